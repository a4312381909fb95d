"""Lower bounds on jitter in which a structure appears only through |H| in the right half plane.

Let S be the spectrum of the line-of-sight error without control, R = r ω²/(ω² + a²) that of the noise and
Φ = R + S. The limit of performance (`log_integral`) is r (μ + ψ(q)),

    μ = (1/2π) ∫ log(Φ/r) dω,    ψ(q) = a (1/q − 1/8q² − 1/2),    log q = ½ ∫ P_a log(Φ/r) dω,

with Poisson's kernel P_c(ω) = Re c/π|c − jω|², here at c = a. ψ is convex in log q for q ≥ ½, which holds since
Φ ≥ R, so that its tangent at any q₀ ≥ ½ bounds the limit from below by

    r ψ₀ + (r/2π) ∫ v log(Φ/r) dω,     v = 1 − b a²/(a² + ω²) ≥ 0,     b = 1/q₀ − 1/4q₀²,     ψ₀ = ψ(q₀) + a b log q₀.

The logarithm is concave. With Φ₀ what no structure changes and H_i the responses to torques through their filters,

    v log(Φ/r) ≥ τ₀ log(Φ₀ v/r τ₀) + Σ_i τ_i log(|H_i|² v/r τ_i)     for all τ ≥ 0 with τ₀ + Σ_i τ_i = v.

And log|H_i| is subharmonic where H_i has no poles: with τ_i = Σ_j w_ij P_{c_j} and w ≥ 0,

    ∫ τ_i log|H_i|² dω ≥ Σ_j w_ij log|H_i(c_j)|²,                                             [Seron1997]

whatever zeros H_i has. What is left of a structure is its response at c_j, away from all resonances. Any w ≥ 0 with
Σ_i τ_i ≤ v is a bound for every structure and every controller; the best one maximizes a concave function.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, log, pi

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance
from fosopt.ops import Array, ComplexArray
from fosopt.relax.quadrature import Nodes, nodes

# Grid on which weights are chosen: step of log ω, and how far beyond the points it goes.
_STEP, _BEYOND = 0.05, 1e3
# Panels of the quadrature per unit of log ω.
_PANELS = 4
# The barrier method: precision of the last round and of those before, and how it goes there.
_FINE, _ROUGH, _SPARSE = 1e-6, 1e-3, 3
# Range of log q₀, also around one that was the best elsewhere, and how closely the best one is looked for.
_TANGENTS, _NEAR, _TANGENT = (log(0.5), 4.0), 0.4, 0.15
_FALL, _NEWTON, _CENTERED = 0.15, 40, 1e-2
_INSIDE, _UPHILL, _SHORTEST, _RIDGE = 0.95, 1e-4, 1e-10, 1e-13
_ROOM, _ROUNDING = 1e-9, 1e-9
Known = NDArray[np.bool_]


@dataclass(frozen=True)
class Sources:
    """Disturbances as the bound sees them.

    Attributes
    ----------
    torques
        Those that come through the structure or the mirror's spring.
    fixed
        The noise, and displacements of the line of sight.
    density, corner
        r [rad² s] and a [rad/s] of the noise; a is zero for white noise.
    left_out
        Names of those that count for nothing, which only lowers the bound.
    """

    torques: tuple[Disturbance, ...]
    fixed: tuple[Disturbance, ...]
    density: float
    corner: float
    left_out: tuple[str, ...]

    def background(self, frequency: Array) -> Array:
        """(m,) Φ₀/r."""
        total = np.zeros_like(frequency)
        for disturbance in self.fixed:
            low, high = disturbance.counted
            counts = (frequency >= low) & (frequency <= high)
            total += np.where(counts, 0.5 * disturbance.one_sided_psd(frequency), 0.0)
        return total / self.density

    def filters(self, points: ComplexArray) -> Array:
        """(torques, n) log(|F|²/r) of their filters."""
        shapes = [d.filter for d in self.torques if d.filter is not None]
        found = [np.log(np.abs(f.response(points)) ** 2 / self.density) for f in shapes]
        return np.array(found).reshape(len(found), points.size)

    def points(self) -> ComplexArray:
        """(n,) Points at which responses are looked at, in fans between the real and the imaginary axis [rad/s]."""
        shapes = [d.filter for d in (*self.torques, *self.fixed) if d.filter is not None]
        size = np.abs(np.concatenate([f.poles for f in shapes]))
        low, high = size.min() / _LOWEST, size.max() * _HIGHEST
        decades = np.log10(high / low)
        fans = []
        for degrees, density in _FANS:
            rates = np.geomspace(low, high, int(density * decades) + 1)
            fans.append(rates * np.exp(1j * np.radians(degrees)))
        return np.concatenate(fans)


_LOWEST, _HIGHEST = 50.0, 15.0
_FANS = ((0.0, 6), (45.0, 6), (70.0, 6), (80.0, 12), (85.0, 12))  # angle, points per decade


def sources(disturbances: Sequence[Disturbance]) -> Sources:
    """Sort disturbances.

    Raises
    ------
    ModelError
        If no sensor noise is white or a high pass of first order.
    """
    noises = [d for d in disturbances if d.at == "sensor_noise" and _simple(d)]
    if not noises:
        raise ModelError(
            "the joint bound needs sensor noise that is white or a high pass of first order, counted at all frequencies"
        )
    densities = [(d.filter.numerator[0] / d.filter.denominator[0]) ** 2 for d in noises if d.filter]
    loudest = int(np.argmax(densities))
    noise = noises[loudest]
    poles = noise.filter.poles if noise.filter is not None else np.zeros(0)
    torques = [d for d in disturbances if "torque" in d.at and d.filter and d.band == (0.0, inf)]
    displaced = [d for d in disturbances if d.at == "line_of_sight"]
    used = {noise.name, *(d.name for d in (*torques, *displaced))}
    return Sources(
        tuple(torques),
        (noise, *displaced),
        densities[loudest],
        float(-poles.real.sum()),
        tuple(d.name for d in disturbances if d.name not in used),
    )


def _simple(noise: Disturbance) -> bool:
    """Whether a spectrum is r, or r ω²/(ω² + a²)."""
    shape = noise.filter
    if shape is None or noise.band != (0.0, inf) or shape.relative_degree:
        return False
    return shape.poles.size == shape.zeros_at_origin <= 1


def kernels(frequency: Array, points: ComplexArray) -> Array:
    """(m, n) Poisson's kernels, even in ω, of integral one over the whole axis [s]."""
    w = frequency[:, None]
    both = 1 / np.abs(points - 1j * w) ** 2 + 1 / np.abs(points + 1j * w) ** 2
    return np.asarray((0.5 / pi) * points.real * both)


@dataclass(frozen=True)
class Weights:
    """One bound on the mean square: constant + factor Σ w log(|H F|²/r).

    Attributes
    ----------
    weight
        (torques, n) w [rad/s].
    constant, factor
        [rad²] and r/2π [rad² s].
    allowance
        Of the quadrature, taken off already [rad²].
    touch
        log q₀.
    """

    weight: Array
    constant: float
    factor: float
    allowance: float
    touch: float


@dataclass(frozen=True)
class _Tangent:
    """v, and ψ₀ [rad/s]."""

    corner: float
    bend: float
    start: float

    def __call__(self, frequency: Array) -> Array:
        square = self.corner**2
        return np.asarray((frequency**2 + (1 - self.bend) * square) / (frequency**2 + square))


def best_weights(
    of: Sources, points: ComplexArray, logarithms: Array, known: Known, near: float | None = None
) -> Weights:
    """Weights that give a high bound where log(|H_i F_i|²/r) at the points is (torques, n) `logarithms`.

    Parameters
    ----------
    known
        (torques, n) where it is; elsewhere weights are zero.
    near
        log q₀ of weights that were good at a similar structure.
    """
    low, high = np.abs(points).min() / _BEYOND, np.abs(points).max() * _BEYOND
    grid = np.exp(np.arange(log(low), log(high), _STEP))
    share = 2 * _STEP * grid
    background, kernel = of.background(grid), kernels(grid, points)

    def chosen(tangent: _Tangent, every: int, precision: float) -> tuple[Array, float]:
        some = slice(None, None, every)
        terms = every * share[some], tangent(grid[some]), background[some], kernel[some]
        weight, best = _maximize(*terms, logarithms, known, precision)
        return weight, 2 * pi * tangent.start + best

    tangent, touch = _tangent(0.0, 0.0), 0.0
    if of.corner:
        found = optimize.minimize_scalar(
            lambda p: -chosen(_tangent(of.corner, p), _SPARSE, _ROUGH)[1],
            bounds=_TANGENTS if near is None else (max(near - _NEAR, _TANGENTS[0]), near + _NEAR),
            method="bounded",
            options={"xatol": _TANGENT},
        )
        touch = float(found.x)
        tangent = _tangent(of.corner, touch)
    weight, _ = chosen(tangent, 1, _FINE)

    own = [d.filter.poles for d in of.fixed if d.filter is not None]
    # Kernels are as wide as their points are far from the imaginary axis, which panels of equal ratio resolve.
    poles = np.concatenate([[-high], *(p[p.imag >= 0] for p in own)])
    panels = np.geomspace(low, high, int(_PANELS * log(high / low)))
    tables = [d.frequency for d in of.fixed if d.frequency is not None]
    edges = np.array([edge for d in of.fixed for edge in d.counted if 0 < edge < inf])
    first = nodes(poles, 0.0, inf, np.concatenate([panels, edges, *tables]))
    twice = first.halved
    crowded = max(
        float((kernels(n.frequency, points) @ weight.sum(axis=0) / tangent(n.frequency)).max())
        for n in (first, twice)
    )
    weight = weight * min(1.0, (1 - _ROOM) / crowded) if crowded > 0 else weight
    found, again = (_constant(of, points, weight, tangent, n) for n in (first, twice))
    allowance = abs(found - again) + _ROUNDING * (abs(again) + of.density * abs(tangent.start))
    return Weights(weight, min(found, again) - allowance, of.density / (2 * pi), allowance, touch)


def _tangent(corner: float, p: float) -> _Tangent:
    """The one that touches ψ at q₀ = exp p."""
    bend = exp(-p) - 0.25 * exp(-2 * p)
    return _Tangent(corner, bend, corner * (exp(-p) - 0.125 * exp(-2 * p) - 0.5 + bend * p))


def _constant(of: Sources, points: ComplexArray, weight: Array, tangent: _Tangent, n: Nodes) -> float:
    """What does not depend on the structure [rad²]."""
    v = tangent(n.frequency)
    tau = kernels(n.frequency, points) @ weight.T
    rest = v - tau.sum(axis=1)
    value = rest * np.log(of.background(n.frequency) * v / rest)
    ratio = np.where(tau > 0, tau, 1.0) / np.where(tau > 0, v[:, None], 1.0)
    value = value - (tau * np.log(ratio)).sum(axis=1)
    return of.density * (tangent.start + float(n.weight @ value))


def _maximize(
    share: Array,
    v: Array,
    background: Array,
    kernel: Array,
    gain: Array,
    known: Known,
    precision: float,
) -> tuple[Array, float]:
    """Barrier method for Σ share (−τ₀ log(τ₀/Φ₀v) − Σ τ_i log(τ_i/v)) + Σ w gain over w ≥ 0 and τ₀ ≥ 0.

    However far it comes, its answer is admissible.    [Boyd2004] Sec. 11.3

    Returns
    -------
    (torques, n), ()
        The weights w, and the value.
    """
    m, n = gain.shape
    used = np.flatnonzero(known.ravel())
    weight = np.zeros(m * n)
    if not used.size:
        return weight.reshape(m, n), float(share @ (v * np.log(background)))
    owner, column = used // n, used % n
    scale = 1 / np.max(kernel / v[:, None], axis=0)[column]
    q = kernel[:, column] * scale
    gains = gain.ravel()[used] * scale
    parts = [np.flatnonzero(owner == i) for i in np.unique(owner)]
    z = np.full(used.size, 0.5 / np.max(q.sum(axis=1) / v))

    def value(z: Array, barrier: float) -> float:
        tau = [q[:, p] @ z[p] for p in parts]
        rest = v - sum(tau)
        if np.any(rest <= 0) or np.any(z <= 0):
            return -inf
        entropy = -rest * np.log(rest / (background * v)) - sum(t * np.log(t / v) for t in tau)
        return float(share @ entropy + gains @ z + barrier * (np.log(z).sum() + np.log(rest / v).sum()))

    count = z.size + v.size
    barrier = max(abs(value(z, 0.0)), float(share.min())) / count
    least = barrier * precision
    while barrier > least:
        barrier *= _FALL
        for _ in range(_NEWTON):
            tau = [q[:, p] @ z[p] for p in parts]
            rest = v - sum(tau)
            slope = q.T @ (share * np.log(rest / (background * v)) - barrier / rest) + gains + barrier / z
            curve = q.T @ (q * (share / rest + barrier / rest**2)[:, None])
            for t, p in zip(tau, parts, strict=True):
                slope[p] -= q[:, p].T @ (share * np.log(t / v))
                curve[np.ix_(p, p)] += q[:, p].T @ (q[:, p] * (share / t)[:, None])
            curve = z[:, None] * curve * z
            curve[np.diag_indices(z.size)] += barrier
            size = 1 / np.sqrt(np.diag(curve))
            scaled = curve * size[:, None] * size
            scaled[np.diag_indices(z.size)] += _RIDGE
            step = z * size * linalg.solve(scaled, size * z * slope, assume_a="sym")
            gained = float(slope @ step)
            if gained < _CENTERED * count * barrier:
                break
            length = min(1.0, _longest(z, step), _longest(rest, -(q @ step)))
            here = value(z, barrier)
            while not value(z + length * step, barrier) >= here + _UPHILL * length * gained:
                length *= 0.5
                if length < _SHORTEST:
                    break
            if length < _SHORTEST:
                break
            z = z + length * step
    weight[used] = z * scale
    return weight.reshape(m, n), value(z, 0.0)


def _longest(value: Array, step: Array) -> float:
    """How far positive values can move along a step and stay so, with room."""
    falls = step < 0
    return _INSIDE * float(np.min(-value[falls] / step[falls], initial=inf))
