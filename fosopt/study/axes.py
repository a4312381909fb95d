"""A mirror that turns about two axes on one structure: when one loop stands for both."""

from __future__ import annotations

import numpy as np

from fosopt.errors import ModelError
from fosopt.modes.axes import axis_coupling, axis_difference
from fosopt.ops import Array
from fosopt.problem import Evaluation, Problem
from fosopt.study.schema_system import OtherAxis

# Modal constants this far (relative) from what symmetry makes them are rounding, of the model's file included.
_ALIKE = 1e-6

_WAY_OUT = "one loop cannot stand for both: make structure and groups symmetric, or study one axis without 'other_axis'"


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
