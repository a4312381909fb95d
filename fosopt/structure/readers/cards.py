"""Nastran bulk data as cards: free, small and large fields, and continuations.    [MscQrg2021] section Bulk Data"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from fosopt.structure.readers.common import bad, number, text_lines
from fosopt.units import quote

_SMALL, _LARGE = 8, 16
_PER_CARD_LINE = 8  # data fields of a small line; a large line has half as many


@dataclass(frozen=True)
class Card:
    """One bulk data entry.

    Attributes
    ----------
    file, line
        Where it begins.
    name
        In capitals, without the asterisk of large fields.
    fields
        Data fields from the second one on, blanks stripped.
    lines
        The line of each field.
    """

    file: Path
    line: int
    name: str
    fields: tuple[str, ...]
    lines: tuple[int, ...]

    def text(self, k: int, default: str = "") -> str:
        """Data field `k`, counted from one."""
        return (self.fields[k - 1] if k <= len(self.fields) else "") or default

    def integer(self, k: int, what: str, default: int | None = None) -> int:
        """Data field `k` as a whole number.

        Raises
        ------
        StudyError
            If it is none, or blank without a default.
        """
        text = self.text(k)
        if not text and default is not None:
            return default
        try:
            return int(text)
        except ValueError:
            message = f"{self.name}: {what} is {quote(text)}; give a whole number"
            raise bad(self.file, message, self._line(k)) from None

    def real(self, k: int, what: str, default: float | None = None) -> float:
        """Data field `k` as a number.

        Raises
        ------
        StudyError
            If it is none, or blank without a default.
        """
        text = self.text(k)
        if not text and default is not None:
            return default
        return number(self.file, text, f"{self.name}: {what}", self._line(k))

    def _line(self, k: int) -> int:
        return self.lines[k - 1] if k <= len(self.lines) else self.line


def read_cards(file: Path) -> Iterator[Card]:
    """Cards of a bulk data file, from BEGIN BULK if it has one up to ENDDATA.

    Raises
    ------
    StudyError
        For a file that cannot be read, an INCLUDE, or a continuation of nothing.
    """
    lines = text_lines(file)
    begin = next((k for k, line in enumerate(lines) if line.upper().split()[:2] == ["BEGIN", "BULK"]), -1)
    name, start, fields = "", 0, [("", 0)]
    for k, raw in enumerate(lines[begin + 1 :], begin + 2):
        line = raw.split("$", 1)[0].rstrip()
        if not line.strip():
            continue
        if line.upper().lstrip().startswith("INCLUDE"):
            raise bad(file, "INCLUDE is not followed; write the files into one", k)
        cells = _cells(file, line, k)
        head = cells[0].upper()
        if head == "ENDDATA":
            break
        if head and head[0] not in "+*":
            if name:
                yield _card(file, start, name, fields)
            name, start, fields = head.rstrip("*"), k, [(cell, k) for cell in cells[1:]]
            continue
        if not name:
            raise bad(file, "a continuation without a card before it; complete the file", k)
        fields += [(cell, k) for cell in cells[1:]]
    if name:
        yield _card(file, start, name, fields)


def _card(file: Path, start: int, name: str, fields: list[tuple[str, int]]) -> Card:
    texts, lines = zip(*fields, strict=True)
    return Card(file, start, name, texts, lines)


def _cells(file: Path, line: str, k: int) -> list[str]:
    """The name and the 8 small or 4 large fields of a line; what it leaves out at its end is blank."""
    if "," in line:
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) > _PER_CARD_LINE + 2:
            raise bad(
                file, f"{len(cells)} fields in a line; at most 10 are read: continue in the next line", k
            )
        full = 1 + _PER_CARD_LINE // (2 if "*" in cells[0] else 1)
        return (cells + [""] * full)[:full]
    line = line.expandtabs(_SMALL)
    width = _LARGE if "*" in line[:_SMALL] else _SMALL
    starts = range(_SMALL, _SMALL + _PER_CARD_LINE * _SMALL, width)
    return [line[:_SMALL].strip(), *(line[i : i + width].strip() for i in starts)]
