"""The command: exit codes, what goes to which stream, and how it ends when it is interrupted."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from fake_run import fake_run, point
from typer.testing import CliRunner

from fosopt.cli.commands import app
from fosopt.cli.guard import Code
from fosopt.cli.progress import duration, remaining, watching
from fosopt.errors import ModelError, StoppedError
from fosopt.study import TEMPLATE, load_study
from fosopt.study.runner import Progress, Workers
from fosopt.study.store import RECORD, Store

FRONT = (point("start", "evaluated"), point("000"), point("001"))


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A study file in the working directory."""
    monkeypatch.chdir(tmp_path)
    Path("beam.yaml").write_text(TEMPLATE, encoding="utf-8")
    return "beam.yaml"


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch):
    """Put a runner in place that returns given points, or raises, and records its calls."""

    def put(*points, error: BaseException | None = None, **changes):
        calls = []

        def run_study(study, out, *, progress, stop, workers, origin):
            calls.append(SimpleNamespace(study=study, out=out, stop=stop, workers=workers, origin=origin))
            total = len(points)
            progress(Progress("start design", 0, total, None, 0.0))
            for done, each in enumerate(points, 1):
                progress(Progress(each["label"], done, total, each, 10.0))
            if error is not None:
                raise error
            return fake_run(*points, **changes)

        monkeypatch.setattr("fosopt.study.runner.run_study", run_study)
        return calls

    return put


def invoke(*arguments: str):
    return CliRunner().invoke(app, [str(each) for each in arguments], prog_name="fosopt")


def one_line(result) -> str:
    """The only line on stderr of a command that printed nothing else."""
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("fosopt: ")
    return result.stderr.removeprefix("fosopt: ").rstrip("\n")


def test_a_verified_front_ends_with_its_table_and_code_0(study, solved):
    calls = solved(*FRONT)
    result = invoke("run", study)
    assert result.exit_code == 0
    assert calls[0].out == Path("runs/beam")
    lines = result.stdout.splitlines()
    assert re.fullmatch(r"point +structural mass \[kg\] +total jitter \[urad\] +status +verified", lines[0])
    assert lines[2].split() == ["000", "9.1", "10", "optimal", "yes", "point", "000"]
    assert "3 points, 2 verified in " in result.stdout
    assert "open runs/beam/report.html in a browser" in lines[-1]


def test_progress_goes_to_stderr_one_line_per_point(study, solved):
    solved(point("start", "evaluated"), point("000"), point("001", "failed", reason="no step; raise it"))
    result = invoke("run", study)
    assert result.stderr.splitlines() == [
        "[0/3] start design",
        "[1/3] start point start: evaluated, verified; structural_mass 9.1 kg, jitter_total 10 urad (10 s)",
        "[2/3] 000 point 000: optimal, verified; structural_mass 9.1 kg, jitter_total 10 urad "
        "(10 s, 6 points/min, about 10 s left)",
        "[3/3] 001 point 001: failed, not verified; structural_mass 10.1 kg, jitter_total 5 urad; "
        "no step; raise it (10 s)",
    ]


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (FRONT, 0),
        ((*FRONT, point("002", "infeasible", reason="why")), 0),
        ((*FRONT, point("002", "unstable", reason="why")), 0),
        ((*FRONT, point("002", "failed", reason="why")), 4),
        ((*FRONT, point("002", "interrupted", reason="out of time")), 4),
        ((*FRONT, point("002", verified=False, reason="why")), 4),
        ((point("start", "evaluated"),), 4),
        ((point("start", "evaluated"), point("000", "infeasible", reason="why")), 4),
        ((point("000", "evaluated"),), 0),
        ((point("000", "unstable", reason="why"),), 4),
        ((), 4),
    ],
)
def test_the_exit_code_says_whether_the_front_is_sound(study, solved, points, code):
    solved(*points)
    result = invoke("run", study, "--json")
    assert result.exit_code == code
    assert json.loads(result.stdout)["exit_code"] == code


def test_json_is_all_there_is_on_stdout(study, solved):
    solved(*FRONT, point("002", "unstable", reason="it grows; lower kp"))
    result = invoke("run", study, "--json", "--out", "there")
    summary = json.loads(result.stdout)
    assert result.stdout.count("\n") == 1
    assert summary["directory"] == "there"
    assert summary["files"]["report"] == str(Path("there/report.html"))
    assert summary["counts"] == {"points": 4, "verified": 2, "failed": 0, "interrupted": 0}
    assert summary["points"][1]["values"] == {"structural_mass": 9.1, "jitter_total": 1e-5}
    assert summary["points"][3]["values"]["jitter_total"] is None
    assert "002 unstable: it grows; lower kp" in result.stderr


def test_a_design_that_is_judged_ends_with_its_metrics(study, solved):
    metrics = {**point("000")["metrics"], "natural_frequency[1]": 3.0}
    solved(point("000", "evaluated", metrics=metrics), objectives=[], kind="analysis")
    stdout = invoke("run", study).stdout
    assert re.search(r"^first elastic frequency \[Hz\] +6$", stdout, re.MULTILINE)
    assert re.search(r"^modulus margin +0.5$", stdout, re.MULTILINE)
    assert "natural_frequency" not in stdout


def test_a_long_front_is_cut_short(study, solved):
    solved(*(point(f"{k:03d}") for k in range(100)))
    stdout = invoke("run", study).stdout
    assert len(stdout.splitlines()) < 40
    assert "and 70 more points" in stdout


def test_results_go_to_a_directory_of_their_own(study, solved):
    calls = solved(*FRONT)
    for name in ("beam", "beam-2", "beam-3"):
        invoke("run", study)
        assert calls[-1].out == Path("runs") / name
        calls[-1].out.mkdir(parents=True)


def test_set_replaces_values_of_the_study(study, solved):
    calls = solved(*FRONT)
    invoke("run", study, "--set", "front.points=7", "--set", "name=Other")
    assert (calls[0].study.front.points, calls[0].study.name) == (7, "Other")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "absent.yaml"), "absent.yaml: no such file; check the path"),
        (("check", "absent.yaml"), "absent.yaml: no such file; check the path"),
        (("check", "."), ".: the file cannot be read: Is a directory; check the path and permissions"),
        (
            ("check", "beam.yaml", "--set", "front.points=1"),
            "--set front.points=1: front.points: 1 is too small",
        ),
        (("run", "beam.yaml", "--set", "nonsense"), "'nonsense' is no assignment; write key=value"),
        (("run", "broken.yaml"), "broken.yaml:1:1: unknown: unknown key"),
        (("new", "beam.yaml"), "beam.yaml: exists already; give another path"),
        (("new", "absent/beam.yaml"), "absent/beam.yaml: No such file or directory; check the path"),
        (("export", "absent", "--format", "csv"), "absent: no such file; give the directory of a run"),
        (("export", ".", "--format", "csv"), "run.sqlite: no such file; give the directory of a run"),
        (("export", "beam.yaml", "--format", "mat"), "beam.yaml: is not the record of a fosopt run"),
    ],
)
def test_what_the_user_can_mend_is_one_line_and_code_3(study, arguments, message):
    Path("broken.yaml").write_text("unknown: 1\n")
    result = invoke(*arguments)
    assert result.exit_code == 3
    assert message in one_line(result)


@pytest.mark.parametrize(
    "error",
    [
        ModelError("the truss is a mechanism;\nadd a bar"),
        OSError(errno.ENOSPC, "No space left on device", "runs/beam/report.html"),
    ],
)
def test_what_goes_wrong_in_a_run_is_one_line_and_code_3(study, solved, error):
    solved(error=error)
    result = invoke("run", study)
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-1] in (
        "fosopt: the truss is a mechanism; add a bar",
        "fosopt: runs/beam/report.html: No space left on device; check the path, permissions and free space",
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ("nonsense",),
        ("run",),
        ("run", "beam.yaml", "--nonsense"),
        ("run", "beam.yaml", "--workers", "-1"),
        ("run", "beam.yaml", "--workers", "2", "--scheduler", "tcp://there:8786"),
        ("run", "beam.yaml", "--scheduler", "there"),
        ("rerun", "runs"),
        ("export", "runs"),
        ("export", "runs", "--format", "xls"),
    ],
)
def test_wrong_usage_is_code_2(study, arguments):
    result = invoke(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert "Usage: fosopt" in result.stderr


def test_a_defect_is_one_line_that_asks_for_a_report(study, solved, monkeypatch):
    monkeypatch.delenv("FOSOPT_DEBUG", raising=False)
    solved(error=KeyError("jitter"))
    result = invoke("run", study)
    assert result.exit_code == 1
    line = result.stderr.splitlines()[-1]
    assert re.fullmatch(
        r"fosopt: KeyError: 'jitter' \(test_cli.py:\d+\): this is a defect, please report .*", line
    )
    assert "Traceback" not in result.stderr
    monkeypatch.setenv("FOSOPT_DEBUG", "1")
    result = invoke("run", study)
    assert (result.exit_code, type(result.exception)) == (1, KeyError)


def test_check_prints_the_problem(study):
    result = invoke("check", study, "--set", "front.points=7")
    assert result.exit_code == 0
    assert "minimize    structural_mass" in result.stdout
    assert "(Pareto front, 7 points)" in result.stdout
    found = json.loads(invoke("check", study, "--json").stdout)
    assert found["variables"][0]["upper"] == 330e-6


def test_schema_is_json_that_knows_the_keys():
    found = json.loads(invoke("schema").stdout)
    assert {"structure", "variables", "objectives"} <= found["properties"].keys()


def test_a_new_study_passes_its_own_check(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "fosopt run study.yaml" in invoke("new").stdout
    assert invoke("check", "study.yaml").exit_code == 0


@pytest.mark.parametrize("form", ["csv", "json", "mat"])
def test_a_run_is_exported_from_its_directory_or_its_record(tmp_path, form):
    header = {name: value for name, value in fake_run().items() if name != "points"}
    with Store.create(tmp_path / RECORD, header) as store:
        store.write_point(0, point("000"))
    for source in (tmp_path, tmp_path / RECORD):
        result = invoke("export", source, "--format", form)
        assert (result.exit_code, result.stdout) == (0, f"wrote {tmp_path / f'front.{form}'}\n")
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "file"
    assert invoke("export", tmp_path, "--format", form, "--out", other).exit_code == 0
    assert other.stat().st_size == (tmp_path / f"front.{form}").stat().st_size


@pytest.mark.parametrize("command", ["run", "resume"])
def test_exit_codes_are_documented(command):
    text = invoke(command, "--help").stdout
    page = (Path(__file__).parents[1] / "docs" / "running.md").read_text(encoding="utf-8")
    for code in (2, *Code):
        assert re.search(rf"^ +{code} +\w", text, re.MULTILINE)
        assert re.search(rf"^\| {code:d} \|", page, re.MULTILINE)


def test_who_computes_is_chosen_on_the_command_line(study, solved):
    calls = solved(*FRONT)
    for arguments, workers in (
        ((), Workers()),
        (("--workers", "3"), Workers(3)),
        (("--scheduler", "tcp://there:8786"), Workers(scheduler="tcp://there:8786")),
    ):
        invoke("run", study, *arguments, "--set", "front.points=7")
        assert calls[-1].workers == workers
        assert (calls[-1].origin.file, calls[-1].origin.assignments) == (Path(study), ["front.points=7"])


def test_a_run_that_the_machine_stops_ends_with_code_5(study, solved):
    solved(*FRONT, error=StoppedError("the disk is full; continue with 'fosopt resume runs/beam'"))
    result = invoke("run", study)
    assert result.exit_code == 5
    assert (
        result.stderr.splitlines()[-1] == "fosopt: the disk is full; continue with 'fosopt resume runs/beam'"
    )


def test_an_interrupted_run_says_how_to_go_on(study, monkeypatch, solved):
    solved(*FRONT)
    monkeypatch.setattr("fosopt.cli.outcome.exit_code", lambda run, stopped: Code.INTERRUPTED)
    result = invoke("run", study)
    assert result.exit_code == 130
    assert result.stdout.splitlines()[-1] == "continue with: fosopt resume runs/beam"


def test_a_long_silence_is_broken_now_and_then(monkeypatch, study):
    monkeypatch.setattr("fosopt.cli.progress._BEAT", 0.05)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with watching(load_study(study)) as watch:
        watch(Progress("start design", 0, 5, None, 0.0))
        watch(Progress("point", 1, 5, point("000"), 1.0))
        end = time.monotonic() + 30
        while "at work" not in sys.stderr.getvalue() and time.monotonic() < end:
            time.sleep(0.01)
        text = sys.stderr.getvalue().splitlines()[2]
    assert text == "[1/5] at work for 0 s; best: structural_mass 9.1 kg, jitter_total 10 urad"


def test_the_pace_leaves_out_what_was_known_before():
    assert remaining(Progress("", 10, 20, None, 60.0, known=4)) == "6 points/min, about 1 min 40 s left"
    assert remaining(Progress("", 4, 20, None, 60.0, known=4)) == ""


def test_the_version_is_printed():
    result = invoke("--version")
    assert result.exit_code == 0
    assert result.stdout.startswith("fosopt")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (59.4, "59 s"), (59.6, "1 min 00 s"), (200, "3 min 20 s"), (7500, "2 h 05 min")],
)
def test_durations_are_for_people(seconds, text):
    assert duration(seconds) == text


# A runner in a process of its own: it waits for the wish to stop, and ignores it where it is told to.
WAITING = """
import sys, time
deaf = "deaf" in sys.argv
sys.path[:0] = sys.argv[2:4]
import fosopt.study.runner
from fake_run import fake_run, point
def run_study(study, out, *, progress, stop, **more):
    print("ready", file=sys.stderr, flush=True)
    deadline = time.monotonic() + 60
    while (deaf or not stop()) and time.monotonic() < deadline:
        time.sleep(0.01)
    return fake_run(point("000"))
fosopt.study.runner.run_study = run_study
from fosopt.cli import main
sys.argv[:] = ["fosopt", "run", sys.argv[1], "--json"]
main()
"""


def started(study: str, *more: str) -> subprocess.Popen[str]:
    here = Path(__file__).parent
    process = subprocess.Popen(
        [sys.executable, "-c", WAITING, study, here, here.parent, *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr.readline() == "ready\n"
    return process


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_says_what_it_found_and_ends_with_code_130(study, number):
    process = started(study)
    process.send_signal(number)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert json.loads(stdout)["interrupted"] is True
    assert stderr.startswith("fosopt: finishing what is at hand")


def test_a_second_interrupt_ends_a_run_that_does_not_listen(study):
    process = started(study, "deaf")
    process.send_signal(signal.SIGINT)
    assert process.stderr.readline().startswith("fosopt: finishing what is at hand")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    # A shell reports death by this signal as 130.
    assert process.returncode == -signal.SIGINT


def test_an_interrupt_outside_a_run_is_code_130(study, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("fosopt.study.load.read_source", interrupted)
    result = invoke("check", study)
    assert result.exit_code == 130
    assert one_line(result) == "interrupted"


@pytest.mark.parametrize("argument", ["schema", "--version"])
def test_python_m_is_the_command_and_a_reader_may_leave_early(argument):
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    environment.pop("PYTHONUNBUFFERED", None)  # what is left in a buffer is the hard part
    process = subprocess.Popen(
        [sys.executable, "-m", "fosopt", argument],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        text=True,
    )
    process.stdout.close()
    stderr = process.stderr.read()
    process.stderr.close()
    assert (process.wait(timeout=60), stderr) == (0, "")


def test_text_goes_to_a_stream_of_another_encoding(study):
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(__file__).parents[1]),
        "PYTHONIOENCODING": "ascii:strict",
    }
    done = subprocess.run(
        [sys.executable, "-m", "fosopt", "check", study], capture_output=True, env=environment, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"first_elastic_frequency ? 4 Hz" in done.stdout


def _drained(descriptor: int) -> str:
    """All that was written to a pseudo-terminal, which hands it over in pieces and a little later."""
    pieces = []
    while select.select([descriptor], [], [], 0.5)[0]:
        pieces.append(os.read(descriptor, 65536))
    return b"".join(pieces).decode()


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_terminal_shows_a_bar_with_the_best_values(study, solved, monkeypatch):
    start = point("start", "evaluated", metrics={"structural_mass": 1.0})  # light, and breaks a constraint
    solved(start, point("000"), point("001", "failed", reason="why"), point("002"))
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    main, side = os.openpty()
    with os.fdopen(side, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        from fosopt.study import runner

        loaded = load_study(study)
        with watching(loaded) as watch:
            runner.run_study(
                loaded, Path("out"), progress=watch, stop=lambda: False, workers=None, origin=None
            )
            time.sleep(0.3)
        shown = _drained(main)
    os.close(main)
    assert "best: structural_mass 9.1 kg, jitter_total 3.33333 urad, 1 failed" in shown
    assert "001 point 001: failed, not verified; why" in shown
    assert "4/4" in shown
    assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")
