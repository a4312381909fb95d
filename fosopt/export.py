"""A run as files for other tools: CSV, JSON and MATLAB.

Values are SI but for frequencies, which are in hertz; the end of a column's name says so. A file replaces an
older one only when it is complete.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fosopt.errors import FosoptError
from fosopt.files import replacing
from fosopt.units import DIMENSIONS

_Cell = str | bool | int | float | None
_Row = Mapping[str, Any]

_TEXT = ("key", "label", "case", "strategy", "status")
_VERDICT = ("verified", "dominated")
_TEXT_AFTER = ("parent", "reason")
_EFFORT = ("seconds", "iterations", "kkt_residual")
# What a spreadsheet takes for the start of a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_LONGEST_NAME = 63  # characters of a name in MATLAB


class ExportError(FosoptError):
    """A file that cannot be written."""


def write_csv(run: Mapping[str, Any], path: Path) -> None:
    """Write the points as a table, one row each.

    Slacks and multipliers are SI throughout, also of frequencies. Text that a spreadsheet would take for a
    formula gets a leading apostrophe; a missing value is an empty cell.

    Parameters
    ----------
    run
        The run data.
    path
        The CSV file to write, in UTF-8.

    Raises
    ------
    ExportError
        If the file cannot be written.
    ValueError
        If a number of the run is not finite.
    """
    points = _points(run)
    columns: dict[str, list[_Cell]] = {
        name: [point[name] for point in points] for name in (*_TEXT, *_VERDICT, *_TEXT_AFTER)
    }
    for name, values in _metrics(run).items():
        columns[_free(name, columns)] = list(values)
    for name, values in _bounds(run).items():
        columns[_free(name, columns)] = list(values)
    for part in ("slack", "multiplier"):
        for name, values in _constraints(run, part).items():
            columns[_free(f"{part}_{name}", columns)] = list(values)
    for name, matrix in _variables(run).items():
        # A crossover that is designed is also measured; the two must not share a name.
        prefix = "variable_" if name in _names(run, "metrics") else ""
        for column, group in zip(_groups(run, name), zip(*matrix, strict=True), strict=True):
            columns[_free(prefix + column, columns)] = list(group)
    columns |= {name: [point[name] for point in points] for name in _EFFORT}
    with (
        _replacing(path) as temporary,
        temporary.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream,
    ):
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(map(_written, row) for row in zip(*columns.values(), strict=True))


def write_json(run: Mapping[str, Any], path: Path) -> None:
    """Write the run data without the details of its points, all in SI.

    Parameters
    ----------
    run
        The run data.
    path
        The JSON file to write, in ASCII.

    Raises
    ------
    ExportError
        If the file cannot be written.
    ValueError
        If a number of the run is not finite.
    """
    points = [{key: value for key, value in point.items() if key != "detail"} for point in _points(run)]
    text = json.dumps({**run, "points": points}, allow_nan=False, indent=1)
    with _replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="ascii", newline="\n")


def write_mat(run: Mapping[str, Any], path: Path) -> None:
    """Write the points as MATLAB arrays with one row each, NaN where a value is missing.

    ``metrics``, ``bounds``, ``variables``, ``slack`` and ``multiplier`` are structs of arrays, ``objectives`` is a
    matrix with one column for each of ``objective_names``. ``labels`` names the groups of a variable, and ``units``
    gives the unit by the name of a column.

    Parameters
    ----------
    run
        The run data.
    path
        The file to write, in MATLAB's format 5.

    Raises
    ------
    ExportError
        If the file cannot be written.
    """
    # SciPy takes a while to import, and only this needs it.
    import numpy as np
    from scipy.io import savemat

    points, metrics, variables = _points(run), _metrics(run), _variables(run)

    def numbers(values: Sequence[object], columns: int = 1) -> Any:
        return np.array(values, dtype=float).reshape(len(points), columns)

    def texts(values: Iterable[object]) -> Any:
        cells = ["" if value is None else str(value) for value in values]
        array = np.empty((len(cells), 1), dtype=object)
        array[:, 0] = cells
        return array

    names = [_column(run, name)[0] for name in _listed(run, "objectives")]
    columns = [metrics.get(name, [None] * len(points)) for name in names]
    quantities = [_quantity(run, name) for name in (*_names(run, "metrics"), *_names(run, "variables"))]
    content = {
        "name": str(run["name"]),
        **{name: texts(point[name] for point in points) for name in (*_TEXT, *_TEXT_AFTER)},
        **{name: np.array([[bool(point[name])] for point in points], dtype=bool) for name in _VERDICT},
        **{name: numbers([point[name] for point in points]) for name in _EFFORT},
        "objectives": numbers([*zip(*columns, strict=True)], len(columns)),
        "objective_names": texts(_field(name) for name in names),
        "metrics": _struct(metrics, numbers),
        "bounds": _struct(_bounds(run), numbers),
        "variables": _struct(
            {_column(run, name)[0]: rows for name, rows in variables.items()},
            lambda rows: numbers(rows, len(rows[0])),
        ),
        "slack": _struct(_constraints(run, "slack"), numbers),
        "multiplier": _struct(_constraints(run, "multiplier"), numbers),
        "labels": _struct(
            {_column(run, name)[0]: run["labels"][name] for name in variables if name in run["labels"]}, texts
        ),
        "units": _struct({str(each["column"]): _unit(each) for each in quantities if each}, str),
    }
    with _replacing(path) as temporary, temporary.open("wb") as stream:
        savemat(stream, content, long_field_names=True, do_compression=True)


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A file to write that takes the place of ``path`` when it is complete."""
    try:
        with replacing(path) as temporary:
            yield temporary
    except OSError as error:
        reason = error.strerror or str(error)
        message = f"{path}: cannot be written: {reason}; check the directory, its permissions and free space"
        raise ExportError(message) from None


def _listed(run: _Row, name: str) -> list[Any]:
    listed = run[name]
    return listed if isinstance(listed, list) else []


def _points(run: _Row) -> list[_Row]:
    return _listed(run, "points")


def _quantity(run: _Row, name: str) -> _Row | None:
    found: _Row | None = run["quantities"].get(name)
    return found


def _column(run: _Row, name: str) -> tuple[str, float]:
    """Name of a metric's or variable's column, and factor from SI; an expression keeps its words and SI."""
    quantity = _quantity(run, name)
    return (_words(name), 1.0) if quantity is None else (quantity["column"], quantity["column_factor"])


def _words(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")


def _names(run: _Row, part: str) -> list[str]:
    """Names of the metrics or variables that some point has."""
    return list(dict.fromkeys(name for point in _points(run) for name in point[part]))


def _metrics(run: _Row) -> dict[str, list[float | None]]:
    """One column per metric that some point has."""
    columns: dict[str, list[float | None]] = {}
    for name in _names(run, "metrics"):
        column, factor = _column(run, name)
        values = (point["metrics"].get(name) for point in _points(run))
        columns[_free(column, columns)] = [None if value is None else value * factor for value in values]
    return columns


def _bounds(run: _Row) -> dict[str, list[float | None]]:
    """Two columns per bound: its value, and the share of what a point has by which another could be better."""
    columns: dict[str, list[float | None]] = {}
    points = _points(run)
    for row, point in enumerate(points):
        for bound in point.get("bounds", ()):
            name, factor = _column(run, bound["name"])
            value = bound["value"]
            columns.setdefault(name, [None] * len(points))[row] = None if value is None else value * factor
            columns.setdefault(f"{bound['name']}_gap", [None] * len(points))[row] = bound["gap"]
    return columns


def _variables(run: _Row) -> dict[str, list[list[float | None]]]:
    """One matrix per variable, with a row per point and a column per group."""
    matrices: dict[str, list[list[float | None]]] = {}
    for name in _names(run, "variables"):
        factor = _column(run, name)[1]
        given = [point["variables"].get(name, []) for point in _points(run)]
        width = max(map(len, given))
        matrices[name] = [
            [*(value * factor for value in values), *[None] * (width - len(values))] for values in given
        ]
    return matrices


def _groups(run: _Row, name: str) -> list[str]:
    """Columns of a variable, named after its groups where it has some: ``area_L1_m2``."""
    column, groups = _column(run, name)[0], run["labels"].get(name)
    if groups is None:
        return [column]
    stem, unit = (name, column.removeprefix(name)) if column.startswith(name) else (column, "")
    return [f"{stem}_{_words(group)}{unit}" for group in groups]


def _constraints(run: _Row, part: str) -> dict[str, list[float | None]]:
    """Slack or multiplier by constraint; the second constraint of one name is another column."""
    columns: dict[str, list[float | None]] = {}
    points = _points(run)
    for row, point in enumerate(points):
        seen: set[str] = set()
        for constraint in point["constraints"]:
            name = _free(_words(constraint["name"]), seen)
            seen.add(name)
            columns.setdefault(name, [None] * len(points))[row] = constraint[part]
    return columns


def _free(name: str, taken: Iterable[str]) -> str:
    """The name, with a number where it is taken."""
    known = set(taken)
    numbered = (f"{name}_{k}" for k in range(2, len(known) + 3))
    return next(each for each in (name, *numbered) if each not in known)


def _written(value: _Cell) -> str:
    """A cell as text: floats with all their digits."""
    if isinstance(value, str):
        # A lone carriage return would end the row for many readers, and csv does not quote it.
        text = value.replace("\r\n", "\n").replace("\r", "\n")
        return f"'{text}" if value.startswith(_FORMULA) else text
    return "" if value is None else json.dumps(value, allow_nan=False)


def _field(name: str, taken: Iterable[str] = ()) -> str:
    """A name MATLAB takes."""
    words = _words(name)
    words = words if words[:1].isalpha() else f"x_{words}"
    return _free(words[: _LONGEST_NAME - 4], taken) if len(words) > _LONGEST_NAME else _free(words, taken)


def _struct(values: Mapping[str, Any], make: Callable[[Any], Any]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for name, value in values.items():
        fields[_field(name, fields)] = make(value)
    return fields


def _unit(quantity: _Row) -> str:
    """Unit of the column, found by the unit that people are shown."""
    shown = quantity["unit"]
    return next((kind.column_unit or kind.unit for kind in DIMENSIONS.values() if kind.shown == shown), shown)
