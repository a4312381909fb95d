"""Run a study: from the understood file to a directory of verified results."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.ops import Array
from fosopt.problem import Problem
from fosopt.solve import Options, Outcome, Search, everything_free, solve_cases, trace_front
from fosopt.solve.ipopt import never
from fosopt.study.build import build_problem, start_vector
from fosopt.study.directory import make_directory, run_header, with_inputs, write_files
from fosopt.study.load import dump_study
from fosopt.study.points import comparison, evaluated_point, judged_point, mark_dominated, state_prices
from fosopt.study.schema import Study
from fosopt.study.store import Store


@dataclass(frozen=True)
class Progress:
    """How far a run has come.

    Attributes
    ----------
    stage
        What is being done.
    done, total
        Points.
    point
        The point of the run data that was just finished, if one was.
    seconds
        Since the start.
    """

    stage: str
    done: int
    total: int
    point: Mapping[str, Any] | None
    seconds: float


def _quiet(progress: Progress) -> None:
    """Tell nobody."""


def run_study(
    study: Study,
    out: str | Path,
    *,
    progress: Callable[[Progress], None] = _quiet,
    stop: Callable[[], bool] = never,
) -> dict[str, Any]:
    """Run a study into a new directory and return its run data.

    Every point is written to ``run.sqlite`` as soon as it is finished; the other files are written at the end,
    also when the run is stopped.

    Parameters
    ----------
    out
        Directory to make; an existing one must be empty.
    progress
        Called when a stage starts and when a point is finished.
    stop
        Asked often; true ends the run with what it has.

    Raises
    ------
    StudyError
        If the study poses no problem, or `out` is not empty.
    """
    begin, out = time.perf_counter(), Path(out)
    if study.kind == "sweep":
        from fosopt.study.sweep import run_sweep

        return run_sweep(study, out, progress, stop)
    problem = build_problem(study)
    start = start_vector(study, problem)
    header = run_header(study, problem)
    make_directory(out)
    resolved = with_inputs(study, out)
    (out / "study.yaml").write_text(dump_study(resolved), encoding="utf-8")
    total = _count(study)
    points: list[dict[str, Any]] = []

    def tell(stage: str, point: Mapping[str, Any] | None = None) -> None:
        progress(Progress(stage, len(points), total, point, time.perf_counter() - begin))

    with Store.create(out / "run.sqlite", header) as store:
        tell("start design")
        for point in _points(study, problem, start, stop):
            state_prices(point, header["quantities"])
            points.append(point)
            store.write_point(len(points) - 1, point)
            tell(str(point["label"]), point)
        if mark_dominated(points, header["objectives"]):
            for position, point in enumerate(points):
                store.write_point(position, point)
        store.finish({"interrupted": stop(), "comparison": comparison(study, points)})
        run = store.run()
    tell("writing files")
    write_files(resolved, run, out)
    return run


def _count(study: Study) -> int:
    each = 1 + len(study.solve.compare)
    if study.kind == "analysis":
        return 1
    if study.front is not None:
        return 1 + study.front.points * each
    return 1 + max(len(study.cases), 1) * each


def _points(
    study: Study, problem: Problem, start: Array, stop: Callable[[], bool]
) -> Iterator[dict[str, Any]]:
    """Points of the run data, the start design first."""
    analysis = study.kind == "analysis"
    yield evaluated_point(
        problem,
        start,
        "000" if analysis else "start",
        "design" if analysis else "start design",
        study.certificates if analysis else None,
    )
    if analysis:
        return
    options = Options(study.solve.tolerance, study.solve.max_iterations, study.solve.time_limit)
    how = Search(study.solve.strategy, options, study.solve.starts, study.solve.seed, study.solve.compare)
    outcomes: Iterator[tuple[str | None, Outcome]]
    if study.front is not None:
        outcomes = ((None, o) for o in trace_front(problem, start, study.front.points, how, stop))
    elif study.cases:
        outcomes = ((n, o) for n, o in solve_cases(problem, start, _masks(study, problem), how, stop))
    else:
        outcomes = (
            (None, o)
            for _, o in solve_cases(problem, start, [("optimum", everything_free(problem))], how, stop)
        )
    for position, (case, outcome) in enumerate(outcomes):
        yield judged_point(problem, position, case, outcome, study.certificates)


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
