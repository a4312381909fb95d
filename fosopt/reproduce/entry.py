"""What a reproduction of a published table or figure is: plain data, computed here, drawn elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fosopt.report.panels import Curve, Mark, Panel, Scale, Style

__all__ = [
    "Comparison",
    "Curve",
    "Entry",
    "Mark",
    "Panel",
    "Reproduction",
    "Scale",
    "Style",
    "Verdict",
]

Verdict = Literal["matches", "differs", "not determinable"]


@dataclass(frozen=True)
class Comparison:
    """A published number or statement beside the computed one.

    Attributes
    ----------
    what
        What is compared, such as ``FEM2, mode 3``.
    published
        As printed; None where the dissertation prints none.
    computed
        In the same unit, or the same kind of statement.
    unit
        Of both, empty for a statement or a pure number.
    note
        What a reader must know about this row.
    """

    what: str
    published: float | str | None
    computed: float | str
    unit: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        for name in ("published", "computed"):
            value = getattr(self, name)
            if isinstance(value, np.generic):
                object.__setattr__(self, name, value.item())
            if isinstance(value, (float, np.floating)) and not np.isfinite(value):
                raise ValueError(f"'{self.what}': {name} is {value}; say in words what it is")

    @property
    def relative_error(self) -> float | None:
        """Computed over published less one; None where either is no number or the published one is zero."""
        if isinstance(self.published, (int, float)) and isinstance(self.computed, (int, float)):
            return None if self.published == 0 else self.computed / self.published - 1
        return None


@dataclass(frozen=True)
class Reproduction:
    """A published table or figure, computed again.

    Attributes
    ----------
    computed
        What was computed, and with which parameters, in one or two sentences.
    verdict, reason
        How it compares, and why; the reason of a difference or of what cannot be determined is never empty.
    comparisons
        Numbers and statements side by side.
    panels, columns
        What is drawn, row by row, `columns` panels to a row.
    """

    computed: str
    verdict: Verdict
    reason: str
    comparisons: tuple[Comparison, ...] = ()
    panels: tuple[Panel, ...] = ()
    columns: int = 1

    def __post_init__(self) -> None:
        if self.verdict != "matches" and not self.reason:
            raise ValueError(f"verdict '{self.verdict}' without a reason; say why")


@dataclass(frozen=True)
class Entry:
    """A numbered table or figure of the dissertation.

    Attributes
    ----------
    name
        ``table-4.1`` or ``figure-3.20``.
    title
        Its caption, in our words.
    compute
        Computes it.
    """

    name: str
    title: str
    compute: Callable[[], Reproduction]
