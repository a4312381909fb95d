"""What a printed figure shows, as plain data: curves on axes, drawn by ``fosopt.report.figures``.

Labels are plain text. A single letter, with an accent or without, takes a subscript after ``_`` and a superscript
after ``^``, in braces where they are more than a word: ``θ_m``, ``J̄_k``, ``10^{-3}``, ``[kg m^2]``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fosopt.ops import Array

Style = Literal["line", "dashed", "dotted", "points", "crosses", "squares", "stems"]
Scale = Literal["linear", "log"]


@dataclass(frozen=True)
class Curve:
    """One curve of a panel.

    Curves with the same label look the same in all panels of a figure. A curve without a label continues the one
    before it, as the branches of a root locus do.

    Attributes
    ----------
    x, y
        (m,) in the units the panel's labels name; not a number where the curve has a gap.
    label
        For the legend; empty for none.
    style
        How it is drawn. On a map, crosses are poles, points zeros and squares the poles of a closed loop.
    """

    x: Array
    y: Array
    label: str = ""
    style: Style = "line"

    def __post_init__(self) -> None:
        x, y = np.shape(self.x), np.shape(self.y)
        if x != y or len(x) != 1:
            raise ValueError(
                f"curve '{self.label}': abscissas {x} and ordinates {y}; give two vectors of one length"
            )
        if np.iscomplexobj(self.x) or np.iscomplexobj(self.y):
            raise ValueError(f"curve '{self.label}' is complex; give its magnitude, phase or parts")


@dataclass(frozen=True)
class Mark:
    """A reference line across a panel: at `x` or at `y`, whichever is given.

    One without a label looks like the one before it.
    """

    label: str = ""
    x: float | None = None
    y: float | None = None


@dataclass(frozen=True)
class Panel:
    """One set of axes.

    Attributes
    ----------
    x_label, y_label
        With units in brackets.
    x_range, y_range
        None for what the curves need.
    equal
        Whether both axes have the same scale, as a map of poles may want.
    wide
        Whether it takes a whole row of the figure, and both columns of a journal's page.
    """

    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    title: str = ""
    x_scale: Scale = "linear"
    y_scale: Scale = "linear"
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    marks: tuple[Mark, ...] = ()
    equal: bool = False
    wide: bool = False
