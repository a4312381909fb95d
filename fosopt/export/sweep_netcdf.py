"""A sweep as netCDF arrays with named axes and units, written piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.export.columns import about, free, plain
from fosopt.export.sweep import SweepColumn, SweepData, gathered, sweep_columns
from fosopt.export.writing import ExportError, written_to

_ROWS = 4096  # points that are written together

Box = tuple[slice | int, ...]


def write_sweep_netcdf(data: SweepData, path: Path) -> None:
    """Write the points as netCDF variables: over the axes of a grid, else over ``point``.

    What has a value for each mode has an axis ``mode`` more, of coupled modes, or ``structure_mode``, of the structure
    alone; modes count from one. Every number has its ``units``; a missing one, as of a point that is not finished, is
    NaN. Name and provenance of the run are global attributes.

    Parameters
    ----------
    path
        The file to write, in the format netCDF-4.

    Raises
    ------
    ExportError
        If the file cannot be written, or netCDF4 is not installed.
    """
    try:
        from netCDF4 import Dataset
    except ImportError:
        raise ExportError(
            "netCDF of a sweep needs netCDF4; install it: pip install 'fosopt[netcdf]'"
        ) from None
    columns, arrays = sweep_columns(data)
    n_axis = len(data.run["axes"])
    grid = [each["values"] for each in data.run["axes"]]
    gridded = all(values is not None for values in grid)
    axes = columns[:n_axis]
    names = tuple(axis.name for axis in axes) if gridded else ("point",)
    shape = tuple(data.run["shape"])
    with written_to(path) as temporary, _writing(), Dataset(temporary, "w", format="NETCDF4") as file:
        file.setncatts({key: plain(value) for key, value in about(data.run).items()})
        for name, size in zip(names, shape, strict=True):
            file.createDimension(name, size)
        if gridded:
            for axis, values in zip(axes, grid, strict=True):
                _coordinate(file, axis, values)
        stored: list[tuple[Any, SweepColumn, int | None]] = []
        for k, column in enumerate(columns):
            if not (gridded and k < n_axis):
                kind: Any = "f8" if column.labels is None else str
                stored.append((_variable(file, column, kind, names), column, k))
        for column, each in zip(arrays, data.by_mode, strict=True):
            mode = _modes(file, each["dimensions"][1], each["shape"][1])
            stored.append((_variable(file, column, "f8", (*names, mode)), column, None))
        first = 0
        for pieces in gathered(data.pieces(), _ROWS):
            scalars = np.concatenate([scalars for scalars, _ in pieces])
            last = first + scalars.shape[0]
            for variable, column, place in stored:
                if place is None:
                    values = column.factor * np.concatenate([found[column.source] for _, found in pieces])
                elif column.labels is not None:
                    texts = [plain(column.labels[int(x)]) for x in scalars[:, place]]
                    values = np.array(texts, dtype=object)
                else:
                    values = column.factor * scalars[:, place]
                _fill(variable, values, boxes(first, last, shape), shape)
            first = last


def _variable(file: Any, column: SweepColumn, kind: Any, axes: tuple[str, ...]) -> Any:
    variable = file.createVariable(column.name, kind, axes, fill_value=None if kind is str else np.nan)
    if column.unit:
        variable.units = column.unit
    variable.long_name = plain(column.source)
    return variable


def _coordinate(file: Any, axis: SweepColumn, values: list[float]) -> None:
    variable = _variable(file, axis, "f8" if axis.labels is None else str, (axis.name,))
    if axis.labels is None:
        variable[:] = axis.factor * np.array(values)
    else:
        variable[:] = np.array([plain(axis.labels[int(x)]) for x in values], dtype=object)


def _modes(file: Any, name: str, count: int) -> str:
    """An axis of so many modes."""
    known = next(
        (key for key, axis in file.dimensions.items() if key.startswith(name) and axis.size == count), None
    )
    if known is not None:
        return str(known)
    axis = free(name, file.dimensions)
    file.createDimension(axis, count)
    number = file.createVariable(axis, "i4", (axis,))
    number[:] = np.arange(1, count + 1)
    return axis


def _fill(variable: Any, values: Any, parts: Iterator[Box], shape: tuple[int, ...]) -> None:
    at = 0
    for box in parts:
        size = tuple(
            1 if isinstance(part, int) else len(range(*part.indices(n)))
            for part, n in zip(box, shape, strict=True)
        )
        count = prod(size)
        kept = tuple(n for n, part in zip(size, box, strict=True) if not isinstance(part, int))
        variable[box] = values[at : at + count].reshape(*kept, *values.shape[1:])
        at += count


def boxes(first: int, last: int, shape: tuple[int, ...]) -> Iterator[Box]:
    """Points `first` to before `last` of a grid whose last axis varies fastest, as boxes in that order."""
    if first == last:
        return
    if len(shape) == 1:
        yield (slice(first, last),)
        return
    inner = prod(shape[1:])
    (begin, a), (end, b) = divmod(first, inner), divmod(last, inner)
    if begin == end:
        yield from ((begin, *box) for box in boxes(a, b, shape[1:]))
        return
    if a:
        yield from ((begin, *box) for box in boxes(a, inner, shape[1:]))
        begin += 1
    if begin < end:
        yield (slice(begin, end), *(slice(None),) * (len(shape) - 1))
    yield from ((end, *box) for box in boxes(0, b, shape[1:]))


@contextmanager
def _writing() -> Iterator[None]:
    """The library's own complaints, as of a full disk, as those of the operating system."""
    try:
        yield
    except RuntimeError as error:
        raise OSError(str(error)) from None
