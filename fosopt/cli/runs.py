"""Commands about runs: what they share with 'run', and those that continue, watch, repeat and compare runs."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fosopt.cli.guard import Code, Stop, guarded, interruptible, say

if TYPE_CHECKING:
    from fosopt.cli.progress import Watch
    from fosopt.study.runner import Workers
    from fosopt.study.schema import Study

    Start = Callable[[Study], AbstractContextManager[Watch]]

RESUME_HELP = """Continue a run that was interrupted or killed.

What is finished is kept, to the last bit; points that were at hand are done again. A run whose study has changed since
is refused. A complete run gets its files anew.
"""
STATUS_HELP = """Say how far a run has come, also while it goes on.

Exit code 0 for a finished run, 4 for one that goes on or can be resumed, 3 where there is none.
"""
RERUN_HELP = """Compute one point of a run again, and show every iteration.

Nothing is written. Exit code 0 if all numbers are the recorded ones to the last bit, 4 if not.
"""
DIFF_HELP = """Compare two runs: hypervolume of the fronts, points gained and points lost.

A point of the second run is gained if no point of the first is as good in both objectives; a point of the first is lost
if none of the second is. Exit code 0 if nothing differs, 4 if something does.
"""

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="The directory of a run, or its run.sqlite.")]
WorkerCount = Annotated[
    int,
    typer.Option(
        "--workers",
        metavar="N",
        min=0,
        max=1024,
        help="Compute in N processes of this machine; 0 for none but this one.",
    ),
]
SchedulerAddress = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Compute on the workers of a dask scheduler, such as tcp://host:8786; see docs/running.md on security.",
        show_default=False,
    ),
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON summary on stdout, and nothing else there.")
]


def who(workers: int, scheduler: str | None) -> Workers:
    """Who computes, from the options of a command.

    Raises
    ------
    typer.BadParameter
        If both are given, or the address is none.
    """
    from fosopt.study.runner import Workers

    if workers and scheduler is not None:
        raise typer.BadParameter("--workers and --scheduler exclude each other; give one of them")
    if scheduler is not None and not scheduler.startswith(("tcp://", "tls://", "ucx://", "ws://", "wss://")):
        raise typer.BadParameter(f"'{scheduler}' is no address of a scheduler; write tcp://HOST:PORT")
    return Workers(workers, scheduler)


def end(work: Callable[[Start, Stop], tuple[dict[str, Any], Path]], as_json: bool) -> None:
    """Do the work of a run, say what came of it, and exit with its code."""
    from fosopt.cli.outcome import closing, exit_code, summary
    from fosopt.cli.progress import watching
    from fosopt.cli.sweep import sweep_closing, sweep_code, sweep_summary, watching_sweep

    started = time.monotonic()
    with interruptible() as stop:

        def tell(study: Study) -> AbstractContextManager[Watch]:
            return watching_sweep() if study.kind == "sweep" else watching(study)

        data, directory = work(tell, stop)
        sweep = data["kind"] == "sweep"
        code = sweep_code(data) if sweep else exit_code(data, stopped=stop())
    seconds = time.monotonic() - started
    if as_json:
        said = (sweep_summary if sweep else summary)(data, directory, code, seconds)
        say(json.dumps(said, allow_nan=False))
    for line in (sweep_closing if sweep else closing)(data, directory, seconds):
        say(line, error=as_json)
    if code == Code.INTERRUPTED:
        say(f"continue with: fosopt resume {directory}", error=as_json)
    raise typer.Exit(code)


@guarded
def resume(
    run_path: RunPath,
    workers: WorkerCount = 0,
    scheduler: SchedulerAddress = None,
    as_json: AsJson = False,
) -> None:
    """Continue a run that was interrupted or killed."""

    def work(tell: Start, stop: Stop) -> tuple[dict[str, Any], Path]:
        from fosopt.study.resume import record_of, recorded_study
        from fosopt.study.runner import resume_run
        from fosopt.study.store import Store

        path = record_of(run_path)
        with Store.open(path) as store:
            study = recorded_study(store)
        with tell(study) as watch:
            data = resume_run(path, progress=watch, stop=stop, workers=who(workers, scheduler))
        return data, path.parent

    end(work, as_json)


@guarded
def status(run_path: RunPath, as_json: AsJson = False) -> None:
    """Say how far a run has come."""
    from fosopt.study.resume import record_of
    from fosopt.study.status import said, status_of

    found = status_of(record_of(run_path))
    if as_json:
        say(json.dumps(found, allow_nan=False))
    else:
        for line in said(found):
            say(line)
    raise typer.Exit(Code.DONE if found["state"] == "finished" else Code.UNVERIFIED)


@guarded
def rerun(
    run_path: RunPath,
    key: Annotated[
        str,
        typer.Option(
            "--point", metavar="KEY", help="Key of the point, as in front.csv, or its number in a sweep."
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Compute one point of a run again."""
    from fosopt.study.rerun import rerun_point, said
    from fosopt.study.resume import record_of

    with interruptible() as stop:
        found = rerun_point(record_of(run_path), key, stop)
    if as_json:
        say(json.dumps(found, allow_nan=False))
    else:
        for line in said(found):
            say(line)
    if found["interrupted"]:
        raise typer.Exit(Code.INTERRUPTED)
    raise typer.Exit(Code.DONE if not found["differs"] else Code.UNVERIFIED)


@guarded
def diff(
    first: Annotated[Path, typer.Argument(metavar="RUN", help="The run to compare with.")],
    second: Annotated[Path, typer.Argument(metavar="RUN", help="The run that is compared.")],
    as_json: AsJson = False,
) -> None:
    """Compare two runs."""
    from fosopt.study.difference import difference, said
    from fosopt.study.resume import record_of

    found = difference(record_of(first), record_of(second))
    if as_json:
        say(json.dumps(found, allow_nan=False))
    else:
        for line in said(found):
            say(line)
    raise typer.Exit(Code.DONE if not (found["gained"] or found["lost"]) else Code.UNVERIFIED)
