"""Transients against their samples and against simulation."""

from __future__ import annotations

from math import inf, log

import numpy as np
import pytest
import reference
from scipy import integrate, linalg

from fosopt.control import closed_loop_poles, closed_loop_state_space
from fosopt.errors import ModelError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.transient import Transient, step_error


def transient(*terms, steady=0.0):
    """From pairs of amplitude and pole."""
    return Transient(
        steady, np.array([q for q, _ in terms], complex), np.array([p for _, p in terms], complex)
    )


RINGING = transient((0.4 - 0.3j, -2 + 300j), (0.7, -25.0), (0.05j, -0.3 + 40j), steady=0.02)


def test_mean_and_rms_are_those_of_a_dense_sample():
    time = np.linspace(0.03, 0.17, 40001)
    error = RINGING(time)
    mean = integrate.simpson(error, x=time) / 0.14
    assert RINGING.mean(0.03, 0.17) == pytest.approx(mean, rel=1e-9)
    rms = np.sqrt(integrate.simpson((error - mean) ** 2, x=time) / 0.14)
    assert RINGING.rms(0.03, 0.17) == pytest.approx(rms, rel=1e-9)


def test_a_pole_at_zero_is_a_constant():
    constant = transient((0.25, 0.0))
    assert constant.mean(1.0, 3.0) == pytest.approx(0.25, rel=1e-15)
    assert constant.rms(1.0, 3.0) == pytest.approx(0.0, abs=1e-9)


def test_the_largest_error_is_missed_by_the_stated_share_at_most():
    time = np.linspace(0.03, 0.17, 400001)
    largest = np.abs(RINGING(time)).max()
    found = RINGING.largest(0.03, 0.17)
    assert largest * (1 - 0.0013) <= found <= largest * (1 + 1e-9)


def test_an_exponential_settles_at_its_logarithm():
    decay = transient((-2.0, -50.0))
    assert decay.settling_time(1e-3) == pytest.approx(log(2e3) / 50, rel=1e-12)


@pytest.mark.parametrize("steady", [8e-4, -8e-4])
def test_a_steady_error_takes_its_share_of_the_tolerance(steady):
    decay = transient((2.0, -50.0), steady=steady)
    # On the side of the steady error what is left is smaller; on the other side the error comes from beyond zero.
    left = 1e-3 - steady
    assert decay.settling_time(1e-3) == pytest.approx(log(2 / left) / 50, rel=1e-12)


def test_after_settling_no_sample_is_outside_and_just_before_one_is():
    settled = RINGING.settling_time(0.05)
    assert abs(RINGING(np.array([settled * (1 - 1e-9)]))[0]) > 0.05
    assert np.all(np.abs(RINGING(np.linspace(settled, settled + 20, 400001))) <= 0.05)


def test_an_oscillation_that_is_inside_from_the_start_has_settled_at_once():
    assert transient((1e-3, -1 + 10j)).settling_time(1e-2) == 0.0


@pytest.mark.parametrize(
    "restless",
    [transient((0.1, 0.0 + 5j)), transient((0.1, 0.2 + 5j)), transient((0.1, -1.0), steady=0.02)],
    ids=["undamped", "growing", "offset"],
)
def test_what_never_settles_settles_at_infinity(restless):
    assert restless.settling_time(0.01) == inf


def test_a_tolerance_that_is_not_positive_is_refused():
    with pytest.raises(ModelError, match="tolerance 0 is not above zero"):
        RINGING.settling_time(0)


@pytest.mark.parametrize("case", [2, 3], ids=["unstable", "stable"])
def test_the_error_of_a_step_is_that_of_a_simulation_stable_or_not(case):
    loop, modes = reference.benchmark(case)
    found = step_error(LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip"))
    system = closed_loop_state_space(loop, modes, "tip")
    n = system.a.shape[0]
    grown = np.zeros((n + 1, n + 1))
    grown[:n, :n] = system.a
    grown[:n, n] = system.b[:, system.inputs.index("command")]
    row = system.c[system.outputs.index("mirror_angle")]
    times = np.array([1e-3, 0.02, 0.4, 3.0])
    angle = [row @ linalg.expm(grown * t)[:n, n] for t in times]
    assert found(times) == pytest.approx(np.array(angle) - 1, abs=1e-8)
    assert found(np.zeros(1))[0] == pytest.approx(-1.0, abs=1e-12)


def test_a_fast_oscillation_that_leaves_the_tolerance_for_an_instant_has_not_settled():
    # Three harmonics add up to 1.2 once in a period and stay below 1.1 but for a fiftieth of it.
    beating = transient(*((0.4, -0.05 + 200j * k) for k in (1, 2, 3)))
    time = np.linspace(0.0, 4.0, 4_000_001)
    last = time[np.flatnonzero(np.abs(beating(time)) > 1.1)[-1]]
    assert beating.settling_time(1.1) == pytest.approx(last, abs=1e-6)
