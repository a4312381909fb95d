"""A controller close to the limit of performance, with margins: an upper bound on the limit.

Over the stable F = G Q of `open_loop`, which is the complementary sensitivity, jitter is a convex quadratic, and discs
|1 − F| ≤ M_S and |F| ≤ M_T at each frequency are convex as well [Boyd1991]. F is a sum of Takenaka and Malmquist's
functions, Laguerre functions with poles spread evenly on a logarithmic scale: one second-order cone program finds
the best sum. F falls off as 1/s², so that Q and the controller K = Q/(1 − F) are proper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, isfinite, sqrt

import clarabel
import numpy as np
from scipy import linalg

from fosopt.errors import ModelError, SolverError
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.functional import LoopModel
from fosopt.ops import Array, ComplexArray
from fosopt.relax.multipliers import solved
from fosopt.relax.open_loop import OpenLoop, Spectra
from fosopt.relax.performance_limit import PerformanceLimit, performance_limit

_TOLERANCE = 1e-4
# Ends of the range of poles that are tried, as powers of ten about the corner at which noise takes over.
_BELOW, _ABOVE = (-3.0, -2.0, -1.5, -1.0, -0.5), (0.5, 1.0, 1.5, 2.0)
_GRID = 300
_DENSER = 10
_ROUNDS = 4
_PEAK = 1e-4  # by which a peak between grid points may pass its limit, relative
_WEAKEST = 1e-12


@dataclass(frozen=True)
class YoulaDesign:
    """A linear controller of high order, with what it was verified to reach.

    Attributes
    ----------
    jitter
        Total, recomputed from the frequency response [rad].
    sensitivity_peak, complementary_peak
        Largest |S| and |T|, recomputed [-].
    limit
        The limit of performance, which it bounds from above.
    poles
        (n,) corners of the basis, the last one that of the roll-off [rad/s].
    coefficients
        (n − 1,) of the basis.
    """

    jitter: float
    sensitivity_peak: float
    complementary_peak: float
    limit: PerformanceLimit
    poles: Array
    coefficients: Array

    def complementary_sensitivity(self, s: ComplexArray) -> ComplexArray:
        """(m,) T(s) = F(s)."""
        start, basis = _basis(self.limit.open_loop, s, self.poles)
        return start + basis @ self.coefficients

    def controller_response(self, s: ComplexArray) -> ComplexArray:
        """(m,) K(s) = T/(G S), torque per line-of-sight error [N m/rad]."""
        closed = self.complementary_sensitivity(s)
        return self.limit.open_loop.impedance(s) * closed / (1 - closed)


def youla(
    model: LoopModel,
    disturbances: Sequence[Disturbance],
    *,
    order: int = 32,
    ms: float = inf,
    mt: float = inf,
) -> YoulaDesign:
    """The controller of least jitter among those whose complementary sensitivity is a sum of `order` functions.

    Parameters
    ----------
    ms, mt
        Largest sensitivity and complementary sensitivity; 1/ms is the modulus margin [-].

    Raises
    ------
    UnstableError
        If structure and mirror do not come to rest by themselves.
    ModelError
        If a limit cannot be met by any controller, the sensor is not on the mirror, there is no disturbance, or one
        has infinite variance under any controller.
    SolverError
        If the cone program is not solved.
    """
    if not ms > 1 or not mt > 1:
        raise ModelError(
            f"ms = {ms:.6g} and mt = {mt:.6g}: no controller keeps the peaks of S or T at one or below; raise them"
        )
    if order < 1:
        raise ModelError(f"order {order}: the basis needs one function or more")
    if model.loop.placement.sensor is not None:
        raise ModelError(
            "a Youla design takes the line of sight for what is measured; put the sensor on the mirror"
        )
    limit = performance_limit(model, disturbances)
    loop = limit.open_loop
    spectra = loop.spectra(loop.nodes(_TOLERANCE))
    poles = _best_poles(limit, spectra, order)
    rows, target = _cost(limit, spectra, poles)
    grid = np.geomspace(1e-2 * poles[0], 1e2 * poles[-1], _GRID)
    finer = np.geomspace(grid[0], grid[-1], _DENSER * _GRID)
    for _ in range(_ROUNDS):
        coefficients = _solve(loop, rows, target, poles, grid, ms, mt)
        start, basis = _basis(loop, 1j * finer, poles)
        closed = start + basis @ coefficients
        high = (np.abs(1 - closed) > ms * (1 + _PEAK)) | (np.abs(closed) > mt * (1 + _PEAK))
        if not high.any():
            break
        grid = np.union1d(grid, finer[high])
    denser = loop.spectra(spectra.nodes.halved)
    s = 1j * denser.nodes.frequency
    start, basis = _basis(loop, s, poles)
    error = 1 - (start + basis @ coefficients) - denser.lack
    density = denser.nodes.weight * (denser.measured * np.abs(error) ** 2 + denser.unavoidable)
    jitter = sqrt(float(density.sum()))
    limit.bound.hold(jitter, "the Youla design")
    return YoulaDesign(
        jitter,
        float(np.abs(1 - closed).max()),
        float(np.abs(closed).max()),
        limit,
        poles,
        coefficients,
    )


def _basis(loop: OpenLoop, s: ComplexArray, poles: Array) -> tuple[ComplexArray, ComplexArray]:
    """(m,) and (m, n − 1): a function with F(0) = 1 where F has to be one at zero, and those added to it."""
    rolled = poles[-1] / (s + poles[-1])
    if loop.drifting:
        start, common = (poles[0] / (s + poles[0])) ** 2, rolled * s / (s + poles[0])
    else:
        start, common = np.zeros_like(s), rolled
    columns = []
    for pole in poles[:-1]:
        columns.append(common * sqrt(2 * pole) / (s + pole))
        common = common * (s - pole) / (s + pole)
    return start, np.column_stack(columns)


def _cost(limit: PerformanceLimit, spectra: Spectra, poles: Array) -> tuple[Array, Array]:
    """Triangular rows and target: jitter is the squared distance plus what no coefficient changes."""
    amplitude = np.sqrt(spectra.nodes.weight * spectra.measured)
    start, basis = _basis(limit.open_loop, 1j * spectra.nodes.frequency, poles)
    rows = amplitude[:, None] * basis
    target = amplitude * (1 - start - limit.lack(spectra))
    real = np.column_stack([np.vstack([rows.real, rows.imag]), np.concatenate([target.real, target.imag])])
    triangle = linalg.qr(real, mode="r", check_finite=False)[0][: real.shape[1]]
    return triangle[:, :-1], triangle[:, -1]


def _best_poles(limit: PerformanceLimit, spectra: Spectra, order: int) -> Array:
    """Poles of the basis, over the range that comes closest to the limit without discs."""
    frequency = spectra.nodes.frequency
    # Where the limit's filter gives up: the highest frequency at which it passes half.
    passing = np.flatnonzero(np.abs(limit.lack(spectra)) < 0.5)
    corner = float(frequency[passing].max()) if passing.size else float(np.median(frequency))
    best, chosen = inf, np.zeros(0)
    for below, above in product(_BELOW, _ABOVE):
        poles = corner * np.append(np.logspace(below, above, order), 10.0**above)
        rows, target = _cost(limit, spectra, poles)
        scale = np.linalg.norm(rows, axis=0)
        found = np.linalg.lstsq(rows / scale, target, rcond=_WEAKEST)[0] / scale
        distance = float(np.sum((rows @ found - target) ** 2))
        if distance < best:
            best, chosen = distance, poles
    return chosen


def _solve(
    loop: OpenLoop, rows: Array, target: Array, poles: Array, grid: Array, ms: float, mt: float
) -> Array:
    """Coefficients of the least cost whose F stays in both discs at the frequencies of `grid`."""
    scale = np.linalg.norm(rows, axis=0)
    size = float(np.linalg.norm(target))
    # Unknowns: coefficients of like size, then the distance to be made small. Cones hold b − A x.
    count = rows.shape[1]
    distance = np.zeros((target.size + 1, count + 1))
    distance[0, count], distance[1:, :count] = -1.0, -rows / scale
    blocks, right = [distance], [np.append(0.0, -target / size)]
    cones = [clarabel.SecondOrderConeT(target.size + 1)]
    start, basis = _basis(loop, 1j * grid, poles)
    unit = size / scale
    for limit, offset in ((ms, start - 1), (mt, start)):
        if isfinite(limit):
            disc = np.zeros((grid.size, 3, count + 1))
            disc[:, 1, :count], disc[:, 2, :count] = -basis.real * unit, -basis.imag * unit
            blocks.append(disc.reshape(-1, count + 1))
            right.append(np.column_stack([np.full(grid.size, limit), offset.real, offset.imag]).ravel())
            cones += [clarabel.SecondOrderConeT(3)] * grid.size
    if loop.zeros.size:
        start, basis = _basis(loop, loop.zeros, poles)
        still = np.zeros((2 * loop.zeros.size, count + 1))
        still[:, :count] = np.vstack([basis.real, basis.imag]) * unit
        blocks.append(still)
        right.append(-np.concatenate([start.real, start.imag]))
        cones.append(clarabel.ZeroConeT(2 * loop.zeros.size))
    solution = solved(np.append(np.zeros(count), 1.0), np.vstack(blocks), np.concatenate(right), cones)
    status = str(solution.status)
    if "PrimalInfeasible" in status:
        raise ModelError(
            f"no sum of {count} functions keeps |S| ≤ {ms:.6g} and |T| ≤ {mt:.6g}; raise the limits or the order"
        )
    if status not in ("Solved", "AlmostSolved"):
        raise SolverError(f"Youla design: the cone solver ended with '{status}'; lower the order")
    return np.array(solution.x)[:count] * unit
