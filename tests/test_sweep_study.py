"""Sweeps from study file to run directory: every point is what a study of that point alone gives."""

from __future__ import annotations

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import loadmat
from small_studies import STUDIES, analysis, section
from typer.testing import CliRunner

from fosopt.cli.commands import app
from fosopt.errors import StudyError
from fosopt.problem import Evaluation
from fosopt.study import TEMPLATE, describe_study, dump_study, load_study, parse_study
from fosopt.study.build import build_problem, start_vector
from fosopt.study.runner import run_study
from fosopt.study.sweep_store import GrowingArray, array_files, size

SHIPPED = STUDIES / "inertia-sweep.yaml"
GRID = """\
sweep:
  axes:
    - quantity: mirror_inertia_ratio
      log: {from: 0.02 %, to: 20 %, points: 5}
    - quantity: damping_ratio
      list: [0.1 %, 1 %]
  outputs:
    - stable
    - spectral_abscissa
    - jitter_total
    - jitter_total / modulus_margin
    - pole_zero_separation[1]
    - one_minus_separation
    - structure_frequency
    - first_elastic_frequency
"""


def sweep_text(sweep=GRID, *changes, bays=3):
    """The small quickstart as a sweep."""
    text = analysis((section(TEMPLATE, "constraints"), ""), *changes, bays=bays)
    return text.replace("kind: analysis", "kind: sweep") + "\n" + sweep


def over(axis, outputs):
    """A sweep over one axis."""
    return f"sweep:\n  axes:\n    - {axis}\n  outputs: [{outputs}]\n"


def run_in(folder, text, **options):
    """Run text as a sweep; its run data and arrays by name."""
    run = run_study(parse_study(text), folder, **options)
    arrays = {each["name"]: np.load(folder / each["file"]) for each in (*run["axes"], *run["outputs"])}
    return SimpleNamespace(run=run, out=folder, arrays=arrays)


def alone(text, changes):
    """Evaluation of one point as an analysis of its own."""
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    study = parse_study(text)
    problem = build_problem(study)
    return problem.evaluate(start_vector(study, problem))


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    return run_in(tmp_path_factory.mktemp("grid") / "run", sweep_text())


# ---- every point ----


def test_each_point_of_a_grid_is_what_its_own_study_gives(grid):
    ratios, damping = grid.arrays["mirror_inertia_ratio"], grid.arrays["damping_ratio"]
    assert ratios.size == grid.run["count"] == grid.run["finished"] == 10
    assert [axis["name"] for axis in grid.run["axes"]] == ["damping_ratio", "mirror_inertia_ratio"]
    assert grid.run["shape"] == [2, 5]
    assert np.unique(damping).tolist() == [0.001, 0.01]
    for k in range(ratios.size):
        point = alone(
            analysis(),
            [
                ("inertia_ratio: 0.2 %", f"inertia_ratio: {float(ratios[k])!r}"),
                ("uniform: 0.2 %", f"uniform: {float(damping[k])!r}"),
            ],
        )
        assert grid.arrays["stable"][k] == float(point.stable)
        assert grid.arrays["spectral_abscissa"][k] == pytest.approx(
            point.value("spectral_abscissa"), rel=1e-9
        )
        found = grid.arrays["one_minus_separation"][k]
        assert np.isnan(found).sum() == 1
        np.testing.assert_allclose(found, point.coupled.one_minus_separation, rtol=1e-11)
        np.testing.assert_allclose(
            grid.arrays["structure_frequency"][k], point.modes.natural_frequency, rtol=1e-12
        )
        if point.stable:
            expected = point.value("jitter_total")
            assert grid.arrays["jitter_total"][k] == pytest.approx(expected, rel=1e-9)
            ratio = expected / point.value("modulus_margin")
            assert grid.arrays["jitter_total / modulus_margin"][k] == pytest.approx(ratio, rel=1e-9)


def test_an_unstable_point_says_so_and_has_no_jitter(tmp_path):
    run = run_in(
        tmp_path / "run",
        sweep_text(GRID + "    - modulus_margin\n", ("crossover: 100 Hz", "crossover: 230 Hz"), bays=20),
    )
    unstable = run.arrays["stable"] == 0
    assert 0 < unstable.sum() == run.run["unstable"] < unstable.size
    assert np.all(run.arrays["spectral_abscissa"][unstable] > 0)
    assert np.array_equal(np.isnan(run.arrays["jitter_total"]), unstable)
    assert np.array_equal(np.isnan(run.arrays["modulus_margin"]), unstable)
    with (run.out / "points.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["jitter_total_rad"] == "" for row in rows] == unstable.tolist()
    assert run.run["failed"] == 0


def test_tables_and_matlab_file_have_the_numbers_of_the_arrays(grid):
    with (grid.out / "points.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    for name, column in (
        ("spectral_abscissa", "spectral_abscissa_rad_per_s"),
        ("damping_ratio", "damping_ratio"),
    ):
        assert [float(row[column]) for row in rows] == grid.arrays[name].tolist()
    hertz = [float(row["first_elastic_frequency_hz"]) for row in rows]
    assert hertz == pytest.approx(grid.arrays["first_elastic_frequency"] / (2 * np.pi), rel=1e-14)
    matlab = loadmat(grid.out / "sweep.mat")
    assert np.array_equal(matlab["spectral_abscissa"].ravel(), grid.arrays["spectral_abscissa"])
    assert matlab["one_minus_separation"].shape == grid.arrays["one_minus_separation"].shape
    about = loadmat(grid.out / "sweep.mat", simplify_cells=True)["about"]
    assert list(about["axes"]) == ["damping_ratio", "mirror_inertia_ratio"]
    assert list(about["shape"]) == [2, 5]
    assert about["units"]["spectral_abscissa"] == "rad/s"
    assert about["names"]["jitter_total_modulus_margin"] == "jitter_total / modulus_margin"
    # Rows follow the last axis first.
    rows = matlab["mirror_inertia_ratio"].reshape(2, 5)
    assert np.array_equal(rows[1], about["grid"]["mirror_inertia_ratio"])
    described = json.loads((grid.out / "sweep.json").read_text(encoding="utf-8"))
    units = {each["name"]: each["unit"] for each in (*described["axes"], *described["outputs"])}
    assert units["spectral_abscissa"] == "rad/s"
    assert units["structure_frequency"] == "rad/s"
    assert units["jitter_total"] == "rad"


@pytest.mark.parametrize(
    ("axis", "changes"),
    [
        ("quantity: crossover\n      list: [40 Hz]", [("crossover: 100 Hz", "crossover: 40 Hz")]),
        ("quantity: gain\n      list: [300]", [("crossover: 100 Hz", "gain: 300")]),
        ("quantity: kp\n      list: [900]", [("kp: 600", "kp: 900")]),
        ("quantity: ki\n      list: [0]", [("ki: 50000", "ki: 0")]),
        ("quantity: kd\n      list: [2]", [("kd: 1\n", "kd: 2\n")]),
        ("quantity: mirror_frequency\n      list: [33 Hz]", [("frequency: 20 Hz", "frequency: 33 Hz")]),
        (
            "quantity: mirror_damping_ratio\n      list: [0.05]",
            [("  damping_ratio: 0.01", "  damping_ratio: 0.05")],
        ),
        ("quantity: mirror_inertia\n      list: [2.5]", [("inertia_ratio: 0.2 %", "inertia: 2.5")]),
        ("quantity: mirror_mass\n      list: [12 kg]", [("mass_fraction: 0.7", "mass: 12 kg")]),
        ("quantity: bays\n      list: [5]", [("bays: 3", "bays: 5")]),
    ],
)
def test_every_axis_sets_what_the_key_of_its_name_sets(tmp_path, axis, changes):
    text = over(axis, "spectral_abscissa, natural_frequency")
    found = run_in(tmp_path / "run", sweep_text(text))
    point = alone(analysis(), changes)
    assert found.arrays["spectral_abscissa"][0] == pytest.approx(point.value("spectral_abscissa"), rel=1e-9)
    np.testing.assert_allclose(
        found.arrays["natural_frequency"][0], point.coupled.natural_frequency, rtol=1e-11
    )


def test_the_area_scale_multiplies_all_areas_and_the_ratio_of_inertias_stays(tmp_path):
    text = over(
        "{quantity: area_scale, list: [2.5]}", "structural_mass, inertia_ratio, first_elastic_frequency"
    )
    found = run_in(tmp_path / "run", sweep_text(text)).arrays
    study = parse_study(analysis())
    problem = build_problem(study)
    base = problem.base
    scaled = base.with_parameters(np.concatenate([2.5 * base.area, base.parameters[base.area.size :]]))
    point = Evaluation(problem.system, scaled)
    for name in ("structural_mass", "first_elastic_frequency"):
        assert found[name][0] == pytest.approx(point.value(name), rel=1e-12)
    assert found["inertia_ratio"][0] == pytest.approx(0.002, rel=1e-12)


CHAIN = """\
structure:
  type: chain
  bodies: [{name: hub, inertia: 50}, {name: middle, inertia: 3}, {name: tip, inertia: 20}]
  springs: [{stiffness: 4e5}, {stiffness: 9e5}]
"""


def test_the_port_of_the_mirror_is_an_axis(tmp_path):
    changes = [
        (section(TEMPLATE, "structure"), CHAIN),
        ("  mass_fraction: 0.7", "  mass: 0"),
        ("inertia_ratio: 0.2 %", "inertia: 0.05"),
    ]
    text = sweep_text(over("{quantity: mirror_port, list: [tip, middle]}", "natural_frequency"), *changes)
    found = run_in(tmp_path / "run", text)
    assert found.run["axes"][0]["labels"] == ["tip", "middle"]
    for row, port in zip(found.arrays["natural_frequency"], ("tip", "middle"), strict=True):
        point = alone(analysis(*changes), [("port: tip", f"port: {port}")])
        np.testing.assert_allclose(row, point.coupled.natural_frequency, rtol=1e-11)
    with (found.out / "points.csv").open(encoding="utf-8") as stream:
        assert [row["mirror_port"] for row in csv.DictReader(stream)] == ["tip", "middle"]


def test_trusses_of_different_length_leave_modes_empty(tmp_path):
    text = over("{quantity: bays, list: [2, 4]}", "effective_modal_reaction_inertia, modal_inertia")
    found = run_in(tmp_path / "run", sweep_text(text)).arrays
    short, long = found["effective_modal_reaction_inertia"]
    assert np.isnan(short[-1])
    assert not np.isnan(long).any()
    assert np.nansum(short) == pytest.approx(1.0, abs=1e-12)
    assert found["modal_inertia"].shape[1] == long.size - 1


def test_a_reactionless_mirror_sweeps_too(tmp_path):
    mirror = ("  damping_ratio: 0.01\n", "  damping_ratio: 0.01\n  reaction_mass: {inertia_ratio: 0.9}\n")
    text = over("{quantity: mirror_inertia_ratio, list: [1 %, 5 %]}", "stable, natural_frequency")
    found = run_in(tmp_path / "run", sweep_text(text, mirror))
    point = alone(analysis(mirror), [("inertia_ratio: 0.2 %", "inertia_ratio: 5 %")])
    np.testing.assert_allclose(
        found.arrays["natural_frequency"][1], point.coupled.natural_frequency, rtol=1e-11
    )
    with pytest.raises(StudyError, match="is a metric of a bicollocated mirror"):
        run_in(
            tmp_path / "other",
            sweep_text(text.replace("natural_frequency", "'natural_frequency[1]'"), mirror),
        )


@pytest.mark.parametrize("sampling", ["latin_hypercube", "sobol"])
def test_drawn_points_fill_the_box_and_come_again_with_the_seed(tmp_path, sampling):
    text = (
        f"sweep:\n  sampling: {sampling}\n  points: 20\n  seed: 7\n  axes:\n"
        "    - {quantity: mirror_inertia_ratio, log: {from: 0.1 %, to: 10 %}}\n"
        "    - {quantity: mirror_frequency, linear: {from: 10 Hz, to: 30 Hz}}\n"
        "    - {quantity: damping_ratio, list: [0.1 %, 1 %]}\n"
        "  outputs: [stable]\n"
    )
    first, again = (run_in(tmp_path / name, sweep_text(text)).arrays for name in "ab")
    ratio = first["mirror_inertia_ratio"]
    assert np.array_equal(ratio, again["mirror_inertia_ratio"])
    assert ratio.size == 20
    assert np.all((ratio >= 1e-3) & (ratio <= 0.1))
    # Both designs put one point in each fourth of every axis at least.
    assert np.unique(np.floor(2 * (np.log10(ratio) + 3))).size == 4
    assert np.ptp(first["mirror_frequency"]) > 15 * 2 * np.pi * 0.9
    # Points of one structure stand together, so that it is solved once.
    assert np.count_nonzero(np.diff(first["damping_ratio"])) == 1
    other = run_in(tmp_path / "c", sweep_text(text.replace("seed: 7", "seed: 8"))).arrays
    assert not np.array_equal(ratio, other["mirror_inertia_ratio"])


# ---- boundaries ----


def test_the_boundary_of_the_shipped_sweep_separates_its_points(tmp_path):
    study = load_study(SHIPPED, ["sweep.axes.0.log.points=21"])
    run = run_study(study, tmp_path / "run")
    (found,) = run["boundaries"]
    ratio, stable = (
        np.load(tmp_path / "run" / "arrays" / f"{n}.npy") for n in ("mirror_inertia_ratio", "stable")
    )
    assert found["loses"]
    assert np.array_equal(stable == 1, ratio < found["at"]["mirror_inertia_ratio"])
    # The dissertation saw a mode near 18 Hz grow at 2 % (table 4.1).
    assert found["frequency"] / (2 * np.pi) == pytest.approx(18.0, rel=0.03)
    with (tmp_path / "run" / "boundary.csv").open(encoding="utf-8") as stream:
        (row,) = csv.DictReader(stream)
    assert float(row["mirror_inertia_ratio"]) == found["at"]["mirror_inertia_ratio"]
    assert row["structural_mode"] == str(found["structural_mode"])


def test_a_contour_has_one_branch_of_boundaries_that_hold_line_by_line(tmp_path):
    text = (
        "sweep:\n  axes:\n    - {quantity: crossover, linear: {from: 150 Hz, to: 300 Hz, points: 4}}\n"
        "    - {quantity: mirror_inertia_ratio, log: {from: 0.1 %, to: 20 %, points: 3}}\n"
        "  outputs: [stable]\n  boundary: {along: mirror_inertia_ratio}\n"
    )
    run = run_in(tmp_path / "run", sweep_text(text, bays=20)).run
    assert {each["branch"] for each in run["boundaries"]} == {0}
    with (tmp_path / "run" / "boundary.csv").open(encoding="utf-8") as stream:
        origins = [row["provenance"] for row in csv.DictReader(stream)]
    assert origins[0].startswith(f"study {run['provenance']['study']}; ")
    assert origins[1:] == [""] * 3
    assert len(run["boundaries"]) == 4
    for each in run["boundaries"]:
        for side in (-1e-6, 1e-6):
            value = each["at"]["mirror_inertia_ratio"] * (1 + side)
            crossover = each["at"]["crossover"]
            changes = [
                ("inertia_ratio: 0.2 %", f"inertia_ratio: {value!r}"),
                ("crossover: 100 Hz", f"crossover: {crossover!r}"),
            ]
            assert alone(analysis(bays=20), changes).stable == ((side < 0) == each["loses"])


# ---- the run directory ----


def test_an_interrupted_sweep_keeps_what_it_has(tmp_path):
    text = GRID.replace("points: 5", "points: 200")
    seen = []
    run = run_in(
        tmp_path / "run", sweep_text(text), progress=seen.append, stop=lambda: seen[-1:] and seen[-1].done > 0
    )
    assert run.run["interrupted"]
    assert 0 < run.run["finished"] < 400
    for values in run.arrays.values():
        assert values.shape[0] == run.run["finished"]
    assert not np.isnan(run.arrays["spectral_abscissa"]).any()
    assert json.loads((run.out / "sweep.json").read_text(encoding="utf-8"))["interrupted"] is True
    assert (run.out / "report.html").exists()


def test_progress_counts_points_up_to_all_of_them(tmp_path):
    heard = []
    run_in(tmp_path / "run", sweep_text(), progress=heard.append)
    done = [p.done for p in heard]
    assert done == sorted(done)
    assert (heard[0].done, heard[-1].done, heard[-1].total) == (0, 10, 10)


def test_a_growing_array_can_be_read_at_every_moment(tmp_path):
    grown = GrowingArray(tmp_path / "a.npy", 3)
    assert np.load(tmp_path / "a.npy").shape == (0, 3)
    for k in range(1, 4):
        grown.append(np.full((4, 3), float(k)))
        found = np.load(tmp_path / "a.npy", mmap_mode="r")
        assert found.shape == (4 * k, 3)
        assert found[-1].tolist() == [k] * 3
    grown.close()


def test_outputs_that_differ_in_signs_only_have_files_of_their_own():
    files = array_files(["a + b", "a - b", "a * b"])
    assert len(set(files.values())) == 3


def test_the_report_of_a_sweep_carries_its_numbers_and_asks_for_nothing(grid):
    page = (grid.out / "report.html").read_text(encoding="utf-8")
    data = json.loads(page.split('<script type="application/json" id="run">')[1].split("</script>")[0])
    assert data["shown"]["shape"] == [2, 5]
    assert data["shown"]["scalars"]["stable"] == grid.arrays["stable"].tolist()
    assert len(data["shown"]["modes"]["one_minus_separation"]) == grid.arrays["one_minus_separation"].shape[1]
    assert "default-src 'none'" in page


def test_the_command_says_what_it_found(tmp_path):
    study = tmp_path / "study.yaml"
    study.write_text(sweep_text(), encoding="utf-8")
    result = CliRunner().invoke(app, ["run", str(study), "--out", str(tmp_path / "out"), "--json"])
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert (summary["finished"], summary["count"]) == (10, 10)
    assert "points/s" in result.stderr
    assert "10 of 10 points" in result.stderr
    assert CliRunner().invoke(app, ["check", str(study)]).exit_code == 0


def test_a_sweep_survives_a_dump_and_is_described():
    study = parse_study(sweep_text())
    assert parse_study(dump_study(study)) == study
    lines = "\n".join(describe_study(study))
    assert "equal ratios, 5 points" in lines
    assert "10, the full grid" in lines


# ---- what is refused ----


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("quantity: mirror_inertia_ratio", "quantity: mirror_inertai", "did you mean 'mirror_inertia'?"),
        ("from: 0.02 %", "from: -1 %", "is not positive; give a ratio above zero"),
        ("from: 0.02 %", "from: 3 kg", "kg"),
        ("from: 0.02 %", "from: 30 %", "'to' is not above 'from'"),
        (", points: 5", "", "'points' is required on a grid"),
        ("list: [0.1 %, 1 %]", "list: [0.1 %, 100 %]", "is too large"),
        ("list: [0.1 %, 1 %]", "list: [1 %, 1 %]", "stands twice"),
        ("quantity: damping_ratio", "quantity: bays", "give a whole number from 1 to 5000"),
        (
            "quantity: damping_ratio\n      list: [0.1 %, 1 %]",
            "quantity: mirror_port\n      list: [tpi]",
            "did you mean 'tip'?",
        ),
        (
            "quantity: damping_ratio\n      list: [0.1 %, 1 %]",
            "quantity: mirror_inertia\n      list: [1.0]",
            "set the same thing",
        ),
        ("- stable", "- stabel_margin", "unknown metric 'stabel_margin'"),
        ("- stable", "- natural_frequency[3000]", "the model has modes 1 to"),
        ("  outputs:", "  boundary: {along: damping}\n  outputs:", "did you mean 'damping_ratio'?"),
        ("  outputs:", "  sampling: sobol\n  outputs:", "needs 'points'"),
        ("  outputs:", "  points: 5\n  outputs:", "a grid has the points of its axes"),
    ],
)
def test_a_sweep_that_breaks_a_rule_is_refused(tmp_path, old, new, message):
    assert old in GRID
    with pytest.raises(StudyError) as refused:
        run_study(parse_study(sweep_text(GRID.replace(old, new, 1))), tmp_path / "run")
    assert message in str(refused.value)
    assert not (tmp_path / "run").exists()


def test_a_sweep_belongs_to_its_kind():
    with pytest.raises(StudyError, match="needs the section 'sweep'"):
        parse_study(sweep_text(""))
    with pytest.raises(StudyError, match="write 'kind: sweep'"):
        parse_study(analysis() + "\n" + GRID)


def test_what_the_disk_has_no_room_for_is_refused_with_its_size(tmp_path):
    text = GRID.replace("points: 5", "points: 1000000").replace(
        "list: [0.1 %, 1 %]", "linear: {from: 0.1 %, to: 5 %, points: 1000}"
    )
    with pytest.raises(StudyError, match=r"10{9} points would take [\d.]+ (GiB|TiB) on a disk with"):
        run_study(parse_study(sweep_text(text)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_sizes_are_for_people():
    assert [size(n) for n in (0, 1000, 1024, 1.5 * 2**30)] == ["0 B", "1e+03 B", "1 KiB", "1.5 GiB"]
