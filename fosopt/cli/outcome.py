"""What a run says at the end: exit code, table of the front, machine-readable summary."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from fosopt.cli.guard import Code

REPORT, TABLE, DATA = "report.html", "front.csv", "front.json"
"""Files of a run beside its record."""

_MOST_ROWS = 30
_MUCH = 0.02  # of a metric, that truncation should not take from it
_START = "start"  # key of the start design
_Run = Mapping[str, Any]


def is_answer(point: Mapping[str, Any]) -> bool:
    """Whether a point is verified and more than the start design, which is judged before the solver starts."""
    return bool(point["verified"]) and point["key"] != _START


def has_failed(point: Mapping[str, Any]) -> bool:
    """Whether a point did not converge, or converged to what did not verify.

    An infeasible or unstable point is an answer, and an interrupted one was not given the time.
    """
    return point["status"] == "failed" or (point["status"] == "optimal" and not point["verified"])


def exit_code(run: _Run, *, stopped: bool) -> Code:
    """What the process says with its exit code."""
    if stopped:
        return Code.INTERRUPTED
    counts = _counts(run["points"])
    if not counts["verified"] or counts["failed"] or counts["interrupted"]:
        return Code.UNVERIFIED
    return Code.DONE if any(not misses for misses in _misses(run).values()) else Code.UNMET


def _misses(run: _Run) -> dict[str, list[str]]:
    """What each verified point misses of what the study requires, in words, by the key of the point."""
    from fosopt.study.requirement import unmet

    return {point["key"]: list(unmet(run, point)) for point in run["points"] if is_answer(point)}


def summary(run: _Run, out: Path, code: Code, seconds: float) -> dict[str, Any]:
    """The outcome for a program to read; objectives are SI."""
    points = run["points"]
    misses = _misses(run)
    kept = ("key", "label", "case", "strategy", "status", "verified", "dominated", "reason")
    return {
        "name": run["name"],
        "kind": run["kind"],
        "exit_code": int(code),
        "interrupted": code == Code.INTERRUPTED,
        "seconds": seconds,
        "directory": str(out),
        "files": {name: str(path) for name, path in files(out).items()},
        "counts": _counts(points),
        "objectives": run["objectives"],
        "points": [
            {name: point[name] for name in kept}
            | {"misses": misses.get(point["key"])}
            | {"values": {name: point["metrics"].get(name) for name in run["objectives"]}}
            for point in points
        ],
    }


def files(out: Path) -> dict[str, Path]:
    """Files a run leaves for people and other tools, by what they are."""
    from fosopt.study.store import RECORD

    return {"report": out / REPORT, "table": out / TABLE, "data": out / DATA, "record": out / RECORD}


def closing(run: _Run, out: Path, seconds: float) -> Iterator[str]:
    """Lines that end a run: its numbers, what failed, and which file to open."""
    points = run["points"]
    yield from _front(run) if run["objectives"] else _metrics(run)
    yield ""
    # What a start design violates is yet to be met.
    told = [each for each in points if each["reason"] and not (each["verified"] and each["key"] == _START)]
    for point in told[:_MOST_ROWS]:
        yield f"{point['key']} {point['status']}: {point['reason']}"
    yield from _judged(run)
    counts = _counts(points)
    yield ", ".join(f"{number} {what}" for what, number in counts.items() if number or what == "verified") + (
        f" in {seconds:.1f} s"
    )
    modes = run.get("provenance", {}).get("modes", "")
    if "residual" in modes:
        yield f"modes: {modes}; peak memory {_peak_gibibytes():.2f} GiB"
        yield from _truncation(points)
    yield f"open {out / REPORT} in a browser; numbers are in {out / TABLE} and {out / DATA}"


def _judged(run: _Run) -> Iterator[str]:
    """Whether what the study requires is met, where it requires anything that an optimization does not hold."""
    from fosopt.study.requirement import line_said

    misses = _misses(run)
    met = sum(not each for each in misses.values())
    if not misses or (met == len(misses) and not run["requirements"] and not run.get("requirement_line")):
        return
    if len(misses) > 1:
        yield f"{met} of {len(misses)} verified points meet all requirements"
        return
    ((key, missed),) = misses.items()
    for text in missed:
        yield f"{key} misses {text}"
    line = next(point.get("requirement_line") for point in run["points"] if point["key"] == key)
    if line and line["met"]:
        yield f"{key} keeps below the requirement line, closest with {line_said(run, line)}"
    if met:
        yield f"{key} meets all requirements"


def _truncation(points: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """What truncation takes from the metrics of the design model: the total jitter, and whatever it changes most."""
    worst: dict[str, float] = {}
    for point in points:
        for name, error in (point["truncation_error"] or {}).items():
            worst[name] = max(error, worst.get(name, 0.0))
    if not worst:
        return
    most = max(worst, key=lambda name: worst[name])
    named = dict.fromkeys(name for name in ("jitter_total", most) if name in worst)
    changed = " and ".join(f"{name} by up to {100 * worst[name]:.2g} %" for name in named)
    yield f"truncation changes {changed}; numbers are the truth model's"
    if worst[most] > _MUCH:
        yield f"that is more than {100 * _MUCH:g} %: keep more modes, with 'modes: {{count: ...}}' in the study"


def _peak_gibibytes() -> float:
    """Largest resident memory of this process so far [GiB]."""
    if sys.platform == "win32":
        return float("nan")
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**30 if sys.platform == "darwin" else 2**20)


def _counts(points: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    return {
        "points": len(points),
        "verified": sum(map(is_answer, points)),
        "failed": sum(map(has_failed, points)),
        "interrupted": sum(point["status"] == "interrupted" for point in points),
    }


def _front(run: _Run) -> Iterator[str]:
    """The points with their objectives."""
    points = run["points"]
    names = run["objectives"]
    optional = [name for name in ("case", "strategy") if len({point[name] for point in points} - {None}) > 1]
    rows = [["point", *optional, *(_title(run, name) for name in names), "status", "verified", ""]]
    rows += [
        [
            point["key"],
            *(str(point[name] or "-") for name in optional),
            *(_number(run, name, point["metrics"].get(name)) for name in names),
            point["status"],
            "yes" if point["verified"] else "no",
            "dominated" if point["dominated"] else point["label"],
        ]
        for point in points[:_MOST_ROWS]
    ]
    yield from _aligned(rows, right=range(1 + len(optional), 1 + len(optional) + len(names)))
    if len(points) > _MOST_ROWS:
        yield f"and {len(points) - _MOST_ROWS} more points"


def _metrics(run: _Run) -> Iterator[str]:
    """The metrics of a design that was judged, one per line; those of single modes are in the files."""
    for point in run["points"]:
        yield f"{point['label']}: {point['status']}, {'verified' if point['verified'] else 'not verified'}"
        names = [name for name in point["metrics"] if "[" not in name]
        rows = [[_title(run, name), _number(run, name, point["metrics"][name])] for name in names]
        yield from _aligned(rows, right=range(1, 2))


def _title(run: _Run, name: str) -> str:
    quantity = run["quantities"].get(name)
    if quantity is None:
        return name
    return f"{quantity['label']} [{quantity['unit']}]" if quantity["unit"] else str(quantity["label"])


def _number(run: _Run, name: str, value: float | None) -> str:
    quantity = run["quantities"].get(name)
    return "-" if value is None else f"{value * (quantity['factor'] if quantity else 1.0):.5g}"


def _aligned(rows: Sequence[Sequence[str]], right: range) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = zip(row, widths, strict=True)
        text = (cell.rjust(w) if k in right else cell.ljust(w) for k, (cell, w) in enumerate(cells))
        yield "  ".join(text).rstrip()
