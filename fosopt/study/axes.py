"""A mirror that turns about two axes on one structure: when one loop stands for both, and the second axis if not."""

from __future__ import annotations

import numpy as np

from fosopt.actuators import Mirror
from fosopt.control import PID, SteeredAxis
from fosopt.errors import ModelError
from fosopt.modes.axes import axis_coupling, axis_difference
from fosopt.ops import Array
from fosopt.problem import Evaluation, Problem, SecondAxisDefinitions
from fosopt.study.build_loop import controller_of
from fosopt.study.schema import Study
from fosopt.study.schema_system import OtherAxis

# Modal constants this far (relative) from what symmetry makes them are rounding, of the model's file included.
_ALIKE = 1e-6

_WAY_OUT = (
    "one loop cannot stand for both: close both with 'second_axis' in place of 'other_axis', or make structure and "
    "groups symmetric"
)


def second_axis(study: Study, mirror: Mirror, controller: PID) -> SteeredAxis | None:
    """The second axis of a study's mirror, what it leaves out being as about the first.

    Raises
    ------
    StudyError
        For a filter that is not stable or not proper, with its line.
    """
    given, first = study.second_axis, study.controller
    if given is None:
        return None
    mirror = Mirror(
        mirror.inertia if given.inertia is None else given.inertia,
        mirror.natural_frequency if given.frequency is None else given.frequency,
        mirror.damping_ratio if given.damping_ratio is None else given.damping_ratio,
    )
    if given.controller is not None:
        controller = controller_of(study, given.controller, mirror, "second_axis", "controller")
    elif first.crossover is not None:
        controller = controller_of(study, first, mirror, "controller")
    return SteeredAxis(given.port, mirror, controller, given.hub)


def second_axis_definitions(study: Study) -> SecondAxisDefinitions | None:
    """What a study's second axis has for itself, so that it does not follow the first."""
    given = study.second_axis
    if given is None:
        return None
    own = [
        f"mirror_{key}"
        for key in ("inertia", "frequency", "damping_ratio")
        if getattr(given, key) is not None
    ]
    if given.controller is None:
        return SecondAxisDefinitions(frozenset(own))
    own += ["gain", "kp", "ki", "kd", "rolloff_time"]
    return SecondAxisDefinitions(frozenset(own), given.controller.crossover)


def check_other_axis(given: OtherAxis, problem: Problem, start: Array) -> float:
    """Coupling of the two axes at the start, after a refusal of a structure whose axes couple or differ.

    Weights are linear in the sizes of members, so that what holds at a design where no two sizes are related holds at
    all of them: it is tried at the start, and at one with sizes of its own in every group.

    Raises
    ------
    ModelError
        If a receptance between the axes is not zero, or one of the other axis is not that of the first.
    """
    coupling = _check(given, problem.evaluate(start))
    generic = start.copy()
    for variable in problem.variables:
        part = problem.slices()[variable.name]
        if variable.groups:
            share = np.random.default_rng(1).uniform(0.3, 0.7, variable.size)
            generic[part] = variable.lower + share * (variable.upper - variable.lower)
    if not np.array_equal(generic, start):
        _check(given, problem.evaluate(generic))
    return coupling


def _check(given: OtherAxis, evaluation: Evaluation) -> float:
    system = evaluation.system
    own = ("hub", system.mirror_port)
    ports = (*own, given.hub or "hub", given.port)
    modes = evaluation.frame.modal_set(system.hub, system.damping, ports)
    pairs = [(own[1], given.port)]
    if given.hub is not None:
        pairs += [(given.hub, own[1]), ("hub", given.port)]
    coupling = 0.0
    for port, other in pairs:
        found = axis_coupling(modes, port, other)
        coupling = max(coupling, found)
        if found > _ALIKE:
            raise ModelError(
                f"the axes couple: '{port}' and '{other}' share modes with {found:.2g} of their own modal constants; "
                f"{_WAY_OUT}"
            )
    alike = [((own[1], own[1]), (given.port, given.port))]
    if given.hub is not None:
        alike.append(((own[0], own[1]), (given.hub, given.port)))
    for first, second in alike:
        found = axis_difference(modes, first, second)
        if found > _ALIKE:
            raise ModelError(
                f"the axes differ: '{second[1]}' has modal constants {found:.2g} from those of '{first[1]}'; {_WAY_OUT}"
            )
    return coupling
