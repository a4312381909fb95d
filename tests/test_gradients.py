"""Gradients of every metric against central differences, at ordinary designs and where modes cross."""

from __future__ import annotations

from dataclasses import replace
from math import inf

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
from fosopt.errors import ModelError, SolverError, UnstableError
from fosopt.expressions import parse_expression
from fosopt.metrics.disturbances import Disturbance, ShapingFilter
from fosopt.metrics.step import StepCommand
from fosopt.modes import Damping, Hub
from fosopt.problem import (
    Constraint,
    Definitions,
    Design,
    Evaluation,
    ModeSelection,
    Problem,
    System,
    Variable,
    branched,
    design_parameters,
)
from fosopt.structure import assemble, barker_truss
from fosopt.symbolic import (
    LOOP_PARAMETERS,
    Differentiable,
    loop_of,
    loop_parameters,
    response_function,
    response_partials,
)

HZ = reference.HZ
COOLING, AFT_BODY, AIR, SENSOR = reference.DISTURBANCES

# Relative steps of the central differences: resonances are 1e-3 wide, so truncation needs steps far below that.
STEPS = (2e-4, 5e-5, 1.2e-5, 3e-6)

INDEXED = (
    ("structure_frequency", 3),
    ("modal_inertia", 2),
    ("modal_inertia", 3),
    ("natural_frequency", 2),
    ("natural_frequency", 5),
    ("natural_frequency", 9),
    ("modal_reaction_inertia", 7),
    ("effective_modal_reaction_inertia", 3),
    ("effective_modal_reaction_inertia", 5),
    ("pole_zero_separation", 4),
    ("pole_zero_separation", 9),
    ("participation", 3),
)
OWN = tuple(r for r in INDEXED if r[0] in ("structure_frequency", "modal_inertia"))
TABLE = Disturbance(
    "table", "hub_torque", frequency=np.array([10.0, 100.0, 3000.0]), psd=np.array([1e-2, 3e-2, 0.0])
)

TABLE_DAMPING = Damping((0.001, 0.02), (10.0, 3000.0))
# A step command costs most of an evaluation; these leave it out.
NO_STEP = {"step": None}
CONFIGURATIONS = {
    "reference": ({}, INDEXED),
    "ideal derivative": ({"rolloff_time": 0.0}, ()),
    "without integral": ({"ki": 0.0}, ()),
    "lowest modes": ({"selection": ModeSelection(count=8)}, OWN),
    "free hub": (NO_STEP | {"hub": Hub("free"), "disturbances": (AIR, SENSOR)}, INDEXED),
    "fixed hub": (
        NO_STEP | {"boundary": "fixed", "hub": Hub("fixed"), "disturbances": (COOLING, AIR, SENSOR)},
        INDEXED,
    ),
    # Here the rightmost pole is all but cancelled. Gradients of J̄ lose as many digits as the separation has zeros.
    "hardly coupled": (
        NO_STEP | {"percent": 1e-9, "disturbances": ()},
        tuple(r for r in INDEXED if "reaction" not in r[0]),
    ),
    "chosen modes": (NO_STEP | {"selection": ModeSelection(keep=(0, 1, 2, 5, 7))}, OWN),
    "without the rigid mode": (NO_STEP | {"selection": ModeSelection(keep=(1, 2, 3))}, OWN),
    "table damping": (NO_STEP | {"damping": TABLE_DAMPING}, ()),
    "damping per mode": (NO_STEP | {"damping": Damping(tuple(0.001 * (1 + k % 3) for k in range(30)))}, ()),
    "table damping, lowest modes": (
        NO_STEP | {"damping": TABLE_DAMPING, "selection": ModeSelection(count=8)},
        (),
    ),
    "bands": (
        NO_STEP
        | {
            "disturbances": (
                replace(COOLING, band=(1.0, 500.0)),
                replace(AFT_BODY, band=(3.0, inf)),
                TABLE,
                replace(AIR, filter=ShapingFilter((1e-3,), (1.0, 60.0, 900.0))),
            )
        },
        (),
    ),
}


def case(seed, ki=None, boundary="pinned", rolloff_time=1e-4, percent=1.0, **options):
    of = reference.structure(boundary, 6)
    gains = {} if ki is None else {"ki": ki}
    loop = reference.loop_of(reference.mirror_of(of, percent), rolloff_time, **gains)
    return reference.system_and_design(boundary=boundary, bays=6, loop=loop, seed=seed, **options)


def directions(design, rng, apart=False):
    """Random relative changes of areas, of batten masses and of the loop, its parameters together or apart."""
    p = design.parameters
    b, r = design.area.size, design.batten_mass.size
    loop = [slice(i, i + 1) for i in range(b + r, p.size)] if apart else [slice(b + r, p.size)]
    found = []
    for part in (slice(0, b), slice(b, b + r), *loop):
        direction = np.zeros(p.size)
        direction[part] = p[part] * rng.normal(size=p[part].size)
        if direction.any():
            found.append(direction)
    return found


def check(system, design, references, rng, steps=STEPS, apart=False):
    evaluation = Evaluation(system, design)
    assert evaluation.stable
    base = design.parameters
    values, gradients = zip(*(evaluation.metric(*r) for r in references), strict=True)
    for direction in directions(design, rng, apart):

        def along(t, direction=direction):
            moved = Evaluation(system, design.with_parameters(base + t * direction))
            return np.array([moved.value(*r) for r in references])

        expected, error = reference.plateau(along, steps)
        found = np.array([gradient @ direction for gradient in gradients])
        # Differences admit their own error; a derivative that is small against its value is known to 1e-8 of it.
        allowed = 1e-6 * np.abs(expected) + 3 * error + 1e-8 * np.abs(values)
        wrong = np.flatnonzero(~(np.abs(found - expected) <= allowed))
        assert not wrong.size, [
            (references[i], *map(float, (found[i], expected[i], error[i]))) for i in wrong
        ]


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_gradients_of_all_metrics_are_those_of_central_differences(name):
    options, indexed = CONFIGURATIONS[name]
    seed = 1 + list(CONFIGURATIONS).index(name)
    system, design = case(seed, **options)
    references = [(name, None) for name in system.metric_names] + list(indexed)
    check(system, design, references, np.random.default_rng(seed))


def test_gradients_for_each_loop_parameter_are_those_of_central_differences():
    system, design = case(20, step=None)
    references = [(name, None) for name in system.metric_names] + list(INDEXED)
    check(system, design, references, np.random.default_rng(20), STEPS[1:], apart=True)


def test_gradients_at_the_full_order_of_the_dissertation_are_those_of_central_differences():
    system, design = reference.system_and_design(seed=3, step=None)
    names = ("jitter_total", "modulus_margin", "loop_crossover", "spectral_abscissa")
    check(system, design, [(name, None) for name in names], np.random.default_rng(3), STEPS[1:])


def test_the_gradient_of_shifted_jitter_of_an_unstable_loop_is_that_of_central_differences():
    system, design = reference.system_and_design(percent=2.0, selection=ModeSelection(count=7))
    base, shift = design.parameters, 1.0
    with pytest.raises(UnstableError):
        Evaluation(system, design).value("jitter_total")
    _, gradient = Evaluation(system, design, shift).metric("jitter_total")
    for direction in directions(design, np.random.default_rng(0)):

        def along(t, direction=direction):
            moved = design.with_parameters(base + t * direction)
            return np.array([Evaluation(system, moved, shift).value("jitter_total")])

        expected, error = reference.plateau(along, STEPS)
        assert gradient @ direction == pytest.approx(expected[0], rel=1e-6, abs=3 * error[0])


def test_the_branches_of_a_minimum_have_their_own_gradients():
    system, design = case(1)
    base = design.parameters
    evaluation = Evaluation(system, design)
    direction = directions(design, np.random.default_rng(1))[0]
    for name in ("first_elastic_frequency", "modulus_margin"):
        branches = evaluation.branches(name)
        assert len(branches) == {"first_elastic_frequency": 4, "modulus_margin": 6}[name]
        assert branches[0][0] == evaluation.value(name)

        def along(t, name=name):
            moved = Evaluation(system, design.with_parameters(base + t * direction))
            return np.array([value for value, _ in moved.branches(name)])

        expected, error = reference.plateau(along, STEPS)
        found = np.array([gradient @ direction for _, gradient in branches])
        assert np.all(np.abs(found - expected) <= 1e-6 * np.abs(expected) + 3 * error + 1e-9)
    assert evaluation.branches("jitter_total") == [evaluation.metric("jitter_total")]


def test_a_mode_the_loop_does_not_see_gives_the_gradient_of_its_own_decay():
    # A mast that the mirror bends in one direction only; the other is rightmost and stays where it is.
    structure = assemble(reference.square_mast(stretch=2.0), "tip")
    mirror = replace(reference.mirror_of(reference.structure(), 0.2), inertia=0.02)
    damping = Damping((0.001, 0.02), (10.0, 3000.0))
    system = System(structure, "tip", Hub("fixed"), damping, (COOLING,))
    design = Design(structure.area, structure.batten_mass, 50.0, reference.loop_of(mirror))
    evaluation = Evaluation(system, design)
    modes = evaluation.modes
    slow = int(np.argmin(modes.damping))
    assert abs(modes.at("tip")[slow]) < 1e-12
    value, gradient = evaluation.metric("spectral_abscissa")
    frequency, by_frequency = evaluation.metric("structure_frequency", slow + 1)
    ratio = modes.damping_ratio[slow]
    assert value == pytest.approx(-ratio * frequency, rel=1e-12, abs=0)
    rate = ratio + frequency * (0.02 - 0.001) / (3000.0 - 10.0)
    assert np.abs(gradient + rate * by_frequency).max() <= 1e-6 * np.abs(gradient).max()


@pytest.mark.parametrize("keep", [None, (2, 3)], ids=["all modes", "two modes"])
def test_a_mirror_on_held_ground_leaves_all_modes_alone_and_the_slowest_kept_decides(keep):
    truss = barker_truss("fixed", 6)
    grounded = replace(truss, ports={"hub": ("B0", "rz"), "tip": ("B0", "rz")})
    structure = assemble(grounded, "tip")
    mirror = replace(reference.mirror_of(reference.structure(), 0.2), inertia=0.02)
    selection = ModeSelection(keep=keep)
    # The first mode is damped so well that a later one decays more slowly.
    damping = Damping((0.05, 0.001))
    system = System(structure, "tip", Hub("fixed"), damping, (), selection=selection)
    design = Design(structure.area, structure.batten_mass, 50.0, reference.loop_of(mirror))
    evaluation = Evaluation(system, design)
    value, gradient = evaluation.metric("spectral_abscissa")
    slowest = 2 if keep is None else 1
    frequency, by_frequency = evaluation.metric("structure_frequency", slowest)
    assert value == pytest.approx(-0.001 * frequency, rel=1e-12, abs=0)
    assert np.abs(gradient + 0.001 * by_frequency).max() <= 1e-12 * np.abs(gradient).max()


def test_of_a_repeated_mode_the_half_the_mirror_cannot_move_may_decide():
    system, design, _ = crossing()
    modes = Evaluation(system, design).all_modes
    twins = np.flatnonzero(np.diff(modes.natural_frequency) < 1e-14 * modes.natural_frequency[1:])
    k = int(twins[0])
    system = replace(system, selection=ModeSelection(keep=(k, k + 1)))
    evaluation = Evaluation(system, design)
    value, gradient = evaluation.metric("spectral_abscissa")
    assert value == evaluation.poles.open_loop.uncoupled.real.max()
    still = 1 + int(np.argmin(np.abs(evaluation.modes.at("tip"))))
    frequency, by_frequency = evaluation.metric("structure_frequency", still)
    assert value == pytest.approx(-0.002 * frequency, rel=1e-12, abs=0)
    assert np.abs(gradient + 0.002 * by_frequency).max() <= 1e-12 * np.abs(gradient).max()


def test_a_disturbance_that_cannot_reach_the_line_of_sight_has_no_jitter_and_no_gradient():
    system, design = case(1, boundary="fixed", hub=Hub("fixed"), step=None)
    value, gradient = Evaluation(system, design).metric("jitter_aft_body")
    assert value == 0
    assert np.all(gradient == 0)


def test_coupled_modes_of_a_truncated_model_have_no_gradient():
    evaluation = Evaluation(*case(1, selection=ModeSelection(count=8)))
    with pytest.raises(SolverError, match="keep all modes"):
        evaluation.metric("natural_frequency", 2)


# --- crossing modes


def crossing():
    """A mast that bends alike in two directions, and a change of areas that splits and mixes the two."""
    structure = assemble(reference.square_mast(), "tip")
    mirror = replace(reference.mirror_of(reference.structure(), 0.2), inertia=0.02)
    loop = reference.loop_of(mirror, 1e-4)
    system = System(
        structure,
        "tip",
        Hub("fixed"),
        Damping((0.002,)),
        (COOLING, AIR, SENSOR),
        StepCommand(1e-6, (0.05, 0.1)),
    )
    design = Design(structure.area, structure.batten_mass, 50.0, loop)
    rng = np.random.default_rng(4)
    direction = np.zeros(design.parameters.size)
    direction[: structure.area.size] = structure.area * rng.normal(size=structure.area.size)
    return system, design, direction


SMOOTH = (
    "structural_mass",
    "structure_inertia",
    "reference_inertia",
    "modulus_margin",
    "jitter_total",
    "jitter_cooling",
    "jitter_air",
    "jitter_sensor",
    "loop_crossover",
    "step_offset",
    "step_rms",
)


def test_where_modes_cross_loop_metrics_are_smooth_and_their_gradients_right():
    system, design, direction = crossing()
    base = design.parameters

    def at(t):
        return Evaluation(system, design.with_parameters(base + t * direction))

    frequencies = [at(t).all_modes.natural_frequency for t in (-1e-3, 0.0, 1e-3)]
    gaps = [f[1] / f[0] - 1 for f in frequencies]
    assert gaps[1] < 1e-12
    assert min(gaps[0], gaps[2]) > 1e-5
    # Both modes turn the mirror on either side, so the crossing is seen by the loop.
    assert np.all(np.abs(at(1e-3).all_modes.at("tip")[:2]) > 1e-3)

    def along(t):
        moved = at(t)
        return np.array([moved.value(name) for name in SMOOTH])

    expected, error = reference.plateau(along, (3e-4, 1e-4, 3e-5, 1e-5))
    values = along(0.0)
    for t in (0.0, 1e-13, 1e-11, 1e-9, 1e-7):
        evaluation = at(t)
        found = np.array([evaluation.metric(name)[1] @ direction for name in SMOOTH])
        # At a distance t the derivative itself has changed, by t times a curvature of a few hundred.
        allowed = (1e-6 + 1e3 * t) * np.abs(expected) + 3 * error + 1e-8 * np.abs(values)
        wrong = np.flatnonzero(~(np.abs(found - expected) <= allowed))
        assert not wrong.size, [(t, SMOOTH[i], found[i], expected[i], error[i]) for i in wrong]
    h = 1e-5
    middle = (4 * (along(h) + along(-h)) - along(2 * h) - along(-2 * h)) / 6
    assert middle == pytest.approx(values, rel=1e-9, abs=0)


def test_through_the_crossing_the_gradient_is_continuous():
    system, design, direction = crossing()
    base = design.parameters
    gradients = []
    for t in (-1e-9, 0.0, 1e-9):
        evaluation = Evaluation(system, design.with_parameters(base + t * direction))
        gradients.append([evaluation.metric(name)[1] * base for name in SMOOTH])
    scale = np.abs(gradients[1]).max(axis=1, keepdims=True)
    assert np.all(np.abs(gradients[0] - np.array(gradients[1])) <= 1e-5 * scale)
    assert np.all(np.abs(gradients[2] - np.array(gradients[1])) <= 1e-5 * scale)


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
def test_partial_derivatives_of_transfer_functions_are_those_of_central_differences(name):
    partials = response_partials(name, LOOP, S, G)
    f = formula(name)

    def difference(along):
        def parts(t):
            value = along(t)
            return np.concatenate([value.real, value.imag])

        expected, error = reference.plateau(parts, (1e-2, 3e-3, 1e-3))
        m = S.size
        return expected[:m] + 1j * expected[m:], error[:m] + error[m:]

    for part in ("direct", "cross"):
        size = np.abs(getattr(G, part))
        expected, error = difference(
            lambda t, part=part, size=size: f(LOOP, S, replace(G, **{part: getattr(G, part) + t * size}))
        )
        found = getattr(partials, part) * size
        assert np.all(np.abs(found - expected) <= 1e-8 * np.abs(f(LOOP, S, G)) + 3 * error)
    p = loop_parameters(LOOP)
    for i in range(len(LOOP_PARAMETERS)):
        unit = np.eye(p.size)[i] * p[i]
        expected, error = difference(lambda t, unit=unit: f(loop_of(p + t * unit), S, G))
        found = partials.parameters[i] * p[i]
        assert np.all(np.abs(found - expected) <= 1e-8 * np.abs(f(LOOP, S, G)) + 3 * error)


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


def test_a_lower_bound_on_a_minimum_is_recognized_as_branched():
    frequency, margin = parse_expression("first_elastic_frequency"), parse_expression("modulus_margin")
    assert branched(Constraint(frequency, lower=1.0)) == "first_elastic_frequency"
    assert branched(Constraint(margin, lower=0.5, upper=0.9)) == "modulus_margin"
    assert branched(Constraint(frequency, upper=1.0)) is None
    assert branched(Constraint(parse_expression("2 * modulus_margin"), lower=1.0)) is None
    assert branched(Constraint(parse_expression("jitter_total"), lower=1.0)) is None


def test_problems_evaluate_on_the_truth_model_when_asked():
    p = problem(variable("kp", 60.0, 600.0, 6000.0), selection=ModeSelection(count=8))
    assert p.evaluate(p.start).modes.natural_frequency.size == 8
    assert p.evaluate(p.start, truth=True).modes.natural_frequency.size == 19
    assert p.evaluate(p.start, shift=1.0).shift == 1.0
