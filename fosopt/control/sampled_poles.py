"""Closed-loop poles of sampled loops, followed from loop to loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from fosopt.control.loop import Loop
from fosopt.control.sampled import sampled_loop
from fosopt.modes import ModalSet
from fosopt.ops import ComplexArray

# Stands for a pole at zero, which is over before the next sample.
_LEAST = 1e-300


@dataclass(frozen=True)
class SampledPoles:
    """All closed-loop poles of a sampled loop, conjugates too.

    Attributes
    ----------
    z
        (m,) in the order of those they were followed from [-].
    period
        [s].
    """

    z: ComplexArray
    period: float

    @property
    def value(self) -> ComplexArray:
        """(m,) ln z/T, whose imaginary part lies between the Nyquist frequencies [rad/s]."""
        s: ComplexArray = np.log(self.z + _LEAST * (self.z == 0)) / self.period
        return s

    @property
    def multiplicity(self) -> NDArray[np.intp]:
        """(m,) One each."""
        return np.ones(self.z.size, dtype=np.intp)

    @property
    def spectral_abscissa(self) -> float:
        """ln|z|/T of the outermost pole, negative for a stable loop [rad/s]."""
        return float(self.value.real.max())


def sampled_poles(
    loop: Loop, modes: ModalSet, mirror_port: str, near: SampledPoles | None = None
) -> SampledPoles:
    """All closed-loop poles of a sampled loop.

    Parameters
    ----------
    near
        Poles of a loop that differs little, in whose order these come: each to the one it lies next to, so that all
        together move least.
    """
    sampled = sampled_loop(loop, modes, mirror_port)
    z = sampled.poles
    if near is not None and near.z.size == z.size:
        z = z[optimize.linear_sum_assignment(np.abs(near.z[:, None] - z))[1]]
    return SampledPoles(z, sampled.period)
