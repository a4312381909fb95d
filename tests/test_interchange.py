"""Plant and controller in python-control, SciPy and MATLAB files: closed there, the loop has fosopt's poles."""

from __future__ import annotations

import sys
from dataclasses import replace

import control
import numpy as np
import pytest
import reference
from sampled_loops import sampled
from scipy import signal

from fosopt.control import SignalPath, closed_loop_poles, loop_transfer, low_pass_filter, pid_response
from fosopt.control.sampled import sampled_loop
from fosopt.control.systems import controller_state_space
from fosopt.errors import FosoptError, ModelError
from fosopt.interchange import control_system, loop_transfer_data, scipy_system, systems
from fosopt.metrics.functional import LoopModel


@pytest.fixture(scope="module")
def built():
    """A sampled loop on four modes and its systems."""
    loop, modes = sampled(2e-4, 3.3e-4)
    modes = modes.keep(np.arange(4))
    return loop, modes, systems(loop, modes, "tip")


def closed(plant, controller):
    """The loop closed in python-control by the names of its signals."""
    whole = control.interconnect(
        [control_system(plant, "plant"), control_system(controller, "controller")],
        inplist=["controller.command"],
        outlist=["plant.mirror_angle"],
        connections=[
            ["plant.control_torque", "controller.control_torque"],
            ["controller.sensor_angle", "plant.sensor_angle"],
        ],
        check_unused=False,
    )
    return whole


def test_python_control_closes_the_continuous_loop_with_the_same_poles(built):
    loop, modes, found = built
    expected = closed_loop_poles(loop, modes, "tip").all
    poles = closed(found["plant"], found["controller"]).poles()
    assert poles.size == expected.size
    assert np.abs(poles[:, None] - expected).min(axis=1).max() < 1e-9 * np.abs(expected).max()


def test_python_control_closes_the_sampled_loop_with_the_same_poles(built):
    loop, modes, found = built
    sampled_system = closed(found["sampled_plant"], found["sampled_controller"])
    assert sampled_system.dt == pytest.approx(2e-4)
    expected = sampled_loop(loop, modes, "tip").poles
    poles = sampled_system.poles()
    assert poles.size == expected.size
    assert np.abs(poles[:, None] - expected).min(axis=1).max() < 1e-8


@pytest.mark.parametrize("rolloff_time", [0.0, 1e-4])
def test_the_controller_answers_as_its_formula_does(rolloff_time):
    loop, _ = sampled(2e-4, rolloff_time=rolloff_time)
    path = SignalPath(
        (low_pass_filter(3e3, 2), *loop.controller.path.filters), loop.controller.path.anti_alias
    )
    pid = replace(loop.controller, path=path)
    s = 1j * np.array([5.0, 300.0, 2e4])
    found = controller_state_space(pid)
    np.testing.assert_allclose(
        found.response(s, "sensor_angle", "control_torque"), -pid_response(pid, s), rtol=1e-9
    )
    by_command = pid_response(pid, s) / path.anti_alias[0].response(s)
    np.testing.assert_allclose(found.response(s, "command", "control_torque"), by_command, rtol=1e-9)


def test_a_controller_without_integral_has_no_pole_at_zero():
    pid = replace(sampled(2e-4)[0].controller, ki=0.0, path=SignalPath())
    found = controller_state_space(pid)
    assert np.abs(np.linalg.eigvals(found.a)).min() > 1.0
    s = np.array([3j, 3e4j])
    for given, sign in (("command", 1), ("sensor_angle", -1)):
        response = found.response(s, given, "control_torque")
        np.testing.assert_allclose(response, sign * pid_response(pid, s), rtol=1e-9)


def test_frequency_data_are_the_loop_transfer(built):
    loop, modes, _ = built
    w = np.array([3.0, 40.0, 900.0])
    data = loop_transfer_data(loop, modes, "tip", w)
    expected = sampled_loop(loop, modes, "tip").loop_transfer(np.exp(1j * w * 2e-4))
    np.testing.assert_allclose(data(1j * w), expected, rtol=1e-12)
    continuous = replace(loop, controller=replace(loop.controller, path=SignalPath()))
    points = LoopModel(continuous, modes, "tip").points(1j * w)
    np.testing.assert_allclose(
        loop_transfer_data(continuous, modes, "tip", w)(1j * w),
        loop_transfer(continuous, points.s, points.g),
        rtol=1e-12,
    )
    with pytest.raises(ModelError, match="Nyquist"):
        loop_transfer_data(loop, modes, "tip", np.array([1.0, 2e4]))


def test_scipy_gets_one_input_and_one_output(built):
    _, _, found = built
    plant = scipy_system(found["plant"], "hub_torque", "mirror_angle")
    assert isinstance(plant, signal.lti)
    s = np.array([3j, 300j])
    response = [(plant.C @ np.linalg.solve(p * np.eye(len(plant.A)) - plant.A, plant.B))[0, 0] for p in s]
    np.testing.assert_allclose(response, found["plant"].response(s, "hub_torque", "mirror_angle"), rtol=1e-12)
    digital = scipy_system(found["sampled_controller"], "command", "control_torque")
    assert isinstance(digital, signal.dlti) and digital.dt == 2e-4
    with pytest.raises(ModelError, match="mirror_angle"):
        scipy_system(found["plant"], "hub_torque", "mirror_angel")


def test_an_ideal_derivative_is_left_out_of_the_continuous_systems():
    loop = reference.loop_of(reference.mirror_of(reference.structure(), 0.2))
    modes = reference.modes_of(reference.structure())
    assert set(systems(loop, modes, "tip")) == {"plant"}
    with pytest.raises(ModelError, match="ideal derivative"):
        controller_state_space(loop.controller)


def test_python_control_missing_is_said_in_one_line(built, monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(FosoptError, match="pip install"):
        control_system(built[2]["plant"])
