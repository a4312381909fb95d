"""The loop as built in a study file: filters, sampling, other forms of the PID, limits of the mirror."""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from fosopt.errors import ModelError, did_you_mean
from fosopt.forms import IdealForm, ParallelForm, SeriesForm
from fosopt.study.schema_base import (
    Count,
    Number,
    PositiveFrequency,
    PositiveRatio,
    PositiveTime,
    Quantity,
    RuleError,
    Section,
    Time,
    exactly_one,
    parsed,
    quantity_of,
)
from fosopt.units import quote, show

if TYPE_CHECKING:
    from fosopt.study.schema import Study

FilterOrder = Annotated[int, Field(strict=True, ge=1, le=8)]
PadeOrder = Annotated[int, Field(strict=True, ge=1, le=6)]
Coefficients = Annotated[tuple[Number, ...], Field(min_length=1, max_length=20)]
# Faster than any controller; in periods; of a step or a retargeting sequence, a tenth of a millisecond each.
_HIGHEST_RATE, _MOST_DELAY, _MOST_SAMPLES = 1e8, 100, 1_000_000
Depth = Annotated[float, Quantity("ratio", "nonnegative")]
ProportionalTorque = Annotated[float, Quantity("rotational_stiffness", "nonnegative")]
PositiveTorqueGain = Annotated[float, Quantity("rotational_stiffness", "positive")]
IntegralTorque = Annotated[float, Quantity("integral_gain", "nonnegative")]
DerivativeTorque = Annotated[float, Quantity("control_gain", "nonnegative")]


class LoopLowPass(Section):
    """A Butterworth low pass in the controller."""

    type: Literal["low_pass"]
    """Kind of filter."""
    corner: PositiveFrequency
    """Corner of the Butterworth filter."""
    order: FilterOrder = 1
    """Order of the Butterworth filter."""


class Notch(Section):
    """A notch; `depth` is its gain at the center, `damping_ratio` half its relative width."""

    type: Literal["notch"]
    """Kind of filter."""
    frequency: PositiveFrequency
    """Center of the notch."""
    damping_ratio: PositiveRatio
    """Half its relative width."""
    depth: Depth = 0.0
    """Its gain at the center."""


class LeadLag(Section):
    """A lead-lag, (1 + s/zero)/(1 + s/pole)."""

    type: Literal["lead_lag"]
    """Kind of filter."""
    zero: PositiveFrequency
    """Corner of the numerator."""
    pole: PositiveFrequency
    """Corner of the denominator."""


class LoopRational(Section):
    """F(s) by its coefficients, highest power first."""

    type: Literal["rational"]
    """Kind of filter."""
    numerator: Coefficients
    """Coefficients of the numerator in powers of s, SI."""
    denominator: Coefficients
    """Coefficients of the denominator in powers of s, SI."""


LoopFilter = Annotated[LoopLowPass | Notch | LeadLag | LoopRational, Field(discriminator="type")]


class AntiAlias(Section):
    """An analog Butterworth low pass between sensor and sampler."""

    corner: PositiveFrequency
    """Corner of the Butterworth filter."""
    order: FilterOrder = 2
    """Order of the Butterworth filter."""


class LoopSampling(Section):
    """How the controller samples, how long it computes, and what stands for that in the continuous model."""

    rate: PositiveFrequency | None = None
    """Sampling rate."""
    period: PositiveTime | None = None
    """Time between samples, in place of `rate`."""
    delay: Time = 0.0
    """Time from a sample to the torque computed from it."""
    derivative: Literal["backward", "trapezoidal"] = "backward"
    """How the derivative is discretized: by a backward difference or by the trapezoidal rule."""
    pade_order: PadeOrder = 3
    """Order of the Padé approximant that stands for delay and hold in the continuous model."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "rate", "period")
        return self

    @property
    def seconds(self) -> float:
        """Time between samples [s]."""
        # A rate is a frequency, and frequencies are rad/s here.
        period = 2 * pi / self.rate if self.rate is not None else self.period
        assert period is not None
        return period


class ParallelGains(Section):
    """K(s) = proportional + integral/s + derivative s/(1 + filter_time s)."""

    proportional: ProportionalTorque
    """Proportional gain."""
    integral: IntegralTorque = 0.0
    """Integral gain."""
    derivative: DerivativeTorque = 0.0
    """Derivative gain."""
    filter_time: Time = 0.0
    """Time constant of the derivative's roll-off; zero for an ideal derivative."""


class IdealGains(Section):
    """K(s) = gain (1 + 1/(integral_time s) + derivative_time s/(1 + filter_time s))."""

    gain: PositiveTorqueGain
    """Factor before the whole controller."""
    integral_time: PositiveTime | None = None
    """Integral time; no integral if left out."""
    derivative_time: Time = 0.0
    """Derivative time."""
    filter_time: Time = 0.0
    """Time constant of the derivative's roll-off; zero for an ideal derivative."""


class SeriesGains(Section):
    """K(s) = gain (1 + 1/(integral_time s)) (1 + derivative_time s)/(1 + filter_time s)."""

    gain: PositiveTorqueGain
    """Factor before the whole controller."""
    integral_time: PositiveTime | None = None
    """Integral time; no integral if left out."""
    derivative_time: Time = 0.0
    """Derivative time."""
    filter_time: Time = 0.0
    """Time constant of the derivative's roll-off; zero for an ideal derivative."""


def check_loop(study: Study) -> None:
    """Refuse what the loop of a study cannot have together."""
    controller, sampling = study.controller, study.controller.sampling
    if study.limits is not None and study.step is None:
        raise RuleError(
            "limits are checked on the step repeated as a sequence; add 'step'", "limits", of_key=True
        )
    gradients = [o.minimize for o in study.objectives] + [c.metric for c in study.constraints]
    for expression in gradients if study.kind == "codesign" else ():
        for name, _ in expression.references:
            if name.startswith("peak_"):
                raise RuleError(
                    f"'{name}' has no gradient and cannot be optimized for; 'limits' check it on every design",
                    "limits",
                )
    if sampling is None:
        return
    _check_sampling(study, sampling)
    if controller.kd and not controller.rolloff and sampling.derivative == "trapezoidal":
        raise RuleError(
            "the trapezoidal rule makes an ideal derivative ring at every second sample; add 'rolloff', or write "
            "'derivative: backward'",
            *("controller", "sampling", "derivative"),
        )


def _check_sampling(study: Study, sampling: LoopSampling) -> None:
    """Refuse what no digital controller does, mostly for a forgotten unit, and what would take for ever."""
    at = "controller", "sampling"
    given = "rate" if sampling.rate is not None else "period"
    period = sampling.seconds
    beyond = f"not below the Nyquist frequency {show(pi / period, 'frequency')}; sample faster, or lower it"
    if period < 1 / _HIGHEST_RATE:
        raise RuleError(
            f"{1 / period:.3g} samples a second, at most {_HIGHEST_RATE:.0e} can be; sample slower",
            *at,
            given,
        )
    if sampling.delay > _MOST_DELAY * period:
        raise RuleError(
            f"{sampling.delay:.6g} s are {sampling.delay / period:.6g} periods, at most {_MOST_DELAY} can be; give the "
            "time in its unit, such as 120 us",
            *at,
            "delay",
        )
    crossover = study.controller.crossover
    if crossover is not None and crossover * period >= pi:
        raise RuleError(f"{show(crossover, 'frequency')} is {beyond}", "controller", "crossover")
    for k, variable in enumerate(study.variables):
        if variable.quantity == "crossover" and variable.upper * period >= pi:
            raise RuleError(f"{show(variable.upper, 'frequency')} is {beyond}", "variables", k, "upper")
    if study.step is not None:
        lasts = study.step.window[1] * (1 if study.limits is None else study.limits.engagements)
        if lasts > _MOST_SAMPLES * period:
            raise RuleError(
                f"{lasts:.6g} s are {lasts / period:.3g} samples, at most {_MOST_SAMPLES} are followed; sample slower, "
                "or shorten the step's window",
                *at,
                given,
            )


FORMS: dict[str, type[ParallelGains | IdealGains | SeriesGains]] = {
    "parallel": ParallelGains,
    "ideal": IdealGains,
    "series": SeriesGains,
}
"""Forms of a PID that a controller may be given in, in place of gain, kd, kp and ki."""


class Limits(Section):
    """What the mirror can do, checked on the study's step repeated as a retargeting sequence."""

    stroke: Annotated[float, Quantity("angle", "positive")] | None = None
    """Largest angle of the mirror against its port."""
    rate: Annotated[float, Quantity("angular_rate", "positive")] | None = None
    """Largest rate of the mirror against its port."""
    torque: Annotated[float, Quantity("torque", "positive")] | None = None
    """Largest control torque."""
    engagements: Count = 10
    """How often the step is repeated."""
    pattern: Literal["square_wave", "staircase"] = "square_wave"
    """Out and back again, or always onward."""

    names: ClassVar[tuple[str, ...]] = ("stroke", "rate", "torque")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if all(getattr(self, name) is None for name in self.names):
            raise RuleError("no limit is given; add stroke, rate or torque")
        return self


def gains_of_form(data: Any) -> Any:
    """A controller given in another form with its gain, kd, kp and ki filled in; anything else as it is."""
    given = [name for name in FORMS if isinstance(data, dict) and data.get(name) is not None]
    if not given:
        return data
    name = given[0]
    if given[1:]:
        raise RuleError(f"'{name}' and '{given[1]}' exclude each other; remove one", given[1], of_key=True)
    inner = data[name]
    known = FORMS[name].model_fields
    if not isinstance(inner, dict):
        raise RuleError(f"{quote(inner)} is no section; give {', '.join(known)}", name)
    for key in inner:
        if key not in known:
            raise RuleError(f"unknown key; {did_you_mean(str(key), known)}", name, key, of_key=True)
    for key, field in known.items():
        if field.is_required() and key not in inner:
            raise RuleError(f"the key '{key}' is required; add it", name)
    keys: dict[str, float] = {}
    for key, field in known.items():
        if inner.get(key) is not None:
            quantity = quantity_of(field)
            assert quantity is not None
            keys[key] = parsed(inner[key], quantity, name, key)
    try:
        if name == "parallel":
            terms = ParallelForm(**keys)
        else:
            terms = (IdealForm if name == "ideal" else SeriesForm)(**keys).parallel
        gain, kp, ki, kd = terms.normalized
    except ModelError as error:
        raise RuleError(str(error), name) from None
    found = {"kd": kd, "kp": kp, "ki": ki}
    if terms.filter_time:
        found["rolloff"] = 1 / terms.filter_time
    if data.get("crossover") is None:
        found["gain"] = gain
    for key in ("gain", "kd", "kp", "ki", "rolloff"):
        # A study that was written down has the same number in both places.
        if data.get(key) is not None and data[key] != found.get(key):
            raise RuleError(f"'{name}' and '{key}' exclude each other; remove one", key, of_key=True)
    return data | found
