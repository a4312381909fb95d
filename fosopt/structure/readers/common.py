"""What readers of foreign files share: errors with a place, names of degrees of freedom, and checks of numbers."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.errors import StudyError
from fosopt.ops import Array
from fosopt.structure.truss import ROTATIONS, TRANSLATIONS
from fosopt.units import quote

COMPONENTS = (*TRANSLATIONS, *ROTATIONS)
_SPELLED = {
    **{c: c for c in COMPONENTS},
    **{str(k): c for k, c in enumerate(COMPONENTS, 1)},
    **{f"{'t' if k < 4 else 'r'}{(k - 1) % 3 + 1}": c for k, c in enumerate(COMPONENTS, 1)},
}
LARGEST_TEXT = 512 * 1024**2
"""Size of the largest foreign text file that is read [bytes]."""


def bad(file: Path, message: str, line: int | None = None, column: int | None = None) -> StudyError:
    """An error in a foreign file, with line and column where it has lines."""
    return StudyError(message, file=file, line=line, column=column)


def file_bytes(file: Path) -> bytes:
    """Content of a file.

    Raises
    ------
    StudyError
        If it is missing, unreadable, empty or too large.
    """
    try:
        size = file.stat().st_size
        content = file.read_bytes() if size <= LARGEST_TEXT else b""
    except FileNotFoundError:
        raise bad(file, "no such file; check the path") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise bad(file, f"the file cannot be read: {reason}; check the path and permissions") from None
    if size > LARGEST_TEXT:
        raise bad(file, f"{size} bytes; at most {LARGEST_TEXT} are read: reduce the model first")
    if not content:
        raise bad(file, "the file is empty; export it again")
    return content


def text_lines(file: Path) -> list[str]:
    """Lines of a text file in UTF-8 or Latin-1.

    Raises
    ------
    StudyError
        As `file_bytes`, and for a file that is binary.
    """
    content = file_bytes(file)
    if b"\0" in content:
        raise bad(file, "the file is binary where text is expected; check the path and the format")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.splitlines()


def table_rows(file: Path) -> tuple[int, list[str], Iterator[tuple[int, list[str]]]]:
    """Line and cells of a CSV file's header, and its other rows with their lines; blank lines and # are passed over.

    Raises
    ------
    StudyError
        As `text_lines`, and for a file without a header or with a row of another length.
    """
    lines = [
        (k, line) for k, line in enumerate(text_lines(file), 1) if line.strip() and line.lstrip()[0] != "#"
    ]
    if not lines:
        raise bad(file, "the file has no header; begin with a line of column names")
    cells = [(k, [cell.strip() for cell in next(csv.reader([line]))]) for k, line in lines]
    header = cells[0][1]
    for k, name in enumerate(header):
        if name in header[:k]:
            raise bad(file, f"the column {quote(name)} stands twice; remove one", cells[0][0], k + 1)

    def rows() -> Iterator[tuple[int, list[str]]]:
        for line, row in cells[1:]:
            if len(row) != len(header):
                message = f"{len(row)} values where the header names {len(header)}; complete the row"
                raise bad(file, message, line)
            yield line, row

    return cells[0][0], header, rows()


def number(file: Path, cell: str, what: str, line: int, column: int | None = None) -> float:
    """A finite number of a text file, Fortran's exponents D and bare signs included.

    Raises
    ------
    StudyError
        If it is none.
    """
    try:
        value = float(cell)
    except ValueError:
        value = _fortran(cell)
    if not np.isfinite(value):
        raise bad(file, f"{what}: {quote(cell)} is no finite number; correct it", line, column)
    return value


def _fortran(cell: str) -> float:
    text = cell.strip().lower().replace("d", "e")
    for k in range(len(text) - 1, 0, -1):
        if text[k] in "+-" and (text[k - 1].isdigit() or text[k - 1] == "."):
            text = f"{text[:k]}e{text[k:]}"
            break
    try:
        return float(text)
    except ValueError:
        return float("nan")


def dof_name(file: Path, grid: object, component: object, line: int | None = None) -> str:
    """Name of a degree of freedom, such as ``101.rz``, of a grid and a component.

    The component is x, y, z, rx, ry or rz; or 1 to 6; or T1 to T3, R1 to R3; 0 of a scalar point counts as x.

    Raises
    ------
    StudyError
        For another component, or no grid.
    """
    name = str(grid).strip()
    key = str(component).strip().lower()
    known = "x" if key == "0" else _SPELLED.get(key)
    if known is None:
        raise bad(
            file,
            f"{quote(str(component))} is no component of grid {quote(name)}; use x, y, z, rx, ry, rz or 1 to 6",
            line,
        )
    if not name:
        raise bad(file, "a degree of freedom without a grid; name one", line)
    return f"{name}.{known}"


def split_dof(file: Path, text: str, line: int | None = None) -> str:
    """Name of a degree of freedom that is written as one text, such as ``101.6`` or ``tip.rz``.

    Raises
    ------
    StudyError
        If the text has no dot or no component behind it.
    """
    grid, dot, component = text.strip().rpartition(".")
    if not dot:
        raise bad(file, f"{quote(text)} is no degree of freedom; write grid.component such as 101.rz", line)
    return dof_name(file, grid, component, line)


def unique_dofs(file: Path, names: Sequence[str], lines: Sequence[int] | None = None) -> tuple[str, ...]:
    """The names, none of them twice.

    Raises
    ------
    StudyError
        For the second of two equal names.
    """
    seen: set[str] = set()
    for k, name in enumerate(names):
        if name in seen:
            line = None if lines is None else lines[k]
            raise bad(
                file, f"the degree of freedom '{name}' stands twice (position {k + 1}); remove one", line
            )
        seen.add(name)
    return tuple(names)


def real_array(file: Path, value: Any, what: str) -> Array:
    """A real, finite array of what a file holds under a name.

    Raises
    ------
    StudyError
        For complex or other values that are no numbers, and for those not finite.
    """
    try:
        array = np.asarray(value)
        if array.dtype == object:
            array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise bad(file, f"'{what}' is no regular array of numbers; correct its rows") from None
    if np.iscomplexobj(array):
        if np.any(array.imag):
            raise bad(file, f"'{what}' is complex; export real (undamped) modes and matrices")
        array = array.real
    if array.dtype.kind not in "fiub":
        raise bad(file, f"'{what}' holds {array.dtype} where numbers are expected; correct the file")
    array = array.astype(float)
    if not np.all(np.isfinite(array)):
        where = ", ".join(str(int(k) + 1) for k in np.argwhere(~np.isfinite(array))[0])
        raise bad(file, f"'{what}' is not finite at ({where}), counted from 1; correct the file")
    return array
