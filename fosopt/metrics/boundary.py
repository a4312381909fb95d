"""Stability boundaries: where along a parameter the closed loop loses or regains stability.

Along a path of loops the poles are followed from sample to sample, those of a sampled loop as ln z/T. A boundary lies
where the spectral abscissa changes sign; samples are added where a pole turns back close to the imaginary axis and
where one pole takes over from another, so that a pair of boundaries between two samples is not overlooked. Assumes that
between samples no pole turns more than once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import pi
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from fosopt.errors import ModelError
from fosopt.metrics.functional import LoopModel
from fosopt.ops import ComplexArray


class Poles(Protocol):
    """Closed-loop poles in an order that those of neighboring loops share."""

    @property
    def value(self) -> ComplexArray:
        """(m,) Poles that the loop moves [rad/s]."""

    @property
    def multiplicity(self) -> NDArray[np.intp]:
        """(m,) How many poles each stands for; alike where those of two loops are the same ones."""

    @property
    def spectral_abscissa(self) -> float:
        """Largest real part, of poles that the loop does not move as well [rad/s]."""


P = TypeVar("P", bound=Poles)

TOLERANCE = 1e-9
"""Relative accuracy of a boundary [-]."""
_SAMPLES = 41
_TURNS = 40  # evaluations to find where a pole turns
_HOPE = 0.05  # least share of its distance from the axis by which a pole has to come closer for the search to go on
_GOLDEN = 0.381966
# A pole may turn this many times its change between samples beyond the sample closest to the turn.
_REACH = 4.0


@dataclass(frozen=True)
class Boundary:
    """One boundary of stability.

    Attributes
    ----------
    value
        Of the parameter.
    loses
        Whether the loop loses stability as the parameter rises; else it regains it.
    pole
        The pole on the imaginary axis, upper one of its pair [rad/s].
    """

    value: float
    loses: bool
    pole: complex

    @property
    def frequency(self) -> float:
        """Of the oscillation that neither grows nor decays [rad/s]."""
        return abs(self.pole)


def stability_boundaries(
    path: Callable[[float, P | None], P],
    low: float,
    high: float,
    *,
    log: bool = True,
    samples: int = _SAMPLES,
) -> list[Boundary]:
    """Every boundary of stability for a parameter from `low` to `high`, ascending, to 1e-9 of its value.

    Parameters
    ----------
    path
        From the parameter, and the poles of a neighbor or none to start from, to the poles.
    log
        Whether samples are spaced by equal ratios.
    samples
        At least three; more for a loop whose poles turn often.

    Raises
    ------
    ModelError
        For a range that is empty, or not positive where it is sampled by ratios.
    """
    if not low < high or (log and not low > 0):
        raise ModelError(
            f"boundary: {low:g} to {high:g} is no range to search; give a lower end below the upper one"
            + (", both above zero" if log else "")
        )
    search = _Search(path, log)
    first, last = (float(np.log(x)) if log else x for x in (low, high))
    found = [search.at(float(u)) for u in np.linspace(first, last, max(samples, 3))]
    found = sorted([*found, *search.turns(found)], key=lambda sample: sample.at)
    found = sorted([*found, *search.handovers(found)], key=lambda sample: sample.at)
    return [search.between(a, b) for a, b in pairwise(found) if a.stable != b.stable]


def boundary_mode(model: LoopModel, pole: complex, period: float | None = None) -> int:
    """Number of the structural mode, from one, that moves most as the loop oscillates at a pole.

    Motions are those of a load at the ports the loop uses, in mass-normalized coordinates. A held load oscillates at
    all frequencies that look alike at the samples, each as much as the hold lets pass.    [Astrom1997] Sec. 7.3

    Parameters
    ----------
    period
        Of a loop that samples [s].
    """
    modes = model.modes
    ports = [model.mirror_port, *model.loop.other_ports]
    shape = np.max([np.abs(modes.at(port)) for port in ports], axis=0)
    load, s = np.ones(1), np.array([pole])
    if period is not None:
        count = int(np.ceil(modes.natural_frequency.max(initial=0.0) * period / (2 * pi)))
        s = pole + 2j * pi / period * np.arange(-count, count + 1)
        load = np.abs(np.where(s == 0, period, -np.expm1(-s * period) / np.where(s == 0, 1.0, s)))
    resistance = np.abs(s[:, None] ** 2 + modes.damping * s[:, None] + modes.stiffness)
    motion = load[:, None] * shape / np.maximum(resistance, np.finfo(float).tiny)
    return 1 + int(np.argmax(motion.max(axis=0)))


def branches(lines: Sequence[Sequence[Boundary]], log: bool = True) -> list[list[int]]:
    """Branch of each boundary on neighboring lines, so that a contour can be drawn.

    A boundary continues the one of the line before that is nearest, of the same direction and within a factor of two
    in frequency; otherwise it begins a new branch.

    Returns
    -------
    list
        For each line the numbers of its branches, from zero.
    """
    count, previous, found = 0, list[tuple[int, Boundary]](), list[list[int]]()
    for line in lines:
        free, numbers = list(previous), []
        for boundary in line:
            same = [
                each
                for each in free
                if each[1].loses == boundary.loses and 0.5 < each[1].frequency / boundary.frequency < 2
            ]
            if same:
                nearest = min(same, key=lambda each: _apart(each[1].value, boundary.value, log))
                free.remove(nearest)
                numbers.append(nearest[0])
            else:
                numbers.append(count)
                count += 1
        previous = list(zip(numbers, line, strict=True))
        found.append(numbers)
    return found


def _apart(a: float, b: float, log: bool) -> float:
    return abs(np.log(a / b)) if log else abs(a - b)


@dataclass(frozen=True)
class _Sample(Generic[P]):
    """Poles at one place of the path."""

    at: float
    poles: P

    @property
    def stable(self) -> bool:
        return self.poles.spectral_abscissa < 0

    @property
    def critical(self) -> complex:
        """The rightmost pole; one that the loop does not move never leaves the left half plane."""
        value = self.poles.value
        pole = value[np.argmax(value.real)]
        return complex(pole.real, abs(pole.imag))

    def follows(self, other: _Sample[P]) -> bool:
        """Whether poles of the two samples are the same ones, one by one."""
        return np.array_equal(self.poles.multiplicity, other.poles.multiplicity)


class _Search(Generic[P]):
    """The path with the poles of its last sample, from which the next ones start."""

    def __init__(self, path: Callable[[float, P | None], P], log: bool) -> None:
        self._path, self._log = path, log
        self._near: P | None = None

    def value(self, u: float) -> float:
        return float(np.exp(u)) if self._log else float(u)

    def at(self, u: float, near: P | None = None) -> _Sample[P]:
        self._near = self._path(self.value(u), near or self._near)
        return _Sample(float(u), self._near)

    def turns(self, samples: Sequence[_Sample[P]]) -> Iterator[_Sample[P]]:
        """Samples where a pole that stays on its side of the axis comes closest to it and may cross it twice."""
        for left, middle, right in zip(samples, samples[1:], samples[2:], strict=False):
            if not (left.follows(middle) and middle.follows(right)):
                continue
            for k in _turning(*(each.poles.value.real for each in (left, middle, right))):
                # Of a pair whose poles are both there, one is enough.
                if middle.poles.value[k].imag >= 0:
                    yield self._turn(left, middle, right, int(k))

    def _turn(self, left: _Sample[P], middle: _Sample[P], right: _Sample[P], k: int) -> _Sample[P]:
        start = float(middle.poles.value.real[k])

        def distance(u: float) -> float:
            sample = self.at(u, middle.poles)
            # Where two real poles have become a pair, pole k is another one: no better place than the middle.
            return (
                float(np.sign(start) * sample.poles.value.real[k]) if sample.follows(middle) else abs(start)
            )

        ends = (abs(float(each.poles.value.real[k])) for each in (left, right))
        places = ((each.at, d) for each, d in zip((left, right), ends, strict=True))
        return self.at(_crossing(distance, (middle.at, abs(start)), *places), middle.poles)

    def handovers(self, samples: Sequence[_Sample[P]]) -> Iterator[_Sample[P]]:
        """Samples where one growing pole calms down before another one starts to grow."""
        for left, right in pairwise(samples):
            if left.stable or right.stable or not left.follows(right):
                continue
            if not np.any((left.poles.value.real > 0) & (right.poles.value.real > 0)):
                yield self._handover(left, right)

    def _handover(self, left: _Sample[P], right: _Sample[P]) -> _Sample[P]:
        """Where the poles that grow on the left are as close to the axis as those that grow on the right."""
        falling, rising = (each.poles.value.real > 0 for each in (left, right))

        def lead(u: float) -> float:
            sample = self.at(u, left.poles)
            real = sample.poles.value.real
            # Where a pair has become two real poles, its own place is as good as any.
            return float(real[falling].max() - real[rising].max()) if sample.follows(left) else 0.0

        width = right.at - left.at
        return self.at(optimize.brentq(lead, left.at, right.at, xtol=1e-6 * width, rtol=1e-14), left.poles)

    def abscissa(self, near: P) -> Callable[[float], float]:
        """The spectral abscissa along the path, its poles found from those of a neighbor."""
        return lambda u: self.at(u, near).poles.spectral_abscissa

    def between(self, left: _Sample[P], right: _Sample[P]) -> Boundary:
        """The boundary between a stable and an unstable sample."""
        near = left.poles
        size = 1.0 if self._log else max(abs(left.at), abs(right.at))
        u = optimize.brentq(self.abscissa(near), left.at, right.at, xtol=0.25 * TOLERANCE * size, rtol=1e-14)
        return Boundary(self.value(u), left.stable, self.at(u, near).critical)


def _turning(left: Any, middle: Any, right: Any) -> Iterator[np.intp]:
    """Poles whose real part has its extreme nearest to zero at the middle sample, within reach of zero."""
    before, after = np.abs(left) - np.abs(middle), np.abs(right) - np.abs(middle)
    same = (np.sign(left) == np.sign(middle)) & (np.sign(right) == np.sign(middle))
    near = np.abs(middle) < _REACH * np.maximum(before, after)
    yield from np.flatnonzero(same & near & (before > 0) & (after > 0))


def _crossing(
    f: Callable[[float], float],
    lowest: tuple[float, float],
    left: tuple[float, float],
    right: tuple[float, float],
) -> float:
    """Where a function with one valley falls below zero, or its lowest place as soon as it is plain that it does not.

    Successive parabolas through the three lowest known places; the golden section where they do not shorten the range.

    Parameters
    ----------
    lowest, left, right
        Place and value within the range and at its ends, of which the first is not the highest.
    """
    shortest = 1e-6 * (right[0] - left[0])
    for _ in range(_TURNS):
        if lowest[1] < 0 or right[0] - left[0] <= shortest:
            break
        u, value = _vertex(left, lowest, right)
        if lowest[1] - value < _HOPE * lowest[1]:
            break
        if abs(u - lowest[0]) < 0.5 * shortest:
            wide = right[0] if right[0] - lowest[0] > lowest[0] - left[0] else left[0]
            u = lowest[0] + _GOLDEN * (wide - lowest[0])
        found = u, f(u)
        inner, outer = (found, lowest) if found[1] < lowest[1] else (lowest, found)
        if outer[0] < inner[0]:
            left = outer
        else:
            right = outer
        lowest = inner
    return lowest[0]


def _vertex(
    left: tuple[float, float], middle: tuple[float, float], right: tuple[float, float]
) -> tuple[float, float]:
    """Lowest place of the parabola through three places, of which the middle one is lowest, and its value there."""
    a, b = middle[0] - left[0], right[0] - middle[0]
    slope_a, slope_b = (left[1] - middle[1]) / a, (right[1] - middle[1]) / b
    curvature = (slope_a + slope_b) / (a + b)
    slope = (slope_b * a - slope_a * b) / (a + b)
    return middle[0] - slope / (2 * curvature), middle[1] - slope**2 / (4 * curvature)
