"""Disturbances referred to another place of the loop."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from scipy import linalg

from fosopt.control import PID, closed_loop_poles, plant_state_space
from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.referred import referred_to_sensor


def test_noise_in_the_torque_gives_the_jitter_of_its_lyapunov_equation():
    of = reference.structure()
    loop, modes = reference.loop_of(reference.mirror_of(of, 0.2)), reference.modes_of(of).keep(range(7))
    shape = low_pass(40.0, 0.3)
    model, poles = LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip")
    noise = Disturbance("torque", "sensor_noise", referred_to_sensor(shape, loop.controller))
    found = jitter_variances(model, poles, [noise])[0].value

    # The loop by hand: torque = noise − PID of the mirror's angle, with states of the filter and of the integral.
    plant, pid = plant_state_space(loop, modes, "tip"), loop.controller
    n = plant.a.shape[0]
    push = plant.b[:, plant.inputs.index("control_torque")]
    angle, rate = (plant.c[plant.outputs.index(f"mirror_{name}")] for name in ("angle", "rate"))
    corner, gain = shape.denominator[1] / shape.denominator[0], shape.numerator[0] / shape.denominator[0]
    a = np.zeros((n + 2, n + 2))
    a[:n, :n] = plant.a - pid.gain * np.outer(push, pid.kp * angle + pid.kd * rate)
    a[:n, n], a[:n, n + 1] = -pid.gain * pid.ki * push, push
    a[n, :n], a[n + 1, n + 1] = angle, -corner
    b = np.zeros(n + 2)
    b[n + 1] = gain
    state = linalg.solve_continuous_lyapunov(a, -np.outer(b, b))
    assert found == pytest.approx(angle @ state[:n, :n] @ angle, rel=1e-6, abs=0)


@pytest.mark.parametrize("changes", [{"ki": 0.0}, {"kd": 0.0}, {"rolloff_time": 1e-4}])
def test_a_controller_whose_inverse_is_no_filter_is_refused(changes):
    pid = PID(**({"gain": 2.0, "kp": 600.0, "ki": 5e4, "kd": 1.0} | changes))
    with pytest.raises(ModelError, match="integral and unfiltered derivative"):
        referred_to_sensor(low_pass(40.0, 1.0), pid)
