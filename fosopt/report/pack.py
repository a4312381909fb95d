"""Details of points in as few bytes as their figures need: a front of hundreds of points is a file of megabytes.

Curves are written as whole numbers of two bytes over their range, frequencies and times of three, in base64. What all
points share, the nodes and bars of a truss, is written once. ``unpack.js`` undoes all this for the point that is shown.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np

_FINE = ("frequency_hz", "time_s", "window_time_s")
_CURVES = ("bode", "spectrum", "cumulative", "step")
_LEAST = 12  # numbers worth packing
_DECADES = 1.5  # from here on a curve that is positive is quantized by its logarithm
_DIGITS = 6
_SHARED = ("nodes", "bars", "kinds", "names", "battens")


def packed(points: list[Mapping[str, object]]) -> tuple[list[dict[str, object]], list[dict[str, object]]]:
    """Points with their details packed, and the trusses these refer to."""
    trusses: list[dict[str, object]] = []
    return [_point(point, trusses) for point in points], trusses


def _point(point: Mapping[str, object], trusses: list[dict[str, object]]) -> dict[str, object]:
    kept = dict(point)
    if isinstance(kept.get("history"), list):
        kept["history"] = _rounded(kept["history"])
    detail = kept.get("detail")
    if not isinstance(detail, Mapping):
        return kept
    found = dict(detail)
    for name in _CURVES:
        if isinstance(found.get(name), Mapping):
            found[name] = _table(found[name])
    by_mode = found.get("by_mode")
    if isinstance(by_mode, Mapping):
        found["by_mode"] = {
            **by_mode,
            "modes": _rounded(by_mode["modes"]),
            "cumulative": _table(by_mode["cumulative"]),
        }
    if found.get("modes"):
        found["modes"] = _rows(found["modes"])
    if found.get("poles"):
        found["poles"] = _rounded(found["poles"])
    if isinstance(found.get("truss"), Mapping):
        found["truss"] = _truss(found["truss"], trusses)
    return {**kept, "detail": found}


def _truss(truss: Mapping[str, object], trusses: list[dict[str, object]]) -> dict[str, object]:
    shared = {name: truss[name] for name in _SHARED if name in truss}
    if shared not in trusses:
        trusses.append(shared)
    return {"of": trusses.index(shared), "areas": _rounded(truss["areas"])}


def _rows(rows: list[Mapping[str, object]]) -> dict[str, object]:
    """A table of records with its names once."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {"names": names, "rows": _rounded([[row.get(name) for name in names] for row in rows])}


def _table(curves: Mapping[str, Any]) -> dict[str, object]:
    return {name: _curve(values, 3 if name in _FINE else 2) for name, values in curves.items()}


def _curve(values: Any, size: int) -> object:
    """[bytes per number, whether logarithms, least, most, base64], or what it was if that is no curve."""
    if not isinstance(values, list) or len(values) < _LEAST:
        return values
    if not all(isinstance(value, int | float) and isfinite(value) for value in values):
        return values
    y = np.asarray(values, dtype=float)
    logarithmic = bool(y.min() > 0 and np.log10(y.max() / y.min()) > _DECADES)
    if logarithmic:
        y = np.log10(y)
    low, high = float(y.min()), float(y.max())
    steps = np.rint((y - low) / ((high - low) or 1.0) * (256**size - 1)).astype("<u4")
    data = steps[:, None].view(np.uint8)[:, :size].tobytes()
    return [size, logarithmic, low, high, b64encode(data).decode("ascii")]


def _rounded(value: Any) -> Any:
    """Numbers to six digits, whatever they stand in."""
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if isfinite(value) else value
    if isinstance(value, list | tuple):
        return [_rounded(each) for each in value]
    if isinstance(value, Mapping):
        return {name: _rounded(each) for name, each in value.items()}
    return value
