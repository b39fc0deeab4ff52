"""The benchmark page, built once, and a small scene for it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from nearfield_server.benchmark.client_scene import ClientScene, client_scene

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="session")
def built_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    tools = Path(sys.executable).parent
    npx = shutil.which("npx", path=str(tools)) or shutil.which("npx")
    if npx is None or not (ROOT / "client_web" / "node_modules").is_dir():
        pytest.fail("the client cannot be built: install Node 22 or later and run `npm ci` in client_web")
    built = subprocess.run(
        [npx, "vite", "build", "--config", "vite.bench.config.ts", "--outDir", str(folder)],
        cwd=ROOT / "client_web",
        env={"PATH": f"{tools}:/usr/bin:/bin", "HOME": str(Path.home())},
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    return folder


@pytest.fixture(scope="session")
def tiny_scene(tmp_path_factory: pytest.TempPathFactory) -> ClientScene:
    """The smallest room, with packets of 2 and 4 VALs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        return client_scene(ROOT / "tests" / "data" / "tiny_room", (2, 4), lambda _: None)
