"""A sweep as tables of its points: which columns there are, and a CSV and a Parquet file of them.

Points come in pieces and are written as they come, so that the number of points costs no memory.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fosopt.export.columns import column_of, column_units, free, plain, provenance_of
from fosopt.export.parquet import arrow, arrow_schema
from fosopt.export.text import inert
from fosopt.export.writing import written_to
from fosopt.ops import Array

_ROWS = 8192  # of a row group in Parquet

Piece = tuple[Array, Mapping[str, Array]]
"""(m, s) numbers of consecutive points, axes first, and (m, n) of each mode by name; SI, NaN for no value."""


@dataclass(frozen=True)
class SweepData:
    """A sweep that can be written.

    Attributes
    ----------
    run
        What it was, as in its ``sweep.json``.
    pieces
        Makes all finished points anew, in their order.
    """

    run: Mapping[str, Any]
    pieces: Callable[[], Iterable[Piece]]

    @property
    def sources(self) -> list[Mapping[str, Any]]:
        """Axes, then outputs with one value for each point, as the run describes them."""
        return [*self.run["axes"], *(each for each in self.run["outputs"] if len(each["shape"]) == 1)]

    @property
    def by_mode(self) -> list[Mapping[str, Any]]:
        """Outputs with a value for each mode, as the run describes them."""
        return [each for each in self.run["outputs"] if len(each["shape"]) == 2]


@dataclass(frozen=True)
class SweepColumn:
    """What an axis or an output is called in files, and in which unit.

    Attributes
    ----------
    source
        Its name in the run.
    factor
        From SI to the unit.
    labels
        Texts that the numbers stand for, if they do.
    """

    name: str
    source: str
    unit: str
    factor: float
    labels: tuple[str, ...] | None


def sweep_columns(data: SweepData) -> tuple[list[SweepColumn], list[SweepColumn]]:
    """Columns with one value for each point, axes first, and those with a value for each mode."""
    units, taken = column_units(data.run), set[str]()

    def column(each: Mapping[str, Any]) -> SweepColumn:
        stem, factor = column_of(data.run, each["name"])
        name = free(stem, taken)
        taken.add(name)
        labels = tuple(each["labels"]) if each.get("labels") else None
        return SweepColumn(name, each["name"], "" if labels else units.get(stem, "SI"), factor, labels)

    return [column(each) for each in data.sources], [column(each) for each in data.by_mode]


def write_sweep_csv(data: SweepData, path: Path) -> None:
    """Write the points as a table, one row each, without what has a value for each mode.

    Units stand in the names of the columns; a missing value is an empty cell, and text that a spreadsheet would take
    for a formula gets a leading apostrophe. The last column says where the run came from, in the first row only.

    Raises
    ------
    ExportError
        If the file cannot be written.
    """
    columns, _ = sweep_columns(data)
    origin = inert(provenance_of(data.run))
    with (
        written_to(path) as temporary,
        temporary.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream,
    ):
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([*(column.name for column in columns), "provenance"])
        factors = [column.factor for column in columns]
        for scalars, _ in data.pieces():
            for row in (scalars * factors).tolist():
                cells = (sweep_cell(x, c.labels) for x, c in zip(row, columns, strict=True))
                writer.writerow([*cells, origin])
                origin = ""


def sweep_cell(value: float, labels: Sequence[str] | None) -> str:
    """A number of a sweep in a table: all its digits, empty for none, the text it stands for."""
    if value != value:
        return ""
    return repr(value).removesuffix(".0") if labels is None else inert(labels[int(value)])


def write_sweep_parquet(data: SweepData, path: Path) -> None:
    """Write the points as a table, one row each; what has a value for each mode is a column of lists.

    Every column carries its unit as field metadata ``unit``; name and provenance of the run are metadata of the table.
    A missing value is null, one of a mode NaN.

    Raises
    ------
    ExportError
        If the file cannot be written, or pyarrow is not installed.
    """
    pa, parquet = arrow()
    columns, arrays = sweep_columns(data)
    kinds = [pa.float64() if column.labels is None else pa.string() for column in columns]
    kinds += [pa.list_(pa.float64(), each["shape"][1]) for each in data.by_mode]
    schema = arrow_schema([*columns, *arrays], kinds, data.run)

    def group(pieces: Sequence[Piece]) -> Any:
        from numpy import concatenate, isnan

        found = []
        scalars = concatenate([scalars for scalars, _ in pieces])
        for column, values in zip(columns, scalars.T, strict=True):
            if column.labels is None:
                found.append(pa.array(column.factor * values, mask=isnan(values)))
            else:
                found.append(pa.array([plain(column.labels[int(k)]) for k in values], pa.string()))
        for column, kind in zip(arrays, kinds[len(columns) :], strict=True):
            flat = concatenate([by_mode[column.source].ravel() for _, by_mode in pieces])
            found.append(pa.FixedSizeListArray.from_arrays(column.factor * flat, kind.list_size))
        return pa.Table.from_arrays(found, schema=schema)

    with written_to(path) as temporary, parquet.ParquetWriter(temporary, schema) as writer:
        for pieces in gathered(data.pieces(), _ROWS):
            writer.write_table(group(pieces))


def gathered(pieces: Iterable[Piece], rows: int) -> Iterable[list[Piece]]:
    """Pieces together that have about so many rows."""
    found: list[Piece] = []
    for piece in pieces:
        found.append(piece)
        if sum(scalars.shape[0] for scalars, _ in found) >= rows:
            yield found
            found = []
    if found:
        yield found
