"""Optimization: IPOPT on scaled programs, strategies, fronts."""

from fosopt.solve.front import Outcome, Search, everything_free, solve_cases, trace_front
from fosopt.solve.ipopt import Options, Solution, solve
from fosopt.solve.nlp import NonlinearProgram, Task
from fosopt.solve.strategies import Goal, reach, stabilize

__all__ = [
    "Goal",
    "NonlinearProgram",
    "Options",
    "Outcome",
    "Search",
    "Solution",
    "Task",
    "everything_free",
    "reach",
    "solve",
    "solve_cases",
    "stabilize",
    "trace_front",
]
