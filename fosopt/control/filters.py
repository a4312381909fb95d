"""Filters in the loop: roll-off and anti-alias low passes, notches, lead-lags, and delays as rational functions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb, factorial, inf
from typing import Any

import numpy as np
from scipy import signal

from fosopt.errors import ModelError
from fosopt.ops import ComplexArray


@dataclass(frozen=True)
class Filter:
    """A proper, stable rational filter F(s) with constant coefficients.

    Attributes
    ----------
    numerator, denominator
        Real coefficients, highest power of `s` first.
    center
        Frequency at which a discretized filter is to equal this one, zero for the lowest ones [rad/s].
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    center: float = 0.0

    def __post_init__(self) -> None:
        for coefficients in (self.numerator, self.denominator):
            if not coefficients or not np.all(np.isfinite(coefficients)) or coefficients[0] == 0:
                raise ModelError(
                    f"filter: coefficients {list(coefficients)} must be finite, highest power first, "
                    "with a leading one that is not zero"
                )
        if self.relative_degree < 0:
            raise ModelError("filter: it has more zeros than poles; raise the denominator's degree")
        growing = [p for p in self.poles if p.real >= 0]
        if growing:
            raise ModelError(
                f"filter: pole at {growing[0]:.6g} rad/s does not decay; all poles need negative real parts"
            )
        if not 0 <= self.center < inf:
            raise ModelError(f"filter: center {self.center} rad/s is negative or not finite")

    @cached_property
    def poles(self) -> ComplexArray:
        """(n,) Poles [rad/s]."""
        return np.roots(self.denominator).astype(complex)

    @property
    def order(self) -> int:
        """Number of poles."""
        return len(self.denominator) - 1

    @property
    def relative_degree(self) -> int:
        """Excess of poles over zeros."""
        return len(self.denominator) - len(self.numerator)

    @property
    def direct(self) -> float:
        """Its value at infinite frequency."""
        return self.numerator[0] / self.denominator[0] if self.relative_degree == 0 else 0.0

    def response(self, s: Any) -> Any:
        """F(s), for numbers and symbols."""
        return horner(self.numerator, s) / horner(self.denominator, s)


def horner(coefficients: tuple[float, ...], s: Any) -> Any:
    """A polynomial at `s`, highest power first.    [Higham2002] Sec. 5.1"""
    value: Any = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * s + coefficient
    return value


def low_pass_filter(corner: float, order: int = 1) -> Filter:
    """Butterworth low pass of gain one at zero frequency; `corner` in rad/s.    [Butterworth1930]"""
    _positive("low pass", "corner", corner)
    _whole("low pass", order, 8)
    numerator, denominator = signal.butter(order, corner, analog=True)
    return Filter(tuple(np.atleast_1d(numerator)[-1:].tolist()), tuple(denominator.tolist()))


def notch_filter(frequency: float, damping_ratio: float, depth: float = 0.0) -> Filter:
    """Notch (s² + 2 d ζ ω s + ω²)/(s² + 2 ζ ω s + ω²).    [Franklin2015] Sec. 5.4

    Parameters
    ----------
    frequency
        ω [rad/s].
    damping_ratio
        ζ of its poles, half its relative width.
    depth
        d, its gain at ω, zero or more; above one it amplifies.
    """
    _positive("notch", "frequency", frequency)
    _positive("notch", "damping_ratio", damping_ratio)
    if not 0 <= depth < inf:
        raise ModelError(f"notch: depth {depth} is negative or not finite; give its gain at the center")
    middle = 2 * damping_ratio * frequency
    return Filter((1.0, depth * middle, frequency**2), (1.0, middle, frequency**2), frequency)


def lead_lag_filter(zero: float, pole: float) -> Filter:
    """(1 + s/ω_z)/(1 + s/ω_p): a lead where the zero is below the pole, else a lag; corners in rad/s.

    [Franklin2015] Sec. 6.7
    """
    _positive("lead-lag", "zero", zero)
    _positive("lead-lag", "pole", pole)
    return Filter((1 / zero, 1.0), (1 / pole, 1.0))


def pade_delay(delay: float, order: int) -> Filter:
    """The delay e^{−sτ} as a Padé approximant of equal degrees, of gain one at every frequency.

    [Golub2013] Sec. 9.3; its phase is right to about 2 (n!)²/((2n)! (2n+1)!) (ωτ)^{2n+1} rad, see `pade_error`.

    Parameters
    ----------
    delay
        τ [s].
    order
        n.
    """
    _positive("delay", "delay", delay)
    _whole("delay", order, 6)
    size = [
        comb(order, k) * factorial(2 * order - k) / factorial(2 * order) * delay**k
        for k in range(order, -1, -1)
    ]
    signs = [(-1.0) ** k for k in range(order, -1, -1)]
    return Filter(tuple(s * c for s, c in zip(signs, size, strict=True)), tuple(size))


def pade_error(delay: float, order: int, frequency: float) -> float:
    """|F(jω) − e^{−jωτ}| of `pade_delay` [-]."""
    s = 1j * frequency
    return float(abs(pade_delay(delay, order).response(s) - np.exp(-s * delay)))


def _positive(what: str, name: str, value: float) -> None:
    if not 0 < value < inf:
        raise ModelError(f"{what}: {name} {value} is not above zero; give a positive, finite one")


def _whole(what: str, order: int, largest: int) -> None:
    if order not in range(1, largest + 1):
        raise ModelError(f"{what}: order {order} is not one of 1 to {largest}")
