"""Pareto fronts by ε-constraint with continuation [Mavrotas2009], and comparisons of strategies and cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fosopt.expressions import Expression
from fosopt.ops import Array
from fosopt.problem import Constraint, Problem, Rows
from fosopt.solve.ipopt import Options, Solution, never
from fosopt.solve.strategies import Goal, Strategy, reach

# The light end of a front allows this share of the front's range above the least first objective: at the very
# least one the other objective has nothing left to choose from.
_LIGHT_END = 1e-3
# The heavy end is the least first objective whose second one is this close to the least (relative).
_HEAVY_END = 1e-4
# Objectives closer than this (relative) are the same local optimum.
_SAME = 1e-4


@dataclass(frozen=True)
class Search:
    """How every point is searched for.

    Attributes
    ----------
    strategy, options
        How and how long.
    starts, seed
        Random starts beside the first one make `starts` in all.
    compare
        Other strategies that run at the same points.
    """

    strategy: Strategy = "simultaneous"
    options: Options = field(default_factory=Options)
    starts: int = 1
    seed: int = 1
    compare: tuple[Strategy, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """One point of a study as it was found.

    Attributes
    ----------
    label
        What it is, in words.
    strategy
        How it was found.
    goal, solution
        What was asked, and the answer.
    parent
        Position of the outcome whose design it started from, None for the study's start.
    tried, agreed
        Starts, and how many ended at the same optimum.
    """

    label: str
    strategy: Strategy
    goal: Goal
    solution: Solution
    parent: int | None
    tried: int = 1
    agreed: int = 1


def everything_free(problem: Problem) -> NDArray[np.bool_]:
    """(n,) all variables free."""
    return np.ones(problem.size, dtype=bool)


def search(
    goal: Goal, start: Array, how: Search, index: int, stop: Callable[[], bool] = never
) -> tuple[Solution, int, int]:
    """The best solution over all starts, how many were tried and how many of them agree with it.

    Random starts are drawn inside the bounds on the scale of each variable; they depend on the seed and the
    index of the point alone.
    """
    found = [reach(goal, start, how.strategy, how.options, stop)]
    rng = np.random.default_rng([how.seed, index])
    for _ in range(how.starts - 1 if goal.free.any() else 0):
        if stop():
            break
        found.append(reach(goal, _random(goal, start, rng), how.strategy, how.options, stop))
    best = min(
        found, key=lambda s: (s.status != "optimal", s.objective if np.isfinite(s.objective) else np.inf)
    )
    near = [
        s
        for s in found
        if s.status == "optimal" and s.objective <= best.objective + _SAME * abs(best.objective)
    ]
    return best, len(found), len(near)


def _random(goal: Goal, start: Array, rng: np.random.Generator) -> Array:
    lower, upper = goal.problem.bounds
    log = np.concatenate([np.full(v.size, v.log) for v in goal.problem.variables])
    share = rng.uniform(size=start.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        on_log = lower * (upper / lower) ** share
    drawn = np.clip(np.where(log, on_log, lower + (upper - lower) * share), lower, upper)
    return np.where(goal.free, drawn, start)


def trace_front(
    problem: Problem, start: Array, count: int, how: Search, stop: Callable[[], bool] = never
) -> Iterator[Outcome]:
    """Points of the Pareto front of two objectives, from the least first one to the least second one.

    The second objective is minimized under a limit on the first; limits lie denser toward the light end, where
    fronts are steep. Each point starts from its neighbor. An empty front is one outcome that says why.

    Parameters
    ----------
    start
        (n,) values of all variables.
    count
        Number of points, two at least.
    """
    first, second = problem.objectives
    free = everything_free(problem)

    def goal(minimized: int, *limits: Constraint) -> Goal:
        return Goal(problem, problem.objectives[minimized], (*problem.constraints, *limits), free)

    # The ends are found with everything free at once: a strategy shows at the points between them.
    at_once = replace(how, strategy="simultaneous")
    light, *tally = search(goal(0), start, at_once, 0, stop)
    if light.status != "optimal":
        yield Outcome(f"least {first.text}", "simultaneous", goal(0), light, None, *tally)
        return
    least = light.objective
    heavy, *tally = search(goal(1), light.x, at_once, 1, stop)
    if heavy.status != "optimal":
        yield Outcome(f"least {first.text}", "simultaneous", goal(0), light, None)
        yield Outcome(f"least {second.text}", "simultaneous", goal(1), heavy, None, *tally)
        return
    saving = Constraint(second, upper=heavy.objective + _HEAVY_END * abs(heavy.objective))
    end, *_ = search(goal(0, saving), heavy.x, at_once, 2, stop)
    most = end.objective if end.status == "optimal" else objective_value(problem, heavy.x, first)
    x, parent, position = light.x, None, 0
    for k in range(count):
        if stop():
            return
        last = k == count - 1
        share = max((k / (count - 1)) ** 2, _LIGHT_END)
        limited = goal(1, Constraint(first, upper=least + share * (most - least)))
        found, *tally = search(limited, end.x if last and end.status == "optimal" else x, how, 3 + k, stop)
        label = f"least {second.text}" if last else f"{first.text} limited" if k else f"least {first.text}"
        yield Outcome(label, how.strategy, limited, found, None if last else parent, *tally)
        here, position = position, position + 1
        for other in how.compare:
            if stop():
                return
            answer = reach(limited, start, other, how.options, stop)
            yield Outcome(f"{label}, {other}", other, limited, answer, None)
            position += 1
        if found.status == "optimal":
            x, parent = found.x, here


def objective_value(problem: Problem, x: Array, objective: Expression) -> float:
    """Value of an objective at a design, on the truth model."""
    return float(Rows(problem, (objective,))(x, problem.evaluate(x, truth=True))[0][0])


def solve_cases(
    problem: Problem,
    start: Array,
    cases: Sequence[tuple[str, NDArray[np.bool_]]],
    how: Search,
    stop: Callable[[], bool] = never,
) -> Iterator[tuple[str, Outcome]]:
    """The same single-objective problem with different variables free, all from the same start."""
    for index, (name, free) in enumerate(cases):
        if stop():
            return
        goal = Goal(problem, problem.objectives[0], problem.constraints, free)
        found, *tally = search(goal, start, how, index, stop)
        yield name, Outcome(name, how.strategy, goal, found, None, *tally)
        for other in how.compare:
            if stop():
                return
            answer = reach(goal, start, other, how.options, stop)
            yield name, Outcome(f"{name}, {other}", other, goal, answer, None)
