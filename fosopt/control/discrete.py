"""The controller as a digital computer runs it: transfer functions in z and their difference equations."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, tan
from typing import Any

import numpy as np

from fosopt.control.filter_states import PASSING, FilterStates, rational_states
from fosopt.control.filters import Filter, horner
from fosopt.control.pid import PID, Sampling
from fosopt.errors import ModelError
from fosopt.ops import Array, ComplexArray


@dataclass(frozen=True)
class DiscreteFilter:
    """A rational function of z with as many zeros as poles or fewer.

    Attributes
    ----------
    numerator, denominator
        Real coefficients, highest power of `z` first; both of the same length, the denominator led by one.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    def response(self, z: Any) -> Any:
        """Its value at `z`."""
        return horner(self.numerator, z) / horner(self.denominator, z)

    def equation(self, output: str, given: str) -> str:
        """The difference equation that a computer runs, such as u[k] = 0.5 u[k-1] + 2 e[k]."""
        terms = [(-c, output, k) for k, c in enumerate(self.denominator) if k]
        terms += [(c, given, k) for k, c in enumerate(self.numerator)]
        shown = [f"{c:+.12g} {name}[k{f'-{k}' if k else ''}]" for c, name, k in terms if c]
        text = " ".join(f"{s[0]} {s[1:]}" for s in shown).removeprefix("+ ")
        return f"{output}[k] = {text or '0'}"


@dataclass(frozen=True)
class DiscreteController:
    """PID and filters in z, from error to torque.    [Astrom1997] Sec. 8.2, 8.5

    Attributes
    ----------
    period
        [s].
    pid
        Terms in parallel: proportional, integral and derivative, with their gains in them [N m/rad].
    filters
        In series with their sum, before it.
    """

    period: float
    pid: tuple[DiscreteFilter, ...]
    filters: tuple[DiscreteFilter, ...]

    def response(self, z: ComplexArray) -> ComplexArray:
        """(m,) C(z) [N m/rad]."""
        value: ComplexArray = np.zeros_like(z)
        for term in self.pid:
            value = value + term.response(z)
        for each in self.filters:
            value = value * each.response(z)
        return value

    @property
    def states(self) -> FilterStates:
        """The same as states, from error to torque."""
        chain = PASSING
        for each in self.filters:
            chain = chain.then(rational_states(each.numerator, each.denominator))
        terms = [rational_states(each.numerator, each.denominator) for each in self.pid]
        a = np.zeros((sum(t.order for t in terms),) * 2)
        first = 0
        for t in terms:
            a[first : first + t.order, first : first + t.order] = t.a
            first += t.order
        b, c = np.concatenate([t.b for t in terms]), np.concatenate([t.c for t in terms])
        return chain.then(FilterStates(a, b, c, sum(t.d for t in terms)))

    def lines(self) -> list[str]:
        """Its difference equations, one to a line, from the error e to the torque u."""
        found, signal = [], "e"
        for k, each in enumerate(self.filters):
            found.append(each.equation(f"e{k + 1}", signal))
            signal = f"e{k + 1}"
        names = ("p", "i", "d")[: len(self.pid)]
        found += [term.equation(name, signal) for name, term in zip(names, self.pid, strict=True)]
        return [*found, f"u[k] = {' + '.join(f'{name}[k]' for name in names)}"]


def discrete_controller(controller: PID) -> DiscreteController:
    """The controller at the samples of its `Sampling`; anti-alias filters stay analog.

    Raises
    ------
    ModelError
        If it is not sampled, if the trapezoidal rule meets a derivative without roll-off, or if a notch lies beyond the
        Nyquist frequency.
    """
    sampling = controller.path.sampling
    if sampling is None:
        raise ModelError("discrete controller: the loop is not sampled; give it a sampling period")
    step, gain = sampling.period, float(controller.gain)
    proportional = DiscreteFilter((gain * controller.kp,), (1.0,))
    half = 0.5 * step * gain * controller.ki
    integral = DiscreteFilter((half, half), (1.0, -1.0))
    derivative = _derivative(sampling, gain * controller.kd, float(controller.rolloff_time))
    filters = tuple(trapezoidal(each, step) for each in controller.path.filters)
    return DiscreteController(
        step,
        (
            proportional,
            integral if controller.ki else _nothing(),
            derivative if controller.kd else _nothing(),
        ),
        filters,
    )


def _nothing() -> DiscreteFilter:
    return DiscreteFilter((0.0,), (1.0,))


def _derivative(sampling: Sampling, gain: float, lag: float) -> DiscreteFilter:
    """Gain s/(1 + lag s) with s replaced as the sampling says."""
    step = sampling.period
    if sampling.derivative == "backward":
        top = gain / (step + lag)
        return DiscreteFilter((top, -top), (1.0, -lag / (step + lag)))
    if not lag > 0:
        raise ModelError(
            "sampling: the trapezoidal rule makes an ideal derivative ring at every second sample; "
            "add a roll-off, or write 'derivative: backward'"
        )
    top = 2 * gain / (step + 2 * lag)
    return DiscreteFilter((top, -top), (1.0, (step - 2 * lag) / (step + 2 * lag)))


def trapezoidal(given: Filter, period: float) -> DiscreteFilter:
    """A filter with s = a (z − 1)/(z + 1), a chosen so that it is the same at its center frequency.

    Without a center a is 2/T. The trapezoidal rule keeps every stable filter stable.    [Astrom1997] Sec. 8.2

    Raises
    ------
    ModelError
        If the center lies at or beyond the Nyquist frequency.
    """
    if given.center * period >= pi:
        raise ModelError(
            f"filter: center {given.center / (2 * pi):.6g} Hz is not below the Nyquist frequency "
            f"{0.5 / period:.6g} Hz; sample faster"
        )
    rate = given.center / tan(0.5 * given.center * period) if given.center else 2 / period
    n = given.order
    numerator = _bilinear(np.concatenate([np.zeros(given.relative_degree), given.numerator]), rate, n)
    denominator = _bilinear(np.asarray(given.denominator, dtype=float), rate, n)
    lead = float(denominator[0])
    return DiscreteFilter(tuple((numerator / lead).tolist()), tuple((denominator / lead).tolist()))


def _bilinear(coefficients: Array, rate: float, degree: int) -> Array:
    """(n+1,) Coefficients of Σ c_i [a (z − 1)]^i (z + 1)^{n−i}."""
    total = np.zeros(degree + 1)
    for k, c in enumerate(coefficients):
        power = degree - k
        total += c * rate**power * np.poly(np.concatenate([np.ones(power), -np.ones(degree - power)]))
    return total
