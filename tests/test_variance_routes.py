"""Mean square jitter by residues, by a Lyapunov equation and by the physical dynamic stiffness."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from reference import DISTURBANCES, HZ, system_and_design

from fosopt import certify as judge
from fosopt.certify import independent_variance
from fosopt.control import closed_loop_state_space
from fosopt.metrics.disturbances import Disturbance, ShapingFilter, band_pass, high_pass, low_pass, white
from fosopt.modes import Hub
from fosopt.problem import Evaluation

# Two routes to one variance: the Lyapunov equation of a balanced system is good to about 1e-9, the quadrature to
# 1e-10 of each resonance.
ROUTES = 1e-8


def truth_of(disturbance: Disturbance, **options) -> tuple[Evaluation, object]:
    """A stable reference system under one disturbance, and its scaled state space."""
    evaluation = Evaluation(*system_and_design(bays=6, disturbances=(disturbance,), **options))
    state_space = closed_loop_state_space(evaluation.design.loop, evaluation.modes, "tip")
    return evaluation, judge._scaled(state_space, evaluation.modes)


def same(value: float, other: float) -> bool:
    """Whether two variances, which are tiny numbers, agree as two routes must."""
    return abs(value / other - 1) <= ROUTES


INPUTS = ("mirror_torque", "hub_torque", "line_of_sight", "sensor_noise")


@pytest.mark.parametrize("disturbance", DISTURBANCES, ids=lambda d: d.at)
def test_residues_lyapunov_and_dynamic_stiffness_agree(disturbance):
    truth, system = truth_of(disturbance)
    residues = truth.variances[f"jitter_{disturbance.name}"].value
    assert same(judge._by_lyapunov(system, disturbance), residues)
    assert same(judge._by_dynamic_stiffness(truth, disturbance), residues)
    assert same(independent_variance(truth, system, disturbance), residues)


@pytest.mark.parametrize("at", ["mirror_torque", "hub_torque", "sensor_noise"])
def test_white_noise_goes_through_the_lyapunov_equation_without_a_filter(at):
    truth, system = truth_of(Disturbance("d", at, white(1e-6)))
    expected = truth.variances["jitter_d"].value
    assert same(independent_variance(truth, system, truth.system.disturbances[0]), expected)


@pytest.mark.parametrize("at", INPUTS)
def test_a_free_hub_is_judged_by_the_dynamic_stiffness(at):
    # Washed out at low frequency, so that a torque does not push a free rigid body away.
    truth, system = truth_of(Disturbance("d", at, band_pass(5 * HZ, 50 * HZ, 1e-3)), hub=Hub("free"))
    assert truth.poles.open_loop.drifting
    expected = truth.variances["jitter_d"].value
    assert same(independent_variance(truth, system, truth.system.disturbances[0]), expected)


@pytest.mark.parametrize("at", INPUTS)
@pytest.mark.parametrize(
    "parts",
    [
        {"filter": white(1e-6), "band": (1 * HZ, 500 * HZ)},
        {"filter": low_pass(20 * HZ, 1e-3, 2), "band": (0.0, 80 * HZ)},
        {"frequency": np.array([1.0, 30.0, 60.0, 400.0]) * HZ, "psd": np.array([1e-6, 4e-6, 1e-7, 1e-7])},
        {
            "frequency": np.array([1.0, 400.0]) * HZ,
            "psd": np.array([1e-6, 1e-7]),
            "band": (20 * HZ, 90 * HZ),
        },
        {"filter": ShapingFilter((1.0,), (1.0, 20.0, 100.0))},
    ],
    ids=["white in a band", "filter in a band", "table", "table in a band", "double pole"],
)
def test_what_has_no_residues_is_judged_by_the_dynamic_stiffness(at, parts):
    truth, system = truth_of(Disturbance("d", at, **parts))
    expected = truth.variances["jitter_d"].value
    assert same(independent_variance(truth, system, truth.system.disturbances[0]), expected)


def test_the_dynamic_stiffness_knows_the_roll_off_of_the_derivative():
    disturbance = Disturbance("d", "sensor_noise", high_pass(70 * HZ, 1e-8))
    values = []
    for time in (1e-4, 1e-3):
        truth, _ = truth_of(disturbance, rolloff_time=time)
        values.append(judge._by_dynamic_stiffness(truth, disturbance))
        assert same(values[-1], truth.variances["jitter_d"].value)
    assert values[1] > 1.5 * values[0]


def test_a_band_around_a_resonance_holds_less_than_all_frequencies():
    shape = low_pass(20 * HZ, 1e-3)
    whole = Disturbance("d", "mirror_torque", shape)
    truth, _ = truth_of(whole)
    inner = replace(whole, band=(0.0, 50 * HZ))
    outer = replace(whole, band=(50 * HZ, inf))
    parts = [judge._by_dynamic_stiffness(truth, each) for each in (inner, outer)]
    assert all(part > 0 for part in parts)
    assert same(sum(parts), judge._by_dynamic_stiffness(truth, whole))


def test_the_static_response_of_the_dynamic_stiffness_is_statics():
    # Without integral action a torque on the mirror turns it by torque/(k_m + gain kp), the truss by its part.
    truth, _ = truth_of(DISTURBANCES[0])
    pid = replace(truth.design.loop.controller, ki=0.0)
    still = Evaluation(truth.system, replace(truth.design, loop=replace(truth.design.loop, controller=pid)))
    response = judge._dense_responses(still, np.array([1e-6]), "mirror_torque")[0]
    stiffness = pid.gain * pid.kp
    compliance = float(np.sum(still.modes.at("tip") ** 2 / still.modes.stiffness))
    spring = still.design.loop.mirror.stiffness
    expected = (1 + spring * compliance) / (spring + stiffness)
    # Of the damping at a millionth of a rad/s next to nothing is left.
    assert response.real / expected == pytest.approx(1, rel=1e-9)
    assert abs(response.imag) < 1e-5 * response.real
