"""Pareto fronts by ε-constraint with continuation [Mavrotas2009], and comparisons of strategies and cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fosopt.errors import FosoptError
from fosopt.expressions import Expression
from fosopt.ops import Array
from fosopt.problem import Constraint, Problem, Rows
from fosopt.solve.corrected import corrected
from fosopt.solve.ipopt import Options, Solution, never
from fosopt.solve.strategies import Goal, Strategy, reach

CHAIN = 8
"""Points of a front that are followed one from the other."""
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


@dataclass(frozen=True)
class Request:
    """One optimization of a study, with all that its answer depends on beside the problem and the search.

    Attributes
    ----------
    name
        Unique within the study: that of an end of a front, or the position of a point.
    label, case
        What it is, in words, and the case it belongs to.
    strategy
        How to search; `at_once` overrides it.
    minimized
        Which objective.
    limits
        Upper bounds on objectives: which one, and its value.
    starts
        (n,) values of all variables each; the next one is tried where the one before ends without an optimum.
    index
        Of its random starts; None for none.
    position
        Among the points of the study, None for an end of a front that is no point itself.
    parent
        Position of the point whose design it starts from.
    free
        (n,) variables that may change, None for all.
    followers
        How many points wait for it, one after the other: the longest chain is to be begun first.
    """

    name: str
    label: str
    strategy: Strategy
    minimized: int
    starts: tuple[Array, ...]
    limits: tuple[tuple[int, float], ...] = ()
    index: int | None = None
    position: int | None = None
    parent: int | None = None
    case: str | None = None
    free: NDArray[np.bool_] | None = None
    followers: int = 0


def goal_of(problem: Problem, request: Request) -> Goal:
    """What a request asks for."""
    limits = tuple(Constraint(problem.objectives[k], upper=value) for k, value in request.limits)
    free = everything_free(problem) if request.free is None else request.free
    return Goal(problem, problem.objectives[request.minimized], (*problem.constraints, *limits), free)


def answer(problem: Problem, request: Request, how: Search, stop: Callable[[], bool] = never) -> Outcome:
    """Make one optimization of a study."""
    goal = goal_of(problem, request)
    how = replace(how, strategy=request.strategy)
    found, tally = None, (1, 1)
    for start in request.starts:
        if request.index is None:
            found = reach(goal, start, how.strategy, how.options, stop)
        else:
            found, *tally_ = search(goal, start, how, request.index, stop)
            tally = tally_[0], tally_[1]
        if found.status in ("optimal", "interrupted"):
            break
    assert found is not None
    found = corrected(goal, found, how.strategy, how.options, stop)
    return Outcome(request.label, request.strategy, goal, found, request.parent, *tally)


class Plan(Protocol):
    """Optimizations of a study, each handed out once all that it depends on is known.

    What is handed out depends on answers alone, and not on the order in which they arrive.
    """

    total: int

    def ready(self) -> list[Request]:
        """Requests that have become possible since the last call, in the order of their positions."""
        ...

    def take(self, request: Request, x: Array, status: str, objective: float) -> None:
        """Learn the answer to a request."""
        ...


class CasePlan:
    """The same single-objective problem with different variables free, all from the same start.

    Parameters
    ----------
    cases
        Name and (n,) free variables of each; one without a name has all of them free.
    """

    def __init__(
        self, start: Array, cases: Sequence[tuple[str | None, str, NDArray[np.bool_]]], how: Search
    ) -> None:
        each = 1 + len(how.compare)
        self._new = []
        for index, (case, label, free) in enumerate(cases):
            for j, strategy in enumerate((how.strategy, *how.compare)):
                k = index * each + j
                text = f"{label}, {strategy}" if j else label
                seeded = None if j else index
                self._new.append(
                    Request(f"{k:03d}", text, strategy, 0, (start,), (), seeded, k, case=case, free=free)
                )
        self.total = len(self._new)

    def ready(self) -> list[Request]:
        """As `Plan`."""
        new, self._new = self._new, []
        return new

    def take(self, request: Request, x: Array, status: str, objective: float) -> None:
        """As `Plan`."""


class FrontPlan:
    """Points of the Pareto front of two objectives, from the least first one to the least second one.

    The second objective is minimized under a limit on the first; limits lie denser toward the light end, where
    fronts are steep. Points form chains of `CHAIN`: the first of a chain starts from the design at the heavy end of
    the front, every other one from its neighbor, so that chains can be followed at the same time. The first chain
    starts from the light end. An empty front is one point that says why.

    Parameters
    ----------
    start
        (n,) values of all variables.
    count
        Number of points, two at least.
    """

    def __init__(self, problem: Problem, start: Array, count: int, how: Search) -> None:
        self._problem, self._start, self._count, self._how = problem, start, count, how
        self._first, self._second = (o.text for o in problem.objectives)
        self._each = 1 + len(how.compare)
        self.total = count * self._each
        self._light = self._heavy = start
        self._least = self._most = np.nan
        # The ends are found with everything free at once: a strategy shows at the points between them.
        self._new = [Request("light", f"least {self._first}", "simultaneous", 0, (start,), index=0)]

    def ready(self) -> list[Request]:
        """As `Plan`."""
        new, self._new = self._new, []
        return sorted(new, key=lambda request: (request.position is not None, request.position))

    def take(self, request: Request, x: Array, status: str, objective: float) -> None:
        """As `Plan`."""
        optimal = status == "optimal"
        if request.position is None:
            self._take_end(request, x, optimal, objective)
        elif request.position % self._each == 0:
            k = request.position // self._each
            if (k + 1) % CHAIN and k + 1 < self._count - 1:
                # A point that failed hands on what it started from.
                starts, parent = ((x,), request.position) if optimal else (request.starts, request.parent)
                self._point(k + 1, starts, parent)

    def _take_end(self, request: Request, x: Array, optimal: bool, objective: float) -> None:
        if request.name == "light":
            self._light, self._least = x, objective
            if optimal:
                label = f"least {self._second}"
                self._new.append(Request("heavy", label, "simultaneous", 1, (x,), index=1))
            else:
                self._give_up(request)
        elif request.name == "heavy":
            self._heavy = x
            if optimal:
                self._most, least = (_judged(self._problem, x, o) for o in self._problem.objectives)
                saving = least + _HEAVY_END * abs(least)
                label = f"least {self._first} there"
                self._new.append(Request("end", label, "simultaneous", 0, (x,), ((1, saving),), 2))
            else:
                light = Request("light", f"least {self._first}", "simultaneous", 0, (self._start,), index=0)
                self._give_up(light, request)
        else:
            if optimal:
                self._heavy, self._most = x, objective
            self._begin()

    def _give_up(self, *requests: Request) -> None:
        """Make the ends the only points."""
        self.total = len(requests)
        self._count = 0
        self._new += [replace(r, name=f"{k:03d}", position=k) for k, r in enumerate(requests)]

    def _begin(self) -> None:
        """The heads of all chains, and all points that depend on no neighbor."""
        last = self._count - 1
        for k in range(self._count):
            if k == last:
                self._point(k, (self._heavy, self._light), None)
            elif k % CHAIN == 0:
                self._point(k, (self._heavy, self._light)[:: -1 if k == 0 else 1], None)
            for j, other in enumerate(self._how.compare, 1):
                label, position = f"{self._label(k)}, {other}", k * self._each + j
                self._new.append(
                    Request(
                        f"{position:03d}", label, other, 1, (self._start,), self._limit(k), None, position
                    )
                )

    def _point(self, k: int, starts: tuple[Array, ...], parent: int | None) -> None:
        position = k * self._each
        strategy = self._how.strategy
        self._new.append(
            Request(
                f"{position:03d}",
                self._label(k),
                strategy,
                1,
                starts,
                self._limit(k),
                3 + k,
                position,
                parent,
                followers=max(min(CHAIN - 1 - k % CHAIN, self._count - 2 - k), 0),
            )
        )

    def _limit(self, k: int) -> tuple[tuple[int, float], ...]:
        share = max((k / (self._count - 1)) ** 2, _LIGHT_END)
        return ((0, self._least + share * (self._most - self._least)),)

    def _label(self, k: int) -> str:
        if k == self._count - 1:
            return f"least {self._second}"
        return f"{self._first} limited" if k else f"least {self._first}"


def answers(
    problem: Problem, plan: Plan, how: Search, stop: Callable[[], bool] = never
) -> Iterator[tuple[Request, Outcome]]:
    """Make all optimizations of a plan one after the other, in the order of their positions."""
    waiting = plan.ready()
    while waiting and not stop():
        request = waiting.pop(0)
        outcome = answer(problem, request, how, stop)
        yield request, outcome
        found = outcome.solution
        plan.take(request, found.x, found.status, found.objective)
        waiting = sorted([*waiting, *plan.ready()], key=lambda r: -1 if r.position is None else r.position)


def trace_front(
    problem: Problem, start: Array, count: int, how: Search, stop: Callable[[], bool] = never
) -> Iterator[Outcome]:
    """Points of the Pareto front of two objectives, one after the other; see `FrontPlan`.

    Parameters
    ----------
    start
        (n,) values of all variables.
    count
        Number of points, two at least.
    """
    for request, outcome in answers(problem, FrontPlan(problem, start, count, how), how, stop):
        if request.position is not None:
            yield outcome


def objective_value(problem: Problem, x: Array, objective: Expression) -> float:
    """Value of an objective at a design, on the truth model."""
    return float(Rows(problem, (objective,)).values(x, problem.evaluate(x, truth=True))[0])


def _judged(problem: Problem, x: Array, objective: Expression) -> float:
    """Value of an objective on the truth model, which limits hold on; where it has none, what the model says."""
    try:
        return objective_value(problem, x, objective)
    except FosoptError:
        return float(Rows(problem, (objective,)).values(x, problem.evaluate(x))[0])


def solve_cases(
    problem: Problem,
    start: Array,
    cases: Sequence[tuple[str, NDArray[np.bool_]]],
    how: Search,
    stop: Callable[[], bool] = never,
) -> Iterator[tuple[str, Outcome]]:
    """The same single-objective problem with different variables free, all from the same start."""
    plan = CasePlan(start, [(name, name, free) for name, free in cases], how)
    for request, outcome in answers(problem, plan, how, stop):
        yield request.case or "", outcome
