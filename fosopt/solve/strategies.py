"""Ways to solve the same problem: sequential, nested, simultaneous; and a stable start for all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fosopt.errors import FosoptError
from fosopt.expressions import Expression, parse_expression
from fosopt.ops import Array
from fosopt.problem import Constraint, Problem
from fosopt.solve.elastic import ElasticProgram
from fosopt.solve.ipopt import Options, Solution, never, solve
from fosopt.solve.nlp import NonlinearProgram, Task

Mask = NDArray[np.bool_]

Strategy = Literal["simultaneous", "nested", "sequential"]

# Metrics that a structural engineer can compute without knowing the loop.
_STRUCTURAL = frozenset(
    {
        "structural_mass",
        "total_mass",
        "structure_inertia",
        "reference_inertia",
        "first_elastic_frequency",
        "structure_frequency",
        "modal_inertia",
    }
)
_STABILIZING_ROUNDS = 12
_AHEAD, _LEAST_AHEAD = 1.2, 1e-3  # how far right of the rightmost pole the shift lies: factor, and [rad/s]
# Of the tolerance asked for: an inner optimum that looks smooth from outside, and an outer one above what is left
# of its noise.
_INNER_TOLERANCE, _OUTER_TOLERANCE = 0.01, 10.0


@dataclass(frozen=True)
class Goal:
    """What one point of a study asks for: minimize an expression under constraints over free variables."""

    problem: Problem
    objective: Expression
    constraints: tuple[Constraint, ...]
    free: Mask

    def task(self) -> Task:
        """The goal as one optimization.

        Constraints that no free variable can move are left out: a constant row that sits on its bound has no
        interior and an unbounded multiplier. `certify` looks at them all.
        """
        movable = tuple(c for c in self.constraints if self._moves(c.expression))
        return Task(self.problem, self.objective, movable, self.free)

    def _moves(self, expression: Expression) -> bool:
        """Whether a free variable can change an expression."""
        slices = self.problem.slices()
        structure = bool(self.discipline("structure").any())
        return any(
            bool(self.free[slices[name]].any()) if name in slices else structure or name not in _STRUCTURAL
            for name, _ in expression.references
        )

    def discipline(self, name: Literal["structure", "control"]) -> Mask:
        """(n,) the free variables of one discipline."""
        variables = self.problem.variables
        own = np.concatenate([np.full(v.size, v.discipline == name) for v in variables])
        return own & self.free

    def structural(self, expression: Expression) -> bool:
        """Whether an expression needs the structure alone."""
        own = {v.name for v in self.problem.variables if v.discipline == "structure"}
        return all(name in _STRUCTURAL or name in own for name, _ in expression.references)


def reach(
    goal: Goal, start: Array, strategy: Strategy, options: Options, stop: Callable[[], bool] = never
) -> Solution:
    """Solve a goal by a strategy; an unstable start is stabilized first.

    Parameters
    ----------
    start
        (n,) values of all variables.
    """
    stable = stabilize(goal, start, options, stop)
    if isinstance(stable, Solution):
        return stable
    both = goal.discipline("structure").any() and goal.discipline("control").any()
    if strategy == "sequential" and both:
        return _sequential(goal, stable, options, stop)
    # Where the loop has nothing to choose for the objective, there is no inner optimum to nest.
    if strategy == "nested" and both and not goal.structural(goal.objective):
        return _nested(goal, stable, options, stop)
    return persist(goal.task(), stable, options, stop)


def persist(task: Task, start: Array, options: Options, stop: Callable[[], bool] = never) -> Solution:
    """Solve a task; where the first try fails, find out whether it can be met at all, and try again if so."""
    found = solve(NonlinearProgram(task, start), options, stop)
    if found.status in ("optimal", "interrupted") or found.seconds >= options.time_limit:
        return found
    elastic = ElasticProgram(NonlinearProgram(task, start))
    least = solve(elastic, options, stop)
    if least.status == "interrupted":
        return least
    tried = replace(
        found, iterations=found.iterations + least.iterations, seconds=found.seconds + least.seconds
    )
    conflict = elastic.conflict(least)
    if conflict is not None:
        # Only a least violation that was found to the end says that the constraints cannot be met.
        met = least.status == "optimal"
        return replace(tried, x=least.x, status="infeasible", reason=conflict) if met else tried
    again = solve(NonlinearProgram(task, least.x), options, stop)
    return replace(
        again, iterations=tried.iterations + again.iterations, seconds=tried.seconds + again.seconds
    )


def stabilize(
    goal: Goal, start: Array, options: Options, stop: Callable[[], bool] = never
) -> Array | Solution:
    """A stable design reached from an unstable start, over the goal's free variables.

    Jitter of H(s + σ) is finite for a loop whose poles lie left of σ. It is minimized for σ just right of the
    rightmost pole, until the loop is stable; the constraints wait until then.

    Returns
    -------
    Array or Solution
        (n,) values of all variables, or a failed solution where no stable design was found.
    """
    problem = goal.problem
    x = start
    iterations, seconds = 0, 0.0
    abscissa = problem.evaluate(x).value("spectral_abscissa")
    objective = parse_expression("log(jitter_total)" if problem.system.disturbances else "spectral_abscissa")
    ahead = _AHEAD
    for _ in range(_STABILIZING_ROUNDS):
        if abscissa < 0 or not goal.free.any():
            break
        task = replace(goal.task(), objective=objective, constraints=())
        program = NonlinearProgram(task, x, shift=ahead * abscissa + _LEAST_AHEAD)
        found = solve(program, options, stop, lambda y: problem.evaluate(y).value("spectral_abscissa") < 0)
        iterations, seconds = iterations + found.iterations, seconds + found.seconds
        if found.status == "interrupted":
            return found
        now = problem.evaluate(found.x).value("spectral_abscissa")
        if now < 0.99 * abscissa:
            x, abscissa, ahead = found.x, now, _AHEAD
        else:
            # The solver starts a little inside the bounds, which may be right of this shift: look from further off.
            ahead *= _AHEAD**3
    if abscissa < 0:
        return x
    reason = (
        f"no stable design found: a pole keeps the real part {abscissa:.4g} rad/s; "
        "free more variables or widen bounds"
    )
    return Solution(x, "infeasible", reason, float("nan"), np.zeros(0), (), iterations, seconds, ())


def _sequential(goal: Goal, start: Array, options: Options, stop: Callable[[], bool]) -> Solution:
    """The habit of separate teams: the structure first, then the best loop on it.

    The structural team minimizes the objective if it can compute it, else it makes the stiffest structure that its
    constraints allow.
    """
    structural = tuple(c for c in goal.constraints if goal.structural(c.expression))
    own = goal.structural(goal.objective)
    aim = goal.objective if own else parse_expression("-first_elastic_frequency")
    first = Task(goal.problem, aim, structural, goal.discipline("structure"))
    stiff = persist(first, start, options, stop)
    if stiff.status != "optimal":
        return replace(stiff, reason=f"structure first: {stiff.reason}", objective=float("nan"))
    control = replace(goal, free=goal.discipline("control"))
    stable = stabilize(control, stiff.x, options, stop)
    if isinstance(stable, Solution):
        return stable
    found = persist(control.task(), stable, options, stop)
    return replace(
        found, iterations=found.iterations + stiff.iterations, seconds=found.seconds + stiff.seconds
    )


def _nested(goal: Goal, start: Array, options: Options, stop: Callable[[], bool]) -> Solution:
    program = _NestedProgram(goal, start, options, stop)
    return solve(program, replace(options, tolerance=_OUTER_TOLERANCE * options.tolerance), stop)


class _NestedProgram(NonlinearProgram):
    """The structure outside, the best loop for it inside.

    The inner optimum's derivative is that of the inner Lagrangian (envelope theorem).
    """

    def __init__(self, goal: Goal, start: Array, options: Options, stop: Callable[[], bool]) -> None:
        self._goal, self._stop = goal, stop
        self._options = replace(options, tolerance=_INNER_TOLERANCE * options.tolerance)
        outer = tuple(c for c in goal.constraints if goal.structural(c.expression))
        self._inner_constraints = tuple(c for c in goal.constraints if c not in outer)
        self._control = goal.discipline("control")
        self.best = start
        self._answers: dict[bytes, tuple[float, Array] | None] = {}
        # The outer objective is the inner optimum; this one only stands in its place for the rows.
        super().__init__(Task(goal.problem, goal.objective, outer, goal.discipline("structure")), start)

    def _inner(self, x: Array) -> tuple[float, Array] | None:
        """Inner optimum [SI] and its gradient over the scaled structure variables."""
        key = x[self.index].tobytes()
        if key not in self._answers:
            self._answers[key] = self._solve_inner(x)
        return self._answers[key]

    def _solve_inner(self, x: Array) -> tuple[float, Array] | None:
        start = np.where(self._control, self.best, x)
        try:
            inner = replace(self._goal, free=self._control, constraints=self._inner_constraints)
            stable = stabilize(inner, start, self._options, self._stop)
            if isinstance(stable, Solution):
                return None
            task = inner.task()
            found = solve(NonlinearProgram(task, stable), self._options, self._stop)
            if found.status != "optimal":
                return None
            # The same rows, looked at along the structure.
            answer = NonlinearProgram(replace(task, free=self._goal.discipline("structure")), found.x)
            at_optimum = answer(answer.scaled(found.x))
            if at_optimum is None:
                return None
            value, gradient, _, jacobian = at_optimum
            slope = answer.objective_slope(value)
            scaled = found.multipliers * answer.row_scale / slope
            self.best = found.x
            return answer.objective(value), (gradient + scaled @ jacobian) * slope
        except FosoptError:
            return None

    def unscaled(self, z: Array) -> Array:
        """(n,) values of all variables, the loop's from the inner optimum."""
        x = super().unscaled(z)
        return np.where(self._control, self.best, x)

    def __call__(self, z: Array) -> tuple[float, Array, Array, Array] | None:
        """Scaled inner optimum, its gradient, the structural rows and their Jacobian."""
        x = super().unscaled(z)
        rows = super().__call__(z)
        inner = self._inner(x)
        if rows is None or inner is None:
            return None
        value = self.scaled_objective(inner[0])
        return value, inner[1] / self.objective_slope(value), rows[2], rows[3]
