"""What a study asks of the solver: its plan, how every point is searched for, and what identifies a point."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fosopt.ops import Array
from fosopt.problem import Problem
from fosopt.solve import CasePlan, FrontPlan, Options, Plan, Request, Search, everything_free
from fosopt.study.schema import Study

_MOST_SOLVES = 3  # optimizations of one start: the first try, the least violation, the second try
_JUDGING = 60.0  # what certificates and curves may take beside the optimizations [s]


def search_of(study: Study) -> Search:
    """How every point of a study is searched for."""
    given = study.solve
    options = Options(given.tolerance, given.max_iterations, given.time_limit)
    return Search(given.strategy, options, given.starts, given.seed, given.compare)


def plan_of(study: Study, problem: Problem, start: Array) -> Plan:
    """The optimizations of a study; an analysis has none."""
    how = search_of(study)
    if study.kind == "analysis":
        return CasePlan(start, (), how)
    if study.front is not None:
        return FrontPlan(problem, start, study.front.points, how)
    if not study.cases:
        return CasePlan(start, [(None, "optimum", everything_free(problem))], how)
    return CasePlan(start, [(n, n, free) for n, free in _masks(study, problem)], how)


def _masks(study: Study, problem: Problem) -> list[tuple[str, NDArray[np.bool_]]]:
    slices = problem.slices()
    masks = []
    for case in study.cases:
        names = case.free if not isinstance(case.free, str) else tuple(slices) if case.free == "all" else ()
        free = np.zeros(problem.size, dtype=bool)
        for name in names:
            free[slices[name]] = True
        masks.append((case.name, free))
    return masks


def identity(study_hash: str, coordinates: Mapping[str, object]) -> str:
    """What is unique to a point: a digest of its study and its coordinates in it."""
    text = json.dumps([study_hash, coordinates], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def request_identity(study_hash: str, request: Request) -> str:
    """The identity of what a request asks for."""
    coordinates = {"name": request.name, "strategy": request.strategy, "case": request.case}
    return identity(study_hash, coordinates)


def time_limit(study: Study) -> float:
    """How long one point may take before it counts as hanging [s].

    The limit of the study holds for one optimization; a point may need several, and is judged afterwards.
    """
    each = _MOST_SOLVES * study.solve.starts * study.solve.time_limit
    strategies = {study.solve.strategy, *study.solve.compare}
    bounds = study.certificates
    judging = _JUDGING + (bounds.pid.time_limit if bounds is not None and bounds.pid is not None else 0.0)
    return (2 if "sequential" in strategies else 1) * each + judging
