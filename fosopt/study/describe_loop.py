"""The controller of a study's start design as other tools write it, for ``fosopt check``."""

from __future__ import annotations

from collections.abc import Iterator

from fosopt.control import PID, SignalPath, pade_error
from fosopt.control.discrete import discrete_controller
from fosopt.control.pid_forms import form_lines
from fosopt.problem import Problem
from fosopt.study.build import start_vector
from fosopt.study.build_loop import loop_filter
from fosopt.study.schema import Study
from fosopt.study.schema_loop import LoopFilter
from fosopt.units import HZ, show


def describe_controller(study: Study, problem: Problem) -> list[str]:
    """The PID in every form it has, its filters, and what a digital controller runs."""
    controller = problem.design(start_vector(study, problem)).loop.controller
    lines = ["", "controller of the start design"]
    lines += [f"  {line}" for line in (*form_lines(controller), *_path(study), *_sampled(controller))]
    if study.limits is not None:
        given = {"stroke": "angle", "rate": "angular_rate", "torque": "torque"}
        limits = [
            f"{name} at most {show(value, dimension)}"
            for name, dimension in given.items()
            if (value := getattr(study.limits, name)) is not None
        ]
        pattern = study.limits.pattern.replace("_", " ")
        lines.append(f"  limits: {', '.join(limits)}, over {study.limits.engagements} steps in a {pattern}")
    return lines


def _path(study: Study) -> Iterator[str]:
    for each in study.controller.filters:
        yield f"filter: {_filter(each)}"
    analog = study.controller.anti_alias
    if analog is not None:
        yield f"anti-alias: low pass of order {analog.order} at {show(analog.corner, 'frequency')}"


def _filter(given: LoopFilter) -> str:
    match given.type:
        case "low_pass":
            return f"low pass of order {given.order} at {show(given.corner, 'frequency')}"
        case "notch":
            width = f"damping ratio {given.damping_ratio:g}, depth {given.depth:g}"
            return f"notch at {show(given.frequency, 'frequency')}, {width}"
        case "lead_lag":
            return f"zero at {show(given.zero, 'frequency')}, pole at {show(given.pole, 'frequency')}"
        case _:
            found = loop_filter(given)
            return f"rational of order {found.order}, gain {found.response(0.0):.6g} at zero frequency"


def _sampled(controller: PID) -> Iterator[str]:
    path: SignalPath = controller.path
    sampling = path.sampling
    if sampling is None:
        return
    yield (
        f"sampled: every {1e6 * sampling.period:.6g} us ({1 / sampling.period:.6g} Hz), torque "
        f"{1e6 * sampling.delay:.6g} us later, held; derivative {sampling.derivative}, all else trapezoidal"
    )
    frequency = 0.1 / sampling.period * HZ
    off = pade_error(sampling.lag, sampling.order, frequency)
    yield (
        f"continuous model: a Padé delay of order {sampling.order} and {1e6 * sampling.lag:.6g} us, off by {off:.2g} "
        f"at {show(frequency, 'frequency')}; designs are judged as sampled"
    )
    for line in discrete_controller(controller).lines():
        yield f"  {line}"
