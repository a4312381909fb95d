"""A front as CSV and as JSON."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fosopt.export.columns import Cell, front_columns, points, provenance_of
from fosopt.export.writing import written_to

# What a spreadsheet takes for the start of a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def write_csv(run: Mapping[str, Any], path: Path) -> None:
    """Write the points as a table, one row each, with `export.columns.front_columns`.

    Text that a spreadsheet would take for a formula gets a leading apostrophe; a missing value is an empty cell.
    The last column says in every row where the run came from, so that a row copied elsewhere can be traced.

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
    columns = front_columns(run)
    origin = provenance_of(run)
    with (
        written_to(path) as temporary,
        temporary.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream,
    ):
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([*(column.name for column in columns), "provenance"])
        for row in zip(*(column.values for column in columns), strict=True):
            writer.writerow(map(inert, [*row, origin]))


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
    rows = [{key: value for key, value in point.items() if key != "detail"} for point in points(run)]
    text = json.dumps({**run, "points": rows}, allow_nan=False, indent=1)
    with written_to(path) as temporary:
        temporary.write_text(text + "\n", encoding="ascii", newline="\n")


def inert(value: Cell) -> str:
    """A cell as text: floats with all their digits, texts that no spreadsheet takes for a formula."""
    if isinstance(value, str):
        # A lone carriage return would end the row for many readers, and csv does not quote it.
        text = value.replace("\r\n", "\n").replace("\r", "\n")
        return f"'{text}" if value.startswith(_FORMULA) else text
    return "" if value is None else json.dumps(value, allow_nan=False)
