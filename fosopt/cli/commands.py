"""The commands: what they read, what they call, what they print."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import Annotated, Any

import typer

from fosopt.cli import export as exporting
from fosopt.cli import reproduce, runs
from fosopt.cli.doctor import doctor
from fosopt.cli.guard import EXIT_CODES, Stop, guarded, say

app = typer.Typer(
    help="Co-design of structure, mirror and controller for flexible optical systems.",
    epilog="Start with 'fosopt new study.yaml', then 'fosopt check study.yaml' and 'fosopt run study.yaml'.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

StudyFile = Annotated[Path, typer.Argument(metavar="STUDY", help="The study file, in YAML.")]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value of the study file, such as front.points=5 or variables.0.upper='300 mm^2'; "
        "list items count from 0. May be repeated.",
    ),
]

_RUN_HELP = """Solve a study and write its results.

Results go to a directory: report.html to look at, front.csv and front.json for other programs, study.yaml and
designs/ to run again, run.sqlite as the record that 'fosopt export' reads. A point is on disk as soon as it is
finished. Ctrl-C ends the run after what is at hand; a second Ctrl-C ends it at once. 'fosopt resume' continues a
run that was interrupted or killed.
A sweep leaves points.csv, boundary.csv, arrays/ with one .npy file per axis and output, sweep.mat where these are not
large, and sweep.json, which names them all with their units.
"""


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            say(f"fosopt {version('fosopt')}")
        except PackageNotFoundError:
            say("fosopt, not installed")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


@app.command(help=_RUN_HELP, epilog=EXIT_CODES)
@guarded
def run(
    study_file: StudyFile,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Directory of the results, empty or new; default runs/<name of the study file>, with -2, -3 "
            "and so on where that exists.",
            show_default=False,
        ),
    ] = None,
    assignments: Assignments = None,
    workers: runs.WorkerCount = 0,
    scheduler: runs.SchedulerAddress = None,
    as_json: runs.AsJson = False,
) -> None:
    """Solve a study and write its results."""

    def work(tell: runs.Start, stop: Stop) -> tuple[dict[str, Any], Path]:
        from fosopt.study.load import load_study
        from fosopt.study.resume import Origin
        from fosopt.study.runner import run_study

        study = load_study(study_file, assignments or ())
        directory = _fresh_directory(study_file) if out is None else out
        origin = Origin(study_file, assignments or ())
        who = runs.who(workers, scheduler)
        with tell(study) as watch:
            return run_study(
                study, directory, progress=watch, stop=stop, workers=who, origin=origin
            ), directory

    runs.end(work, as_json)


def _fresh_directory(study_file: Path) -> Path:
    runs = Path("runs")
    later = (runs / f"{study_file.stem}-{number}" for number in count(2))
    first = runs / study_file.stem
    return first if not first.exists() else next(path for path in later if not path.exists())


@app.command()
@guarded
def check(
    study_file: StudyFile,
    assignments: Assignments = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the study as JSON, in SI with all defaults.")
    ] = False,
) -> None:
    """Read a study file and print the problem as mathematics. Exit code 3 if the file breaks a rule."""
    from fosopt.study import describe_study, load_study
    from fosopt.study.build import build_problem
    from fosopt.study.describe_loop import describe_controller

    study = load_study(study_file, assignments or ())
    problem = build_problem(study)
    if as_json:
        say(json.dumps(study.model_dump(mode="json", exclude_none=True), allow_nan=False))
    else:
        say("\n".join([*describe_study(study), *describe_controller(study, problem)]))


@app.command()
@guarded
def schema(
    page: Annotated[
        Path | None,
        typer.Option(
            "--page",
            metavar="FILE",
            help="Write the reference of the study file as a page of Markdown to FILE, and print nothing.",
        ),
    ] = None,
) -> None:
    """Print the JSON schema of the study file, for editors."""
    from fosopt.files import replacing
    from fosopt.study import Study
    from fosopt.study.schema_page import study_file_page

    if page is None:
        say(json.dumps(Study.model_json_schema(), indent=2))
        return
    with replacing(page) as temporary:
        temporary.write_text(study_file_page(), encoding="utf-8")


@app.command()
@guarded
def new(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="The file to write.")] = Path("study.yaml"),
) -> None:
    """Write a study file to start from. An existing file is left alone."""
    from fosopt.errors import FosoptError
    from fosopt.study.template import TEMPLATE

    try:
        with path.open("x", encoding="utf-8", newline="\n") as stream:
            stream.write(TEMPLATE)
    except FileExistsError:
        raise FosoptError(f"{path}: exists already; give another path") from None
    say(f"wrote {path}; edit it, then: fosopt run {path}")


app.command(help=exporting.HELP)(exporting.export)
app.command(help=runs.RESUME_HELP, epilog=EXIT_CODES)(runs.resume)
app.command(help=runs.STATUS_HELP)(runs.status)
app.command(help=runs.RERUN_HELP)(runs.rerun)
app.command(help=runs.DIFF_HELP)(runs.diff)
app.command()(doctor)
app.command(help=reproduce.HELP, epilog=reproduce.EPILOG)(reproduce.reproduce)
