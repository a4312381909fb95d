"""Entries that compute nothing: a figure, a table with a figure, a table, one that fails, one that cannot be drawn."""

from __future__ import annotations

import numpy as np

from fosopt.reproduce.catalogue import joined
from fosopt.reproduce.entry import Comparison, Curve, Entry, Mark, Panel, Reproduction
from fosopt.reproduce.published import Printed

HOSTILE = "<script>alert(1)</script>"
X = np.array([1.0, 10.0, 100.0])


def panel(**changes) -> Panel:
    """Two curves, one of them in two branches."""
    curves = (
        Curve(X, X, "plant, θ_m"),
        Curve(X, 2 * X, "loop", "dashed"),
        Curve(X, np.array([3.0, np.nan, 9.0])),
    )
    options = {"x_scale": "log", "marks": (Mark("0 dB", y=0.0),), **changes}
    return Panel("frequency [Hz]", "gain [dB]", curves, **options)


def figure() -> Reproduction:
    """Matches, in a number and in words."""
    rows = (
        Comparison("crossover", Printed("230.00"), 230.004, "Hz"),
        Comparison("stability", "stable", "stable"),
        Comparison("lowest zero", None, 6.9, "Hz", "not printed"),
    )
    return Reproduction("Two curves.", "matches", "", rows, (panel(), panel(x_scale="linear")))


def table_with_figure() -> Reproduction:
    """Differs, with a figure that says why."""
    rows = (
        Comparison("force, J_m = 2 %", Printed("0.0621"), 5.5, "µdu", "see | the *figure*"),
        Comparison("noise", Printed("50.000"), 49.9989, "µdu"),
    )
    return Reproduction("Jitter.", "differs", f"Because of x_0 {HOSTILE}.", rows, (panel(wide=True),))


def table() -> Reproduction:
    """Cannot be determined."""
    return Reproduction(HOSTILE, "not determinable", "Nothing is printed.", (Comparison("rows", None, 3),))


def failing() -> Reproduction:
    """Fails."""
    raise ValueError(f"no such mode {HOSTILE}")


def undrawable() -> Reproduction:
    """Computes what matplotlib cannot draw: an axis of negative numbers only, from a to a."""
    return Reproduction("x", "matches", "", (), (panel(x_range=(np.nan, 1.0)),))


FIGURE = Entry("figure-3.20", f"A figure of θ_m(jω) {HOSTILE}", figure)
TABLE_WITH_FIGURE = Entry("table-4.1", "A table", table_with_figure)
TABLE = Entry("table-3.3", "Another table", table)
FAILING = Entry("figure-2.12", "A failure", failing)
UNDRAWABLE = Entry("figure-2.13", "A failure to draw", undrawable)
SOUND = joined([TABLE_WITH_FIGURE, FIGURE, TABLE])
ALL = joined([*SOUND.values(), FAILING, UNDRAWABLE])
