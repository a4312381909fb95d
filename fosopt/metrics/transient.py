"""What a loop does after a step: a sum of decaying or growing oscillations, exact at any time."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from fosopt.control import ClosedLoopPoles
from fosopt.errors import ModelError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import pole_residues
from fosopt.ops import Array, ComplexArray

_PER_PERIOD = 64  # a peak between samples is missed by 0.12 % at most
_CHUNK = 512
_BISECTIONS = 60
# Oscillations this much smaller than the largest, or than a tolerance, need no samples of their own.
_NEGLIGIBLE = 1e-4


@dataclass(frozen=True)
class Transient:
    """The error e(t) = steady + Re Σ_i q_i e^{p_i t} of the line of sight.

    Attributes
    ----------
    steady
        What is left when all oscillations have decayed [rad].
    amplitude
        (m,) complex amplitudes q_i at t = 0 [rad].
    pole
        (m,) p_i, one of each conjugate pair [rad/s].
    """

    steady: float
    amplitude: ComplexArray
    pole: ComplexArray

    def __call__(self, time: Array) -> Array:
        """(k,) Error at (k,) times [s]."""
        return self.steady + np.real(np.exp(np.outer(time, self.pole)) @ self.amplitude)

    def mean(self, start: float, end: float) -> float:
        """Mean error between two times [rad]."""
        return self.steady + float(np.real(self.amplitude @ mean_exponential(self.pole, start, end)))

    def rms(self, start: float, end: float) -> float:
        """Rms error about its mean between two times [rad]."""
        q, p = self.amplitude, self.pole
        both = (
            mean_exponential(p[:, None] + p, start, end),
            mean_exponential(p[:, None] + p.conj(), start, end),
        )
        square = 0.5 * (q @ both[0] @ q + q @ both[1] @ q.conj()).real
        swing = self.mean(start, end) - self.steady
        return max(float(square - swing**2), 0.0) ** 0.5

    def largest(self, start: float, end: float) -> float:
        """Largest size of the error between two times, from samples that miss a peak by 0.12 % at most [rad]."""
        size = np.abs(self.amplitude) * np.exp(self.pole.real * start)
        step = self._step(size > _NEGLIGIBLE * size.max(initial=0.0), end - start)
        time = np.linspace(start, end, int(np.ceil((end - start) / step)) + 1)
        return float(np.abs(self(time)).max())

    def settling_time(self, tolerance: float) -> float:
        """Time after which the error stays within a tolerance; infinite where it never does [s].

        Raises
        ------
        ModelError
            If the tolerance is not above zero.
        """
        if not tolerance > 0:
            raise ModelError(f"settling: tolerance {tolerance} is not above zero; give a positive one")
        decay = -self.pole.real
        if np.any((decay <= 0) & (self.amplitude != 0)) or abs(self.steady) >= tolerance:
            return inf
        rest = tolerance - abs(self.steady)
        size = np.abs(self.amplitude)
        moving = size > 0
        # Beyond this time each oscillation is smaller than its share of what is allowed them together.
        shares = np.log(np.maximum(size[moving] * moving.sum() / rest, 1.0)) / decay[moving]
        time = float(shares.max(initial=0.0))
        while time > 0:
            # Backwards, in steps that resolve what has not decayed there.
            step = self._step(size * np.exp(-decay * time) > _NEGLIGIBLE * tolerance, time)
            sampled = np.maximum(time - step * np.arange(_CHUNK), 0.0)
            outside = np.flatnonzero(np.abs(self(sampled)) > tolerance)
            if outside.size:
                return self._crossing(
                    float(sampled[outside[0]]), float(time - step * (outside[0] - 1)), tolerance
                )
            time = float(sampled[-1])
        return 0.0

    def _step(self, chosen: NDArray[np.bool_], span: float) -> float:
        """Sampling step for the chosen oscillations [s]."""
        fastest = np.abs(self.pole[chosen]).max(initial=2 * np.pi / span)
        return float(2 * np.pi / (_PER_PERIOD * fastest))

    def _crossing(self, outside: float, inside: float, tolerance: float) -> float:
        for _ in range(_BISECTIONS):
            middle = 0.5 * (outside + inside)
            if abs(self(np.array([middle]))[0]) > tolerance:
                outside = middle
            else:
                inside = middle
        return inside


def mean_exponential(z: ComplexArray, start: float, end: float) -> ComplexArray:
    """Mean of e^{zt} between two times, in the shape of `z`."""
    whole = z * (end - start)
    ratio = np.divide(np.expm1(whole), whole, out=np.ones_like(whole), where=whole != 0)
    return np.exp(z * start) * ratio


def step_error(model: LoopModel, poles: ClosedLoopPoles) -> Transient:
    """Error of the mirror angle after a unit step command.    [Barker1991] Eq. (4.28)

    Holds at any finite time, for an unstable loop too. The command has no direct way to the mirror angle, so the
    error starts at −1.
    """
    amplitude = poles.multiplicity * pole_residues(model, poles, "command") / poles.value
    integral = model.loop.controller.ki != 0
    return Transient(0.0 if integral else -1.0 - float(amplitude.real.sum()), amplitude, poles.value)
