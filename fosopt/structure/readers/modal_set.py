"""Modal sets in .npz, .mat, JSON and CSV files: frequencies, damping, shapes and residual flexibility."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io

from fosopt.errors import did_you_mean
from fosopt.ops import Array
from fosopt.structure.readers.common import (
    bad,
    dof_name,
    file_bytes,
    number,
    real_array,
    split_dof,
    table_rows,
    unique_dofs,
)
from fosopt.units import quote

_KEYS = ("frequency_hz", "mode_shape", "dofs", "damping_ratio", "modal_mass", "residual_flexibility")
_COLUMNS = ("frequency_hz", "damping_ratio", "modal_mass")


@dataclass(frozen=True)
class ModalFile:
    """What a file says of modes, in the units of the file.

    Shapes: p degrees of freedom, n modes.

    Attributes
    ----------
    file
        Where it was read.
    frequency_hz
        (n,) [Hz].
    mode_shape
        (p, n) one column per mode.
    dofs
        (p,) names such as ``101.rz``.
    damping_ratio, modal_mass
        (n,) if the file has them.
    residual_flexibility
        (p, p) static flexibility of the modes the file leaves out, if it has one.
    """

    file: Path
    frequency_hz: Array
    mode_shape: Array
    dofs: tuple[str, ...]
    damping_ratio: Array | None = None
    modal_mass: Array | None = None
    residual_flexibility: Array | None = None

    def __post_init__(self) -> None:
        n, p = self.frequency_hz.size, len(self.dofs)
        if self.frequency_hz.ndim != 1 or n == 0:
            raise bad(self.file, f"'frequency_hz' has the shape {self.frequency_hz.shape}; give one per mode")
        if np.any(self.frequency_hz < 0):
            k = int(np.argmin(self.frequency_hz))
            raise bad(
                self.file,
                f"mode {k + 1}: frequency {self.frequency_hz[k]:g} Hz is negative; write zero for a rigid-body mode",
            )
        if self.mode_shape.shape != (p, n):
            hint = "transpose it" if self.mode_shape.shape == (n, p) else "correct the file"
            raise bad(
                self.file,
                f"'mode_shape' has the shape {self.mode_shape.shape}; expected ({p}, {n}), one row per degree of "
                f"freedom and one column per mode: {hint}",
            )
        for name, least in (("damping_ratio", 0.0), ("modal_mass", np.finfo(float).tiny)):
            values = getattr(self, name)
            if values is None:
                continue
            if values.shape != (n,):
                raise bad(
                    self.file, f"'{name}' has the shape {values.shape}; give one value for each of {n} modes"
                )
            if np.any(values < least):
                k = int(np.argmin(values))
                rule = "zero or more" if least == 0 else "above zero"
                raise bad(self.file, f"mode {k + 1}: {name} {values[k]:g} is not {rule}; correct it")
        residual = self.residual_flexibility
        if residual is not None and residual.shape != (p, p):
            raise bad(
                self.file,
                f"'residual_flexibility' has the shape {residual.shape}; expected ({p}, {p}), in the order of 'dofs'",
            )


def read_modal_set(file: Path) -> ModalFile:
    """A modal set of a file with the ending .npz, .mat, .json or .csv.

    The first three hold arrays of the names `frequency_hz`, `mode_shape` (one row per degree of freedom, one column
    per mode), `dofs` (text such as ``101.rz``, or rows of grid and component) and, where known, `damping_ratio`,
    `modal_mass` (one where missing) and `residual_flexibility`. A CSV file has a row per mode under the header
    ``frequency_hz,damping_ratio,modal_mass,<grid>.<component>,...``; rows that begin with the name of a degree of
    freedom hold the rows of the residual flexibility.

    Raises
    ------
    StudyError
        For a file that is missing, truncated or of another format, and for values that are not what they should be.
    """
    match file.suffix.lower():
        case ".csv":
            return _csv(file)
        case ".json":
            return _arrays(file, _json(file))
        case ".npz":
            return _arrays(file, numpy_archive(file))
        case ".mat":
            return _arrays(file, matlab_file(file))
    raise bad(file, f"{quote(file.suffix)} is no format of a modal set; use .npz, .mat, .json, .csv or .pch")


def numpy_archive(file: Path) -> dict[str, Any]:
    """Arrays of an .npz file by name.

    Raises
    ------
    StudyError
        If it is missing, truncated or holds Python objects.
    """
    content = file_bytes(file)
    try:
        with np.load(BytesIO(content), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (zipfile.BadZipFile, EOFError, OSError, ValueError, KeyError, AttributeError) as error:
        if "allow_pickle" in str(error):
            raise bad(
                file, "the archive holds Python objects; save arrays of numbers and text only"
            ) from None
        raise bad(file, f"truncated or no .npz archive ({error}); write it again with numpy.savez") from None


def matlab_file(file: Path) -> dict[str, Any]:
    """Variables of a .mat file by name.

    Raises
    ------
    StudyError
        If it is missing, truncated, or of version 7.3.
    """
    content = file_bytes(file)
    try:
        found = io.loadmat(BytesIO(content))
    except NotImplementedError:
        raise bad(file, "a .mat file of version 7.3; save it with -v7") from None
    except Exception as error:  # a third-party parser may fail in its own ways on broken bytes
        reason = " ".join(str(error).split()) or type(error).__name__
        raise bad(file, f"truncated or no .mat file ({reason}); save it again with -v7") from None
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _json(file: Path) -> dict[str, Any]:
    content = file_bytes(file)
    try:
        found = json.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise bad(file, f"byte {error.start + 1} is not UTF-8; save the file as UTF-8") from None
    except json.JSONDecodeError as error:
        message = f"truncated or broken JSON: {error.msg}; write the file again"
        raise bad(file, message, error.lineno, error.colno) from None
    except RecursionError:
        raise bad(file, "nested too deep; write the arrays at the top") from None
    if not isinstance(found, dict):
        raise bad(file, f"the top is no object; write one with the keys {', '.join(_KEYS)}", 1)
    return found


def _arrays(file: Path, found: Mapping[str, Any]) -> ModalFile:
    for name in found:
        if name not in _KEYS:
            raise bad(file, f"unknown array {quote(name)}; {did_you_mean(name, _KEYS)}")
    for name in _KEYS[:3]:
        if name not in found:
            raise bad(file, f"the array '{name}' is missing; add it")
    arrays = {name: real_array(file, value, name) for name, value in found.items() if name != "dofs"}
    vectors = {name: np.atleast_1d(arrays[name].squeeze()) for name in _COLUMNS if name in arrays}
    shape = arrays["mode_shape"]
    return ModalFile(
        file,
        vectors["frequency_hz"],
        shape if shape.ndim == 2 else np.atleast_2d(shape),
        unique_dofs(file, dof_names(file, found["dofs"])),
        vectors.get("damping_ratio"),
        vectors.get("modal_mass"),
        arrays.get("residual_flexibility"),
    )


def dof_names(file: Path, value: Any) -> list[str]:
    """Names of degrees of freedom from a list of texts, or of rows of grid and component.

    Raises
    ------
    StudyError
        For anything else.
    """
    array = np.asarray(value, dtype=object)
    if array.ndim == 2 and array.shape[1] == 2 and array.shape[0] != 1:
        return [dof_name(file, _plain(grid), _plain(component)) for grid, component in array]
    texts = [_plain(each) for each in array.ravel()]
    if not texts or not all(isinstance(each, str) for each in texts):
        raise bad(file, "'dofs' holds no names; give texts such as 101.rz, or rows of grid and component")
    return [split_dof(file, str(each)) for each in texts]


def _plain(value: Any) -> object:
    """Text or a whole number, out of the arrays of one that MATLAB's cells become."""
    while isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    if isinstance(value, bytes):
        return value.decode("latin-1")
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def _csv(file: Path) -> ModalFile:
    first, header, rows = table_rows(file)
    if header[0] != "frequency_hz":
        raise bad(
            file,
            f"the first column is {quote(header[0])}; write the header frequency_hz,damping_ratio,<grid>.<component>",
            first,
            1,
        )
    columns = {name: header.index(name) for name in _COLUMNS if name in header}
    places = [k for k, name in enumerate(header) if name not in columns]
    dofs = unique_dofs(file, [split_dof(file, header[k], first) for k in places], [first] * len(places))
    modes: list[list[float]] = []
    residual = np.zeros((len(dofs), len(dofs)))
    filled: set[str] = set()
    for line, row in rows:
        if row[0][-1:] in "xyz":  # the name of a degree of freedom
            name = split_dof(file, row[0], line)
            if name not in dofs:
                raise bad(file, f"'{name}' has no column; {did_you_mean(name, dofs)}", line, 1)
            if name in filled:
                raise bad(file, f"the residual flexibility of '{name}' stands twice; remove one", line, 1)
            filled.add(name)
            residual[dofs.index(name)] = [number(file, row[k], header[k], line, k + 1) for k in places]
            continue
        modes.append([number(file, cell, header[k], line, k + 1) for k, cell in enumerate(row)])
    if not modes:
        raise bad(file, "no row of a mode under the header; add one per mode")
    if filled and len(filled) < len(dofs):
        missing = next(name for name in dofs if name not in filled)
        raise bad(
            file, f"the residual flexibility has no row of '{missing}'; give one for each of {len(dofs)}"
        )
    table = np.array(modes)
    found = {name: table[:, k] for name, k in columns.items()}
    return ModalFile(
        file,
        found["frequency_hz"],
        table[:, places].T,
        dofs,
        found.get("damping_ratio"),
        found.get("modal_mass"),
        residual if filled else None,
    )
