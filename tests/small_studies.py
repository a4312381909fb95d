"""The quickstart cut short and edited: studies for the tests that run or build one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fosopt.study import TEMPLATE, parse_study
from fosopt.study.runner import run_study

STUDIES = Path(__file__).resolve().parents[1] / "studies"


# What an attitude loop has and a hub that is free or fixed has not.
HELD_KEYS = (("  bandwidth: 0.1 Hz\n", ""), ("  damping_ratio: 0.7\n", ""))


def edited(*changes: tuple[str, str], text: str = TEMPLATE, bays: int = 3) -> str:
    """The quickstart on a short truss with pieces of its text replaced."""
    for old, new in (*changes, ("bays: 20", f"bays: {bays}")):
        if "bays" in old and "bays" not in text:
            continue  # another structure
        assert old in text, f"the template has no {old!r}"
        text = text.replace(old, new)
    return text


def section(text: str, name: str) -> str:
    """A top-level section of a study file, as it is written."""
    lines = text.splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if line.startswith(f"{name}:"))
    last = next((i for i in range(first + 1, len(lines)) if lines[i][0] not in " \n#"), len(lines))
    return "".join(lines[first:last])


def single(objective: str, constraints: str, **changes: str) -> str:
    """The small quickstart with one objective."""
    return edited(
        (section(TEMPLATE, "objectives"), f"objectives:\n  - minimize: {objective}\n"),
        (section(TEMPLATE, "constraints"), f"constraints:\n{constraints}" if constraints else ""),
        (section(TEMPLATE, "front"), ""),
        *changes.items(),
    )


def analysis(*changes: tuple[str, str], bays: int = 3) -> str:
    """The small quickstart as an analysis of its start."""
    cut = tuple((section(TEMPLATE, name), "") for name in ("variables", "objectives", "front"))
    return edited(("kind: codesign", "kind: analysis"), *cut, *changes, bays=bays)


def run_text(text: str, folder: Path, **options: Any) -> dict[str, Any]:
    """Run text as a study whose run directory is ``out`` in a folder."""
    return run_study(parse_study(text, folder), folder / "out", **options)
