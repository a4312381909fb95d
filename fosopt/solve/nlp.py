"""A problem as a scaled nonlinear program: what an optimizer sees."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fosopt.errors import FosoptError
from fosopt.expressions import Expression
from fosopt.ops import Array
from fosopt.problem import Constraint, Evaluation, Problem, Rows, branched

# Metrics that may be zero or negative; all others are positive by nature.
_SIGNED = frozenset({"spectral_abscissa", "step_offset"})


@dataclass(frozen=True)
class Task:
    """One optimization of a problem: minimize one expression over some variables.

    Attributes
    ----------
    problem
        Where variables and metrics come from.
    objective
        What to minimize.
    constraints
        What to meet; not only the problem's own, but also the limit on the other objective.
    free
        (n,) which variables may move.
    """

    problem: Problem
    objective: Expression
    constraints: tuple[Constraint, ...]
    free: NDArray[np.bool_] = field(repr=False)


class Program(Protocol):
    """What an optimizer needs: scaled bounds, rows, and one callable that answers for a point."""

    start: Array
    lower: Array
    upper: Array
    row_lower: Array
    row_upper: Array
    row_scale: Array
    row_names: tuple[str, ...]

    def objective(self, value: float) -> float:
        """Objective in physical units from its scaled value."""

    def objective_slope(self, value: float) -> float:
        """Derivative of `objective`."""

    def scaled(self, x: Array) -> Array:
        """Scaled free variables of (n,) values of all variables."""

    def unscaled(self, z: Array) -> Array:
        """(n,) values of all variables."""

    def __call__(self, z: Array) -> tuple[float, Array, Array, Array] | None:
        """Scaled objective, gradient, rows, Jacobian; None where the design has no such numbers."""


class NonlinearProgram:
    """A task in scaled variables, with each point evaluated once.

    Variables on a logarithmic scale enter as ln(x), others over their range. Constraint rows are divided by their
    bound. An objective that is positive by nature enters as its logarithm, because a start may be decades away
    from the optimum; others are divided by their value at the start. The scaling comes from the problem alone.

    Parameters
    ----------
    task
        What to solve.
    start
        (n,) values of all variables; those not free stay there.
    shift
        See `problem.Evaluation`.
    """

    def __init__(self, task: Task, start: Array, shift: float = 0.0) -> None:
        self.task, self.start, self.shift = task, start, shift
        problem = task.problem
        self.index = np.flatnonzero(task.free)
        lower, upper = problem.bounds
        logs = np.concatenate([np.full(v.size, v.log) for v in problem.variables])
        self._log = logs[self.index]
        with np.errstate(divide="ignore", invalid="ignore"):
            self._unit = np.where(self._log, 1.0, np.maximum(np.abs(lower), np.abs(upper))[self.index])
        self.lower, self.upper = self._scaled(lower[self.index]), self._scaled(upper[self.index])
        single = [c for c in task.constraints if branched(c) is None]
        self._branched = [(c, str(branched(c))) for c in task.constraints if branched(c) is not None]
        self._rows = Rows(problem, (task.objective, *(c.expression for c in single)))
        self._known: tuple[Array, Evaluation, Array, Array] | None = None
        self.failure: str | None = None
        value = self._raw(start)[0]
        reference = task.objective.reference
        self._logarithmic = reference is not None and reference[0] not in _SIGNED and value[0] > 0
        self._objective_scale = max(abs(value[0]), 1e-300)
        names: list[str] = []
        bounds: list[tuple[float, float, float]] = []
        for constraint, at_start in zip(single, value[1 : 1 + len(single)], strict=True):
            sizes = [abs(b) for b in (constraint.lower, constraint.upper) if np.isfinite(b) and b != 0]
            size = max(sizes, default=max(abs(float(at_start)), 1e-300))
            bounds.append((constraint.lower, constraint.upper, size))
            names.append(constraint.name)
        for constraint, metric in self._branched:
            for _ in self._known_evaluation(start).branches(metric):
                limit = constraint.lower if np.isfinite(constraint.lower) else constraint.upper
                bounds.append((constraint.lower, constraint.upper, abs(limit) or 1.0))
                names.append(constraint.name)
        # The branches of a minimum share the name of their constraint.
        self.row_names = tuple(names)
        table = np.array(bounds).reshape(-1, 3)
        self.row_scale = table[:, 2]
        self.row_lower, self.row_upper = table[:, 0] / self.row_scale, table[:, 1] / self.row_scale

    def objective(self, value: float) -> float:
        """Objective in physical units from its scaled value."""
        return float(np.exp(value) if self._logarithmic else value) * self._objective_scale

    def objective_slope(self, value: float) -> float:
        """Derivative of `objective`."""
        return self.objective(value) if self._logarithmic else self._objective_scale

    def scaled_objective(self, objective: float) -> float:
        """Inverse of `objective`."""
        ratio = objective / self._objective_scale
        return float(np.log(ratio)) if self._logarithmic else ratio

    def scaled(self, x: Array) -> Array:
        """Scaled free variables of (n,) values of all variables."""
        return self._scaled(x[self.index])

    def _scaled(self, part: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self._log, np.log(part), part / self._unit)

    def unscaled(self, z: Array) -> Array:
        """(n,) values of all variables; inside their bounds to the last bit."""
        x = self.start.copy()
        part = np.where(self._log, np.exp(np.where(self._log, z, 0.0)), z * self._unit)
        lower, upper = self.task.problem.bounds
        x[self.index] = np.clip(part, lower[self.index], upper[self.index])
        return x

    def _known_evaluation(self, x: Array) -> Evaluation:
        if self._known is None or not np.array_equal(self._known[0], x):
            self._raw(x)
        assert self._known is not None
        return self._known[1]

    def _raw(self, x: Array) -> tuple[Array, Array]:
        """Objective and constraint rows in physical units with their Jacobian over all variables."""
        if self._known is not None and np.array_equal(self._known[0], x):
            return self._known[2], self._known[3]
        evaluation = self.task.problem.evaluate(x, self.shift)
        values, jacobian = self._rows(x, evaluation)
        if self._branched:
            parameters = self.task.problem.parameter_jacobian(x)
            more = [b for _, metric in self._branched for b in evaluation.branches(metric)]
            values = np.concatenate([values, [v for v, _ in more]])
            jacobian = np.vstack([jacobian, np.array([g for _, g in more]) @ parameters])
        if not (np.all(np.isfinite(values)) and np.all(np.isfinite(jacobian))):
            raise FosoptError("a metric or its derivative is not finite here")
        self._known = (x.copy(), evaluation, values, jacobian)
        return values, jacobian

    def __call__(self, z: Array) -> tuple[float, Array, Array, Array] | None:
        """Scaled objective, its gradient, rows and their Jacobian; None where the design has no such numbers."""
        x = self.unscaled(z)
        try:
            values, jacobian = self._raw(x)
        except FosoptError as error:
            self.failure = str(error)
            return None
        chain = np.where(self._log, x[self.index], self._unit)
        jacobian = jacobian[:, self.index] * chain
        value = self.scaled_objective(float(values[0]))
        return (
            value,
            jacobian[0] / self.objective_slope(value),
            values[1:] / self.row_scale,
            jacobian[1:] / self.row_scale[:, None],
        )
