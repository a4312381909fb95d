"""The columns of a front: which there are, what they are called, and their units.

Every table of a front has the same columns in the same order. Values are SI but for frequencies, which are in
hertz; the end of a column's name says so. `docs/running.md` lists them for users.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from fosopt.units import DIMENSIONS

Cell = str | bool | int | float | None
Row = Mapping[str, Any]

TEXT = ("key", "label", "case", "strategy", "status")
VERDICT = ("verified", "dominated")
TEXT_AFTER = ("parent", "reason")
EFFORT = ("seconds", "iterations", "kkt_residual")
LINE = {"requirement_line_excess_rad": "rad", "requirement_line_frequency_hz": "Hz"}
SI = "SI"
"""Unit of a column whose quantity has no name: slacks, multipliers and expressions."""

_EFFORT_UNITS = {"seconds": "s", "iterations": "1", "kkt_residual": "1"}


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    name
        Unique in the table.
    kind
        What its cells are; None is a missing value of any kind.
    unit
        Of its numbers, empty for texts and verdicts.
    values
        One for each point.
    variable
        The design variable that it is one group of, if it is.
    """

    name: str
    kind: Literal["text", "verdict", "number"]
    unit: str
    values: list[Cell]
    variable: str | None = None


def front_columns(run: Row) -> list[Column]:
    """All columns of the points of a run.

    Slacks and multipliers are SI throughout, also of frequencies.
    """
    columns: dict[str, Column] = {}
    every = points(run)

    def add(
        name: str,
        kind: Literal["text", "verdict", "number"],
        unit: str,
        values: Iterable[Cell],
        variable: str | None = None,
    ) -> None:
        name = free(name, columns)
        columns[name] = Column(name, kind, unit, list(values), variable)

    for name in TEXT:
        add(name, "text", "", (point[name] for point in every))
    for name in VERDICT:
        add(name, "verdict", "", (point[name] for point in every))
    for name in TEXT_AFTER:
        add(name, "text", "", (point[name] for point in every))
    units = column_units(run)
    for name, values in (metrics(run) | bounds(run)).items():
        add(name, "number", "1" if name.endswith("_gap") else units.get(name, SI), values)
    for part in ("slack", "multiplier"):
        for name, values in constraints(run, part).items():
            add(f"{part}_{name}", "number", SI, values)
    for name, values in line_verdicts(run).items():
        add(name, "number" if name in LINE else "verdict", LINE.get(name, ""), values)
    for name, matrix in variables(run).items():
        column = variable_column(run, name)
        unit, owner = units.get(column_of(run, name)[0], SI), name if name in run["labels"] else None
        for group, cells in zip(_groups(run, name, column), zip(*matrix, strict=True), strict=True):
            add(group, "number", unit, cells, owner)
    for name in EFFORT:
        add(name, "number", _EFFORT_UNITS[name], (point[name] for point in every))
    return list(columns.values())


def provenance_of(run: Row) -> str:
    """Where the run came from, as one line of text."""
    return "; ".join(f"{key} {value}" for key, value in run["provenance"].items())


def about(run: Row) -> dict[str, str]:
    """Name of the run and where it came from."""
    return {"name": str(run["name"]), **{key: str(value) for key, value in run["provenance"].items()}}


def encoded(text: str) -> bytes:
    """UTF-8 of a text; what that cannot hold, a lone surrogate of a file's name, is spelled out."""
    return text.encode("utf-8", "backslashreplace")


def plain(text: str) -> str:
    """A text that UTF-8 can hold, see `encoded`."""
    return encoded(text).decode("utf-8")


def points(run: Row) -> list[Row]:
    """Points of a run, in its order."""
    return listed(run, "points")


def listed(run: Row, name: str) -> list[Any]:
    """A list of the run data, empty where it has none."""
    found = run[name]
    return found if isinstance(found, list) else []


def column_of(run: Row, name: str) -> tuple[str, float]:
    """Name of a metric's or variable's column, and factor from SI; an expression keeps its words and SI."""
    quantity = run["quantities"].get(name)
    return (words(name), 1.0) if quantity is None else (quantity["column"], quantity["column_factor"])


def column_units(run: Row) -> dict[str, str]:
    """Unit by the name of a column, found by the unit that people are shown."""
    kinds = DIMENSIONS.values()
    return {
        str(each["column"]): next(
            (kind.column_unit or kind.unit for kind in kinds if kind.shown == each["unit"]), each["unit"]
        )
        for each in run["quantities"].values()
    }


def words(text: str) -> str:
    """Letters and digits of a text, joined by underscores."""
    return re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")


def names(run: Row, part: str) -> list[str]:
    """Names of the metrics or variables that some point has."""
    return list(dict.fromkeys(name for point in points(run) for name in point[part]))


def metrics(run: Row) -> dict[str, list[Cell]]:
    """One column per metric that some point has."""
    columns: dict[str, list[Cell]] = {}
    for name in names(run, "metrics"):
        column, factor = column_of(run, name)
        values = (point["metrics"].get(name) for point in points(run))
        columns[free(column, columns)] = [None if value is None else value * factor for value in values]
    return columns


def bounds(run: Row) -> dict[str, list[Cell]]:
    """Two columns per bound: its value, and the share of what a point has by which another could be better."""
    columns: dict[str, list[Cell]] = {}
    every = points(run)
    for row, point in enumerate(every):
        for bound in point.get("bounds", ()):
            name, factor = column_of(run, bound["name"])
            value = bound["value"]
            columns.setdefault(name, [None] * len(every))[row] = None if value is None else value * factor
            columns.setdefault(f"{bound['name']}_gap", [None] * len(every))[row] = bound["gap"]
    return columns


def line_verdicts(run: Row) -> dict[str, list[Cell]]:
    """Whether each point keeps below the requirement line, false where it is not judged, and the numbers in `LINE`."""
    if run.get("requirement_line") is None:
        return {}
    verdicts = [point.get("requirement_line") or {} for point in points(run)]
    return {
        "requirement_line_met": [bool(each.get("met")) for each in verdicts],
        "requirement_line_excess_rad": [each.get("excess") for each in verdicts],
        "requirement_line_frequency_hz": [each.get("frequency_hz") for each in verdicts],
    }


def variables(run: Row) -> dict[str, list[list[float | None]]]:
    """One matrix per variable, with a row per point and a column per group."""
    matrices: dict[str, list[list[float | None]]] = {}
    for name in names(run, "variables"):
        factor = column_of(run, name)[1]
        given = [point["variables"].get(name, []) for point in points(run)]
        width = max(map(len, given))
        matrices[name] = [
            [*(value * factor for value in values), *[None] * (width - len(values))] for values in given
        ]
    return matrices


def variable_column(run: Row, name: str) -> str:
    """Name of a variable's column; one that is designed and measured, as a crossover, has two of them."""
    return f"variable_{column_of(run, name)[0]}" if name in names(run, "metrics") else column_of(run, name)[0]


def _groups(run: Row, name: str, column: str) -> list[str]:
    """Columns of a variable, named after its groups where it has some: ``area_L1_m2``."""
    groups = run["labels"].get(name)
    if groups is None:
        return [column]
    end = column.find(name) + len(name)
    stem, unit = (column[:end], column[end:]) if name in column else (column, "")
    return [f"{stem}_{words(group)}{unit}" for group in groups]


def constraints(run: Row, part: str) -> dict[str, list[Cell]]:
    """Slack or multiplier by constraint; the second constraint of one name is another column."""
    columns: dict[str, list[Cell]] = {}
    every = points(run)
    for row, point in enumerate(every):
        seen: set[str] = set()
        for constraint in point["constraints"]:
            name = free(words(constraint["name"]), seen)
            seen.add(name)
            columns.setdefault(name, [None] * len(every))[row] = constraint[part]
    return columns


def free(name: str, taken: Iterable[str]) -> str:
    """The name, with a number where it is taken."""
    known = set(taken)
    numbered = (f"{name}_{k}" for k in range(2, len(known) + 3))
    return next(each for each in (name, *numbered) if each not in known)
