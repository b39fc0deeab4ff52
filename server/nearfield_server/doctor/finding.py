"""What a check found."""

from __future__ import annotations

import enum
import json
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass


class Level(enum.Enum):
    """How bad it is."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Result of one check.

    Attributes:
        check: short name ("receive buffer").
        level: ok, warning (it works, but not well) or problem (it will not work).
        text: what was found, and what was expected.
        mend: the command that mends it, or what to do; empty when nothing is to be done.
    """

    check: str
    level: Level
    text: str
    mend: str = ""


def ok(check: str, text: str) -> Finding:
    """All is well."""
    return Finding(check=check, level=Level.OK, text=text)


def warning(check: str, text: str, mend: str) -> Finding:
    """It works, but not well."""
    return Finding(check=check, level=Level.WARNING, text=text, mend=mend)


def problem(check: str, text: str, mend: str) -> Finding:
    """It will not work."""
    return Finding(check=check, level=Level.PROBLEM, text=text, mend=mend)


def has_problem(findings: Sequence[Finding]) -> bool:
    """Whether anything will not work."""
    return any(finding.level is Level.PROBLEM for finding in findings)


def as_text(findings: Sequence[Finding], *, colour: bool = False) -> str:
    """One line per check; below it, where there is something to do, the command alone, ready to be copied."""
    colours = {Level.OK: "32", Level.WARNING: "33", Level.PROBLEM: "31"}
    width = max((len(finding.check) for finding in findings), default=0)
    lines = []
    for finding in findings:
        level = f"{finding.level.value:<7}"
        if colour:
            level = f"\x1b[{colours[finding.level]}m{level}\x1b[0m"
        lines.append(f"{level}  {finding.check:<{width}}  {finding.text}")
        if finding.mend:
            lines.append(textwrap.indent(finding.mend, " " * (width + 11)))
    counts = {level: sum(finding.level is level for finding in findings) for level in Level}
    lines += [
        "",
        f"{counts[Level.PROBLEM]} problems, {counts[Level.WARNING]} warnings, {counts[Level.OK]} ok",
    ]
    return "\n".join(lines) + "\n"


def as_json(findings: Sequence[Finding]) -> str:
    """The same for programs."""
    entries = [
        {
            "check": finding.check,
            "level": finding.level.value,
            "text": finding.text,
            "mend": finding.mend,
        }
        for finding in findings
    ]
    return json.dumps({"ok": not has_problem(findings), "findings": entries}, indent=2) + "\n"
