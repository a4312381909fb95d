"""Jitter: rms line-of-sight error under random disturbances, with its exact differential.

For a transfer function H with simple poles p_i in the left half plane and residues r_i,

    J = (1/2π) ∫ |H(jω)|² dω = Σ_i r_i H(−p_i),    dJ = 2 Σ_i r_i dH(−p_i),

the second because only H(−s), which keeps still, has poles to the right [Gugercin2008]. No derivative of a pole
or of a residue appears, so the differential holds through mode crossings. Tabulated spectra, finite bands and
filters with repeated poles use a quadrature that is refined at every resonance [Johnston2005].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi

import numpy as np

from fosopt.control import NUMERATORS, ClosedLoopPoles, characteristic, closed_loop_response
from fosopt.errors import UnstableError
from fosopt.metrics.disturbances import Disturbance, refuse_infinite_variance
from fosopt.metrics.functional import Functional, LoopModel, Points
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
    mirrored = model.points(2 * shift - poles.value)
    return [
        _by_residues(model, poles, disturbance, mirrored, shift)
        if disturbance.by_residues and _apart(poles, disturbance)
        else _by_quadrature(model, poles, disturbance, shift)
        for disturbance in disturbances
    ]


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
    g, slope = poles.receptances()
    s = poles.value
    delta = characteristic(
        model.loop, Dual(s, 1.0), type(g)(Dual(g.direct, slope.direct), Dual(g.cross, slope.cross))
    )
    return NUMERATORS[response](model.loop, s, g) / delta.slope


def _by_residues(
    model: LoopModel, poles: ClosedLoopPoles, disturbance: Disturbance, mirrored: Points, shift: float
) -> Variance:
    shape = disturbance.filter
    assert shape is not None
    own = poles.multiplicity * pole_residues(model, poles, disturbance.at) * shape.response(poles.value)
    groups = [(mirrored, own)]
    if shape.poles.size:
        at_filter = closed_loop_response(disturbance.at, model.loop, shape.poles, model.points(shape.poles).g)
        groups.append((model.points(2 * shift - shape.poles), at_filter * shape.residues))
    variance, functionals = 0.0, []
    for points, residues in groups:
        filtered = residues * shape.response(points.s)
        variance += float(
            np.sum(filtered * closed_loop_response(disturbance.at, model.loop, points.s, points.g)).real
        )
        functionals.append(Functional(disturbance.at, points, 2 * filtered))
    return Variance(variance, tuple(functionals))


def _by_quadrature(
    model: LoopModel, poles: ClosedLoopPoles, disturbance: Disturbance, shift: float
) -> Variance:
    low, high = disturbance.counted
    cuts = disturbance.frequency if disturbance.frequency is not None else np.zeros(0)
    own = disturbance.filter.poles if disturbance.filter is not None else np.zeros(0, complex)
    nodes, weights = resonance_quadrature(np.concatenate([poles.all - shift, own]), low, high, cuts)
    points = model.points(1j * nodes + shift)
    response = closed_loop_response(disturbance.at, model.loop, points.s, points.g)
    density = weights / (2 * pi) * disturbance.one_sided_psd(nodes)
    functional = Functional(disturbance.at, points, 2 * density * response.conj())
    return Variance(float(np.sum(density * np.abs(response) ** 2)), (functional,))


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
    x, w = np.polynomial.legendre.leggauss(_NODES)
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
