"""Margins, residues, step metrics and the values an evaluation gives."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from scipy import integrate, linalg

from fosopt.actuators import Mirror
from fosopt.control import (
    PID,
    Loop,
    closed_loop_poles,
    closed_loop_response,
    closed_loop_state_space,
    loop_transfer,
)
from fosopt.errors import ModelError, SolverError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import pole_residues
from fosopt.metrics.margins import _stationary, crossover, modulus_margins
from fosopt.metrics.step import StepCommand, step_response
from fosopt.modes import Hub
from fosopt.problem import ModeSelection

HZ = reference.HZ
REDUCED = ModeSelection(count=7)


@pytest.mark.parametrize("seed", range(6))
def test_the_modulus_margin_is_the_least_distance_over_a_dense_grid(seed):
    evaluation = reference.evaluation(percent=0.02 * 3**seed, seed=seed, selection=ModeSelection(count=20))
    model = evaluation.model
    resonances = np.concatenate([evaluation.poles.all, evaluation.poles.open_loop.first])
    resonances = resonances[resonances.imag > 0]
    local = resonances.imag[:, None] + np.abs(resonances.real)[:, None] * np.sinh(np.linspace(-7, 7, 400))
    grid = np.concatenate([local[local > 0], np.geomspace(0.01, 1e6, 4000)])
    s = 1j * grid
    distance = np.abs(1 + loop_transfer(model.loop, s, model.points(s).g))
    found = evaluation.value("modulus_margin")
    # A grid can only miss the minimum, by the square of its spacing in half widths, 0.035.
    assert found <= distance.min() * (1 + 1e-12)
    assert found == pytest.approx(distance.min(), rel=1e-3, abs=0)
    sensitivity = closed_loop_response("line_of_sight", model.loop, s, model.points(s).g)
    assert 1 / found == pytest.approx(np.abs(sensitivity).max(), rel=1e-3, abs=0)


def test_the_smallest_minima_come_first_and_one_stands_in_for_those_that_do_not_exist(evaluation):
    values, functionals = modulus_margins(evaluation.model, evaluation.poles, 6)
    assert np.all(np.diff(values) >= 0)
    assert len(functionals) == 6
    assert values[0] == evaluation.value("modulus_margin")
    loop, modes = reference.benchmark(None)
    lone, _ = modulus_margins(LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip"), 5)
    assert np.all(lone[-3:] == 1)


# On the last three designs a resonance well above the first crossing reaches one again, narrower than any grid
# that does not know it.
@pytest.mark.parametrize(
    ("percent", "seed"), [(0.002, None), (0.2, None), (20.0, None), (4.193, 0), (0.766, 42), (0.099, 118)]
)
def test_at_the_crossover_the_loop_gain_is_one_and_below_one_beyond(percent, seed):
    evaluation = reference.evaluation(percent=percent, seed=seed, rolloff_time=0.0)
    frequency, _ = crossover(evaluation.model, evaluation.poles)
    resonances = evaluation.coupled.natural_frequency
    local = resonances[:, None] * (1 + 1e-3 * np.sinh(np.linspace(-4, 4, 161)))
    beyond = np.concatenate([local.ravel(), frequency * np.geomspace(1, 1e3, 2000)])
    s = 1j * np.concatenate([[frequency], beyond[beyond > frequency * (1 + 1e-9)]])
    gain = np.abs(loop_transfer(evaluation.model.loop, s, evaluation.model.points(s).g))
    assert gain[0] == pytest.approx(1.0, rel=1e-10)
    assert np.all(gain[1:] < 1)


def test_the_crossover_on_a_rigid_support_is_the_one_the_gain_was_chosen_for():
    loop, modes = reference.benchmark(None)
    loop = reference.loop_of(loop.mirror)
    found, _ = crossover(LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip"))
    assert found == pytest.approx(230 * HZ, rel=1e-10, abs=0)


def test_a_loop_that_never_reaches_a_gain_of_one_has_no_crossover():
    loop = Loop(Mirror(1.0, 60.0, 0.5), PID(1e-3, 1.0, 0.0, 1e-3))
    _, modes = reference.benchmark(None)
    with pytest.raises(SolverError, match="loop gain stays below one"):
        crossover(LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip"))


# --- residues and steps


def test_residues_at_the_poles_rebuild_the_transfer_function():
    evaluation = reference.evaluation(selection=REDUCED)
    model, poles = evaluation.model, evaluation.poles
    s = 1j * np.array([0.3, 20.0, 300.0, 5e3])
    for name in ("mirror_torque", "hub_torque", "sensor_noise", "command"):
        residues = pole_residues(model, poles, name)
        pair = poles.multiplicity == 2
        terms = (residues / (s[:, None] - poles.value)).sum(axis=1)
        terms += (residues[pair].conj() / (s[:, None] - poles.value[pair].conj())).sum(axis=1)
        expected = closed_loop_response(name, model.loop, s, model.points(s).g)
        assert np.abs(terms - expected).max() < 1e-10 * np.abs(expected).max()


STEPS = {
    "ideal": {},
    "rolled off": {"rolloff_time": 1e-4},
    "without integral": {"ki": 0.0},
    "without integral, free hub": {"ki": 0.0, "hub": Hub("free")},
}


def step_case(hub=reference.HELD, selection=REDUCED, **pid):
    mirror = reference.mirror_of(reference.structure(), 0.2)
    return reference.evaluation(hub=hub, loop=reference.loop_of(mirror, **pid), selection=selection)


@pytest.mark.parametrize("options", STEPS.values(), ids=STEPS)
def test_the_step_response_is_that_of_a_simulation(options):
    evaluation = step_case(**options)
    system = closed_loop_state_space(evaluation.design.loop, evaluation.modes, "tip")
    n = system.a.shape[0]
    # The state and a constant input in one exponential, exact at every step.
    grown = np.zeros((n + 1, n + 1))
    grown[:n, :n] = system.a
    grown[:n, n] = system.b[:, system.inputs.index("command")]
    advance = linalg.expm(grown * 1e-3)
    state, angles = np.zeros(n + 1), []
    state[n] = 1.0
    for _ in range(100):
        state = advance @ state
        angles.append(system.c[system.outputs.index("mirror_angle")] @ state[:n])
    found = step_response(evaluation.model, evaluation.poles, 1e-3 * np.arange(1, 101))
    assert found == pytest.approx(np.array(angles), abs=1e-9)


def test_the_step_response_starts_at_zero_and_ends_at_the_command(evaluation):
    # Zero to rounding of a hundred terms; the integral pole at 1/0.012 s is the last to die out with the modes.
    start, late = step_response(evaluation.model, evaluation.poles, np.array([0.0, 400.0]))
    assert abs(start) < 1e-9
    assert late == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("options", STEPS.values(), ids=STEPS)
def test_offset_and_residual_are_mean_and_rms_over_the_window(options):
    evaluation = step_case(**options)
    time = np.linspace(0.05, 0.1, 20001)
    error = 1e-6 * (step_response(evaluation.model, evaluation.poles, time) - 1)
    mean = integrate.simpson(error, x=time) / 0.05
    rms = np.sqrt(integrate.simpson((error - mean) ** 2, x=time) / 0.05)
    assert evaluation.value("step_offset") == pytest.approx(abs(mean), rel=1e-7, abs=1e-16)
    assert evaluation.value("step_rms") == pytest.approx(rms, rel=1e-7, abs=0)


def test_without_integral_action_the_step_keeps_the_offset_of_its_springs():
    evaluation = step_case(ki=0.0)
    loop = evaluation.design.loop
    spring = evaluation.modes.receptance(np.array([0j]), "tip", "tip")[0].real
    assert spring > 0
    stiffness, torque = loop.mirror.stiffness, loop.controller.gain * loop.controller.kp
    late = step_response(evaluation.model, evaluation.poles, np.array([2000.0]))[0]
    assert late == pytest.approx(torque / (torque + stiffness), rel=1e-9, abs=0)


@pytest.mark.parametrize("window", [(0.0, 0.1), (0.1, 0.1), (0.2, 0.1), (-0.1, 0.1)])
def test_a_step_window_that_is_empty_or_starts_at_once_is_refused(window):
    with pytest.raises(ModelError, match="must start after zero and end after it starts"):
        StepCommand(1.0, window)


# --- the evaluation


def test_an_evaluation_refuses_names_and_numbers_that_do_not_exist(evaluation):
    for name, index, message in (
        ("jiter_total", None, "did you mean 'jitter_total'"),
        ("structure_frequency", None, "needs the number of a mode"),
        ("jitter_total", 1, "takes no mode number"),
        ("structure_frequency", 0, "the model has modes 1 to 61"),
        ("natural_frequency", 63, "the model has modes 1 to 62"),
        ("pole_zero_separation", evaluation.coupled.mirror_mode + 1, "this is the mirror mode"),
    ):
        with pytest.raises(ModelError, match=message):
            evaluation.value(name, index)


def test_metrics_of_modes_are_those_of_the_modal_set_and_the_coupled_modes(evaluation):
    coupled, modes = evaluation.coupled, evaluation.modes
    for k in (2, 4, 9, 40):
        i = k - 1
        assert evaluation.value("structure_frequency", k) == pytest.approx(modes.natural_frequency[i])
        assert evaluation.value("modal_inertia", k) == pytest.approx(modes.at("tip")[i] ** -2)
        assert evaluation.value("natural_frequency", k) == coupled.natural_frequency[i]
        share = coupled.effective_modal_reaction_inertia[i]
        assert evaluation.value("effective_modal_reaction_inertia", k) == share
        inertia = evaluation.value("mirror_inertia") / share
        assert evaluation.value("modal_reaction_inertia", k) == pytest.approx(inertia)
        assert evaluation.value("participation", k) == coupled.participation[i]
        assert evaluation.value("pole_zero_separation", k) == coupled.pole_zero_separation[i]


def test_masses_and_inertias_are_those_of_structure_and_mirror(evaluation):
    assert evaluation.value("structural_mass") == pytest.approx(108.3)
    assert evaluation.value("total_mass") == pytest.approx(361.0)
    assert evaluation.value("inertia_ratio") == pytest.approx(0.002)
    inertia = reference.inertia_of(reference.structure())
    assert evaluation.value("structure_inertia") == pytest.approx(inertia)
    assert evaluation.value("mirror_inertia") == pytest.approx(0.002 * inertia)
    assert evaluation.value("first_elastic_frequency") == evaluation.value("structure_frequency", 2)


def test_a_free_rigid_body_is_a_mode_the_mirror_cannot_move():
    evaluation = reference.evaluation(hub=Hub("free"), disturbances=())
    assert evaluation.value("natural_frequency", 1) == 0
    assert evaluation.value("effective_modal_reaction_inertia", 1) == 0
    assert evaluation.value("pole_zero_separation", 1) == 1
    with pytest.raises(ModelError, match=r"modal_reaction_inertia\[1\] is infinite"):
        evaluation.value("modal_reaction_inertia", 1)


def test_the_truth_model_has_all_modes_and_the_design_model_those_selected():
    reduced = reference.evaluation(selection=REDUCED)
    assert reduced.modes.natural_frequency.size == 7
    truth = type(reduced)(reduced.system.truth, reduced.design)
    assert truth.modes.natural_frequency.size == 61
    assert np.array_equal(reduced.modes.natural_frequency, truth.modes.natural_frequency[:7])


@pytest.mark.parametrize(
    "falling", [lambda w: np.arctan(40 * (3 - w)), lambda w: np.exp(-w) - np.exp(-3.0)], ids=["step", "tail"]
)
def test_where_a_slope_falls_through_zero_is_found_at_a_superlinear_rate(falling):
    calls = []

    def slope(w):
        calls.append(w)
        return falling(w)

    found = _stationary(slope, np.array([1.0, 2.0]), np.array([5.0, 100.0]))
    assert found == pytest.approx(3.0, rel=1e-14)
    # Halving the longer bracket to the last digit takes fifty.
    assert len(calls) <= 18
