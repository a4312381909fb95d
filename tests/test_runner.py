"""Studies from file to run directory: everything is there, everything agrees, nothing is lost."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from itertools import pairwise
from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fosopt.errors import StudyError
from fosopt.study import TEMPLATE, load_study, parse_study
from fosopt.study.build import build_problem, start_vector
from fosopt.study.points import comparison, mark_dominated, state_prices
from fosopt.study.runner import run_study
from fosopt.study.store import Store

STUDIES = Path(__file__).resolve().parents[1] / "studies"
SMALL = ("structure.bays=3", "front.points=3")
LOOP_METRICS = ("jitter_total", "jitter_aft_body", "jitter_noise", "modulus_margin", "loop_crossover")


def edited(*changes: tuple[str, str], text: str = TEMPLATE, bays: int = 3) -> str:
    """The quickstart on a short truss with pieces of its text replaced."""
    for old, new in (*changes, ("bays: 20", f"bays: {bays}")):
        if "bays" in old and "bays" not in text:
            continue  # another structure
        assert old in text, f"the template has no {old!r}"
        text = text.replace(old, new)
    return text


def section(text: str, name: str) -> str:
    """A top-level section of a study file, as it is written."""
    lines = text.splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if line.startswith(f"{name}:"))
    last = next((i for i in range(first + 1, len(lines)) if lines[i][0] not in " \n#"), len(lines))
    return "".join(lines[first:last])


def single(objective: str, constraints: str, **changes: str) -> str:
    """The small quickstart with one objective."""
    return edited(
        (section(TEMPLATE, "objectives"), f"objectives:\n  - minimize: {objective}\n"),
        (section(TEMPLATE, "constraints"), f"constraints:\n{constraints}" if constraints else ""),
        (section(TEMPLATE, "front"), ""),
        *changes.items(),
    )


def analysis(*changes: tuple[str, str], bays: int = 3) -> str:
    """The small quickstart as an analysis of its start."""
    cut = tuple((section(TEMPLATE, name), "") for name in ("variables", "objectives", "front"))
    return edited(("kind: codesign", "kind: analysis"), *cut, *changes, bays=bays)


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """Run text as a study in a directory of its own."""

    def of(text: str, **options: Any) -> dict[str, Any]:
        return run_study(parse_study(text, tmp_path), tmp_path / "out", **options)

    return of


def by_key(points: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
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
    study = load_study(quick.out / "designs" / f"{key}.yaml")
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
        assert len(detail["truss"]["areas"]) == 9
        assert set(detail["truss"]["areas"]) == set(point["variables"]["area"])


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


def test_a_solve_stopped_half_way_is_a_point_that_says_so(tmp_path, run):
    asked = iter(range(10**6))
    done = run(
        single("jitter_total", "  - {metric: structural_mass, upper: 20}\n"), stop=lambda: next(asked) > 6
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


HELD_KEYS = (("  bandwidth: 0.1 Hz\n", ""), ("  damping_ratio: 0.7\n", ""))


# ---- what cannot be, and what is unstable ----


def test_an_infeasible_study_names_its_conflict_and_prices_nothing(run):
    constraints = (
        "  - {metric: first_elastic_frequency, lower: 300 Hz}\n  - {metric: structural_mass, upper: 20}\n"
    )
    _, point = run(single("jitter_total", constraints))["points"]
    assert (point["status"], point["verified"]) == ("infeasible", False)
    assert "constraints conflict: " in point["reason"]
    assert all(c["name"] in point["reason"] for c in point["constraints"])
    assert all(c["statement"] is None for c in point["constraints"])


def test_an_infeasible_front_is_one_point(run):
    text = edited(("lower: 4 Hz", "lower: 3 kHz"))
    start, point = run(text)["points"]
    assert start["verified"], "a requirement that the start misses is no doubt about its numbers"
    assert "is violated by" in start["reason"]
    assert (point["key"], point["status"]) == ("000", "infeasible")


UNSTABLE = (
    ("inertia_ratio: 0.2 %", "inertia_ratio: 10 %"),
    ("crossover: 100 Hz", "crossover: 230 Hz"),
    ("uniform: 0.2 %", "uniform: 0.1 %"),
)


@pytest.fixture(scope="module")
def unstable(tmp_path_factory):
    out = tmp_path_factory.mktemp("unstable") / "run"
    text = analysis(*UNSTABLE, bays=20) + "\nstep:\n  command: 1 urad\n  window: [50 ms, 100 ms]\n"
    return run_study(parse_study(text), out), out


def test_an_unstable_analysis_says_so(unstable):
    (point,) = unstable[0]["points"]
    assert (point["key"], point["status"], point["verified"]) == ("000", "unstable", False)
    assert point["reason"].startswith("unstable: a pole has the real part 1.02")
    assert point["metrics"]["spectral_abscissa"] > 0
    assert point["metrics"]["structural_mass"] == pytest.approx(108.3)


def test_an_unstable_design_has_no_jitter_anywhere(unstable):
    run, out = unstable
    for point in (run["points"][0], json.loads((out / "front.json").read_text())["points"][0]):
        for name in (*LOOP_METRICS, "step_offset", "step_rms"):
            assert point["metrics"][name] is None
        assert point["jitter_disagreement"] is None
        assert {c["name"] for c in point["constraints"]} == {"first_elastic_frequency"}
    detail = run["points"][0]["detail"]
    assert detail["jitter"] == {}
    assert detail["cumulative"] is None
    assert detail["step"] is None
    with (out / "front.csv").open(encoding="utf-8", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert not any(value for name, value in row.items() if name.startswith(("jitter", "step", "modulus")))
    assert "urad" not in _visible(out / "report.html")


def _visible(path: Path) -> str:
    """What stands in the data of a report, without its code."""
    text = path.read_text(encoding="utf-8")
    first = text.index('type="application/json"')
    return (
        text[text.index(">", first) : text.index("</script>", first)]
        .replace('"unit": "urad"', "")
        .replace('"unit":"urad"', "")
    )


def test_cases_of_the_unstable_mirror_tell_gains_structure_and_both_apart(tmp_path):
    study = load_study(STUDIES / "unstable-mirror.yaml", ("variables.0.group_by=kind", "solve.starts=1"))
    run = run_study(study, tmp_path / "out")
    start, baseline, gains, structure, both = run["points"]
    assert start["status"] == baseline["status"] == "unstable"
    assert baseline["metrics"]["jitter_total"] is None
    assert [p["case"] for p in run["points"]] == [None, "baseline", "gains alone", "structure alone", "both"]
    assert baseline["variables"] == start["variables"]
    assert gains["variables"]["area"] == start["variables"]["area"]
    assert structure["variables"]["kp"] == start["variables"]["kp"]
    for point in (gains, structure, both):
        assert (point["status"], point["verified"]) == ("optimal", True)
    jitter = [p["metrics"]["jitter_total"] for p in (gains, structure, both)]
    assert jitter[2] < jitter[0] < jitter[1]
    mass = next(c for c in gains["constraints"] if c["name"] == "total_mass")
    assert mass["multiplier"] == 0.0, "gains cannot change the mass"
    assert run["comparison"] == []


# ---- objectives ----


def test_an_expression_of_metrics_can_be_minimized(run):
    constraints = "  - {metric: first_elastic_frequency, lower: 60 Hz}\n"
    text = "structural_mass + 2*mirror_inertia"
    done = run(single(text, constraints))
    start, point = done["points"]
    metrics = point["metrics"]
    assert point["verified"]
    assert metrics[text] == pytest.approx(
        metrics["structural_mass"] + 2 * metrics["mirror_inertia"], rel=1e-14
    )
    assert metrics[text] < start["metrics"][text]
    assert done["objectives"] == [text]
    assert text in done["quantities"]


def test_a_variable_can_be_minimized_and_bounded(run):
    constraints = "  - {metric: jitter_total, upper: 20 urad}\n  - {metric: ki/kp, upper: 200}\n"
    _, point = run(single("crossover", constraints))["points"]
    assert point["verified"], point["reason"]
    bound = {c["name"]: c for c in point["constraints"]}
    assert bound["jitter_total"]["active"]
    # Less jitter needs a faster loop.
    assert bound["jitter_total"]["multiplier"] < 0


def test_many_starts_are_counted(run):
    constraints = "  - {metric: structural_mass, upper: 20}\n"
    text = single("jitter_total", constraints) + "  starts: 2\n  seed: 5\n"
    _, point = run(text)["points"]
    assert point["starts"]["tried"] == 2
    assert 1 <= point["starts"]["agreed"] <= 2


# ---- mistakes that only the physics shows ----

TRUSS = """\
structure:
  type: truss
  nodes: {A: [0, 0], B: [1, 0], C: [0, 1], D: [1, 1]}
  bars:
    - {name: lower, nodes: [A, B], area: 1 cm^2, young: 70 GPa, density: 2700}
    - {name: upper, nodes: [C, D], area: 1 cm^2, young: 70 GPa, density: 2700}
  battens:
    - {name: root, nodes: [A, C], mass: 1, inertia: 0.1}
    - {name: end, nodes: [B, D], mass: 1, inertia: 0.1}
  supports: {root: [x, y, rz]}
  ports: {hub: [root, rz], tip: [end, rz]}
"""


def place_of(text: str) -> tuple[StudyError, str]:
    """The error of building a study, and the line it points at."""
    with pytest.raises(StudyError) as caught:
        build_problem(parse_study(text))
    error = caught.value
    assert error.file == "study.yaml"
    assert error.column >= 1
    assert str(error).startswith(f"study.yaml:{error.line}:{error.column}: ")
    return error, text.splitlines()[error.line - 1]


def test_a_mechanism_points_at_the_structure():
    text = analysis((section(TEMPLATE, "structure"), TRUSS), *HELD_KEYS, ("type: held", "type: fixed"))
    error, line = place_of(text)
    assert error.path == "structure"
    assert "structure is a mechanism: 1 motion(s) without stiffness, the loosest at 'end.y'" in error.message
    assert line == "  type: truss"


def test_an_unbounded_drift_points_at_its_disturbance():
    error, line = place_of(analysis(("type: held", "type: free"), *HELD_KEYS))
    assert error.path == "disturbances.0"
    assert "aft_body" in line
    assert "unbounded drift" in error.message


def test_a_washed_out_torque_on_a_free_hub_runs(run):
    text = analysis(
        ("type: held", "type: free"),
        *HELD_KEYS,
        ("{type: low_pass, corner: 10 Hz, order: 2,", "{type: band_pass, lower: 5 Hz, upper: 50 Hz,"),
    )
    (point,) = run(text)["points"]
    assert point["verified"], point["reason"]
    assert point["jitter_disagreement"] < 1e-8


def test_a_hub_that_contradicts_the_supports_points_at_the_hub():
    error, _ = place_of(analysis(("type: held", "type: fixed"), *HELD_KEYS))
    assert error.path == "hub"
    assert "the supports let the structure rotate" in error.message


AREA = "".join(section(TEMPLATE, "variables").splitlines(keepends=True)[1:3])


@pytest.mark.parametrize(
    ("groups", "path", "message"),
    [
        ("{a: [L*], b: [X*]}", "variables.0.groups.b", "'X*' matches no member; members are named L1a"),
        ("{a: [L*], b: [L1a]}", "variables.0.groups.b", "member 'L1a' belongs to 'a' and 'b'; keep one"),
    ],
)
def test_groups_that_match_nothing_or_overlap_point_at_the_group(groups, path, message):
    grouped = f"  - quantity: area\n    groups: {groups}\n"
    error, line = place_of(edited((AREA, grouped)))
    assert error.path == path
    assert message in error.message
    assert "groups:" in line


def test_two_variables_of_one_member_point_at_the_second():
    second = (
        AREA
        + "    lower: 13 mm^2\n    upper: 330 mm^2\n  - quantity: area\n    name: again\n    kinds: [diagonal]\n"
    )
    error, line = place_of(edited((AREA, second)))
    assert error.path == "variables.1"
    assert "member 'D1' is already set by variable 'area'" in error.message
    assert "quantity: area" in line


def test_named_groups_and_kinds_pick_their_members():
    grouped = "  - quantity: area\n    groups: {root: [L1*, D1], rest: ['L[23]a']}\n"
    problem = build_problem(parse_study(edited((AREA, grouped))))
    area = problem.variables[0]
    names = [bar.name for bar in problem.system.structure.truss.bars]
    assert area.labels == ("root", "rest")
    assert [[names[i] for i in group] for group in area.groups] == [["L1a", "L1b", "D1"], ["L2a", "L3a"]]
    kinds = build_problem(parse_study(edited((AREA, AREA + "    kinds: [diagonal]\n"))))
    assert kinds.variables[0].labels == ("diagonal",)


@pytest.mark.parametrize(
    ("group_by", "labels"),
    [
        ("member", ("L1a", "L1b", "D1", "L2a", "L2b", "D2", "L3a", "L3b", "D3")),
        ("bay", ("bay 1", "bay 2", "bay 3")),
        ("kind", ("longeron", "diagonal")),
        ("all", ("all",)),
    ],
)
def test_areas_group_by_member_bay_kind_or_all(group_by, labels):
    text = edited(("group_by: kind ", f"group_by: {group_by} "))
    if group_by == "all":
        text = text.replace("area[1]", "area")
    area = build_problem(parse_study(text)).variables[0]
    assert area.labels == labels
    assert sorted(i for group in area.groups for i in group) == list(range(9))


def test_a_selection_of_too_many_modes_points_at_the_modes():
    error, line = place_of(analysis() + "\nmodes:\n  count: 100\n")
    assert error.path == "modes"
    assert "choose between 1 and 10" in error.message
    assert line in ("modes:", "  count: 100")


def test_a_wrong_number_of_design_values_points_at_the_design():
    error, _ = place_of(edited() + "\ndesign:\n  area: [50 mm^2, 60 mm^2, 70 mm^2]\n")
    assert error.path == "design"
    assert "'area' has 2 values, 3 were given" in error.message


def test_a_design_is_where_a_study_starts():
    study = parse_study(edited() + "\ndesign:\n  area: [50 mm^2, 60 mm^2]\n  kp: 300\n")
    problem = build_problem(study)
    x = start_vector(study, problem)
    np.testing.assert_allclose(x[:2], [50e-6, 60e-6], rtol=1e-15)
    assert problem.values(x)["kp"].tolist() == [300.0]
    assert problem.values(x)["ki"].tolist() == [50e3]


# ---- the system as written ----


def test_the_mirror_is_what_the_study_says():
    study = parse_study(analysis())
    problem = build_problem(study)
    mirror, of = problem.base.loop.mirror, problem.system.structure
    mass = problem.evaluate(problem.start).value("structural_mass")
    inertia = problem.evaluate(problem.start).value("structure_inertia")
    assert problem.base.mirror_mass / (problem.base.mirror_mass + mass) == pytest.approx(0.7, rel=1e-14)
    assert mirror.inertia / inertia == pytest.approx(0.002, rel=1e-14)
    assert mirror.natural_frequency == pytest.approx(20 * 2 * pi, rel=1e-14)
    assert len(of.truss.bars) == 9
    given = parse_study(
        analysis(
            ("mass_fraction: 0.7", "mass: 12 kg"),
            ("inertia_ratio: 0.2 %", "inertia: 0.5 kg m^2"),
            ("frequency: 20 Hz\n", "stiffness: 800 N m/rad\n"),
        )
    )
    base = build_problem(given).base
    assert base.mirror_mass == 12
    assert base.loop.mirror.inertia == 0.5
    assert base.loop.mirror.natural_frequency == pytest.approx(40.0, rel=1e-14)


def test_a_roll_off_becomes_a_time_constant_and_a_given_gain_is_kept():
    text = analysis(("crossover: 100 Hz", "gain: 12\n  rolloff: 2 kHz"))
    pid = build_problem(parse_study(text)).base.loop.controller
    assert pid.rolloff_time == pytest.approx(1 / (2000 * 2 * pi), rel=1e-14)
    assert pid.gain == 12


@pytest.mark.parametrize(
    ("damping", "expected"),
    [
        ("uniform: 0.5 %", [0.005, 0.005, 0.005]),
        ("per_mode: [0.001, 0.002]", [0.001, 0.002, 0.002]),
        ("table: [[1 Hz, 0.001], [500 Hz, 0.001], [501 Hz, 0.009]]", [0.001, None, None]),
    ],
)
def test_elastic_modes_get_the_damping_of_the_study(damping, expected):
    problem = build_problem(parse_study(analysis(("uniform: 0.2 %", damping))))
    modes = problem.evaluate(problem.start).all_modes
    elastic = modes.damping_ratio[~modes.rigid]
    for found, value in zip(elastic, expected, strict=False):
        if value is not None:
            assert found == pytest.approx(value, rel=1e-12)
    assert modes.damping_ratio[modes.rigid] == pytest.approx([0.7])
    if damping.startswith("table"):
        assert elastic[-1] == pytest.approx(0.009)


@pytest.mark.parametrize(
    ("modes", "kept"), [("count: 4", [0, 1, 2, 3]), ("keep: [1, 3]", [0, 2]), ("below: 100 Hz", None)]
)
def test_the_design_model_keeps_the_modes_of_the_study(modes, kept):
    problem = build_problem(parse_study(analysis() + f"\nmodes:\n  {modes}\n"))
    evaluation = problem.evaluate(problem.start)
    if kept is None:
        kept = np.flatnonzero(evaluation.all_modes.natural_frequency < 100 * 2 * pi).tolist()
    assert evaluation.kept.tolist() == kept


@pytest.mark.parametrize(
    ("shape", "density"),
    [
        ("{type: white, density: 2 N m/sqrt(Hz)}", lambda f: 4.0),
        ("{type: high_pass, corner: 10 Hz, density: 2 N m/sqrt(Hz)}", lambda f: 4 * f**2 / (f**2 + 100)),
        ("{type: rational, numerator: [3], denominator: [1, 5]}", lambda f: 18 / ((2 * pi * f) ** 2 + 25)),
        # One-sided density of a first-order low pass of unit rms: 4 T/(1 + ω² T²), T = 1/(2π f_c).
        (
            "{type: low_pass, corner: 10 Hz, rms: 3 N m}",
            lambda f: 9 * 4 / (2 * pi * 10) / (1 + (f / 10) ** 2),
        ),
    ],
)
def test_a_filter_of_the_study_has_its_spectrum(shape, density):
    text = analysis(("{type: low_pass, corner: 10 Hz, order: 2, rms: 150 N m}", shape))
    disturbance = build_problem(parse_study(text)).system.disturbances[0]
    f = np.array([1.0, 10.0, 70.0])
    np.testing.assert_allclose(disturbance.one_sided_psd(2 * pi * f), density(f), rtol=1e-12)


def test_a_band_pass_and_a_band_reach_the_disturbance():
    text = analysis(
        (
            "{type: low_pass, corner: 10 Hz, order: 2, rms: 150 N m}",
            "{type: band_pass, lower: 5 Hz, upper: 20 Hz, rms: 2 N m}\n    band: [1 Hz, 300 Hz]",
        )
    )
    disturbance = build_problem(parse_study(text)).system.disturbances[0]
    assert disturbance.band == pytest.approx((2 * pi, 600 * pi))
    f = np.linspace(1e-3, 2e4, 4_000_001)
    power = np.trapezoid(disturbance.one_sided_psd(2 * pi * f), f)
    # The tail beyond 20 kHz holds a thousandth of a band 15 Hz wide.
    assert np.sqrt(power) == pytest.approx(2.0, rel=1e-3)


def test_the_truss_on_its_root_table_runs_with_the_frequency_of_the_dissertation(run, dissertation):
    text = analysis(
        ("boundary: pinned ", "boundary: table "),
        ("type: held", "type: fixed"),
        ("mass_fraction: 0.7 ", "mass: 1e-6 kg "),
        *HELD_KEYS,
        bays=20,
    )
    (point,) = run(text)["points"]
    assert (point["status"], point["verified"]) == ("evaluated", True)
    # The springs of the table are fitted to within 0.6 %.
    first = point["metrics"]["first_elastic_frequency"] / (2 * pi)
    assert first == pytest.approx(dissertation["table_2_2"]["fem1"][0], rel=6e-3)


def spatial_study() -> str:
    """A square mast of two bays, by hand."""
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    nodes = {f"N{i}{j}": [0.5 * i, 0.2 * y, 0.2 * z] for i in range(3) for j, (y, z) in enumerate(corners)}
    bars = []
    for i in (1, 2):
        for j in range(4):
            k = (j + 1) % 4
            for kind, a, b in (
                ("longeron", f"N{i - 1}{j}", f"N{i}{j}"),
                ("brace", f"N{i - 1}{j}", f"N{i}{k}"),
                ("brace", f"N{i - 1}{k}", f"N{i}{j}"),
            ):
                bars.append(
                    f"    - {{nodes: [{a}, {b}], area: 1 cm^2, young: 70 GPa, density: 2700, kind: {kind}, bay: {i}}}\n"
                )
    battens = "".join(
        f"    - {{name: B{i}, nodes: [N{i}0, N{i}1, N{i}2, N{i}3], mass: 2, inertia: 0.1}}\n"
        for i in range(3)
    )
    structure = (
        "structure:\n  type: truss\n  nodes: "
        + json.dumps(nodes).replace('"', "")
        + "\n  bars:\n"
        + "".join(bars)
        + "  battens:\n"
        + battens
        + "  supports: {B0: [x, y, z, rx, ry, rz]}\n  ports: {hub: [B0, rz], tip: [B2, rz]}\n"
    )
    changes = (
        (section(TEMPLATE, "structure"), structure),
        ("type: held", "type: fixed"),
        *HELD_KEYS,
        ("at: hub_torque", "at: mirror_torque"),
        ("rms: 150 N m", "rms: 0.1 N m"),
        ("points: 5", "points: 2"),
        ("lower: 4 Hz", "lower: 20 Hz"),
    )
    text = TEMPLATE
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def test_a_spatial_truss_is_designed_and_verified(run):
    start, light, quiet = run(spatial_study())["points"]
    assert start["detail"]["truss"]["nodes"][0] == [0.0, 0.2, 0.2]
    for point in (light, quiet):
        assert (point["status"], point["verified"]) == ("optimal", True), point["reason"]
    assert light["metrics"]["structural_mass"] < quiet["metrics"]["structural_mass"]
    assert light["metrics"]["jitter_total"] > quiet["metrics"]["jitter_total"]


def test_a_design_on_too_few_modes_that_fails_on_all_of_them_is_no_success(tmp_path):
    study = load_study(
        STUDIES / "quickstart.yaml", ("structure.bays=6", "front.points=2", "modes={count: 3}")
    )
    light = run_study(study, tmp_path / "out")["points"][1]
    assert (light["status"], light["verified"]) == ("failed", False)
    assert "constraint 'modulus_margin' is violated" in light["reason"]
    assert "on the full-order model" in light["reason"]
    assert light["truncation_error"]["modulus_margin"] > 1e-3


# ---- marking, comparing, pricing ----


def point_of(mass: float | None, jitter: float | None, **more: Any) -> dict[str, Any]:
    return {
        "verified": True,
        "dominated": False,
        "strategy": "simultaneous",
        "metrics": {"mass": mass, "jitter": jitter},
    } | more


def test_a_point_that_another_beats_in_both_objectives_is_dominated():
    points = [point_of(1, 5), point_of(2, 4), point_of(2, 6), point_of(3, 4), point_of(4, 1)]
    assert mark_dominated(points, ["mass", "jitter"])
    assert [p["dominated"] for p in points] == [False, False, True, True, False]


def test_equal_points_do_not_dominate_each_other_even_by_a_solver_tolerance():
    points = [point_of(1.0, 5.0), point_of(1.0, 5.0), point_of(1 - 1e-9, 5 * (1 - 1e-8))]
    assert not mark_dominated(points, ["mass", "jitter"])


def test_only_verified_designs_that_were_sought_can_dominate():
    points = [
        point_of(1, 1, verified=False),
        point_of(1, 1, strategy=None),
        point_of(None, 1),
        point_of(5, 5),
    ]
    assert not mark_dominated(points, ["mass", "jitter"])
    assert not mark_dominated([point_of(1, 1), point_of(2, 2)], ["mass"])


def test_a_strategy_that_failed_is_an_empty_cell_of_the_comparison(quick):
    limits = [{"name": "structural_mass", "upper": 20.0}]
    points = [
        {
            "strategy": name,
            "verified": name != "sequential",
            "constraints": limits,
            "metrics": {"jitter_total": 1.0},
        }
        for name in ("simultaneous", "sequential")
    ]
    points.append(points[0] | {"strategy": None})
    points.append(points[0] | {"constraints": [{"name": "jitter_total", "upper": 3.0}]})
    (row,) = comparison(quick.study, points)
    assert row == {"at": {"structural_mass": 20.0}, "simultaneous": 1.0, "sequential": None}


@pytest.mark.parametrize(
    ("multiplier", "statement"),
    [(2e-6, "1 Hz more costs 12.6 urad"), (-2e-6, "1 Hz more saves 12.6 urad"), (0.0, None), (None, None)],
)
def test_a_price_converts_both_units_and_says_whether_it_costs_or_saves(multiplier, statement):
    quantities = {
        "jitter": {"factor": 1e6, "unit": "urad"},
        "frequency": {"factor": 1 / (2 * pi), "unit": "Hz"},
    }
    constraint = {"name": "frequency", "multiplier": multiplier, "active": True, "statement": None}
    idle = constraint | {"active": False}
    composed = constraint | {"name": "frequency/2"}
    point = {"objective": "jitter", "status": "optimal", "constraints": [constraint, idle, composed]}
    state_prices(point, quantities)
    assert constraint["statement"] == statement
    assert idle["statement"] is None
    assert composed["statement"] is None


def test_only_an_optimum_has_prices():
    quantities = {"jitter": {"factor": 1.0, "unit": "rad"}, "mass": {"factor": 1.0, "unit": "kg"}}
    constraint = {"name": "mass", "multiplier": 1.0, "active": True, "statement": None}
    for status in ("failed", "infeasible", "interrupted"):
        state_prices({"objective": "jitter", "status": status, "constraints": [constraint]}, quantities)
        assert constraint["statement"] is None
