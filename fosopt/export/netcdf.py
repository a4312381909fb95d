"""A front as netCDF arrays with named axes and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fosopt.export.columns import (
    SI,
    about,
    column_of,
    column_units,
    encoded,
    front_columns,
    points,
    variable_column,
    variables,
)
from fosopt.export.writing import written_to


def write_netcdf(run: Mapping[str, Any], path: Path) -> None:
    """Write the points as netCDF variables over the axis ``point``.

    The columns are those of `export.columns.front_columns`, but a variable with groups is one matrix over ``point``
    and ``<variable>_group``, whose labels have the name of the axis. Every number has its ``units``; a missing one
    is NaN. Name and provenance of the run are global attributes.

    Parameters
    ----------
    run
        The run data.
    path
        The file to write, in netCDF's classic format with 64-bit offsets.

    Raises
    ------
    ExportError
        If the file cannot be written.
    """
    # SciPy takes a while to import, and only this needs it.
    import numpy as np
    from scipy.io import netcdf_file

    units, count = column_units(run), len(points(run))
    grouped = {name: matrix for name, matrix in variables(run).items() if name in run["labels"]}
    with written_to(path) as temporary, netcdf_file(temporary, "w", version=2) as file:
        for key, value in about(run).items():
            setattr(file, key, encoded(value))
        file.createDimension("point", count)

        def number(name: str, axes: tuple[str, ...], unit: str, values: Any) -> None:
            variable = file.createVariable(name, "f8", axes)
            variable.units = unit.encode()
            variable[:] = np.array(values, dtype=float).reshape(variable.shape)

        def text(name: str, axis: str, values: Sequence[object]) -> None:
            cells = [b"" if value is None else encoded(str(value)) for value in values]
            width = max(map(len, cells), default=1) or 1
            file.createDimension(f"{name}_length", width)
            variable = file.createVariable(name, "c", (axis, f"{name}_length"))
            variable[:] = np.array(cells, dtype=f"S{width}").view("S1").reshape(len(cells), width)

        for column in front_columns(run):
            if column.variable is not None:
                continue
            if column.kind == "text":
                text(column.name, "point", column.values)
            elif column.kind == "verdict":
                flag = file.createVariable(column.name, "b", ("point",))
                flag[:] = np.array(column.values, dtype="i1")
            else:
                number(column.name, ("point",), column.unit, column.values)
        for name, matrix in grouped.items():
            axis, stem = f"{name}_group", column_of(run, name)[0]
            labels = run["labels"][name]
            file.createDimension(axis, len(labels))
            text(axis, axis, labels)
            number(variable_column(run, name), ("point", axis), units.get(stem, SI), matrix)
