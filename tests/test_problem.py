"""A co-design problem as data: its rules, its parameter map and its oracle."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import casadi as ca
import numpy as np
import pytest
from reference import HZ, plateau, structure
from small_problems import areas_by_kind, expressions, limit, truss_problem, variable

from fosopt.errors import ModelError, UnstableError
from fosopt.expressions import parse_expression
from fosopt.metrics.step import StepCommand
from fosopt.problem import Definitions, ModeSelection, Problem, Rows, branched
from fosopt.symbolic import LOOP_PARAMETERS

# Sums of a few dozen products in another order.
ROUNDING = 1e-12
# Differences of a step h lose eps/h to rounding, of their fourth order h⁴ to truncation.
STEPS = (1e-2, 3e-3, 1e-3, 3e-4)
SLOPE = 1e-7


@pytest.fixture(scope="module")
def problem() -> Problem:
    return truss_problem()


def loop_of(problem: Problem, x: np.ndarray) -> dict[str, float]:
    """Loop parameters by name at a point."""
    return dict(zip(LOOP_PARAMETERS, problem.design(x).parameters[-len(LOOP_PARAMETERS) :], strict=True))


def rigid_loop_gain(loop: dict[str, float], frequency: float) -> float:
    """|K G| of the mirror on a rigid support, by complex arithmetic."""
    s, time = 1j * frequency, loop["rolloff_time"]
    control = loop["gain"] * (loop["kp"] + loop["ki"] / s + loop["kd"] * s / (1 + time * s))
    w, zeta = loop["mirror_frequency"], loop["mirror_damping_ratio"]
    return abs(control / (loop["mirror_inertia"] * (s**2 + 2 * zeta * w * s + w**2)))


# ---- rules ----


@pytest.mark.parametrize(
    ("lower", "upper", "start", "log", "rule"),
    [
        (2.0, 1.0, 1.5, True, "the lower must be below the upper"),
        (1.0, 1.0, 1.0, True, "the lower must be below the upper"),
        (1.0, inf, 2.0, True, "the lower must be below the upper"),
        (1.0, 2.0, 2.5, True, "start 2.5 lies outside 1 to 2"),
        (1.0, 2.0, 0.5, False, "start 0.5 lies outside 1 to 2"),
        (1.0, 2.0, float("nan"), False, "lies outside"),
        (0.0, 2.0, 1.0, True, "is not positive; raise it or use a linear scale"),
    ],
)
def test_a_variable_refuses_bounds_and_starts_that_make_no_sense(lower, upper, start, log, rule):
    with pytest.raises(ModelError, match=rule):
        variable("kp", lower, upper, start, log=log)


def test_a_linear_variable_may_reach_zero_and_below():
    assert variable("kp", -1.0, 2.0, 0.0, log=False).size == 1


def test_one_bad_group_of_many_is_refused():
    with pytest.raises(ModelError, match="start 9 lies outside 1 to 2"):
        variable("area", [1, 1], [2, 2], [1, 9], groups=((0,), (1,)))


@pytest.mark.parametrize(("lower", "upper"), [(-inf, inf), (2.0, 1.0), (float("nan"), 1.0)])
def test_a_constraint_needs_a_bound_and_its_bounds_in_order(lower, upper):
    with pytest.raises(ModelError, match="constraint 'structural_mass': bounds"):
        limit("structural_mass", lower, upper)


def test_a_constraint_may_fix_a_value_and_is_named_by_its_text():
    assert limit("structural_mass/2", 3.0, 3.0).name == "structural_mass/2"


@pytest.mark.parametrize(
    ("first", "second"), [("gain", "crossover"), ("mirror_inertia", "mirror_inertia_ratio")]
)
def test_two_variables_that_set_the_same_thing_are_refused(problem, first, second):
    pair = (variable(first, 1, 3, 2), variable(second, 1, 3, 2))
    with pytest.raises(ModelError, match=f"'{first}' and '{second}' set the same thing"):
        replace(problem, variables=pair)


def test_two_variables_of_one_name_are_refused(problem):
    twice = (variable("kp", 1, 3, 2), variable("kp", 1, 3, 2, quantity="ki"))
    with pytest.raises(ModelError, match=r"\['kp', 'kp'\] are not unique"):
        replace(problem, variables=twice)


@pytest.mark.parametrize(
    "change",
    [{"objectives": expressions("jiter_total")}, {"constraints": (limit("2*jiter_total", upper=1.0),)}],
    ids=["objective", "constraint"],
)
def test_an_unknown_metric_is_refused_with_its_nearest_neighbor(problem, change):
    with pytest.raises(ModelError, match="'jiter_total' does not exist; did you mean 'jitter_total'"):
        replace(problem, **change)


def test_a_metric_of_a_step_needs_a_step_command(problem):
    with pytest.raises(ModelError, match="step_rms"):
        replace(problem, objectives=expressions("step_rms"))
    stepped = replace(problem.system, step=StepCommand(1e-6, (0.05, 0.1)))
    assert replace(problem, system=stepped, objectives=expressions("step_rms")).size == problem.size


@pytest.mark.parametrize(
    ("constraint", "metric"),
    [
        (limit("first_elastic_frequency", lower=1.0), "first_elastic_frequency"),
        (limit("modulus_margin", lower=0.5), "modulus_margin"),
        (limit("modulus_margin", lower=0.5, upper=1.0), None),
        (limit("spectral_abscissa", upper=-0.5), "spectral_abscissa"),
        (limit("spectral_abscissa", lower=-0.5), None),
        (limit("spectral_abscissa", lower=-1.0, upper=-0.5), None),
        (limit("modulus_margin", upper=0.5), None),
        (limit("2*modulus_margin", lower=0.5), None),
        (limit("structural_mass", lower=0.5), None),
        (limit("structure_frequency[1]", lower=0.5), None),
    ],
    ids=lambda value: value.name if hasattr(value, "name") else str(value),
)
def test_only_what_holds_for_every_branch_enters_branch_by_branch(constraint, metric):
    assert branched(constraint) == metric


# ---- the parameter map ----


def test_groups_set_their_members_and_all_other_members_keep_their_values(problem):
    of = problem.system.structure
    base = replace(problem.base, area=of.area * np.linspace(0.8, 1.2, of.area.size))
    only = variable("area", 1e-5, 1e-3, 1e-4, groups=((0, 4),))
    heavy = variable("root", 1, 9, 3, quantity="batten_mass", groups=((0, 2),))
    few = replace(problem, base=base, variables=(only, heavy))
    design = few.design(np.array([2e-4, 5.0]))
    expected = base.area.copy()
    expected[[0, 4]] = 2e-4
    np.testing.assert_array_equal(design.area, expected)
    expected = base.batten_mass.copy()
    expected[[0, 2]] = 5.0
    np.testing.assert_array_equal(design.batten_mass, expected)


def test_two_area_variables_each_set_their_own_members(problem):
    pair = tuple(
        variable(f"area_{i}", 1e-5, 1e-3, 1e-4, quantity="area", groups=((i,),), log=bool(i))
        for i in range(2)
    )
    design = replace(problem, variables=pair).design(np.array([2e-4, 3e-4]))
    np.testing.assert_array_equal(design.area[:2], [2e-4, 3e-4])
    np.testing.assert_array_equal(design.area[2:], problem.base.area[2:])


def test_the_mirror_inertia_follows_the_structure_by_the_inertia_ratio(problem):
    x = problem.vector({"area": [1e-4, 3e-5]})
    truss, design = problem.system.structure.truss, problem.design(x)
    nodes = {name: np.array(xyz) for name, xyz in truss.nodes.items()}
    # About the hub at the origin: rods by their ends, battens by their center and own inertia.
    inertia = 0.0
    for bar, area in zip(truss.bars, design.area, strict=True):
        p, q = (nodes[name] for name in bar.nodes)
        inertia += bar.density * area * np.linalg.norm(q - p) * (p @ p + q @ q + p @ q) / 3
    for batten in truss.battens:
        center = np.mean([nodes[name] for name in batten.nodes], axis=0)
        inertia += batten.mass * center @ center + batten.inertia
    assert loop_of(problem, x)["mirror_inertia"] == pytest.approx(0.002 * inertia, rel=ROUNDING)


def test_a_variable_beats_what_is_defined_to_follow(problem):
    x = problem.start
    ratio = replace(problem, variables=(variable("mirror_inertia_ratio", 1e-4, 1, 0.01),))
    assert loop_of(ratio, np.array([0.01]))["mirror_inertia"] == pytest.approx(
        5 * loop_of(problem, x)["mirror_inertia"], rel=ROUNDING
    )
    inertia = replace(problem, variables=(variable("mirror_inertia", 0.1, 1, 0.5),))
    assert loop_of(inertia, np.array([0.7]))["mirror_inertia"] == 0.7
    gain = replace(problem, variables=(variable("gain", 1, 9, 2),))
    assert loop_of(gain, np.array([3.0]))["gain"] == 3.0


def test_without_definitions_mirror_and_gain_keep_their_values(problem):
    bare = replace(problem, definitions=Definitions(), variables=problem.variables[:1])
    x = bare.start * 2
    assert loop_of(bare, x) == loop_of(replace(bare, variables=()), np.zeros(0))
    np.testing.assert_allclose(bare.design(x).area, problem.base.area * 2, rtol=ROUNDING)


@pytest.mark.parametrize("rolloff_time", [0.0, 3e-4])
@pytest.mark.parametrize("name", ["area", "crossover", "kp", "ki"])
def test_the_gain_follows_so_that_the_rigid_loop_crosses_unity_at_the_crossover(problem, name, rolloff_time):
    pid = replace(problem.base.loop.controller, rolloff_time=rolloff_time)
    rolled = replace(problem, base=replace(problem.base, loop=replace(problem.base.loop, controller=pid)))
    x = rolled.start.copy()
    x[rolled.slices()[name]] *= 1.7
    loop = loop_of(rolled, x)
    crossover = float(rolled.values(x)["crossover"][0])
    assert rigid_loop_gain(loop, crossover) == pytest.approx(1.0, rel=ROUNDING)
    assert rigid_loop_gain(loop, 1.3 * crossover) < 1 < rigid_loop_gain(loop, crossover / 1.3)


def test_a_defined_crossover_holds_the_gain_where_it_is_no_variable(problem):
    fixed = replace(problem, variables=problem.variables[:1])
    assert rigid_loop_gain(loop_of(fixed, fixed.start * 0.5), 100 * HZ) == pytest.approx(1, rel=ROUNDING)


def test_the_jacobian_of_the_parameters_is_their_difference(problem):
    x = problem.start
    for i in range(x.size):
        unit = np.eye(x.size)[i] * x[i]
        slope, error = plateau(lambda h, unit=unit: problem.design(x + h * unit).parameters, STEPS)
        size = np.abs(problem.design(x).parameters)
        found = problem.parameter_jacobian(x)[:, i] * x[i]
        assert np.all(np.abs(found - slope) <= 10 * error + ROUNDING * size + SLOPE * np.abs(slope))


def test_parameters_make_the_design_they_came_from(problem):
    design = problem.design(problem.start * 1.1)
    again = problem.base.with_parameters(design.parameters)
    np.testing.assert_array_equal(again.parameters, design.parameters)
    assert again.mirror_mass == problem.base.mirror_mass


# ---- the vector of variables ----


def test_values_and_vector_are_inverse(problem):
    x = problem.start * np.linspace(0.9, 1.1, problem.size)
    np.testing.assert_array_equal(problem.vector(problem.values(x)), x)
    assert {name: part.stop - part.start for name, part in problem.slices().items()} == {
        "area": 2,
        "crossover": 1,
        "kp": 1,
        "ki": 1,
    }


def test_a_vector_keeps_the_start_of_what_is_not_named_and_spreads_a_single_value(problem):
    x = problem.vector({"area": 1e-4, "ki": 7e4})
    np.testing.assert_array_equal(x, [1e-4, 1e-4, problem.start[2], problem.start[3], 7e4])
    assert problem.start[0] != 1e-4, "the start itself must stay as it was"


def test_a_vector_refuses_unknown_names_and_wrong_numbers_of_values(problem):
    with pytest.raises(ModelError, match="variable 'crosover' does not exist; did you mean 'crossover'"):
        problem.vector({"crosover": 1.0})
    with pytest.raises(ModelError, match="variable 'area' has 2 values, 3 were given"):
        problem.vector({"area": [1e-4] * 3})


def test_bounds_and_start_of_the_problem_are_those_of_its_variables_in_order(problem):
    lower, upper = problem.bounds
    np.testing.assert_array_equal(lower, [13e-6, 13e-6, 20 * HZ, 10, 100])
    np.testing.assert_array_equal(upper, [330e-6, 330e-6, 500 * HZ, 6000, 5e6])
    assert problem.size == problem.start.size == 5


@pytest.mark.parametrize(
    ("quantity", "discipline"),
    [
        ("area", "structure"),
        ("batten_mass", "structure"),
        ("spring_stiffness", "structure"),
        ("mirror_inertia", "control"),
        ("kp", "control"),
    ],
)
def test_what_members_have_belongs_to_the_structure_all_else_to_the_loop(quantity, discipline):
    assert variable(quantity, 1, 3, 2).discipline == discipline


# ---- the oracle ----


def test_a_row_of_metrics_and_variables_is_their_arithmetic_with_the_exact_gradient(problem):
    x = problem.start
    rows = Rows(problem, expressions("structural_mass + 2*kp*area[2]", "log(jitter_total)/ki", "3"))
    value, jacobian = rows(x, problem.evaluate(x))
    evaluation = problem.evaluate(x)
    mass, jitter = evaluation.value("structural_mass"), evaluation.value("jitter_total")
    area, kp, ki = x[1], x[3], x[4]
    np.testing.assert_allclose(value, [mass + 2 * kp * area, np.log(jitter) / ki, 3.0], rtol=ROUNDING)
    for i in range(x.size):
        unit = np.eye(x.size)[i] * x[i]

        def along(h: float, unit: np.ndarray = unit) -> np.ndarray:
            return rows(x + h * unit, problem.evaluate(x + h * unit))[0]

        slope, error = plateau(along, STEPS)
        assert np.all(np.abs(jacobian[:, i] * x[i] - slope) <= 10 * error + SLOPE * np.abs(slope) + 1e-18)


@pytest.mark.parametrize("text", ["area", "area[3]", "kp[2]"])
def test_a_variable_is_named_with_an_index_that_it_has(problem, text):
    with pytest.raises(ModelError, match=r"has \d values; write"):
        Rows(problem, (parse_expression(text),))


def test_a_single_value_may_be_named_with_or_without_its_index(problem):
    x = problem.start
    both = Rows(problem, expressions("kp", "kp[1]"))(x, problem.evaluate(x))
    assert both[0].tolist() == [600.0, 600.0]
    np.testing.assert_array_equal(both[1][0], both[1][1])


def test_metrics_as_a_casadi_function_are_those_of_the_evaluation(problem):
    names = ("structural_mass", "jitter_total", "first_elastic_frequency", "modulus_margin")
    f = problem.metric_function(*names)
    x = problem.start * 1.05
    evaluation = problem.evaluate(x)
    np.testing.assert_allclose(f(x).full().ravel(), [evaluation.value(name) for name in names], rtol=ROUNDING)


def test_a_composed_casadi_expression_has_the_chain_rule_of_the_oracle(problem):
    f = problem.metric_function("structural_mass", "jitter_total")
    z = ca.MX.sym("z", problem.size)
    m = f(z)
    own = ca.Function("own", [z], [ca.gradient(m[0] * ca.log(m[1]), z)])
    x = problem.start
    evaluation, by_parameter = problem.evaluate(x), problem.parameter_jacobian(x)
    (mass, by_mass), (jitter, by_jitter) = map(evaluation.metric, ("structural_mass", "jitter_total"))
    expected = (np.log(jitter) * by_mass + mass / jitter * by_jitter) @ by_parameter
    np.testing.assert_allclose(own(x).full().ravel(), expected, rtol=1e-10)


def test_a_metric_function_refuses_an_unknown_metric(problem):
    f = problem.metric_function("structural_mas")
    with pytest.raises(Exception, match="structural_mas"):
        f(problem.start)


def test_the_truth_model_has_all_modes_whatever_the_design_model_keeps(problem):
    few = replace(problem, system=replace(problem.system, selection=ModeSelection(count=3)))
    assert few.evaluate(few.start).modes.natural_frequency.size == 3
    truth = few.evaluate(few.start, truth=True)
    assert truth.modes.natural_frequency.size == truth.frame.eigenvalue.size > 3


def test_a_shift_reaches_the_evaluation(problem):
    x = problem.start
    plain, shifted = problem.evaluate(x), problem.evaluate(x, shift=5.0)
    assert shifted.value("jitter_total") < plain.value("jitter_total")


def test_an_unstable_design_has_no_row_of_jitter():
    unstable = truss_problem(bays=20, percent=10, crossover=230 * HZ, damping=0.001)
    x = unstable.start
    with pytest.raises(UnstableError, match="closed loop is unstable"):
        Rows(unstable, expressions("jitter_total"))(x, unstable.evaluate(x))


@pytest.mark.parametrize(
    ("selection", "kept"),
    [
        (ModeSelection(), [0, 1, 2, 3]),
        (ModeSelection(count=2), [0, 1]),
        (ModeSelection(below=25.0), [0, 1]),
        (ModeSelection(below=20.0), [0]),
        (ModeSelection(keep=(3, 1, 1)), [1, 3]),
    ],
)
def test_a_selection_keeps_the_modes_it_names(selection, kept):
    assert selection.of(np.array([0.0, 20.0, 30.0, 40.0])).tolist() == kept


@pytest.mark.parametrize(
    "selection", [ModeSelection(count=5), ModeSelection(below=0.0), ModeSelection(keep=(-1,))]
)
def test_a_selection_of_no_mode_or_of_one_that_does_not_exist_is_refused(selection):
    with pytest.raises(ModelError, match="choose between 1 and 4"):
        selection.of(np.array([0.0, 20.0, 30.0, 40.0]))


def test_bars_of_a_kind_without_a_variable_keep_their_areas():
    of = structure("pinned", 3)
    by_kind = areas_by_kind(of)
    longerons = replace(
        by_kind,
        groups=by_kind.groups[:1],
        labels=by_kind.labels[:1],
        **{name: getattr(by_kind, name)[:1] for name in ("lower", "upper", "start")},
    )
    some = replace(truss_problem(), variables=(longerons,))
    area = some.design(np.array([1e-4])).area
    diagonals = list(by_kind.groups[1])
    np.testing.assert_array_equal(area[diagonals], of.area[diagonals])
