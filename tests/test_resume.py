"""Runs that are cut short in every way go on and end as if nothing had happened."""

from __future__ import annotations

import itertools
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_studies import STUDIES, analysis, edited, section
from typer.testing import CliRunner

from fosopt.cli.commands import app
from fosopt.errors import FosoptError, StudyError
from fosopt.study import TEMPLATE, load_study, parse_study
from fosopt.study.difference import difference, hypervolume
from fosopt.study.lock import is_written, only_writer
from fosopt.study.rerun import rerun_point
from fosopt.study.resume import Origin
from fosopt.study.runner import Workers, resume_run, run_study
from fosopt.study.status import status_of
from fosopt.study.store import RECORD, Store, StoreError

SMALL = ("structure.bays=2", "front.points=10")
SWEEP = """\
sweep:
  axes:
    - quantity: damping_ratio
      list: [0.1 %, 1 %]
    - quantity: mirror_inertia_ratio
      log: {from: 0.02 %, to: 20 %, points: 250}
  outputs: [stable, jitter_total, "natural_frequency[1]", one_minus_separation]
"""


def study(*changes: str):
    """The quickstart on two bays, with two chains of points."""
    return load_study(STUDIES / "quickstart.yaml", (*SMALL, *changes))


def sweep():
    """Loops at two structures, in blocks of 64 points and some left over."""
    text = analysis((section(TEMPLATE, "constraints"), ""), bays=2)
    return parse_study(text.replace("kind: analysis", "kind: sweep") + "\n" + SWEEP)


def numbers(run: dict[str, Any]) -> list[dict[str, Any]]:
    """All that the points of a run say but how long they took."""
    return [{name: value for name, value in point.items() if name != "seconds"} for point in run["points"]]


def recorded(out: Path) -> dict[str, Any]:
    """The run data of a record."""
    with Store.open(out / RECORD) as store:
        return store.run()


def after(count: int):
    """A wish to stop once some points are done, and what hears of them."""
    heard: list[Any] = []
    return SimpleNamespace(
        heard=heard,
        progress=heard.append,
        stop=lambda: sum(p.point is not None for p in heard) >= count,
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run in one go."""
    out = tmp_path_factory.mktemp("whole") / "run"
    return SimpleNamespace(out=out, run=run_study(study(), out))


@pytest.fixture(scope="module")
def once_cut(tmp_path_factory):
    """A run that was interrupted after four points."""
    watch, out = after(4), tmp_path_factory.mktemp("cut") / "run"
    run = run_study(study(), out, progress=watch.progress, stop=watch.stop)
    assert run["interrupted"]
    assert len(run["points"]) == 4
    return out


@pytest.fixture
def cut(once_cut, tmp_path):
    """A copy of it."""
    return shutil.copytree(once_cut, tmp_path / "run")


def invoke(*arguments: object):
    return CliRunner().invoke(app, [str(each) for each in arguments], prog_name="fosopt")


# ---- going on ----


def test_a_resumed_run_is_the_run_in_one_go_to_the_last_bit(whole, cut):
    watch = after(10**6)
    run = resume_run(cut, progress=watch.progress)
    assert numbers(run) == numbers(whole.run)
    assert {name: run[name] for name in ("comparison", "interrupted", "objectives")} == {
        name: whole.run[name] for name in ("comparison", "interrupted", "objectives")
    }
    done_again = [p.point["key"] for p in watch.heard if p.point is not None]
    assert done_again == [f"{k:03d}" for k in range(3, 10)]
    assert {p.known for p in watch.heard} == {4}
    assert sorted(p.name for p in cut.iterdir()) == sorted(p.name for p in whole.out.iterdir())


def test_a_run_may_be_cut_again_and_again(whole, cut):
    done = 4
    while done < 11:
        watch = after(3)
        run = resume_run(cut, progress=watch.progress, stop=watch.stop)
        assert len(run["points"]) > done
        done = len(run["points"])
    assert numbers(run) == numbers(whole.run)
    with Store.open(cut / RECORD) as store:
        assert [s["end"] for s in store.sessions()] == [*["interrupted"] * 3, "finished"]


def test_a_point_that_was_interrupted_is_done_again(whole, cut):
    watch, asked = after(1), itertools.count()
    # Some iterations into the point after the next.
    run = resume_run(cut, progress=watch.progress, stop=lambda: watch.stop() and next(asked) > 5)
    assert [p["status"] for p in run["points"]].count("interrupted") == 1
    assert status_of(cut / RECORD)["state"] == "interrupted"
    assert numbers(resume_run(cut)) == numbers(whole.run)


def test_a_complete_run_that_is_resumed_gets_its_files_anew(whole, tmp_path):
    out = tmp_path / "copy"
    shutil.copytree(whole.out, out)
    (out / "front.csv").unlink()
    watch = after(1)
    assert numbers(resume_run(out / RECORD, progress=watch.progress)) == numbers(whole.run)
    assert not any(p.point for p in watch.heard)
    assert (out / "front.csv").read_bytes() == (whole.out / "front.csv").read_bytes()


def test_cases_are_resumed_too(tmp_path):
    text = (STUDIES / "root-table.yaml").read_text(encoding="utf-8")
    watch = after(1)
    loaded = parse_study(text, STUDIES)
    run_study(loaded, tmp_path / "cut", progress=watch.progress, stop=watch.stop)
    assert numbers(resume_run(tmp_path / "cut")) == numbers(run_study(loaded, tmp_path / "whole"))


def test_identities_are_unique_to_study_and_coordinates(whole, tmp_path):
    with Store.open(whole.out / RECORD) as store:
        own = {row[0] for row in store._connection.execute("SELECT identity FROM answers")}
    assert len(own) == 13, "ten points and three ends of the front"
    run_study(study("solve.seed=2", "front.points=2"), tmp_path / "other")
    with Store.open(tmp_path / "other" / RECORD) as store:
        other = {row[0] for row in store._connection.execute("SELECT identity FROM answers")}
    assert own.isdisjoint(other)


# ---- killed ----

COMMAND = [sys.executable, "-m", "fosopt"]
HERE = str(Path(__file__).parents[1])
ENVIRONMENT = {**os.environ, "PYTHONPATH": HERE}
SETS = [word for each in SMALL for word in ("--set", each)]


def begun(out: Path, *more: str, **options: Any) -> subprocess.Popen[str]:
    """A run in a process of its own."""
    command = [*COMMAND, "run", str(STUDIES / "quickstart.yaml"), *SETS, "--out", str(out), *more]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
        **options,
    )


def test_a_run_killed_at_random_moments_loses_nothing_and_repeats_nothing(whole, tmp_path):
    out, luck, kept = tmp_path / "run", random.Random(6), {}
    process = begun(out)
    for _ in range(2):
        # Not before there is a new point, so that the test comes to an end on a slow machine.
        count = len(kept)
        while process.poll() is None and len(kept) <= count:
            time.sleep(0.02)
            if (out / RECORD).exists():
                kept |= {p["key"]: p for p in recorded(out)["points"]}
        time.sleep(luck.uniform(0, 0.3))
        process.kill()
        process.communicate()
        with Store.open(out / RECORD) as store:
            assert store._connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            now = {p["key"]: p for p in store.run()["points"]}
        assert {key: now[key] for key in kept} == kept, "what was there is there, with the seconds it took"
        kept = now
        process = subprocess.Popen(
            [*COMMAND, "resume", str(out)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT
        )
    process.communicate()
    run = recorded(out)
    assert numbers(run) == numbers(whole.run)
    assert {p["key"]: p["seconds"] for p in run["points"] if p["key"] in kept} == {
        key: p["seconds"] for key, p in kept.items()
    }


def test_ctrl_c_says_how_to_go_on(tmp_path):
    out = tmp_path / "run"
    process = begun(out)
    while not process.stderr.readline().startswith("[2/"):
        pass
    process.send_signal(signal.SIGINT)
    stdout, _ = process.communicate()
    assert process.returncode == 130
    assert stdout.splitlines()[-1] == f"continue with: fosopt resume {out}"


# ---- what a machine does to runs ----


def test_a_full_disk_stops_the_run_and_what_was_written_goes_on(whole, tmp_path):
    out = tmp_path / "run"

    def small() -> None:
        # No file may grow further than the record does at its third point or so.
        resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, resource.RLIM_INFINITY))

    process = begun(out, preexec_fn=small)
    _, stderr = process.communicate()
    assert process.returncode == 5
    last = stderr.splitlines()[-1]
    assert last.startswith("fosopt: ")
    assert "continue with 'fosopt resume" in last
    assert "Traceback" not in stderr
    kept = numbers(recorded(out))
    assert 0 < len(kept) < 11
    assert numbers(resume_run(out)) == numbers(whole.run)


@contextmanager
def nobody():
    """Be a user to whom permissions apply, which root is not."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def open_place():
    """A directory that every user may enter."""
    folder = Path(tempfile.mkdtemp(prefix="fosopt-test-"))
    folder.chmod(0o755)
    yield folder
    for path in folder.rglob("*"):
        path.chmod(0o755)
    shutil.rmtree(folder)


def test_a_directory_that_cannot_be_written_is_refused_before_anything_is_computed(open_place):
    heard = []
    open_place.chmod(0o555)
    with nobody(), pytest.raises(StudyError, match=r"cannot be written: Permission denied; choose another"):
        run_study(study(), open_place / "run", progress=heard.append)
    assert not heard
    assert not list(open_place.iterdir())


def test_a_run_in_a_directory_that_cannot_be_written_is_read_and_not_continued(cut, open_place):
    out = open_place / "run"
    shutil.copytree(cut, out)
    for path in (*out.rglob("*"), out):
        path.chmod(0o555 if path.is_dir() else 0o444)
    with nobody():
        assert status_of(out / RECORD)["state"] == "interrupted"
        assert len(recorded(out)["points"]) == 4
        with pytest.raises(FosoptError, match=r"cannot be written: Permission denied"):
            resume_run(out)
    assert len(recorded(out)["points"]) == 4


def test_a_second_run_in_a_directory_is_refused_while_the_first_goes_on(cut):
    with only_writer(cut):
        assert is_written(cut)
        assert status_of(cut / RECORD)["state"] == "running"
        with pytest.raises(StudyError, match=r"another run writes to '.*'; wait for it"):
            resume_run(cut)
    assert not is_written(cut)
    assert status_of(cut / RECORD)["state"] == "interrupted"


def test_a_run_does_not_begin_where_another_has_just_begun(tmp_path):
    (tmp_path / "run").mkdir()
    with only_writer(tmp_path / "run"), pytest.raises(StudyError, match="another run writes to"):
        run_study(study(), tmp_path / "run")
    assert not list((tmp_path / "run").iterdir())


def test_a_clock_that_jumps_back_changes_nothing(whole, cut, monkeypatch):
    now = itertools.count(1e9, -86400)
    monkeypatch.setattr(time, "time", lambda: next(now))
    watch = after(10**6)
    run = resume_run(cut, progress=watch.progress)
    assert numbers(run) == numbers(whole.run)
    assert all(p.seconds >= 0 for p in watch.heard)
    status = status_of(cut / RECORD)
    assert status["rate"] > 0
    assert all(session["seconds"] >= 0 for session in status["sessions"])


# ---- a study that has changed ----


@pytest.fixture
def from_file(tmp_path):
    """An interrupted run of a study file with a side file, and the two files."""
    (tmp_path / "torque.csv").write_text("frequency_hz,psd_N m^2/Hz\n0.5,10\n10,20\n200,0.01\n")
    text = (STUDIES / "quickstart.yaml").read_text(encoding="utf-8")
    text = text.replace("filter: {type: low_pass, corner: 10 Hz, order: 2, rms: 150 N m}", "psd: torque.csv")
    file = tmp_path / "study.yaml"
    file.write_text(text, encoding="utf-8")
    watch, out = after(2), tmp_path / "run"
    loaded = load_study(file, SMALL)
    origin = Origin(file, SMALL)
    run_study(loaded, out, progress=watch.progress, stop=watch.stop, origin=origin)
    return SimpleNamespace(file=file, side=tmp_path / "torque.csv", out=out)


@pytest.mark.parametrize(
    ("where", "old", "new", "message"),
    [
        ("file", "lower: 4 Hz", "lower: 5 Hz", "constraints.0.lower is 31.4159265"),
        ("file", "kp: 600", "kp: 600\n  unknown: 1", "unknown key"),
        ("side", "10,20", "10,21", "a side file has another content (torque.csv)"),
        ("out/study.yaml", "seed: 1", "seed: 2", "solve.seed is 2, was 1"),
        ("out/inputs/0-torque.csv", "10,20", "10,21", "it has another content"),
    ],
)
def test_a_study_edited_between_run_and_resume_is_refused_with_what_differs(
    from_file, where, old, new, message
):
    file, *rest = where.split("/", 1)
    path = getattr(from_file, file) / rest[0] if rest else getattr(from_file, file)
    before = recorded(from_file.out)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(StudyError, match="has changed since") as caught:
        resume_run(from_file.out)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert recorded(from_file.out) == before
    path.write_text(text, encoding="utf-8")
    watch = after(1)
    assert len(resume_run(from_file.out, progress=watch.progress, stop=watch.stop)["points"]) == 3


def test_a_run_needs_neither_its_study_file_nor_the_copies_of_it(from_file):
    from_file.file.unlink()
    from_file.side.unlink()
    (from_file.out / "study.yaml").unlink()
    shutil.rmtree(from_file.out / "inputs")
    run = resume_run(from_file.out)
    assert [p["verified"] for p in run["points"]] == [True] * 11
    assert (from_file.out / "inputs" / "0-torque.csv").is_file()


def test_what_is_no_run_is_not_resumed(tmp_path):
    with pytest.raises(StoreError, match="no such file; give the directory of a run"):
        resume_run(tmp_path)
    Store.create(tmp_path / RECORD, {"kind": "codesign", "name": "x"}).close()
    with pytest.raises(StudyError, match="keeps no study"):
        resume_run(tmp_path)


# ---- sweeps ----


@pytest.fixture(scope="module")
def whole_sweep(tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep") / "run"
    run_study(sweep(), out)
    return out


def arrays(out: Path) -> dict[str, np.ndarray]:
    """All arrays of a sweep."""
    return {path.name: np.load(path) for path in sorted((out / "arrays").iterdir())}


def test_a_sweep_that_is_cut_and_resumed_with_workers_is_the_sweep_in_one_go(
    whole_sweep, tmp_path, monkeypatch
):
    # Other pieces than those of the whole sweep, and some for each worker.
    monkeypatch.setattr("fosopt.study.sweep._HERE", 1)
    monkeypatch.setattr("fosopt.study.sweep._THERE", 2)
    out, heard = tmp_path / "run", []
    run = run_study(sweep(), out, progress=heard.append, stop=lambda: heard[-1].done > 64)
    assert run["interrupted"]
    assert run["finished"] == 128
    assert all(values.shape[0] == run["finished"] for values in arrays(out).values())
    resumed = resume_run(out, workers=Workers(2))
    assert (resumed["finished"], resumed["interrupted"]) == (500, False)
    found, expected = arrays(out), arrays(whole_sweep)
    assert found.keys() == expected.keys()
    assert all(np.array_equal(found[name], expected[name], equal_nan=True) for name in expected)
    assert (out / "points.csv").read_bytes() == (whole_sweep / "points.csv").read_bytes()
    assert status_of(out / RECORD)["state"] == "finished"
    summary = json.loads((out / "sweep.json").read_text())
    own = json.loads((whole_sweep / "sweep.json").read_text())
    assert {k: summary[k] for k in ("unstable", "failed", "count")} == {
        k: own[k] for k in ("unstable", "failed", "count")
    }


def test_points_that_are_missing_between_others_have_no_values(whole_sweep, tmp_path, monkeypatch):
    monkeypatch.setattr("fosopt.study.sweep._HERE", 1)
    out = tmp_path / "run"
    heard = []
    run_study(sweep(), out, progress=heard.append, stop=lambda: heard[-1].done > 64)
    with Store.resume(out / RECORD) as store:
        first, second = store.blocks()[:2]
        store._execute("DELETE FROM blocks WHERE first = ?", first.first)
    run = resume_run(out, stop=lambda: True)
    assert run["finished"] == second.last - second.first
    found, expected = arrays(out), arrays(whole_sweep)
    assert np.isnan(found["jitter_total.npy"][: first.last]).all()
    for name in ("jitter_total.npy", "damping_ratio.npy"):
        np.testing.assert_array_equal(
            found[name][first.last : second.last], expected[name][first.last : second.last]
        )
    np.testing.assert_array_equal(
        found["damping_ratio.npy"][: first.last], expected["damping_ratio.npy"][: first.last]
    )


# ---- a point again, and two runs beside each other ----


@pytest.mark.parametrize("key", ["start", "000", "002", "008", "009"])
def test_a_point_computed_again_has_the_same_numbers(whole, key):
    found = rerun_point(whole.out / RECORD, key, lambda: False)
    assert found["differs"] == {}
    assert found["point"]["key"] == key


def test_a_sweep_that_reads_a_side_file_is_the_same_with_workers_and_again(tmp_path, monkeypatch):
    text = analysis((section(TEMPLATE, "constraints"), ""), bays=2).replace("kind: analysis", "kind: sweep")
    text = text.replace(section(text, "damping"), "damping:\n  table: damp.csv\n")
    (tmp_path / "damp.csv").write_text("frequency_hz,damping_ratio\n1,0.002\n1000,0.01\n")
    axis = "    - quantity: mirror_mass\n      list: [200 kg, 250 kg, 300 kg]\n"
    text += f"\nsweep:\n  axes:\n{axis}  outputs: [stable, jitter_total]\n"
    found = parse_study(text, tmp_path)
    monkeypatch.setattr("fosopt.study.sweep._THERE", 1)
    run_study(found, tmp_path / "here")
    run_study(found, tmp_path / "there", workers=Workers(1))
    here, there = ((tmp_path / folder / "points.csv").read_text() for folder in ("here", "there"))
    # Of where they came from they tell who computed.
    assert here.count("options serial\n") == 1
    assert here.replace("options serial\n", "options 1 worker\n") == there
    assert rerun_point(tmp_path / "here" / RECORD, "2", lambda: False)["differs"] == {}


def test_a_point_of_a_sweep_computed_again_has_the_same_numbers(whole_sweep):
    found = rerun_point(whole_sweep / RECORD, "301", lambda: False)
    assert found["differs"] == {}
    assert found["point"]["metrics"]["natural_frequency[1]"] > 0
    with pytest.raises(StudyError, match=r"no point '500'; give a number from 0 to 499"):
        rerun_point(whole_sweep / RECORD, "500", lambda: False)


def test_the_command_repeats_a_point_and_says_what_is_not_the_same(whole, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(whole.out, out)
    result = invoke("rerun", out, "--point", "001")
    assert result.exit_code == 0
    assert result.stdout.splitlines()[-1] == "all numbers are the recorded ones to the last bit"
    assert "iteration" in result.stdout
    with Store.resume(out / RECORD) as store:
        point = store.run()["points"][2]
        point["metrics"]["jitter_total"] *= 1 + 2**-52
        store.mark("001", point)
    result = invoke("rerun", out, "--point", "001")
    assert result.exit_code == 4
    assert "1 numbers are not the recorded ones" in result.stdout
    assert "  metrics.jitter_total: " in result.stdout
    result = invoke("rerun", out, "--point", "01")
    assert (result.exit_code, "did you mean '001'?" in result.stderr) == (3, True)


def test_a_bound_whose_time_was_up_is_said_to_depend_on_the_machine(tmp_path):
    cut = [(section(TEMPLATE, name), "") for name in ("objectives", "front", "constraints")]
    text = edited(("kind: codesign", "kind: analysis"), *cut, bays=2)
    out = tmp_path / "run"
    run_study(parse_study(text + "\ncertificates:\n  pid: {time_limit: 0.01 s, gap: 0.01 %}\n"), out)
    with Store.resume(out / RECORD) as store:
        (point,) = store.run()["points"]
        named = {entry["name"]: entry for entry in point["bounds"]}
        assert named["jitter_bound_pid"]["hurried"] and not named["jitter_bound_any"]["hurried"]
        named["jitter_bound_pid"]["value"] *= 0.999
        store.mark("000", point)
    found = rerun_point(out / RECORD, "000", lambda: False)
    assert found["differs"] == {}
    assert any(path.endswith(".value") for path in found["hurried"])
    result = invoke("rerun", out, "--point", "000")
    assert result.exit_code == 0
    assert "its time limit was reached, which depends on the machine" in result.stdout
    with Store.resume(out / RECORD) as store:
        named["jitter_bound_any"]["value"] *= 0.999
        store.mark("000", point)
    found = rerun_point(out / RECORD, "000", lambda: False)
    assert {path.partition(".")[2].partition(".")[2] for path in found["differs"]} == {"value"}


def test_a_run_does_not_differ_from_itself_and_gains_what_a_finer_front_has(whole, cut):
    same = difference(whole.out / RECORD, whole.out / RECORD)
    assert (same["gained"], same["lost"]) == ({}, {})
    assert same["hypervolume"][0] == same["hypervolume"][1] > 0
    other = difference(cut / RECORD, whole.out / RECORD)
    assert other["gained"].keys() == {f"{k:03d}" for k in range(3, 10)}
    assert other["lost"] == {}
    assert other["hypervolume"][1] > other["hypervolume"][0]
    result = invoke("diff", cut, whole.out)
    assert (result.exit_code, "7 points gained" in result.stdout) == (4, True)
    assert invoke("diff", whole.out, whole.out, "--json").exit_code == 0


def test_the_hypervolume_of_a_staircase_is_its_area():
    # Three steps below (4, 4), a dominated point and one beyond the reference.
    assert hypervolume([(1.0, 3.0), (2.0, 2.0), (3.0, 1.0), (3.0, 2.5), (5.0, 0.0)], (4.0, 4.0)) == 6.0


def test_runs_with_other_objectives_are_not_compared(whole, whole_sweep):
    with pytest.raises(StudyError, match="compare two runs that minimize the same"):
        difference(whole.out / RECORD, whole_sweep / RECORD)


def test_status_says_how_far_a_run_has_come_and_how_to_go_on(whole, cut):
    result = invoke("status", whole.out)
    assert (result.exit_code, "finished: 11 of 11 points" in result.stdout) == (0, True)
    result = invoke("status", cut, "--json")
    found = json.loads(result.stdout)
    assert result.exit_code == 4
    assert (found["state"], found["done"], found["total"], found["failed"]) == ("interrupted", 4, 11, 0)
    assert found["best"]["jitter_total"][1] == "urad"
    assert found["best"]["jitter_total"][0] == pytest.approx(
        1e6 * min(p["metrics"]["jitter_total"] for p in recorded(cut)["points"][1:])
    )
    assert invoke("status", cut).stdout.splitlines()[-1] == f"continue with: fosopt resume {cut}"
    assert invoke("status", cut.parent).exit_code == 3


def test_a_killed_run_says_so(cut):
    with Store.resume(cut / RECORD) as store:
        store.write_session({**store.sessions()[-1], "end": None})
    assert status_of(cut / RECORD)["state"] == "killed"


def test_the_doctor_finds_this_machine_fit(tmp_path):
    result = invoke("doctor", tmp_path)
    assert result.exit_code == 0, result.stdout
    assert not list(tmp_path.iterdir())
    found = {line[5:].split("  ")[0].strip() for line in result.stdout.splitlines()}
    assert {"fosopt", "libraries", "threads", "IPOPT", "Clarabel", "workers", "file system"} <= found


def test_the_doctor_finds_what_is_wrong(monkeypatch, open_place):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    open_place.chmod(0o555)
    with nobody():
        result = invoke("doctor", open_place, "--json")
    assert result.exit_code == 4
    bad = {each["what"]: each["found"] for each in json.loads(result.stdout) if not each["good"]}
    assert bad.keys() == {"threads", "file system"}
    assert "cannot be written: Permission denied" in bad["file system"]


def test_provenance_names_study_program_options_seed_and_threads(whole):
    found = whole.run["provenance"]
    assert found.keys() >= {"study", "revision", "fosopt", "numpy", "options", "seed", "threads", "machine"}
    assert (found["options"], found["threads"], found["seed"]) == ("serial", "1", "1")
    assert whole.run["provenance"] == json.loads((whole.out / "front.json").read_text())["provenance"]
