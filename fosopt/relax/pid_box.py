"""Boxes of PID gains, many at once."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror
from fosopt.control import PID, gain_for_crossover
from fosopt.errors import ModelError
from fosopt.ops import Array

Range = tuple[float, float]
GAINS = ("gain", "kp", "ki", "kd")
# Where a range that starts at zero is cut, as a share of its end.
_FIRST_CUT = 0.1
_ROUNDED = 1e-9
# Crossovers looked at for the range of gains they need, and by how much it is widened for those between.
_CROSSOVERS, _WIDER = 2000, 1.01


@dataclass(frozen=True)
class PidBox:
    """All PID controllers with gains in given ranges; one whose ends are equal is fixed.

    Absolute gains are those with `gain` fixed at one. With `gain` and `kd` both free each controller is in the box
    more than once, which only costs time.

    Attributes
    ----------
    gain, kp, ki, kd
        Lowest and highest value, `gain` above zero and the others zero or above, in the units of `PID`.
    rolloff_time
        Of the derivative, the same for all [s].
    """

    gain: Range
    kp: Range
    ki: Range
    kd: Range
    rolloff_time: float = 0.0

    def __post_init__(self) -> None:
        for name in GAINS:
            low, high = getattr(self, name)
            if not (isfinite(low) and isfinite(high)):
                raise ModelError(f"PID box: {name} from {low} to {high} has no end; give finite bounds")
            if low > high:
                raise ModelError(
                    f"PID box: {name} from {low:.6g} to {high:.6g} is empty; exchange its bounds"
                )
            if low < 0 or (low == 0 and name == "gain"):
                raise ModelError(
                    f"PID box: {name} from {low:.6g}; it must not be negative, and gain must be above zero"
                )
        if not 0 <= self.rolloff_time < np.inf:
            raise ModelError(f"PID box: rolloff_time {self.rolloff_time} is negative or not finite")

    @property
    def description(self) -> str:
        """The ranges in words."""
        parts = []
        for name in GAINS:
            low, high = getattr(self, name)
            parts.append(f"{name} {low:.6g}" if low == high else f"{name} from {low:.6g} to {high:.6g}")
        return ", ".join(parts)

    @property
    def whole(self) -> Boxes:
        """The box as the only one of many."""
        ends = np.array([getattr(self, name) for name in GAINS], dtype=float)
        return Boxes(ends[None, :, 0], ends[None, :, 1])

    def at(self, share: Array) -> Array:
        """(..., 4) Gains at shares from zero to one of each range, on a logarithmic scale where it can be."""
        low, high = self.whole.low[0], self.whole.high[0]
        positive = np.where(low > 0, low, 1.0)
        return np.where(low > 0, positive * (np.maximum(high, low) / positive) ** share, share * high)

    def share(self, gains: Array) -> Array:
        """(4,) The shares at which `at` gives these gains, zero for a fixed one."""
        low, high = self.whole.low[0], self.whole.high[0]
        free = high > low
        positive = np.where(low > 0, low, 1.0)
        width = np.where(free, np.log(np.where(free, high, 2.0) / positive), 1.0)
        logarithmic = np.log(np.where(low > 0, gains, 1.0) / positive) / width
        return np.where(free, np.where(low > 0, logarithmic, gains / np.where(free, high, 1.0)), 0.0)

    def controller(self, gains: Array) -> PID:
        """The controller with (4,) gains."""
        gain, kp, ki, kd = (float(value) for value in gains)
        return PID(gain, kp, ki, kd, self.rolloff_time)

    def contains(self, pid: PID) -> bool:
        """Whether a controller lies in the box, but for rounding, as it stands: its gains are not rescaled."""
        gains, whole = np.array([getattr(pid, name) for name in GAINS]), self.whole
        inside = (gains >= whole.low[0] * (1 - _ROUNDED)) & (gains <= whole.high[0] * (1 + _ROUNDED))
        return bool(inside.all()) and bool(
            np.isclose(pid.rolloff_time, self.rolloff_time, rtol=_ROUNDED, atol=0)
        )


def box_of_crossovers(
    mirror: Mirror, crossover: Range, kp: Range, ki: Range, kd: Range, rolloff_time: float = 0.0
) -> PidBox:
    """The smallest box with all controllers whose gain puts the crossover on a rigid support into a range.

    It holds others too: its bound holds for those meant, but the best controller in it may not be one of them.

    Parameters
    ----------
    crossover
        Lowest and highest, see `control.gain_for_crossover` [rad/s].

    Raises
    ------
    ModelError
        If a range is empty, or so wide that no gain is too large.
    """
    if not 0 < crossover[0] <= crossover[1] < np.inf:
        raise ModelError(
            f"PID box: crossover from {crossover[0]:.6g} to {crossover[1]:.6g} rad/s is empty or not above zero; "
            "give ascending, finite bounds"
        )
    resonance = np.clip(float(mirror.natural_frequency), *crossover)
    w = np.append(np.geomspace(*crossover, _CROSSOVERS), resonance)
    # |K| is one for a proportional gain alone: this is the inverse of the rigidly supported plant.
    inverse = gain_for_crossover(w, mirror, 1.0, 0.0, 0.0, 0.0)
    derivative = 1j * w / (1 + 1j * w * rolloff_time)
    real = [kp[end] + kd[end] * derivative.real for end in (0, 1)]
    imag = [kd[end] * derivative.imag - ki[1 - end] / w for end in (0, 1)]
    least = np.hypot(real[0], np.maximum(np.maximum(imag[0], -imag[1]), 0.0))
    most = np.hypot(real[1], np.maximum(np.abs(imag[0]), np.abs(imag[1])))
    if not least.min() > 0:
        raise ModelError("PID box: integral and derivative action may cancel at any gain; raise the least kp")
    gain = float((inverse / most).min()) / _WIDER, float((inverse / least).max()) * _WIDER
    return PidBox(gain, kp, ki, kd, rolloff_time)


@dataclass(frozen=True)
class Boxes:
    """Many boxes of gains in the order of `GAINS`.

    Attributes
    ----------
    low, high
        (b, 4).
    """

    low: Array
    high: Array

    @property
    def middle(self) -> Array:
        """(b, 4) Gains in the middle, on a logarithmic scale unless a range starts at zero."""
        geometric = np.sqrt(self.low * self.high)
        return np.where(self.low > 0, geometric, np.where(self.high > 0, _FIRST_CUT * self.high, 0.0))

    @property
    def absolute(self) -> tuple[Array, Array]:
        """(b, 3), (b, 3) Least and largest proportional, integral and derivative gain."""
        return self.low[:, :1] * self.low[:, 1:], self.high[:, :1] * self.high[:, 1:]

    def least(self, slope: Array) -> Array:
        """(b,) Least value over each box of a linear function of the absolute gains with (b, 3) slopes."""
        inner = np.minimum(slope * self.low[:, 1:], slope * self.high[:, 1:]).sum(axis=1)
        return np.minimum(self.low[:, 0] * inner, self.high[:, 0] * inner)

    def split(self, along: NDArray[np.intp]) -> Boxes:
        """(2b) Halves of each box along one gain each, the lower ones first."""
        rows = np.arange(along.size)
        cut = self.middle[rows, along]
        below, above = self.high.copy(), self.low.copy()
        below[rows, along] = above[rows, along] = cut
        return Boxes(np.concatenate([self.low, above]), np.concatenate([below, self.high]))

    def take(self, chosen: NDArray[np.intp] | NDArray[np.bool_] | list[int]) -> Boxes:
        """Some of them."""
        return Boxes(self.low[chosen], self.high[chosen])


def joined(parts: list[Boxes]) -> Boxes:
    """All boxes of several."""
    none = np.zeros((0, len(GAINS)))
    return Boxes(
        np.concatenate([none, *(part.low for part in parts)]),
        np.concatenate([none, *(part.high for part in parts)]),
    )
