"""Jitter: rms line-of-sight error under random disturbances, with its exact differential.

For a transfer function H with simple poles p_i in the left half plane and residues r_i,

    J = (1/2π) ∫ |H(jω)|² dω = Σ_i r_i H(−p_i),    dJ = 2 Σ_i r_i dH(−p_i),

the second because only H(−s), which keeps still, has poles to the right [Gugercin2008]. No derivative of a pole
or of a residue appears, so the differential holds through mode crossings. Tabulated spectra, finite bands and
filters with repeated poles use a quadrature that is refined at every resonance [Johnston2005].
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import inf, pi

import numpy as np
from numpy.typing import NDArray

from fosopt.control import (
    COMMANDED,
    ClosedLoopPoles,
    Loop,
    Receptances,
    characteristic,
    closed_loop_response,
    numerator_of,
)
from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance, refuse_infinite_variance
from fosopt.metrics.functional import Functional, LoopModel, Points
from fosopt.ops import Array, ComplexArray, Dual

# Poles of filter and loop closer than this (relative) share a residue that loses as many digits.
_MEETING = 1e-4
PANEL = 20
"""Nodes per panel of `resonance_quadrature`, or per piece of one."""
_REACH = 6.0  # of a piece in u; 20 nodes leave 1e-11 of a resonance


@dataclass(frozen=True)
class Variance:
    """Mean square line-of-sight error [rad²] with its differential, a sum of functionals."""

    value: float
    functionals: tuple[Functional, ...]


def jitter_variances(
    model: LoopModel, poles: ClosedLoopPoles, disturbances: Sequence[Disturbance], shift: float = 0.0
) -> list[Variance]:
    """Mean square line-of-sight error of each disturbance.

    Parameters
    ----------
    shift
        Evaluate H(s + shift) instead of H(s), the shaping filter with the loop: finite for a loop whose poles lie left
        of `shift`, and the loop's own jitter at zero. Minimizing it while `shift` falls stabilizes a loop [rad/s].

    Raises
    ------
    UnstableError
        If a closed-loop pole does not lie left of `shift`: an unstable loop has no jitter.
    """
    poles.refuse_unstable(shift)
    for disturbance in disturbances:
        refuse_infinite_variance(disturbance, model.loop, poles.open_loop.drifting)
    # Two axes that are alike have double poles.
    single = model.loop.beside is None
    rational = [d for d in disturbances if single and d.by_residues and _apart(poles, d)]
    found = dict(zip((d.name for d in rational), _by_residues(model, poles, rational, shift), strict=True))
    return [found.get(d.name) or _by_quadrature(model, poles, d, shift) for d in disturbances]


def _apart(poles: ClosedLoopPoles, disturbance: Disturbance) -> bool:
    """Whether no pole of the shaping filter meets one of the loop, where residues of both grow without limit."""
    return bool(apart(poles.value, disturbance))


def apart(value: ComplexArray, disturbance: Disturbance) -> NDArray[np.bool_]:
    """(...,) The same for (..., m) poles, upper ones of their pairs."""
    assert disturbance.filter is not None
    own = disturbance.filter.poles[:, None]
    # Poles of a filter come with their conjugates, so that those of the loop need not.
    return np.all(np.abs(own - value[..., None, :]) > _MEETING * np.abs(own), axis=(-2, -1))


def pole_residues(model: LoopModel, poles: ClosedLoopPoles, response: str) -> ComplexArray:
    """(m,) Residues N(p)/Δ'(p) of a closed-loop transfer function at the poles the loop moves.

    Raises
    ------
    ModelError
        If the mirror has two axes, which may share poles.
    """
    if model.loop.beside is not None:
        raise ModelError("two axes: their poles may be double and have no residues; study one axis at a time")
    g = poles.receptances()
    slope = characteristic(model.loop, Dual(poles.value, 1.0), g).slope
    at_poles = Receptances.of([pair.value for pair in g.values])
    numerator = COMMANDED[response] if response in COMMANDED else numerator_of(response)
    return numerator(model.loop, poles.value, at_poles) / slope


def _by_residues(
    model: LoopModel, poles: ClosedLoopPoles, disturbances: Sequence[Disturbance], shift: float
) -> Iterator[Variance]:
    g = poles.receptances()
    slope = characteristic(model.loop, Dual(poles.value, 1.0), g).slope
    at_poles = poles.value, Receptances.of([pair.value for pair in g.values])
    responses = [d.at for d in disturbances]
    return residue_variances(model, at_poles, poles.multiplicity / slope, disturbances, responses, shift)


def residue_variances(
    model: LoopModel,
    at_poles: Place,
    strength: ComplexArray,
    disturbances: Sequence[Disturbance],
    responses: Sequence[str],
    shift: float,
) -> Iterator[Variance]:
    """Variances of rational spectra, all on the same points: mirrored poles of the loop and of the filters.

    Parameters
    ----------
    at_poles, strength
        (m,) as in `residue_terms`.
    responses
        The closed-loop transfer function each disturbance goes through.
    """
    filter_poles = model.points(poles_of_filters(disturbances))
    every: ComplexArray = np.concatenate([at_poles[0], filter_poles.s])
    mirrored = model.points(2 * shift - every)
    there = at_poles, (filter_poles.s, filter_poles.g), (mirrored.s, mirrored.g)
    terms = residue_terms(model.loop, disturbances, strength, *there, responses)
    for name, (weight, response) in zip(responses, terms, strict=True):
        value = float(np.sum(weight * response).real)
        yield Variance(value, (Functional(name, mirrored, 2 * weight),))


def poles_of_filters(disturbances: Sequence[Disturbance]) -> ComplexArray:
    """(f,) Poles of all shaping filters one after another [rad/s]."""
    none: ComplexArray = np.zeros(0, dtype=complex)
    return np.concatenate([none, *(d.filter.poles for d in disturbances if d.filter is not None)])


Place = tuple[ComplexArray, Receptances]
"""Points of the complex plane with the receptances there."""


def residue_terms(
    loop: Loop,
    disturbances: Sequence[Disturbance],
    strength: ComplexArray,
    at_poles: Place,
    at_filters: Place,
    at_mirrored: Place,
    responses: Sequence[str] | None = None,
) -> Iterator[tuple[ComplexArray, ComplexArray]]:
    """Terms r_i and H(−p_i) of J = Σ_i r_i H(−p_i) for each disturbance.    [Gugercin2008]

    All arrays may have leading axes, one loop to a line.

    Parameters
    ----------
    strength
        (..., m) multiplicity over Δ′ at the poles of the loop.
    at_poles, at_filters, at_mirrored
        (..., m) poles of the loop, (f,) poles of all filters, (..., m + f) the mirror images of both.
    responses
        The closed-loop transfer functions, by default those of where the disturbances enter.
    """
    filters = [d.filter for d in disturbances if d.filter is not None]
    owner = np.concatenate([np.full(f.poles.size, k) for k, f in enumerate(filters)] or [np.zeros(0)])
    own_residues = np.concatenate([np.zeros(0, dtype=complex), *(f.residues for f in filters)])
    below, below_mirrored = characteristic(loop, *at_filters), characteristic(loop, *at_mirrored)
    for k, (name, shape) in enumerate(zip(responses or [d.at for d in disturbances], filters, strict=True)):
        numerator = numerator_of(name)
        at_loop = strength * numerator(loop, *at_poles) * shape.response(at_poles[0])
        through = numerator(loop, *at_filters) / below
        at_filter = np.where(owner == k, through * own_residues, 0.0)
        weight = np.concatenate([at_loop, at_filter], axis=-1) * shape.response(at_mirrored[0])
        yield weight, numerator(loop, *at_mirrored) / below_mirrored


def _by_quadrature(
    model: LoopModel, poles: ClosedLoopPoles, disturbance: Disturbance, shift: float
) -> Variance:
    nodes, density = jitter_quadrature(poles, disturbance, shift)
    return quadrature_variance(model.points(1j * nodes + shift), density, disturbance.at)


def jitter_quadrature(
    poles: ClosedLoopPoles, disturbance: Disturbance, shift: float = 0.0
) -> tuple[Array, Array]:
    """Nodes of `resonance_quadrature` over what a disturbance counts [rad/s], and its power at each, weighted."""
    low, high = disturbance.counted
    cuts = disturbance.cuts
    own = disturbance.filter.poles if disturbance.filter is not None else np.zeros(0, complex)
    if poles.open_loop.drifting and low > 0:
        cuts = np.concatenate([cuts, drift_cuts(low, float(np.abs(poles.all).min()))])
    moved = np.concatenate([poles.all - shift, own - shift])
    nodes, weights = resonance_quadrature(moved, low, high, cuts)
    return nodes, weights / (2 * pi) * disturbance.one_sided_psd(nodes, shift)


def drift_cuts(low: float, slowest: float) -> Array:
    """(k,) Edges of panels of a decade each, over which a free rigid body's drift falls as a power of the frequency.

    Parameters
    ----------
    low, slowest
        The lowest frequency that is counted and the least size of a pole [rad/s].
    """
    decades = int(max(np.ceil(np.log10(slowest / low)), 0)) + 1
    edges: Array = low * 10.0 ** np.arange(float(decades))
    return edges


def quadrature_variance(points: Points, density: Array, response: str) -> Variance:
    """Mean square line-of-sight error through one closed-loop transfer function.

    Parameters
    ----------
    density
        (m,) power of the disturbance at each point, weight of the quadrature included [unit²].
    """
    answer = closed_loop_response(response, points.model.loop, points.s, points.g)
    functional = Functional(response, points, 2 * density * answer.conj())
    return Variance(float(np.sum(density * np.abs(answer) ** 2)), (functional,))


@lru_cache(maxsize=32)
def gauss(count: int) -> tuple[Array, Array]:
    """(count,), (count,) Nodes and weights of Gauss-Legendre quadrature on −1 to 1."""
    x, w = np.polynomial.legendre.leggauss(count)
    return x, w


def resonance_quadrature(poles: ComplexArray, low: float, high: float, cuts: Array) -> tuple[Array, Array]:
    """Nodes and weights for ∫ f(ω) dω from `low` to `high` with f resonant at the given poles.

    Each panel holds at most one resonance at ω₀ of half width σ; the substitution ω = ω₀ + σ sinh u makes the
    integrand smooth however narrow it is [Johnston2005].

    Parameters
    ----------
    cuts
        Further panel edges, such as the rows of a spectrum table [rad/s].

    Returns
    -------
    (m,), (m,)
        Nodes [rad/s] and weights.
    """
    size = np.abs(poles).max()
    centers = np.unique(np.concatenate([[0.0], poles.imag[poles.imag > 0]]))
    widths = np.array(
        [np.abs(poles.real[np.isclose(poles.imag, c, rtol=1e-12, atol=0)]).min(initial=inf) for c in centers]
    )
    widths = np.where(np.isfinite(widths), widths, np.abs(poles).min())
    top = 10 * size if high == inf else high
    middles = 0.5 * (centers[1:] + centers[:-1])
    # Well damped poles bend the integrand at their size, in whichever panel that is.
    damped = np.abs(poles[np.abs(poles.real) > np.abs(poles.imag)])
    inner = np.concatenate([middles, centers, cuts, damped, [2 * size]])
    edges = np.unique(np.concatenate([[low, top], inner[(inner > low) & (inner < top)]]))
    left, right = edges[:-1], edges[1:]
    nearest = np.searchsorted(middles, 0.5 * (left + right))
    center, width = centers[nearest], widths[nearest]
    x, w = gauss(PANEL)
    u0, u1 = np.arcsinh((left - center) / width), np.arcsinh((right - center) / width)
    # A panel that reaches many widths away is cut where the nodes would grow too sparse for the rest of the loop.
    pieces = np.maximum(np.ceil((u1 - u0) / _REACH), 1).astype(int)
    center, width, u0, step = (np.repeat(v, pieces) for v in (center, width, u0, (u1 - u0) / pieces))
    u0 += step * (np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces))
    half = 0.5 * step
    u = (u0 + half)[:, None] + half[:, None] * x
    nodes = (center[:, None] + width[:, None] * np.sinh(u)).ravel()
    weights = (half[:, None] * w * width[:, None] * np.cosh(u)).ravel()
    if high == inf:
        # The tail in t = top/ω, where the integrand is smooth.
        t, wt = 0.5 * (x + 1), 0.5 * w
        nodes = np.concatenate([nodes, top / t])
        weights = np.concatenate([weights, top * wt / t**2])
    return nodes, weights
