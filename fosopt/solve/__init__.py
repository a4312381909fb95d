"""Optimization: IPOPT on scaled programs, strategies, fronts."""

from fosopt.solve.front import (
    CasePlan,
    FrontPlan,
    Outcome,
    Plan,
    Request,
    Search,
    answer,
    everything_free,
    goal_of,
    solve_cases,
    trace_front,
)
from fosopt.solve.ipopt import Options, Solution, solve
from fosopt.solve.nlp import NonlinearProgram, Task
from fosopt.solve.strategies import Goal, reach, stabilize

__all__ = [
    "CasePlan",
    "FrontPlan",
    "Goal",
    "NonlinearProgram",
    "Options",
    "Outcome",
    "Plan",
    "Request",
    "Search",
    "Solution",
    "Task",
    "answer",
    "everything_free",
    "goal_of",
    "reach",
    "solve",
    "solve_cases",
    "stabilize",
    "trace_front",
]
