"""Tabulated power spectral densities: what stands between their rows, and where a quadrature has to cut them."""

from __future__ import annotations

from typing import Literal

import numpy as np

from fosopt.errors import ModelError
from fosopt.ops import Array

Interpolation = Literal["linear", "log", "level"]
"""Between two rows: a straight line, a straight line on logarithmic axes, or the level of the lower row."""

# On logarithmic axes a row to the next is cut where the frequency doubles, so that a power law is smooth in each piece.
_OCTAVE = 2.0


def check_interpolation(frequency: Array, psd: Array, interpolation: Interpolation) -> None:
    """Refuse a table that cannot be drawn on logarithmic axes and should be.

    Raises
    ------
    ModelError
        For a frequency or a density of zero.
    """
    if interpolation == "log" and (frequency[0] <= 0 or np.any(psd <= 0)):
        raise ModelError(
            "a spectrum table with a zero has no straight lines on logarithmic axes; write 'interpolation: linear'"
        )


def density_between(frequency: Array, rows: Array, psd: Array, interpolation: Interpolation) -> Array:
    """(m,) Density of a table at `frequency`, zero outside of its `rows` [rad/s], in the unit of `psd`."""
    if interpolation == "linear":
        return np.interp(frequency, rows, psd, left=0.0, right=0.0)
    inside = (frequency >= rows[0]) & (frequency <= rows[-1])
    if interpolation == "log":
        with np.errstate(divide="ignore"):
            return np.where(inside, np.exp(np.interp(np.log(frequency), np.log(rows), np.log(psd))), 0.0)
    below = np.clip(np.searchsorted(rows, frequency, side="right") - 1, 0, rows.size - 2)
    return np.where(inside, psd[below], 0.0)


def table_cuts(rows: Array, interpolation: Interpolation) -> Array:
    """(k,) Frequencies between which the density is smooth [rad/s]."""
    if interpolation != "log":
        return rows
    pieces = np.maximum(np.ceil(np.log(rows[1:] / rows[:-1]) / np.log(_OCTAVE)), 1).astype(int)
    parts = [
        np.geomspace(low, high, count, endpoint=False)
        for low, high, count in zip(rows[:-1], rows[1:], pieces, strict=True)
    ]
    return np.concatenate([*parts, rows[-1:]])


def levels_of_cumulative_rms(frequency: Array, rms: Array) -> Array:
    """(m,) Levels of the density whose rms accumulates as a table says, (R²_{k+1} − R²_k)/(f_{k+1} − f_k).

    The table rises from zero, or falls to it where it accumulates from the highest frequency down. The last level is
    that of the row before it.

    Parameters
    ----------
    frequency
        (m,) ascending [Hz].
    rms
        (m,) [unit].

    Returns
    -------
    (m,)
        [unit²/Hz].

    Raises
    ------
    ModelError
        If the rms neither rises nor falls throughout, or if it has no zero where it begins to accumulate.
    """
    steps = np.diff(rms)
    rising, falling = bool(np.all(steps >= 0)), bool(np.all(steps <= 0))
    if not (rising or falling) or not np.any(steps):
        raise ModelError(
            "a cumulative rms rises or falls throughout, but not both; sort the table, or give its spectrum"
        )
    first = rms[0] if rising else rms[-1]
    if first != 0:
        end = frequency[0] if rising else frequency[-1]
        raise ModelError(
            f"the cumulative rms is {first:g} already at {end:g} Hz, and nothing tells the spectrum beyond; add a row "
            "with zero where it begins to accumulate"
        )
    levels = np.abs(np.diff(rms**2)) / np.diff(frequency)
    return np.append(levels, levels[-1])
