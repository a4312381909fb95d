"""The line-of-sight controller."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Any, Literal

from fosopt.actuators import Mirror
from fosopt.control.filters import Filter, pade_delay
from fosopt.errors import ModelError
from fosopt.ops import ComplexPair, sqrt


@dataclass(frozen=True)
class Sampling:
    """How a digital controller samples its sensor and holds its output.    [Astrom1997] Ch. 8

    Attributes
    ----------
    period
        T, between samples [s].
    delay
        From a sample to the change of the held torque that follows from it; may exceed a period [s].
    derivative
        How the derivative is discretized: by a backward difference, s = (z − 1)/(T z), or by the trapezoidal rule,
        s = 2/T (z − 1)/(z + 1), which needs a roll-off. Integral and filters follow the trapezoidal rule.
    order
        Of the Padé approximant that stands for delay and hold in the continuous model of the loop.
    """

    period: float
    delay: float = 0.0
    derivative: Literal["backward", "trapezoidal"] = "backward"
    order: int = 3

    def __post_init__(self) -> None:
        if not 0 < self.period < inf:
            raise ModelError(
                f"sampling: period {self.period} s is not above zero; give a positive, finite one"
            )
        if not 0 <= self.delay < inf:
            raise ModelError(f"sampling: delay {self.delay} s is negative or not finite; give zero or more")
        if self.derivative not in ("backward", "trapezoidal"):
            raise ModelError(
                f"sampling: derivative '{self.derivative}' is neither 'backward' nor 'trapezoidal'"
            )
        # The approximant checks its order.
        pade_delay(self.lag, self.order)

    @property
    def lag(self) -> float:
        """Delay and half a period, by which a hold lags [s].    [Astrom1997] Ch. 8"""
        return self.delay + 0.5 * self.period


@dataclass(frozen=True)
class SignalPath:
    """What lies between sensor and torque beside the PID itself.

    Attributes
    ----------
    filters
        On the error: roll-off, notches. Part of the digital controller where there is one.
    anti_alias
        Analog filters on the measurement; the command does not pass them.
    sampling
        Of a digital controller. A continuous model of the loop has a Padé approximant of its lag in its place.
    """

    filters: tuple[Filter, ...] = ()
    anti_alias: tuple[Filter, ...] = ()
    sampling: Sampling | None = None

    @cached_property
    def on_error(self) -> tuple[Filter, ...]:
        """What the error passes in the continuous model of the loop."""
        sampling = self.sampling
        return self.filters if sampling is None else (*self.filters, pade_delay(sampling.lag, sampling.order))

    @cached_property
    def sections(self) -> tuple[Filter, ...]:
        """What the measurement passes in the continuous model of the loop."""
        return (*self.anti_alias, *self.on_error)

    @property
    def derivative_lag(self) -> float:
        """What a backward difference adds to the roll-off in the continuous model, half a period [s].

        (1 − e^{−sT})/T is s/(1 + sT/2) but for terms of second order.
        """
        sampling = self.sampling
        return 0.5 * sampling.period if sampling is not None and sampling.derivative == "backward" else 0.0


DIRECT = SignalPath()


@dataclass(frozen=True)
class PID:
    """PID controller K(s) = gain (k_d s² + k_p s + k_i)/s, with filters.    [Barker1991] Eq. (3.25)

    Attributes
    ----------
    gain, kp, ki, kd
        The product gain k_p is in [N m/rad], gain k_i in [N m/(rad s)], gain k_d in [N m s/rad].
    rolloff_time
        Time constant of a first-order low pass on the derivative term, zero for none [s].
    path
        Filters and sampling.
    """

    gain: Any
    kp: Any
    ki: Any
    kd: Any
    rolloff_time: Any = 0.0
    path: SignalPath = DIRECT

    @property
    def lag(self) -> Any:
        """Time constant of the low pass on the derivative, with what a backward difference adds to it [s]."""
        return self.rolloff_time + self.path.derivative_lag


def pid_response(controller: PID, s: Any) -> Any:
    """K(s), torque per measured line-of-sight error [N m/rad].    [Barker1991] Eq. (3.25)"""
    return _filtered(controller, controller.path.sections, s)


def command_response(controller: PID, s: Any) -> Any:
    """Torque per command as long as nothing is measured, K(s) without the anti-alias filters [N m/rad]."""
    return _filtered(controller, controller.path.on_error, s)


def _filtered(controller: PID, sections: tuple[Filter, ...], s: Any) -> Any:
    derivative = controller.kd * s / (1 + controller.lag * s)
    response = controller.gain * (controller.kp + controller.ki / s + derivative)
    for section in sections:
        response = response * section.response(s)
    return response


def gain_for_crossover(
    crossover: Any,
    mirror: Mirror,
    kp: Any,
    ki: Any,
    kd: Any,
    rolloff_time: Any,
    path: SignalPath = DIRECT,
) -> Any:
    """Gain at which the loop of the rigidly supported mirror crosses unity.    [Barker1991] Sec. 4.4

    Solves |G(jω) K(jω)| = 1 with G of Eq. (2.41), in real arithmetic so that one text serves numbers and symbols.

    Parameters
    ----------
    crossover
        ω [rad/s].
    """
    w, wm = crossover, mirror.natural_frequency
    spring = mirror.inertia * (wm**2 - w**2)
    damper = mirror.damping * w
    lag = rolloff_time + path.derivative_lag
    # j w / (1 + j w T) = (w² T + j w) / (1 + w² T²)
    low_pass = 1 + (w * lag) ** 2
    real = kp + kd * w**2 * lag / low_pass
    imag = kd * w / low_pass - ki / w
    gain = sqrt(spring**2 + damper**2) / sqrt(real**2 + imag**2)
    for section in path.sections:
        passed = section.response(ComplexPair(0.0, w))
        gain = gain / sqrt(passed.re**2 + passed.im**2)
    return gain
