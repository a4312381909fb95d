"""From the loop of a study to filters, sampling and limits of the mirror."""

from __future__ import annotations

from typing import Literal

from fosopt.actuators import Mirror
from fosopt.control import (
    PID,
    Filter,
    Sampling,
    SignalPath,
    gain_for_crossover,
    lead_lag_filter,
    low_pass_filter,
    notch_filter,
)
from fosopt.errors import ModelError
from fosopt.expressions import parse_expression
from fosopt.metrics.sequence import Retargeting
from fosopt.problem import Constraint
from fosopt.study.schema import Study
from fosopt.study.schema_loop import LeadLag, LoopFilter, LoopLowPass, LoopSampling, Notch
from fosopt.study.schema_system import Controller


def controller_of(study: Study, given: Controller, mirror: Mirror, *at: str) -> PID:
    """The controller that stands at a place of a study, for its mirror.

    Raises
    ------
    StudyError
        For a filter that is not stable or not proper, with its line.
    """
    path, gain = _signal_path(study, given, *at), given.gain
    lag = 1 / given.rolloff if given.rolloff is not None else 0.0
    if gain is None:
        gain = float(gain_for_crossover(given.crossover, mirror, given.kp, given.ki, given.kd, lag, path))
    return PID(gain, given.kp, given.ki, given.kd, lag, path)


def _signal_path(study: Study, given: Controller, *at: str) -> SignalPath:
    filters = []
    for k, each in enumerate(given.filters):
        try:
            filters.append(loop_filter(each))
        except ModelError as error:
            raise study.error(str(error), *at, "filters", k) from error
    analog = given.anti_alias
    anti_alias = () if analog is None else (low_pass_filter(analog.corner, analog.order),)
    return SignalPath(
        tuple(filters), anti_alias, None if given.sampling is None else _sampling(given.sampling)
    )


def loop_filter(given: LoopFilter) -> Filter:
    """The filter a study describes."""
    if isinstance(given, LoopLowPass):
        return low_pass_filter(given.corner, given.order)
    if isinstance(given, Notch):
        return notch_filter(given.frequency, given.damping_ratio, given.depth)
    if isinstance(given, LeadLag):
        return lead_lag_filter(given.zero, given.pole)
    return Filter(given.numerator, given.denominator)


def _sampling(given: LoopSampling) -> Sampling:
    return Sampling(given.seconds, given.delay, given.derivative, given.pade_order)


def mirror_limits(study: Study) -> tuple[Retargeting | None, tuple[Constraint, ...]]:
    """The sequence on which a study's limits are checked, and the limits; none without them."""
    limits, step = study.limits, study.step
    if limits is None or step is None:
        return None, ()
    start, end = step.window
    pattern: Literal["square wave", "staircase"] = (
        "staircase" if limits.pattern == "staircase" else "square wave"
    )
    sequence = Retargeting(step.command, start, end - start, limits.engagements, pattern)
    given = {f"peak_{name}": getattr(limits, name) for name in limits.names}
    checks = [
        Constraint(parse_expression(metric), upper=value)
        for metric, value in given.items()
        if value is not None
    ]
    return sequence, tuple(checks)
