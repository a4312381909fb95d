"""Chains of filters as states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fosopt.control.filters import Filter
from fosopt.ops import Array


@dataclass(frozen=True)
class FilterStates:
    """A system of one input and one output: ẋ = a x + b u, y = c x + d u, or the same from sample to sample.

    Attributes
    ----------
    a, b, c, d
        (n, n), (n,), (n,), scalar.
    """

    a: Array
    b: Array
    c: Array
    d: float

    @property
    def order(self) -> int:
        """N."""
        return int(self.b.size)

    def then(self, after: FilterStates) -> FilterStates:
        """Both in series, the other one after it."""
        a = np.block([[self.a, np.zeros((self.order, after.order))], [np.outer(after.b, self.c), after.a]])
        b = np.concatenate([self.b, after.b * self.d])
        return FilterStates(a, b, np.concatenate([after.d * self.c, after.c]), after.d * self.d)


PASSING = FilterStates(np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0)


def filter_state_space(filters: Sequence[Filter]) -> FilterStates:
    """Filters one after another, each in companion form with states of like size."""
    chain = PASSING
    for each in filters:
        chain = chain.then(rational_states(each.numerator, each.denominator))
    return chain


def rational_states(numerator: Sequence[float], denominator: Sequence[float]) -> FilterStates:
    """A proper rational function in companion form, its states scaled by the size of its poles.    [Franklin2015]

    Parameters
    ----------
    numerator, denominator
        Highest power first.
    """
    den = np.asarray(denominator, dtype=float)
    num = np.concatenate([np.zeros(den.size - len(numerator)), np.asarray(numerator, dtype=float)]) / den[0]
    den = den / den[0]
    n = den.size - 1
    if n == 0:
        return FilterStates(np.zeros((0, 0)), np.zeros(0), np.zeros(0), float(num[0]))
    size = float(np.abs(np.roots(den)).max()) if den[1:].any() else 1.0
    scale = size ** -np.arange(1.0, n + 1)
    a = np.eye(n, k=-1) * size
    a[0] = -den[1:] * scale * size
    return FilterStates(a, size * np.eye(n)[0], (num[1:] - num[0] * den[1:]) * scale, float(num[0]))
