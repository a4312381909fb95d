"""Gradients of every metric against central differences, at ordinary designs and where modes cross."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np
import pytest
import reference

from fosopt.errors import SolverError, UnstableError
from fosopt.metrics.disturbances import Disturbance, ShapingFilter
from fosopt.metrics.margins import decay_functional
from fosopt.metrics.step import StepCommand
from fosopt.modes import Damping, Hub, ModalSet
from fosopt.problem import (
    Design,
    Evaluation,
    ModeSelection,
    System,
)
from fosopt.problem.evaluation import BRANCHES
from fosopt.structure import assemble, barker_truss

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
    "root table": (NO_STEP | {"boundary": "table", "hub": Hub("free")}, INDEXED),
    "root table, lowest modes": (
        NO_STEP | {"boundary": "table", "hub": Hub("free"), "selection": ModeSelection(count=6)},
        OWN,
    ),
    # The hub's own mode lies among those of the structure, and its stiffness follows the mass.
    "stiffly held hub": (NO_STEP | {"hub": Hub("held", 60.0, 0.1), "disturbances": (AIR,)}, INDEXED),
}


def case(seed, ki=None, boundary="pinned", rolloff_time=1e-4, percent=1.0, **options):
    of = reference.structure(boundary, 6)
    gains = {} if ki is None else {"ki": ki}
    loop = reference.loop_of(reference.mirror_of(of, percent), rolloff_time, **gains)
    return reference.system_and_design(boundary=boundary, bays=6, loop=loop, seed=seed, **options)


def directions(design, rng, apart=False):
    """Random relative changes of each kind of member and of the loop, its parameters together or apart."""
    p = design.parameters
    sizes = design.area.size, design.batten_mass.size, design.spring_stiffness.size
    *ends, first = np.cumsum([0, *sizes])
    members = [slice(a, b) for a, b in pairwise([*ends, first])]
    loop = [slice(i, i + 1) for i in range(first, p.size)] if apart else [slice(first, p.size)]
    found = []
    for part in (*members, *loop):
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
    for name in ("first_elastic_frequency", "modulus_margin", "spectral_abscissa"):
        branches = evaluation.branches(name)
        assert len(branches) == BRANCHES[name]
        assert branches[0][0] == evaluation.value(name)

        def along(t, name=name):
            moved = Evaluation(system, design.with_parameters(base + t * direction))
            return np.array([value for value, _ in moved.branches(name)])

        expected, error = reference.plateau(along, STEPS)
        found = np.array([gradient @ direction for _, gradient in branches])
        assert np.all(np.abs(found - expected) <= 1e-6 * np.abs(expected) + 3 * error + 1e-9)


def test_a_mode_the_loop_does_not_see_gives_the_gradient_of_its_own_decay():
    # A mast that the mirror bends in one direction only; the other is rightmost and stays where it is.
    structure = assemble(reference.square_mast(stretch=2.0), "tip")
    mirror = replace(reference.mirror_of(reference.structure(), 0.2), inertia=0.02)
    damping = Damping((0.001, 0.02), (10.0, 3000.0))
    system = System(structure, "tip", Hub("fixed"), damping, (COOLING,))
    design = Design(
        structure.area, structure.batten_mass, structure.spring_stiffness, 50.0, reference.loop_of(mirror)
    )
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


def test_the_decay_of_a_mode_that_no_longer_oscillates_follows_its_stiffness_and_mass():
    # ζ = 5/4 leaves the slower pole at −ω/2 with ω² = K/M; the other mode decays elsewhere and is not asked for.
    frequency, ratio = np.array([30.0, 70.0]), np.array([1.25, 1.25])
    shape = np.array([[0.3, 0.4], [0.0, 0.2]])
    modes = ModalSet(frequency, ratio, shape, ("hub", "tip"), np.zeros(2, bool))
    found = decay_functional(frequency**2, modes, Damping((1.25,)), ("tip",), np.arange(2), -15.0)
    np.testing.assert_allclose(found.stiffness, np.diag([-1 / (4 * 30.0), 0.0]), rtol=1e-12)
    np.testing.assert_allclose(found.mass, np.diag([30.0 / 4, 0.0]), rtol=1e-12)


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
    design = Design(
        structure.area, structure.batten_mass, structure.spring_stiffness, 50.0, reference.loop_of(mirror)
    )
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
    design = Design(structure.area, structure.batten_mass, structure.spring_stiffness, 50.0, loop)
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
