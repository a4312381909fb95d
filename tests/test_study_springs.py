"""Springs to ground as variables of a study file: what is read and refused, and a run from end to end."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fosopt.cli.progress import goals
from fosopt.errors import StudyError
from fosopt.export import write_mat
from fosopt.problem import Variable
from fosopt.study import describe_study, dump_study, load_study, parse_study
from fosopt.study.build import build_problem, start_vector
from fosopt.study.runner import run_study

HEAD = """\
fosopt: 1
name: Springs
"""
TRUSS = """\
structure:
  type: truss
  nodes: {A: [0, 0], B: [0, 0.4], C: [1, 0], D: [1, 0.4]}
  bars:
    - {nodes: [A, C], area: 66 mm^2, young: 70 GPa, density: 2700}
    - {nodes: [B, D], area: 66 mm^2, young: 70 GPa, density: 2700}
    - {nodes: [A, D], area: 66 mm^2, young: 70 GPa, density: 2700}
  battens:
    - {name: root, nodes: [A, B], mass: 2 kg, inertia: 0.1 kg m^2}
    - {name: head, nodes: [C, D], mass: 2 kg, inertia: 0.1 kg m^2}
  springs:
    - {name: left, batten: root, component: x, stiffness: 2 MN/m}
    - {batten: root, component: y, stiffness: 3 MN/m}
    - {batten: root, component: rz, stiffness: 40 kN m/rad}
    - {batten: head, component: y, stiffness: 1 kN/m}
  ports: {hub: [root, rz], tip: [head, rz]}
"""
BARKER = "structure: {type: barker_truss, boundary: table, bays: 2}\n"
LOOP = """\
damping: {uniform: 0.2 %}
mirror: {mass: 1 kg, inertia: 1.0e-3 kg m^2, frequency: 20 Hz, damping_ratio: 0.01}
controller: {type: pid, kp: 600, ki: 50000, crossover: 30 Hz}
objectives: [{label: weight, minimize: structural_mass}]
constraints: [{label: slowest, metric: "structure_frequency[1]", lower: 5 Hz}]
variables:
"""
BOUNDS = ", lower: 1 N/m, upper: 10 MN/m}"
TURNING = ", lower: 1 N m/rad, upper: 10 MN m/rad}"


def study_text(*variables: str, structure: str = TRUSS) -> str:
    lines = (f"  - {{quantity: spring_stiffness, {each}\n" for each in variables)
    return HEAD + structure + LOOP + "".join(lines)


def variables_of(text: str) -> tuple[list[str], tuple[Variable, ...]]:
    """Names of the springs, and the variables of the problem."""
    problem = build_problem(parse_study(text))
    return [spring.name for spring in problem.system.structure.truss.springs], problem.variables


# ---- what is read ----


@pytest.mark.parametrize(
    ("choice", "groups"),
    [
        ("components: [x, y]" + BOUNDS, {"left": ["left"], "root.y": ["root.y"], "head.y": ["head.y"]}),
        (
            "components: [x, y], group_by: component" + BOUNDS,
            {"x": ["left"], "y": ["root.y", "head.y"]},
        ),
        ("components: [y], group_by: all" + BOUNDS, {"all": ["root.y", "head.y"]}),
        ("groups: {a: [left, head.y], b: [root.y]}" + BOUNDS, {"a": ["left", "head.y"], "b": ["root.y"]}),
        ("groups: {soft: ['head.*']}" + BOUNDS, {"soft": ["head.y"]}),
        ("groups: {turn: ['*.r?']}" + TURNING, {"turn": ["root.rz"]}),
        ("components: [rz]" + TURNING, {"root.rz": ["root.rz"]}),
    ],
)
def test_springs_are_chosen_by_component_or_name_and_grouped(
    choice: str, groups: dict[str, list[str]]
) -> None:
    names, (variable,) = variables_of(study_text(choice))
    found = {
        label: [names[i] for i in group]
        for label, group in zip(variable.labels, variable.groups, strict=True)
    }
    assert found == groups
    assert variable.log
    assert variable.discipline == "structure"


@pytest.mark.parametrize("structure", [TRUSS, BARKER], ids=["truss", "barker_truss"])
def test_the_rules_of_the_file_know_the_springs_that_are_built(structure: str) -> None:
    study = parse_study(study_text("components: [rz]" + TURNING, structure=structure))
    built = build_problem(study).system.structure.truss.springs
    given: Any = study.structure
    assert list(given.ground_springs) == [(spring.name, spring.component) for spring in built]


def test_starts_come_from_the_variable_the_design_or_the_structure() -> None:
    text = study_text(
        "name: along, components: [x, y]" + BOUNDS,
        "name: turn, components: [rz], start: 30 kN m/rad" + TURNING,
    )
    study = parse_study(text)
    problem = build_problem(study)
    assert start_vector(study, problem).tolist() == [2e6, 3e6, 1e3, 30e3]
    placed = parse_study(text + "design: {along: [1 MN/m, 2 MN/m, 3 kN/m], turn: 5 kN m/rad}\n")
    assert start_vector(placed, problem).tolist() == [1e6, 2e6, 3e3, 5e3]
    assert parse_study(dump_study(placed)) == placed
    bare = study_text("components: [rz], lower: 1, upper: 1.0e+7}")
    assert (
        parse_study(bare).variables[0] == parse_study(study_text("components: [rz]" + TURNING)).variables[0]
    )


def test_check_states_springs_in_their_unit_and_labels_before_what_they_stand_for() -> None:
    study = parse_study(
        study_text("name: along, components: [x, y]" + BOUNDS, "name: turn, groups: {a: ['*.rz']}" + TURNING)
    )
    lines = [line.strip() for line in describe_study(study)]
    assert (
        "1 ≤ along[k] ≤ 1e+07 N/m, start from the structure, log scale, the spring stiffness, one per member, x, y only"
        in lines
    )
    assert (
        "1 ≤ turn[k] ≤ 1e+07 N m/rad, start from the structure, log scale, the spring stiffness, "
        "one per group: a = *.rz" in lines
    )
    assert "minimize    weight: structural_mass" in lines
    assert "subject to  slowest: structure_frequency[1] ≥ 5 Hz" in lines
    (goal,) = goals(study)
    assert (goal.name, goal.shown(2.0)) == ("structural_mass", "weight 2 kg")


# ---- what is refused ----

ALONG = "components: [x, y]" + BOUNDS
PINNED = BARKER.replace("boundary: table, ", "")
CHAIN = """\
structure:
  type: chain
  bodies: [{name: a, inertia: 3 kg m^2}, {name: b, inertia: 2 kg m^2}]
  springs: [{frequency: 40 Hz}]
"""
BAD = [
    (
        study_text("lower: 1, upper: 2}"),
        "variables.0",
        "'left' [N/m] and 'root.rz' [N m/rad] have no unit in",
    ),
    (study_text("group_by: all, lower: 1, upper: 2}"), "variables.0", "give each a variable of its own"),
    (study_text("groups: {a: ['root.*'], b: [left]}" + BOUNDS), "variables.0", "no unit in common"),
    (study_text("components: [x]" + TURNING), "variables.0.lower", "give a stiffness such as"),
    (study_text("components: [rz]" + BOUNDS), "variables.0.lower", "give a rotational stiffness such as"),
    (
        study_text("components: [rz], start: 2 N/m, lower: 1, upper: 3}"),
        "variables.0.start",
        "give a rotational stiffness",
    ),
    (study_text("components: [x], lower: -1, upper: 3}"), "variables.0.lower", "negative"),
    (study_text("components: [x], lower: 3, upper: 3}"), "variables.0.upper", "not above 'lower'"),
    (study_text("components: [x], start: 9, lower: 1, upper: 3}"), "variables.0.start", "outside the bounds"),
    (
        study_text("components: [z]" + BOUNDS),
        "variables.0.components.0",
        "no spring resists the component 'z'",
    ),
    (study_text("components: [q]" + BOUNDS), "variables.0.components.0", "'rx', 'ry' or 'rz'"),
    (
        study_text("groups: {a: [right]}" + BOUNDS),
        "variables.0.groups.a",
        "'right' matches no spring; springs",
    ),
    (study_text("group_by: kind" + BOUNDS), "variables.0.group_by", "'member', 'component' or 'all'"),
    (
        study_text("group_by: all, groups: {a: [left]}" + BOUNDS),
        "variables.0.group_by",
        "exclude each other",
    ),
    (study_text(ALONG, "name: more, components: [x]" + BOUNDS), "variables.1", "'left' is already set by"),
    (
        study_text(ALONG) + "design: {spring_stiffness: [1 N m/rad]}\n",
        "design.spring_stiffness.0",
        "a stiffness",
    ),
    (
        study_text(ALONG) + "requirements: {spring_stiffness: 1}\n",
        "requirements.spring_stiffness",
        "is no metric",
    ),
    (
        study_text(ALONG).replace("structural_mass", "'structural_mass + spring_stiffness[1]'"),
        "objectives.0.minimize",
        "different units",
    ),
    (
        study_text(ALONG).replace("{batten: root, component: y", "{name: left, batten: root, component: y"),
        "structure.springs.1.name",
        "the spring 'left' stands twice",
    ),
    (study_text(ALONG, structure=PINNED), "variables.0.quantity", "write 'boundary: table'"),
    (
        study_text(ALONG, structure=TRUSS[: TRUSS.index("  springs")] + TRUSS[TRUSS.index("  ports") :]),
        "variables.0.quantity",
        "no springs to ground; remove the variable or add springs",
    ),
    (study_text(ALONG, structure=CHAIN), "variables.0.quantity", "a chain has neither bars nor battens nor"),
]


@pytest.mark.parametrize(("text", "path", "words"), BAD)
def test_a_broken_rule_is_one_line_with_its_place(text: str, path: str, words: str) -> None:
    with pytest.raises(StudyError) as caught:
        build_problem(parse_study(text))
    error = caught.value
    assert "\n" not in str(error)
    assert error.path == path
    assert words in error.message


# ---- a run ----

STIFFEST = """\
fosopt: 1
name: Which springs hold the root at 6 Hz?
structure: {type: barker_truss, boundary: table, bays: 2}
damping: {uniform: 0.2 %}
mirror: {mass: 1 kg, inertia: 1.0e-6 kg m^2, frequency: 20 Hz, damping_ratio: 0.01}
controller: {type: pid, kp: 600, ki: 50000, crossover: 100 Hz}
objectives: [{label: stiffness along, minimize: "along[1] + along[2]"}]
constraints:
  - {metric: first_elastic_frequency, lower: 6 Hz}
  - {label: fourth, metric: "structure_frequency[4]", lower: 7 Hz}
variables:
  - {quantity: spring_stiffness, name: along, components: [x, y], lower: 1 kN/m, upper: 1000 MN/m}
  - {quantity: spring_stiffness, name: turn, components: [rz], lower: 1 kN m/rad, upper: 10 MN m/rad}
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    out = tmp_path_factory.mktemp("springs") / "out"
    return run_study(parse_study(STIFFEST), out), out


def test_an_optimum_over_springs_is_verified_and_meets_its_bound(done: tuple[dict[str, Any], Path]) -> None:
    start, found = done[0]["points"]
    assert (found["status"], found["verified"]) == ("optimal", True)
    slowest, fourth = found["constraints"]
    assert (slowest["active"], fourth["active"]) == (True, False)
    assert found["metrics"]["along[1] + along[2]"] < 1e-2 * start["metrics"]["along[1] + along[2]"]
    assert "1 Hz more costs" in slowest["statement"]


def test_quantities_of_a_run_have_the_unit_of_their_springs_and_the_label_of_the_file(
    done: tuple[dict[str, Any], Path],
) -> None:
    quantities = done[0]["quantities"]
    assert [quantities[name]["unit"] for name in ("along", "turn")] == ["N/m", "N m/rad"]
    assert quantities["along[1] + along[2]"]["label"] == "stiffness along"
    assert quantities["along[1] + along[2]"]["unit"] == "N/m"
    fourth = quantities["structure_frequency[4]"]
    assert (fourth["label"], fourth["unit"]) == ("fourth", "Hz")
    assert fourth["factor"] == pytest.approx(1 / (2 * np.pi))
    assert quantities["first_elastic_frequency"]["label"] == "first elastic frequency"


def test_tables_name_springs_with_their_unit(done: tuple[dict[str, Any], Path], tmp_path: Path) -> None:
    run, out = done
    with (out / "front.csv").open(encoding="utf-8", newline="") as stream:
        row = list(csv.DictReader(stream))[-1]
    columns = [name for name in row if name.startswith(("along", "turn"))]
    assert columns == ["along_B0_x_n_per_m", "along_B0_y_n_per_m", "turn_B0_rz_n_m_per_rad"]
    values = run["points"][-1]["variables"]
    assert [float(row[name]) for name in columns] == [*values["along"], *values["turn"]]
    write_mat(run, tmp_path / "run.mat")
    from scipy.io import loadmat

    units = loadmat(tmp_path / "run.mat", simplify_cells=True)["units"]
    assert (units["along_n_per_m"], units["turn_n_m_per_rad"]) == ("N/m", "N m/rad")


def test_a_design_of_a_run_repeats_its_numbers_bit_for_bit(
    done: tuple[dict[str, Any], Path], tmp_path: Path
) -> None:
    run, out = done
    (again,) = run_study(load_study(out / "designs" / "000.yaml"), tmp_path / "again")["points"]
    assert again["variables"] == run["points"][-1]["variables"]
    assert again["metrics"] == run["points"][-1]["metrics"]
