"""Python, packages, libraries, graphics, the built page."""

from __future__ import annotations

import re
from pathlib import Path

from nearfield_server.doctor.finding import Finding, ok, problem, warning
from nearfield_server.doctor.machine import Machine
from nearfield_server.errors import CaptureError, GraphicsError

OLDEST_PYTHON = (3, 11)
OLDEST_ARAVIS = (0, 8, 20)


def check_python(machine: Machine) -> Finding:
    """Python is new enough."""
    found = machine.python_version()
    needed = ".".join(map(str, OLDEST_PYTHON))
    if _numbers(found)[:2] < OLDEST_PYTHON:
        return problem(
            "python",
            f"{found}, expected {needed} or newer",
            f"sudo apt-get install python{needed} python{needed}-venv",
        )
    return ok("python", found)


def check_packages(machine: Machine) -> Finding:
    """Every package is there in a version that Nearfield was tested with."""
    requirements = machine.requirements()
    if not requirements:
        return problem("packages", "Nearfield itself is not installed in this Python", "make setup")
    wrong, told = [], []
    for line in requirements:
        name, bounds = parse_requirement(line)
        found = machine.package_version(name)
        if found is None or not is_within(found, bounds):
            wrong.append(f"'{name}{bounds}'")
            told.append(f"{name} {found or 'missing'}, expected {bounds or 'any'}")
    if wrong:
        return problem("packages", "; ".join(told), "pip install " + " ".join(wrong))
    return ok("packages", f"{len(requirements)} packages in the expected versions")


def parse_requirement(line: str) -> tuple[str, str]:
    """Name and version bounds of a requirement such as "numpy<3,>=2.2" or "uvicorn[standard] (>=0.40) ; marker"."""
    found = re.match(r"\s*([A-Za-z0-9._-]+)\s*(?:\[[^]]*])?\s*\(?([^;()]*)\)?", line)
    return (found[1], found[2].strip()) if found else (line, "")


def is_within(version: str, bounds: str) -> bool:
    """Whether a version fulfils bounds of the forms >=, >, <=, <, ==, !=, joined by commas; suffixes such as rc1 are left out."""
    numbers = _numbers(version)
    for bound in filter(None, (part.strip() for part in bounds.split(","))):
        found = re.fullmatch(r"(>=|<=|==|!=|~=|<|>)\s*([0-9.]+)\S*", bound)
        if found is None:
            continue
        limit = _numbers(found[2])
        length = max(len(numbers), len(limit))
        here, there = _padded(numbers, length), _padded(limit, length)
        holds = {
            ">=": here >= there,
            ">": here > there,
            "<=": here <= there,
            "<": here < there,
            "==": here == there,
            "!=": here != there,
            "~=": here >= there and numbers[: len(limit) - 1] == limit[:-1],
        }[found[1]]
        if not holds:
            return False
    return True


def _numbers(version: str) -> tuple[int, ...]:
    found = re.match(r"\d+(?:\.\d+)*", version)
    return tuple(int(part) for part in found[0].split(".")) if found else ()


def _padded(numbers: tuple[int, ...], length: int) -> tuple[int, ...]:
    return numbers + (0,) * (length - len(numbers))


def check_aravis(machine: Machine, is_needed: bool) -> Finding:
    """The library for GigE Vision and USB3 Vision is there.

    Args:
        machine: see there.
        is_needed: the room has such a camera.
    """
    mend = "sudo apt-get install --no-install-recommends libaravis-0.8-0"
    try:
        version = machine.aravis_version()
    except CaptureError as error:
        if is_needed:
            return problem("libaravis", str(error), mend)
        return warning("libaravis", f"{error}; only V4L2 cameras will work", mend)
    if _numbers(version) < OLDEST_ARAVIS:
        oldest = ".".join(map(str, OLDEST_ARAVIS))
        return warning("libaravis", f"{version}, tested with {oldest} and newer", mend)
    return ok("libaravis", version)


def check_graphics(machine: Machine) -> Finding:
    """There is an OpenGL renderer, and it is a real one."""
    try:
        renderer, is_software = machine.renderer()
    except GraphicsError as error:
        return warning(
            "graphics",
            f"no OpenGL 4.3 ({error}); light is computed on the processor",
            "sudo apt-get install libegl1 libgl1",
        )
    if not is_software:
        return ok("graphics", renderer)
    if machine.names("/dev/dri/renderD*") and not any(
        machine.may_use(node) for node in machine.names("/dev/dri/renderD*")
    ):
        return warning(
            "graphics",
            f"{renderer}: a graphics card is there, but this user may not use it",
            f"sudo usermod -aG render {machine.user()}   # then log in again",
        )
    return warning(
        "graphics",
        f"{renderer}: a software renderer; light is computed on the processor, which is enough for a few cameras of 1024 x 1024",
        "install the driver of the graphics card, if there is one",
    )


def check_page(static_dir: Path) -> Finding:
    """The browser client is built; what tablets need is said here, where nobody can test it."""
    if not (static_dir / "index.html").is_file():
        return problem("page", "the browser client is not built", "make setup")
    return ok(
        "page",
        "built; tablets need a browser with WebGL 2. The page is plain HTTP and uses no tablet camera, so it needs no certificate; "
        "browsers keep the screen awake on HTTPS only, so let tablets never sleep",
    )
