"""Studies from file to run directory: everything is there, everything agrees, nothing is lost."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import pairwise
from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_studies import HELD_KEYS, STUDIES, analysis, run_text, single

from fosopt.errors import StudyError
from fosopt.study import load_study, parse_study
from fosopt.study.build import build_problem, start_vector
from fosopt.study.runner import run_study
from fosopt.study.store import Store

SMALL = ("structure.bays=3", "front.points=3")


def by_key(points: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Points by their key."""
    return {point["key"]: point for point in points}


# ---- a front, end to end ----


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """The quickstart on three bays with three points, compared with the sequential habit."""
    out = tmp_path_factory.mktemp("quick") / "run"
    heard = []
    study = load_study(STUDIES / "quickstart.yaml", (*SMALL, "solve.compare=[sequential]"))
    run = run_study(study, out, progress=heard.append)
    return SimpleNamespace(study=study, run=run, out=out, heard=heard)


def test_a_run_leaves_every_file_it_promises(quick):
    keys = ["start", *(f"{k:03d}" for k in range(6))]
    assert sorted(path.name for path in quick.out.iterdir()) == [
        "designs",
        "front.csv",
        "front.json",
        "report.html",
        "run.sqlite",
        "study.yaml",
    ]
    assert sorted(path.stem for path in (quick.out / "designs").iterdir()) == sorted(keys)
    assert [point["key"] for point in quick.run["points"]] == keys
    assert quick.study.name in (quick.out / "report.html").read_text(encoding="utf-8")


def test_every_point_of_the_quickstart_is_optimal_and_verified(quick):
    start, *points = quick.run["points"]
    assert (start["status"], start["verified"], start["strategy"]) == ("evaluated", True, None)
    assert start["label"] == "start design"
    for point in points:
        assert (point["status"], point["verified"], point["reason"]) == ("optimal", True, None)
        assert point["iterations"] > 0
        assert point["seconds"] > 0
        assert point["history"][0][0] == 0
    assert {p["strategy"] for p in points} == {"simultaneous", "sequential"}
    assert all((p["kkt_residual"] is None) == (p["strategy"] == "sequential") for p in points)


def test_the_seconds_of_the_points_add_up_to_less_than_the_run_took(quick):
    spent = [point["seconds"] for point in quick.run["points"]]
    assert all(seconds > 0 for seconds in spent)
    assert sum(spent) < quick.heard[-1].seconds


def test_no_point_of_the_front_is_dominated_but_a_sequential_one_may_be(quick):
    assert not any(p["dominated"] for p in quick.run["points"] if p["strategy"] != "sequential")


def test_the_front_of_the_quickstart_is_monotone(quick):
    front = [p["metrics"] for p in quick.run["points"] if p["strategy"] == "simultaneous"]
    assert all(a["structural_mass"] < b["structural_mass"] for a, b in pairwise(front))
    assert all(a["jitter_total"] > b["jitter_total"] for a, b in pairwise(front))


def test_the_store_the_json_and_what_is_returned_are_the_same(quick):
    with Store.open(quick.out / "run.sqlite") as store:
        assert store.run() == quick.run
    written = json.loads((quick.out / "front.json").read_text(encoding="ascii"))
    bare = [{k: v for k, v in p.items() if k != "detail"} for p in quick.run["points"]]
    assert written == quick.run | {"points": bare}
    assert quick.run["interrupted"] is False


def test_columns_of_the_table_carry_their_units_and_values_in_them(quick):
    with (quick.out / "front.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(quick.run["points"])
    for row, point in zip(rows, quick.run["points"], strict=True):
        metrics, variables = point["metrics"], point["variables"]
        assert float(row["structural_mass_kg"]) == metrics["structural_mass"]
        assert float(row["jitter_total_rad"]) == metrics["jitter_total"]
        hertz = metrics["first_elastic_frequency"] / (2 * pi)
        assert float(row["first_elastic_frequency_hz"]) == pytest.approx(hertz, rel=1e-14)
        assert float(row["area_longeron_m2"]) == variables["area"][0]
        assert float(row["area_diagonal_m2"]) == variables["area"][1]
        assert float(row["crossover_hz"]) == pytest.approx(variables["crossover"][0] / (2 * pi), rel=1e-14)
        assert row["key"] == point["key"]


@pytest.mark.parametrize("key", ["start", "000", "001", "004"])
def test_a_design_run_again_has_the_same_metrics_to_the_last_bit(quick, tmp_path, key):
    file = quick.out / "designs" / f"{key}.yaml"
    assert file.read_text(encoding="utf-8").startswith(f"# study {quick.run['provenance']['study']}; ")
    study = load_study(file)
    assert study.kind == "analysis"
    (again,) = run_study(study, tmp_path / "again")["points"]
    point = by_key(quick.run["points"])[key]
    assert again["variables"] == point["variables"]
    own = {name: value for name, value in again["metrics"].items()}
    assert own == {name: point["metrics"][name] for name in own}
    assert again["spectral_abscissa"] == point["spectral_abscissa"]


def test_the_resolved_study_runs_to_the_same_front(quick, tmp_path):
    study = load_study(quick.out / "study.yaml", ("solve.compare=[]", "front.points=2"))
    again = run_study(study, tmp_path / "again")["points"]
    assert again[1]["variables"] == by_key(quick.run["points"])["000"]["variables"]


def test_progress_tells_every_point_once_and_counts_them_all(quick):
    finished = [p for p in quick.heard if p.point is not None]
    assert [p.point["key"] for p in finished] == [p["key"] for p in quick.run["points"]]
    assert [p.done for p in finished] == list(range(1, 8))
    assert {p.total for p in quick.heard} == {7}
    assert quick.heard[-1].stage == "writing files"
    assert all(a.seconds <= b.seconds for a, b in pairwise(quick.heard))


def test_the_comparison_puts_the_strategies_side_by_side_at_the_same_limit(quick):
    rows = quick.run["comparison"]
    assert quick.run["comparison_objective"] == "jitter_total"
    assert len(rows) == 3
    points = by_key(quick.run["points"])
    for row, (own, other) in zip(rows, (("000", "001"), ("002", "003"), ("004", "005")), strict=True):
        limit = next(c for c in points[own]["constraints"] if c["name"] == "structural_mass")["upper"]
        assert row["at"] == {"structural_mass": limit}
        assert row["simultaneous"] == points[own]["metrics"]["jitter_total"]
        assert row["sequential"] == points[other]["metrics"]["jitter_total"]
        assert row["simultaneous"] <= row["sequential"] * (1 + 1e-6)


def test_parents_of_the_front_are_keys_of_the_run(quick):
    assert {p["key"]: p["parent"] for p in quick.run["points"]} == {
        "start": None,
        "000": None,
        "001": None,
        "002": "000",
        "003": None,
        "004": None,
        "005": None,
    }


def test_an_active_limit_states_its_price_in_the_units_shown(quick):
    point = by_key(quick.run["points"])["002"]
    mass = next(c for c in point["constraints"] if c["name"] == "structural_mass")
    assert mass["active"]
    assert mass["multiplier"] < 0
    assert mass["statement"] == f"1 kg more saves {-mass['multiplier'] * 1e6:.3g} urad"


def test_the_header_says_where_the_numbers_come_from(quick):
    assert quick.run["provenance"].keys() >= {"study", "fosopt", "casadi", "numpy", "python", "seed"}
    assert quick.run["objectives"] == ["structural_mass", "jitter_total"]
    assert quick.run["labels"] == {"area": ["longeron", "diagonal"]}
    shown = quick.run["quantities"]["first_elastic_frequency"]
    assert (shown["unit"], shown["column"]) == ("Hz", "first_elastic_frequency_hz")
    assert shown["factor"] == pytest.approx(1 / (2 * pi))


def test_the_detail_of_a_point_agrees_with_its_metrics(quick):
    for point in quick.run["points"]:
        detail, metrics = point["detail"], point["metrics"]
        assert sum(v**2 for v in detail["jitter"].values()) == pytest.approx(
            metrics["jitter_total"] ** 2, rel=1e-12, abs=0
        )
        assert detail["cumulative"]["total"][-1] == pytest.approx(metrics["jitter_total"], rel=1e-5, abs=0)
        assert max(p[0] for p in detail["poles"]) == pytest.approx(metrics["spectral_abscissa"], rel=1e-5)
        assert 1 / max(detail["bode"]["sensitivity"]) >= metrics["modulus_margin"] * (1 - 1e-6)
        assert len(detail["bode"]["frequency_hz"]) <= 700, "curves are thinned"
        assert len(detail["truss"]["areas"]) == 9
        assert set(detail["truss"]["areas"]) == set(point["variables"]["area"])


def test_curves_of_the_detail_are_over_hertz(quick, tmp_path):
    study = load_study(quick.out / "designs" / "002.yaml")
    (point,) = run_study(study, tmp_path / "again")["points"]
    detail = point["detail"]
    bode = detail["bode"]
    at_crossover = np.interp(
        point["metrics"]["loop_crossover"] / (2 * pi), bode["frequency_hz"], bode["loop_magnitude"]
    )
    # Between points of the curve the magnitude is a chord.
    assert at_crossover == pytest.approx(1.0, rel=0.02)
    # The jitter below a frequency is that of a band up to it.
    problem = build_problem(study)
    noise = problem.system.disturbances[1]
    banded = replace(noise, band=(0.0, 2 * pi * 50))
    below = replace(problem, system=replace(problem.system, disturbances=(banded,)))
    cumulative = detail["cumulative"]
    at_fifty = np.interp(50, cumulative["frequency_hz"], cumulative["noise"])
    exact = below.evaluate(start_vector(study, problem)).value("jitter_noise")
    # A trapezoid rule for a picture.
    assert at_fifty / exact == pytest.approx(1, rel=0.03)
    assert cumulative["noise"] == sorted(cumulative["noise"])
    assert cumulative["noise"][-1] / detail["jitter"]["noise"] == pytest.approx(1, rel=1e-5)


def test_the_step_of_the_detail_ends_at_the_command(tmp_path):
    text = analysis() + "\nstep:\n  command: 3 urad\n  window: [50 ms, 4 s]\n"
    (point,) = run_text(text, tmp_path)["points"]
    step = point["detail"]["step"]
    assert (step["command"], step["window"]) == (pytest.approx(3e-6, abs=0), [0.05, 4.0])
    assert (step["time_s"][0], step["response"][0], step["time_s"][-1]) == (0.0, 0.0, 4.0)
    assert step["response"][-1] / 3e-6 == pytest.approx(1, rel=1e-2)


# ---- side files, interruptions, directories ----

PSD = "frequency_hz,psd_N m^2/Hz\n0.5,10\n10,20\n200,0.01\n"
DAMPING = "frequency_hz,damping_ratio\n1,0.001\n500,0.004\n"


@pytest.fixture
def with_side_files(tmp_path):
    base = tmp_path / "inputs of mine"
    base.mkdir()
    (base / "torque.csv").write_text(PSD)
    (base / "damping.csv").write_text(DAMPING)
    return base, analysis(
        ("filter: {type: low_pass, corner: 10 Hz, order: 2, rms: 150 N m}", "psd: torque.csv"),
        ("uniform: 0.2 %", "table: damping.csv"),
    )


def test_a_run_stands_alone_without_the_files_it_was_made_from(with_side_files, tmp_path):
    base, text = with_side_files
    first = run_study(parse_study(text, base), tmp_path / "out")["points"][0]
    for path in base.iterdir():
        path.unlink()
    moved = (tmp_path / "out").rename(tmp_path / "elsewhere")
    for name in ("study.yaml", "designs/000.yaml"):
        study = load_study(moved / name)
        (again,) = run_study(study, tmp_path / Path(name).stem)["points"]
        assert again["metrics"] == first["metrics"]
    assert {path.read_text() for path in (moved / "inputs").iterdir()} == {PSD, DAMPING}


def test_a_psd_table_is_integrated_and_judged(with_side_files, tmp_path):
    base, text = with_side_files
    (point,) = run_study(parse_study(text, base), tmp_path / "out")["points"]
    assert (point["status"], point["verified"]) == ("evaluated", True)
    # The judge takes the dynamic stiffness, the run modal residues; both on the same nodes.
    assert 0 <= point["jitter_disagreement"] < 1e-8
    assert point["metrics"]["jitter_aft_body"] > 0


def test_the_provenance_changes_with_a_side_file(with_side_files, tmp_path):
    base, text = with_side_files
    marks = []
    for k, rows in enumerate((PSD, PSD.replace("20\n", "21\n"))):
        (base / "torque.csv").write_text(rows)
        run = run_study(parse_study(text, base), tmp_path / f"out{k}")
        marks.append(run["provenance"]["study"])
    assert marks[0] != marks[1]


def test_an_interrupted_run_keeps_its_finished_points(tmp_path):
    study = load_study(STUDIES / "quickstart.yaml", ("structure.bays=3", "front.points=8"))
    heard = []
    run = run_study(
        study,
        tmp_path / "out",
        progress=lambda p: heard.append(p.point),
        stop=lambda: sum(p is not None for p in heard) >= 3,
    )
    assert [p["key"] for p in run["points"]] == ["start", "000", "001"]
    assert run["interrupted"] is True
    assert all(p["verified"] for p in run["points"])
    with Store.open(tmp_path / "out" / "run.sqlite") as store:
        assert store.run() == run
    assert {path.stem for path in (tmp_path / "out" / "designs").iterdir()} == {"start", "000", "001"}
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_solve_stopped_half_way_is_a_point_that_says_so(tmp_path):
    asked = iter(range(10**6))
    done = run_text(
        single("jitter_total", "  - {metric: structural_mass, upper: 20}\n"),
        tmp_path,
        stop=lambda: next(asked) > 6,
    )
    start, point = done["points"]
    assert start["status"] == "evaluated"
    assert (point["status"], point["verified"]) == ("interrupted", False)
    assert point["reason"] == "stopped by the user"
    assert point["metrics"]["jitter_total"] > 0, "it is stable, so it has its numbers"


def test_every_point_is_on_disk_as_soon_as_it_is_finished(tmp_path):
    study = load_study(STUDIES / "quickstart.yaml", SMALL)
    seen = []

    def look(progress):
        if progress.point is not None:
            with Store.open(tmp_path / "out" / "run.sqlite") as store:
                seen.append(len(store.run()["points"]))

    run_study(study, tmp_path / "out", progress=look)
    assert seen == [1, 2, 3, 4]


@pytest.mark.parametrize("kind", ["directory", "file"])
def test_a_place_that_is_taken_is_refused_and_left_as_it_was(tmp_path, kind):
    out = tmp_path / "out"
    if kind == "directory":
        out.mkdir()
        (out / "mine.txt").write_text("mine")
    else:
        out.write_text("mine")
    with pytest.raises(StudyError, match="is not an empty directory; choose another with --out"):
        run_study(parse_study(analysis()), out)
    left = [path.name for path in out.iterdir()] if kind == "directory" else out.read_text()
    assert left == (["mine.txt"] if kind == "directory" else "mine")


def test_an_empty_directory_is_taken(tmp_path):
    (tmp_path / "out").mkdir()
    assert run_study(parse_study(analysis()), tmp_path / "out")["points"][0]["verified"]


def test_a_study_that_poses_no_problem_makes_no_directory(tmp_path):
    with pytest.raises(StudyError):
        run_study(parse_study(analysis(("type: held", "type: fixed"), *HELD_KEYS)), tmp_path / "out")
    assert not (tmp_path / "out").exists()
