"""Stability and margins of the loop: spectral abscissa, modulus margin, crossover."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fosopt.control import ClosedLoopPoles, characteristic, loop_transfer
from fosopt.control.open_loop import BLOCK
from fosopt.control.phase import resonance_grid
from fosopt.errors import SolverError
from fosopt.metrics.functional import Functional, LoopModel
from fosopt.metrics.inertias import ModalFunctional
from fosopt.modes import Damping, ModalSet, impedance_change
from fosopt.ops import Array, ComplexArray

_BISECTIONS = 60
# A pole that rounding has put on its open-loop pole is looked at this far from it (relative).
_LEAST_SHIFT = 1e-12
_GRID = 120


def loop_transfer_slope(model: LoopModel, frequency: Array) -> tuple[ComplexArray, ComplexArray]:
    """L(jω) and dL/dω at (m,) frequencies [rad/s]."""
    pieces = int(np.ceil(frequency.size * model.modes.natural_frequency.size / BLOCK))
    found = [
        loop_transfer(model.loop, *model.along(model.points(1j * some)))
        for some in np.array_split(frequency, max(pieces, 1))
    ]
    return np.concatenate([each.value for each in found]), 1j * np.concatenate([each.slope for each in found])


def frequency_grid(model: LoopModel, poles: ClosedLoopPoles, count: int = _GRID) -> Array:
    """Ascending frequencies that resolve every closed- and open-loop resonance [rad/s]."""
    roots = np.concatenate([poles.value, poles.open_loop.first])
    size = np.abs(roots[roots != 0])
    return resonance_grid(roots, 0.1 * size.min(), 20 * size.max(), count)


def modulus_margins(model: LoopModel, poles: ClosedLoopPoles, count: int) -> tuple[Array, list[Functional]]:
    """The `count` smallest local minima of |1 + L(jω)| over frequency, ascending, with their differentials.

    The first is the modulus margin, the distance of the Nyquist plot from −1, the reciprocal of the peak of the
    sensitivity S.    [Doyle1992] Sec. 2.3. Where there are fewer minima, the value one at infinite frequency
    stands in. The distance says nothing about an unstable loop.

    Returns
    -------
    (count,)
        Distances [-].
    list
        Differential of each; by the envelope theorem the frequency of a minimum is held.
    """
    grid = frequency_grid(model, poles)
    value, slope = loop_transfer_slope(model, grid)
    distance = np.abs(1 + value)
    falling = -_squared_slope(value, slope, 1.0)
    brackets = _falls(falling)
    brackets = brackets[np.argsort(np.minimum(distance[brackets], distance[brackets + 1]), kind="stable")]
    brackets = brackets[: count + 2]
    frequency = _stationary(
        lambda w: -_squared_slope(*loop_transfer_slope(model, w), 1.0), grid[brackets], grid[brackets + 1]
    )
    value, _ = loop_transfer_slope(model, frequency)
    distance = np.abs(1 + value)
    order = np.argsort(distance, kind="stable")[:count]
    distances = [float(distance[i]) for i in order if distance[i] < 1]
    functionals = [
        Functional("loop_transfer", model.points(1j * frequency[[i]]), (1 + value[[i]]).conj() / distance[i])
        for i in order[: len(distances)]
    ]
    none = Functional("loop_transfer", model.points(1j * grid[:1]), np.zeros(1, complex))
    missing = count - len(distances)
    return np.array(distances + [1.0] * missing), functionals + [none] * missing


def _squared_slope(value: ComplexArray, slope: ComplexArray, center: float) -> Array:
    """Slope of |center + L(jω)|² in ω, halved."""
    return np.real((center + value).conj() * slope)


def _falls(values: Array) -> NDArray[np.intp]:
    """Indices after which a sequence falls through zero."""
    return np.flatnonzero((values[:-1] > 0) & ~(values[1:] > 0))


def _stationary(slope: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """(m,) Frequencies at which `slope` falls through zero in each of (m,) brackets, by the Illinois method."""
    at_low, at_high = slope(low), slope(high)
    before = np.zeros(low.size)
    middle = low
    for _ in range(_BISECTIONS):
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        value = slope(middle)
        up, side = value > 0, np.sign(value)
        moved = np.where(up, middle - low, high - middle)
        # An end that stays twice in a row counts half, so that it moves next.
        stays = np.where(side == before, 0.5, 1.0)
        low, at_low = np.where(up, middle, low), np.where(up, value, stays * at_low)
        high, at_high = np.where(up, high, middle), np.where(up, stays * at_high, value)
        before = side
        if np.all((moved <= 1e-12 * middle) | (value == 0)):
            break
    return middle


def crossover(model: LoopModel, poles: ClosedLoopPoles) -> tuple[float, Functional]:
    """Highest frequency at which |L(jω)| is one, and its differential.

    Returns
    -------
    float
        ω [rad/s].

    Raises
    ------
    SolverError
        If the loop gain never reaches one.
    """
    grid = frequency_grid(model, poles)
    # Tops of the loop gain are sharper than any grid.
    peaks = _falls(_squared_slope(*loop_transfer_slope(model, grid), 0.0))
    tops = _stationary(
        lambda w: _squared_slope(*loop_transfer_slope(model, w), 0.0), grid[peaks], grid[peaks + 1]
    )
    grid = np.union1d(grid, tops)
    above = np.abs(loop_transfer_slope(model, grid)[0]) >= 1
    if not above.any():
        raise SolverError("crossover: the loop gain stays below one at every frequency; raise the gain")
    last = int(np.flatnonzero(above)[-1])
    if last + 1 == grid.size:
        raise SolverError("crossover: the loop gain stays above one at every frequency; add a roll-off")
    low, high = grid[last], grid[last + 1]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if np.abs(loop_transfer_slope(model, np.array([middle]))[0][0]) >= 1:
            low = middle
        else:
            high = middle
    frequency = 0.5 * (low + high)
    value, slope = loop_transfer_slope(model, np.array([frequency]))
    weight = -value.conj() / np.real(value.conj() * slope)
    return float(frequency), Functional("loop_transfer", model.points(np.array([1j * frequency])), weight)


def rightmost_poles(
    model: LoopModel, poles: ClosedLoopPoles, count: int
) -> list[tuple[float, Functional | None]]:
    """The `count` largest real parts of the closed-loop poles, descending, with dp = −dΔ/Δ′ of each.

    The first is the spectral abscissa, negative for a stable loop; the drift of a free rigid body is not counted.
    Assumes each pole is simple; elsewhere it has no differential.

    Returns
    -------
    list
        Real part [rad/s] and its differential, None for a mode with a node at the mirror port, see
        `decay_functional`. At most as many as there are poles, conjugate pairs counted once.
    """
    hidden = np.unique(poles.open_loop.uncoupled.real)
    real = np.concatenate([poles.value.real, hidden])
    found: list[tuple[float, Functional | None]] = []
    for k in np.argsort(-real, kind="stable")[:count]:
        if k >= poles.value.size:
            found.append((float(real[k]), None))
            continue
        base, shift = poles.base[k], poles.shift[k]
        points = model.points_near_pole(base, shift or _LEAST_SHIFT * abs(base))
        delta = characteristic(model.loop, *model.along(points))
        found.append((float(real[k]), Functional("characteristic", points, -1 / delta.slope)))
    return found


def decay_functional(
    eigenvalue: Array,
    modes: ModalSet,
    damping: Damping,
    mirror_ports: Sequence[str],
    kept: NDArray[np.intp],
    decay: float,
) -> ModalFunctional:
    """Differential of the real part `decay` of the pole of a mode the loop does not see, dp = −(p dC + dK)/(2p + c).

    Parameters
    ----------
    eigenvalue, modes
        Of the whole frame.
    kept
        Modes of the design model, one of which has the pole.
    """
    root = np.sqrt((0.25 * modes.damping**2 - modes.stiffness).astype(complex))
    pole = -0.5 * modes.damping + root
    # Of modes that share the pole, the one that stands still at the mirror.
    own = kept[np.abs(pole[kept].real - decay) <= 1e-12 * np.abs(pole[kept])]
    k = int(own[np.argmin(sum(np.abs(modes.at(port)[own]) for port in mirror_ports))])
    change = impedance_change(eigenvalue, modes, damping)
    factor, p = -1 / (2 * pole[k] + modes.damping[k]), pole[k]
    stiffness, mass = np.zeros_like(change.hub_by_mass), np.zeros_like(change.hub_by_mass)
    stiffness[k, k] = (factor * (1 + p * change.damping_by_stiffness[k, k])).real
    mass[k, k] = (factor * (p**2 + p * change.damping_by_mass[k, k] + change.hub_by_mass[k, k])).real
    return ModalFunctional(stiffness, mass)
