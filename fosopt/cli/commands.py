"""The commands: what they read, what they call, what they print."""

from __future__ import annotations

import json
import time
from enum import StrEnum
from itertools import count
from pathlib import Path
from typing import Annotated

import typer

from fosopt.cli import reproduce
from fosopt.cli.guard import guarded, interruptible, say

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
finished. Ctrl-C ends the run after what is at hand; a second Ctrl-C ends it at once.
A sweep leaves points.csv, boundary.csv, arrays/ with one .npy file per axis and output, sweep.mat where these are not
large, and sweep.json, which names them all with their units.
"""
_RUN_EPILOG = """\b
Exit codes:
  0    finished; at least one point is verified and none failed
  1    a defect of fosopt; FOSOPT_DEBUG=1 shows the traceback
  2    wrong usage
  3    the study file, a file it names or the output directory is at fault
  4    finished, but a point failed (no convergence, out of time or not
       verified), or no point is verified
  130  interrupted; what was found so far is on disk
"""


class Format(StrEnum):
    """Files that a run is exported to."""

    CSV = "csv"
    JSON = "json"
    MAT = "mat"


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


@app.command(help=_RUN_HELP, epilog=_RUN_EPILOG)
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
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON summary on stdout, and nothing else there.")
    ] = False,
) -> None:
    """Solve a study and write its results."""
    from fosopt.cli.outcome import closing, exit_code, summary
    from fosopt.cli.progress import watching
    from fosopt.cli.sweep import sweep_closing, sweep_code, sweep_summary, watching_sweep

    started = time.monotonic()
    with interruptible() as stop:
        from fosopt.study.load import load_study
        from fosopt.study.runner import run_study

        study = load_study(study_file, assignments or ())
        directory = _fresh_directory(study_file) if out is None else out
        sweep = study.kind == "sweep"
        with watching_sweep() if sweep else watching(study) as watch:
            data = run_study(study, directory, progress=watch, stop=stop)
        code = sweep_code(data) if sweep else exit_code(data, stopped=stop())
    seconds = time.monotonic() - started
    if as_json:
        said = (sweep_summary if sweep else summary)(data, directory, code, seconds)
        say(json.dumps(said, allow_nan=False))
    for line in (sweep_closing if sweep else closing)(data, directory, seconds):
        say(line, error=as_json)
    raise typer.Exit(code)


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

    study = load_study(study_file, assignments or ())
    build_problem(study)
    if as_json:
        say(json.dumps(study.model_dump(mode="json", exclude_none=True), allow_nan=False))
    else:
        say("\n".join(describe_study(study)))


@app.command()
@guarded
def schema() -> None:
    """Print the JSON schema of the study file, for editors."""
    from fosopt.study import Study

    say(json.dumps(Study.model_json_schema(), indent=2))


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


@app.command()
@guarded
def export(
    run_path: Annotated[
        Path, typer.Argument(metavar="RUN", help="The directory of a run, or its run.sqlite.")
    ],
    target: Annotated[Format, typer.Option("--format", help="What to write.")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The file to write; default front.csv, front.json or front.mat beside the record.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write the points of a run for other programs.

    The run may be going on, or have been killed.
    """
    from fosopt import export as writers
    from fosopt.study.store import RECORD, Store

    record = run_path / RECORD if run_path.is_dir() else run_path
    with Store.open(record) as store:
        data = store.run()
    path = record.with_name(f"front.{target}") if out is None else out
    write = {Format.CSV: writers.write_csv, Format.JSON: writers.write_json, Format.MAT: writers.write_mat}
    write[target](data, path)
    say(f"wrote {path}")


app.command(help=reproduce.HELP, epilog=reproduce.EPILOG)(reproduce.reproduce)
