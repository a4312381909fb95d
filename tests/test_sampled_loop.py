"""Sampled loops: discretization, poles and margins against closed forms, matrix exponentials and python-control."""

from __future__ import annotations

import re
from dataclasses import replace
from math import cos, exp, pi, sin, sqrt

import control
import numpy as np
import pytest
import reference
from sampled_loops import ANTI_ALIAS, rigid, sampled
from scipy import linalg, optimize, signal

from fosopt.control import Sampling, SignalPath, closed_loop_poles, notch_filter, plant_state_space
from fosopt.control.discrete import discrete_controller, trapezoidal
from fosopt.control.filters import Filter
from fosopt.control.sampled import sampled_loop
from fosopt.control.spans import span
from fosopt.errors import ModelError, SolverError, UnstableError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.margins import crossover, modulus_margins
from fosopt.metrics.sampled import SampledModel

HZ = reference.HZ


@pytest.mark.parametrize("time", [1e-4, 0.3, 7.0])
def test_a_span_is_the_matrix_exponential_with_its_energies_also_of_a_defective_matrix(time):
    a = np.array([[-2.0, 30.0, 0.0], [0.0, -2.0, 1.0], [0.0, 0.0, -2.0]])
    rows = np.array([[1.0, 0.2, 3.0], [0.0, 1.0, -1.0]])
    weight = rows.T @ rows
    found = span(a, rows, time, grown=True)
    np.testing.assert_allclose(found.carried, linalg.expm(a * time), rtol=1e-11, atol=1e-16)
    x, w = np.polynomial.legendre.leggauss(60)
    s, w = 0.5 * time * (x + 1), 0.5 * time * w
    energies = [linalg.expm(a.T * t) @ weight @ linalg.expm(a * t) for t in s]
    np.testing.assert_allclose(found.energy.T @ found.energy, np.tensordot(w, energies, 1), rtol=1e-9)
    np.testing.assert_allclose(
        found.grown.T @ found.grown, np.tensordot(w * (time - s), energies, 1), rtol=1e-9
    )


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, 1.7])
def test_the_sampled_plant_is_the_sum_over_its_modes_in_closed_form(share):
    loop, modes = sampled(2e-4, share * 2e-4, anti_alias=())
    modes = modes.keep(np.arange(10))
    found = sampled_loop(loop, modes, "tip")
    plant = plant_state_space(loop, modes, "tip")
    pole, right = linalg.eig(plant.a)
    column = np.linalg.solve(right, plant.b[:, plant.inputs.index("control_torque")].astype(complex))
    residue = (plant.c[plant.outputs.index("sensor_angle")] @ right) * column
    period = 2e-4
    whole, rest = int(share), (share - int(share)) * period
    z = np.exp(1j * np.array([0.01, 0.4, 1.5, 3.0]))
    expected = np.zeros_like(z)
    for p, r in zip(pole, residue, strict=True):
        late = np.expm1(p * (period - rest)) / p
        early = np.exp(p * (period - rest)) * np.expm1(p * rest) / p
        expected += r * (late + early / z) / (z - np.exp(p * period))
    expected /= z**whole
    np.testing.assert_allclose(found.plant_response(z), expected, rtol=1e-7)


@pytest.mark.parametrize("aliased", [False, True])
def test_the_sampled_plant_and_its_closed_loop_poles_are_those_of_python_control(aliased):
    loop, modes = sampled(2e-4, anti_alias=ANTI_ALIAS if aliased else ())
    modes = modes.keep(np.arange(5))
    found = sampled_loop(loop, modes, "tip")
    plant = plant_state_space(loop, modes, "tip")
    column, row = plant.inputs.index("control_torque"), plant.outputs.index("sensor_angle")
    g = control.ss(plant.a, plant.b[:, [column]], plant.c[[row]], 0.0)
    for section in loop.controller.path.anti_alias:
        g = control.ss(control.tf(section.numerator, section.denominator)) * g
    g = control.c2d(g, 2e-4, "zoh")
    z = np.exp(1j * np.array([0.02, 0.3, 2.0]))
    np.testing.assert_allclose(found.plant_response(z), [g(point) for point in z], rtol=1e-6)
    states = found.states
    k = control.ss(states.a, states.b[:, None], states.c[None], states.d, 2e-4)
    expected = control.feedback(g * k).poles()
    assert expected.size == found.poles.size
    # The other program's states are not scaled, which costs it digits.
    assert np.abs(found.poles[:, None] - expected).min(axis=1).max() < 1e-7


@pytest.mark.parametrize("derivative", ["backward", "trapezoidal"])
def test_the_discrete_pid_is_that_of_python_control(derivative):
    loop, _ = sampled(1e-3, derivative=derivative, rolloff_time=2e-3)
    pid = loop.controller
    found = discrete_controller(pid)
    z = np.exp(1j * np.array([0.05, 0.5, 2.0]))
    method = {"backward": "backward_diff", "trapezoidal": "bilinear"}[derivative]
    gain = float(pid.gain)
    for term, rule, numerator, denominator in (
        (found.pid[0], "bilinear", [gain * pid.kp], [1.0]),
        (found.pid[1], "bilinear", [gain * pid.ki], [1.0, 0.0]),
        (found.pid[2], method, [gain * pid.kd, 0.0], [2e-3, 1.0]),
    ):
        expected = control.c2d(control.tf(numerator, denominator), 1e-3, rule)
        np.testing.assert_allclose(term.response(z), [expected(point) for point in z], rtol=1e-9)
    notch = pid.path.filters[0]
    warped = control.c2d(
        control.tf(notch.numerator, notch.denominator), 1e-3, "bilinear", prewarp_frequency=notch.center
    )
    np.testing.assert_allclose(found.filters[0].response(z), [warped(point) for point in z], rtol=1e-9)
    whole = sum(term.response(z) for term in found.pid) * found.filters[0].response(z)
    np.testing.assert_allclose(found.response(z), whole, rtol=1e-13)


def test_a_discretized_notch_is_itself_at_its_center():
    notch = notch_filter(700.0, 0.1, 0.25)
    found = trapezoidal(notch, 1e-3).response(np.exp(0.7j))
    assert found == pytest.approx(notch.response(700j), abs=0, rel=1e-12)


def test_a_filter_without_a_center_is_discretized_as_scipy_does():
    plain = Filter((2.0, 1e4), (1.0, 3e3, 1e7))
    found = trapezoidal(plain, 1e-3)
    numerator, denominator = signal.bilinear(plain.numerator, plain.denominator, fs=1e3)
    assert plain.center == 0
    np.testing.assert_allclose(found.numerator, numerator, rtol=1e-12)
    np.testing.assert_allclose(found.denominator, denominator, rtol=1e-12)


def test_states_and_difference_equations_of_the_controller_are_its_transfer_function():
    loop, _ = sampled(1e-3, rolloff_time=2e-3)
    found = discrete_controller(loop.controller)
    states = found.states
    z = np.exp(1j * np.array([0.05, 0.5, 2.0]))
    by_states = [
        states.c @ np.linalg.solve(p * np.eye(states.order) - states.a, states.b) + states.d for p in z
    ]
    np.testing.assert_allclose(by_states, found.response(z), rtol=1e-9)
    # The printed lines, run as they stand, give the same sequence.
    rng = np.random.default_rng(1)
    e = rng.normal(size=30)
    lines = found.lines()
    assert [line.split("[")[0] for line in lines] == ["e1", "p", "i", "d", "u"]
    signals = {name: np.zeros(39) for name in ("e", "e1", "p", "i", "d", "u")}
    signals["e"][9:] = e
    for k in range(9, 39):
        for line in lines:
            target, text = line.split(" = ")
            text = re.sub(r"(\w+)\[k", r"signals['\1'][k", re.sub(r"(\d) (\w+\[)", r"\1 * \2", text))
            signals[target.split("[")[0]][k] = eval(text, {"signals": signals, "k": k})  # what the lines say
    x, expected = np.zeros(states.order), []
    for value in e:
        expected.append(states.c @ x + states.d * value)
        x = states.a @ x + states.b * value
    np.testing.assert_allclose(signals["u"][9:], expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


def test_a_proportional_loop_turns_unstable_at_the_period_that_jurys_test_gives():
    gain, w, ratio = 3e4, 100.0, 0.05

    def outer(period):
        """Product of the two poles of z² + (a1 + K b1) z + a2 + K b2."""
        decay, wd = exp(-ratio * w * period), w * sqrt(1 - ratio**2)
        c, s = cos(wd * period), sin(wd * period) * ratio * w / wd
        b2 = (decay**2 + decay * (s - c)) / w**2
        return decay**2 + gain * b2

    boundary = optimize.brentq(lambda t: outer(t) - 1, 1e-4, 5e-3, xtol=1e-15)

    def abscissa(period):
        return sampled_loop(*rigid(gain, Sampling(period)), "tip").spectral_abscissa

    assert optimize.brentq(abscissa, 1e-4, 5e-3, xtol=1e-15) == pytest.approx(boundary, abs=0, rel=1e-9)
    assert abscissa(0.999 * boundary) < 0 < abscissa(1.001 * boundary)
    model = SampledModel(*rigid(gain, Sampling(1.001 * boundary)), "tip", reference.DISTURBANCES)
    assert not model.stable
    with pytest.raises(UnstableError, match="sampled loop is unstable"):
        _ = model.variances


def test_the_delay_at_which_a_loop_turns_unstable_is_its_phase_margin():
    loop, modes = sampled(1e-4, anti_alias=())
    modes = modes.keep(np.arange(12))

    def abscissa(delay):
        path = replace(loop.controller.path, sampling=Sampling(1e-4, delay))
        return SampledModel(replace(loop, controller=replace(loop.controller, path=path)), modes, "tip")

    longest = optimize.brentq(lambda d: abscissa(d).spectral_abscissa, 0.0, 2e-2, xtol=1e-14)
    # There the loop transfer function passes through −1.
    assert abscissa(longest).modulus_margin < 1e-6
    assert longest > 1e-4


def test_a_delay_of_almost_a_period_is_that_of_a_whole_one():
    before, after = (SampledModel(*sampled(2e-4, delay), "tip") for delay in (2e-4 * (1 - 1e-7), 2e-4))
    assert before.spectral_abscissa == pytest.approx(after.spectral_abscissa, abs=0, rel=1e-5)
    assert before.modulus_margin == pytest.approx(after.modulus_margin, abs=0, rel=1e-5)


def halvings(values, limit):
    """How much closer each value is to a limit than the one before."""
    off = np.abs(np.array(values) - limit)
    return off[:-1] / off[1:]


def test_a_loop_sampled_ever_faster_becomes_the_continuous_one():
    periods = [4e-5, 2e-5, 1e-5]
    found = [SampledModel(*sampled(period), "tip") for period in periods]
    loop, modes = sampled(1e-4)
    bare = replace(loop.controller.path, sampling=None)
    loop = replace(loop, controller=replace(loop.controller, path=bare))
    model, poles = LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip")
    # A hold lags by half a period: first order.
    margin = float(modulus_margins(model, poles, 1)[0][0])
    np.testing.assert_allclose(halvings([m.modulus_margin for m in found], margin), 2, rtol=0.1)
    np.testing.assert_allclose(
        halvings([m.spectral_abscissa for m in found], poles.spectral_abscissa), 2, rtol=0.1
    )
    assert found[-1].loop_crossover == pytest.approx(crossover(model, poles)[0], abs=0, rel=1e-3)


@pytest.mark.parametrize("derivative", ["backward", "trapezoidal"])
def test_the_continuous_model_of_a_sampled_loop_is_right_to_second_order(derivative):
    off = []
    for period in (1e-4, 5e-5, 2.5e-5):
        loop, modes = sampled(period, 0.4 * period, derivative=derivative)
        poles = closed_loop_poles(loop, modes, "tip")
        margin = float(modulus_margins(LoopModel(loop, modes, "tip"), poles, 1)[0][0])
        off.append(SampledModel(loop, modes, "tip").modulus_margin - margin)
    np.testing.assert_allclose(np.array(off[:-1]) / off[1:], 4, rtol=0.02)


def test_the_modulus_margin_is_the_least_of_a_dense_sweep():
    loop, modes = sampled(2e-4, 1e-4)
    model = SampledModel(loop, modes.keep(np.arange(12)), "tip")
    w = np.geomspace(1.0, 0.999 * pi / 2e-4, 10_000)
    for _ in range(2):
        distance = np.abs(1 + model.bare.loop_transfer(np.exp(1j * w * 2e-4)))
        least = int(np.argmin(distance))
        w = np.linspace(w[least - 1], w[least + 1], 1000)
    assert model.modulus_margin <= distance.min() * (1 + 1e-12)
    assert model.modulus_margin == pytest.approx(distance.min(), abs=0, rel=1e-6)
    at_crossover = model.bare.loop_transfer(np.exp(1j * np.array([model.loop_crossover]) * 2e-4))
    assert abs(at_crossover[0]) == pytest.approx(1, abs=0, rel=1e-9)


def test_a_delay_of_whole_periods_leaves_no_sliver_of_one():
    for delay in (3e-4, 3e-4 * (1 + 3e-16), 3e-4 * (1 - 3e-16)):
        loop, modes = sampled(1e-4, delay)
        found = sampled_loop(loop, modes, "tip")
        assert (found.whole, found.rest) == (3, 0.0)
    late = sampled_loop(*sampled(1e-4, 3.25e-4), "tip")
    assert late.whole == 3 and late.rest == pytest.approx(0.25e-4, abs=0, rel=1e-9)


def test_what_cannot_be_sampled_is_refused():
    loop, modes = sampled(2e-4)
    with pytest.raises(ModelError, match="not sampled"):
        sampled_loop(replace(loop, controller=replace(loop.controller, path=SignalPath())), modes, "tip")
    with pytest.raises(ModelError, match="ring"):
        discrete_controller(sampled(2e-4, rolloff_time=0.0, derivative="trapezoidal")[0].controller)
    with pytest.raises(ModelError, match="Nyquist"):
        discrete_controller(sampled(2e-3)[0].controller)
    with pytest.raises(ModelError, match="Nyquist"):
        trapezoidal(notch_filter(np.pi, 0.3), 1.0)
    with pytest.raises(SolverError, match="stays below one"):
        _ = SampledModel(*rigid(1.0, Sampling(1e-3)), "tip").loop_crossover
