"""One point of a study from a request, the same in this process and in a worker."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.errors import StudyError
from fosopt.problem import Problem
from fosopt.solve import Outcome, Request, Solution, answer, goal_of
from fosopt.solve.ipopt import never
from fosopt.study.build import build_problem
from fosopt.study.files import side_files
from fosopt.study.load import dump_study, parse_study
from fosopt.study.plan import search_of, time_limit
from fosopt.study.points import judged_point
from fosopt.study.provenance import unlike
from fosopt.study.schema import Study
from fosopt.study.store import Answered

STUDY = "study.yaml"
"""Name of the study file in the directory of a run and in a parcel."""


@dataclass(frozen=True)
class Parcel:
    """A study as it travels to another process: files by name, and the environment it was checked in.

    Attributes
    ----------
    files
        The study file and its side files.
    environment
        Versions that decide the last bits of a result.
    """

    files: Mapping[str, bytes]
    environment: Mapping[str, str]

    @contextmanager
    def laid_out(self) -> Iterator[Study]:
        """The study, while its files stand in a folder of their own.

        Raises
        ------
        StudyError
            If this process has other versions or threads, or the files break a rule.
        """
        differs = unlike(self.environment)
        if differs:
            raise StudyError(
                f"a worker has {differs}; results would not be the same to the last bit: give every worker the "
                "environment of this run"
            )
        with laid_out(self.files) as study:
            yield study


def opened(files: Mapping[str, bytes]) -> tuple[Study, Problem]:
    """The study of files by name, and its problem, which needs the files no more.

    Raises
    ------
    StudyError
        If the files break a rule.
    """
    with laid_out(files) as study:
        return study, build_problem(study)


@contextmanager
def laid_out(files: Mapping[str, bytes]) -> Iterator[Study]:
    """The study of files by name, while they stand in a folder of their own.

    Raises
    ------
    StudyError
        If the files break a rule.
    """
    with tempfile.TemporaryDirectory(prefix="fosopt-") as folder:
        for name, content in files.items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        yield parse_study(files[STUDY].decode(), folder, STUDY)


@dataclass(frozen=True)
class Response:
    """What became of a request: the point it stands for, None for an end of a front, and the solver's answer."""

    point: dict[str, Any] | None
    answer: Answered


class PointJob:
    """Optimizations of a study, each judged.

    Attributes
    ----------
    limit
        How long one of them may take [s].
    """

    def __init__(self, study: Study, problem: Problem) -> None:
        self._study, self._problem = study, problem
        self.limit = time_limit(study)

    def respond(self, request: Request, stop: Callable[[], bool] = never) -> Response:
        """Make one optimization and judge what it found."""
        end = time.monotonic() + self.limit

        def enough() -> bool:
            return stop() or time.monotonic() > end

        outcome = answer(self._problem, request, search_of(self._study), enough)
        if outcome.solution.status == "interrupted" and not stop():
            late = replace(outcome.solution, status="failed", reason=late_reason(self.limit))
            outcome = replace(outcome, solution=late)
        found = outcome.solution
        point = None
        if request.position is not None:
            bounds = self._study.certificates
            point = judged_point(self._problem, request.position, request.case, outcome, bounds)
        return Response(point, Answered(found.x, found.status, found.objective))

    def unanswered(self, request: Request, reason: str) -> Response:
        """What a search would have started from, judged, where it was given up from outside."""
        goal, x = goal_of(self._problem, request), request.starts[0]
        lost = Solution(x, "failed", reason, float("nan"), np.zeros(0), (), 0, 0.0, ())
        outcome = Outcome(request.label, request.strategy, goal, lost, request.parent)
        assert request.position is not None
        point = judged_point(self._problem, request.position, request.case, outcome)
        return Response(point, Answered(x, "failed", float("nan")))


def job_of(study: Study, problem: Problem) -> Any:
    """What is done with the requests of a study."""
    if study.kind != "sweep":
        return PointJob(study, problem)
    # A sweep takes numba along.
    from fosopt.study.sweep_job import SweepJob

    return SweepJob(study)


def late_reason(limit: float) -> str:
    """Why a point that took too long has failed."""
    return f"stopped after {limit:.4g} s, all the time that a point has; raise solve.time_limit"


def parcel_files(study: Study, directory: Path) -> dict[str, bytes]:
    """Files of a study whose side files lie in its run directory, by their names there."""
    files = {STUDY: dump_study(study).encode()}
    for path in side_files(study):
        files[path.relative_to(study.base).as_posix()] = (
            directory / path.relative_to(study.base)
        ).read_bytes()
    return files
