"""The Nyquist criterion: stability counted from the loop transfer function alone."""

from __future__ import annotations

import numpy as np

from fosopt.control import ClosedLoopPoles, loop_transfer
from fosopt.errors import SolverError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.margins import frequency_grid
from fosopt.ops import Array

_TURN = 0.8  # between neighboring frequencies 1 + L turns by less than this [rad]
_PASSES = 40
_REACH = 1e3  # beyond the slowest and fastest poles by this factor, 1 + L no longer turns


def encirclements(model: LoopModel, poles: ClosedLoopPoles) -> int:
    """Clockwise turns of the whole Nyquist plot around −1.    [Doyle1992] Sec. 3.2

    With a plant whose own poles are stable it is the number of unstable closed-loop poles. The poles given only
    say where to look: the turns are counted on 1 + L(jω), at frequencies added until it turns little between them.

    Raises
    ------
    SolverError
        If the plot passes through −1, so that turns cannot be counted.
    """
    grid = frequency_grid(model, poles)
    grid = np.concatenate([grid[:1] / np.array([_REACH, 30.0]), grid, grid[-1:] * np.array([30.0, _REACH])])
    for _ in range(_PASSES):
        turn = _turns(model, grid)
        wide = np.flatnonzero(np.abs(turn) > _TURN)
        if not wide.size:
            # The contour passes the integrator's pole on its right: half a turn, a quarter for this half of the plot.
            quarter = 0.5 * np.pi if model.loop.controller.ki else 0.0
            return round(float((quarter - turn.sum()) / np.pi))
        grid = np.union1d(grid, 0.5 * (grid[wide] + grid[wide + 1]))
    raise SolverError(
        "Nyquist plot: it passes through −1, where turns cannot be counted; change the gain a little"
    )


def _turns(model: LoopModel, frequency: Array) -> Array:
    """(m − 1,) Angle by which 1 + L turns from each frequency to the next [rad]."""
    points = model.points(1j * frequency)
    distance = 1 + loop_transfer(model.loop, points.s, points.g)
    return np.angle(distance[1:] / distance[:-1])
