"""Results of a sweep on disk: arrays and a table that grow chunk by chunk and are valid at every moment."""

from __future__ import annotations

import csv
import os
import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from fosopt.errors import StudyError
from fosopt.export.sweep import sweep_cell
from fosopt.export.text import inert
from fosopt.ops import Array

_CELL = 24  # bytes of a number in the table, with its comma


class GrowingArray:
    """A ``.npy`` file of float64 that grows along its first axis.

    NumPy leaves room in a header for the first axis to grow, so that the header is written anew in place after each
    addition; readers always find a complete array.
    """

    def __init__(self, path: Path, width: int | None = None) -> None:
        self._shape = (width,) if width is not None else ()
        self._count = 0
        self._file = path.open("wb")
        self._header()
        self._start = self._file.tell()

    def append(self, values: Array) -> None:
        """Add (m,) or (m, width) values."""
        values = np.ascontiguousarray(values, dtype="<f8").reshape(-1, *self._shape)
        self._file.seek(0, os.SEEK_END)
        self._file.write(values.tobytes())
        self._file.flush()
        self._count += values.shape[0]
        self._file.seek(0)
        self._header()
        assert self._file.tell() == self._start

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _header(self) -> None:
        shape = (self._count, *self._shape)
        content = {"descr": "<f8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._file, content)
        self._file.flush()


class SweepFiles:
    """The files of a sweep under a run directory, made anew and written in the order of the points.

    Parameters
    ----------
    directory
        Where ``points.csv`` and ``arrays/`` are made.
    scalars
        Names of what has one value per point, axes first.
    head, factors
        Columns of the table and factors from SI.
    widths
        Columns of each array, by name.
    labels
        Texts a column of the table shows in place of its numbers, by name.
    origin
        Where the run came from, for the last column of the first row.
    """

    def __init__(
        self,
        directory: Path,
        scalars: Sequence[str],
        head: Sequence[str],
        factors: Sequence[float],
        widths: dict[str, int],
        labels: Mapping[str, Sequence[str]],
        origin: str,
    ) -> None:
        (directory / "arrays").mkdir(exist_ok=True)
        files = array_files((*scalars, *widths))
        self._scalars, self._factors, self._labels = tuple(scalars), np.array(factors), labels
        self._columns = [GrowingArray(directory / files[name]) for name in scalars]
        self._arrays = {name: GrowingArray(directory / files[name], n) for name, n in widths.items()}
        self._table = (directory / "points.csv").open(
            "w", encoding="utf-8", errors="backslashreplace", newline=""
        )
        self._writer = csv.writer(self._table, lineterminator="\n")
        self._writer.writerow([*head, "provenance"])
        self._origin = inert(origin)

    def append(self, scalars: Array, arrays: Mapping[str, Array]) -> None:
        """Add (m, s) values of all scalars and the rows of each array."""
        for column, values in zip(self._columns, scalars.T, strict=True):
            column.append(values)
        for name, values in arrays.items():
            self._arrays[name].append(values)
        texts = [self._labels.get(name) for name in self._scalars]
        for row in (scalars * self._factors).tolist():
            cells = (sweep_cell(x, names) for x, names in zip(row, texts, strict=True))
            self._writer.writerow([*cells, self._origin])
            self._origin = ""
        self._table.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for each in (*self._columns, *self._arrays.values()):
            each.close()
        self._table.close()


def array_files(names: Iterable[str]) -> dict[str, str]:
    """Path of each array inside the run directory; an expression is named by its letters and digits."""
    files: dict[str, str] = {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:60] or "output"
        same = sum(f.startswith(f"arrays/{plain}") for f in files.values())
        files[name] = (
            f"arrays/{plain}{f'__{same + 1}' if same and f'arrays/{plain}.npy' in files.values() else ''}.npy"
        )
    return files


def refuse_too_large(out: Path, count: int, scalars: int, widths: dict[str, int]) -> None:
    """Refuse a sweep whose results the disk has no room for.

    Raises
    ------
    StudyError
        With the size it would take.
    """
    # Once in the record, and once in the arrays.
    need = count * (scalars * (2 * 8 + _CELL) + 2 * 8 * sum(widths.values()))
    place = next(p for p in (out.absolute(), *out.absolute().parents) if p.exists())
    free = shutil.disk_usage(place).free
    if need > 0.95 * free:
        raise StudyError(
            f"the sweep of {count} points would take {size(need)} on a disk with {size(free)} free; "
            "take fewer points or fewer per-mode outputs, or another directory with --out"
        )


def size(bytes_: float) -> str:
    """A number of bytes for people, such as ``1.2 GiB``."""
    units = ("B", "KiB", "MiB", "GiB", "TiB", "PiB")
    power = min(int(np.log2(max(bytes_, 1)) // 10), len(units) - 1)
    return f"{bytes_ / 1024**power:.3g} {units[power]}"
