"""Root locus: the closed-loop poles as the gain of the controller grows from zero."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from fosopt.control.loop import Loop
from fosopt.control.pid import PID
from fosopt.control.poles import closed_loop_poles
from fosopt.errors import ModelError
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray

# The first gain beside zero, as a share of the largest: branches leave their open-loop poles on straight lines.
_FIRST = 1e-4
_PASSES = 10
# A branch is fine enough when its points leave the chord of their neighbors by less than this share of its size.
_STRAIGHT = 0.001
# A branch no longer than this (relative) does not move: what is left is rounding.
_STILL = 1e-12


@dataclass(frozen=True)
class RootLocus:
    """Branches of the root locus.

    Attributes
    ----------
    gain
        (m,) ascending from zero, closest where the branches bend.
    branches
        (m, n) closed-loop poles, each column one branch from its open-loop pole [rad/s]. Conjugate branches are
        both there; where two meet on the real axis and part again, either continuation is right. A free rigid
        body's double zero stays where it is and is left out.
    """

    gain: Array
    branches: ComplexArray

    @property
    def spectral_abscissa(self) -> Array:
        """(m,) Largest real part at each gain [rad/s]."""
        return self.branches.real.max(axis=1)

    def branch(self, start: complex) -> ComplexArray:
        """(m,) The branch that leaves the open-loop pole nearest to `start` [rad/s]."""
        return self.branches[:, int(np.argmin(np.abs(self.branches[0] - start)))]

    def unstable_gains(self, branch: ComplexArray) -> tuple[tuple[float, float], ...]:
        """Intervals of the gain in which a branch is unstable, ends interpolated between the gains of the locus."""
        real = np.real(branch)
        unstable = real > 0
        edges = np.flatnonzero(unstable[1:] != unstable[:-1])
        share = real[edges] / (real[edges] - real[edges + 1])
        ends = [float(gain) for gain in self.gain[edges] + share * np.diff(self.gain)[edges]]
        if unstable[0]:
            ends.insert(0, float(self.gain[0]))
        if unstable[-1]:
            ends.append(float(self.gain[-1]))
        return tuple(zip(ends[::2], ends[1::2], strict=True))


def root_locus(loop: Loop, modes: ModalSet, mirror_port: str, count: int = 60) -> RootLocus:
    """Closed-loop poles for gains from zero to the loop's own.    [Barker1991] Sec. 3.4, Fig. 3.14

    Each gain is solved on its own, and poles of neighboring gains are joined so that they move least. Gains are
    added where a branch bends.

    Parameters
    ----------
    count
        Gains to begin with; what is added is several times as many.

    Raises
    ------
    ModelError
        If the loop's gain is not above zero.
    SolverError
        If the poles of a gain cannot be found.
    """
    top = loop.controller.gain
    if not top > 0:
        raise ModelError(f"root locus: gain {top} is not above zero; give the largest gain of the locus")
    known = {0.0: _at_zero_gain(loop, modes, mirror_port)}

    def poles(gain: float) -> ComplexArray:
        if gain not in known:
            with_gain = replace(loop, controller=replace(loop.controller, gain=gain))
            known[gain] = closed_loop_poles(with_gain, modes, mirror_port).all
        return known[gain]

    gain = np.concatenate([[0.0], np.geomspace(_FIRST * top, top, count)])
    branches = _joined(gain, poles)
    for _ in range(_PASSES):
        coarse = _coarse(branches)
        if not coarse.any():
            break
        gain = np.union1d(gain, 0.5 * (gain[:-1] + gain[1:])[coarse])
        branches = _joined(gain, poles)
    return RootLocus(gain, branches)


def _at_zero_gain(loop: Loop, modes: ModalSet, mirror_port: str) -> ComplexArray:
    """(n,) Poles of the plant and of the controller, which no longer know of each other."""
    pid = loop.controller
    plant = closed_loop_poles(replace(loop, controller=PID(0.0, 0.0, 0.0, 0.0)), modes, mirror_port).all
    integrator = [0.0] if pid.ki else []
    low_pass = [-1 / pid.lag] if pid.lag and pid.kd else []
    filters = [section.poles for section in pid.path.sections]
    return np.concatenate([plant, integrator, low_pass, *filters])


def _joined(gain: Array, poles: Callable[[float], ComplexArray]) -> ComplexArray:
    """(m, n) Poles of each gain in the order in which they continue those of the gain before."""
    rows = [poles(0.0)]
    for value in gain[1:]:
        after = poles(float(value))
        _, order = linear_sum_assignment(np.abs(rows[-1][:, None] - after))
        rows.append(after[order])
    return np.array(rows)


def _coarse(branches: ComplexArray) -> NDArray[np.bool_]:
    """(m − 1,) Whether the interval between two gains must be halved.

    Poles joined to the wrong branch leave a kink too, which finer gains straighten.
    """
    size = np.abs(branches - branches[0]).max(axis=0)
    moving = size > _STILL * np.abs(branches).max(axis=0)
    # Distance of a point from the chord of its neighbors.
    chord = branches[2:] - branches[:-2]
    length = np.abs(chord)
    aside = np.abs(np.imag((branches[1:-1] - branches[:-2]) * chord.conj()))
    bent = np.any((aside > _STRAIGHT * size * length) & moving, axis=1)
    coarse = np.zeros(branches.shape[0] - 1, dtype=bool)
    coarse[:-1] |= bent
    coarse[1:] |= bent
    return coarse
