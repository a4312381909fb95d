"""The second axis of a mirror in a study file, with a loop of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from fosopt.errors import did_you_mean
from fosopt.study.schema_base import (
    Frequency,
    Identifier,
    PositiveInertia,
    PositiveRatio,
    RuleError,
    Section,
)
from fosopt.study.schema_names import BY_AXIS
from fosopt.study.schema_system import Controller

if TYPE_CHECKING:
    from fosopt.study.schema import Study


class SecondAxis(Section):
    """A second axis about which the mirror turns on the same structure, both loops closed at once.

    What is left out is as about the first axis, also while a variable changes it there. Of a symmetric structure one
    loop may stand for both axes instead: see `other_axis` of the mirror.
    """

    port: Identifier
    """Where the mirror is mounted about it."""
    hub: Identifier | None = None
    """Port of the hub about it; needed where a torque on the hub acts about it."""
    inertia: PositiveInertia | None = None
    """The mirror's inertia about it."""
    frequency: Frequency | None = None
    """Natural frequency of the mirror about it on a rigid support."""
    damping_ratio: PositiveRatio | None = None
    """Damping ratio of the mirror about it on a rigid support."""
    controller: Controller | None = None
    """Its controller, complete; if left out, one like the first with the same crossover, or else the same gain."""


_ABSENT = {
    "placement": "the loops of two axes are bicollocated",
    "step": "a step command is about one axis",
    "limits": "limits are checked on a step, which is about one axis",
    "certificates": "bounds are those of one loop",
}
_WAY_OUT = "remove it, or study one axis without 'second_axis'"


def check_second_axis(study: Study) -> None:
    """Refuse what a mirror with two axes cannot have, and what needs a second axis where there is none."""
    given = study.second_axis
    if given is None:
        _check_alone(study)
        return
    if study.mirror.other_axis is not None:
        raise RuleError(
            "'other_axis' lets one loop stand for both axes, 'second_axis' closes two; remove one",
            *("mirror", "other_axis"),
            of_key=True,
        )
    for key, reason in _ABSENT.items():
        if getattr(study, key):
            raise RuleError(f"{reason}; {_WAY_OUT}", key, of_key=True)
    if study.mirror.reaction_mass is not None:
        raise RuleError(
            f"a reaction mass is about one axis; {_WAY_OUT}", "mirror", "reaction_mass", of_key=True
        )
    for at, controller in ((), study.controller), (("second_axis",), given.controller):
        if controller is not None and controller.sampling is not None:
            raise RuleError(
                f"the loops of two axes are continuous; {_WAY_OUT}",
                *at,
                "controller",
                "sampling",
                of_key=True,
            )
    _check_ports(study, given)
    for k, disturbance in enumerate(study.disturbances):
        if f"jitter_{disturbance.name}" in BY_AXIS:
            raise RuleError(
                f"'{disturbance.name}' is taken by the jitter of an axis; choose another name",
                *("disturbances", k, "name"),
            )
        if disturbance.at == "hub_torque" and disturbance.axis != "first" and given.hub is None:
            raise RuleError(
                "a torque on the hub about the second axis needs its port; add 'hub' to 'second_axis', or write "
                "'axis: first'",
                *("disturbances", k, "at"),
            )
    for k, axis in enumerate(study.sweep.axes if study.sweep is not None else ()):
        if axis.quantity == "mirror_port":
            raise RuleError(
                "a mirror with two axes stays at its ports; use another axis",
                *("sweep", "axes", k, "quantity"),
            )
    if study.sweep is not None and study.sweep.boundary is not None:
        raise RuleError(
            "boundaries are found of one loop; ask for the output 'stable' in place of it",
            *("sweep", "boundary"),
            of_key=True,
        )
    _check_gradients(study)


def _check_alone(study: Study) -> None:
    for k, disturbance in enumerate(study.disturbances):
        if disturbance.axis is not None:
            raise RuleError(
                "the mirror has one axis; remove 'axis', or add 'second_axis'",
                *("disturbances", k, "axis"),
                of_key=True,
            )
    for k, variable in enumerate(study.variables):
        if variable.of_second_axis:
            raise RuleError(
                "the mirror has one axis; remove 'axis', or add 'second_axis'",
                *("variables", k, "axis"),
                of_key=True,
            )


def _check_ports(study: Study, given: SecondAxis) -> None:
    ports = study.structure.ports
    for key, port in (("port", given.port), ("hub", given.hub)):
        if port is not None and port not in ports:
            raise RuleError(f"unknown port '{port}'; {did_you_mean(port, ports)}", "second_axis", key)
    if given.port == study.mirror.port:
        raise RuleError(
            f"'{given.port}' is the mirror's port about its first axis; name the one about the second",
            *("second_axis", "port"),
        )
    if isinstance(ports, Mapping):
        component = ports[given.port][1]
        if not component.startswith("r"):
            raise RuleError(
                f"the mirror turns, but its port moves along '{component}'; use rx, ry or rz of the mirror's batten",
                *("second_axis", "port"),
            )


def _check_gradients(study: Study) -> None:
    if study.kind != "codesign":
        return
    given = [(o.minimize, ("objectives", k, "minimize")) for k, o in enumerate(study.objectives)]
    given += [(c.metric, ("constraints", k, "metric")) for k, c in enumerate(study.constraints)]
    for expression, at in given:
        if any(name == "modulus_margin_multivariable" for name, _ in expression.references):
            raise RuleError(
                "'modulus_margin_multivariable' has no gradient and cannot be optimized for; use 'modulus_margin', the "
                "report has both",
                *at,
            )
