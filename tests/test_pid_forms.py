"""PID controllers in the forms of other tools: the same transfer function whichever form."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from fosopt.control import PID, SignalPath, low_pass_filter, pid_response
from fosopt.control.pid_forms import controller_of, form_lines, ideal_form, parallel_form, series_form
from fosopt.errors import ModelError
from fosopt.forms import IdealForm, ParallelForm, SeriesForm

S = 1j * np.geomspace(0.1, 1e5, 30)
PIDS = {
    "ideal derivative": PID(20.0, 60.0, 500.0, 1.0),
    "rolled off": PID(20.0, 60.0, 500.0, 1.0, 2e-3),
    "without integral": PID(20.0, 60.0, 0.0, 1.0, 2e-3),
    "without derivative": PID(20.0, 60.0, 500.0, 0.0),
    "proportional": PID(20.0, 60.0, 0.0, 0.0),
    "double zero": PID(3.0, 40.0, 400.0, 1.0),
}


def parallel_response(form):
    return form.proportional + form.integral / S + form.derivative * S / (1 + form.filter_time * S)


def ideal_response(form):
    return form.gain * (
        1 + 1 / form.integral_time / S + form.derivative_time * S / (1 + form.filter_time * S)
    )


def series_response(form):
    lead = (1 + form.derivative_time * S) / (1 + form.filter_time * S)
    return form.gain * (1 + 1 / form.integral_time / S) * lead


@pytest.mark.parametrize("name", PIDS)
def test_every_form_is_the_same_controller(name):
    pid = PIDS[name]
    expected = pid_response(pid, S)
    np.testing.assert_allclose(parallel_response(parallel_form(pid)), expected, rtol=1e-12)
    np.testing.assert_allclose(ideal_response(ideal_form(pid)), expected, rtol=1e-12)
    np.testing.assert_allclose(series_response(series_form(pid)), expected, rtol=1e-7)


@pytest.mark.parametrize("name", PIDS)
def test_every_form_leads_back_to_the_controller(name):
    pid = PIDS[name]
    expected = pid_response(pid, S)
    for form in (parallel_form(pid), ideal_form(pid).parallel, series_form(pid).parallel):
        np.testing.assert_allclose(pid_response(controller_of(form), S), expected, rtol=1e-7)


def test_the_series_form_of_a_textbook():
    # K = 1, T_i = 4 s, T_d = 1 s in ideal form is the double zero: K/2, 2 s, 2 s.
    form = series_form(controller_of(IdealForm(1.0, 4.0, 1.0)))
    assert (form.gain, form.integral_time, form.derivative_time) == pytest.approx((0.5, 2.0, 2.0))


def test_a_series_form_with_a_roll_off_is_exact():
    form = SeriesForm(7.0, 0.05, 0.004, 0.0005)
    np.testing.assert_allclose(pid_response(controller_of(form), S), series_response(form), rtol=1e-12)
    again = series_form(controller_of(form))
    assert (again.gain, again.integral_time, again.derivative_time, again.filter_time) == pytest.approx(
        (7.0, 0.05, 0.004, 0.0005), abs=0, rel=1e-9
    )


def test_the_gain_of_a_controller_is_its_derivative_gain():
    pid = controller_of(ParallelForm(600.0, 5e4, 2.0, 1e-4))
    assert (pid.gain, pid.kp, pid.ki, pid.kd, pid.rolloff_time) == (2.0, 300.0, 2.5e4, 1.0, 1e-4)
    assert controller_of(ParallelForm(600.0)).kp == 1.0
    path = SignalPath((low_pass_filter(10.0),))
    assert controller_of(ParallelForm(600.0), path).path == path


def test_the_forms_are_printed_with_their_units():
    lines = form_lines(PIDS["rolled off"])
    assert (
        lines[0] == "parallel: k_p = 1200 N m/rad, k_i = 10000 N m/(rad s), k_d = 20 N m s/rad, T_f = 0.002 s"
    )
    assert lines[1] == "ideal: K = 1200 N m/rad, T_i = 0.12 s, T_d = 0.0166667 s, T_f = 0.002 s"
    assert lines[2].startswith("series: K = ")
    nothing_to_filter = form_lines(PID(20.0, 60.0, 500.0, 0.0, 2e-3))
    assert not any("T_f" in line for line in nothing_to_filter)
    complex_zeros = form_lines(PID(1.0, 10.0, 1000.0, 1.0))
    assert "zeros are complex" in complex_zeros[2]


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: series_form(PID(1.0, 10.0, 1000.0, 1.0)), "four times"),
        (lambda: series_form(PID(1.0, 0.0, 0.0, 1.0)), "derivative alone"),
        (lambda: ideal_form(PID(1.0, 0.0, 10.0, 1.0)), "without a proportional gain"),
        (lambda: SeriesForm(1.0, 0.01, 0.001, 0.1).parallel, "negative gain"),
        (lambda: ParallelForm(-1.0), "proportional -1"),
        (lambda: controller_of(ParallelForm(0.0)), "all gains are zero"),
        (lambda: IdealForm(0.0), "gain 0"),
        (lambda: IdealForm(1.0, 0.0), "integral_time 0"),
        (lambda: SeriesForm(1.0, 1.0, inf), "derivative_time inf"),
    ],
)
def test_forms_that_do_not_exist_are_refused(make, says):
    with pytest.raises(ModelError, match=says):
        make()


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_a_double_zero_is_no_complex_pair_however_large_the_gains(size):
    # Rounding leaves either sign of what should be zero.
    for time in np.geomspace(0.001, 1.0, 50):
        double = series_form(controller_of(IdealForm(size / 3, 4 * time, time)))
        assert double.integral_time == pytest.approx(2 * time, rel=1e-6)
        assert double.derivative_time == pytest.approx(2 * time, rel=1e-6)
    with pytest.raises(ModelError, match="zeros are complex"):
        series_form(controller_of(IdealForm(size / 3, 4.0, 1.001)))
