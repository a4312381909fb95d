"""Stability and margins of the loop: spectral abscissa, modulus margin, crossover."""

from __future__ import annotations

import numpy as np

from fosopt.control import ClosedLoopPoles, Receptances, characteristic, loop_transfer
from fosopt.errors import SolverError
from fosopt.metrics.functional import Functional, LoopModel, Points
from fosopt.ops import Array, ComplexArray, Dual

_BISECTIONS = 60
_OFFSETS = np.sinh(np.linspace(-3.5, 3.5, 9))  # in half widths about each resonance
_GRID = 120


def loop_transfer_slope(model: LoopModel, frequency: Array) -> tuple[ComplexArray, ComplexArray]:
    """L(jω) and dL/dω at (m,) frequencies [rad/s]."""
    s = 1j * frequency
    g, slope = model.receptances(s), model.receptance_slopes(s)
    value = loop_transfer(
        model.loop, Dual(s, 1.0), Receptances(Dual(g.direct, slope.direct), Dual(g.cross, slope.cross))
    )
    return value.value, 1j * value.slope


def frequency_grid(model: LoopModel, poles: ClosedLoopPoles, count: int = _GRID) -> Array:
    """Ascending frequencies that resolve every closed- and open-loop resonance [rad/s]."""
    ol = poles.open_loop
    resonances = np.concatenate([poles.value, ol.first])
    resonances = resonances[resonances.imag > 0]
    local = resonances.imag[:, None] + np.abs(resonances.real)[:, None] * _OFFSETS
    every = np.concatenate([np.abs(poles.value), np.abs(ol.first)])
    every = every[every > 0]
    broad = np.geomspace(0.1 * every.min(), 20 * every.max(), count)
    return np.unique(np.concatenate([local.ravel()[local.ravel() > 0], broad]))


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
    rising = np.real((1 + value).conj() * slope) > 0
    left = np.flatnonzero(~rising[:-1] & rising[1:])
    left = left[np.argsort(np.minimum(distance[left], distance[left + 1]), kind="stable")][: count + 2]
    low, high = grid[left], grid[left + 1]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        value, slope = loop_transfer_slope(model, middle)
        up = np.real((1 + value).conj() * slope) > 0
        low, high = np.where(up, low, middle), np.where(up, middle, high)
        if np.all(high - low <= 1e-12 * high):
            break
    frequency = 0.5 * (low + high)
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


def spectral_abscissa(model: LoopModel, poles: ClosedLoopPoles) -> tuple[float, Functional]:
    """Largest real part of the closed-loop poles, and its differential dp = −dΔ/Δ′ at the rightmost one.

    Assumes the rightmost pole is simple and moved by the mirror; elsewhere it has no differential.

    Returns
    -------
    float
        [rad/s]; negative for a stable loop. The drift of a free rigid body is not counted.
    """
    rightmost = int(np.argmax(poles.value.real))
    # The quotient of two terms that both grow as 1/shift² is the same a little further from the open-loop pole.
    base, shift = poles.base[rightmost], poles.shift[rightmost]
    least = 1e-8 * abs(base)
    if abs(shift) < least:
        shift = least * (shift / abs(shift) if shift else 1.0)
    s = np.array([base + shift])
    g, slope = model.receptances(s), model.receptance_slopes(s)
    delta = characteristic(
        model.loop, Dual(s, 1.0), Receptances(Dual(g.direct, slope.direct), Dual(g.cross, slope.cross))
    )
    return poles.spectral_abscissa, Functional("characteristic", Points(s, g), -1 / delta.slope)
