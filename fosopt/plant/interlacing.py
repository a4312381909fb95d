"""Roots of a function that falls through each interval between its poles, kept as pole plus distance.

Coupled modes and the zeros of collocated transfer functions are such roots [Golub1973]. A distance, which carries
all that matters of a nearly cancelled pair, keeps full relative accuracy however small it is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fosopt.errors import SolverError
from fosopt.ops import Array

_MAX_ITERATIONS = 200

# From base, distance and the own pole (or −1) of each root: the function without its own pole term, its slope, and
# the numerator of that term over the distance, with its slope.
Terms = Callable[[Array, Array, NDArray[np.intp]], tuple[Array, Array, Array, Array]]


def falling_roots(
    low: Array, high: Array, low_pole: NDArray[np.intp], high_pole: NDArray[np.intp], terms: Terms
) -> tuple[Array, Array]:
    """The root in each of (m,) intervals of a function f(x) = rest(x) + strength(x)/(x − pole) that falls.

    Parameters
    ----------
    low, high
        Ends of the intervals.
    low_pole, high_pole
        Which pole stands at each end. Without one (−1) the low end still serves as a base; the high end does not.
    terms
        f in parts, see `Terms`.

    Returns
    -------
    (m,), (m,)
        Root = base + distance, base being the nearer end.

    Raises
    ------
    SolverError
        If a root does not settle in its interval.
    """
    n = low.size
    both = high_pole >= 0
    with np.errstate(divide="ignore"):
        at_middle = terms(np.zeros(n), 0.5 * (low + high), np.full(n, -1))[0]
    # Positive at the middle, the function has its root in the upper half.
    upper = (at_middle > 0) & both
    own = np.where(upper, high_pole, low_pole)
    base = np.where(upper, high, low)
    inner = np.zeros(n)
    outer = np.where(upper, -1.0, 1.0) * np.where(both, 0.5, 1.0) * (high - low)
    # h = distance·rest + strength has the root of f without its pole; it is rest itself where there is no pole.
    pole = own >= 0
    distance = np.where(pole, 0.0, 0.5 * outer)
    step = np.zeros(n)
    for _ in range(_MAX_ITERATIONS):
        rest, rest_slope, strength, strength_slope = terms(base, distance, own)
        value = np.where(pole, distance * rest + strength, rest)
        slope = np.where(pole, rest + distance * rest_slope + strength_slope, rest_slope)
        # Sign of f on this side of the root decides which end of the bracket moves.
        sign = np.where(pole, np.where(upper, -1.0, 1.0) * value, value)
        before = np.where(upper, sign < 0, sign > 0)
        inner = np.where(before, distance, inner)
        outer = np.where(before, outer, distance)
        with np.errstate(divide="ignore", invalid="ignore"):
            trial = distance - value / slope
        lower_end, upper_end = np.minimum(inner, outer), np.maximum(inner, outer)
        outside = ~((trial > lower_end) & (trial < upper_end))
        trial = np.where(outside & (value != 0), 0.5 * (inner + outer), np.where(value == 0, distance, trial))
        step = np.abs(trial - distance)
        distance = trial
        if np.all(step <= 1e-15 * np.abs(distance)):
            break
    if np.any(step > 1e-12 * np.abs(distance)):
        raise SolverError("secular equation: a root does not settle in its interval; check the modal set")
    return base, distance
