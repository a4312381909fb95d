"""Printed figures: panels of curves as PNG and SVG, in the style of a journal.

A panel is as wide as a column of a page, a wide one as both. The same panels give the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from textwrap import wrap
from typing import Any, Literal, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from fosopt.report.axes import set_scales
from fosopt.report.legends import add_legends
from fosopt.report.panels import Curve, Mark, Panel
from fosopt.report.typeset import as_mathtext

Format = Literal["png", "svg"]

COLUMN, PAGE = 3.4, 7.0
"""Widths of one and of two columns of a journal [in]."""

_TALLEST = 3.0  # panel with one scale for both axes [in]
# Points of a marker; a marker that stands for a point of data is larger than one at the end of a stem.
_MARKER, _DOT = 3.8, 2.2
_STYLE: dict[str, Any] = {
    # Both fonts come with matplotlib, so that every machine draws the same letters.
    "font.family": ["STIXGeneral", "DejaVu Serif"],
    "mathtext.fontset": "stix",
    "font.size": 8.5,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.labelpad": 2.5,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "axes.titlesize": 8.5,
    "axes.titlepad": 4,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.4,
    "legend.fontsize": 7.5,
    "legend.edgecolor": "none",
    "legend.framealpha": 1.0,
    "legend.fancybox": False,
    "legend.borderaxespad": 0.4,
    "legend.borderpad": 0.25,
    "legend.columnspacing": 1.4,
    "legend.handlelength": 2.4,
    "legend.labelspacing": 0.35,
    "lines.linewidth": 0.9,
    "lines.dash_capstyle": "butt",
    "xtick.labelsize": 7.5,
    "xtick.direction": "in",
    "xtick.top": True,
    "xtick.major.width": 0.5,
    "xtick.minor.width": 0.35,
    "xtick.major.size": 3,
    "xtick.minor.size": 1.6,
    "ytick.labelsize": 7.5,
    "ytick.direction": "in",
    "ytick.right": True,
    "ytick.major.width": 0.5,
    "ytick.minor.width": 0.35,
    "ytick.major.size": 3,
    "ytick.minor.size": 1.6,
    # A curve of many points is drawn piece by piece, or the rasterizer gives up.
    "agg.path.chunksize": 20_000,
    "savefig.dpi": 200,
    "svg.fonttype": "path",
    "svg.hashsalt": "fosopt",
}
# Okabe and Ito's colors, which color-blind readers tell apart; the dashes tell them apart on gray paper.
_COLORS = ("#1b1f24", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_SOLID, _DASHED, _DOTTED = "-", (0, (5, 1.8)), (0, (1.1, 1.3))
_DASHES: tuple[Any, ...] = (_SOLID, _DASHED, _DOTTED, (0, (7, 1.6, 1.2, 1.6)), (0, (2.6, 1.2)))
_NAMED: Mapping[str, Any] = {"dashed": _DASHED, "dotted": _DOTTED}
_GRAY = "#7b838d"
_METADATA: Mapping[Format, Mapping[str, None]] = {
    "png": {"Software": None},
    "svg": {"Creator": None, "Date": None, "Format": None, "Type": None},
}

_LAYOUT = ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03, wspace=0.02, hspace=0.02)  # [in], [in], [-], [-]

Look = tuple[str, Any]
"""Color and dash of a curve."""


@dataclass(frozen=True)
class Picture:
    """A figure as files.

    Attributes
    ----------
    width, height
        As printed [in].
    files
        Contents of a file by its format.
    """

    width: float
    height: float
    files: Mapping[Format, bytes]


def picture(panels: Sequence[Panel], columns: int = 1, formats: Iterable[Format] = ("png", "svg")) -> Picture:
    """A figure as files of these formats.

    Parameters
    ----------
    panels
        Drawn row by row.
    columns
        Panels to a row.
    """
    files: dict[Format, bytes] = {}
    with journal_style():
        figure = draw(panels, columns)
        for kind in formats:
            stream = io.BytesIO()
            figure.savefig(stream, format=kind, metadata=dict(_METADATA[kind]))
            files[kind] = stream.getvalue()
    width, height = figure.get_size_inches()
    return Picture(float(width), float(height), files)


@contextmanager
def journal_style() -> Iterator[None]:
    """Matplotlib set to the style of these figures, whatever the user's own settings are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        cast(Any, mpl.rcParams).update(_STYLE)
        yield


def draw(panels: Sequence[Panel], columns: int = 1) -> Figure:
    """The figure itself, in the style that is set."""
    cells = _cells(panels, columns)
    looks = _looks(panels)
    below = _sharing(panels, cells)
    width = COLUMN if columns == 1 and not any(panel.wide for panel in panels) else PAGE
    heights = _heights(panels, cells, below, width / columns)
    figure = Figure(figsize=(width, sum(heights)), layout=_LAYOUT)
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    for number, (panel, (row, column)) in enumerate(zip(panels, cells, strict=True)):
        axes = figure.add_subplot(grid[row, :] if panel.wide else grid[row, column])
        _panel(axes, panel, looks[number])
        if number in below:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel(as_mathtext(panel.x_label))
        left = panels[cells.index((row, column - 1))] if column and not panel.wide else None
        if left is None or left.y_label != panel.y_label:
            axes.set_ylabel(as_mathtext(panel.y_label))
    FigureCanvasAgg(figure)
    _LAYOUT.execute(figure)
    _break_labels(figure)
    add_legends(figure, lambda: _LAYOUT.execute(figure))
    # It is laid out once for all formats: each would do it again, which takes longer than to draw.
    figure.set_layout_engine("none")
    return figure


def _cells(panels: Sequence[Panel], columns: int) -> list[tuple[int, int]]:
    """Row and column of each panel; a wide one has a row of its own."""
    cells, row, column = [], 0, 0
    for panel in panels:
        if column and (panel.wide or column == columns):
            row, column = row + 1, 0
        cells.append((row, column))
        column = columns if panel.wide else column + 1
    return cells


def _sharing(panels: Sequence[Panel], cells: Sequence[tuple[int, int]]) -> set[int]:
    """Panels that need no labels at their abscissa because the next one below has the same, as in a Bode plot."""
    places = {cell: number for number, cell in enumerate(cells)}
    return {
        number
        for number, (row, column) in enumerate(cells)
        if (row + 1, column) in places
        and _abscissa(panels[number]) == _abscissa(panels[places[row + 1, column]])
    }


def _abscissa(panel: Panel) -> tuple[Any, ...]:
    """What two panels must have in common to share an abscissa."""
    values = np.concatenate([np.empty(0), *(np.asarray(curve.x, dtype=float) for curve in panel.curves)])
    finite = values[np.isfinite(values)]
    extent = (finite.min(), finite.max()) if finite.size and panel.x_range is None else None
    return panel.x_label, panel.x_scale, panel.x_range, panel.wide, panel.equal, extent


def _heights(
    panels: Sequence[Panel], cells: Sequence[tuple[int, int]], below: set[int], column: float
) -> list[float]:
    """Height of each row [in], where a column is that wide [in]."""
    rows: list[float] = [0.0] * (1 + max(row for row, _ in cells))
    for number, (row, _) in enumerate(cells):
        panel = panels[number]
        if panel.equal:
            height = _equal_height(panel, column)
        elif len(rows) == 1:
            height = 2.0 if panel.wide else 2.3
        else:
            height = 1.5 if number in below else 1.85
        rows[row] = max(rows[row], height)
    return rows


def _equal_height(panel: Panel, column: float) -> float:
    """Height of a panel that is as wide as its column allows and has one scale [in]."""
    labels = 0.45  # beside the axes, and about as much above and below them
    if panel.x_range is None or panel.y_range is None:
        return 0.8 * (column - labels) + labels
    (left, right), (low, high) = panel.x_range, panel.y_range
    return min((column - labels) * abs((high - low) / (right - left)), _TALLEST) + labels


def _looks(panels: Sequence[Panel]) -> list[list[Look]]:
    """Color and dash of every curve, panel by panel; the same label looks the same in all panels."""
    chosen = {_NAMED[curve.style] for panel in panels for curve in panel.curves if curve.style in _NAMED}
    dashes = [dash for dash in _DASHES if dash not in chosen]
    groups: list[_Looks] = []
    found = []
    for panel in panels:
        labels = {curve.label for curve in panel.curves if curve.label}
        # A panel that shares no label with another begins anew, with the plainest look.
        group = next((each for each in groups if labels & each.known.keys()), None)
        if group is None:
            group = _Looks(cycle(_COLORS), cycle(dashes), {})
            groups.append(group)
        found.append(group.of(panel.curves))
    return found


@dataclass(frozen=True)
class _Looks:
    """The looks of the labels that some panels share."""

    colors: Iterator[str]
    dashes: Iterator[Any]
    known: dict[str, Look]

    def of(self, curves: Iterable[Curve]) -> list[Look]:
        found, look = [], (_COLORS[0], _SOLID)
        for curve in curves:
            if curve.label:
                if curve.label not in self.known:
                    dash = next(self.dashes) if curve.style == "line" else _SOLID
                    self.known[curve.label] = next(self.colors), dash
                look = self.known[curve.label]
            found.append((look[0], _NAMED.get(curve.style, look[1])))
        return found


def _panel(axes: Axes, panel: Panel, looks: Sequence[Look]) -> None:
    set_scales(axes, panel)
    for curve, look in zip(panel.curves, looks, strict=True):
        _curve(axes, curve, look)
    dashes = cycle(_DASHES)
    dash = next(dashes)
    for number, mark in enumerate(panel.marks):
        if mark.label and number:
            dash = next(dashes)
        _mark(axes, mark, dash)
    axes.set_title(as_mathtext(panel.title))


def _break_labels(figure: Figure) -> None:
    """Break an ordinate's label that is longer than its axes before its unit, and a long title between words."""
    long = {
        axes.get_ylabel()
        for axes in figure.axes
        if axes.yaxis.label.get_window_extent().height > axes.bbox.height
    }
    for axes in figure.axes:
        if axes.get_ylabel() in long:
            axes.set_ylabel("\n[".join(axes.get_ylabel().rsplit(" [", 1)))
        text = axes.get_title()
        share = axes.title.get_window_extent().width / axes.bbox.width
        if share > 1:
            axes.set_title("\n".join(wrap(text, int(len(text) / share))))


def _curve(axes: Axes, curve: Curve, look: Look) -> None:
    color, dash = look
    marker = {"color": color, "linestyle": "none", "markersize": _MARKER, "markeredgewidth": 0.8}
    line: dict[str, Any]
    match curve.style:
        case "points":
            line = {**marker, "marker": "o", "markerfacecolor": "none"}
        case "squares":
            line = {**marker, "marker": "s", "markerfacecolor": "none"}
        case "crosses":
            line = {**marker, "marker": "x"}
        case "stems":
            foot = axes.get_ylim()[0] if axes.get_yscale() == "log" else 0.0
            axes.vlines(curve.x, foot, curve.y, color=color, linewidth=0.7)
            line = {**marker, "marker": "o", "markersize": _DOT}
        case _:
            line = {"color": color, "linestyle": dash}
    axes.plot(curve.x, curve.y, label=as_mathtext(curve.label) or None, **line)


def _mark(axes: Axes, mark: Mark, dash: Any) -> None:
    line: dict[str, Any] = {"color": _GRAY, "linestyle": dash, "linewidth": 0.6, "zorder": 1.5}
    label = as_mathtext(mark.label) or None
    if mark.x is not None:
        axes.axvline(mark.x, label=label, **line)
    if mark.y is not None:
        axes.axhline(mark.y, label=label if mark.x is None else None, **line)
