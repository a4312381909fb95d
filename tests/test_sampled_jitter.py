"""Jitter and steps of sampled loops: closed forms, a second route, a spectrum by frequency, a plain simulation."""

from __future__ import annotations

from dataclasses import replace
from math import exp, inf, log, pi

import numpy as np
import pytest
import reference
from sampled_loops import plain_simulation, rigid, sampled
from scipy import integrate, linalg

from fosopt.control import Sampling, closed_loop_poles, low_pass_filter
from fosopt.control.discrete import DiscreteController, DiscreteFilter
from fosopt.control.sampled import SampledLoop
from fosopt.control.spans import energy_for_ever
from fosopt.errors import ModelError, SolverError, UnstableError
from fosopt.metrics.disturbances import Disturbance, ShapingFilter, high_pass, low_pass, white
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.peaks import peaks
from fosopt.metrics.sampled import SampledModel, averaged_variances
from fosopt.metrics.sampled_check import Forward, forward, sampled_disagreement
from fosopt.metrics.sampled_steps import sampled_peaks, sampled_response, sampled_step_metrics
from fosopt.metrics.sequence import Retargeting
from fosopt.metrics.step import StepCommand, step_metrics

HZ = reference.HZ
DISTURBANCES = (
    Disturbance("cooling", "mirror_torque", low_pass(8.5 * HZ, 0.02)),
    Disturbance("aft_body", "hub_torque", low_pass(5 * HZ, 1.0, 2)),
    Disturbance("air", "line_of_sight", low_pass(8.5 * HZ, 1e-5)),
    Disturbance("sensor", "sensor_noise", high_pass(70 * HZ, 1e-8)),
)


def first_order(decay, gain, period, whole=0, rest=0.0):
    """ẋ = −a x + u + w, y = x, held torque u = −K x with a delay."""
    controller = DiscreteController(period, (DiscreteFilter((gain,), (1.0,)),), ())
    one = np.ones(1)
    return SampledLoop(
        np.array([[-decay]]), one, one, one, np.zeros((2, 1)), np.ones((1, 1)), controller, controller.states,
        period, whole, rest,
    )  # fmt: skip


@pytest.mark.parametrize(("decay", "gain", "period"), [(2.0, 3.0, 0.1), (0.5, 8.0, 0.2), (10.0, 0.0, 0.3)])
def test_jitter_of_a_first_order_loop_is_the_closed_form_also_between_samples(decay, gain, period):
    loop = first_order(decay, gain, period)
    (found,) = averaged_variances(loop)
    phi = exp(-decay * period) - gain * (1 - exp(-decay * period)) / decay
    assert loop.spectral_abscissa == pytest.approx(log(abs(phi)) / period, abs=0, rel=1e-12)
    at_samples = (1 - exp(-2 * decay * period)) / (2 * decay) / (1 - phi**2)

    def square(t):
        carried = exp(-decay * t) - gain * (1 - exp(-decay * t)) / decay
        return carried**2 * at_samples + (1 - exp(-2 * decay * t)) / (2 * decay)

    expected = integrate.quad(square, 0, period, epsabs=0, epsrel=1e-12)[0] / period
    assert found == pytest.approx(expected, abs=0, rel=1e-10)
    if gain:
        # What samples alone show is something else.
        assert abs(found / at_samples - 1) > 1e-3


def test_jitter_of_a_delayed_first_order_loop_is_that_of_its_covariance_in_small_steps():
    decay, gain, period, rest, count = 2.0, 3.0, 0.1, 0.04, 2000
    (found,) = averaged_variances(first_order(decay, gain, period, 1, rest))
    # x and the three last torques; the third acts until `rest`, the second after it.
    step = period / count
    free = exp(-decay * step)
    push, noise = (1 - free) / decay, (1 - free**2) / (2 * decay)
    rows, added, total = [np.eye(4)[0]], [0.0], 0.0
    for k in range(count):
        torque = np.eye(4)[3] if k * step < rest - 1e-12 else np.eye(4)[2]
        rows.append(free * rows[-1] + push * torque)
        added.append(free**2 * added[-1] + noise)
    # At a sample u[k] = −K x joins the torques: states are [x, u[k], u[k−1], u[k−2]] right after it.
    moved = np.zeros((4, 4))
    moved[0] = rows[-1]
    moved[1], moved[2], moved[3] = -gain * rows[-1], np.eye(4)[1], np.eye(4)[2]
    pushed = np.zeros((4, 4))
    pushed[:2, :2] = added[-1] * np.array([[1, -gain], [-gain, gain**2]])
    covariance = linalg.solve_discrete_lyapunov(moved, pushed)
    total = integrate.simpson([r @ covariance @ r + n for r, n in zip(rows, added, strict=True)], dx=step)
    assert found == pytest.approx(total / period, abs=0, rel=1e-9)


@pytest.mark.parametrize(("period", "delay"), [(4e-4, 0.0), (2e-4, 1.4e-4), (1e-4, 2.5e-4)])
def test_two_routes_to_the_jitter_of_the_truss_agree(period, delay):
    loop, modes = sampled(period, delay)
    model = SampledModel(loop, modes.keep(np.arange(12)), "tip", DISTURBANCES)
    poles, jitter = sampled_disagreement(model)
    assert poles < 1e-12 and jitter < 1e-8
    assert forward(model).radius == pytest.approx(np.exp(model.spectral_abscissa * period), abs=0, rel=1e-12)
    for disturbance in DISTURBANCES:
        alone = replace(model, disturbances=(disturbance,))
        assert alone.variances[disturbance.name] == pytest.approx(
            model.variances[disturbance.name], abs=0, rel=1e-9
        )
        assert alone.variances[disturbance.name] == pytest.approx(forward(alone).variance, abs=0, rel=1e-7)


def test_the_disagreement_of_rms_is_half_the_relative_one_of_the_mean_square(monkeypatch):
    loop, modes = sampled(4e-4, 0.0)
    model = SampledModel(loop, modes.keep(np.arange(4)), "tip", DISTURBANCES)
    right = forward(model)
    other = Forward(right.variance * 1.25, right.radius - 0.125)
    monkeypatch.setattr("fosopt.metrics.sampled_check.forward", lambda _: other)
    poles, jitter = sampled_disagreement(model)
    assert poles == pytest.approx(0.125, rel=1e-9)
    assert jitter == pytest.approx(0.5 * 0.25 / 1.25, rel=1e-6)
    assert sampled_disagreement(replace(model, disturbances=()))[1] is None


@pytest.mark.parametrize(("period", "delay"), [(4e-4, 0.0), (4e-4, 5.5e-4)])
@pytest.mark.parametrize("at", ["mirror_torque", "hub_torque", "line_of_sight", "sensor_noise"])
def test_jitter_by_frequency_adds_up_to_that_by_covariance(at, period, delay):
    shape = low_pass(60 * HZ, 1.0, 4)
    loop, modes = sampled(period, delay)
    modes = modes.keep(np.arange(5))
    whole = SampledModel(loop, modes, "tip", (Disturbance("w", at, shape),))
    # Beyond 4 kHz a fourth-order low pass at 60 Hz has 1e-13 of its power left.
    band = SampledModel(loop, modes, "tip", (Disturbance("w", at, shape, band=(0.0, 4000 * HZ)),))
    # The loop attenuates a torque by 1e5: amplitudes that cancel leave 1e-11, squares that cancel would leave 1e-6.
    assert band.variances["w"] == pytest.approx(whole.variances["w"], abs=0, rel=1e-9)
    # A band that begins above zero and never ends is the rest.
    above = SampledModel(loop, modes, "tip", (Disturbance("w", at, shape, band=(40 * HZ, inf)),))
    below = SampledModel(loop, modes, "tip", (Disturbance("w", at, shape, band=(0.0, 40 * HZ)),))
    assert above.variances["w"] + below.variances["w"] == pytest.approx(whole.variances["w"], abs=0, rel=1e-9)


@pytest.mark.parametrize("at", ["line_of_sight", "sensor_noise"])
def test_what_rolls_off_by_itself_needs_no_anti_alias_filter(at):
    shape = low_pass(60 * HZ, 1.0, 3)
    loop, modes = sampled(4e-4, anti_alias=())
    modes = modes.keep(np.arange(3))
    whole = SampledModel(loop, modes, "tip", (Disturbance("w", at, shape),))
    band = SampledModel(loop, modes, "tip", (Disturbance("w", at, shape, band=(0.0, 4000 * HZ)),))
    # Beyond 4 kHz a third-order low pass at 60 Hz has 1e-10 of its power left.
    assert band.variances["w"] == pytest.approx(whole.variances["w"], abs=0, rel=1e-7)
    assert forward(whole).variance == pytest.approx(whole.variances["w"], abs=0, rel=1e-8)


def test_a_tabulated_spectrum_gives_the_jitter_of_its_filter():
    shape = low_pass(60 * HZ, 1.0, 2)
    frequency = np.linspace(0.0, 300 * HZ, 1000)
    psd = Disturbance("w", "mirror_torque", shape).one_sided_psd(frequency)
    loop, modes = sampled(4e-4)
    modes = modes.keep(np.arange(3))
    table = SampledModel(loop, modes, "tip", (Disturbance("w", "mirror_torque", None, frequency, psd),))
    band = SampledModel(loop, modes, "tip", (Disturbance("w", "mirror_torque", shape, band=(0.0, 300 * HZ)),))
    # Linear between 1000 rows.
    assert table.variances["w"] == pytest.approx(band.variances["w"], abs=0, rel=1e-4)


def test_a_table_of_few_rows_is_the_sum_of_its_pieces():
    frequency, psd = np.array([2.0, 11.0, 12.0, 60.0, 90.0]) * HZ, np.array([0.0, 3.0, 0.5, 2.0, 0.0])
    loop, modes = sampled(4e-4)
    modes = modes.keep(np.arange(2))

    def square(rows):
        table = Disturbance("w", "mirror_torque", None, frequency[rows], psd[rows])
        return SampledModel(loop, modes, "tip", (table,)).variances["w"]

    pieces = sum(square(slice(k, k + 2)) for k in range(4))
    assert square(slice(None)) == pytest.approx(pieces, abs=0, rel=1e-9)


def test_jitter_sampled_ever_faster_becomes_that_of_the_continuous_loop():
    loop, modes = sampled(1e-4)
    still = replace(loop.controller, path=replace(loop.controller.path, sampling=None))
    model = LoopModel(replace(loop, controller=still), modes, "tip")
    poles = closed_loop_poles(model.loop, modes, "tip")
    limit = np.array([v.value for v in jitter_variances(model, poles, DISTURBANCES)])
    off = []
    for period in (2e-5, 1e-5, 5e-6):
        values = SampledModel(*sampled(period), "tip", DISTURBANCES).variances
        off.append(np.array(list(values.values())) - limit)
    assert np.all(np.abs(off[-1]) < 0.02 * limit)
    np.testing.assert_allclose(off[0] / off[1], 2, rtol=0.1)
    np.testing.assert_allclose(off[1] / off[2], 2, rtol=0.1)


def test_noise_beyond_nyquist_is_folded_into_the_band():
    noise = Disturbance("n", "sensor_noise", white(1e-8))
    values = []
    for corner in (4000 * HZ, 32000 * HZ, 128000 * HZ):
        loop, modes = sampled(2e-4, anti_alias=(low_pass_filter(corner, 2),))
        values.append(SampledModel(loop, modes, "tip", (noise,)).variances["n"])
    # Far above the Nyquist frequency, 2.5 kHz, samples of filtered white noise are uncorrelated, and their power is
    # proportional to the corner; the filter's lag in the loop no longer matters.
    assert values[1] / values[0] > 5
    assert values[2] / values[1] == pytest.approx(4, abs=0, rel=0.02)


def test_repeated_poles_of_a_spectrum_do_no_harm():
    double = ShapingFilter((1.0,), tuple(np.poly([-50.0, -50.0, -50.0]).tolist()))
    near = ShapingFilter((1.0,), tuple(np.poly([-50.0, -50.001, -49.999]).tolist()))
    loop, modes = sampled(2e-4)
    of = [Disturbance(name, "mirror_torque", s) for name, s in (("a", double), ("b", near))]
    values = SampledModel(loop, modes, "tip", tuple(of)).variances
    assert values["a"] == pytest.approx(values["b"], abs=0, rel=1e-4)


@pytest.mark.parametrize("delay", [0.0, 0.75, 1.5])
def test_a_step_of_a_sampled_loop_is_that_of_a_plain_simulation(delay):
    period, count = 4e-4, 40
    loop, modes = sampled(period, delay * period, anti_alias=())
    modes = modes.keep(np.arange(4))
    model = SampledModel(loop, modes, "tip")
    assert model.stable
    simulated = plain_simulation(loop, modes, count, 100, lambda k: 1.0)
    time = np.arange(simulated.shape[0]) * period / count
    chosen = np.arange(0, 400, 7)
    np.testing.assert_allclose(sampled_response(model.bare, time[chosen]), simulated[chosen, 0], atol=1e-9)
    # A window whose edges lie between samples.
    first, last = 20 * count + 10, 70 * count + 30
    window = simulated[first : last + 1, 0] - 1
    span = time[last] - time[first]
    mean = integrate.simpson(window, dx=period / count) / span
    square = integrate.simpson(window**2, dx=period / count) / span
    found = sampled_step_metrics(model.bare, StepCommand(2.0, (float(time[first]), float(time[last]))))
    assert found["step_offset"] == pytest.approx(2 * abs(mean), abs=0, rel=1e-4)
    assert found["step_rms"] == pytest.approx(2 * np.sqrt(square - mean**2), abs=0, rel=1e-4)


def test_peaks_of_a_sampled_sequence_are_those_of_a_plain_simulation():
    period, count = 4e-4, 32
    loop, modes = sampled(period, 0.5 * period, anti_alias=())
    modes = modes.keep(np.arange(4))
    sequence = Retargeting(-3.0, 0.012, 0.008, 4, "staircase")
    found = sampled_peaks(SampledModel(loop, modes, "tip").bare, sequence)
    commands = sequence.target((np.arange(200) + 1e-6) * period)
    simulated = np.abs(plain_simulation(loop, modes, count, 200, lambda k: commands[k])).max(axis=0)
    assert found["peak_stroke"] == pytest.approx(simulated[1], abs=0, rel=2e-3)
    assert found["peak_rate"] == pytest.approx(simulated[2], abs=0, rel=2e-2)
    assert found["peak_torque"] == pytest.approx(simulated[3], abs=0, rel=1e-9)


def test_steps_and_peaks_sampled_ever_faster_become_the_continuous_ones():
    loop, modes = sampled(1e-4)
    still = replace(loop.controller, path=replace(loop.controller.path, sampling=None))
    model = LoopModel(replace(loop, controller=still), modes, "tip")
    poles = closed_loop_poles(model.loop, modes, "tip")
    step, sequence = StepCommand(1e-6, (0.02, 0.05)), Retargeting(1e-6, 0.02, 0.03, 2)
    limit = {name: value for name, (value, _) in step_metrics(model, poles, step).items()}
    limit |= peaks(model, poles, sequence)
    bare = SampledModel(*sampled(1e-5), "tip").bare
    found = sampled_step_metrics(bare, step) | sampled_peaks(bare, sequence)
    for name, value in limit.items():
        # First order in the period; the torque jumps at the step, where it is seen last.
        assert found[name] == pytest.approx(value, abs=0, rel=0.1 if name == "peak_torque" else 0.04), name


def test_nothing_unstable_has_jitter_steps_or_peaks():
    loop, modes = sampled(4e-4, 5e-3)
    model = SampledModel(loop, modes, "tip", DISTURBANCES)
    assert not model.stable
    with pytest.raises(UnstableError, match="unstable"):
        _ = model.variances
    with pytest.raises(UnstableError, match="unstable"):
        sampled_step_metrics(model.bare, StepCommand(1.0, (0.1, 0.2)))
    with pytest.raises(UnstableError, match="unstable"):
        sampled_peaks(model.bare, Retargeting(1.0, 0.1, 0.1, 1))
    with pytest.raises(SolverError, match="does not end"):
        energy_for_ever(np.eye(2), np.eye(2))


def test_infinite_variances_are_refused():
    loop, modes = sampled(2e-4, anti_alias=())
    noise = (Disturbance("n", "sensor_noise", white(1e-8)),)
    with pytest.raises(ModelError, match="anti-alias"):
        _ = SampledModel(loop, modes, "tip", noise).variances
    # Within a band there is no harm.
    banded = (Disturbance("n", "sensor_noise", white(1e-8), band=(0.0, 1000 * HZ)),)
    assert SampledModel(loop, modes.keep(np.arange(6)), "tip", banded).variances["n"] > 0
    with pytest.raises(ModelError, match="infinite power"):
        air = (Disturbance("a", "line_of_sight", white(1e-8)),)
        _ = SampledModel(*sampled(2e-4), "tip", air).variances


@pytest.mark.parametrize(("at", "turns", "count"), [("sensor_noise", 7, 40), ("line_of_sight", 807, 2000)])
def test_a_hold_of_constant_torque_has_the_power_of_its_sequence(at, turns, count):
    # A rigid mirror fed one frequency: power between samples by a plain average over one period of both.
    period = 2e-3
    loop, modes = rigid(2e3, Sampling(period, 0.5e-3), damping_ratio=0.3)
    model = SampledModel(loop, modes, "tip")
    assert model.stable
    # A frequency commensurate with the sampling: whole periods of it in forty samples, twenty in each for the fast one.
    frequency, samples = 2 * pi * turns / (40 * period), 40
    power = model.power(at, np.array([frequency]))[0]
    z = np.exp(1j * frequency * period)
    transfer = model.bare.loop_transfer(np.array([z]))[0]
    torque = -model.bare.controller.response(np.array([z]))[0] / (1 + transfer)
    a, b = np.array([[0.0, 1.0], [-1e4, -60.0]]), np.array([0.0, 1.0])
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[:2, 2] = a, b
    # From instant to instant within a period, and over a quarter and the rest of it.
    fine = linalg.expm(whole * period / count)
    powers = [np.eye(3)]
    for _ in range(count):
        powers.append(fine @ powers[-1])
    powers, late = np.array(powers), count // 4
    x, seen = np.zeros(2, dtype=complex), []
    for k in range(-400, samples):
        before = powers[:late] @ np.append(x, torque * z ** (k - 1))
        middle = (powers[late] @ np.append(x, torque * z ** (k - 1)))[:2]
        after = powers[: count - late] @ np.append(middle, torque * z**k)
        if k >= 0:
            direct = float(at == "line_of_sight") * np.exp(
                1j * frequency * (k + np.arange(count) / count) * period
            )
            seen.append(np.mean(np.abs(np.concatenate([before, after])[:, 0] + direct) ** 2))
        x = (powers[count - late] @ np.append(middle, torque * z**k))[:2]
    assert power == pytest.approx(np.mean(seen), abs=0, rel=1e-3 if at == "sensor_noise" else 1e-6)
