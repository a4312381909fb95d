"""Scales, limits and ticks of a panel: what engineers read on a Bode plot and nothing odd elsewhere."""

from __future__ import annotations

from math import log10

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import (
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    MultipleLocator,
    NullFormatter,
    NullLocator,
)

from fosopt.ops import Array
from fosopt.report.panels import Curve, Panel, Scale

_MARGIN = 0.05  # of the span, around points and above and below curves
_PLAIN = 1e-3, 1e5  # between them a number on a logarithmic axis is written out
_MOST_TICKS = 6
_TURNS = (1, 2, 5, 10, 15, 30, 45, 90, 180, 360, 720, 1440, 3600, 7200, 14400)


def set_scales(axes: Axes, panel: Panel) -> None:
    """Scales, limits and ticks of empty axes, for the curves that are to come."""
    axes.set_xscale(panel.x_scale)
    axes.set_yscale(panel.y_scale)
    free = panel.x_range is None and panel.y_range is None
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim" if free else "box")
        axes.margins(_MARGIN)
    if not (panel.equal and free):
        axes.set_xlim(panel.x_range or _x_range(panel))
        axes.set_ylim(panel.y_range or _y_range(panel))
    _ticks(axes.xaxis, panel.x_scale, panel.x_label, axes.get_xlim())
    _ticks(axes.yaxis, panel.y_scale, panel.y_label, axes.get_ylim())


def _x_range(panel: Panel) -> tuple[float, float]:
    """Curves from edge to edge, points with room around them."""
    values = [_shown(curve.x, panel.x_scale) for curve in panel.curves]
    values += [np.array([mark.x]) for mark in panel.marks if mark.x is not None]
    lines = any(curve.style in ("line", "dashed", "dotted") for curve in panel.curves)
    return _around(values, panel.x_scale, 0.0 if lines and panel.x_scale == "log" else _margin(panel))


def _margin(panel: Panel) -> float:
    lines = [curve for curve in panel.curves if curve.style in ("line", "dashed", "dotted")]
    rising = all(np.all(np.diff(curve.x) >= 0) for curve in lines)
    return 0.0 if lines and rising else _MARGIN


def _y_range(panel: Panel) -> tuple[float, float]:
    """What the visible part of the curves needs."""
    values = [_shown(_within(curve, panel.x_range), panel.y_scale) for curve in panel.curves]
    values += [np.array([mark.y]) for mark in panel.marks if mark.y is not None]
    if panel.y_scale == "linear" and any(curve.style == "stems" for curve in panel.curves):
        values.append(np.zeros(1))
    return _around(values, panel.y_scale, _MARGIN)


def _within(curve: Curve, x_range: tuple[float, float] | None) -> Array:
    if x_range is None:
        return np.asarray(curve.y)
    low, high = sorted(x_range)
    return np.asarray(curve.y)[(np.asarray(curve.x) >= low) & (np.asarray(curve.x) <= high)]


def _shown(values: Array, scale: Scale) -> Array:
    """What an axis of this scale can show."""
    found = np.asarray(values, dtype=float)
    found = found[np.isfinite(found)]
    return found[found > 0] if scale == "log" else found


def _around(values: list[Array], scale: Scale, margin: float) -> tuple[float, float]:
    every = np.concatenate([np.empty(0), *values])
    if not every.size:
        return (1.0, 10.0) if scale == "log" else (0.0, 1.0)
    low, high = float(every.min()), float(every.max())
    if scale == "log":
        low, high = (log10(low), log10(high)) if high > low else (log10(low) - 0.5, log10(low) + 0.5)
        room = margin * (high - low)
        return 10 ** (low - room), 10 ** (high + room)
    if high == low:
        low, high = low - (abs(low) or 1.0) / 2, high + (abs(high) or 1.0) / 2
    room = margin * (high - low)
    return low - room, high + room


def _ticks(axis: Axis, scale: Scale, label: str, limits: tuple[float, float]) -> None:
    low, high = sorted(limits)
    if scale == "log":
        _logarithmic(axis, low, high)
        return
    unit = label.rpartition("[")[2].rstrip("]")
    if unit in ("deg", "°"):
        # A phase is read in quarter turns.
        step = next((turn for turn in _TURNS if (high - low) / turn < _MOST_TICKS), _TURNS[-1])
        axis.set_major_locator(MultipleLocator(step))
    elif unit.startswith("dB"):
        axis.set_major_locator(MaxNLocator(_MOST_TICKS, steps=[1, 2, 4, 5, 6, 10]))
    else:
        axis.set_major_locator(MaxNLocator(_MOST_TICKS, steps=[1, 2, 2.5, 5, 10]))


def _logarithmic(axis: Axis, low: float, high: float) -> None:
    decades = log10(high / low)
    plain = _PLAIN[0] <= low and high <= _PLAIN[1]
    if decades < 0.7:
        axis.set_major_locator(MaxNLocator(_MOST_TICKS - 1))
        axis.set_minor_locator(NullLocator())
    else:
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if decades < 1.7 else (1,), numticks=9))
        axis.set_minor_locator(LogLocator(subs=range(2, 10) if decades < 9 else (1,), numticks=99))
    axis.set_minor_formatter(NullFormatter())
    if plain:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}"))
