"""All arrays of a sweep as one file that MATLAB, Octave and SciPy read, with names, units and axes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.export.matlab import struct_of_texts
from fosopt.export.sweep import SweepData
from fosopt.export.writing import ExportError, written_to
from fosopt.ops import Array

_ORDER = "one row per point; of a grid the last axis varies fastest"
_LARGEST = 2**31  # bytes of an array in MATLAB's format 5


def write_sweep_mat(data: SweepData, path: Path) -> None:
    """Write all arrays of a sweep, as `write_sweep_arrays` does.

    Raises
    ------
    ExportError
        If the file cannot be written, or an array is larger than the format allows.
    """
    for each in data.run["outputs"]:
        size = 8 * int(np.prod(each["shape"]))
        if size >= _LARGEST:
            raise ExportError(
                f"{path}: '{each['name']}' takes {size / 2**30:.3g} GiB, and an array of a MATLAB file holds less than "
                "2 GiB; write --format netcdf, which MATLAB reads with ncread"
            )
    with written_to(path) as temporary:
        write_sweep_arrays(data.run, _whole(data), temporary)


def _whole(data: SweepData) -> dict[str, Array]:
    """All points of each axis and output."""
    names, pieces = [each["name"] for each in data.sources], list(data.pieces())
    scalars = np.concatenate([np.zeros((0, len(names))), *(scalars for scalars, _ in pieces)])
    arrays = dict(zip(names, scalars.T, strict=True))
    for each in data.by_mode:
        nothing = np.zeros((0, each["shape"][1]))
        arrays[each["name"]] = np.concatenate([nothing, *(found[each["name"]] for _, found in pieces)])
    return arrays


def write_sweep_arrays(run: Mapping[str, Any], arrays: Mapping[str, Array], path: Path) -> None:
    """Write the arrays of a sweep, and ``about``, which says what they are.

    Fields of ``about``: `axes` and `outputs`, the names of variables in order; `sampling`; `shape`, points along each
    axis; `grid`, values along each axis of a grid; `units` and `names` of each variable; `labels` of ports, which stand
    as their place in it, from zero; `order` of the rows; `provenance`. All numbers are SI.

    Parameters
    ----------
    run
        What the sweep was, as in its ``sweep.json``.
    arrays
        By the names of axes and outputs in it.
    """
    from scipy.io import savemat

    entries = [*run["axes"], *run["outputs"]]
    name_of = {each["name"]: _variable(each["file"]) for each in entries}
    content: dict[str, Any] = {name: arrays[text] for text, name in name_of.items()}
    content["about"] = {
        "axes": _cells(name_of[each["name"]] for each in run["axes"]),
        "outputs": _cells(name_of[each["name"]] for each in run["outputs"]),
        "sampling": run["sampling"],
        "shape": np.array(run["shape"], dtype=float),
        "order": _ORDER,
        "units": {name_of[each["name"]]: each["unit"] or "-" for each in entries},
        "names": {name: text for text, name in name_of.items()},
        "grid": {
            name_of[each["name"]]: np.array(each["values"])
            for each in run["axes"]
            if each["values"] is not None
        },
        "labels": {name_of[each["name"]]: _cells(each["labels"]) for each in run["axes"] if each["labels"]},
        "provenance": struct_of_texts(run["provenance"]),
    }
    savemat(path, content, appendmat=False, long_field_names=True, do_compression=True, oned_as="column")


def _variable(file: str) -> str:
    """Name of a variable from that of an array's file: letters first, at most 63 of them."""
    return Path(file).stem[:63].lstrip("_0123456789")


def _cells(texts: Iterable[str]) -> Any:
    """A cell array of texts."""
    return np.array(list(texts), dtype=object)
