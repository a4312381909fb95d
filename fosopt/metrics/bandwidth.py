"""Bandwidth of the closed loop."""

from __future__ import annotations

from math import sqrt

import numpy as np

from fosopt.control import ClosedLoopPoles, closed_loop_response
from fosopt.errors import SolverError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.margins import frequency_grid
from fosopt.ops import Array

_BISECTIONS = 60


def closed_loop_bandwidth(model: LoopModel, poles: ClosedLoopPoles) -> float:
    """Frequency beyond which the command response |T(jω)| stays more than 3 dB below one [rad/s].

    [Barker1991] Sec. 4.4

    Narrow dips below it, at zeros of the plant, do not count; resonances beyond it do.

    Raises
    ------
    SolverError
        If the response is that small at every frequency, or at none.
    """

    def passes(frequency: Array) -> np.ndarray:
        points = model.points(1j * frequency)
        return np.abs(closed_loop_response("command", model.loop, points.s, points.g)) >= 1 / sqrt(2)

    grid = frequency_grid(model, poles)
    above = np.flatnonzero(passes(grid))
    if not above.size or above[-1] + 1 == grid.size:
        where = "no" if not above.size else "every"
        raise SolverError(f"bandwidth: the command response passes at {where} frequency; change the gains")
    low, high = grid[above[-1]], grid[above[-1] + 1]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if passes(np.array([middle]))[0] else (low, middle)
    return float(0.5 * (low + high))
