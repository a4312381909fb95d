"""The study file: what is read, what is refused and where."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from example_study import EXAMPLE
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from fosopt.errors import StudyError
from fosopt.study import Study, describe_study, dump_study, load_study, parse_study
from fosopt.study.files import read_damping, read_psd, side_files

TRUSS = """\
fosopt: 1
name: Small truss
structure:
  type: truss
  nodes: {1: [0 m, 0 m], 2: [0 m, 0.4 m], 3: [1 m, 0 m], 4: [1 m, 0.4 m]}
  bars:
    - {name: low, nodes: [1, 3], area: 66 mm^2, young: 70 GPa, density: 2.7 g/cm^3, kind: longeron, bay: 1}
    - {nodes: [2, 4], area: 66 mm^2, young: 70 GPa, density: 2700, kind: longeron, bay: 1}
    - {nodes: [1, 4], area: 66 mm^2, young: 70 GPa, density: 2700, kind: diagonal}
  battens:
    - {name: root, nodes: [1, 2], mass: 2 kg, inertia: 0.1 kg m^2}
    - {name: head, nodes: [3, 4], mass: 2 kg, inertia: 0.1 kg m^2, center: [1 m, 0.2 m]}
  points:
    - {batten: head, mass: 1 kg, inertia: 0.2 kg m^2}
  springs:
    - {node: 3, component: y, stiffness: 5 N/m}
    - {batten: root, component: rz, stiffness: 5 N m/rad}
  supports: {root: [x, y]}
  ports: {hub: [root, rz], tip: [head, rz]}
hub: {type: held, bandwidth: 0.1 Hz, damping_ratio: 0.7}
damping: {per_mode: [0.1 %, 0.2 %]}
mirror: {mass: 5 kg, inertia: 0.4 kg m^2, stiffness: 6000 N m/rad, damping_ratio: 0.01}
controller: {type: pid, kp: 600, ki: 50000 1/s^2, gain: 1300, rolloff: 2 kHz}
disturbances:
  - {name: hum, at: line_of_sight, filter: {type: band_pass, lower: 1 Hz, upper: 2 Hz, rms: 3 urad}}
  - {name: torque, at: hub_torque, filter: {type: white, density: 1 mN m/sqrt(Hz)}}
  - {name: other, at: mirror_torque, filter: {type: rational, numerator: [1], denominator: [1, 2]}}
step: {command: 1 urad, window: [50 ms, 100 ms]}
variables:
  - {quantity: area, name: root_area, groups: {a: [low], b: ["*"]}, lower: 20 mm^2, upper: 1 cm^2}
  - {quantity: batten_mass, group_by: all, lower: 0 kg, upper: 9 kg}
  - {quantity: kp, lower: 0, upper: 1000}
objectives:
  - minimize: structural_mass + 1e6 * jitter_hum + root_area[2] / batten_mass
constraints:
  - {metric: "natural_frequency[2] - natural_frequency[1]", lower: 1 Hz}
  - {metric: step_rms, lower: 0, upper: 2 urad}
cases:
  - {name: kp alone, free: [kp]}
  - {name: all, free: all}
requirements: {jitter_total: 100 urad, "pole_zero_separation[1]": 1 %}
design: {root_area: [30 mm^2, 6e-05], kp: 700}
"""


def position(text: str, piece: str) -> tuple[int, int]:
    """Line and column of a piece that stands in the text once."""
    assert text.count(piece) == 1
    before = text[: text.index(piece)]
    return before.count("\n") + 1, len(before) - before.rfind("\n")


def refusal(text: str) -> StudyError:
    with pytest.raises(StudyError) as caught:
        parse_study(text)
    assert "\n" not in str(caught.value)
    return caught.value


def test_the_starting_study_loads_and_is_quick():
    study = parse_study(EXAMPLE)
    assert study.structure.type == "barker_truss"
    assert study.front.points == 5
    assert study.variables[0].group_by == "kind"
    assert study.variables[0].lower == 20e-6
    assert study.mirror.inertia_ratio == 2e-4
    assert study.controller.crossover == pytest.approx(2 * math.pi * 230, rel=1e-15)
    assert study.disturbances[1].filter.density == 1e-8


def test_all_kinds_of_sections_load():
    study = parse_study(TRUSS)
    assert study.structure.nodes["2"] == (0.0, 0.4)
    assert study.structure.bars[0].nodes == ("1", "3")
    assert study.structure.springs[1].stiffness == 5.0
    assert study.disturbances[1].filter.density == 1e-3
    assert study.variables[0].group_by is None
    assert [variable.scale for variable in study.variables] == ["log", "linear", "linear"]
    assert study.constraints[0].lower == pytest.approx(2 * math.pi, rel=1e-15)
    assert study.requirements == {"jitter_total": 1e-4, "pole_zero_separation[1]": 0.01}
    assert study.design == {"root_area": (3e-5, 6e-5), "kp": 700.0}
    assert study.variable("kp").name == "kp"
    assert study.given("gain") == 1300.0


@pytest.mark.parametrize("text", [EXAMPLE, TRUSS])
def test_a_dump_loads_to_an_equal_study_bit_for_bit(text):
    study = parse_study(text, base="elsewhere")
    dumped = dump_study(study)
    again = parse_study(dumped)
    assert again == study
    assert again.base != study.base
    assert dump_study(again) == dumped
    assert Study.model_validate(study.model_dump(mode="json")) == study


PROSE = st.text(st.characters(codec="utf-8").filter(lambda c: c.isprintable() or c in "\n\t"), max_size=30)


@given(st.floats(min_value=1e-300, max_value=1e300), PROSE)
@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_any_number_and_text_survive_the_dump(number, text):
    data = parse_study(TRUSS).model_dump(mode="json")
    data["controller"]["gain"] = number
    data["description"] = text
    study = Study.model_validate(data)
    assert parse_study(dump_study(study)) == study


def test_a_study_is_frozen():
    with pytest.raises(ValueError, match="frozen"):
        parse_study(EXAMPLE).name = "other"


def test_the_json_schema_takes_numbers_and_text_for_quantities():
    schema = Study.model_json_schema()
    json.dumps(schema)
    area = schema["$defs"]["Bar"]["properties"]["area"]
    assert [each["type"] for each in area["anyOf"]] == ["number", "string"]
    assert "66 mm^2" in area["description"]


def test_reading_a_study_does_not_load_numerical_libraries():
    script = (
        "import sys; from fosopt.study import TEMPLATE, parse_study, describe_study;"
        "describe_study(parse_study(TEMPLATE)); print({'numpy', 'scipy', 'casadi'} & set(sys.modules))"
    )
    root = str(Path(__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": root}
    run = subprocess.run(
        [sys.executable, "-c", script], cwd=root, env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == "set()"


# What replaces a piece of a good file, where the error must stand (a piece of the broken file), the path
# and words of the message.
BAD_EXAMPLE = [
    ("name: Mass against", "nam: Mass against", "nam: Mass", "nam", "unknown key; did you mean 'name'"),
    ("fosopt: 1 ", "fosopt: 77 ", "77 ", "fosopt", "use 1"),
    ("boundary: pinned ", "boundary: pined ", "pined ", "structure.boundary", "'table', 'fixed' or 'pinned'"),
    ("type: barker_truss", "type: barker", "barker ", "structure.type", "use one of 'barker_truss', 'truss'"),
    ("type: barker_truss", "typ: barker_truss", "typ: barker", "structure", "'type' is required"),
    ("bays: 20\n", "bays: 0\n", "0\n\nhub", "structure.bays", "at least 1"),
    ("bays: 20\n", "bays: 2.5\n", "2.5\n", "structure.bays", "no whole number"),
    ("bays: 20\n", "bays: yes\n", "yes\n", "structure.bays", "no whole number"),
    (
        "type: free ",
        "type: free\n  bandwidth: 1 Hz ",
        "bandwidth: 1",
        "hub.bandwidth",
        "belongs to a held hub",
    ),
    ("type: free ", "type: held\n  bandwidth: 1 Hz ", "type: held", "hub", "needs 'damping_ratio'"),
    ("uniform: 0.1 %", "uniform: -0.1 %", "-0.1 %", "damping.uniform", "negative"),
    ("uniform: 0.1 %", "uniform: 120 %", "120 %", "damping.uniform", "below 1"),
    ("uniform: 0.1 %", "uniform: .nan", ".nan", "damping.uniform", "not finite"),
    ("uniform: 0.1 %", "uniform: .inf", ".inf", "damping.uniform", "not finite"),
    ("uniform: 0.1 %", "uniform: 0.1 mm", "0.1 mm", "damping.uniform", "wrong dimension; give a ratio"),
    ("uniform: 0.1 %", "uniform: 1 %\n  table: x.csv", "table: x", "damping.table", "exclude each other"),
    ("uniform: 0.1 %", "table: [[2, .1], [1, .1]]", "[1, .1]", "damping.table.1", "ascending"),
    ("uniform: 0.1 %", "table: [[2, .1], [3, x]]", "x]]", "damping.table.1.1", "no number"),
    ("uniform: 0.1 %", "table: [[2, .1]]", "[[2", "damping.table", "at least 2"),
    ("uniform: 0.1 %", "table: [[2, .1], [3]]", "[3]]", "damping.table.1.1", "value 2 is missing"),
    ("uniform: 0.1 %", "table: none.csv", "none.csv", "damping.table", "no such file"),
    ("count: 12 ", "count: 12\n  below: 1 Hz", "below: 1", "modes.below", "exclude each other"),
    ("count: 12 ", "keep: [1, 1] ", "1] ", "modes.keep.1", "ascending"),
    ("port: tip ", "port: tipp ", "tipp ", "mirror.port", "did you mean 'tip'"),
    ("mass_fraction: 0.7 ", "mass_fraction: 1.7 ", "1.7 ", "mirror.mass_fraction", "below 1"),
    ("frequency: 20 Hz ", "frequency: 20 Hz\n  stiffness: 1 ", "stiffness", "mirror.stiffness", "exclude"),
    ("  damping_ratio: 0.01\n", "", "port: tip", "mirror.damping_ratio", "is required"),
    (
        "crossover: 230 Hz ",
        "gain: 3\n  crossover: 2 Hz ",
        "crossover: 2 Hz",
        "controller.crossover",
        "exclude",
    ),
    ("  crossover: 230 Hz", "#", "type: pid", "controller", "one of gain, crossover is required"),
    ("kp: 600", "kp: 600 kg", "600 kg", "controller.kp", "give a rate such as 600 1/s"),
    ("name: sensor\n", "name: cooling\n", "cooling\n    at: sensor", "disturbances.1.name", "stands twice"),
    ("name: sensor\n", "name: total\n", "total\n    at:", "disturbances.1.name", "taken by jitter_total"),
    ("name: sensor\n", "name: 1sensor\n", "1sensor\n", "disturbances.1.name", "no identifier"),
    ("name: sensor\n", "name: if\n", "if\n", "disturbances.1.name", "no identifier"),
    ("at: sensor_noise", "at: noises", "noises\n", "disturbances.1.at", "use 'mirror_torque'"),
    ("type: high_pass, ", "type: high, ", "high, ", "disturbances.1.filter.type", "use one of 'low_pass'"),
    ("density: 0.01 urad/sqrt(Hz)", "density: 1 urad", "1 urad}", "disturbances.1.filter.density", "sqrt"),
    ("rms: 0.02 N m", "density: 0.02", "density: 0.02}", "disturbances.0.filter.density", "unknown key"),
    ("rms: 0.02 N m}", "rms: 0.02 N m}\n    psd: x.csv", "psd: x", "disturbances.0.psd", "exclude"),
    ("order: 1, rms", "order: 0, rms", "0, rms", "disturbances.0.filter.order", "at least 1"),
    (
        "lower: 20 mm^2",
        "lower: -3 mm^2",
        "-3 mm^2",
        "variables.0.lower",
        "'-3 mm^2' is not positive; give an area",
    ),
    (
        "lower: 20 mm^2",
        "lower: 20 Hz",
        "20 Hz\n    upper",
        "variables.0.lower",
        "wrong dimension; give an area",
    ),
    ("lower: 20 mm^2", "lower: 20 mmm^2", "20 mmm", "variables.0.lower", "unknown unit 'mmm'"),
    ("lower: 20 mm^2", "lower: [1]", "[1]", "variables.0.lower", "no quantity"),
    ("    lower: 20 mm^2\n", "", "quantity: area", "variables.0.lower", "is required"),
    ("upper: 500 mm^2", "upper: 5 mm^2", "5 mm^2\n", "variables.0.upper", "not above 'lower'"),
    ("start: 66 mm^2", "start: 6 mm^2", "6 mm^2\n  -", "variables.0.start", "outside the bounds"),
    ("start: 66 mm^2", "scale: lin", "lin\n", "variables.0.scale", "'log' or 'linear'"),
    ("start: 66 mm^2", "kinds: [batten]", "batten]", "variables.0.kinds.0", "known: diagonal, longeron"),
    ("group_by: kind ", "groups: {a: []} ", "[]", "variables.0.groups.a", "at least 1"),
    (
        "group_by: kind ",
        "groups: {a: [x]}\n    group_by: bay ",
        "group_by",
        "variables.0.group_by",
        "exclude",
    ),
    ("quantity: crossover", "quantity: crossing", "crossing", "variables.1.quantity", "use one of 'area'"),
    (
        "quantity: crossover\n",
        "quantity: crossover\n    name: area\n",
        "area\n    lower: 100",
        "variables.1.name",
        "twice",
    ),
    (
        "quantity: crossover\n",
        "quantity: crossover\n    name: total_mass\n",
        "total_mass",
        "variables.1.name",
        "metric",
    ),
    (
        "quantity: crossover\n    lower: 100 Hz\n    upper: 400 Hz",
        "quantity: gain\n    lower: 1\n    upper: 2",
        "gain\n    lower",
        "variables.1.quantity",
        "given by its crossover",
    ),
    ("lower: 100 Hz", "lower: 300 Hz", "quantity: crossover", "variables.1", "start 230 Hz of the crossover"),
    (
        "minimize: jitter_total",
        "minimize: jiter_total",
        "jiter_total",
        "objectives.1.minimize",
        "did you mean 'jitter_total'",
    ),
    (
        "minimize: jitter_total",
        "minimize: jitter_hum",
        "jitter_hum",
        "objectives.1.minimize",
        "unknown metric",
    ),
    (
        "minimize: jitter_total",
        "minimize: step_rms",
        "step_rms",
        "objectives.1.minimize",
        "add the section 'step'",
    ),
    (
        "minimize: jitter_total",
        "minimize: participation",
        "participation",
        "objectives.1.minimize",
        "participation[1]",
    ),
    (
        "minimize: jitter_total",
        "minimize: total_mass[1]",
        "total_mass[1]",
        "objectives.1.minimize",
        "single value",
    ),
    ("minimize: jitter_total", "minimize: 3", "3\n\nconstr", "objectives.1.minimize", "no expression"),
    ("minimize: jitter_total", "minimize: '3'", "'3'", "objectives.1.minimize", "names no metric"),
    ("minimize: jitter_total", "minimize: exec(a)", "exec(a)", "objectives.1.minimize", "unknown function"),
    (
        "minimize: jitter_total",
        "minimize: total_mass + crossover",
        "total_mass +",
        "objectives.1.minimize",
        "different units",
    ),
    ("  - minimize: jitter_total\n", "", "front:\n", "front", "a front needs two objectives"),
    ("front:\n  points: 5\n", "", "minimize: jitter_total", "objectives.1", "two objectives need 'front'"),
    ("points: 5\n", "points: 1\n", "1\n\nsolve", "front.points", "at least 2"),
    ("points: 5\n", "points: five\n", "five", "front.points", "no whole number"),
    ("lower: 6 Hz", "lower: 6 kg", "6 kg", "constraints.0.lower", "wrong dimension; give a frequency"),
    ("    lower: 6 Hz\n", "", "metric: first", "constraints.0", "no bound"),
    ("lower: 6 Hz", "lower: 6 Hz\n    upper: 5 Hz", "5 Hz\n  -", "constraints.0.upper", "below 'lower'"),
    ("strategy: simultaneous ", "strategy: both ", "both ", "solve.strategy", "'nested' or 'sequential'"),
    (
        "strategy: simultaneous ",
        "compare: [simultaneous] ",
        "simultaneous] ",
        "solve.compare.0",
        "strategy itself",
    ),
    ("time_limit: 60 s ", "time_limit: 0 s ", "0 s ", "solve.time_limit", "not positive"),
    ("time_limit: 60 s ", "tolerance: 77 ", "77 ", "solve.tolerance", "below 1"),
    ("time_limit: 60 s ", "seed: -1 ", "-1 ", "solve.seed", "at least 0"),
    ("solve:\n", "cases: [{name: a, free: all}]\nsolve:\n", "cases:", "cases", "single objective"),
    (
        "solve:\n",
        "requirements: {jiter_total: 1}\nsolve:\n",
        "jiter_",
        "requirements.jiter_total",
        "did you mean",
    ),
    (
        "solve:\n",
        "requirements: {jitter_total: 1 m}\nsolve:\n",
        "1 m}",
        "requirements.jitter_total",
        "an angle",
    ),
    ("solve:\n", "design: {crossing: 1}\nsolve:\n", "crossing", "design.crossing", "known: area, crossover"),
    ("solve:\n", "design: {area: [9 Hz]}\nsolve:\n", "9 Hz", "design.area.0", "give an area"),
    (
        "solve:\n",
        "design: {area: [9 mm^2]}\nsolve:\n",
        "9 mm^2",
        "design.area.0",
        "outside the variable's bounds",
    ),
    ("solve:\n", "design: {crossover: [1, 2]}\nsolve:\n", "[1, 2]", "design.crossover", "single value"),
    ("kind: codesign ", 'description: "a\\eb"', '"a\\eb"', "description", "control character"),
    ("kind: codesign ", "kind: analysis ", "front:", "front", "an analysis has no 'front'"),
    ("solve:\n", "name: twice\nsolve:\n", "name: twice", "name", "first in line 9"),
    ("name: Mass against jitter", "name: [", ":", None, "check the YAML"),
    ("name: Mass against jitter", "name: ''", "''", "name", "no name"),
    ("name: Mass against jitter", "name: aa: b", ": b\n", None, "mapping values are not allowed"),
    ("name: Mass against jitter", "name: !!python/none x", "!!python", "name", "tag"),
    ("name: Mass against jitter", "name: *x", "*x", None, "undefined alias"),
    ("name: Mass against jitter", "? [a]\n: b", "[a]", None, "a key is a name"),
    ("name: Mass against jitter", "name: a\tb\x07", "\x07", None, "not allowed in YAML"),
]
BAD_TRUSS = [
    (
        "nodes: [1, 3], area",
        "nodes: [1, 9], area",
        "9], area",
        "structure.bars.0.nodes.1",
        "unknown node '9'",
    ),
    ("nodes: [1, 3], area", "nodes: [1, 1], area", "[1, 1], area", "structure.bars.0.nodes", "no length"),
    (
        "nodes: [1, 3], area",
        "nodes: [1], area",
        "[1], area",
        "structure.bars.0.nodes.1",
        "value 2 is missing",
    ),
    (
        "nodes: [1, 3], area",
        "nodes: [1, 2, 3], area",
        "[1, 2, 3], area",
        "structure.bars.0.nodes",
        "at most 2",
    ),
    ("2: [0 m, 0.4 m]", "2: [0 m, 0 m, 0 m]", "[0 m, 0 m, 0 m]", "structure.nodes.2", "give all alike"),
    ("2: [0 m, 0.4 m]", "2: [0 m, 4 Hz]", "4 Hz", "structure.nodes.2.1", "give a length"),
    (
        "nodes: [3, 4], mass",
        "nodes: [2, 4], mass",
        "2], mass",
        "structure.battens.0.nodes.1",
        "one rigid body",
    ),
    ("name: head", "name: root", "root, nodes: [3", "structure.battens.1.name", "twice"),
    ("name: head", "name: 3", "3, nodes: [3", "structure.battens.1.name", "is a node too"),
    ("batten: head, mass", "batten: 3, mass", "3, mass", "structure.points.0.batten", "unknown batten '3'"),
    ("batten: head, mass", "node: 3, mass", "0.2 kg m^2}\n", "structure.points.0.inertia", "no rotation"),
    (
        "stiffness: 5 N/m",
        "stiffness: 5 N m/rad",
        "5 N m/rad}\n    - {batten",
        "structure.springs.0.stiffness",
        "N/m",
    ),
    ("component: y,", "component: rz,", "5 N/m", "structure.springs.0.stiffness", "rotational stiffness"),
    ("component: y,", "component: z,", "3, component", "structure.springs.0.node", "planar truss"),
    (
        "supports: {root: [x, y]}",
        "supports: {3: [rz]}",
        "rz]}\n  ports",
        "structure.supports.3.0",
        "has no rotation",
    ),
    ("supports: {root: [x, y]}", "supports: {root: [x, x]}", "x]}", "structure.supports.root.1", "twice"),
    ("tip: [head, rz]", "tip: [head, x]", "x]}\nhub", "structure.ports.tip.1", "the mirror turns"),
    ("tip: [head, rz]", "tip: [hed, rz]", "[hed", "structure.ports.tip", "did you mean 'head'"),
    ("hub: [root, rz], ", "", "held", "hub.type", "needs the port 'hub'"),
    ("upper: 2 Hz, rms", "upper: 1 Hz, rms", "1 Hz, rms", "disturbances.0.filter.upper", "not above"),
    ("denominator: [1, 2]", "denominator: [0, 2]", "0, 2]", "disturbances.2.filter.denominator.0", "zero"),
    (
        "numerator: [1]",
        "numerator: [1, 2, 3]",
        "[1, 2]}",
        "disturbances.2.filter.denominator",
        "zeros than poles",
    ),
    (
        "at: hub_torque, filter: {type: white, density: 1 mN m/sqrt(Hz)}",
        "at: line_of_sight, filter: {type: white, density: 1 urad/sqrt(Hz)}",
        "{name: torque",
        "disturbances.1",
        "infinite power",
    ),
    ("window: [50 ms, 100 ms]", "window: [50 ms, 10 ms]", "[50 ms", "step.window", "not after its start"),
    ('groups: {a: [low], b: ["*"]}', "group_by: bay", "bay, lower", "variables.0.group_by", "bar 2 has none"),
    ("root_area[2]", "root_area[3]", "structural_mass + 1e6", "objectives.0.minimize", "beyond the 2 groups"),
    ("root_area[2]", "root_area", "structural_mass + 1e6", "objectives.0.minimize", "one value per group"),
    ("lower: 1 Hz}\n", "lower: 1 kg}\n", "1 kg}\n", "constraints.0.lower", "give a frequency"),
    ("free: [kp]", "free: [kd]", "kd]", "cases.0.free.0", "unknown variable 'kd'"),
    ("free: [kp]", "free: some", "some", "cases.0.free", "'all' or 'none'"),
    ("name: all, free", "name: kp alone, free", "kp alone, free: all", "cases.1.name", "twice"),
    (
        "{quantity: kp, lower: 0, upper: 1000}",
        "{quantity: kp, lower: 0, upper: 1000, scale: log}",
        "log}",
        "variables.2.scale",
        "lower bound above zero",
    ),
]


@pytest.mark.parametrize(
    ("text", "old", "new", "at", "path", "words"),
    [(EXAMPLE, *case) for case in BAD_EXAMPLE] + [(TRUSS, *case) for case in BAD_TRUSS],
)
def test_a_broken_rule_is_one_line_with_its_place(text, old, new, at, path, words):
    assert text.count(old) == 1
    broken = text.replace(old, new)
    error = refusal(broken)
    assert error.path == path
    assert words in error.message
    if at != ":":
        assert (error.line, error.column) == position(broken, at)
    assert str(error).startswith(f"study.yaml:{error.line}:{error.column}: ")


def test_text_that_is_no_mapping_is_refused():
    for text in ("", "- a", "text", "null", "# only a comment"):
        assert "a study is a mapping" in str(refusal(text))


def test_bombs_are_refused_quickly():
    laughs = "a0: &a0 [x]\n" + "".join(
        f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 9)
    )
    assert "aliases" in str(refusal(laughs))
    assert "aliases" in str(refusal("a: &a [*a]")) or "nested" in str(refusal("a: &a [*a]"))
    assert "nested" in str(refusal("a: " + "[" * 2000 + "]" * 2000))
    assert "nested" in str(refusal("a: " + "[" * 25 + "]" * 25))


def test_a_few_aliases_are_read():
    text = EXAMPLE.replace("band: [0.1 Hz, 2 kHz]", "band: &band [0.1 Hz, 2 kHz]", 1)
    at = text.rindex("band: [")
    text = text[:at] + text[at:].replace("band: [0.1 Hz, 2 kHz]", "band: *band", 1)
    assert parse_study(text).disturbances[1].band == parse_study(EXAMPLE).disturbances[1].band


def test_unreadable_files_are_refused(tmp_path):
    with pytest.raises(StudyError, match=r"none\.yaml: no such file"):
        load_study(tmp_path / "none.yaml")
    with pytest.raises(StudyError, match="cannot be read"):
        load_study(tmp_path)
    (tmp_path / "latin.yaml").write_bytes(b"fosopt: 1\nname: m\xfcde\n")
    with pytest.raises(StudyError, match=r"latin.yaml:2:8: byte 0xfc is not UTF-8"):
        load_study(tmp_path / "latin.yaml")
    (tmp_path / "large.yaml").write_bytes(b"#" * (10 * 1024**2 + 1))
    with pytest.raises(StudyError, match="larger than 10 MiB"):
        load_study(tmp_path / "large.yaml")


def test_overrides_replace_and_add_values(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text("\ufeff" + EXAMPLE, encoding="utf-8")
    study = load_study(
        path,
        [
            "front.points=7",
            "variables.0.lower=30 mm^2",
            "step.command=1 urad",
            "step.window=[1 ms, 2 ms]",
            "solve.seed=3",
        ],
    )
    assert study.front.points == 7
    assert study.variables[0].lower == 3e-5
    assert study.step.window == (1e-3, 2e-3)
    assert study.base == tmp_path
    assert load_study(path, ["modes="]).modes is None


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("front.points", "no assignment"),
        ("=5", "no assignment"),
        ("front..points=5", "no assignment"),
        ("front.point=5", "front.point: unknown key; did you mean 'points'"),
        ("frnt.points=5", "frnt: unknown key; did you mean 'front'"),
        ("variables.2.lower=5", "variables.2: '2' is no item of a list of 2"),
        ("variables.x.lower=5", "variables.x: 'x' is no item"),
        ("name.x=5", "no keys"),
        ("structure.bay.x=5", "did you mean 'bays'"),
        ("front.points=five", "front.points: 'five' is no whole number"),
        ("front.points=[", "check the YAML"),
        ("variables.0.lower=30 Hz", "variables.0.lower: '30 Hz' has the wrong dimension"),
    ],
)
def test_a_broken_override_is_named(tmp_path, assignment, words):
    path = tmp_path / "study.yaml"
    path.write_text(EXAMPLE, encoding="utf-8")
    with pytest.raises(StudyError, match=words) as caught:
        load_study(path, [assignment])
    assert str(caught.value).startswith(f"--set {assignment}")


PSD = "frequency_hz,psd_urad^2/Hz\n1,2\n10,3\n\n100,4\n"


def with_files(folder: Path, psd: str = PSD, at: str = "sensor_noise") -> Path:
    text = EXAMPLE.replace(
        "filter: {type: high_pass, corner: 70 Hz, order: 1, density: 0.01 urad/sqrt(Hz)}", "psd: noise.csv"
    )
    text = text.replace("at: sensor_noise\n", f"at: {at}\n").replace("uniform: 0.1 %", "table: damping.csv")
    head, tail = text[: text.index("psd: noise")], text[text.index("psd: noise") :]
    (folder / "study.yaml").write_text(
        head + tail.replace("band: [0.1 Hz, 2 kHz]", "band: [1 Hz, 100 Hz]", 1)
    )
    (folder / "noise.csv").write_text(psd)
    (folder / "damping.csv").write_text("frequency_hz,damping_ratio\n0.5,0.001\n100,0.002\n")
    return folder / "study.yaml"


def test_side_files_are_read_beside_the_study(tmp_path):
    study = load_study(with_files(tmp_path))
    table = read_psd(study, study.disturbances[1])
    assert table.frequency == pytest.approx([2 * math.pi * f for f in (1, 10, 100)])
    assert table.psd == pytest.approx([2e-12, 3e-12, 4e-12])
    assert read_damping(study).damping_ratio == (0.001, 0.002)
    assert side_files(study) == (tmp_path / "noise.csv", tmp_path / "damping.csv")
    assert read_damping(
        parse_study(EXAMPLE.replace("uniform: 0.1 %", "table: [[1, .1], [2, .2]]"))
    ).frequency == (1.0, 2.0)


@pytest.mark.parametrize("unit", ["N m", "Nm", "(N m)"])
def test_a_torque_spectrum_has_the_unit_of_a_torque_squared(tmp_path, unit):
    study = load_study(with_files(tmp_path, f"frequency_hz,psd_{unit}^2/Hz\n1,2\n100,3\n", "hub_torque"))
    assert read_psd(study, study.disturbances[1]).psd == (2.0, 3.0)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("", ":1:1", "an empty file is not the header"),
        ("1,2\n2,3\n", ":1:1", "write frequency_hz,psd_rad"),
        ("frequency_hz,psd\n1,2\n100,3\n", ":1:14", "names no PSD"),
        ("frequency_hz,psd_N m^2/Hz\n1,2\n100,3\n", ":1:14", "names no PSD"),
        ("frequency_hz,psd_^2/Hz\n1,2\n100,3\n", ":1:14", "names no PSD"),
        ("frequency_hz,psd_rad^2/Hz\n1,2\n", ":2:1", "1 rows of numbers; at least 2"),
        ("frequency_hz,psd_rad^2/Hz\n1,2\n1,3\n", ":3:1", "'1' Hz is not above the row before"),
        ("frequency_hz,psd_rad^2/Hz\n0,2\n1,3\n", ":2:1", "positive frequency"),
        ("frequency_hz,psd_rad^2/Hz\n1,2\n10,-3\n", ":3:4", "'-3' is not a PSD of zero or more"),
        ("frequency_hz,psd_rad^2/Hz\n1,2\n10,nan\n", ":3:4", "'nan' is not"),
        ("frequency_hz,psd_rad^2/Hz\n1,2\n10,inf\n", ":3:4", "'inf' is not"),
        ("frequency_hz,psd_rad^2/Hz\n1,2\n10,x\n", ":3:4", "'x' is not"),
        ("frequency_hz,psd_rad^2/Hz\n1,2\n10\n", ":3:1", "1 columns"),
    ],
)
def test_a_broken_table_is_refused_with_its_line_and_column(tmp_path, text, place, words):
    with pytest.raises(StudyError, match=words) as caught:
        load_study(with_files(tmp_path, text))
    assert str(caught.value).startswith(f"{tmp_path / 'noise.csv'}{place}: ")
    assert "\n" not in str(caught.value)


def test_a_missing_table_or_one_too_short_for_the_band_is_the_study_files_error(tmp_path):
    path = with_files(tmp_path, "frequency_hz,psd_rad^2/Hz\n1,2\n10,3\n")
    with pytest.raises(
        StudyError,
        match=r"study.yaml:\d+:10: disturbances.1.psd: .*leaves the table, which covers 1 to 10 Hz",
    ):
        load_study(path)
    (tmp_path / "noise.csv").unlink()
    with pytest.raises(StudyError, match=r"study.yaml:\d+:10: disturbances.1.psd: .*noise.csv: no such file"):
        load_study(path)
    (tmp_path / "damping.csv").write_text("frequency_hz,zeta\n1,0.1\n2,0.1\n")
    with pytest.raises(StudyError, match=r"damping.csv:1:14: 'zeta' is not 'damping_ratio'"):
        load_study(path)
    (tmp_path / "damping.csv").write_text("frequency_hz,damping_ratio\n1,0.1\n2,1.1\n")
    with pytest.raises(
        StudyError, match=r"damping.csv:3:3: '1.1' is not a damping ratio of zero or more below 1"
    ):
        load_study(path)


def test_the_description_states_the_problem():
    text = "\n".join(describe_study(parse_study(EXAMPLE)))
    for line in (
        "minimize    structural_mass",
        "subject to  first_elastic_frequency ≥ 6 Hz",
        "20 ≤ area[k] ≤ 500 mm^2, start 66 mm^2, log scale, one per kind",
        "100 ≤ crossover ≤ 400 Hz, start 230 Hz",
        "rms 0.02 N m, over 0.1 to 2000 Hz",
    ):
        assert line in text
    text = "\n".join(describe_study(parse_study(TRUSS)))
    for line in (
        "natural_frequency[2] - natural_frequency[1] ≥ 1 Hz",
        "0 urad ≤ step_rms ≤ 2 urad",
        "H(s) = (1)/(1 s + 2) N m on white noise",
        "start 700 1/s",
        "from 2 values of the design",
        "required    jitter_total ≤ 100 urad",
        "case        kp alone: free kp",
        "held, bandwidth 0.1 Hz",
        "1 urad, judged from 50 to 100 ms",
    ):
        assert line in text


SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
WORDS = st.sampled_from(["1 Hz", "-1 mm^2", "all", "area", "total_mass", "pid", "held", "x", "type", "name"])
VALUES = st.recursive(
    SCALARS | WORDS,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5) | WORDS, inner, max_size=3)
    ),
    max_leaves=5,
)


def plain(text):
    return parse_study(text).model_dump(mode="json", exclude_none=True)


def paths(data, path=()):
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, inner in items:
        yield (*path, key)
        yield from paths(inner, (*path, key))


PLACES = [(text, path) for text in (EXAMPLE, TRUSS) for path in paths(plain(text))]


@given(st.sampled_from(PLACES), VALUES)
@example((TRUSS, ("structure", "bars")), "\x1f")
@example((TRUSS, ("structure", "nodes")), "\ud800")
@settings(max_examples=300, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_any_value_anywhere_loads_or_is_a_study_error(place, value):
    text, path = place
    data = node = plain(text)
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    loads_or_refuses(json.dumps(data))


@given(
    st.integers(0, len(EXAMPLE)),
    st.integers(0, 40),
    st.text(max_size=12) | st.text("[]{}:,&*!|>-#?%@'\" \n\t", max_size=12),
)
@settings(max_examples=300, deadline=None)
def test_any_damage_to_the_text_loads_or_is_a_study_error(start, length, piece):
    loads_or_refuses(EXAMPLE[:start] + piece + EXAMPLE[start + length :])


def loads_or_refuses(text):
    try:
        study = parse_study(text)
    except StudyError as error:
        assert str(error).isprintable()
    else:
        assert parse_study(dump_study(study)) == study
