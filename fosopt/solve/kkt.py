"""Multipliers of what is active at a point, found afresh from gradients alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from fosopt.ops import Array

# Rounds of the search for multipliers; few are needed.
_ROUNDS = 100


def active_multipliers(
    matrix: Array, gradient: Array, at_upper: NDArray[np.bool_], at_lower: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Weights of active rows that leave least of the gradient, and what they leave, one multiplier per active bound.

    The multiplier of a bound takes what pushes its variable against it. Which bounds do follows from the weights of the
    few rows: a convex problem, solved by repeating the least squares over what no bound takes.
    """
    weights, residual = np.zeros(matrix.shape[1]), gradient

    def left(weights: Array) -> Array:
        rest = gradient + matrix @ weights
        return np.where((at_upper & (rest < 0)) | (at_lower & (rest > 0)), 0.0, rest)

    best = left(weights)
    taken = at_upper | at_lower
    for _ in range(_ROUNDS if matrix.shape[1] else 0):
        if taken.all():
            break
        found, _ = optimize.nnls(matrix[~taken], -gradient[~taken])
        residual = left(found)
        if np.linalg.norm(residual) <= np.linalg.norm(best):
            weights, best = found, residual
        now = (residual == 0) & (at_upper | at_lower)
        if np.array_equal(now, taken):
            break
        taken = now
    return weights, best
