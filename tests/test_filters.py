"""Filters in the loop: against scipy, python-control, dense state spaces and central differences."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
import reference
from scipy import linalg, signal

from fosopt.actuators import Mirror
from fosopt.control import (
    NUMERATORS,
    PID,
    Filter,
    Loop,
    Sampling,
    SignalPath,
    closed_loop_poles,
    closed_loop_response,
    closed_loop_state_space,
    gain_for_crossover,
    lead_lag_filter,
    loop_transfer,
    low_pass_filter,
    notch_filter,
    pade_delay,
    pade_error,
    pid_response,
    plant_state_space,
)
from fosopt.control.filter_states import filter_state_space
from fosopt.control.locus import root_locus
from fosopt.control.many import many_closed_loop_poles
from fosopt.control.poles import _controller_poles
from fosopt.errors import ModelError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.problem import Evaluation

HZ = reference.HZ
S = 1j * np.geomspace(1.0, 1e5, 40)
PATHS = {
    "low pass": SignalPath((low_pass_filter(800 * HZ, 3),)),
    "notch and lead": SignalPath((notch_filter(300 * HZ, 0.2, 0.1), lead_lag_filter(50 * HZ, 2000 * HZ))),
    "anti-alias": SignalPath((notch_filter(700 * HZ, 0.1),), (low_pass_filter(2000 * HZ, 2),)),
    "delay": SignalPath((), (low_pass_filter(3000 * HZ, 4),), Sampling(1e-4, 5e-5)),
    "rational": SignalPath((Filter((2.0, 1e4), (1.0, 3e3, 1e7)),)),
}


def filtered(path, rolloff_time=0.0, **parts):
    """The reference loop with filters, on all modes of the truss."""
    of = reference.structure()
    loop = reference.loop_of(reference.mirror_of(of, 0.2), rolloff_time)
    gain = 0.3 * loop.controller.gain
    return replace(
        loop, controller=replace(loop.controller, gain=gain, path=path, **parts)
    ), reference.modes_of(of)


@pytest.mark.parametrize("order", [1, 2, 5, 8])
def test_a_low_pass_is_scipys_butterworth_filter(order):
    found = low_pass_filter(300.0, order)
    expected = signal.freqs(*signal.butter(order, 300.0, analog=True), worN=S.imag)[1]
    np.testing.assert_allclose(found.response(S), expected, rtol=1e-12)
    assert found.response(0.0) == pytest.approx(1.0, abs=0, rel=1e-12)


def test_a_notch_has_its_depth_at_its_center_and_passes_all_else():
    notch = notch_filter(200.0, 0.3, 0.05)
    assert notch.response(200j) == pytest.approx(0.05, abs=0, rel=1e-12)
    assert notch.response(0.0) == pytest.approx(1.0)
    assert notch.direct == 1.0
    # Half way down, |F|² = 1/2 (1 + d²), at ω (√(1 + ζ²) ± ζ): these are 2 ζ ω apart.
    for edge in (np.sqrt(1 + 0.09) - 0.3, np.sqrt(1 + 0.09) + 0.3):
        assert abs(notch.response(200j * edge)) ** 2 == pytest.approx(0.5 * (1 + 0.05**2), abs=0, rel=1e-12)


def test_a_lead_lag_has_its_zero_and_pole():
    lead = lead_lag_filter(30.0, 400.0)
    assert lead.response(-30.0) == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(lead.poles, [-400.0])
    assert lead.direct == pytest.approx(400 / 30)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_a_pade_delay_is_that_of_python_control_and_as_good_as_its_order_says(order):
    delay, frequency = 1e-3, 300.0
    numerator, denominator = control.pade(delay, order)
    expected = np.polyval(numerator, S) / np.polyval(denominator, S)
    np.testing.assert_allclose(pade_delay(delay, order).response(S), expected, rtol=1e-9)
    np.testing.assert_allclose(np.abs(pade_delay(delay, order).response(S)), 1.0, rtol=1e-12)
    # Half the delay: the error falls by 2^(2n+1), up to the next term of its series, (ωτ)² smaller.
    ratio = pade_error(delay, order, frequency) / pade_error(delay / 2, order, frequency)
    assert ratio == pytest.approx(2 ** (2 * order + 1), abs=0, rel=0.1 * (frequency * delay) ** 2 + 1e-2)
    leading = (np.prod(range(1, order + 1)) ** 2) / (
        float(np.prod(range(1, 2 * order + 1))) * float(np.prod(range(1, 2 * order + 2)))
    )
    small = pade_error(1e-3, order, frequency)
    assert small == pytest.approx(leading * 0.3 ** (2 * order + 1), abs=0, rel=0.02)


@pytest.mark.parametrize("name", PATHS)
def test_states_of_a_chain_of_filters_answer_as_the_filters_do(name):
    path = PATHS[name]
    states = filter_state_space(path.sections)
    found = [states.c @ np.linalg.solve(s * np.eye(states.order) - states.a, states.b) + states.d for s in S]
    expected = np.prod([section.response(S) for section in path.sections], axis=0)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("rolloff_time", [0.0, 1e-4])
@pytest.mark.parametrize("name", PATHS)
def test_poles_with_filters_are_those_of_the_dense_state_matrix(name, rolloff_time):
    loop, modes = filtered(PATHS[name], rolloff_time)
    poles = closed_loop_poles(loop, modes, "tip")
    dense = linalg.eigvals(closed_loop_state_space(loop, modes, "tip").a)
    assert poles.all.size == dense.size
    assert reference.worst_match(poles.all, dense) < 1e-8


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", ["notch and lead", "anti-alias", "delay"])
def test_poles_with_filters_are_found_on_random_structures(name, seed):
    loop, modes = reference.random_loop(np.random.default_rng(seed), ki=0.0 if seed == 2 else 100.0)
    loop = replace(loop, controller=replace(loop.controller, path=PATHS[name]))
    poles = closed_loop_poles(loop, modes, "tip")
    dense = linalg.eigvals(closed_loop_state_space(loop, modes, "tip").a)
    assert poles.all.size == dense.size
    size = np.abs(dense).max()
    assert np.abs(poles.all[:, None] - dense).min(axis=1).max() < 1e-9 * size


def test_poles_with_filters_are_those_of_python_control():
    loop, modes = filtered(PATHS["anti-alias"], 1e-4)
    few = modes.keep(np.arange(4))
    plant = plant_state_space(loop, few, "tip")
    column = plant.inputs.index("control_torque")
    row = plant.outputs.index("sensor_angle")
    g = control.ss(plant.a, plant.b[:, [column]], plant.c[[row]], 0.0)
    pid, s = loop.controller, control.tf("s")
    k = pid.gain * (pid.kp + pid.ki / s + pid.kd * s / (1 + pid.rolloff_time * s))
    for section in pid.path.sections:
        k = k * control.tf(section.numerator, section.denominator)
    expected = control.feedback(g * control.ss(k)).poles()
    found = closed_loop_poles(loop, few, "tip").all
    assert found.size == expected.size
    # python-control's states are not scaled: its poles are good to about eps times the largest.
    apart = np.abs(found[:, None] - expected).min(axis=1)
    assert apart.max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("rolloff_time", [0.0, 1e-4])
@pytest.mark.parametrize("name", PATHS)
def test_the_closed_loop_state_space_with_filters_answers_as_the_formulas_do(name, rolloff_time):
    loop, modes = filtered(PATHS[name], rolloff_time)
    modes = modes.keep(np.arange(6))
    system = closed_loop_state_space(loop, modes, "tip")
    s = 1j * np.array([3.0, 40.0, 300.0, 2500.0])
    g = LoopModel(loop, modes, "tip").points(s).g
    for given in NUMERATORS:
        found = system.response(s, given, "line_of_sight")
        expected = closed_loop_response(given, loop, s, g)
        np.testing.assert_allclose(found, expected, rtol=1e-7, err_msg=given)


def test_the_command_does_not_pass_the_anti_alias_filter():
    loop, modes = filtered(PATHS["anti-alias"])
    g = LoopModel(loop, modes, "tip").points(S).g
    noise = closed_loop_response("sensor_noise", loop, S, g)
    command = closed_loop_response("command", loop, S, g)
    np.testing.assert_allclose(-noise, command * loop.controller.path.anti_alias[0].response(S), rtol=1e-12)
    sensitivity = closed_loop_response("line_of_sight", loop, S, g)
    np.testing.assert_allclose(sensitivity - noise, 1.0, rtol=1e-9)


@pytest.mark.parametrize("name", PATHS)
def test_jitter_through_filters_is_that_of_a_lyapunov_equation(name):
    loop, modes = filtered(PATHS[name], 1e-4)
    modes = modes.keep(np.arange(8))
    poles = closed_loop_poles(loop, modes, "tip")
    assert poles.spectral_abscissa < 0
    found = jitter_variances(LoopModel(loop, modes, "tip"), poles, reference.DISTURBANCES)
    system = closed_loop_state_space(loop, modes, "tip")
    for disturbance, variance in zip(reference.DISTURBANCES, found, strict=True):
        shape = disturbance.filter
        fa, fb, fc, fd = signal.tf2ss(shape.numerator, shape.denominator)
        b = system.b[:, [system.inputs.index(disturbance.at)]]
        c, d = system.c[[1]], system.d[1, system.inputs.index(disturbance.at)]
        a = np.block([[system.a, b @ fc], [np.zeros((fa.shape[0], system.a.shape[0])), fa]])
        b, c = np.vstack([b @ fd, fb]), np.hstack([c, d * fc])
        _, (scale, _) = linalg.matrix_balance(a, permute=False, separate=True)
        a, b, c = a / scale[:, None] * scale, b / scale[:, None], c * scale
        p = linalg.solve_continuous_lyapunov(a, -b @ b.T)
        assert variance.value == pytest.approx((c @ p @ c.T)[0, 0], abs=0, rel=1e-6)


@pytest.mark.parametrize(
    "metric", ["jitter_total", "modulus_margin", "loop_crossover", "spectral_abscissa", "step_rms"]
)
def test_gradients_through_filters_match_central_differences(metric):
    loop, _ = filtered(PATHS["delay"], 1e-4)
    system, design = reference.system_and_design(bays=4, loop=loop, seed=3)
    base = design.parameters
    _, gradient = Evaluation(system, design).metric(metric)
    # One bar, the mirror's inertia, the gain and the roll-off.
    for k in (5, base.size - 8, base.size - 5, base.size - 1):

        def value(step, k=k):
            moved = base.copy()
            moved[k] *= 1 + step
            return np.array([Evaluation(system, design.with_parameters(moved)).value(metric)])

        estimate, error = reference.plateau(value, (3e-4, 1e-4, 3e-5))
        assert gradient[k] * base[k] == pytest.approx(estimate[0], abs=3 * error[0] + 1e-6 * abs(estimate[0]))


@pytest.mark.parametrize("name", PATHS)
def test_the_gain_for_a_crossover_counts_the_filters(name):
    mirror = reference.mirror_of(reference.structure(), 0.2)
    path = PATHS[name]
    gain = gain_for_crossover(100 * HZ, mirror, 600.0, 5e4, 1.0, 1e-4, path)
    s = 100j * HZ
    plant = 1 / (mirror.inertia * s**2 + mirror.damping * s + mirror.stiffness)
    assert abs(plant * pid_response(PID(gain, 600.0, 5e4, 1.0, 1e-4, path), s)) == pytest.approx(
        1, abs=0, rel=1e-12
    )


def test_the_loop_transfer_has_the_filters_in_it():
    loop, modes = filtered(PATHS["notch and lead"])
    bare = replace(loop, controller=replace(loop.controller, path=SignalPath()))
    g = LoopModel(loop, modes, "tip").points(S).g
    ratio = loop_transfer(loop, S, g) / loop_transfer(bare, S, g)
    expected = np.prod([f.response(S) for f in loop.controller.path.filters], axis=0)
    np.testing.assert_allclose(ratio, expected, rtol=1e-12)


def test_a_root_locus_starts_at_the_filters_poles():
    loop, modes = filtered(PATHS["low pass"])
    locus = root_locus(loop, modes.keep(np.arange(3)), "tip", count=12)
    for pole in loop.controller.path.filters[0].poles:
        assert np.abs(locus.branches[0] - pole).min() < 1e-6 * abs(pole)


def test_loops_with_filters_are_left_to_one_at_a_time():
    loop, modes = filtered(PATHS["low pass"])
    near = closed_loop_poles(loop, modes, "tip")
    assert many_closed_loop_poles([loop, loop], modes, "tip", near) == [None, None]


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Filter((1.0,), (1.0, -2.0)), "does not decay"),
        (lambda: Filter((1.0,), (1.0, 0.0)), "does not decay"),
        (lambda: Filter((1.0, 2.0, 3.0), (1.0, 2.0)), "more zeros than poles"),
        (lambda: Filter((0.0, 1.0), (1.0, 2.0)), "leading one"),
        (lambda: Filter((1.0,), (1.0, np.nan)), "finite"),
        (lambda: Filter((1.0,), (1.0, 1.0), -1.0), "center -1"),
        (lambda: low_pass_filter(0.0), "corner 0"),
        (lambda: low_pass_filter(1.0, 9), "order 9"),
        (lambda: notch_filter(1.0, 0.0), "damping_ratio 0"),
        (lambda: notch_filter(1.0, 0.1, -0.1), "depth -0.1"),
        (lambda: lead_lag_filter(1.0, -2.0), "pole -2"),
        (lambda: pade_delay(1e-3, 7), "order 7"),
        (lambda: Sampling(0.0), "period 0"),
        (lambda: Sampling(1e-3, -1e-3), "delay -0.001"),
        (lambda: Sampling(1e-3, derivative="euler"), "'euler'"),
        (lambda: Sampling(1e-3, order=0), "order 0"),
    ],
)
def test_filters_and_samplings_that_cannot_be_are_refused(make, says):
    with pytest.raises(ModelError, match=says):
        make()


@pytest.mark.parametrize("gains", [{"ki": 50.0}, {}, {"kd": 0.01, "ki": 3.0, "rolloff_time": 1e-3}])
def test_poles_of_a_filtered_loop_on_rigid_ground_are_where_its_search_starts(gains):
    path = SignalPath((notch_filter(300.0, 0.3, 0.2), low_pass_filter(900.0, 2)))
    controller = PID(2e3, **({"kp": 1.0, "ki": 0.0, "kd": 0.0} | gains), path=path)
    mirror = Mirror(1.0, 100.0, 0.05)
    poles = _controller_poles(Loop(mirror, controller))
    assert poles.size == 6 + (controller.ki > 0) + (controller.kd > 0)
    plant = mirror.inertia * poles**2 + mirror.damping * poles + mirror.stiffness
    np.testing.assert_allclose(pid_response(controller, poles) / plant, -1, rtol=1e-9)
