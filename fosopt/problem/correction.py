"""Constraints on the truth, in terms of the model that designs are found on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fosopt.errors import FosoptError
from fosopt.ops import Array
from fosopt.problem.as_built import AsBuilt
from fosopt.problem.problem import Constraint, Problem, Rows


def is_model_enough(problem: Problem) -> bool:
    """Whether the model a design is found on needs no correction: a continuous loop on a structure solved whole."""
    return problem.base.loop.controller.path.sampling is None and problem.system.truncated is None


def as_model_sees(problem: Problem, constraints: Sequence[Constraint], x: Array) -> tuple[Constraint, ...]:
    """Constraints whose bounds are moved by what the model of a sampled loop or a truncated truss is off at a design.

    Where the model meets them the truth meets those given, to first order around the design: an additive
    correction of a cheap model by a dear one. Constraints without metrics of the loop, and those of a loop that is not
    sampled or has no such value, stay as they are.    [Alexandrov2001]

    Parameters
    ----------
    x
        (n,) values of all variables.
    """
    if is_model_enough(problem):
        return tuple(constraints)
    truth, model = problem.evaluate(x, truth=True), problem.evaluate(x)
    moved = []
    for constraint in constraints:
        off = 0.0
        truncated = problem.system.truncated is not None
        if truncated or any(AsBuilt.has(name) for name, _ in constraint.expression.references):
            rows = Rows(problem, (constraint.expression,))
            try:
                off = float(rows.values(x, truth)[0] - rows.values(x, model)[0])
            except FosoptError:
                off = 0.0
        moved.append(replace(constraint, lower=constraint.lower - off, upper=constraint.upper - off))
    return tuple(moved)
