"""Solutions on a model of the truth, corrected until they meet their constraints on the truth itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from fosopt.problem import Constraint
from fosopt.problem.correction import as_model_sees, is_model_enough
from fosopt.solve.ipopt import Options, Solution, never
from fosopt.solve.strategies import Goal, Strategy, reach

# How often the model is corrected, and what is left of a bound's change at the end (relative).
_CORRECTIONS = 8
_CORRECTED = 5e-7


def corrected(
    goal: Goal, found: Solution, strategy: Strategy, options: Options, stop: Callable[[], bool] = never
) -> Solution:
    """A goal met by the truth, from a solution on its model: the model is corrected at each solution in turn.

    Each solution is looked for next to the one before: with many local optima the corrections would not settle.

    Parameters
    ----------
    found
        Solution without correction; it stays where the model needs none.

    Returns
    -------
    Solution
        Failed, with what to do, where the corrections do not settle.
    """
    problem = goal.problem
    if is_model_enough(problem):
        return found
    before, near = goal.constraints, replace(options, near=True)
    for left in range(_CORRECTIONS, -1, -1):
        if found.status != "optimal":
            break
        moved = as_model_sees(problem, goal.constraints, found.x)
        if all(_close(a, b) for a, b in zip(moved, before, strict=True)):
            break
        if not left:
            return replace(found, status="failed", reason=_unsettled(goal.constraints, before, moved))
        asked = replace(goal, constraints=moved)
        again = reach(asked, found.x, strategy, near, stop)
        if again.status not in ("optimal", "interrupted"):
            again = _after(again, reach(asked, found.x, strategy, options, stop))
        before, found = moved, _after(found, again)
    return found


def _after(first: Solution, second: Solution) -> Solution:
    """The second solution with the effort of both."""
    return replace(
        second, iterations=first.iterations + second.iterations, seconds=first.seconds + second.seconds
    )


def _unsettled(given: Sequence[Constraint], before: Sequence[Constraint], now: Sequence[Constraint]) -> str:
    """What to do where a constraint's correction still moves."""
    moving = [g.name for g, a, b in zip(given, before, now, strict=True) if not _close(a, b)]
    return (
        f"constraint '{moving[0]}': what its model is off still changes after {_CORRECTIONS} corrections; sample "
        "faster or keep more modes, narrow the variables, or start elsewhere"
    )


def _close(one: Constraint, other: Constraint) -> bool:
    pairs = ((one.lower, other.lower), (one.upper, other.upper))
    return all(a == b or abs(a - b) <= _CORRECTED * max(abs(a), abs(b)) for a, b in pairs)
