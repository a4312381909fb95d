"""Curves as few points as the eye needs: nothing is left out that could be seen in a figure of ordinary size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fosopt.ops import Array

WIDTH, HEIGHT = 600.0, 280.0
"""A figure that is looked at closely [px]."""

_TOLERANCE = 0.75  # px by which what is left out may be off the line


def visible(x: Array, *axes: Array) -> NDArray[np.intp]:
    """Indices of the points that a polyline through curves of one abscissa needs.

    Ends are kept, and so is the point farthest from the line between two kept ones, until none is farther than three
    quarters of a pixel in a figure of 600 by 280: no peak is cut off, however narrow.    [Douglas1973]

    Parameters
    ----------
    x
        (m,) ascending, as the figure shows it: the logarithm where its axis is logarithmic.
    axes
        (m,) or (c, m) each, as the figure shows it: one curve or several that together fill the height of their axes.
    """
    across = _spread(x) * WIDTH
    heights = np.vstack([_spread(y) * HEIGHT for y in axes])
    kept = np.array([0, x.size - 1])
    # Points of the segments that were split last; all segments of a pass at once.
    points = np.arange(x.size - 1)
    while points.size:
        segment = np.searchsorted(kept, points, side="right") - 1
        first, last = kept[segment], kept[segment + 1]
        distance = _distance(
            across[points] - across[first],
            heights[:, points] - heights[:, first],
            across[last] - across[first],
            heights[:, last] - heights[:, first],
        )
        begins = np.flatnonzero(np.diff(segment, prepend=-1))
        worst = np.repeat(np.maximum.reduceat(distance, begins), np.diff(np.append(begins, points.size)))
        split = worst > _TOLERANCE
        far = np.flatnonzero(split & (distance == worst))
        _, once = np.unique(segment[far], return_index=True)
        kept = np.union1d(kept, points[far[once]])
        points = points[split]
    return kept


def _spread(values: Array) -> Array:
    """From zero to one."""
    low, high = float(values.min()), float(values.max())
    return (values - low) / (high - low or 1.0)


def _distance(x: Array, y: Array, end_x: Array, end_y: Array) -> Array:
    """(m,) Largest distance over (c, m) curves from segments that begin at the origin."""
    square = np.maximum(end_x**2 + end_y**2, 1e-300)
    along = np.clip((x * end_x + y * end_y) / square, 0.0, 1.0)
    squared: Array = ((x - along * end_x) ** 2 + (y - along * end_y) ** 2).max(axis=0)
    return np.sqrt(squared)
