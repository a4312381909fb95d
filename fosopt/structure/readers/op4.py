"""Nastran OUTPUT4 files: text and binary, either byte order, 32- and 64-bit, dense and both sparse forms.

A matrix is a header (columns, rows, form, type, name) and one record per column that is not empty: the column, the
first row (0 marks a sparse column), the number of words, and the values. A sparse column is a run of strings, each
behind a word that packs its length and first row, or behind two words where rows do not fit (BIGMAT). A column
beyond the last one ends the matrix.    [MscDmap2021] module OUTPUT4
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fosopt.errors import StudyError
from fosopt.ops import Array
from fosopt.structure.readers.common import bad, file_bytes
from fosopt.units import quote

_PACKED = 65536  # rows below this fit beside a string's length into one word
_FORMAT = re.compile(r"(\d+)[EDed](\d+)\.(\d+)")
_MOST_ROWS = 10_000_000


def read_op4(file: Path) -> dict[str, sparse.csc_array]:
    """Matrices of an OUTPUT4 file by name, in capitals.

    Raises
    ------
    StudyError
        For a file that is missing, truncated, or has a record of a wrong length, and for a complex matrix.
    """
    content = file_bytes(file)
    for order in "<>":
        if len(content) >= 4 and struct.unpack(f"{order}i", content[:4])[0] in (24, 48):
            return dict(_binary(file, content, order))
    if b"\0" in content:
        raise bad(
            file, "no OUTPUT4 file: record 1 is not of 24 or 48 bytes; check the path, or export it again"
        )
    return dict(_text(file, content.decode("latin-1").splitlines()))


@dataclass
class _Columns:
    """What has been read of one matrix."""

    file: Path
    name: str
    shape: tuple[int, int]
    where: str

    def __post_init__(self) -> None:
        rows, columns = self.shape
        if not (0 < columns <= _MOST_ROWS and 0 < rows <= _MOST_ROWS):
            raise bad(
                self.file, f"{self.where}: {rows} rows and {columns} columns are no matrix; export it again"
            )
        self.row: list[NDArray[np.int64]] = []
        self.column: list[NDArray[np.int64]] = []
        self.value: list[Array] = []

    def add(self, column: int, first: int, values: Array, where: str, line: int | None = None) -> None:
        rows, columns = self.shape
        if not (0 < column <= columns and first > 0 and first - 1 + values.size <= rows):
            raise bad(
                self.file,
                f"{where}: rows {first} to {first - 1 + values.size} of column {column} leave the {rows} x {columns} "
                f"matrix {self.name}; the file is damaged, export it again",
                line,
            )
        if not np.all(np.isfinite(values)):
            at = first + int(np.argmin(np.isfinite(values)))
            raise bad(
                self.file, f"{where}: {self.name}({at}, {column}) is not finite; correct the model", line
            )
        self.row.append(np.arange(first - 1, first - 1 + values.size, dtype=np.int64))
        self.column.append(np.full(values.size, column - 1, dtype=np.int64))
        self.value.append(values)

    def matrix(self) -> sparse.csc_array:
        if not self.value:
            return sparse.csc_array(self.shape)
        places = np.concatenate(self.row), np.concatenate(self.column)
        return sparse.csc_array(sparse.coo_array((np.concatenate(self.value), places), shape=self.shape))


def _refuse_type(file: Path, name: str, kind: int, where: str, line: int | None = None) -> None:
    if kind in (3, 4):
        raise bad(file, f"{where}: {name} is complex; export the real stiffness and mass", line)
    if kind not in (1, 2):
        raise bad(
            file, f"{where}: {name} has the type {kind}, which is none of 1 to 4; export it again", line
        )


# ---- binary ----


def _records(file: Path, content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Number and content of each record between its two lengths."""
    at, count = 0, 0
    while at < len(content):
        count += 1
        if at + 4 > len(content):
            raise bad(file, f"record {count}: the file is truncated in its length; export it again")
        size = struct.unpack_from(f"{order}i", content, at)[0]
        if size < 0 or at + 8 + size > len(content):
            left = len(content) - at - 4
            raise bad(
                file,
                f"record {count}: {size} bytes announced and {left} left; the file is truncated or damaged, export it "
                "again",
            )
        end = struct.unpack_from(f"{order}i", content, at + 4 + size)[0]
        if end != size:
            raise bad(
                file,
                f"record {count}: length {size} at its start and {end} at its end; the file is damaged, or was "
                "transferred as text",
            )
        yield count, content[at + 4 : at + 4 + size]
        at += 8 + size


def _binary(file: Path, content: bytes, order: str) -> Iterator[tuple[str, sparse.csc_array]]:
    records = _records(file, content, order)
    for count, head in records:
        where = f"record {count}"
        if len(head) not in (24, 48):
            raise bad(file, f"{where}: {len(head)} bytes where a matrix begins; 24 or 48 are expected")
        word = len(head) // 6  # bytes
        integer, single = ("i", "f4") if word == 4 else ("q", "f8")
        columns, rows, _, kind = struct.unpack_from(f"{order}4{integer}", head)
        name = head[4 * word :].decode("latin-1").replace("\0", " ").replace(" ", "").upper()
        _refuse_type(file, name, kind, where)
        found = _Columns(file, name, (abs(rows), columns), where)
        big = rows < 0 or rows >= _PACKED
        real = np.dtype(order + ("f8" if kind == 2 else single))
        per_value = real.itemsize // word
        for count, body in records:
            where = f"record {count}"
            if len(body) < 3 * word or len(body) % word:
                raise bad(file, f"{where}: {len(body)} bytes are no column of {name}; export the file again")
            column, first, words = struct.unpack_from(f"{order}3{integer}", body)
            if len(body) != (3 + words) * word:
                raise bad(
                    file,
                    f"{where}: wrong record length, {len(body)} bytes where column {column} of {name} announces "
                    f"{(3 + words) * word}; export the file again",
                )
            if column > columns:
                break
            if first > 0:
                if words % per_value:
                    raise bad(file, f"{where}: {words} words are no whole number of values of {name}")
                found.add(column, first, np.frombuffer(body, real, offset=3 * word).astype(float), where)
                continue
            at = 3 * word
            while at < len(body):
                if big:
                    size, row = (
                        struct.unpack_from(f"{order}2{integer}", body, at)
                        if at + 2 * word <= len(body)
                        else (0, 0)
                    )
                    at, size = at + 2 * word, size - 1
                else:
                    packed = struct.unpack_from(f"{order}{integer}", body, at)[0]
                    at, size = at + word, packed // _PACKED - 1
                    row = packed - _PACKED * (size + 1)
                end = at + size * word
                if size <= 0 or size % per_value or end > len(body):
                    raise bad(
                        file, f"{where}: a string of {size} words does not fit column {column} of {name}"
                    )
                found.add(column, row, np.frombuffer(body[at:end], real).astype(float), where)
                at = end
        else:
            raise bad(file, f"the file ends within {name}, after record {count}: truncated; export it again")
        yield name, found.matrix()


# ---- text ----


class _Lines:
    """Lines of a text file, read one by one."""

    def __init__(self, file: Path, lines: list[str]) -> None:
        self.file, self.lines, self.at = file, lines, 0

    def next(self, name: str) -> str:
        if self.at >= len(self.lines):
            raise bad(self.file, f"the file ends within {name}: truncated; export it again", len(self.lines))
        self.at += 1
        return self.lines[self.at - 1]

    def integers(self, name: str, count: int) -> list[int]:
        line = self.next(name)
        try:
            return [int(line[8 * k : 8 * k + 8]) for k in range(count)]
        except ValueError:
            raise self.bad(
                f"{quote(line[: 8 * count])} are no {count} whole numbers of 8 characters each"
            ) from None

    def packed(self, name: str) -> int:
        line = self.next(name)
        try:
            return int(line)
        except ValueError:
            raise self.bad(f"{quote(line)} is no whole number that begins a string of {name}") from None

    def values(self, name: str, count: int, per_line: int, width: int) -> Array:
        cells: list[str] = []
        while len(cells) < count:
            line = self.next(name)
            take = min(per_line, count - len(cells))
            cells += [line[width * k : width * k + width] for k in range(take)]
            try:
                float(cells[-1].replace("D", "E"))
            except ValueError:
                raise self.bad(
                    f"{quote(line[:60])} holds no {take} numbers of {width} characters; truncated or damaged"
                ) from None
        try:
            return np.array([float(cell.replace("D", "E")) for cell in cells])
        except ValueError:
            raise self.bad(f"a value of {name} above is no number; export the file again") from None

    def bad(self, message: str) -> StudyError:
        return bad(self.file, message, self.at)


def _text(file: Path, content: list[str]) -> Iterator[tuple[str, sparse.csc_array]]:
    lines = _Lines(file, content)
    while lines.at < len(content) and content[lines.at].strip():
        head = content[lines.at]
        columns, rows, _, kind = lines.integers("the header", 4)
        name = head[32:40].replace(" ", "").upper()
        layout = _FORMAT.search(head[40:])
        per_line, width = (int(layout[1]), int(layout[2])) if layout else (5, 16)
        _refuse_type(file, name, kind, "header", lines.at)
        found = _Columns(file, name, (abs(rows), columns), f"line {lines.at}")
        big = rows < 0 or rows >= _PACKED
        per_value = kind  # words
        while True:
            column, first, words = lines.integers(name, 3)
            where = f"column {column}"
            if column > columns:
                lines.values(name, 1, per_line, width)
                break
            if words < 0:
                raise lines.bad(f"{where}: {words} words; the file is damaged, export it again")
            if first > 0:
                start = lines.at
                found.add(column, first, lines.values(name, words, per_line, width), where, start)
                continue
            while words > 0:
                if big:
                    size, row = lines.integers(name, 2)
                    words, size = words - 2, size - 1
                else:
                    packed = lines.packed(name)
                    size = packed // _PACKED - 1
                    words, row = words - 1, packed - _PACKED * (size + 1)
                if size <= 0 or size % per_value or size > words:
                    raise lines.bad(
                        f"a string of {size} words does not fit {where} of {name}; export the file again"
                    )
                start = lines.at
                found.add(column, row, lines.values(name, size // per_value, per_line, width), where, start)
                words -= size
        yield name, found.matrix()
    if not lines.at:
        raise bad(file, "no OUTPUT4 file: the first line is blank", 1)
