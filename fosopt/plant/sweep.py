"""Coupled modes of one structure with many mirrors, at the speed of compiled loops.

The same secular equation as for one mirror, and the same form of its roots: uncoupled eigenvalue plus distance.
From one mirror to the next a root moves little, so that it is followed rather than found: what the equation says of
d ln x/d ln k gives the first guess, and a guarded Newton iteration ends in two or three steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror
from fosopt.errors import SolverError
from fosopt.modes import ModalSet
from fosopt.ops import Array
from fosopt.plant.coupled import CoupledModes, mirror_mode_index, secular, secular_slope, seen_by_mirror

_MOST_STEPS = 200
# Newton converges quadratically: after a step this small (relative) what is left is rounding.
_SETTLED = 1e-9


@dataclass(frozen=True)
class CoupledSweep:
    """Coupled modes of structure and mirror, ascending, for each of m mirrors.

    Attributes
    ----------
    base, distance, effective_modal_reaction_inertia, zero, separation
        (m, n+1), as in `CoupledModes`.
    mirror_mode
        (m,) index of the mirror mode.
    """

    base: Array
    distance: Array
    effective_modal_reaction_inertia: Array
    zero: Array
    separation: Array
    mirror_mode: NDArray[np.intp]

    def __len__(self) -> int:
        return self.base.shape[0]

    def __getitem__(self, point: int) -> CoupledModes:
        return CoupledModes(
            self.base[point],
            self.distance[point],
            self.effective_modal_reaction_inertia[point],
            self.zero[point],
            self.separation[point],
            int(self.mirror_mode[point]),
        )

    @property
    def natural_frequency(self) -> Array:
        """(m, n+1) ω_k [rad/s]."""
        return np.sqrt(self.base + self.distance)

    @property
    def pole_zero_separation(self) -> Array:
        """(m, n+1) β_k = ω_k/Ω_k [-].    [Barker1991] Eq. (2.55)"""
        return np.sqrt(1 + self.separation)

    @property
    def one_minus_separation(self) -> Array:
        """(m, n+1) 1 − β_k without cancellation [-]."""
        return -self.separation / (1 + self.pole_zero_separation)


def coupled_sweep(
    modes: ModalSet, mirror_port: str, inertia: Array, natural_frequency: Array | float
) -> CoupledSweep:
    """All coupled modes of one modal set with each of many mirrors.    [Barker1991] Eqs. (4.10), (4.20)

    Fastest where neighbors in the arrays are neighbors in inertia.

    Parameters
    ----------
    inertia, natural_frequency
        (m,) J_m [kg m²] and ω_m [rad/s], or one frequency for all.

    Raises
    ------
    ModelError
        For an inertia or frequency that is not positive and finite.
    SolverError
        If a root does not settle in its interval.
    """
    inertia = np.asarray(inertia, dtype=float).ravel()
    frequency = np.broadcast_to(np.asarray(natural_frequency, dtype=float), inertia.shape)
    wrong = ~(np.isfinite(inertia) & (inertia > 0) & np.isfinite(frequency) & (frequency >= 0))
    for j, w in zip(inertia[wrong][:1], frequency[wrong][:1], strict=True):
        Mirror(j, w, 0.0)  # refuses it, in the words of one mirror
    uncoupled, shape2 = seen_by_mirror(modes, mirror_port)
    moved = (shape2 > 0) & (uncoupled > 0)
    poles, weight = uncoupled[moved], shape2[moved]
    free = float(shape2[uncoupled == 0].sum())
    square = np.square(frequency)
    below = np.asarray(mirror_mode_index(poles, frequency), dtype=np.intp)
    count = poles.size + 1
    own = np.empty((inertia.size, count), dtype=np.intp)
    distance, reaction = np.empty((2, inertia.size, count))
    settled = _follow(poles, weight, free, inertia * square, square, own, distance, reaction)
    if not settled:
        raise SolverError("secular equation: a root does not settle in its interval; check the modal set")
    base = np.append(poles, 0.0)[own]
    # Each root but the mirror's is paired with the pole it starts from: the upper one below the mirror, else the lower.
    number = np.arange(count)
    paired = number - (number > below[:, None])
    zero = np.where(number == below[:, None], np.nan, np.append(poles, np.nan)[paired])
    separation = np.where(base == zero, distance, base + distance - zero) / zero

    arrays: tuple[Array, ...] = (base, distance, reaction, zero, separation)
    still = uncoupled[~moved]
    if still.size:
        arrays, below = _with_still_modes(arrays, still, below)
    base, distance, reaction, zero, separation = arrays
    return CoupledSweep(base, distance, reaction, zero, separation, below)


def _with_still_modes(
    arrays: tuple[Array, ...], still: Array, below: NDArray[np.intp]
) -> tuple[tuple[Array, ...], NDArray[np.intp]]:
    """Modes the mirror cannot move put in their places: a node at the port, or a free rigid body."""
    base, distance, reaction, zero, separation = arrays
    each = np.broadcast_to(still, (base.shape[0], still.size))
    nothing = np.zeros(each.shape)
    base, distance = np.hstack([base, each]), np.hstack([distance, nothing])
    reaction, separation = np.hstack([reaction, nothing]), np.hstack([separation, nothing])
    zero = np.hstack([zero, np.where(each > 0, each, np.nan)])
    position = np.argsort(base + distance, axis=1, kind="stable")
    sorted_ = (np.take_along_axis(a, position, axis=1) for a in (base, distance, reaction, zero, separation))
    return tuple(sorted_), np.argmax(position == below[:, None], axis=1)


_f, _slope = numba.njit(inline="always")(secular), numba.njit(inline="always")(secular_slope)


@numba.njit(fastmath={"reassoc", "contract", "arcp"}, error_model="numpy", cache=True)
def _sums(poles: Array, weight: Array, base: float, distance: float, own: int) -> tuple[float, float]:
    """G and dg/dλ without the own pole's part."""
    g = slope = 0.0
    for j in range(poles.size):
        gap = (poles[j] - base) - distance
        part = 0.0 if j == own else weight[j] / gap
        g += part
        slope += 0.0 if j == own else part / gap
    return g, slope


@numba.njit(error_model="numpy", cache=True)
def _settle(
    poles: Array, weight: Array, k: float, constant: float, pole: int, x: float, lo: float, hi: float
) -> tuple[float, float, float, bool]:
    """Newton's method from x within a bracket: distance from the pole, g and dg/dλ there, whether it settled."""
    n = poles.size
    base, w = (poles[pole], weight[pole]) if pole < n else (0.0, 0.0)
    g = slope = 0.0
    step, last = np.inf, False
    for _ in range(_MOST_STEPS):
        g, slope = _sums(poles, weight, base, x, pole)
        eigenvalue = base + x
        rest, fall = _f(k, constant, base, x, g), _slope(k, eigenvalue, g, slope)
        # x F has the root of F without its pole; it is F itself where there is no pole.
        value = x * rest + eigenvalue * k * w if pole < n else rest
        rate = rest + x * fall + k * w if pole < n else fall
        # F falls: above zero, the root is farther up.
        if (value > 0) != (pole < n and hi <= 0):
            lo = x
        else:
            hi = x
        trial = x - value / rate
        if not lo <= trial <= hi:
            trial = 0.5 * (lo + hi)
        step, x = abs(trial - x), trial
        # The step after one of 1e-9 is at rounding level, and so are the sums before it.
        if last or step <= 1e-15 * abs(x):
            break
        last = step <= _SETTLED * abs(x)
    return x, g, slope, step <= 1e-12 * abs(x)


@numba.njit(inline="always")
def _near(k: float, before: float) -> bool:
    """Whether two stiffnesses are close enough for one root to lead to the next."""
    return 0.2 * before < k < 5.0 * before


@numba.njit(error_model="numpy", cache=True)
def _follow(
    poles: Array,
    weight: Array,
    free: float,
    stiffness: Array,
    square: Array,
    own: NDArray[np.intp],
    distance: Array,
    reaction: Array,
) -> bool:
    """Own pole (or none: the last index), distance and J̄ of each root at each point; whether all have settled."""
    n, whole = poles.size, weight.sum() + free
    for i in range(n + 1):
        low = poles[i - 1] if i > 0 else 0.0
        pole, x, rate = n, 0.0, 0.0
        for q in range(stiffness.size):
            k, constant = stiffness[q], square[q] + stiffness[q] * free
            width = (poles[i] if i < n else 2 * (low + square[q] + k * whole) + 1.0) - low
            half = 0.5 * width
            near = q > 0 and pole < n and square[q] == square[q - 1] and _near(k, stiffness[q - 1])
            g, slope, settled = 0.0, 0.0, False
            if near:
                x *= (k / stiffness[q - 1]) ** rate
                lo, hi = (-width, 0.0) if pole == i else (0.0, width)
                if abs(x) < half:
                    x, g, slope, settled = _settle(poles, weight, k, constant, pole, x, lo, hi)
                settled = settled and (abs(x) <= half or i == n)
            if not settled:
                # Positive at the middle, F has its root in the upper half of the interval.
                g, _ = _sums(poles, weight, low, half, n)
                upper = i < n and _f(k, constant, low, half, g) > 0
                pole = i if upper else (i - 1 if i > 0 else n)
                lo, hi = (-half, 0.0) if upper else (0.0, width if i == n else half)
                x = 0.0 if pole < n else 0.5 * hi
                x, g, slope, settled = _settle(poles, weight, k, constant, pole, x, lo, hi)
                if not settled:
                    return False
            eigenvalue = (poles[pole] if pole < n else 0.0) + x
            if pole < n:
                g, slope = g - weight[pole] / x, slope + weight[pole] / x**2
            fall = _slope(k, eigenvalue, g - free / eigenvalue, slope + free / eigenvalue**2)
            # From F(x, k) = 0: dx/dk = λ g_all/(dF/dλ).
            rate = k / x * (eigenvalue * g - free) / fall
            own[q, i], distance[q, i], reaction[q, i] = pole, x, -1.0 / fall
    return True
