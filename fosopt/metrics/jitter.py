"""Jitter: rms line-of-sight error under random disturbances, with its exact differential.

For a transfer function H with simple poles p_i in the left half plane and residues r_i,

    J = (1/2π) ∫ |H(jω)|² dω = Σ_i r_i H(−p_i),    dJ = 2 Σ_i r_i dH(−p_i),

the second because only H(−s), which keeps still, has poles to the right [Gugercin2008]. No derivative of a pole
or of a residue appears, so the differential holds through mode crossings. Tabulated spectra, finite bands and
filters with repeated poles use a quadrature that is refined at every resonance [Johnston2005].
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import inf, pi

import numpy as np

from fosopt.control import NUMERATORS, ClosedLoopPoles, Receptances, characteristic, closed_loop_response
from fosopt.errors import UnstableError
from fosopt.metrics.disturbances import Disturbance, refuse_infinite_variance
from fosopt.metrics.functional import Functional, LoopModel
from fosopt.ops import Array, ComplexArray, Dual

# Poles of filter and loop closer than this (relative) share a residue that loses as many digits.
_MEETING = 1e-4
_NODES = 20  # per half panel; 20 leave 1e-10 of a resonance a thousand times narrower than its panel


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
        Evaluate H(s + shift) instead of H(s): finite for a loop whose poles lie left of `shift`, and the loop's
        own jitter at zero. Minimizing it while `shift` falls stabilizes a loop [rad/s].

    Raises
    ------
    UnstableError
        If a closed-loop pole does not lie left of `shift`: an unstable loop has no jitter.
    """
    if not poles.spectral_abscissa < shift:
        raise UnstableError(
            f"closed loop is unstable: a pole has the real part {poles.spectral_abscissa:.6g} rad/s"
        )
    for disturbance in disturbances:
        refuse_infinite_variance(disturbance, model.loop, poles.open_loop.drifting)
    rational = [d for d in disturbances if d.by_residues and _apart(poles, d)]
    found = dict(zip((d.name for d in rational), _by_residues(model, poles, rational, shift), strict=True))
    return [found.get(d.name) or _by_quadrature(model, poles, d, shift) for d in disturbances]


def _apart(poles: ClosedLoopPoles, disturbance: Disturbance) -> bool:
    """Whether no pole of the shaping filter meets one of the loop, where residues of both grow without limit."""
    shape = disturbance.filter
    assert shape is not None
    if not shape.poles.size:
        return True
    known = np.concatenate([poles.value, poles.value.conj()])
    return bool(np.all(np.abs(shape.poles[:, None] - known) > _MEETING * np.abs(shape.poles)[:, None]))


def pole_residues(model: LoopModel, poles: ClosedLoopPoles, response: str) -> ComplexArray:
    """(m,) Residues N(p)/Δ'(p) of a closed-loop transfer function at the poles the loop moves."""
    return _residues(model, poles, [response])[response]


def _residues(model: LoopModel, poles: ClosedLoopPoles, responses: Iterable[str]) -> dict[str, ComplexArray]:
    g = poles.receptances()
    slope = characteristic(model.loop, Dual(poles.value, 1.0), g).slope
    at_poles = Receptances.of([pair.value for pair in g.values])
    return {name: NUMERATORS[name](model.loop, poles.value, at_poles) / slope for name in set(responses)}


def _by_residues(
    model: LoopModel, poles: ClosedLoopPoles, disturbances: Sequence[Disturbance], shift: float
) -> Iterator[Variance]:
    """Variances of rational spectra, all on the same points: mirrored poles of the loop and of the filters."""
    residues = _residues(model, poles, (d.at for d in disturbances))
    filters = [d.filter for d in disturbances if d.filter is not None]
    none: ComplexArray = np.zeros(0, dtype=complex)
    filter_poles = model.points(np.concatenate([none, *(f.poles for f in filters)]))
    filter_residues = np.concatenate([none, *(f.residues for f in filters)])
    owner = np.concatenate([none, *(np.full(f.poles.size, k) for k, f in enumerate(filters))])
    every: ComplexArray = np.concatenate([poles.value, filter_poles.s])
    mirrored = model.points(2 * shift - every)
    loop = model.loop
    at_filters = characteristic(loop, filter_poles.s, filter_poles.g)
    at_mirrored = characteristic(loop, mirrored.s, mirrored.g)
    for k, (disturbance, shape) in enumerate(zip(disturbances, filters, strict=True)):
        at_loop = poles.multiplicity * residues[disturbance.at] * shape.response(poles.value)
        numerator = NUMERATORS[disturbance.at]
        through = numerator(loop, filter_poles.s, filter_poles.g) / at_filters
        at_filter = np.where(owner == k, through * filter_residues, 0.0)
        weight = np.concatenate([at_loop, at_filter]) * shape.response(mirrored.s)
        response = numerator(loop, mirrored.s, mirrored.g) / at_mirrored
        value = float(np.sum(weight * response).real)
        yield Variance(value, (Functional(disturbance.at, mirrored, 2 * weight),))


def _by_quadrature(
    model: LoopModel, poles: ClosedLoopPoles, disturbance: Disturbance, shift: float
) -> Variance:
    low, high = disturbance.counted
    cuts = disturbance.frequency if disturbance.frequency is not None else np.zeros(0)
    own = disturbance.filter.poles if disturbance.filter is not None else np.zeros(0, complex)
    if poles.open_loop.drifting and low > 0:
        # A free rigid body's drift falls as a power of the frequency, from the lower edge on: panels of a decade each.
        slowest = np.abs(poles.all).min()
        decades = int(max(np.ceil(np.log10(slowest / low)), 0)) + 1
        cuts = np.concatenate([cuts, low * 10.0 ** np.arange(decades)])
    nodes, weights = resonance_quadrature(np.concatenate([poles.all - shift, own]), low, high, cuts)
    points = model.points(1j * nodes + shift)
    response = closed_loop_response(disturbance.at, model.loop, points.s, points.g)
    density = weights / (2 * pi) * disturbance.one_sided_psd(nodes)
    functional = Functional(disturbance.at, points, 2 * density * response.conj())
    return Variance(float(np.sum(density * np.abs(response) ** 2)), (functional,))


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
    inner = np.concatenate([middles, centers, cuts, [2 * size]])
    edges = np.unique(np.concatenate([[low, top], inner[(inner > low) & (inner < top)]]))
    left, right = edges[:-1], edges[1:]
    nearest = np.searchsorted(middles, 0.5 * (left + right))
    center, width = centers[nearest], widths[nearest]
    x, w = gauss(_NODES)
    u0, u1 = np.arcsinh((left - center) / width), np.arcsinh((right - center) / width)
    half = 0.5 * (u1 - u0)
    u = 0.5 * (u1 + u0)[:, None] + half[:, None] * x
    nodes = (center[:, None] + width[:, None] * np.sinh(u)).ravel()
    weights = (half[:, None] * w * width[:, None] * np.cosh(u)).ravel()
    if high == inf:
        # The tail in t = top/ω, where the integrand is smooth.
        t, wt = 0.5 * (x + 1), 0.5 * w
        nodes = np.concatenate([nodes, top / t])
        weights = np.concatenate([weights, top * wt / t**2])
    return nodes, weights
