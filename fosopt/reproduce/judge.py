"""Reproductions whose verdict follows from their rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fosopt.reproduce.entry import Comparison, Panel, Reproduction
from fosopt.reproduce.published import Printed

NOTHING_SAID = (
    "the figure is a picture that is not available, and the text says nothing about it that can be checked"
)


def agrees(row: Comparison) -> bool:
    """Whether a row's numbers agree to the printed digits, or its statements word by word; so does a row without."""
    printed, computed = row.published, row.computed
    if printed is None:
        return True
    if isinstance(printed, str) or isinstance(computed, str):
        return printed == computed
    decimals = len(printed.text.partition(".")[2]) if isinstance(printed, Printed) else 0
    return abs(computed - printed) <= 0.5 * 10**-decimals


def claim(what: str, said: str, holds: bool | np.bool_, otherwise: str, note: str = "") -> Comparison:
    """A statement of the text beside what the computation says to it."""
    return Comparison(what, said, said if holds else otherwise, note=note)


def judged(
    computed: str,
    rows: Sequence[Comparison],
    panels: Sequence[Panel] = (),
    columns: int = 1,
    *,
    differs: str = "",
    open_because: str = NOTHING_SAID,
) -> Reproduction:
    """A reproduction that matches when every row does, and cannot be determined when no row says what was published.

    Parameters
    ----------
    differs
        Why rows disagree; by default, which ones do.
    open_because
        Why nothing can be determined.
    """
    if all(row.published is None for row in rows):
        return Reproduction(computed, "not determinable", open_because, tuple(rows), tuple(panels), columns)
    apart = [row.what for row in rows if not agrees(row)]
    reason = (differs or f"not as published: {'; '.join(apart)}") if apart else ""
    return Reproduction(
        computed, "differs" if apart else "matches", reason, tuple(rows), tuple(panels), columns
    )
