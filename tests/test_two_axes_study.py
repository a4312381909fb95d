"""Studies of a mirror with two axes: what they say, refuse, find and hand over."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
import small_problems as small
import two_axes
from scipy import io, linalg
from small_studies import STUDIES
from two_axes import HZ

from fosopt.actuators import Mirror
from fosopt.certify import certify
from fosopt.control import OTHER, Sampling, SignalPath, gain_for_crossover
from fosopt.errors import ModelError, StudyError
from fosopt.interchange import systems
from fosopt.metrics.disturbances import low_pass
from fosopt.problem import Definitions, Problem, SecondAxisDefinitions
from fosopt.report.html import document
from fosopt.solve import Options, everything_free, reach
from fosopt.solve.strategies import Goal
from fosopt.study import dump_study, load_study, parse_study
from fosopt.study.build import build_problem, start_vector
from fosopt.study.chosen import design_of_file
from fosopt.study.describe import describe_study
from fosopt.study.detail import detail_of
from fosopt.study.runner import run_study
from fosopt.study.sweep_points import Points, bench

TEXT = (STUDIES / "two-axis-tripod.yaml").read_text(encoding="utf-8")
TRIPOD = (STUDIES / "tripod.yaml").read_text(encoding="utf-8")


def edited(*changes: tuple[str, str], text: str = TEXT) -> str:
    """The shipped study with pieces of its text replaced."""
    for old, new in changes:
        assert old in text, f"the study has no {old!r}"
        text = text.replace(old, new, 1)
    return text


def one_design(*changes: tuple[str, str]) -> str:
    """Its start design to be judged."""
    text = edited(("kind: codesign", "kind: analysis"), *changes)
    return text[: text.index("variables:")]


def built(text: str):
    """Problem and start of a study."""
    problem = build_problem(parse_study(text, STUDIES))
    return problem, start_vector(parse_study(text, STUDIES), problem)


# ---- what a study says ----


def test_what_the_second_axis_leaves_out_is_as_about_the_first():
    problem, x = built(one_design())
    loop = problem.design(x).loop
    assert problem.system.two_axes and loop.beside is not None
    assert (loop.beside.port, loop.beside.hub) == ("tip_y", "hub_y")
    assert (loop.beside.mirror, loop.beside.controller) == (loop.mirror, loop.controller)
    assert [d.axis for d in problem.system.disturbances] == ["both", "both"]


def test_the_second_axis_may_have_mirror_and_controller_of_its_own():
    own = "hub: hub_y\n  inertia: 0.004 kg m^2\n  frequency: 20 Hz\n  damping_ratio: 0.05"
    pid = "\n  controller: {type: pid, kp: 500, ki: 0, crossover: 90 Hz, rolloff: 2 kHz}"
    problem, x = built(one_design(("hub: hub_y", own + pid)))
    beside = problem.design(x).loop.beside
    assert (beside.mirror.inertia, beside.mirror.damping_ratio) == (0.004, 0.05)
    assert beside.mirror.natural_frequency == pytest.approx(20 * HZ, rel=1e-12, abs=0)
    time = 1 / (2000 * HZ)
    gain = gain_for_crossover(90 * HZ, beside.mirror, 500.0, 0.0, 1.0, time)
    assert (beside.controller.kp, beside.controller.ki) == (500.0, 0.0)
    assert beside.controller.gain == pytest.approx(gain, rel=1e-12, abs=0)
    assert beside.controller.rolloff_time == pytest.approx(time, rel=1e-12, abs=0)
    assert problem.definitions.second == SecondAxisDefinitions(
        frozenset(
            {
                "mirror_inertia",
                "mirror_frequency",
                "mirror_damping_ratio",
                "gain",
                "kp",
                "ki",
                "kd",
                "rolloff_time",
            }
        ),
        pytest.approx(90 * HZ, rel=1e-12, abs=0),
    )


def test_an_inertia_of_its_own_keeps_the_crossover_of_the_first():
    problem, x = built(one_design(("hub: hub_y", "hub: hub_y\n  inertia: 0.006 kg m^2")))
    for loop in (problem.design(x).loop, problem.base.loop):
        assert loop.beside.controller.gain == pytest.approx(2 * loop.controller.gain, rel=1e-12, abs=0)


def test_a_gain_is_the_same_about_both_axes():
    problem, x = built(
        one_design(("crossover: 120 Hz", "gain: 2"), ("hub: hub_y", "hub: hub_y\n  inertia: 6 kg m^2"))
    )
    assert problem.design(x).loop.beside.controller.gain == 2.0


def test_a_variable_of_the_second_axis_starts_where_that_axis_is():
    own = "hub: hub_y\n  inertia: 0.004 kg m^2\n  controller: {type: pid, kp: 500, ki: 0, crossover: 90 Hz}"
    more = "  - {quantity: %s, name: own_%s, axis: second, lower: %s, upper: %s}\n"
    text = edited(
        ("hub: hub_y", own),
        ("objectives:", more % ("mirror_inertia", "inertia", "1e-3", "0.1") + "objectives:"),
        ("objectives:", more % ("mirror_frequency", "frequency", "1 Hz", "90 Hz") + "objectives:"),
        ("objectives:", more % ("kp", "kp", "10", "1000") + "objectives:"),
    )
    problem, _ = built(text)
    starts = {v.name: v.start[0] for v in problem.variables if v.axis == "second"}
    assert starts == {
        "second_crossover": pytest.approx(90 * HZ, rel=1e-12, abs=0),
        "own_inertia": 0.004,
        "own_frequency": pytest.approx(15 * HZ, rel=1e-12, abs=0),
        "own_kp": 500.0,
    }


def test_the_study_survives_a_dump_and_is_told_as_it_is_meant():
    study = load_study(STUDIES / "two-axis-tripod.yaml")
    assert parse_study(dump_study(study), study.base) == study
    told = "\n".join(describe_study(study))
    for line in (
        "second axis both loops are closed; the mirror at port tip_y, hub at port hub_y, the rest as about the first",
        "mount: hub torque about both axes, independent, low pass",
        "the crossover about the second axis",
    ):
        assert line in told, told


REFUSED = {
    "unknown port": (
        ("port: tip_y", "port: tipy"),
        "second_axis.port: unknown port 'tipy'; did you mean 'tip_y'?",
    ),
    "unknown hub": (
        ("hub: hub_y", "hub: huby"),
        "second_axis.hub: unknown port 'huby'; did you mean 'hub_y'?",
    ),
    "same port": (("port: tip_y", "port: tip"), "'tip' is the mirror's port about its first axis"),
    "port that moves": (
        ("tip_y: [secondary, ry]", "tip_y: [secondary, x]"),
        "moves along 'x'; use rx, ry or rz",
    ),
    "no hub": (("  hub: hub_y\n", ""), "a torque on the hub about the second axis needs its port"),
    "name": (("name: noise", "name: second_axis"), "'second_axis' is taken by the jitter of an axis"),
    "other axis": (
        ("damping_ratio: 0.02", "damping_ratio: 0.02\n  other_axis: {port: tip_y}"),
        "closes two; remove one",
    ),
    "sampling": (("kp: 600", "kp: 600\n  sampling: {rate: 9 kHz}"), "the loops of two axes are continuous"),
    "its sampling": (
        (
            "hub: hub_y",
            "hub: hub_y\n  controller: {type: pid, kp: 1, ki: 0, crossover: 1 Hz, sampling: {rate: 9 kHz}}",
        ),
        "second_axis.controller.sampling: the loops of two axes are continuous",
    ),
    "its filter": (
        (
            "hub: hub_y",
            "hub: hub_y\n  controller: {type: pid, kp: 1, ki: 0, crossover: 30 Hz, "
            "filters: [{type: rational, numerator: [1], denominator: [1, -1]}]}",
        ),
        "second_axis.controller.filters.0: filter: pole at 1",
    ),
    "reaction mass": (
        ("damping_ratio: 0.02", "damping_ratio: 0.02\n  reaction_mass: {}"),
        "a reaction mass is about one",
    ),
    "step": (
        ("objectives:", "step: {command: 1 urad, window: [1 ms, 2 ms]}\nobjectives:"),
        "step: a step command is",
    ),
    "placement": (
        ("objectives:", "placement: {sensor: hub}\nobjectives:"),
        "the loops of two axes are bicoll",
    ),
    "bounds": (
        ("objectives:", "certificates: {structure: true}\nobjectives:"),
        "bounds are those of one loop",
    ),
    "no gradient": (
        ("metric: modulus_margin", "metric: modulus_margin_multivariable"),
        "has no gradient and",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_mirror_with_two_axes_cannot_have_is_refused_with_a_way_out(name):
    change, message = REFUSED[name]
    with pytest.raises(StudyError) as caught:
        build_problem(parse_study(edited(change), STUDIES))
    assert message in str(caught.value)


def test_an_axis_is_refused_where_the_mirror_has_one():
    alone = edited(("second_axis:                     # mirror and controller as about the first\n", ""))
    alone = alone.replace("  port: tip_y\n  hub: hub_y\n", "")
    with pytest.raises(StudyError, match=r"variables\.2\.axis: the mirror has one axis; remove 'axis'"):
        parse_study(alone, STUDIES)
    with pytest.raises(StudyError, match=r"disturbances\.0\.axis: the mirror has one axis"):
        parse_study(edited(("at: hub_torque", "at: hub_torque\n    axis: both"), text=alone), STUDIES)
    with pytest.raises(
        StudyError, match="'jitter_first_axis' is a metric of a mirror with two axes; add the section"
    ):
        parse_study(edited(("metric: jitter_total", "metric: jitter_first_axis"), text=TRIPOD), STUDIES)


def test_two_variables_of_one_quantity_about_the_second_axis_are_refused():
    twice = "axis: second\n    lower: 20 Hz\n    upper: 400 Hz\n  - quantity: crossover\n    name: c\n    axis: second"
    with pytest.raises(StudyError, match="the quantity 'second crossover'"):
        parse_study(edited(("axis: second", twice)), STUDIES)


def test_axes_that_couple_are_refused_by_other_axis_with_second_axis_as_the_way_out():
    coupled = edited(("center: [0, 0, 1600 mm]", "center: [60 mm, 40 mm, 1600 mm]"), text=TRIPOD)
    with pytest.raises(
        StudyError, match=r"the axes couple: .*close both with 'second_axis' in place of 'other_axis'"
    ):
        build_problem(parse_study(coupled, STUDIES))


# ---- what it finds ----


def test_the_symmetric_tripod_has_the_root_of_two_of_one_loop():
    one = edited(("kind: codesign", "kind: analysis"), text=TRIPOD)
    one = one[: one.index("variables:")]
    two = edited(
        ("  other_axis: {port: tip_y, hub: hub_y}\n", ""),
        ("controller:\n", "second_axis: {port: tip_y, hub: hub_y}\ncontroller:\n"),
        text=one,
    )
    (problem, x), (both, y) = built(one), built(two)
    alone, found = problem.evaluate(x), both.evaluate(y)
    # Tables of the tripod hold nanometers.
    assert found.value("jitter_total") == pytest.approx(
        sqrt(2) * alone.value("jitter_total"), rel=1e-6, abs=0
    )
    for name in ("modulus_margin", "loop_crossover"):
        assert found.value(name) == pytest.approx(alone.value(name), rel=1e-6, abs=0)


def test_a_camera_beside_the_axis_makes_a_torque_about_one_axis_shake_the_other():
    problem, x = built(one_design(("at: hub_torque", "at: hub_torque\n    axis: first")))
    (first, second), _ = problem.evaluate(x).shares
    assert 0.5 < second.value / first.value < 1
    on_axis = ("center: [60 mm, 40 mm, 1600 mm]", "center: [0, 0, 1600 mm]")
    problem, x = built(one_design(on_axis, ("at: hub_torque", "at: hub_torque\n    axis: first")))
    (first, second), _ = problem.evaluate(x).shares
    assert second.value < 1e-10 * first.value


def goal_on_mast() -> Goal:
    """Lightest mast that jitters no more about both axes than the start does."""
    mount = replace(two_axes.DISTURBANCES[1], filter=low_pass(20 * HZ, 10.0, 2))
    system, design = two_axes.on_mast(disturbances=(mount, two_axes.DISTURBANCES[3]))
    bars = range(design.area.size)
    variables = (
        small.variable(
            *("area", np.full(2, 1e-5), np.full(2, 4e-4), np.full(2, 1e-4)),
            groups=(tuple(k for k in bars if k % 2), tuple(k for k in bars if not k % 2)),
        ),
        small.variable("crossover", 20 * HZ, 300 * HZ, 60 * HZ),
        small.variable("crossover_2", 20 * HZ, 300 * HZ, 60 * HZ, "crossover", axis="second"),
    )
    own = SecondAxisDefinitions(frozenset({"mirror_inertia", "mirror_frequency", "mirror_damping_ratio"}))
    definitions = Definitions(crossover=60 * HZ, second=own)
    objectives = small.expressions("structural_mass")
    problem = Problem(system, design, variables, objectives, definitions=definitions)
    start = problem.evaluate(problem.start)
    most = start.value("jitter_total")
    limits = small.limit("jitter_total", upper=most), small.limit("modulus_margin", 0.5)
    problem = Problem(system, design, variables, objectives, limits, definitions)
    return Goal(problem, objectives[0], limits, everything_free(problem))


def test_structure_and_both_loops_are_designed_together_to_a_verified_optimum():
    goal = goal_on_mast()
    found = reach(goal, goal.problem.start, "simultaneous", Options())
    assert found.status == "optimal", found.reason
    certificate = certify(goal.problem, found.x, goal.constraints, goal.objective, goal.free)
    assert certificate.verified, certificate.reasons
    assert certificate.jitter_disagreement < 1e-8
    # The mirror differs about its axes, and so do the best crossovers.
    first, second = found.x[-2:]
    assert abs(first / second - 1) > 0.01
    again = reach(goal, 0.9 * found.x, "simultaneous", Options())
    assert again.objective == pytest.approx(found.objective, rel=1e-5)
    assert found.objective < 0.95 * goal.problem.evaluate(goal.problem.start).value("structural_mass")


def test_an_unstable_pair_of_loops_is_stabilized_before_it_is_optimized():
    goal = goal_on_mast()
    start = goal.problem.start.copy()
    start[-2:] = 20 * HZ
    assert not goal.problem.evaluate(start).stable
    found = reach(goal, start, "simultaneous", Options())
    assert found.status == "optimal", found.reason
    assert goal.problem.evaluate(found.x).value("jitter_total") <= goal.constraints[0].upper * (1 + 1e-6)


def test_a_sweep_has_the_numbers_of_designs_that_are_evaluated_one_by_one():
    text = one_design().replace("kind: analysis", "kind: sweep") + (
        "sweep:\n  axes: [{quantity: crossover, list: [60 Hz, 200 Hz]}]\n  outputs: [jitter_second_axis, stable]\n"
    )
    study = parse_study(text, STUDIES)
    points = Points(study.sweep)
    for number, crossover in enumerate((60 * HZ, 200 * HZ)):
        row = points.row(points.rows(number, number + 1)[0])
        found = bench(study, row)
        (evaluation,) = found.first.neighbors([found.design(row)])
        problem, x = built(one_design(("crossover: 120 Hz", f"crossover: {crossover}")))
        expected = problem.evaluate(x).value("jitter_second_axis")
        assert evaluation.value("jitter_second_axis") == pytest.approx(expected, rel=1e-9, abs=0)
    with pytest.raises(StudyError, match="boundaries are found of one loop"):
        parse_study(text + "  boundary: {along: crossover}\n", STUDIES)
    with pytest.raises(StudyError, match="a mirror with two axes stays at its ports"):
        parse_study(
            text.replace("crossover, list: [60 Hz, 200 Hz]", "mirror_port, list: [tip, hub]"), STUDIES
        )


# ---- what it hands over ----


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The start design with a slower loop about the second axis, judged and written."""
    slower = "hub: hub_y\n  controller: {type: pid, kp: 600, ki: 50000, crossover: 60 Hz}"
    study = parse_study(one_design(("hub: hub_y", slower)), STUDIES)
    return run_study(study, tmp_path_factory.mktemp("two") / "run")


def test_a_run_has_the_jitter_of_every_source_about_every_axis(run):
    (point,) = run["points"]
    assert point["verified"] and point["status"] == "evaluated"
    detail, metrics = point["detail"], point["metrics"]
    assert list(detail["jitter"]) == [
        f"{d}, {a} axis" for d in ("mount", "noise") for a in ("first", "second")
    ]
    assert np.linalg.norm(list(detail["jitter"].values())) == pytest.approx(
        metrics["jitter_total"], rel=1e-12, abs=0
    )
    second = [value for name, value in detail["jitter"].items() if "second" in name]
    assert np.linalg.norm(second) == pytest.approx(metrics["jitter_second_axis"], rel=1e-12, abs=0)
    for name in ("mount, second axis", "total"):
        assert len(detail["cumulative"][name]) == len(detail["cumulative"]["frequency_hz"])
    assert detail["cumulative"]["total"][-1] == pytest.approx(metrics["jitter_total"], rel=1e-5, abs=0)
    assert detail["by_mode"] is None


def test_a_run_has_the_loops_about_both_axes(run):
    bode = run["points"][0]["detail"]["bode"]
    size = len(bode["frequency_hz"])
    for axis, margin in (("", "first"), ("second_axis_", "second")):
        for name in ("loop_magnitude", "loop_phase_deg", "sensitivity", "complementary_sensitivity"):
            assert len(bode[f"{axis}{name}"]) == size, (axis, name)
        peak = 20 * np.log10(max(bode[f"{axis}sensitivity"]))
        least = run["points"][0]["metrics"][f"modulus_margin_{margin}_axis"]
        # Points within three quarters of a pixel of a line are left out, a third of a decibel here.
        assert peak == pytest.approx(-20 * np.log10(least), abs=0.3)
    # Far above all modes mirror and derivative are alike, and what differs is the gain.
    mirror = Mirror(0.003, 15 * HZ, 0.02)
    fast, slow = (gain_for_crossover(f * HZ, mirror, 600.0, 5e4, 1.0, 0.0) for f in (120, 60))
    apart = bode["second_axis_loop_magnitude"][-1] / bode["loop_magnitude"][-1]
    assert apart == pytest.approx(slow / fast, rel=1e-4, abs=0)
    page = document(run)
    assert "mount, second axis" in page


def test_an_unstable_pair_of_loops_has_no_jitter_margin_or_crossover_anywhere(tmp_path):
    unstable = one_design(("ki: 50000", "ki: 50000000"), ("crossover: 120 Hz", "crossover: 20 Hz"))
    run = run_study(parse_study(unstable, STUDIES), tmp_path / "run")
    (point,) = run["points"]
    assert point["status"] == "unstable" and not point["verified"]
    for name, value in point["metrics"].items():
        if name.startswith(("jitter", "modulus_margin", "loop_crossover")):
            assert value is None, name
    assert point["detail"]["jitter"] == {} and point["detail"]["spectrum"] is None
    problem, x = built(unstable)
    assert detail_of(problem.evaluate(x))["cumulative"] is None


def test_plant_and_both_controllers_close_to_the_closed_loop(tmp_path):
    """As a user of the exported file would close them, by the names of the signals."""
    own = "hub: hub_y\n  controller: {type: pid, kp: 500, ki: 9000, crossover: 90 Hz, rolloff: 2 kHz}"
    text = one_design(("crossover: 120 Hz", "crossover: 120 Hz\n  rolloff: 3 kHz"), ("hub: hub_y", own))
    path = tmp_path / "two.yaml"
    names = {name: str(STUDIES / name) for name in ("tripod-nodes.csv", "tripod-members.csv")}
    path.write_text(edited(*names.items(), text=text), encoding="utf-8")
    chosen = design_of_file(path)
    chosen.write_plant(tmp_path / "plant.mat")
    file = io.loadmat(tmp_path / "plant.mat", simplify_cells=True)
    plant, whole = file["plant"], file["closed_loop"]
    inputs, outputs = list(plant["inputs"]), list(plant["outputs"])
    a, loops = plant["A"], []
    for axis, sensed in (("", "sensor_angle"), (OTHER, f"{OTHER}mirror_angle")):
        controller = file[f"{axis}controller"]
        column = plant["B"][:, [inputs.index(f"{axis}control_torque")]]
        loops.append((controller, column, plant["C"][[outputs.index(sensed)]]))
        assert list(controller["inputs"]) == ["command", "sensor_angle"]
    blocks = [c["A"] for c, _, _ in loops]
    own = [
        column @ (c["D"] if np.ndim(c["D"]) else np.array([[c["D"]]])).reshape(1, 2)[:, [1]] @ row
        for c, column, row in loops
    ]
    top = np.hstack([a + sum(own), *(column @ np.atleast_2d(c["C"]) for c, column, _ in loops)])
    fed = [np.asarray(c["B"]).reshape(-1, 2)[:, [1]] @ row for c, _, row in loops]
    matrix = np.vstack([top, np.hstack([np.vstack(fed), linalg.block_diag(*blocks)])])
    found, expected = linalg.eigvals(matrix), linalg.eigvals(whole["A"])
    apart = np.abs(found[:, None] - expected)
    assert found.size == expected.size and apart.min(axis=1).max() < 1e-9 * np.abs(expected).max()
    assert f"{OTHER}hub_torque" in list(whole["inputs"]) and f"{OTHER}line_of_sight" in list(whole["outputs"])
    units = dict(zip(plant["outputs"], plant["output_units"], strict=True))
    assert (units[f"{OTHER}mirror_angle"], units[f"{OTHER}mirror_rate"]) == ("rad", "rad/s")


def test_two_axes_are_not_sampled_for_other_programs():
    text = one_design()
    problem, x = built(text)
    evaluation = problem.evaluate(x)
    assert set(systems(evaluation.design.loop, evaluation.modes, "tip")) == {"plant"}, (
        "an ideal derivative is none"
    )
    with pytest.raises(ModelError, match="controllers that sample are not known"):
        pid = replace(evaluation.design.loop.controller, path=SignalPath(sampling=Sampling(1e-4)))
        replace(evaluation.design.loop, controller=pid)
