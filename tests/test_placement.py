"""Loops that act, react or sense elsewhere, reactionless mirrors and reaction-mass actuators, by several routes."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest
import reference
from scipy import linalg
from test_gradients import check

from fosopt import certify
from fosopt.actuators import (
    Mirror,
    MirrorReactionMass,
    Placement,
    ReactionMassActuator,
    proof_mass_force,
)
from fosopt.control import (
    NUMERATORS,
    Loop,
    Receptances,
    closed_loop_poles,
    closed_loop_response,
    closed_loop_state_space,
    loop_transfer,
    plant_state_space,
    with_attachments,
)
from fosopt.control.open_loop import _paired
from fosopt.control.state_space import modal_matrices
from fosopt.errors import ModelError
from fosopt.metrics.jitter import jitter_variances
from fosopt.modes import Hub
from fosopt.plant import coupled_modes, modes_of_matrices
from fosopt.problem import ModeSelection

HZ = reference.HZ
FREE = Hub("free")
MISMATCH = MirrorReactionMass(0.9, 0.95, 1.1)


def absorbers(**more):
    return (
        ReactionMassActuator("B6.y", 1.0, 10 * HZ, 0.05, **more),
        ReactionMassActuator("B3.y", 2.0, 30 * HZ, 0.02, **more),
    )


# The last number is the share of the usual gain: a sensor on the structure bears little.
CASES = {
    "bicollocated": ({}, None, 1.0),
    "reaction at mid-span": ({"placement": Placement(reaction="B4.rz")}, None, 1.0),
    "reaction at the hub": ({"placement": Placement(reaction="hub")}, None, 1.0),
    "reactionless with mismatch": ({}, MISMATCH, 1.0),
    "reactionless": ({}, MirrorReactionMass(), 1.0),
    "absorbers": ({"actuators": absorbers()}, None, 1.0),
    "active absorbers": ({"actuators": absorbers(rate_gain=50.0)}, None, 1.0),
    "all of it": (
        {"actuators": absorbers(rate_gain=5.0), "placement": Placement(reaction="B4.rz")},
        MISMATCH,
        1.0,
    ),
    "sensor on the structure": ({"placement": Placement(sensor="B3.rz", reaction="B1.rz")}, None, 1e-3),
    "action on the structure": ({"placement": Placement(action="B5.rz", reaction="B1.rz")}, None, 1e-3),
    "sensor and action on the structure": (
        {"actuators": absorbers(rate_gain=5.0), "placement": Placement(sensor="B3.rz", action="B4.rz")},
        MISMATCH,
        1e-3,
    ),
    "sensor and action at the hub": ({"placement": Placement(sensor="hub", action="hub")}, None, 1e-3),
}


def loop_of(name, percent=1.0, rolloff_time=1e-4, **gains):
    parts, reaction_mass, share = CASES[name]
    mirror = replace(
        reference.mirror_of(reference.structure("pinned", 6), percent), reaction_mass=reaction_mass
    )
    base = reference.loop_of(mirror, rolloff_time, **gains)
    return Loop(mirror, replace(base.controller, gain=share * base.controller.gain), **parts)


def case(name, hub=reference.HELD, seed=3, **options):
    loop = loop_of(
        name, **{k: options.pop(k) for k in ("percent", "rolloff_time", "kp", "ki") if k in options}
    )
    disturbances = reference.DISTURBANCES
    if hub == FREE:
        disturbances = tuple(replace(d, band=(1.0, inf)) for d in disturbances)
    return reference.evaluation(
        bays=6, loop=loop, hub=hub, seed=seed, **({"disturbances": disturbances} | options)
    )


def dense_poles(loop, modes, hub):
    found = linalg.eigvals(closed_loop_state_space(loop, modes, "tip").a)
    return found[np.argsort(np.abs(found))[2:]] if hub == FREE else found


EVERY = pytest.mark.parametrize("name", CASES)
HUBS = pytest.mark.parametrize("hub", [reference.HELD, FREE], ids=["held", "free"])
POINTS = np.array([-30 + 200j, 5 + 47j, 100 + 900j, -800 + 3000j, 40 + 2.0j])


@EVERY
@HUBS
def test_closed_form_and_state_space_give_the_same_closed_loop(name, hub):
    evaluation = case(name, hub)
    loop, points = evaluation.design.loop, evaluation.model.points(POINTS)
    system = closed_loop_state_space(loop, evaluation.modes, "tip")
    for response in NUMERATORS:
        found = closed_loop_response(response, loop, points.s, points.g)
        expected = system.response(points.s, response, "line_of_sight")
        # A dense solve of a matrix of condition 1e5 or so.
        assert np.abs(found - expected).max() <= 1e-10 * np.abs(expected).max(), response


@EVERY
def test_closed_form_and_state_space_give_the_same_plant(name):
    evaluation = case(name)
    loop, points = evaluation.design.loop, evaluation.model.points(POINTS)
    plant = plant_state_space(loop, evaluation.modes, "tip")
    expected = plant.response(points.s, "control_torque", "sensor_angle")
    # Through a controller of one, L is the plant.
    unit = replace(loop, controller=replace(loop.controller, gain=1.0, kp=1.0, ki=0.0, kd=0.0))
    found = loop_transfer(unit, points.s, points.g)
    assert np.abs(found - expected).max() <= 1e-10 * np.abs(expected).max()


@EVERY
@HUBS
@pytest.mark.parametrize(
    "gains", [{}, {"rolloff_time": 0.0}, {"ki": 0.0}], ids=["full", "ideal", "no integral"]
)
def test_the_poles_are_the_eigenvalues_of_the_closed_loop(name, hub, gains):
    evaluation = case(name, hub, **gains)
    loop, modes = evaluation.design.loop, evaluation.modes
    found = closed_loop_poles(loop, modes, "tip").all
    expected = dense_poles(loop, modes, hub)
    assert found.size == expected.size
    # Near the double zero of a free hub, dense eigenvalues of a slow pole keep no digits.
    known = expected[np.abs(expected) > (1.0 if hub == FREE else 0.0)]
    distance = np.abs(known[:, None] - found).min(axis=1)
    assert np.all(distance <= 1e-10 * np.abs(expected).max())


@EVERY
@HUBS
def test_jitter_is_that_of_an_independent_route(name, hub):
    evaluation = case(name, hub)
    if (name, hub) == ("sensor on the structure", FREE):
        # Internal torque cannot hold what the sensor sees turn.
        assert not evaluation.stable
        return
    system = certify._scaled(
        closed_loop_state_space(evaluation.design.loop, evaluation.modes, "tip"), evaluation.modes
    )
    found = jitter_variances(evaluation.model, evaluation.poles, evaluation.system.disturbances)
    for disturbance, variance in zip(evaluation.system.disturbances, found, strict=True):
        expected = certify.independent_variance(evaluation, system, disturbance)
        assert variance.value == pytest.approx(expected, rel=certify.AGREEMENT, abs=0), disturbance.name


@EVERY
def test_gradients_are_those_of_central_differences(name):
    evaluation = case(name, step=None)
    rng = np.random.default_rng(5)
    references = [("jitter_total",), ("spectral_abscissa",), ("modulus_margin",)]
    check(evaluation.system, evaluation.design, references, rng)


def test_gradients_on_a_truncated_model_follow_every_port():
    evaluation = case("all of it", step=None, selection=ModeSelection(count=7))
    check(evaluation.system, evaluation.design, [("jitter_total",)], np.random.default_rng(6))


# --- what each part is


def test_a_reaction_at_the_reference_port_by_name_is_bicollocated_control():
    plain, named = case("bicollocated"), loop_of("bicollocated")
    named = replace(named, placement=Placement(reaction="B6.rz"))
    again = reference.evaluation(bays=6, loop=named, seed=3)
    assert again.value("jitter_total") == pytest.approx(plain.value("jitter_total"), rel=1e-12)


def test_a_perfect_reaction_mass_leaves_the_structure_at_rest():
    evaluation = case("reactionless")
    loop, modes = evaluation.design.loop, evaluation.modes
    coupled = modal_matrices(loop, modes, "tip")
    plant = plant_state_space(loop, modes, "tip")
    n = modes.natural_frequency.size
    s = 1j * np.array([3.0, 50.0, 700.0])
    for point in s:
        total = coupled.stiffness + point * coupled.damping + point**2 * coupled.mass
        moved = np.linalg.solve(total, coupled.control)
        assert np.abs(modes.mode_shape[:, 1] @ moved[:n]) <= 1e-12 * np.abs(moved[n])
    rigid = loop.mirror
    alone = 1 / (rigid.inertia * s**2 + rigid.damping * s + rigid.stiffness)
    assert plant.response(s, "control_torque", "mirror_angle") == pytest.approx(alone, rel=1e-10)


def test_torque_leakage_is_the_difference_of_the_two_inertial_torques():
    loop = loop_of("reactionless with mismatch")
    mirror, counter = loop.mirror, loop.mirror.counter
    s = 1j * np.array([3.0, 50.0, 700.0])
    # On a rigid mount, Eq. (2.50): J_m s² θ_m + J_rm s² θ_rm is all that the mount must bear.
    angle = 1 / (mirror.inertia * s**2 + mirror.damping * s + mirror.stiffness)
    other = -1.1 / (counter.inertia * s**2 + counter.damping * s + counter.stiffness)
    leaked = -(mirror.inertia * angle + counter.inertia * other) * s**2
    plant = plant_state_space(loop, case("reactionless with mismatch").modes, "tip")
    assert plant.outputs[4] == "reaction_mass_angle"
    # Loads on the mount: reactions of both drives, and both springs.
    springs = (mirror.damping * s + mirror.stiffness) * angle + (
        counter.damping * s + counter.stiffness
    ) * other
    # What is left of two torques that all but cancel.
    assert np.abs(springs - 1 + 1.1 - leaked).max() <= 4 * np.finfo(float).eps


def test_an_absorber_holds_its_port_at_its_own_frequency():
    mirror = Mirror(1.0, 100.0, 0.01)
    absorber = ReactionMassActuator("hub", 2.0, 50.0, 0.0)
    loop = Loop(mirror, reference.loop_of(mirror).controller, Placement(sensor="hub"), (absorber,))
    g = Receptances(1e-3 + 0j, 2e-3 + 0j, (5e-3 + 0j,))
    held = with_attachments(loop, 1j * 50.0 * (1 + 1e-9), g)
    assert abs(held.cross) < 1e-9
    # g_rr − g_ro²/g_oo is what a pinned hub leaves.
    assert held.direct == pytest.approx(1e-3 - 2e-3**2 / 5e-3, rel=1e-6)


def test_the_force_of_a_proof_mass_on_a_rigid_mount_is_a_second_order_high_pass():
    actuator = ReactionMassActuator("tip", 3.0, 20.0, 0.1)
    s = 1j * np.array([1e-3, 20.0, 1e6])
    force = proof_mass_force(actuator, s)
    assert abs(force[0]) == pytest.approx((1e-3 / 20) ** 2, rel=1e-6)
    assert abs(force[1]) == pytest.approx(1 / (2 * 0.1), rel=1e-12)
    assert abs(force[2]) == pytest.approx(1, rel=1e-6)


def test_rate_feedback_adds_to_the_damper_alone():
    passive, active = absorbers()[0], absorbers(rate_gain=7.0)[0]
    assert active.suspended.damping - passive.suspended.damping == pytest.approx(7.0)
    assert (active.suspended.inertia, active.suspended.stiffness) == (1.0, passive.suspended.stiffness)


@pytest.mark.parametrize("gain", [1.0, 30.0, 1e3])
def test_rate_feedback_takes_energy_out_of_every_mode(gain):
    """Δ positive definite can only add stability; text after Eq. (2.40)."""
    plain = case("absorbers")
    more = replace(plain.design.loop, actuators=absorbers(rate_gain=gain))
    system = modal_matrices(more, plain.modes, "tip")
    before = modal_matrices(plain.design.loop, plain.modes, "tip")
    added = system.damping - before.damping
    assert np.linalg.eigvalsh(added).min() >= -1e-9 * gain
    assert np.trace(added) > gain


def test_the_coupled_modes_are_those_of_the_matrices():
    evaluation = case("bicollocated")
    coupled = modal_matrices(evaluation.design.loop, evaluation.modes, "tip")
    expected = linalg.eigh(coupled.stiffness, coupled.mass, eigvals_only=True)
    found = coupled_modes(evaluation.modes, evaluation.design.loop.mirror, "tip").eigenvalue
    assert found == pytest.approx(expected, rel=1e-9)


# --- words


def test_collocation_is_named_as_the_dissertation_names_it():
    assert Placement().bicollocated and Placement().collocated
    elsewhere = Placement(reaction="mid")
    assert elsewhere.collocated and not elsewhere.bicollocated
    sensor = Placement(sensor="mid")
    assert not sensor.collocated and not sensor.bicollocated


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Placement(reaction="mid", action="mid"), "acts and reacts at 'mid'"),
        (lambda: MirrorReactionMass(inertia_ratio=0.0), "inertia_ratio 0.0"),
        (lambda: MirrorReactionMass(torque_ratio=-1.0), "torque_ratio -1.0"),
        (lambda: ReactionMassActuator("tip", 0.0, 1.0, 0.1), "mass 0.0"),
        (lambda: ReactionMassActuator("tip", 1.0, 1.0, 0.1, -2.0), "rate_gain -2.0"),
    ],
)
def test_what_is_not_physical_is_refused(make, words):
    with pytest.raises(ModelError, match=words):
        make()


def test_an_unknown_signal_is_refused_with_the_nearest_name():
    plant = plant_state_space(loop_of("bicollocated"), case("bicollocated").modes, "tip")
    with pytest.raises(ModelError, match="did you mean 'mirror_angle'"):
        plant.response(POINTS, "control_torque", "mirror_angel")


def test_of_a_mirror_alone_modes_of_matrices_are_the_coupled_modes():
    of = reference.structure()
    modes, mirror = reference.modes_of(of).keep(slice(0, 12)), reference.mirror_of(of, 1.0)
    expected = coupled_modes(modes, mirror, "tip")
    found = modes_of_matrices(modal_matrices(reference.loop_of(mirror), modes, "tip"), mirror)
    np.testing.assert_allclose(found.eigenvalue, expected.eigenvalue, rtol=1e-9)
    share = found.effective_modal_reaction_inertia
    np.testing.assert_allclose(share, expected.effective_modal_reaction_inertia, atol=1e-9)
    assert share.sum() == pytest.approx(1, rel=1e-9)
    assert found.mirror_mode == int(np.argmax(share))


def test_real_poles_join_in_pairs_and_complex_ones_with_their_conjugates():
    pole = np.array([-5.0, -1 + 7j, -2.0, -9.0, -1 - 7j, -3.0])
    residue = np.array([[0.5, 2.0], [1 - 2j, 3j], [-1.0, 0.0], [4.0, 1.0], [1 + 2j, -3j], [0.3, -0.7]])
    first, second, constant, linear = _paired(pole, residue.astype(complex))
    assert np.allclose(
        np.sort_complex(np.concatenate([first, second])), np.sort_complex(pole), rtol=0, atol=0
    )
    s = np.array([[1 + 2j], [-4 + 30j]])
    joined = ((constant + s[..., None] * linear) / ((s - first) * (s - second))[..., None]).sum(axis=1)
    np.testing.assert_allclose(joined, (residue / (s - pole)[..., None]).sum(axis=1), rtol=1e-13)
