"""Closed-loop poles of many loops on one structure, found together.

The same method and the same steps as for one loop, with all poles of all loops in one array and the sums over modes and
poles in compiled loops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror
from fosopt.control.loop import Loop, Receptances
from fosopt.control.pid import PID
from fosopt.control.poles import MAX_ITERATIONS, ClosedLoopPoles, aberth_step, complete, moves
from fosopt.ops import Array, Dual
from fosopt.plant.sums import modal_sums, repulsion


@dataclass(frozen=True)
class _Mirrors(Mirror):
    """Mirrors whose properties are arrays, each of which was a mirror before."""

    def __post_init__(self) -> None:
        pass


_MIRROR = ("inertia", "natural_frequency", "damping_ratio")
_CONTROLLER = ("gain", "kp", "ki", "kd", "rolloff_time")


def loops_together(loops: Sequence[Loop]) -> Loop | None:
    """Bicollocated mirrors as one loop with (l, 1) arrays in place of numbers; None where their forms differ."""
    first = loops[0].controller
    for loop in loops:
        pid = loop.controller
        alike = all((a == 0) == (b == 0) for a, b in ((pid.ki, first.ki), (pid.kd, first.kd)))
        if not (loop.plain and alike and (pid.rolloff_time == 0) == (first.rolloff_time == 0)):
            return None

    def column(values: list[float]) -> Array:
        return np.array(values)[:, None]

    mirrors, pids = [loop.mirror for loop in loops], [loop.controller for loop in loops]
    return _joined(
        {n: column([getattr(m, n) for m in mirrors]) for n in _MIRROR},
        {n: column([getattr(c, n) for c in pids]) for n in _CONTROLLER},
    )


def _lines(together: Loop, line: NDArray[np.intp]) -> Loop:
    """The loop of each line that is asked for, as (r,) arrays."""
    m, c = together.mirror, together.controller
    return _joined(
        {n: getattr(m, n)[line, 0] for n in _MIRROR}, {n: getattr(c, n)[line, 0] for n in _CONTROLLER}
    )


def _joined(mirror: dict[str, Any], controller: dict[str, Any]) -> Loop:
    return Loop(_Mirrors(**mirror), PID(**controller))


def many_closed_loop_poles(loops: Sequence[Loop], near: ClosedLoopPoles) -> list[ClosedLoopPoles | None]:
    """All closed-loop poles of each loop, from those of a loop on the same modes that differs little.

    Returns
    -------
    list
        None for a loop whose poles have to be found alone: it is no bicollocated mirror without attachments, a pair
        has become two real poles, or the iteration does not converge.
    """
    together = loops_together(loops)
    if together is None or near.open_loop.linear is not None:
        return [None] * len(loops)
    open_loop, multiplicity = near.open_loop, near.multiplicity
    constant = np.ascontiguousarray(open_loop.constant[:, :1])
    base = np.tile(near.base, (len(loops), 1))
    shift = np.tile(near.shift, (len(loops), 1))
    pair = multiplicity == 2
    line, place = np.divmod(np.arange(base.size), base.shape[1])
    converged = np.ones(len(loops), dtype=bool)
    with np.errstate(all="ignore"):
        for _ in range(MAX_ITERATIONS):
            b, d = base[line, place], shift[line, place]
            s = b + d
            value, slope, known = modal_sums(open_loop.first, open_loop.second, constant, b, d)
            others = repulsion(base, shift, pair, line, place)
            g = Receptances(Dual(value[0], slope[0]), 0.0)
            step = aberth_step(_lines(together, line), s, g, known, others)
            step = np.where(pair[place], step, step.real)
            lost = ~np.isfinite(step)
            converged[line[lost]] = False
            d = d - step
            shift[line, place] = d
            still = moves(step, d, s) & converged[line]
            line, place = line[still], place[still]
            if line.size == 0:
                break
    converged[line] = False
    found = (ClosedLoopPoles(b, d, multiplicity, open_loop) for b, d in zip(base, shift, strict=True))
    return [
        poles if good and complete(loop, open_loop, poles) else None
        for loop, poles, good in zip(loops, found, converged, strict=True)
    ]
