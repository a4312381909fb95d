"""Disturbances: stationary random inputs with a shaping filter or a tabulated power spectral density."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf, sqrt
from typing import Literal

import numpy as np
from scipy import signal

from fosopt.control import NUMERATORS, Loop
from fosopt.errors import ModelError, did_you_mean
from fosopt.metrics.tabulated import Interpolation, check_interpolation, density_between, table_cuts
from fosopt.ops import Array, ComplexArray

# Poles of a shaping filter closer than this (relative) are treated as repeated: roots of multiplicity four come
# out of their coefficients 1e-4 apart, and residues of poles this close still keep eight digits.
_REPEATED = 0.03


@dataclass(frozen=True)
class ShapingFilter:
    """A rational filter F(s) driven by white noise of unit two-sided density.

    The filtered signal has the one-sided power spectral density 2 |F(j 2πf)|² per hertz.

    Attributes
    ----------
    numerator, denominator
        Real coefficients, highest power of `s` first.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    def __post_init__(self) -> None:
        for coefficients in (self.numerator, self.denominator):
            if not coefficients or not np.all(np.isfinite(coefficients)) or coefficients[0] == 0:
                raise ModelError(
                    f"shaping filter: coefficients {list(coefficients)} must be finite, highest power first, "
                    "with a leading one that is not zero"
                )
        unstable = [p for p in self.poles if p.real >= 0]
        if unstable:
            raise ModelError(
                f"shaping filter: pole at {unstable[0]:.6g} rad/s does not decay; all poles need negative real parts"
            )

    @cached_property
    def poles(self) -> ComplexArray:
        """(n,) Poles [rad/s]."""
        return np.roots(self.denominator).astype(complex)

    @property
    def relative_degree(self) -> int:
        """Excess of poles over zeros."""
        return len(self.denominator) - len(self.numerator)

    @property
    def zeros_at_origin(self) -> int:
        """Number of differentiations: trailing zero coefficients of the numerator."""
        return len(self.numerator) - 1 - int(np.flatnonzero(self.numerator)[-1])

    @cached_property
    def has_repeated_poles(self) -> bool:
        """Whether two poles coincide, so that residues do not exist."""
        p = self.poles
        apart = np.abs(p[:, None] - p)[np.triu_indices(p.size, 1)]
        return bool(np.any(apart <= _REPEATED * np.abs(p).max(initial=0.0)))

    def response(self, s: ComplexArray) -> ComplexArray:
        """F(s)."""
        return np.polyval(self.numerator, s) / np.polyval(self.denominator, s)

    @cached_property
    def residues(self) -> ComplexArray:
        """(n,) Residues of F at its poles, which must be simple."""
        return np.polyval(self.numerator, self.poles) / np.polyval(np.polyder(self.denominator), self.poles)


@dataclass(frozen=True)
class Disturbance:
    """A disturbance, where it enters, its spectrum and the band it is counted over.

    Exactly one of `filter` and the table `frequency`, `psd` is given.

    Attributes
    ----------
    at
        Where it enters: a key of `control.NUMERATORS`.
    frequency, psd
        (m,) one-sided power spectral density, zero outside [rad/s], [unit²/Hz].
    band
        Frequencies counted [rad/s].
    interpolation
        Of a table between its rows.
    axis
        Of a mirror with two axes, the one it acts about; both at once are disturbances that are alike and independent.
    """

    name: str
    at: str
    filter: ShapingFilter | None = None
    frequency: Array | None = None
    psd: Array | None = None
    band: tuple[float, float] = (0.0, inf)
    interpolation: Interpolation = "linear"
    axis: Literal["first", "second", "both"] = "first"

    def __post_init__(self) -> None:
        if self.at not in NUMERATORS:
            raise ModelError(
                f"disturbance '{self.name}': input '{self.at}' does not exist; {did_you_mean(self.at, NUMERATORS)}"
            )
        if (self.filter is None) == (self.frequency is None or self.psd is None):
            raise ModelError(f"disturbance '{self.name}': give either a shaping filter or a spectrum table")
        if self.frequency is not None and self.psd is not None:
            rows = self.frequency.size
            if (
                rows < 2
                or self.psd.size != rows
                or np.any(np.diff(self.frequency) <= 0)
                or self.frequency[0] < 0
            ):
                raise ModelError(
                    f"disturbance '{self.name}': {rows} frequencies and {self.psd.size} densities; give two rows or "
                    "more, one density each, frequencies ascending from zero or above"
                )
            if not (np.all(np.isfinite(self.psd)) and np.all(self.psd >= 0)):
                raise ModelError(
                    f"disturbance '{self.name}': a density is negative or not finite; correct the table"
                )
            check_interpolation(self.frequency, self.psd, self.interpolation)
        low, high = self.band
        if not 0 <= low < high:
            raise ModelError(
                f"disturbance '{self.name}': band {low:.6g} to {high:.6g} rad/s is empty; "
                "the lower edge must be below the upper"
            )

    @property
    def counted(self) -> tuple[float, float]:
        """Band in which the spectrum is not zero by definition [rad/s]."""
        low, high = self.band
        if self.frequency is not None:
            low, high = max(low, float(self.frequency[0])), min(high, float(self.frequency[-1]))
        return low, high

    @property
    def by_residues(self) -> bool:
        """Whether its jitter is a sum of residues: a rational spectrum with simple poles over all frequencies."""
        return self.filter is not None and self.band == (0.0, inf) and not self.filter.has_repeated_poles

    def one_sided_psd(self, frequency: Array, shift: float = 0.0) -> Array:
        """(m,) One-sided power spectral density at `frequency` [rad/s], in [unit²/Hz].

        Parameters
        ----------
        shift
            Take F(s + shift) instead of F(s), which a table does not have [rad/s].
        """
        if self.filter is not None:
            return 2 * np.abs(self.filter.response(1j * frequency + shift)) ** 2
        assert self.frequency is not None and self.psd is not None
        return density_between(frequency, self.frequency, self.psd, self.interpolation)

    @property
    def cuts(self) -> Array:
        """(k,) Frequencies of a table between which its density is smooth; none of a filter [rad/s]."""
        return np.zeros(0) if self.frequency is None else table_cuts(self.frequency, self.interpolation)


def low_pass(corner: float, rms: float, order: int = 1) -> ShapingFilter:
    """Butterworth low pass whose output has the given rms; `corner` in rad/s."""
    numerator, denominator = signal.butter(order, corner, analog=True)
    return _to_rms(numerator, denominator, rms)


def band_pass(lower: float, upper: float, rms: float, order: int = 1) -> ShapingFilter:
    """Butterworth band pass whose output has the given rms; corners in rad/s."""
    numerator, denominator = signal.butter(order, (lower, upper), btype="bandpass", analog=True)
    return _to_rms(numerator, denominator, rms)


def high_pass(corner: float, density: float, order: int = 1) -> ShapingFilter:
    """Butterworth high pass with the given one-sided density [unit/√Hz] far above the corner [rad/s]."""
    numerator, denominator = signal.butter(order, corner, btype="highpass", analog=True)
    return ShapingFilter(tuple(density / sqrt(2) * numerator), tuple(denominator))


def white(density: float) -> ShapingFilter:
    """White noise of the given one-sided density [unit/√Hz]."""
    return ShapingFilter((density / sqrt(2),), (1.0,))


def _to_rms(numerator: Array, denominator: Array, rms: float) -> ShapingFilter:
    numerator = np.trim_zeros(
        np.where(np.abs(numerator) < 1e-14 * np.abs(numerator).max(), 0.0, numerator), "f"
    )
    shape = ShapingFilter(tuple(numerator), tuple(denominator))
    variance = np.sum(shape.residues * shape.response(-shape.poles)).real
    return ShapingFilter(tuple(rms / sqrt(variance) * numerator), shape.denominator)


def refuse_infinite_variance(disturbance: Disturbance, loop: Loop, drifting: bool) -> None:
    """Refuse a disturbance whose jitter is infinite on any stable loop.

    Raises
    ------
    ModelError
        If its spectrum does not fall off where the loop passes all frequencies, or if it drives a free rigid
        body at zero frequency, which the mirror's torque cannot hold.
    """
    pid, shape, at = loop.controller, disturbance.filter, disturbance.at
    pushing = drifting and "torque" in at and disturbance.counted[0] == 0.0
    drift = (
        f"disturbance '{disturbance.name}': unbounded drift, it pushes a free rigid body at zero frequency; "
        "hold the hub, wash the disturbance out, or state a lower band edge"
    )
    if shape is None:
        # Linear between its rows, a table that starts at zero falls there no faster than the frequency.
        if pushing:
            raise ModelError(drift)
        return
    derivative = pid.kd != 0 and pid.lag == 0
    degree = {
        "mirror_torque": 2,
        "hub_torque": 3,
        "line_of_sight": 0,
        "sensor_noise": 1 if derivative else 2,
    }[at]
    if disturbance.band[1] == inf and degree + shape.relative_degree < 1:
        raise ModelError(
            f"disturbance '{disturbance.name}': infinite variance, its spectrum does not fall off at high "
            f"frequency and '{at}' passes it; use a filter that rolls off, or state an upper band edge"
        )
    # Through a free rigid body a torque reaches the line of sight as 1/s with integral action on it, else as 1/s².
    needed = 1 if pid.ki != 0 and loop.placement.sensor is None else 2
    if pushing and shape.zeros_at_origin < needed:
        raise ModelError(drift)
