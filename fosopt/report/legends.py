"""Legends that never cover a curve: in a corner where nothing is drawn, or above the panel."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.transforms import Bbox

_PLACES: tuple[Literal["upper right", "lower left", "upper left", "lower right"], ...] = (
    "upper right",
    "lower left",
    "upper left",
    "lower right",
)
_MOST_TOGETHER = 6
_CLEAR = 2.5  # between a legend and a curve [pt]


def add_legends(figure: Figure, lay_out: Callable[[], None]) -> None:
    """One legend for all panels where they share names, and these are few; else one for each.

    Parameters
    ----------
    figure
        Laid out without legends.
    lay_out
        Lays it out again.
    """
    named = [(axes, _handles(axes)) for axes in figure.axes if _handles(axes)]
    together = {label: handle for _, handles in named for label, handle in handles.items()}
    shared = len(together) < sum(len(handles) for _, handles in named)
    distinct = len(set(map(_look, together.values()))) == len(together) <= _MOST_TOGETHER
    if shared and distinct:
        _above_all(figure, together)
        lay_out()
        return
    inside = [axes for axes, handles in named if _inside(axes, handles)]
    for axes, handles in named:
        if axes not in inside:
            _above(axes, handles)
    # A legend above its panel makes the panels smaller: what was clear may not be any more.
    lay_out()
    for axes in inside:
        legend = axes.get_legend()
        if legend is not None and _covers(legend, axes):
            _above(axes, _handles(axes))
            lay_out()


def _handles(axes: Axes) -> dict[str, Any]:
    """What has a label in these axes, by its label."""
    handles, labels = axes.get_legend_handles_labels()
    return dict(zip(labels, handles, strict=True))


def _look(handle: Any) -> tuple[Any, ...]:
    """What tells a line from others."""
    return handle.get_color(), handle.get_marker(), handle.get_linestyle()


def _above_all(figure: Figure, handles: dict[str, Any]) -> None:
    for columns in _column_counts(len(handles)):
        legend = figure.legend(
            list(handles.values()),
            list(handles),
            loc="outside upper center",
            ncols=columns,
            borderaxespad=0.1,
        )
        if columns == 1 or legend.get_window_extent().width < figure.bbox.width:
            return
        legend.remove()


def _column_counts(entries: int) -> list[int]:
    """Columns that fill their rows as evenly as they can, for one row, two rows and so on."""
    return list(dict.fromkeys(ceil(entries / rows) for rows in range(1, entries + 1)))


def _inside(axes: Axes, handles: dict[str, Any]) -> bool:
    """Put the legend into the first corner where it covers nothing; whether there is one."""
    for place in _PLACES:
        legend = axes.legend(list(handles.values()), list(handles), loc=place)
        legend.set_in_layout(False)
        if not _covers(legend, axes):
            return True
    return False


def _above(axes: Axes, handles: dict[str, Any]) -> None:
    for columns in _column_counts(len(handles)):
        legend = axes.legend(
            list(handles.values()),
            list(handles),
            loc="lower center",
            bbox_to_anchor=(0.5, 1.0),
            ncols=columns,
            borderaxespad=0.1,
            columnspacing=1.0,
        )
        if columns == 1 or legend.get_window_extent().width < axes.bbox.width:
            break
    if axes.get_title():
        points = legend.get_window_extent().height * 72 / axes.figure.dpi
        axes.set_title(axes.get_title(), pad=points + 3)


def _covers(legend: Legend, axes: Axes) -> bool:
    """Whether the legend lies over anything that is drawn, or is larger than its axes."""
    extent = legend.get_window_extent()
    if extent.width > axes.bbox.width or extent.height > axes.bbox.height:
        return True
    box = extent.padded(_CLEAR * axes.figure.dpi / 72)
    stems = (
        collection.get_transform().transform_path(path)
        for collection in axes.collections
        for path in collection.get_paths()
    )
    return any(_crosses(line, box) for line in axes.lines) or any(
        path.intersects_bbox(box, filled=False) for path in stems
    )


def _crosses(line: Line2D, box: Bbox) -> bool:
    path = line.get_transform().transform_path(line.get_path())
    if line.get_linestyle() != "None":
        return bool(path.intersects_bbox(box, filled=False))
    points = np.asarray(path.vertices)
    return bool(np.any(np.all((points >= np.asarray(box.min)) & (points <= np.asarray(box.max)), axis=1)))
