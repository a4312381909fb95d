"""Closed-loop poles of many loops on one structure, found together, each from its neighbors.

The same method and the same steps as for one loop, with all poles of all loops in one array and the sums over modes and
poles in compiled loops. What all loops have in common on the structure is part of its poles; the reaction mass of a
reactionless mirror, which grows with the mirror, hangs on it and changes receptances and characteristic function by a
rank-one update.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror
from fosopt.control.loop import Loop, Receptances
from fosopt.control.open_loop import OpenLoopPoles, moving_pairs, open_loop_poles
from fosopt.control.pid import PID
from fosopt.control.poles import (
    ClosedLoopPoles,
    aberth_step,
    adds_up,
    closed_loop_poles,
    moves,
)
from fosopt.errors import SolverError
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray, Dual
from fosopt.plant.sums import modal_sums, repulsion

# A pole this close to one of the structure, relative, is kept as a shift from it.
_NEAR = 1e-3
_HIDDEN = 1e-12
# From a neighbor two or three steps are enough; what takes many has the wrong number of real poles.
_MOST_STEPS = 20


@dataclass(frozen=True)
class _Mirrors(Mirror):
    """Mirrors whose properties are arrays, each of which was a mirror before."""

    def __post_init__(self) -> None:
        pass


_MIRROR = ("inertia", "natural_frequency", "damping_ratio")
_CONTROLLER = ("gain", "kp", "ki", "kd", "rolloff_time")


def loops_together(loops: Sequence[Loop]) -> Loop | None:
    """Loops as one with (l, 1) arrays in place of numbers; None where their forms differ."""
    first = loops[0]
    alone = any(loop.beside is not None or loop.controller.path.sections for loop in loops)
    if alone or any(_form(loop) != _form(first) for loop in loops):
        return None

    def column(values: list[float]) -> Array:
        return np.array(values)[:, None]

    mirrors, pids = [loop.mirror for loop in loops], [loop.controller for loop in loops]
    return _joined(
        first,
        {n: column([getattr(m, n) for m in mirrors]) for n in _MIRROR},
        {n: column([getattr(c, n) for c in pids]) for n in _CONTROLLER},
    )


def _form(loop: Loop) -> tuple[Any, ...]:
    """What loops that are found together have in common: their parts, and which terms a controller has."""
    pid = loop.controller
    terms = pid.ki == 0, pid.kd == 0, pid.rolloff_time == 0
    return loop.placement, loop.actuators, loop.mirror.reaction_mass, pid.path, terms


def _joined(like: Loop, mirrors: dict[str, Array], controllers: dict[str, Array]) -> Loop:
    mirror: Mirror = _Mirrors(**mirrors, reaction_mass=like.mirror.reaction_mass)
    return Loop(mirror, PID(**controllers, path=like.controller.path), like.placement, like.actuators)


def _lines(together: Loop, line: NDArray[np.intp]) -> Loop:
    """The loop of each line that is asked for, as (r,) arrays."""
    m, c = together.mirror, together.controller
    return _joined(
        together,
        {n: getattr(m, n)[line, 0] for n in _MIRROR},
        {n: getattr(c, n)[line, 0] for n in _CONTROLLER},
    )


def hung(loop: Loop, open_loop: OpenLoopPoles) -> tuple[tuple[int, Any], ...]:
    """What hangs on the structure beyond its poles, with the numbers of these loops."""
    return ((0, loop.mirror.counter),) if open_loop.hung else ()


def sums(
    open_loop: OpenLoopPoles, base: ComplexArray, shift: ComplexArray, pairs: Sequence[int], count: int
) -> tuple[Receptances, ComplexArray]:
    """Receptances with their derivatives at (m,) points, without what hangs on the structure, and Σ_k D_k′/D_k.

    Parameters
    ----------
    pairs, count
        Which pairs of ports are asked for, and how many there are; the others are zero.
    """
    linear = open_loop.linear
    rows = np.ascontiguousarray(open_loop.constant.T[list(pairs)])
    by_s = np.zeros((0, rows.shape[1])) if linear is None else np.ascontiguousarray(linear.T[list(pairs)])
    value, slope, known = modal_sums(
        open_loop.first, open_loop.second, rows, by_s, base.ravel(), shift.ravel()
    )
    every: list[Any] = [0.0] * count
    for k, v, d in zip(pairs, value, slope, strict=True):
        every[k] = Dual(v.reshape(base.shape), d.reshape(base.shape))
    return Receptances.of(every), known.reshape(base.shape)


def shared_open_loop(loop: Loop, modes: ModalSet, mirror_port: str) -> OpenLoopPoles:
    """Poles of the structure with what a mirror does not change; the mirror's own reaction mass hangs on it."""
    counter = loop.mirror.counter
    if counter is None:
        return open_loop_poles(loop, modes, mirror_port)
    without = replace(loop, mirror=replace(loop.mirror, reaction_mass=None))
    return replace(open_loop_poles(without, modes, mirror_port), hung=((0, counter),))


def many_closed_loop_poles(
    loops: Sequence[Loop],
    modes: ModalSet,
    mirror_port: str,
    near: ClosedLoopPoles,
    shared: OpenLoopPoles | None = None,
) -> list[ClosedLoopPoles | None]:
    """Closed-loop poles of each loop.    [Barker1991] Eq. (4.30)

    Fastest where neighbors in the list are neighbors in their numbers: the first loop starts from `near`, then the last
    from the first, and each one half way between two from the mean of both.

    Parameters
    ----------
    near
        Poles of a loop on the same modes that differs little.
    shared
        What `shared_open_loop` gives for one of the loops, if it is known.

    Returns
    -------
    list
        None for a loop whose poles have to be found alone: its form differs from that of the others, or the iteration
        does not converge. The others differ in what hangs on their open loops only.
    """
    found: list[ClosedLoopPoles | None] = [None] * len(loops)
    if loops_together(loops) is None:
        return found
    open_loop = shared or shared_open_loop(loops[0], modes, mirror_port)
    left, start = list(range(len(loops))), near
    while True:
        many = _Many([loops[k] for k in left], open_loop, _moved(start, open_loop))
        for k, poles in zip(left, many.solve(), strict=True):
            found[k] = poles
        missing = [k for k in left if found[k] is None]
        if not missing or (len(missing) == len(left) and start is not near):
            return found
        # Where a pair has become two real poles, one loop alone shows the others how many there are of each.
        left = missing
        try:
            start = closed_loop_poles(loops[left[0]], modes, mirror_port)
        except SolverError:
            return found


def _moved(
    near: ClosedLoopPoles, open_loop: OpenLoopPoles
) -> tuple[ComplexArray, ComplexArray, NDArray[np.intp]]:
    """Poles as shifts from those of an open loop, or from zero where none is close, with their multiplicity."""
    value, multiplicity = near.value, near.multiplicity
    known: ComplexArray = np.concatenate([open_loop.first, open_loop.second, np.zeros(1)])
    if np.array_equal(near.open_loop.first, open_loop.first):
        base = np.where(np.isin(near.base, known), near.base, 0.0)
        return base, (near.base - base) + near.shift, multiplicity
    if open_loop.uncoupled.size > near.open_loop.uncoupled.size:
        # A mode that only rounding lets the loop move is none of the others.
        hidden = np.abs(value[:, None] - open_loop.uncoupled).min(axis=1) < _HIDDEN * np.abs(value)
        value, multiplicity = value[~hidden], multiplicity[~hidden]
    nearest = known[np.argmin(np.abs(value[:, None] - known), axis=1)]
    close = (np.abs(nearest - value) < _NEAR * np.abs(value)) & ((nearest.imag == 0) == (multiplicity == 1))
    base = np.where(close, nearest, 0.0)
    shift = value - base
    return base, np.where(shift == 0, 1e-14 * np.abs(base), shift), multiplicity


class _Many:
    """Poles of loops of one form, kept as shifts from common bases."""

    def __init__(
        self,
        loops: Sequence[Loop],
        open_loop: OpenLoopPoles,
        start: tuple[ComplexArray, ComplexArray, NDArray[np.intp]],
    ) -> None:
        together = loops_together(loops)
        assert together is not None
        self._loops, self._together = loops, together
        # With the numbers of all loops in place of those of one.
        self._open_loop = replace(open_loop, hung=hung(together, open_loop))
        base, shift, self._multiplicity = start
        self._pair = self._multiplicity == 2
        self._base, self._shift = np.tile(base, (len(loops), 1)), np.tile(shift, (len(loops), 1))
        self._done = np.zeros(len(loops), dtype=bool)
        self._pairs, self._count = moving_pairs(loops[0]), len(loops[0].pairs)

    def solve(self) -> list[ClosedLoopPoles | None]:
        """The poles of each loop, None where the iteration fails."""
        for lines, left, right in _levels(len(self._loops)):
            for line, a, b in zip(lines, left, right, strict=True):
                ends = [k for k in (a, b) if k >= 0 and self._done[k]]
                if ends:
                    self._shift[line] = self._shift[ends].mean(axis=0)
            self._settle(lines)
        found = []
        for k, loop in enumerate(self._loops):
            own = self._open_loop
            if own.hung:
                own = replace(own, hung=hung(loop, own))
            poles = ClosedLoopPoles(self._base[k], self._shift[k], self._multiplicity, own)
            found.append(poles if self._done[k] else None)
        return found

    def _settle(self, lines: NDArray[np.intp]) -> None:
        """Iterate the poles of some lines until they rest."""
        base, shift, pair, open_loop = self._base, self._shift, self._pair, self._open_loop
        line, place = (each.ravel() for each in np.meshgrid(lines, np.arange(base.shape[1]), indexing="ij"))
        lost, before = np.zeros(len(self._loops), dtype=bool), np.full(line.size, np.inf)
        with np.errstate(all="ignore"):
            for _ in range(_MOST_STEPS):
                b, d = base[line, place], shift[line, place]
                s = b + d
                g, known = sums(open_loop, b, d, self._pairs, self._count)
                others = repulsion(base, shift, pair, line, place)
                loop = _lines(self._together, line)
                step = aberth_step(loop, s, g, known, others, hung(loop, open_loop))
                step = np.where(pair[place], step, step.real)
                lost[line[~np.isfinite(step)]] = True
                d = d - step
                shift[line, place] = d
                still = moves(step, before, d, s) & ~lost[line]
                line, place, before = line[still], place[still], np.abs(step)[still]
                if line.size == 0:
                    break
            lost[line] = True
            value = base + shift
            self._done = self._done | (~lost & np.isin(np.arange(lost.size), lines))
            self._done &= adds_up(self._together, open_loop, value, self._multiplicity)


def _levels(
    count: int,
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]]:
    """Lines in the order in which they are found, and on either side of each the line it starts from, −1 for none."""
    none = np.full(1, -1, dtype=np.intp)
    yield np.array([0]), none, none
    if count == 1:
        return
    yield np.array([count - 1]), np.array([0]), none
    known = np.array([0, count - 1])
    while True:
        left, right = known[:-1], known[1:]
        wide = right - left > 1
        if not wide.any():
            return
        middle = (left[wide] + right[wide]) // 2
        yield middle, left[wide], right[wide]
        known = np.sort(np.concatenate([known, middle]))
