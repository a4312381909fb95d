"""Run a study: from the understood file to a directory of verified results, in one go or in several."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fosopt.errors import StoppedError, StudyError
from fosopt.problem import Problem
from fosopt.solve import Request
from fosopt.solve.ipopt import never
from fosopt.study.build import build_problem, start_vector
from fosopt.study.directory import make_directory, run_header, with_inputs, write_files
from fosopt.study.engine import Job, Pool, Serial, drive
from fosopt.study.load import dump_study, load_study
from fosopt.study.lock import only_writer
from fosopt.study.plan import identity, plan_of, request_identity
from fosopt.study.points import comparison, evaluated_point, mark_dominated, state_prices
from fosopt.study.processes import prepare
from fosopt.study.provenance import environment, threads
from fosopt.study.resume import Origin, inputs_of, record_of, recorded_study, refuse_changed
from fosopt.study.schema import Study
from fosopt.study.session import Session
from fosopt.study.store import RECORD, Answered, Store, StoreError
from fosopt.study.work import STUDY, Parcel, PointJob, parcel_files


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
        Since the start of this session.
    known
        Points that were finished before this session.
    """

    stage: str
    done: int
    total: int
    point: Mapping[str, Any] | None
    seconds: float
    known: int = 0


@dataclass(frozen=True)
class Workers:
    """Who computes: this process, processes of its own, or those of a scheduler.

    Attributes
    ----------
    count
        Processes to start on this machine, 0 to compute in this process.
    scheduler
        Address of a dask scheduler that has workers.
    """

    count: int = 0
    scheduler: str | None = None

    @property
    def alone(self) -> bool:
        """Whether this process computes by itself."""
        return not self.count and self.scheduler is None

    def __str__(self) -> str:
        if self.scheduler is not None:
            return f"scheduler {self.scheduler}"
        return f"{self.count} worker{'s' if self.count > 1 else ''}" if self.count else "serial"


Tell = Callable[[Progress], None]


def _quiet(progress: Progress) -> None:
    """Tell nobody."""


def run_study(
    study: Study,
    out: str | Path,
    *,
    progress: Tell = _quiet,
    stop: Callable[[], bool] = never,
    workers: Workers | None = None,
    origin: Origin | None = None,
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
    workers
        Who computes; this process by default.
    origin
        Where the study was read from, which `resume_run` will compare with.

    Raises
    ------
    StudyError
        If the study poses no problem, or `out` is not empty.
    StoppedError
        If the machine stops the run: a full disk, a lost scheduler. What was finished is written.
    """
    workers, out = workers or Workers(), Path(out)
    _refuse_threads(workers)
    if study.kind == "sweep":
        from fosopt.study.sweep import run_sweep

        return run_sweep(study, out, progress, stop, workers, origin)
    problem = build_problem(study)
    start_vector(study, problem)
    header = run_header(study, problem)
    header["provenance"] |= {"options": options(workers, origin)}
    make_directory(out)
    with only_writer(out):
        resolved, files = settle(study, out)
        with Store.create(out / RECORD, header, inputs_of(study, files, origin)) as store:
            return _go_on(store, resolved, problem, progress, stop, workers)


def resume_run(
    run: str | Path,
    *,
    progress: Tell = _quiet,
    stop: Callable[[], bool] = never,
    workers: Workers | None = None,
) -> dict[str, Any]:
    """Continue a run that was interrupted, or killed, and return its run data.

    What is finished is kept; points that were interrupted are done again. A complete run gets its files anew.

    Parameters
    ----------
    run
        The directory of the run, or its record.
    progress, stop, workers
        As `run_study`.

    Raises
    ------
    StudyError
        If the study has changed since the run began, or another process writes to the run.
    StoreError
        If there is no record, or it is damaged.
    StoppedError
        As `run_study`.
    """
    workers, path = workers or Workers(), record_of(Path(run))
    _refuse_threads(workers)
    Store.open(path).close()
    with only_writer(path.parent), Store.resume(path) as store:
        refuse_changed(store)
        study = recorded_study(store)
        if study.kind == "sweep":
            from fosopt.study.sweep import resume_sweep

            return resume_sweep(store, study, progress, stop, workers)
        return _go_on(store, study, build_problem(study), progress, stop, workers)


def options(workers: Workers, origin: Origin | None) -> str:
    """What was chosen on the command line, for the provenance of a run."""
    given = [] if origin is None else [f"set {each}" for each in origin.assignments]
    return "; ".join([str(workers), *given])


def settle(study: Study, out: Path) -> tuple[Study, dict[str, bytes]]:
    """Make a directory stand alone: the study with its side files in it, and the content of them all."""
    text = dump_study(with_inputs(study, out))
    (out / STUDY).write_text(text, encoding="utf-8")
    resolved = load_study(out / STUDY)
    return resolved, parcel_files(resolved, out)


def _refuse_threads(workers: Workers) -> None:
    if not workers.alone and threads() != "1":
        raise StudyError(
            f"this process uses {threads()} threads of linear algebra and workers use 1, which changes the last "
            "bits of results; set OMP_NUM_THREADS=1 and OPENBLAS_NUM_THREADS=1 before Python starts"
        )


def _go_on(
    store: Store, study: Study, problem: Problem, progress: Tell, stop: Callable[[], bool], workers: Workers
) -> dict[str, Any]:
    """Do what a record does not have yet, then write all files."""
    out, header = store.path.parent, store.header()
    start, study_id = start_vector(study, problem), header["provenance"]["study"]
    plan = plan_of(study, problem, start)
    known = store.answers()
    done = finished = sum(status != "interrupted" for _, status, _ in store.tally())
    session = Session.after(store.sessions(), finished, str(workers), environment())

    def tell(stage: str, point: Mapping[str, Any] | None = None) -> None:
        progress(Progress(stage, done, plan.total + 1, point, session.seconds, finished))

    def name(request: Request) -> str:
        return request_identity(study_id, request)

    def keep(point: dict[str, Any], position: int, of: str, answer: Answered | None = None) -> None:
        nonlocal done
        state_prices(point, header["quantities"])
        done += 1
        store.write_point(position, point, of, answer, session.record(done, plan.total + 1))
        tell(str(point["label"]), point)

    stopped: StoppedError | None = None
    tell("start design")
    try:
        try:
            # Workers start while this process judges the start design.
            with pool_of(PointJob(study, problem), study, workers, out) as pool:
                if not store.tally():
                    keep(_start_point(study, problem, start), 0, identity(study_id, {"name": "start"}))
                for request, response in drive(plan, pool, known, name, stop):
                    if response.point is None:
                        store.write_answer(name(request), response.answer)
                        tell(request.label)
                    else:
                        assert request.position is not None
                        keep(response.point, 1 + request.position, name(request), response.answer)
        except StoppedError as error:
            stopped = error
        run = _complete(store, study, session, done, plan.total + 1, stop(), stopped)
        tell("writing files")
        write_files(study, run, out)
    except (StoreError, OSError) as error:
        stopped = StoppedError(told(error))
    if stopped is not None:
        raise StoppedError(f"{stopped}; {going_on(done, plan.total + 1, out)}")
    return run


def told(error: Exception) -> str:
    """What went wrong with a file, in words."""
    if isinstance(error, OSError):
        return f"{error.filename}: {error.strerror or error}; make room" if error.filename else str(error)
    return str(error)


def going_on(done: int, total: int, out: Path) -> str:
    """How a run that was stopped goes on."""
    return f"{done} of {total} points are finished: continue with 'fosopt resume {out}'"


def _start_point(study: Study, problem: Problem, start: Any) -> dict[str, Any]:
    if study.kind == "analysis":
        return evaluated_point(problem, start, "000", "design", study.certificates)
    return evaluated_point(problem, start, "start", "start design")


def pool_of(job: Job, study: Study, workers: Workers, out: Path) -> AbstractContextManager[Pool]:
    """Whoever answers the requests of a study, whose files lie in a directory."""
    if study.kind == "analysis" or workers.alone:
        return nullcontext(Serial(job))
    if workers.scheduler is None:
        prepare()
    # dask takes a while to import, and only workers need it.
    from fosopt.study.cluster import Cluster

    parcel = Parcel(parcel_files(study, out), environment())
    return Cluster(job, parcel, workers=workers.count, scheduler=workers.scheduler)


def _complete(
    store: Store,
    study: Study,
    session: Session,
    done: int,
    total: int,
    interrupted: bool,
    stopped: StoppedError | None,
) -> dict[str, Any]:
    """What can only be said of all points together."""
    run = store.run()
    points = run["points"]
    before = [point["dominated"] for point in points]
    mark_dominated(points, run["objectives"])
    for point, was in zip(points, before, strict=True):
        if point["dominated"] != was:
            store.mark(point["key"], point)
    cut = interrupted or stopped is not None
    store.finish({"interrupted": cut, "comparison": comparison(study, points)})
    store.write_session(session.record(done, total, "interrupted" if cut else "finished"))
    return store.run()
