"""Design variables and how they become the parameters of a design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import sparse

from fosopt import ops
from fosopt.actuators import Mirror
from fosopt.control import SignalPath, gain_for_crossover
from fosopt.errors import ModelError
from fosopt.ops import Array
from fosopt.problem.system import Design, System
from fosopt.structure import structure_inertia
from fosopt.symbolic import LOOP_PARAMETERS, loop_parameters

Quantity = Literal[
    "area",
    "batten_mass",
    "spring_stiffness",
    "mirror_inertia",
    "mirror_inertia_ratio",
    "mirror_frequency",
    "gain",
    "crossover",
    "kp",
    "ki",
    "kd",
]
Discipline = Literal["structure", "control"]

_MEMBERS = ("area", "batten_mass", "spring_stiffness")


@dataclass(frozen=True)
class Variable:
    """One design variable, a scalar or one value per group of members.

    Attributes
    ----------
    name
        Unique identifier.
    quantity
        What it sets.
    lower, upper, start
        (g,) bounds and start value, in the unit of the quantity.
    log
        Whether the optimizer works on its logarithm; needs a positive lower bound.
    groups
        For areas, batten masses and spring stiffnesses: the indices of the members in each of the g groups.
    labels
        (g,) names of the groups.
    axis
        Of a mirror with two axes, the one whose mirror or controller it sets.
    """

    name: str
    quantity: Quantity
    lower: Array
    upper: Array
    start: Array
    log: bool = True
    groups: tuple[tuple[int, ...], ...] = ()
    labels: tuple[str, ...] = ()
    axis: Literal["first", "second"] = "first"

    def __post_init__(self) -> None:
        if self.axis == "second" and self.quantity in (*_MEMBERS, "mirror_inertia_ratio"):
            raise ModelError(
                f"variable '{self.name}': '{self.quantity}' is not about one axis; leave 'axis' out"
            )
        for low, high, start in zip(self.lower, self.upper, self.start, strict=True):
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise ModelError(
                    f"variable '{self.name}': bounds {low:g} and {high:g} cross; the lower must be below the upper"
                )
            if not low <= start <= high:
                raise ModelError(
                    f"variable '{self.name}': start {start:g} lies outside {low:g} to {high:g}; move it or the bounds"
                )
            if self.log and not low > 0:
                raise ModelError(
                    f"variable '{self.name}': lower bound {low:g} is not positive; raise it or use a linear scale"
                )

    @property
    def size(self) -> int:
        """Number of groups, one for a scalar."""
        return int(self.start.size)

    @property
    def discipline(self) -> Discipline:
        """Who sizes it in the sequential habit: structure first, then mirror and controller."""
        return "structure" if self.quantity in _MEMBERS else "control"


@dataclass(frozen=True)
class Definitions:
    """Quantities that follow others unless they are design variables.

    Attributes
    ----------
    inertia_ratio
        When given, J_m is this multiple of the structure's inertia about the hub.
    crossover
        When given, the gain is the one that puts the crossover of the rigidly supported mirror here [rad/s].
    second
        The same of a second axis.
    """

    inertia_ratio: float | None = None
    crossover: float | None = None
    second: SecondAxisDefinitions | None = None


@dataclass(frozen=True)
class SecondAxisDefinitions:
    """What the second axis of a mirror has for itself; all else follows the first axis.

    Attributes
    ----------
    own
        Names of `LOOP_PARAMETERS`. Where the first gain follows a crossover and the second is not its own, it follows
        the same crossover.
    crossover
        As in `Definitions`, of a gain of its own.
    """

    own: frozenset[str] = frozenset()
    crossover: float | None = None


def design_parameters(
    system: System, base: Design, definitions: Definitions, variables: Sequence[Variable], x: Any
) -> Any:
    """Parameters of a design (areas, batten masses, spring stiffnesses, loop) from the values of all variables.

    One text for numbers and symbols; its Jacobian carries gradients from parameters to variables.

    Parameters
    ----------
    x
        (n,) values of the variables one after another.

    Returns
    -------
    (b + r + s + 8,), with a second axis (b + r + s + 16,)
        In the order of `Design.parameters`.
    """
    structure = system.structure
    values: dict[str, dict[str, Any]] = {"first": {}, "second": {}}
    members: dict[str, Any] = {name: getattr(base, name) for name in _MEMBERS}
    offset = 0
    for variable in variables:
        part = x[offset : offset + variable.size]
        offset += variable.size
        if variable.groups:
            base_values = members[variable.quantity]
            spread = _membership(variable, len(getattr(base, variable.quantity)))
            fixed = 1.0 - np.asarray(spread.sum(axis=1)).ravel()
            members[variable.quantity] = base_values * fixed + ops.linear(spread, part)
        else:
            values[variable.axis][variable.quantity] = part[0]
    known, count = loop_parameters(base.loop), len(LOOP_PARAMETERS)
    loop = dict(zip(LOOP_PARAMETERS, known[:count], strict=True))
    ratio = values["first"].get("mirror_inertia_ratio", definitions.inertia_ratio)
    if ratio is not None:
        loop["mirror_inertia"] = ratio * structure_inertia(structure, members["area"], members["batten_mass"])
    loop |= {name: value for name, value in values["first"].items() if name in loop}
    crossover = values["first"].get("crossover", definitions.crossover)
    if "gain" in values["first"]:
        crossover = None
    _gain_of_crossover(loop, crossover, base.loop.controller.path)
    axes = [loop]
    if base.loop.beside is not None:
        second = definitions.second or SecondAxisDefinitions()
        own = dict(zip(LOOP_PARAMETERS, known[count:], strict=True))
        other = {name: own[name] if name in second.own else loop[name] for name in LOOP_PARAMETERS}
        other |= {name: value for name, value in values["second"].items() if name in other}
        if "gain" in second.own:
            crossover = second.crossover
        crossover = None if "gain" in values["second"] else values["second"].get("crossover", crossover)
        _gain_of_crossover(other, crossover, base.loop.beside.controller.path)
        axes.append(other)
    return ops.stack(*members.values(), *(axis[name] for axis in axes for name in LOOP_PARAMETERS))


def _gain_of_crossover(loop: dict[str, Any], crossover: Any, path: SignalPath) -> None:
    """Set the gain of a loop's parameters to what puts the crossover here, if it is given."""
    if crossover is None:
        return
    mirror = Mirror(loop["mirror_inertia"], loop["mirror_frequency"], loop["mirror_damping_ratio"])
    kp, ki, kd, time = (loop[name] for name in ("kp", "ki", "kd", "rolloff_time"))
    loop["gain"] = gain_for_crossover(crossover, mirror, kp, ki, kd, time, path)


def _membership(variable: Variable, count: int) -> sparse.csr_array:
    """(count, g) One where a member belongs to a group."""
    rows = [member for group in variable.groups for member in group]
    columns = [g for g, group in enumerate(variable.groups) for _ in group]
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, variable.size))
