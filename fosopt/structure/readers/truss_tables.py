"""Nodes and members of a truss in CSV tables whose headers name the units, such as ``area [mm^2]``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from fosopt.errors import did_you_mean
from fosopt.structure.readers.common import bad, number, table_rows
from fosopt.structure.truss import Bar
from fosopt.units import DIMENSIONS, QuantityError, parse_quantity, quote

_HEADER = re.compile(r"(\w+)\s*(?:\[(.*)\])?")
_NODE_COLUMNS = {"node": None, "x": "length", "y": "length", "z": "length"}
_BAR_COLUMNS = {
    "name": None,
    "start": None,
    "end": None,
    "area": "area",
    "young": "pressure",
    "density": "density",
    "kind": None,
    "bay": None,
}
_MOST_ROWS = 20_000


def read_nodes(file: Path) -> dict[str, tuple[float, ...]]:
    """Coordinates of nodes by name [m], of a table with the columns node, x, y and, in space, z.

    Raises
    ------
    StudyError
        For a column that is unknown, missing or without a unit, a value that is no number, or a name that stands twice.
    """
    columns, rows = _table(file, _NODE_COLUMNS, ("node", "x", "y"))
    found: dict[str, tuple[float, ...]] = {}
    for line, row in rows:
        name = _name(file, row["node"], "a node", line)
        if name in found:
            raise bad(file, f"the node '{name}' stands twice; remove one", line)
        found[name] = tuple(
            columns[axis] * number(file, row[axis], axis, line) for axis in ("x", "y", "z") if axis in columns
        )
    return found


def read_bars(file: Path) -> tuple[Bar, ...]:
    """Bars of a table with the columns start, end, area, young and density, and as wanted name, kind and bay.

    Raises
    ------
    StudyError
        As `read_nodes`, and for an area, modulus or density that is not above zero.
    """
    columns, rows = _table(file, _BAR_COLUMNS, ("start", "end", "area", "young", "density"))
    found: list[Bar] = []
    for line, row in rows:
        sizes = {}
        for what in ("area", "young", "density"):
            sizes[what] = columns[what] * number(file, row[what], what, line)
            if not sizes[what] > 0:
                raise bad(
                    file,
                    f"{what} {quote(row[what])} is not above zero; correct it or leave the bar out",
                    line,
                )
        ends = _name(file, row["start"], "a start", line), _name(file, row["end"], "an end", line)
        bay = row.get("bay") or "0"
        if not bay.isdigit():
            raise bad(file, f"bay {quote(bay)} is no whole number; count bays from 1", line)
        name = row.get("name") or f"{ends[0]}-{ends[1]}"
        found.append(Bar(name, ends, **sizes, kind=row.get("kind") or "bar", bay=int(bay)))
    return tuple(found)


def _name(file: Path, text: str, what: str, line: int) -> str:
    if not text:
        raise bad(file, f"{what} without a name; complete the row", line)
    return text


def _table(
    file: Path, known: Mapping[str, str | None], needed: tuple[str, ...]
) -> tuple[dict[str, float], list[tuple[int, dict[str, str]]]]:
    """Factor to SI of each column, and the rows by column with their lines."""
    first, header, rows = table_rows(file)
    names: list[str] = []
    factors: dict[str, float] = {}
    for k, text in enumerate(header, 1):
        match = _HEADER.fullmatch(text)
        name, unit = (match[1], match[2]) if match else (text, None)
        if name not in known:
            raise bad(file, f"unknown column {quote(text)}; {did_you_mean(name, known)}", first, k)
        dimension = known[name]
        if dimension is None:
            if unit is not None:
                raise bad(file, f"the column {quote(name)} has no unit; write the name alone", first, k)
            factors[name] = 1.0
        else:
            factors[name] = _factor(file, name, unit, dimension, (first, k))
        names.append(name)
    for name in needed:
        if name not in names:
            example = f"{name} [{DIMENSIONS[known[name] or ''].unit}]" if known[name] else name
            raise bad(file, f"the column '{name}' is missing; add '{example}'", first)
    found = [(line, dict(zip(names, row, strict=True))) for line, row in rows]
    if not 1 <= len(found) <= _MOST_ROWS:
        raise bad(file, f"{len(found)} rows; give 1 to {_MOST_ROWS}")
    return factors, found


def _factor(file: Path, name: str, unit: str | None, dimension: str, at: tuple[int, int]) -> float:
    example = DIMENSIONS[dimension].unit
    if not unit:
        raise bad(file, f"the column '{name}' is left without a unit; write '{name} [{example}]'", *at)
    try:
        return parse_quantity(f"1 {unit}", dimension)
    except QuantityError:
        raise bad(
            file, f"{quote(unit)} is no unit of '{name}'; write one such as '{name} [{example}]'", *at
        ) from None
