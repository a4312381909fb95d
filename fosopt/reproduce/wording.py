"""Numbers and verdicts as people read them, rounded so that every machine writes the same."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from math import floor, log10

from fosopt.reproduce.entry import Comparison, Reproduction
from fosopt.reproduce.published import Printed

VERDICTS = ("matches", "differs", "not determinable", "failed")
"""What an entry may come to; it failed if it raised an error."""

_DIGITS = 4  # a computed number shows at least as many, or the decimals of the printed one
_FIXED = 1e-3, 1e6  # outside them a number has a power of ten
_LARGE = 10.0  # relative errors above it are factors


def heading(name: str) -> str:
    """``Figure 3.20`` for ``figure-3.20``."""
    return name.replace("-", " ").capitalize()


def verdict(result: Reproduction | None) -> str:
    """One of `VERDICTS`."""
    return "failed" if result is None else result.verdict


def counts(results: Iterable[Reproduction | None]) -> dict[str, int]:
    """How many results have each verdict."""
    found = Counter(map(verdict, results))
    return {each: found[each] for each in VERDICTS}


def sentence(found: Mapping[str, int]) -> str:
    """Counts of verdicts in words."""
    plural = {"matches": ("matches", "match"), "differs": ("differs", "differ")}
    plural |= {"not determinable": ("is not determinable", "are not determinable"), "failed": ("failed",) * 2}
    parts = [f"{number} {plural[each][number != 1]}" for each, number in found.items() if number]
    return ", ".join(parts) or "nothing was computed"


def prose(text: str) -> str:
    """A text that stands alone: it opens with a capital, unless with a symbol, and ends with a stop."""
    plain = " ".join(text.split())
    if plain[:2].isascii() and plain[:2].isalpha():
        plain = plain[0].upper() + plain[1:]
    return plain if not plain or plain.endswith((".", "!", "?")) else f"{plain}."


def published(row: Comparison) -> str:
    """The published side of a row, in the digits of the print."""
    value = row.published
    if value is None:
        return "–"
    return value.text if isinstance(value, Printed) else _number(value, 0)


def computed(row: Comparison) -> str:
    """The computed side of a row."""
    printed = row.published.text if isinstance(row.published, Printed) else ""
    return _number(row.computed, 0 if "e" in printed.lower() else len(printed.partition(".")[2]))


def error(row: Comparison) -> str:
    """The relative error of a row in percent, or as a factor where it is large; empty where there is none."""
    relative = row.relative_error
    if relative is None:
        return ""
    if relative > _LARGE:
        return f"×{_number(relative + 1, 0)}"
    percent = round(100 * relative, 2)
    return f"{percent:+.2f} %".replace("-", "−") if percent else "0.00 %"


def columns(rows: Sequence[Comparison]) -> dict[str, list[str]]:
    """Rows as columns of text by their titles, without those that all rows leave empty."""
    every = {
        "Quantity or statement": [row.what for row in rows],
        "Published": [published(row) for row in rows],
        "Computed": [computed(row) for row in rows],
        "Unit": [row.unit for row in rows],
        "Relative error": [error(row) for row in rows],
        "Note": [row.note for row in rows],
    }
    return {title: cells for title, cells in every.items() if any(cells)}


def numeric(title: str, rows: Iterable[Comparison]) -> bool:
    """Whether a column of such rows holds a number."""
    sides = {"Published": "published", "Computed": "computed", "Relative error": "relative_error"}
    return title in sides and any(isinstance(getattr(row, sides[title]), int | float) for row in rows)


def _number(value: float | str, decimals: int) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, int) or value == 0:
        return f"{value:.{decimals}f}" if isinstance(value, float) else str(value)
    if not _FIXED[0] <= abs(value) < _FIXED[1]:
        digits, power = f"{value:.{_DIGITS - 1}e}".split("e")
        return f"{digits} × 10^{{{int(power)}}}".replace("-", "−")
    needed = _DIGITS - 1 - floor(log10(abs(value)))
    return f"{value:.{max(decimals, needed, 0)}f}".replace("-", "−")
