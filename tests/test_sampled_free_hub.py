"""Sampled loops on a free hub: a mirror on two bodies, the plant that drifts, images in frequency, fast sampling."""

from __future__ import annotations

from dataclasses import replace
from math import inf, pi, sqrt

import numpy as np
import pytest
import reference
from sampled_loops import ANTI_ALIAS, plain_simulation, sampled
from scipy import linalg, optimize
from small_studies import HELD_KEYS, analysis, section

from fosopt.actuators import Mirror, MirrorReactionMass, Placement, ReactionMassActuator
from fosopt.certify import certify
from fosopt.control import (
    DIRECT,
    PID,
    Loop,
    Sampling,
    SignalPath,
    closed_loop_poles,
    plant_state_space,
)
from fosopt.control.sampled import SampledLoop, Source, sampled_loop
from fosopt.control.sampled_closed import sampled_closed_loop_state_space
from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance, ShapingFilter, band_pass, high_pass, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.margins import crossover, modulus_margins
from fosopt.metrics.peaks import peaks
from fosopt.metrics.sampled import SampledModel
from fosopt.metrics.sampled_check import forward, sampled_disagreement
from fosopt.metrics.sampled_steps import sampled_peaks, sampled_response, sampled_step_metrics
from fosopt.metrics.sequence import Retargeting
from fosopt.metrics.step import StepCommand, step_metrics
from fosopt.modes import Hub, ModalSet
from fosopt.study import parse_study
from fosopt.study.build import build_problem, start_vector

HZ = reference.HZ
FREE = Hub("free")
ONCE, TWICE = band_pass(1 * HZ, 8 * HZ, 0.02), band_pass(1 * HZ, 8 * HZ, 0.02, 2)
PUSHING = tuple(
    Disturbance(f"{at}_{order}", f"{at}_torque", shape)
    for at in ("mirror", "hub")
    for order, shape in ((1, ONCE), (2, TWICE))
)
DISTURBANCES = (
    *PUSHING,
    Disturbance("air", "line_of_sight", low_pass(8.5 * HZ, 1e-5)),
    Disturbance("sensor", "sensor_noise", high_pass(70 * HZ, 1e-8)),
)


def free_loop(period, delay=0.0, count=12, **options):
    """The reference loop, sampled, on the free hub."""
    loop, _ = sampled(period, delay, **options)
    modes = reference.modes_of(reference.structure(), FREE)
    return loop, modes.keep(np.arange(count))


def two_bodies(gain, period, delay, inertia=0.5, **pid):
    """A mirror of 1 kg m² on a free body, and the fixed mirror that moves as it does against that body."""
    terms = {"kp": 1.0, "ki": 0.0, "kd": 0.0} | pid
    path = SignalPath(sampling=Sampling(period, delay))
    shape = np.full((1, 2), 1 / sqrt(inertia))
    body = ModalSet(np.zeros(1), np.zeros(1), shape, reference.PORTS, np.ones(1, bool))
    nothing = ModalSet(np.zeros(0), np.zeros(0), np.zeros((0, 2)), reference.PORTS, np.zeros(0, bool))
    free = Mirror(1.0, 100.0, 0.05)
    share = inertia / (1 + inertia)  # of the stroke that is the mirror's own, and its reduced inertia
    frequency = sqrt(free.stiffness / share)
    fixed = Mirror(share, frequency, free.damping / (2 * share * frequency))
    return (
        SampledModel(Loop(free, PID(gain, path=path, **terms)), body, "tip"),
        SampledModel(Loop(fixed, PID(gain * share, path=path, **terms)), nothing, "tip"),
        share,
    )


@pytest.mark.parametrize("share", [0.0, 0.3, 1.7])
def test_a_mirror_on_a_free_body_is_a_fixed_one_of_the_reduced_inertia(share):
    free, fixed, part = two_bodies(2e3, 1e-3, share * 1e-3, ki=10.0, kd=0.05)
    assert free.stable
    np.testing.assert_allclose(
        np.sort_complex(free.bare.poles), np.sort_complex(fixed.bare.poles), atol=1e-10
    )
    assert free.spectral_abscissa == pytest.approx(fixed.spectral_abscissa, abs=0, rel=1e-9)
    assert free.modulus_margin == pytest.approx(fixed.modulus_margin, abs=0, rel=1e-9)
    assert free.loop_crossover == pytest.approx(fixed.loop_crossover, abs=0, rel=1e-9)
    time = np.linspace(0, 0.05, 333)
    np.testing.assert_allclose(
        sampled_response(free.bare, time), sampled_response(fixed.bare, time), atol=1e-11
    )
    # The fixed mirror turns by the stroke: a command of its size asks for the same.
    sequence = Retargeting(1.0, 0.02, 0.03, 3)
    larger = replace(sequence, command=1 / part)
    found, expected = sampled_peaks(free.bare, sequence), sampled_peaks(fixed.bare, larger)
    assert found == pytest.approx(expected, abs=0, rel=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.3])
@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"reaction_mass": MirrorReactionMass(inertia_ratio=0.9, torque_ratio=0.95)},
        {"actuators": (ReactionMassActuator("B6.y", 1.0, 10 * HZ, 0.05, 50.0),)},
        {"placement": Placement(reaction="B4.rz")},
        {
            "placement": Placement(sensor="B3.rz", action="B4.rz"),
            "reaction_mass": MirrorReactionMass(1.1, 0.9),
        },
    ],
    ids=["bicollocated", "reactionless", "absorber", "reaction elsewhere", "all elsewhere"],
)
def test_the_plant_that_drifts_has_the_same_loop_and_two_poles_at_one_more(parts, share):
    of = reference.structure("pinned", 6)
    mirror = replace(reference.mirror_of(of, 0.2), reaction_mass=parts.get("reaction_mass"))
    parts = {key: value for key, value in parts.items() if key != "reaction_mass"}
    base = reference.loop_of(mirror, 1e-4).controller
    period = 2e-4
    path = SignalPath(sampling=Sampling(period, share * period))
    loop = Loop(mirror, replace(base, gain=0.1 * base.gain, path=path), **parts)
    modes = reference.evaluation(bays=6, loop=loop, hub=FREE, seed=3).modes
    modes = modes.keep(np.arange(8))
    found = sampled_loop(loop, modes, "tip")
    plant = plant_state_space(loop, modes, "tip")
    rows = {name: plant.c[plant.outputs.index(name)] for name in plant.outputs}
    whole = SampledLoop(
        plant.a, plant.b[:, plant.inputs.index("control_torque")], rows["mirror_angle"], rows["sensor_angle"],
        np.zeros((2, plant.a.shape[0])), np.zeros((0, plant.a.shape[0])), found.controller, found.states, period,
        found.whole, found.rest,
    )  # fmt: skip
    assert whole.size == found.size + 2
    # Double eigenvalues, those at one and the delays' at zero, split by the root of rounding.
    drift = np.argsort(np.abs(whole.poles - 1))[:2]
    assert np.abs(whole.poles[drift] - 1).max() < 1e-4
    others = np.delete(whole.poles, drift)
    rows, columns = optimize.linear_sum_assignment(np.abs(others[:, None] - found.poles))
    apart = np.abs(others[rows] - found.poles[columns])
    assert apart.max() < 1e-4 and apart[np.abs(others[rows]) > 1e-3].max() < 1e-9
    z = np.exp(1j * np.array([0.02, 0.3, 2.0]))
    np.testing.assert_allclose(found.plant_response(z), whole.plant_response(z), rtol=1e-7)


def test_two_free_bodies_are_the_one_that_moves_the_ports():
    loop, modes = free_loop(2e-4, 1e-4, 6)
    turn = np.array([0.6, 0.8])
    parted = ModalSet(
        np.concatenate([[0.0], modes.natural_frequency]),
        np.concatenate([[0.0], modes.damping_ratio]),
        np.vstack([np.outer(turn, modes.mode_shape[0]), modes.mode_shape[1:]]),
        modes.ports,
        np.concatenate([[True], modes.rigid]),
    )
    one, two = (SampledModel(loop, each, "tip", DISTURBANCES) for each in (modes, parted))
    # The other one is a motion without momentum at the ports: a plant that moves within does not know of it.
    assert two.bare.size == one.bare.size
    np.testing.assert_allclose(np.sort_complex(two.bare.poles), np.sort_complex(one.bare.poles), atol=1e-11)
    assert two.variances == pytest.approx(one.variances, abs=0, rel=1e-7)


@pytest.mark.parametrize("delay", [0.0, 0.75, 1.5])
def test_steps_and_peaks_are_those_of_a_plain_simulation_of_the_plant_that_drifts(delay):
    period, count = 4e-4, 32
    loop, modes = free_loop(period, delay * period, 4, anti_alias=())
    model = SampledModel(loop, modes, "tip")
    assert model.stable
    sequence = Retargeting(-3.0, 0.012, 0.008, 4, "staircase")
    commands = sequence.target((np.arange(200) + 1e-6) * period)
    simulated = plain_simulation(loop, modes, count, 200, lambda k: commands[k])
    largest = np.abs(simulated).max(axis=0)
    found = sampled_peaks(model.bare, sequence)
    assert found["peak_stroke"] == pytest.approx(largest[1], abs=0, rel=2e-3)
    assert found["peak_rate"] == pytest.approx(largest[2], abs=0, rel=2e-2)
    assert found["peak_torque"] == pytest.approx(largest[3], abs=0, rel=1e-9)
    # The first of its steps, between samples too.
    time = np.arange(40 * count) * period / count
    np.testing.assert_allclose(
        -3.0 * sampled_response(model.bare, time), simulated[: time.size, 0], atol=1e-9
    )


@pytest.mark.parametrize("at", ["mirror_torque", "hub_torque", "line_of_sight", "sensor_noise"])
@pytest.mark.parametrize(
    ("delay", "sensor", "anti_alias"), [(0.3, None, ANTI_ALIAS), (1.6, None, ()), (0.0, "hub", ANTI_ALIAS)]
)
def test_the_power_of_one_frequency_is_that_of_its_images_through_the_plant_that_drifts(
    at, delay, sensor, anti_alias
):
    # What is held repeats itself at ω + nω_s, where the hold lets (1 − e^{−sT})/s pass: Parseval over the images.
    period = 4e-4
    loop, modes = free_loop(period, delay * period, 3, anti_alias=anti_alias)
    if sensor:
        loop = replace(loop, placement=Placement(sensor=sensor))
        # A sensor that turns with the whole, but not as far as the mirror.
        shape = modes.mode_shape.copy()
        shape[0, modes.ports.index(sensor)] *= 0.7
        modes = replace(modes, mode_shape=shape)
    model = SampledModel(loop, modes, "tip")
    plant = plant_state_space(loop, modes, "tip")
    frequency = np.array([0.5, 40.0, 390.0]) * HZ
    image = np.arange(-1500, 1501)
    s = 1j * (frequency[:, None] + 2 * pi * image / period)

    def filtered(s):
        return anti_alias[0].response(s) if anti_alias else np.ones_like(s)

    def of(name, output, s):
        return plant.response(s.ravel(), name, output).reshape(s.shape)

    held = np.exp(-s * delay * period) * (1 - np.exp(-s * period)) / s
    z = np.exp(1j * frequency * period)
    moved = of("control_torque", "mirror_angle", s) * held / period
    seen = np.sum(of("control_torque", "sensor_angle", s) * held * filtered(s), axis=1) / period
    torque = model.bare.controller.response(z) / (1 + seen * model.bare.controller.response(z))
    here = s[:, 1500]
    if "torque" in at:
        direct, read = (of(at, f"{name}_angle", here) for name in ("mirror", "sensor"))
    else:
        direct, read = np.full(3, float(at == "line_of_sight")), np.ones(3)
    images = -(torque * read * filtered(here))[:, None] * moved
    images[:, 1500] += direct
    expected = np.sum(np.abs(images) ** 2, axis=1)
    # Amplitudes of the images fall off as n⁻³, as do those the sampler folds back without a filter.
    np.testing.assert_allclose(model.power(at, frequency), expected, rtol=1e-8 if anti_alias else 1e-6)


@pytest.mark.parametrize(("period", "delay"), [(4e-4, 0.0), (2e-4, 2.6e-4)])
def test_two_routes_to_the_jitter_agree_whatever_pushes(period, delay):
    model = SampledModel(*free_loop(period, delay), "tip", DISTURBANCES)
    poles, jitter = sampled_disagreement(model)
    assert poles < 1e-11 and jitter < 1e-8
    for disturbance in DISTURBANCES:
        alone = replace(model, disturbances=(disturbance,))
        assert alone.variances[disturbance.name] == pytest.approx(
            model.variances[disturbance.name], abs=0, rel=1e-8
        )
        assert forward(alone).variance == pytest.approx(alone.variances[disturbance.name], abs=0, rel=1e-7)


@pytest.mark.parametrize("at", ["mirror_torque", "hub_torque"])
@pytest.mark.parametrize("ki", [True, False])
def test_jitter_by_frequency_adds_up_to_that_by_energy(at, ki):
    # Washed out once an integrator follows the drift; without one it takes twice.
    washed = (1.0, 0.0) if ki else (1.0, 0.0, 0.0)
    shape = ShapingFilter(washed, tuple(np.poly(-HZ * np.array([3.0, 5.0, 60.0, 61.0, 62.0, 63.0, 64.0]))))
    loop, modes = free_loop(4e-4, 1e-4, 5)
    if not ki:
        loop = replace(loop, controller=replace(loop.controller, ki=0.0))
    whole = SampledModel(loop, modes, "tip", (Disturbance("w", at, shape),)).variances["w"]

    def band(low, high):
        part = Disturbance("w", at, shape, band=(low, high))
        return SampledModel(loop, modes, "tip", (part,)).variances["w"]

    # Beyond 3 kHz less than 1e-15 of the power is left.
    assert band(0.0, 3000 * HZ) == pytest.approx(whole, abs=0, rel=1e-8)
    # From above zero on and without end: what is washed out stands for it.
    assert band(0.0, 2 * HZ) + band(2 * HZ, inf) == pytest.approx(whole, abs=0, rel=1e-8)


@pytest.mark.parametrize("at", ["mirror_torque", "hub_torque"])
def test_a_torque_that_pushes_is_counted_from_its_lower_edge_on(at):
    loop, modes = free_loop(4e-4, 1e-4, 5)
    shape = low_pass(8 * HZ, 0.02, 3)

    def band(low, high):
        part = Disturbance("w", at, shape, band=(low, high))
        return SampledModel(loop, modes, "tip", (part,)).variances["w"]

    for low in (0.01 * HZ, 3 * HZ):
        # A third-order low pass at 8 Hz has 1e-11 of its power beyond 1 kHz.
        assert band(low, inf) == pytest.approx(band(low, 1000 * HZ), abs=0, rel=1e-8)
    table = np.linspace(0.5 * HZ, 60 * HZ, 1500)
    psd = Disturbance("w", at, shape).one_sided_psd(table)
    rows = SampledModel(loop, modes, "tip", (Disturbance("w", at, None, table, psd),)).variances["w"]
    # Linear between 1500 rows.
    assert rows == pytest.approx(band(0.5 * HZ, 60 * HZ), abs=0, rel=1e-4)


def test_a_free_loop_sampled_ever_faster_becomes_the_continuous_one():
    loop, modes = free_loop(1e-4, count=61)
    still = replace(loop.controller, path=replace(loop.controller.path, sampling=None))
    model = LoopModel(replace(loop, controller=still), modes, "tip")
    poles = closed_loop_poles(model.loop, modes, "tip")
    banded = Disturbance("low", "hub_torque", low_pass(8 * HZ, 0.02), band=(0.5 * HZ, inf))
    disturbances = (*DISTURBANCES, banded)
    step, sequence = StepCommand(1e-6, (0.02, 0.05)), Retargeting(1e-6, 0.02, 0.03, 2)
    limit = {d.name: v.value for d, v in zip(
        disturbances, jitter_variances(model, poles, disturbances), strict=True)}  # fmt: skip
    limit |= {"abscissa": poles.spectral_abscissa, "margin": float(modulus_margins(model, poles, 1)[0][0])}
    slow = {name: value for name, (value, _) in step_metrics(model, poles, step).items()}
    slow |= peaks(model, poles, sequence)
    off = []
    for period in (2e-5, 1e-5):
        found = SampledModel(free_loop(period)[0], modes, "tip", disturbances)
        values = found.variances | {"abscissa": found.spectral_abscissa, "margin": found.modulus_margin}
        off.append(np.array([values[name] / value - 1 for name, value in limit.items()]))
    # A hold lags by half a period: first order.
    assert np.all(np.abs(off[1]) < 0.02)
    np.testing.assert_allclose(off[0] / off[1], 2, rtol=0.1)
    assert found.loop_crossover == pytest.approx(crossover(model, poles)[0], abs=0, rel=1e-3)
    at_samples = np.exp(1e-5 * poles.all[np.abs(poles.all) < 500])
    assert np.abs(at_samples[:, None] - found.bare.poles).min(axis=1).max() < 5e-5
    now = sampled_step_metrics(found.bare, step) | sampled_peaks(found.bare, sequence)
    for name, value in slow.items():
        assert now[name] == pytest.approx(value, abs=0, rel=0.1 if name == "peak_torque" else 0.04), name


@pytest.mark.parametrize(
    ("disturbance", "change"),
    [
        (Disturbance("w", "mirror_torque", low_pass(8 * HZ, 1.0)), {}),
        (Disturbance("w", "hub_torque", ONCE), {"ki": 0.0}),
        (Disturbance("w", "hub_torque", ONCE), {"sensor": "hub"}),
        (Disturbance("w", "hub_torque", None, np.array([0.0, 9.0]), np.array([1.0, 0.0])), {}),
    ],
    ids=["steady", "without integral", "sensor elsewhere", "table from zero"],
)
def test_what_pushes_without_end_is_refused_as_on_a_continuous_loop(disturbance, change):
    loop, modes = free_loop(4e-4, count=4)
    if "sensor" in change:
        loop = replace(loop, placement=Placement(sensor="hub"))
        loop = replace(loop, controller=replace(loop.controller, gain=1e-6 * loop.controller.gain, ki=0.0))
    else:
        loop = replace(loop, controller=replace(loop.controller, **change))
    model = SampledModel(loop, modes, "tip", (disturbance,))
    assert model.stable
    with pytest.raises(ModelError, match="disturbance 'w': unbounded drift, it pushes a free rigid body"):
        _ = model.variances


def test_a_control_torque_that_turns_the_free_hub_is_refused():
    loop, modes = free_loop(4e-4, count=4)
    shape = modes.mode_shape.copy()
    shape[0, 0] *= 1.001
    uneven = replace(modes, mode_shape=shape)
    assert sampled_loop(loop, uneven, "tip").size == sampled_loop(loop, modes, "tip").size
    with pytest.raises(ModelError, match="turns the free hub, as action and reaction do not turn alike"):
        sampled_loop(replace(loop, placement=Placement(reaction="hub")), uneven, "tip")
    continuous = replace(
        loop, placement=Placement(reaction="hub"), controller=replace(loop.controller, path=DIRECT)
    )
    with pytest.raises(ModelError, match="turns the free hub"):
        closed_loop_poles(continuous, uneven, "tip")
    assert closed_loop_poles(continuous, modes, "tip").value.size


@pytest.mark.parametrize(
    ("numerator", "added"),
    [
        ((3.0,), 2),
        ((2.0, 0.0), 1),
        ((2.0, 0.0, 0.0), 0),
        ((2.0, 1.0, 0.0, 0.0), 0),
        ((2.0, 1.0), 2),
        ((2.0, 1.0, 0.0), 1),
    ],
)
def test_a_source_turns_a_free_body_by_its_second_integral(numerator, added):
    denominator = (1.0, 5.0, 11.0, 9.0)
    source = Source.shaped("hub_torque", numerator, denominator)
    assert source.turning.order == source.states.order + added
    washed = source.washed((1.0, 0.0, 0.0), (1.0, 2.0, 7.0))
    for s in (0.3j, 2.0 + 1j):
        expected = np.polyval(numerator, s) / np.polyval(denominator, s)
        for shape, value in (
            (source.states, expected),
            (source.turning, expected / s**2),
            (washed.turning, expected / np.polyval((1.0, 2.0, 7.0), s)),
        ):
            response = shape.c @ linalg.solve(s * np.eye(shape.order) - shape.a, shape.b) + shape.d
            assert response == pytest.approx(value, abs=0, rel=1e-12)
    assert washed.turning.order == source.states.order + 2


def test_a_free_study_that_samples_is_verified_as_built():
    loop = (
        "  crossover: 100 Hz              # sets the gain, on a rigid support\n",
        "  crossover: 100 Hz\n  rolloff: 3 kHz\n  anti_alias: {corner: 2 kHz}\n"
        "  sampling: {rate: 5 kHz, delay: 100 us}\n",
    )
    limits = (
        "step: {command: 10 urad, window: [20 ms, 50 ms]}\n"
        "limits: {stroke: 1 mrad, rate: 10 rad/s, torque: 2 kN m, engagements: 3}\n"
    )
    disturbances = (
        "disturbances:\n"
        "  - {name: hum, at: hub_torque, filter: {type: band_pass, lower: 1 Hz, upper: 8 Hz, rms: 1 N m}}\n"
        "  - {name: wheels, at: hub_torque, filter: {type: low_pass, corner: 8 Hz, rms: 1 N m}, band: [1 Hz, 90 Hz]}\n"
        "  - {name: noise, at: sensor_noise, filter: {type: high_pass, corner: 70 Hz, density: 0.2 urad/sqrt(Hz)}}\n"
    )
    text = analysis(loop, ("type: held                     #", "type: free #"), *HELD_KEYS)
    text = text.replace(section(text, "disturbances"), limits + disturbances)
    text = text.replace(section(text, "constraints"), "")
    study = parse_study(text)
    problem = build_problem(study)
    x = start_vector(study, problem)
    found = certify(problem, x, problem.constraints)
    assert found.verified, found.reasons
    assert found.jitter_disagreement < 1e-8
    truth = problem.evaluate(x, truth=True)
    for name in ("jitter_hum", "jitter_wheels", "jitter_noise", "step_rms", "peak_stroke", "modulus_margin"):
        # Near the continuous model, and not it.
        model = problem.evaluate(x).value(name)
        assert truth.value(name) == pytest.approx(model, abs=0, rel=0.1) and truth.value(name) != model, name
    loop, modes = truth.design.loop, truth.modes
    closed = sampled_closed_loop_state_space(loop, modes, "tip")
    bare = sampled_loop(loop, modes, "tip")
    assert closed.a.shape[0] == bare.size
    rows, columns = optimize.linear_sum_assignment(np.abs(linalg.eigvals(closed.a)[:, None] - bare.poles))
    assert np.abs(linalg.eigvals(closed.a)[rows] - bare.poles[columns]).max() < 1e-9
