"""Retargeting sequences against the superposition they are, and what their windows hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
from scipy import integrate

from fosopt.control import closed_loop_poles
from fosopt.errors import ModelError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.sequence import Retargeting, engagements, sequence_response
from fosopt.metrics.transient import step_error

SQUARE = Retargeting(2.0, 0.04, 0.06, 5)


def model(case, **pid):
    loop, modes = reference.benchmark(case)
    loop = replace(loop, controller=replace(loop.controller, **pid))
    return LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip")


def superposed(of, retargeting, time):
    """The sum of the responses to each step on its own."""
    step = step_error(*of)
    total = np.zeros_like(time)
    for start, size in zip(retargeting.start, retargeting.step, strict=True):
        after = time >= start
        total[after] += size * (1 + step(time[after] - start))
    return total


def test_a_square_wave_goes_out_and_back_and_a_staircase_on():
    time = np.array([-0.01, 0.0, 0.099, 0.1, 0.25, 0.41, 3.0])
    assert SQUARE.target(time) == pytest.approx([0.0, 2.0, 2.0, 0.0, 2.0, 2.0, 2.0])
    assert replace(SQUARE, pattern="staircase").target(time) == pytest.approx([0, 2, 2, 4, 6, 10, 10])


@pytest.mark.parametrize("pattern", ["square wave", "staircase"])
@pytest.mark.parametrize("case", [2, 3], ids=["unstable", "stable"])
def test_the_response_is_the_sum_of_its_steps(case, pattern):
    retargeting = replace(SQUARE, pattern=pattern)
    time = np.linspace(-0.05, 0.8, 2003)
    found = sequence_response(*model(case), retargeting, time)
    assert found == pytest.approx(superposed(model(case), retargeting, time), abs=1e-12)
    assert np.all(found[time < 0] == 0)


def test_without_integral_action_every_level_keeps_its_own_offset():
    of = model(3, ki=0.0)
    staircase = replace(SQUARE, pattern="staircase", settling_time=2.0, dwell_time=3.0)
    late = staircase.start + 4.9
    offset = sequence_response(*of, staircase, late) - staircase.target(late)
    assert offset == pytest.approx(step_error(*of).steady * np.cumsum(staircase.step), rel=1e-6)
    assert abs(offset[0]) > 1e-3


def test_windows_hold_offset_rms_and_largest_error_of_the_response():
    of = model(3)
    found = engagements(*of, SQUARE)
    for k, start in enumerate(SQUARE.start):
        # The window ends as the next step starts.
        time = start + np.linspace(0.04, 0.1 * (1 - 1e-12), 20001)
        error = sequence_response(*of, SQUARE, time) - SQUARE.target(time)
        assert found.offset[k] == pytest.approx(error[0], rel=1e-9)
        mean = integrate.simpson(error, x=time) / 0.06
        rms = np.sqrt(integrate.simpson((error - mean) ** 2, x=time) / 0.06)
        assert found.rms[k] == pytest.approx(rms, rel=1e-7)
        # Samples miss a peak by 0.12 % at most.
        assert found.largest[k] == pytest.approx(np.abs(error).max(), rel=1.3e-3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"settling_time": 0.0}, "settling_time 0.0 s is not above zero"),
        ({"dwell_time": np.inf}, "dwell_time inf s is not above zero"),
        ({"count": 0}, "0 engagements; give one or more"),
        ({"pattern": "sawtooth"}, "'sawtooth' is neither"),
    ],
)
def test_a_sequence_that_makes_no_sense_is_refused(wrong, message):
    with pytest.raises(ModelError, match=message):
        replace(SQUARE, **wrong)


def test_the_first_engagement_is_a_step_alone():
    error = step_error(*model(3))
    found = engagements(*model(3), replace(SQUARE, count=1))
    assert found.rms[0] == pytest.approx(2.0 * error.rms(0.04, 0.1), rel=1e-12)


def test_a_square_wave_turns_back_at_every_engagement():
    assert SQUARE.step.tolist() == [2.0, -2.0, 2.0, -2.0, 2.0]
