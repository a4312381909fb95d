"""Formulas as functions, and problems: variables, their parameters, and metrics as CasADi functions."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import reference

from fosopt.control import (
    NUMERATORS,
    PID,
    Loop,
    Receptances,
    characteristic,
    closed_loop_response,
    loop_transfer,
)
from fosopt.errors import ModelError
from fosopt.expressions import parse_expression
from fosopt.problem import (
    Constraint,
    Definitions,
    ModeSelection,
    Problem,
    Variable,
    branched,
    design_parameters,
)
from fosopt.symbolic import (
    LOOP_PARAMETERS,
    Differentiable,
    loop_differential,
    loop_of,
    loop_parameters,
    response_function,
)

# Relative steps of the central differences: resonances are 1e-3 wide, so truncation needs steps far below that.
STEPS = (2e-4, 5e-5, 1.2e-5, 3e-6)


def case(seed, ki=None, boundary="pinned", rolloff_time=1e-4, percent=1.0, **options):
    of = reference.structure(boundary, 6)
    gains = {} if ki is None else {"ki": ki}
    loop = reference.loop_of(reference.mirror_of(of, percent), rolloff_time, **gains)
    return reference.system_and_design(boundary=boundary, bays=6, loop=loop, seed=seed, **options)


# --- formulas as functions

RESPONSES = (*NUMERATORS, "characteristic", "loop_transfer")
S = np.array([0.3 + 2j, -5 + 30j, 400j, 2000.0 + 1j])
G = Receptances(
    np.array([1e-3 + 2e-3j, -1e-2 + 1e-3j, 2e-6j + 1e-5, -1e-6 + 0j]),
    np.array([2e-3 - 1e-3j, 1e-3j, 1e-6 + 1e-6j, 3e-7 + 0j]),
)
LOOP = Loop(replace(reference.mirror_of(reference.structure(), 0.02)), PID(1300.0, 600.0, 5e4, 1.0, 2e-4))


def formula(name):
    others = {"characteristic": characteristic, "loop_transfer": loop_transfer}
    return others.get(name) or (lambda loop, s, g: closed_loop_response(name, loop, s, g))


@pytest.mark.parametrize("name", RESPONSES)
def test_numbers_and_symbols_give_the_same_transfer_functions(name):
    points = np.stack([S.real, S.imag, G.direct.real, G.direct.imag, G.cross.real, G.cross.imag])
    value = response_function(name)(loop_parameters(LOOP), points).full()
    expected = formula(name)(LOOP, S, G)
    assert np.abs(value[0] + 1j * value[1] - expected).max() <= 1e-13 * np.abs(expected).max()


@pytest.mark.parametrize("name", RESPONSES)
def test_differentials_of_transfer_functions_are_those_of_central_differences(name):
    one, i = np.ones(S.size), -1j * np.ones(S.size)
    real, imaginary = (loop_differential({name: w}, LOOP, S, G) for w in (one, i))
    f = formula(name)

    def difference(along):
        def parts(t):
            value = along(t)
            return np.concatenate([value.real, value.imag])

        expected, error = reference.plateau(parts, (1e-2, 3e-3, 1e-3))
        m = S.size
        return expected[:m] + 1j * expected[m:], error[:m] + error[m:]

    for k, part in enumerate(("direct", "cross")):
        size = np.abs(getattr(G, part))
        expected, error = difference(
            lambda t, part=part, size=size: f(LOOP, S, replace(G, **{part: getattr(G, part) + t * size}))
        )
        found = real.receptances[k] * size
        assert np.all(np.abs(found - expected) <= 1e-8 * np.abs(f(LOOP, S, G)) + 3 * error)
        assert np.allclose(imaginary.receptances[k], -1j * real.receptances[k], rtol=1e-12, atol=0)
    p = loop_parameters(LOOP)
    for i in range(len(LOOP_PARAMETERS)):
        unit = np.eye(p.size)[i] * p[i]
        expected, error = difference(lambda t, unit=unit: f(loop_of(p + t * unit), S, G))
        found = (real.parameters[i] + 1j * imaginary.parameters[i]) * p[i]
        bound = 1e-8 * np.abs(f(LOOP, S, G)).sum() + 3 * error.sum()
        assert abs(found - expected.sum()) <= bound


def test_the_differential_of_a_sum_is_the_sum_of_differentials():
    rng = np.random.default_rng(5)
    weights = {name: rng.normal(size=S.size) + 1j * rng.normal(size=S.size) for name in RESPONSES}
    together = loop_differential(weights, LOOP, S, G)
    parts = [loop_differential({name: w}, LOOP, S, G) for name, w in weights.items()]
    for what in ("receptances", "parameters"):
        each = [getattr(part, what) for part in parts]
        scale = sum(np.abs(x) for x in each)
        assert np.all(np.abs(getattr(together, what) - sum(each)) <= 1e-13 * scale)


def test_weights_count_at_the_point_they_belong_to():
    rng = np.random.default_rng(6)
    weight = rng.normal(size=S.size) + 1j * rng.normal(size=S.size)
    name = RESPONSES[0]
    together = loop_differential({name: weight}, LOOP, S, G)
    for k in range(S.size):
        at = Receptances(G.direct[k : k + 1], G.cross[k : k + 1])
        alone = loop_differential({name: weight[k : k + 1]}, LOOP, S[k : k + 1], at)
        assert np.allclose(together.receptances[:, k], alone.receptances[:, 0], rtol=1e-12, atol=0)


def test_an_unknown_transfer_function_is_refused_with_the_nearest_name():
    with pytest.raises(ModelError, match="did you mean 'hub_torque'"):
        response_function("hub_torqe")


def test_loop_parameters_come_back_from_the_loop_they_make():
    assert loop_of(loop_parameters(LOOP)) == LOOP


def test_a_differentiable_formula_gives_its_jacobian():
    f = Differentiable(lambda x: ca.vertcat(x[0] ** 2 * x[1], 3 * x[1]), 2)
    value, jacobian = f(np.array([2.0, 5.0]))
    assert value == pytest.approx([20.0, 15.0])
    assert np.array_equal(jacobian, [[20.0, 4.0], [0.0, 3.0]])


# --- problems


def variable(quantity, low, start, high, groups=(), **given):
    size = max(len(groups), 1)
    values = (np.full(size, v, dtype=float) for v in (low, high, start))
    return Variable(given.pop("name", quantity), quantity, *values, groups=groups, **given)


def problem(*variables, definitions=Definitions(), objectives=("structural_mass",), **options):  # noqa: B008
    system, design = case(1, **options)
    parsed = tuple(parse_expression(text) for text in objectives)
    return Problem(system, design, tuple(variables), parsed, definitions=definitions)


def everything():
    areas = tuple((i, i + 1, i + 2) for i in range(0, 15, 3))
    return (
        variable("area", 1e-5, 8e-5, 5e-4, areas),
        variable("batten_mass", 1.0, 4.0, 9.0, ((0, 1, 2), (4, 5, 6))),
        variable("mirror_inertia_ratio", 1e-4, 5e-3, 0.1),
        variable("mirror_frequency", 10.0, 120.0, 500.0),
        variable("crossover", 100.0, 1400.0, 3000.0),
        variable("kp", 60.0, 600.0, 6000.0),
        variable("ki", 500.0, 5e4, 5e5),
        variable("kd", 0.1, 1.0, 9.0),
    )


def test_variables_set_the_parameters_they_name_and_leave_the_others():
    p = problem(variable("area", 1e-5, 8e-5, 5e-4, ((0, 3), (1,))), variable("kp", 60.0, 700.0, 6000.0))
    x = np.array([1e-4, 2e-4, 650.0])
    design = p.design(x)
    assert design.area[[0, 3, 1]] == pytest.approx([1e-4, 1e-4, 2e-4])
    others = np.delete(np.arange(design.area.size), [0, 1, 3])
    assert np.array_equal(design.area[others], p.base.area[others])
    assert np.array_equal(design.batten_mass, p.base.batten_mass)
    assert design.loop.controller.kp == 650.0
    assert (
        replace(design.loop, controller=replace(design.loop.controller, kp=p.base.loop.controller.kp))
        == p.base.loop
    )
    assert p.size == 3
    assert p.values(x)["area"] == pytest.approx([1e-4, 2e-4])
    assert p.vector({"kp": 99.0})[-1] == 99.0
    assert [b[0] for b in p.bounds] == [1e-5, 5e-4]


def test_an_inertia_ratio_and_a_crossover_follow_the_structure():
    p = problem(*everything())
    x = p.start
    evaluation = p.evaluate(x)
    assert evaluation.value("inertia_ratio") == pytest.approx(5e-3, rel=1e-12, abs=0)
    rigid = Receptances(0.0, 0.0)
    assert abs(loop_transfer(evaluation.design.loop, 1400j, rigid)) == pytest.approx(1.0, rel=1e-12, abs=0)
    defined = problem(everything()[0], definitions=Definitions(inertia_ratio=5e-3, crossover=1400.0))
    design = defined.design(defined.start)
    assert abs(loop_transfer(design.loop, 1400j, rigid)) == pytest.approx(1.0, rel=1e-12, abs=0)
    assert defined.evaluate(defined.start).value("inertia_ratio") == pytest.approx(5e-3, rel=1e-12, abs=0)
    gain = problem(variable("gain", 1.0, 50.0, 99.0), definitions=Definitions(crossover=1400.0))
    assert gain.design(gain.start).loop.controller.gain == 50.0


def test_the_parameter_jacobian_is_that_of_central_differences():
    p = problem(*everything())
    x = p.start
    jacobian = p.parameter_jacobian(x)
    for i in range(p.size):
        unit = np.eye(p.size)[i] * x[i]

        def along(t, unit=unit):
            return np.asarray(design_parameters(p.system, p.base, p.definitions, p.variables, x + t * unit))

        expected, error = reference.plateau(along, (1e-2, 3e-3, 1e-3))
        size = np.abs(along(0.0))
        assert np.all(np.abs(jacobian @ unit - expected) <= 1e-9 * size + 3 * error)


def test_metrics_as_a_casadi_function_have_the_jacobian_of_central_differences():
    p = problem(*everything())
    names = (
        "jitter_total",
        "2 * structural_mass + log(modulus_margin) * kp / 600",
        "area[2] * loop_crossover",
    )
    f = p.metric_function(*names)
    x = p.start
    symbol = ca.MX.sym("x", p.size)
    # Composed with other expressions, as a user would.
    scaled = ca.Function("scaled", [symbol], [ca.jacobian(ca.sqrt(f(symbol)), symbol)])
    values = f(x).full().ravel()
    jacobian = scaled(x).full() * 2 * np.sqrt(values)[:, None]
    evaluation = p.evaluate(x)
    assert values[0] == evaluation.value("jitter_total")
    mass, margin = evaluation.value("structural_mass"), evaluation.value("modulus_margin")
    assert values[1] == pytest.approx(2 * mass + np.log(margin), rel=1e-14, abs=0)
    rng = np.random.default_rng(0)
    for unit in (x * rng.normal(size=x.size) for _ in range(3)):

        def along(t, unit=unit):
            return f(x + t * unit).full().ravel()

        expected, error = reference.plateau(along, STEPS[1:])
        allowed = 1e-6 * np.abs(expected) + 3 * error + 1e-8 * values
        assert np.all(np.abs(jacobian @ unit - expected) <= allowed)


def test_a_problem_that_contradicts_itself_is_refused():
    kp = variable("kp", 60.0, 600.0, 6000.0)
    for make, message in (
        (lambda: problem(kp, kp), "are not unique"),
        (lambda: problem(variable("gain", 1, 2, 3), variable("crossover", 1, 2, 3)), "set the same thing"),
        (lambda: problem(kp, objectives=("structural_mas",)), "did you mean 'structural_mass'"),
        (lambda: problem(kp).vector({"kq": 1.0}), "variable 'kq' does not exist; known: kp"),
        (lambda: problem(kp).vector({"kp": [1.0, 2.0]}), "has 1 values, 2 were given"),
        (lambda: problem(*everything()).metric_function("area"), r"write area\[1\] to area\[5\]"),
        (lambda: variable("kp", 3.0, 2.0, 1.0), "the lower must be below the upper"),
        (lambda: variable("kp", 1.0, 9.0, 3.0), "start 9 lies outside 1 to 3"),
        (lambda: variable("kp", 0.0, 1.0, 3.0), "lower bound 0 is not positive"),
        (lambda: Constraint(parse_expression("kp")), "leave nothing or everything"),
        (lambda: Constraint(parse_expression("kp"), 2.0, 1.0), "leave nothing or everything"),
    ):
        with pytest.raises(ModelError, match=message):
            make()


def test_a_bound_that_holds_for_all_branches_if_it_holds_for_the_outermost_is_recognized():
    frequency, margin, decay, other, twice = (
        parse_expression(text)
        for text in (
            "first_elastic_frequency",
            "modulus_margin",
            "spectral_abscissa",
            "jitter_total",
            "2 * modulus_margin",
        )
    )
    assert branched(Constraint(frequency, lower=1.0)) == "first_elastic_frequency"
    assert branched(Constraint(margin, lower=0.5)) == "modulus_margin"
    assert branched(Constraint(decay, upper=-0.1)) == "spectral_abscissa"
    assert branched(Constraint(frequency, upper=1.0)) is None
    assert branched(Constraint(margin, lower=0.5, upper=0.9)) is None
    assert branched(Constraint(decay, lower=-1.0)) is None
    assert branched(Constraint(twice, lower=1.0)) is None
    assert branched(Constraint(other, lower=1.0)) is None


def test_problems_evaluate_on_the_truth_model_when_asked():
    p = problem(variable("kp", 60.0, 600.0, 6000.0), selection=ModeSelection(count=8))
    assert p.evaluate(p.start).modes.natural_frequency.size == 8
    assert p.evaluate(p.start, truth=True).modes.natural_frequency.size == 19
    assert p.evaluate(p.start, shift=1.0).shift == 1.0
