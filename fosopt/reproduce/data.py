"""Reproductions for other programs: curves and comparisons as CSV, all of it as JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Any

from fosopt.reproduce.entry import Comparison, Entry, Panel, Reproduction
from fosopt.reproduce.published import Printed
from fosopt.reproduce.wording import verdict

_ROW = ("what", "published", "computed", "unit", "relative error", "note")


def curves_csv(panels: Sequence[Panel]) -> str:
    """Points of all curves, one to a line: panel and curve, then a column for each quantity that an axis shows."""
    axes = list(dict.fromkeys(label for panel in panels for label in _labels(panel)))
    lines = [["panel", "curve", *axes]]
    for number, panel in enumerate(panels, 1):
        places = [2 + axes.index(label) for label in _labels(panel)]
        for name, curve in _named(panel):
            for point in zip(curve.x, curve.y, strict=True):
                line = [_panel_name(number, panel), name, *[""] * len(axes)]
                for place, value in zip(places, point, strict=True):
                    line[place] = _text(float(value))
                lines.append(line)
    return _csv(lines)


def comparisons_csv(results: Iterable[tuple[Entry, Reproduction]], *, named: bool = True) -> str:
    """Comparisons, one to a line; with the name and verdict of their entry unless there is but one."""
    lines = [[*(("entry", "verdict") if named else ()), *_ROW]]
    for entry, result in results:
        head = [entry.name, result.verdict] if named else []
        lines += [[*head, *(_text(value) for value in _values(row))] for row in result.comparisons]
    return _csv(lines)


def record(entry: Entry, result: Reproduction | None) -> dict[str, Any]:
    """An entry and what was found, without its curves."""
    found = {
        "name": entry.name,
        "title": entry.title,
        "verdict": verdict(result),
    }
    if result is None:
        return found
    keys = [key.replace(" ", "_") for key in _ROW]
    return found | {
        "reason": result.reason,
        "computed": result.computed,
        "comparisons": [dict(zip(keys, _values(row), strict=True)) for row in result.comparisons],
    }


def _values(row: Comparison) -> tuple[Any, ...]:
    return row.what, row.published, row.computed, row.unit, row.relative_error, row.note


def _labels(panel: Panel) -> tuple[str, str]:
    same = panel.x_label == panel.y_label
    return panel.x_label or "x", (f"{panel.y_label} (ordinate)" if same else panel.y_label) or "y"


def _panel_name(number: int, panel: Panel) -> str:
    return f"{number}: {panel.title}" if panel.title else str(number)


def _named(panel: Panel) -> Iterable[tuple[str, Any]]:
    """Curves with a name each: its label, or that of the one it continues and a number."""
    name, branch = "", 0
    for curve in panel.curves:
        name, branch = (curve.label, 1) if curve.label else (name, branch + 1)
        yield (name if curve.label else f"{name} {branch}".strip()), curve


def _text(value: float | str | None) -> str:
    if value is None or (isinstance(value, float) and not isfinite(value)):
        return ""
    if isinstance(value, Printed):
        return value.text
    return str(value) if isinstance(value, str | int) else f"{value:.12g}"


def _csv(lines: Iterable[Sequence[str]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(lines)
    return stream.getvalue()
