"""The least jitter any linear controller can leave.

The square of the line-of-sight error of a stabilizing controller is ∫ Φ |F − W|² plus a constant, see `open_loop`,
with F stable and strictly proper. For every g without poles in the left half plane ∫ F g* vanishes, hence

    J(F) = D(g) + (1/2π) ∫ Φ |F − F_g|² dω,     F_g = W − g/Φ,
    D(g) = J₀ + (1/2π) ∫ (2 Re W g* − |g|²/Φ) dω ≤ J(F).

Any g gives a lower bound D(g) that holds for each controller whatever a solver did to find g. The best g has the
mirrored poles of the spectra alone, so that for rational spectra a least squares problem of that size finds the
limit itself; F_g is then Wiener's causal filter. A zero z of the plant in the right half plane forces F(z) = 0, one
more condition orthogonal to 1/(s + z).                                                 [Kailath2000, Youla1976]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from fosopt.errors import SolverError
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.functional import LoopModel
from fosopt.ops import Array, ComplexArray
from fosopt.relax.bound import Bound
from fosopt.relax.open_loop import OpenLoop, Spectra, open_loop

TOLERANCE = 1e-6
# Directions of the least squares problem weaker than this are left out: the bound stays one.
_WEAKEST = 1e-13
_REAL_POLES = 32
# Two other routes to the limit differ by less than this share of its square.
_ROUNDING = 1e-8


@dataclass(frozen=True)
class PerformanceLimit:
    """The limit of performance of a loop's plant under its disturbances.

    Attributes
    ----------
    bound
        On the total jitter of any controller [rad].
    noncausal
        What a filter that knows the future of the measurement leaves over [rad].
    open_loop
        What it is the limit of.
    coefficients
        (n,) of the functions `annihilators` that make up g.
    """

    bound: Bound
    noncausal: float
    open_loop: OpenLoop
    coefficients: Array

    def annihilator(self, spectra: Spectra) -> ComplexArray:
        """(m,) g at the nodes of `spectra`."""
        return annihilators(self.open_loop, spectra.nodes.frequency) @ self.coefficients

    def lack(self, spectra: Spectra) -> ComplexArray:
        """(m,) 1 − F_g, what the limit's filter lacks to one."""
        g = self.annihilator(spectra)
        counts = spectra.measured > 0
        return spectra.lack + np.divide(g, spectra.measured, out=np.zeros_like(g), where=counts)

    def variance(self, spectra: Spectra) -> float:
        """D(g) on the nodes of `spectra` [rad²]."""
        rows, target, constant = _least_squares(self.open_loop, spectra)
        return constant + _gain(rows @ self.coefficients, target)


def performance_limit(model: LoopModel, disturbances: Sequence[Disturbance]) -> PerformanceLimit:
    """Lower bound on the total jitter of every stabilizing linear controller fed with the measured angle.

    The loop's own controller does not matter. No controller of the plant, of whatever order, goes below; controllers
    of growing bandwidth come as close as one likes. Under Gaussian disturbances nonlinear controllers cannot either.

    Raises
    ------
    UnstableError
        If structure and mirror do not come to rest by themselves.
    ModelError
        If there is no disturbance, or one has infinite variance under any controller.
    SolverError
        If the least-squares problem has no solution in double precision.
    """
    loop = open_loop(model, disturbances)
    spectra = loop.spectra(loop.nodes(TOLERANCE))
    rows, target, constant = _least_squares(loop, spectra)
    size = np.linalg.norm(rows, axis=0)
    scale = np.where(size > 0, size, 1.0)
    try:
        coefficients = np.linalg.lstsq(rows / scale, target, rcond=_WEAKEST)[0] / scale
    except np.linalg.LinAlgError as failure:
        raise SolverError(f"least squares of the limit: {failure}; give each mode more damping") from failure
    found = constant + _gain(rows @ coefficients, target)
    rows, target, noncausal = _least_squares(loop, loop.spectra(spectra.nodes.halved))
    again = noncausal + _gain(rows @ coefficients, target)
    allowance = abs(found - again) + _ROUNDING * again
    value = sqrt(max(min(found, again) - allowance, 0.0))
    bound = Bound(
        value,
        "total jitter over all stabilizing linear controllers fed with the measured angle",
        _assumptions(loop),
        sqrt(max(again, 0.0)) - value,
    )
    return PerformanceLimit(bound, sqrt(noncausal), loop, coefficients)


def _assumptions(loop: OpenLoop) -> tuple[str, ...]:
    said = [
        "the structure, the mirror and the disturbances are as modeled and the disturbances independent",
        "the control torque is unlimited",
    ]
    if not loop.counted_everywhere:
        said.append(
            "frequencies outside the counted bands cost nothing, so that causality costs nothing either"
        )
    return tuple(said)


def annihilators(loop: OpenLoop, frequency: Array) -> ComplexArray:
    """(m, n) Functions orthogonal to every F a stabilizing controller can give, real for real s, at s = jω.

    None where some frequencies do not count: F is free there, and only zero is orthogonal to all of it.
    """
    s = 1j * frequency
    columns: list[ComplexArray] = []
    if not loop.counted_everywhere:
        return np.zeros((s.size, 0), dtype=complex)
    corner = _corner(loop)
    rolled = (corner / (corner - s)) ** _rolloff(loop)
    poles = loop.spectral_poles
    if not all(d.by_residues for d in loop.disturbances):
        # Spectra without poles of their own are met by real ones at all scales.
        size = np.abs(poles)
        poles = np.append(poles, -np.geomspace(0.1 * size.min(), 10 * size.max(), _REAL_POLES))
    for pole in poles:
        columns += _pair(s, -pole.conjugate(), rolled)
    if loop.drifting:
        columns.append(rolled / s)
    for zero in loop.zeros:
        columns += _pair(s, -zero, np.ones_like(s))
    return np.column_stack(columns)


def _pair(s: ComplexArray, pole: complex, factor: ComplexArray) -> list[ComplexArray]:
    """The real functions with this pole and its conjugate."""
    own = factor / (s - pole)
    if pole.imag == 0:
        return [own]
    other = factor / (s - pole.conjugate())
    return [own + other, 1j * (own - other)]


def _corner(loop: OpenLoop) -> float:
    """A frequency in the middle of all [rad/s]."""
    return float(np.median(np.abs(loop.spectral_poles)))


def _rolloff(loop: OpenLoop) -> int:
    """Powers of ω by which the amplitude of the measured spectrum falls off; g has to fall with it."""
    torque = {"mirror_torque": 2, "hub_torque": 3}
    falls = [
        torque.get(d.at, 0) + d.filter.relative_degree
        for d in loop.disturbances
        if d.filter is not None and d.counted[1] == inf
    ]
    return min(falls)


def _least_squares(loop: OpenLoop, spectra: Spectra) -> tuple[Array, Array, float]:
    """Rows and target of the least squares problem whose solution is the best g, and J₀.

    A stable F₀ with the plant's zeros and F₀(0) = 1 is taken off W first, which g does not see: what remains has
    finite energy even where a free rigid body drifts.
    """
    frequency, weight = spectra.nodes.frequency, spectra.nodes.weight
    s = 1j * frequency
    amplitude = np.sqrt(weight * spectra.measured)
    counts = amplitude > 0
    zeros = np.concatenate([loop.zeros, loop.zeros[loop.zeros.imag > 0].conj()])
    mirrored = np.prod((zeros - s[:, None]) / (zeros + s[:, None]), axis=1)
    start = mirrored * (1 - (s / (s + _corner(loop))) ** 2)
    target = amplitude * ((1 - start) - spectra.lack)
    scale = np.divide(weight, amplitude, out=np.zeros_like(amplitude), where=counts)
    rows = scale[:, None] * annihilators(loop, frequency)
    return (
        np.concatenate([rows.real, rows.imag]),
        np.concatenate([target.real, target.imag]),
        float(np.sum(weight * spectra.unavoidable)),
    )


def _gain(fitted: Array, target: Array) -> float:
    """2 ⟨W, g⟩ − ⟨g, g⟩ from g and W over the root of the spectrum."""
    return float(2 * fitted @ target - fitted @ fitted)
