"""Jitter and stability of a sampled loop by a second route, for who trusts no first one.

Covariances go forward in time here where energies go backward in `metrics.sampled`: from the stationary covariance at
the samples through one period in small steps, by matrix exponentials of SciPy and Romberg's rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np
from scipy import integrate, linalg

from fosopt.control.sampled import SampledLoop, Source, sampled_loop
from fosopt.control.spans import energy_for_ever
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.sampled import SampledModel
from fosopt.ops import Array

# Steps in each part of a period, a power of two for Romberg's rule, at least as many as turns of the fastest state.
_STEPS = 32
_NODES = 6  # in each step, whose fastest state turns by a radian at most


@dataclass(frozen=True)
class Forward:
    """What the second route finds.

    Attributes
    ----------
    variance
        Mean square over time of the line of sight under all rational spectra over all frequencies together [rad²].
    radius
        Size of the outermost closed-loop pole in z [-].
    """

    variance: float
    radius: float


def forward(model: SampledModel) -> Forward:
    """Jitter and stability of a stable sampled loop, forward in time.    [VanLoan1978]"""
    sources = [
        Source.shaped(d.at, d.filter.numerator, d.filter.denominator)
        for d in _whole(model)
        if d.filter is not None
    ]
    sampled = sampled_loop(model.loop, model.modes, model.mirror_port, sources)
    n, size = sampled.torque.size, sampled.size
    parts = [(t, *_steps(sampled.a, sampled.torque, sampled.noise, t)) for t in _parts(sampled)]
    _, before, after = sampled.rows
    held = [before, after] if sampled.rest > 0 else [after]
    # Rows of the states within a period over those at its beginning, and a factor of what noise has added since.
    states, added = np.eye(size)[:n], np.zeros((n, 0))
    for (_, count, free, forced, pushed), torque in zip(parts, held, strict=True):
        for _ in range(count):
            states = free @ states + np.outer(forced, torque)
            added = _joined(free @ added, pushed)
    transition = sampled.transition.copy()
    transition[:n] = states
    # The covariance at the samples as a factor, for the same reason as energies; the transposed sum.
    beside, back = sampled.settled
    start = beside @ np.vstack([added, np.zeros((size - n, added.shape[1]))])
    transition = beside @ transition @ back
    covariance = back @ energy_for_ever(transition.T, start.T).T
    states, added, row, total = np.eye(size)[:n], np.zeros((n, 0)), sampled.line_of_sight, 0.0

    def seen() -> float:
        return float(np.sum((row @ states @ covariance) ** 2) + np.sum((row @ added) ** 2))

    for (time, count, free, forced, pushed), torque in zip(parts, held, strict=True):
        squares = [seen()]
        for _ in range(count):
            states = free @ states + np.outer(forced, torque)
            added = _joined(free @ added, pushed)
            squares.append(seen())
        total += float(integrate.romb(np.array(squares), time / count))
    return Forward(total / sampled.period, float(np.abs(linalg.eigvals(transition)).max()))


def sampled_disagreement(model: SampledModel) -> tuple[float, float | None]:
    """Differences between the two routes for a stable loop: of its outermost pole, and relative ones of rms jitter [-].

    Jitter is None without a rational spectrum over all frequencies: what is counted over a band has one route only.
    """
    whole = replace(model, disturbances=_whole(model))
    other = forward(whole)
    # Both with the poles of the shaping filters, which may be the outermost.
    poles = [np.abs(d.filter.poles.real) for d in whole.disturbances if d.filter is not None]
    slowest = min((float(p.min()) for p in poles if p.size), default=inf)
    apart = abs(
        max(float(np.abs(model.bare.poles).max()), float(np.exp(-slowest * model.bare.period))) - other.radius
    )
    if not whole.disturbances:
        return apart, None
    value = sum(whole.variances.values())
    if value == other.variance:
        return apart, 0.0
    return apart, abs(value - other.variance) / (2 * max(value, other.variance))


def _whole(model: SampledModel) -> tuple[Disturbance, ...]:
    return tuple(d for d in model.disturbances if d.filter is not None and d.band == (0.0, inf))


def _parts(sampled: SampledLoop) -> list[float]:
    rest, period = sampled.rest, sampled.period
    return [rest, period - rest] if rest > 0 else [period]


def _joined(*factors: Array) -> Array:
    """A factor L of a sum of covariances L Lᵀ, with no more columns than rows."""
    whole = np.hstack(factors)
    if whole.shape[1] <= whole.shape[0]:
        return whole
    triangle: Array = linalg.qr(whole.T, mode="r")[0][: whole.shape[0]]
    return triangle.T


def _steps(a: Array, torque: Array, noise: Array, time: float) -> tuple[int, Array, Array, Array]:
    """Number of small steps, and what one does to states, held torque and covariance."""
    n = torque.size
    fastest = float(np.abs(linalg.eigvals(a)).max()) * time
    count = max(_STEPS, 2 ** int(np.ceil(np.log2(max(fastest, 1.0)))))
    step = time / count
    held = np.zeros((n + 1, n + 1))
    held[:n, :n], held[:n, n] = a, torque
    carried = linalg.expm(held * step)
    x, w = np.polynomial.legendre.leggauss(_NODES)
    pushed = [
        np.sqrt(0.5 * step * weight) * (linalg.expm(0.5 * step * (node + 1) * a) @ noise.T)
        for node, weight in zip(x, w, strict=True)
    ]
    return count, carried[:n, :n], carried[:n, n], _joined(*pushed)
