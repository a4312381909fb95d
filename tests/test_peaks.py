"""Stroke, rate and torque of a retargeting sequence, against a simulation of the closed loop."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest
import reference

from fosopt.control import (
    COMMANDED,
    Filter,
    Placement,
    SignalPath,
    characteristic,
    closed_loop_poles,
    closed_loop_state_space,
    command_response,
    low_pass_filter,
    modal_matrices,
    notch_filter,
)
from fosopt.control.time_response import time_response
from fosopt.errors import UnstableError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.peaks import peaks, torque_at_once
from fosopt.metrics.sequence import Retargeting

SEQUENCE = Retargeting(2.0, 0.03, 0.02, 3)


def rolled_off(**parts):
    """The reference loop on six modes with a torque that begins and stays finite."""
    of = reference.structure()
    loop = replace(reference.loop_of(reference.mirror_of(of, 0.2), 1e-3), **parts)
    return LoopModel(loop, reference.modes_of(of).keep(np.arange(6)), "tip")


@pytest.mark.parametrize("filters", [(), (notch_filter(900.0, 0.3, 0.5), low_pass_filter(2e4))], ids=len)
def test_peaks_are_those_of_a_simulation(filters):
    model = rolled_off()
    pid = replace(model.loop.controller, path=SignalPath(filters))
    model = replace(model, loop=replace(model.loop, controller=pid))
    found = peaks(model, closed_loop_poles(model.loop, model.modes, "tip"), SEQUENCE)
    system = closed_loop_state_space(model.loop, model.modes, "tip")
    n = model.modes.natural_frequency.size
    # Stroke and its rate are rows of the states, the torque is what accelerates the mirror beyond its spring.
    stroke = np.zeros(system.a.shape[0])
    stroke[n], stroke[:n] = 1.0, -model.modes.at("tip")
    rate = np.zeros_like(stroke)
    rate[n + 1 : 2 * (n + 1)] = stroke[: n + 1]
    mirror = model.loop.mirror
    acceleration = system.a[2 * n + 1]
    torque = mirror.inertia * acceleration + mirror.stiffness * stroke + mirror.damping * rate
    direct = mirror.inertia * system.b[2 * n + 1, system.inputs.index("command")]
    watched = replace(
        system,
        c=np.vstack([stroke, rate, torque]),
        d=np.vstack([np.zeros((2, 5)), direct * np.eye(5)[system.inputs.index("command")]]),
        outputs=("stroke", "rate", "torque"),
    )
    step = 5e-6
    total = np.zeros((30_000, 3))
    answer = time_response(watched, "command", np.ones(30_000), step, ("stroke", "rate", "torque"))
    for k, size in enumerate(SEQUENCE.step):
        first = round(k * SEQUENCE.period / step)
        total[first:] += size * answer[: total.shape[0] - first]
    expected = np.abs(total).max(axis=0)
    # A jump of the torque just before a step counts at its own time; samples miss a peak by 0.12 %.
    assert found["peak_stroke"] == pytest.approx(expected[0], abs=0, rel=2e-3)
    assert found["peak_rate"] == pytest.approx(expected[1], abs=0, rel=2e-3)
    assert found["peak_torque"] == pytest.approx(expected[2], abs=0, rel=2e-3)


@pytest.mark.parametrize(
    "placement",
    [Placement(), Placement(reaction="r3"), Placement(sensor="r5"), Placement(sensor="r5", action="r5")],
)
def test_stroke_and_torque_are_those_of_the_coupled_matrices(placement):
    of = reference.stations()
    modes = of.modal_set(reference.HELD, reference.DAMPING, ("hub", "tip", "r3", "r5")).keep(np.arange(8))
    loop = replace(
        reference.loop_of(reference.mirror_of(reference.structure(), 0.2), 1e-3), placement=placement
    )
    whole = modal_matrices(loop, modes, "tip")
    n = modes.natural_frequency.size
    s = np.array([5j, 80j, -3 + 900j])
    g = LoopModel(loop, modes, "tip").points(s).g
    for k, point in enumerate(s):
        plant = whole.stiffness + point * whole.damping + point**2 * whole.mass
        moved = np.linalg.solve(plant, whole.control)
        gain = command_response(loop.controller, point)
        torque = gain / (1 + gain * (whole.sensor @ moved))
        stroke = (moved[whole.mirror] - modes.at("tip") @ moved[:n]) * torque
        at = LoopModel(loop, modes, "tip").points(s[[k]]).g
        below = characteristic(loop, s[[k]], at)
        assert COMMANDED["torque"](loop, s[[k]], at)[0] / below[0] == pytest.approx(torque, abs=0, rel=1e-9)
        assert COMMANDED["stroke"](loop, s[[k]], at)[0] / below[0] == pytest.approx(stroke, abs=0, rel=1e-9)
    assert g.direct.size == 3


def test_a_torque_begins_with_the_response_at_infinite_frequency():
    pid = rolled_off().loop.controller
    gain = float(pid.gain)
    assert torque_at_once(pid) == pytest.approx(gain * (pid.kp + pid.kd / 1e-3))
    assert torque_at_once(replace(pid, rolloff_time=0.0)) == inf
    assert torque_at_once(replace(pid, rolloff_time=0.0, kd=0.0)) == pytest.approx(gain * pid.kp)
    falling = SignalPath((low_pass_filter(500.0),))
    steeper = replace(pid, rolloff_time=0.0, kd=2.0, path=falling)
    assert torque_at_once(steeper) == pytest.approx(gain * 2 * 500.0)
    assert torque_at_once(replace(pid, path=falling)) == 0.0
    steep = SignalPath((low_pass_filter(500.0, 2),))
    assert torque_at_once(replace(pid, rolloff_time=0.0, path=steep)) == 0.0
    double = SignalPath((Filter((6.0, 3.0), (3.0, 15.0)),))
    assert torque_at_once(replace(pid, path=double)) == pytest.approx(2 * gain * (pid.kp + pid.kd / 1e-3))


def test_an_ideal_derivative_asks_for_an_infinite_torque():
    model = rolled_off()
    model = replace(model, loop=reference.loop_of(reference.mirror_of(reference.structure(), 0.2)))
    found = peaks(model, closed_loop_poles(model.loop, model.modes, "tip"), SEQUENCE)
    assert found["peak_torque"] == inf and found["peak_stroke"] < inf


def test_an_unstable_loop_has_no_peaks():
    model = rolled_off()
    pid = replace(model.loop.controller, gain=0.02 * model.loop.controller.gain)
    model = replace(model, loop=replace(model.loop, controller=pid))
    poles = closed_loop_poles(model.loop, model.modes, "tip")
    assert poles.spectral_abscissa > 0
    with pytest.raises(UnstableError):
        peaks(model, poles, SEQUENCE)
