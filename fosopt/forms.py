"""The PID controller in the forms other tools use.

| form | K(s) |
|---|---|
| parallel | k_p + k_i/s + k_d s/(1 + T_f s) |
| ideal (standard, noninteracting) | K (1 + 1/(T_i s) + T_d s/(1 + T_f s)) |
| series (interacting) | K (1 + 1/(T_i s)) (1 + T_d s)/(1 + T_f s) |

[Astrom2006] Ch. 3
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isclose

from fosopt.errors import ModelError

# A derivative gain that cancels but for rounding is none.
_NONE = 1e-12


@dataclass(frozen=True)
class ParallelForm:
    """Proportional, integral and derivative gains.

    Attributes
    ----------
    proportional, integral, derivative
        k_p [N m/rad], k_i [N m/(rad s)], k_d [N m s/rad].
    filter_time
        T_f [s].
    """

    proportional: float
    integral: float = 0.0
    derivative: float = 0.0
    filter_time: float = 0.0

    def __post_init__(self) -> None:
        _refuse("parallel", self, ("proportional", "integral", "derivative", "filter_time"))

    @property
    def normalized(self) -> tuple[float, float, float, float]:
        """Gain, k_p, k_i and k_d of gain (k_d s² + k_p s + k_i)/s, the first of k_d, k_p and k_i that is not zero one.

        [Barker1991] Eq. (3.25)

        Raises
        ------
        ModelError
            If all gains are zero.
        """
        gain = self.derivative or self.proportional or self.integral
        if not gain:
            raise ModelError("PID: all gains are zero; give at least one above zero")
        return gain, self.proportional / gain, self.integral / gain, self.derivative / gain


@dataclass(frozen=True)
class IdealForm:
    """Gain and times, each term with the gain in front.

    Attributes
    ----------
    gain
        K [N m/rad].
    integral_time
        T_i, infinite for none [s].
    derivative_time, filter_time
        T_d, T_f [s].
    """

    gain: float
    integral_time: float = inf
    derivative_time: float = 0.0
    filter_time: float = 0.0

    def __post_init__(self) -> None:
        _refuse_times("ideal", self)

    @property
    def parallel(self) -> ParallelForm:
        """The same controller in parallel form."""
        return ParallelForm(
            self.gain, self.gain / self.integral_time, self.gain * self.derivative_time, self.filter_time
        )


@dataclass(frozen=True)
class SeriesForm:
    """Gain and times of an integrating and a leading part in series.

    Attributes
    ----------
    gain
        K [N m/rad].
    integral_time
        T_i, infinite for none [s].
    derivative_time, filter_time
        T_d, T_f [s].
    """

    gain: float
    integral_time: float = inf
    derivative_time: float = 0.0
    filter_time: float = 0.0

    def __post_init__(self) -> None:
        _refuse_times("series", self)

    @property
    def parallel(self) -> ParallelForm:
        """The same controller in parallel form; its roll-off acts on the derivative alone.

        Raises
        ------
        ModelError
            If the roll-off is so slow that a gain of the parallel form is negative.
        """
        lead, lag, integral = self.derivative_time, self.filter_time, self.gain / self.integral_time
        proportional = self.gain + integral * (lead - lag)
        derivative = self.gain * lead - proportional * lag
        if isclose(self.gain * lead, proportional * lag, rel_tol=_NONE):
            derivative = 0.0
        if proportional < 0 or derivative < 0:
            raise ModelError(
                f"PID: the series form with derivative time {lead:.6g} s and filter time {lag:.6g} s has a negative "
                "gain in parallel form; make the filter time smaller than the derivative time"
            )
        return ParallelForm(proportional, integral, derivative, lag)


def _refuse(form: str, given: object, names: tuple[str, ...]) -> None:
    for name in names:
        value = getattr(given, name)
        if not 0 <= value < inf:
            raise ModelError(f"PID in {form} form: {name} {value} is negative or not finite")


def _refuse_times(form: str, given: IdealForm | SeriesForm) -> None:
    _refuse(form, given, ("gain", "derivative_time", "filter_time"))
    if not given.gain > 0:
        raise ModelError(f"PID in {form} form: gain {given.gain} is not above zero; give a positive one")
    if not given.integral_time > 0:
        raise ModelError(
            f"PID in {form} form: integral_time {given.integral_time} s is not above zero; leave it out for none"
        )
