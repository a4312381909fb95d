"""From a study to the problem it poses: the system as written, and mistakes that only the physics shows."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from small_studies import HELD_KEYS, analysis, edited, section

from fosopt.errors import StudyError
from fosopt.study import TEMPLATE, parse_study
from fosopt.study.build import build_problem, start_vector

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
