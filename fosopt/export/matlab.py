"""A front as MATLAB arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fosopt.export.columns import (
    EFFORT,
    TEXT,
    TEXT_AFTER,
    VERDICT,
    bounds,
    column_of,
    column_units,
    constraints,
    free,
    line_verdicts,
    listed,
    metrics,
    names,
    points,
    variables,
    words,
)
from fosopt.export.writing import written_to

_LONGEST_NAME = 63  # characters of a name in MATLAB


def write_mat(run: Mapping[str, Any], path: Path) -> None:
    """Write the points as MATLAB arrays with one row each, NaN where a value is missing.

    ``metrics``, ``bounds``, ``variables``, ``slack`` and ``multiplier`` are structs of arrays, ``objectives`` is a
    matrix with one column for each of ``objective_names``. ``labels`` names the groups of a variable, ``units``
    gives the unit by the name of a column, and ``provenance`` says where the run came from.

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

    rows, measured, designed = points(run), metrics(run), variables(run)

    def numbers(values: Sequence[object], columns: int = 1) -> Any:
        return np.array(values, dtype=float).reshape(len(rows), columns)

    def texts(values: Iterable[object]) -> Any:
        cells = ["" if value is None else str(value) for value in values]
        array = np.empty((len(cells), 1), dtype=object)
        array[:, 0] = cells
        return array

    objectives = [column_of(run, name)[0] for name in listed(run, "objectives")]
    columns = [measured.get(name, [None] * len(rows)) for name in objectives]
    units = column_units(run)
    named = dict.fromkeys(
        column_of(run, name)[0] for part in ("metrics", "variables") for name in names(run, part)
    )
    content = {
        "name": str(run["name"]),
        **{name: texts(row[name] for row in rows) for name in (*TEXT, *TEXT_AFTER)},
        **{name: np.array([[bool(row[name])] for row in rows], dtype=bool) for name in VERDICT},
        **{name: numbers([row[name] for row in rows]) for name in EFFORT},
        "objectives": numbers([*zip(*columns, strict=True)], len(columns)),
        "objective_names": texts(_field(name) for name in objectives),
        "metrics": _struct(measured, numbers),
        "bounds": _struct(bounds(run), numbers),
        "variables": _struct(
            {column_of(run, name)[0]: values for name, values in designed.items()},
            lambda values: numbers(values, len(values[0])),
        ),
        **{name: numbers(values) for name, values in line_verdicts(run).items()},
        "slack": _struct(constraints(run, "slack"), numbers),
        "multiplier": _struct(constraints(run, "multiplier"), numbers),
        "labels": _struct(
            {column_of(run, name)[0]: run["labels"][name] for name in designed if name in run["labels"]},
            texts,
        ),
        "units": _struct({name: units[name] for name in named if name in units}, str),
        "provenance": struct_of_texts(run["provenance"]),
    }
    with written_to(path) as temporary, temporary.open("wb") as stream:
        savemat(stream, content, long_field_names=True, do_compression=True)


def _field(name: str, taken: Iterable[str] = ()) -> str:
    """A name MATLAB takes."""
    plain = words(name)
    plain = plain if plain[:1].isalpha() else f"x_{plain}"
    return free(plain[: _LONGEST_NAME - 4], taken) if len(plain) > _LONGEST_NAME else free(plain, taken)


def struct_of_texts(values: Mapping[str, Any]) -> dict[str, str]:
    """A struct of texts under names that MATLAB takes."""
    return _struct(values, str)


def _struct(values: Mapping[str, Any], make: Callable[[Any], Any]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for name, value in values.items():
        fields[_field(name, fields)] = make(value)
    return fields
