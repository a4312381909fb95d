"""A co-design problem as data, and the oracle that answers for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from math import inf
from typing import Any

import numpy as np
from scipy import sparse

from fosopt import ops
from fosopt.errors import ModelError, did_you_mean
from fosopt.expressions import Expression, Reference, parse_expression
from fosopt.ops import Array
from fosopt.problem.evaluation import BRANCHES, Evaluation
from fosopt.problem.system import INDEXED, Design, System
from fosopt.problem.two_axes import evaluation_of
from fosopt.problem.variables import Definitions, Variable, design_parameters
from fosopt.symbolic import Differentiable, OracleFunction


@dataclass(frozen=True)
class Constraint:
    """lower ≤ expression ≤ upper, in SI units."""

    expression: Expression
    lower: float = -inf
    upper: float = inf

    def __post_init__(self) -> None:
        if not self.lower <= self.upper or (self.lower == -inf and self.upper == inf):
            raise ModelError(
                f"constraint '{self.expression.text}': bounds {self.lower:g} and {self.upper:g} leave nothing or "
                "everything; give a lower bound, an upper bound, or both in order"
            )

    @property
    def name(self) -> str:
        """The text of its expression."""
        return self.expression.text


@dataclass(frozen=True)
class Problem:
    """Minimize one objective or trade two, over design variables, subject to constraints.

    Attributes
    ----------
    system, base, definitions
        The system, the design that holds what is not a variable, and quantities that follow others.
    variables
        Design variables.
    objectives
        One or two expressions to minimize.
    constraints
        What every design must meet.
    checks
        What every design is judged by as well, but not optimized for: limits that have no gradient.
    """

    system: System
    base: Design
    variables: tuple[Variable, ...]
    objectives: tuple[Expression, ...]
    constraints: tuple[Constraint, ...] = ()
    definitions: Definitions = field(default_factory=Definitions)
    checks: tuple[Constraint, ...] = ()

    def __post_init__(self) -> None:
        if self.system.two_axes != (self.base.loop.beside is not None):
            raise ModelError(
                "two axes: the system and the loop differ in how many the mirror has; give both two"
            )
        names = [v.name for v in self.variables]
        if len(set(names)) < len(names):
            raise ModelError(f"variables: the names {names} are not unique; rename one")
        quantities = [(v.quantity, v.axis) for v in self.variables if not v.groups]
        axes = {v.axis for v in self.variables}
        if "second" in axes and not self.system.two_axes:
            raise ModelError("variables: one is of a second axis, which the mirror has not; remove 'axis'")
        exclusive = ("gain", "crossover"), ("mirror_inertia", "mirror_inertia_ratio")
        for (first, second), axis in product(exclusive, axes):
            if (first, axis) in quantities and (second, axis) in quantities:
                raise ModelError(f"variables: '{first}' and '{second}' set the same thing; free one of them")
        known = {*self.system.metric_names, *INDEXED, *names}
        for expression in (*self.objectives, *(c.expression for c in self.constraints)):
            for name, _ in expression.references:
                if name not in known:
                    raise ModelError(
                        f"'{expression.text}': '{name}' does not exist; {did_you_mean(name, known)}"
                    )

    @property
    def size(self) -> int:
        """Number of scalar design variables."""
        return sum(v.size for v in self.variables)

    @property
    def start(self) -> Array:
        """(n,) Start values of all variables."""
        return np.concatenate([v.start for v in self.variables]) if self.variables else np.zeros(0)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """(n,), (n,) Bounds of all variables."""
        return (
            np.concatenate([v.lower for v in self.variables]),
            np.concatenate([v.upper for v in self.variables]),
        )

    def slices(self) -> dict[str, slice]:
        """Where each variable stands in the vector of all."""
        ends = np.cumsum([0, *(v.size for v in self.variables)])
        return {
            v.name: slice(int(a), int(b)) for v, a, b in zip(self.variables, ends[:-1], ends[1:], strict=True)
        }

    def values(self, x: Array) -> dict[str, Array]:
        """Values by variable name."""
        return {name: x[part] for name, part in self.slices().items()}

    def vector(self, values: Mapping[str, Any]) -> Array:
        """(n,) Vector of all variables from values by name; variables not named keep their start.

        Raises
        ------
        ModelError
            For an unknown name or a wrong number of values.
        """
        x, slices = self.start.copy(), self.slices()
        for name, value in values.items():
            if name not in slices:
                raise ModelError(f"design: variable '{name}' does not exist; {did_you_mean(name, slices)}")
            given = np.atleast_1d(np.asarray(value, dtype=float))
            size = x[slices[name]].size
            if given.size not in (1, size):
                raise ModelError(f"design: variable '{name}' has {size} values, {given.size} were given")
            x[slices[name]] = given
        return x

    @cached_property
    def _parameters(self) -> Differentiable:
        return Differentiable(
            lambda x: design_parameters(self.system, self.base, self.definitions, self.variables, x),
            self.size,
        )

    def design(self, x: Array) -> Design:
        """The design at (n,) values of the variables."""
        return self.base.with_parameters(self._parameters(x)[0])

    def evaluate(self, x: Array, shift: float = 0.0, truth: bool = False) -> Evaluation:
        """Evaluation of the design at `x`, if asked for on the truth model and with the loop as built."""
        system = replace(self.system.truth, as_built=True) if truth else self.system
        return evaluation_of(system, self.design(x), shift)

    def parameter_jacobian(self, x: Array) -> Array | sparse.csc_array:
        """(p, n) Jacobian of the design parameters; sparse for very many variables."""
        return self._parameters(x)[1]

    def metric_function(self, *names: str) -> OracleFunction:
        """Metrics as a CasADi function of the vector of all variables, with exact Jacobian.

        Compose objectives of your own from it: ``f = problem.metric_function("jitter_total")``, then ``f(x)`` in
        any CasADi expression.

        Parameters
        ----------
        names
            Metrics or expressions of metrics and variables.

        Raises
        ------
        ModelError
            For an unknown metric.
        """
        rows = Rows(self, tuple(parse_expression(name) for name in names))

        def evaluate(x: Array) -> tuple[Array, Array]:
            return rows(x, self.evaluate(x))

        return OracleFunction("metrics", evaluate, self.size, len(names))


class Rows:
    """Expressions of metrics and variables as one vector with its Jacobian over the variables.

    Parameters
    ----------
    problem
        Where metrics and variables come from.
    expressions
        One row each.
    """

    def __init__(self, problem: Problem, expressions: tuple[Expression, ...]) -> None:
        self._problem = problem
        self._references: list[Reference] = sorted(
            {reference for e in expressions for reference in e.references}, key=lambda r: (r[0], r[1] or 0)
        )
        place = {reference: i for i, reference in enumerate(self._references)}

        def formula(m: Any) -> Any:
            return ops.stack(*(e.evaluate(lambda name, index: m[place[name, index]]) for e in expressions))

        self._formula = Differentiable(formula, max(len(self._references), 1))
        for name, index in self._references:
            if name in problem.slices():
                self._position(name, index)

    def _position(self, name: str, index: int | None) -> int:
        part = self._problem.slices()[name]
        size = part.stop - part.start
        if (index is None and size > 1) or not 1 <= (index or 1) <= size:
            raise ModelError(f"variable '{name}' has {size} values; write {name}[1] to {name}[{size}]")
        return int(part.start) + (index or 1) - 1

    def values(self, x: Array, evaluation: Evaluation) -> Array:
        """(m,) values at `x`, without the work of their gradients; raises what a call raises."""
        variables = self._problem.slices()
        found = [
            x[self._position(name, index)] if name in variables else evaluation.value(name, index)
            for name, index in self._references
        ]
        return self._formula(np.array(found or [0.0]))[0]

    def __call__(self, x: Array, evaluation: Evaluation) -> tuple[Array, Array]:
        """(m,) values and (m, n) Jacobian at `x`.

        Raises
        ------
        UnstableError
            If a row needs the jitter of an unstable loop.
        """
        variables = self._problem.slices()
        values = np.zeros(max(len(self._references), 1))
        jacobian = np.zeros((values.size, x.size))
        parameter_jacobian = self._problem.parameter_jacobian(x)
        for i, (name, index) in enumerate(self._references):
            if name in variables:
                position = self._position(name, index)
                values[i], jacobian[i, position] = x[position], 1.0
            else:
                values[i], gradient = evaluation.metric(name, index)
                jacobian[i] = gradient @ parameter_jacobian
        value, by_reference = self._formula(values)
        return value, by_reference @ jacobian


def branched(constraint: Constraint) -> str | None:
    """The metric of a constraint that holds for every branch if it holds for the metric, else None.

    A least frequency or margin bounded below alone, a largest real part bounded above alone.
    """
    reference = constraint.expression.reference
    if reference is None or reference[0] not in BRANCHES or reference[1] is not None:
        return None
    least = reference[0] != "spectral_abscissa"
    one_sided = constraint.upper == inf if least else constraint.lower == -inf
    return reference[0] if one_sided else None
