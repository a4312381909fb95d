"""Controller and sampled plant as state spaces with named signals, for other programs."""

from __future__ import annotations

from typing import Any

import numpy as np

from fosopt.control.discrete import discrete_controller
from fosopt.control.filter_states import FilterStates, filter_state_space, rational_states
from fosopt.control.loop import Loop
from fosopt.control.pid import PID
from fosopt.control.sampled import sampled_loop
from fosopt.control.state_space import StateSpace
from fosopt.errors import ModelError
from fosopt.modes import ModalSet

CONTROLLER_INPUTS = ("command", "sensor_angle")
TORQUE = "control_torque"


def controller_state_space(pid: PID) -> StateSpace:
    """The controller with its filters from command and sensed angle [rad] to torque [N m].

    Of a sampled loop it is the continuous model, its lag a Padé approximant.    [Barker1991] Eq. (3.25)

    Raises
    ------
    ModelError
        If its derivative does not roll off.
    """
    on_error = _rolled_off(pid)
    seen = filter_state_space(pid.path.anti_alias)
    n, m = seen.order, on_error.order
    a = np.block([[seen.a, np.zeros((n, m))], [-np.outer(on_error.b, seen.c), on_error.a]])
    b = np.zeros((n + m, 2))
    b[n:, 0] = on_error.b
    b[:, 1] = np.concatenate([seen.b, -on_error.b * seen.d])
    c = np.concatenate([-on_error.d * seen.c, on_error.c])[None]
    return StateSpace(a, b, c, np.array([[on_error.d, -on_error.d * seen.d]]), CONTROLLER_INPUTS, (TORQUE,))


def _rolled_off(pid: PID) -> FilterStates:
    """PID and filters on the error; an ideal derivative goes together with a filter that has fewer zeros than poles."""
    sections = list(pid.path.on_error)
    lag = float(pid.lag) if pid.kd else 0.0
    numerator: Any = float(pid.gain) * np.array([pid.kd + pid.kp * lag, pid.kp + pid.ki * lag, pid.ki])
    denominator: Any = np.array([lag, 1.0, 0.0])
    if pid.kd and not lag:
        falling = next((section for section in sections if section.relative_degree > 0), None)
        if falling is None:
            raise ModelError(
                "controller: an ideal derivative is no state space; add a roll-off or a low-pass filter"
            )
        sections.remove(falling)
        numerator = np.polymul(numerator, falling.numerator)
        denominator = np.polymul(denominator, falling.denominator)
    if not pid.ki:
        numerator, denominator = numerator[:-1], denominator[:-1]
    own = rational_states(np.trim_zeros(numerator, "f"), np.trim_zeros(denominator, "f"))
    return filter_state_space(sections).then(own)


def sampled_controller_state_space(pid: PID) -> StateSpace:
    """The digital controller from sample to sample, without its anti-alias filters and its delay.

    Raises
    ------
    ModelError
        If it is not sampled.
    """
    found = discrete_controller(pid)
    states = found.states
    b = np.column_stack([states.b, -states.b])
    d = np.array([[states.d, -states.d]])
    return StateSpace(states.a, b, states.c[None], d, CONTROLLER_INPUTS, (TORQUE,), found.period)


def sampled_plant_state_space(loop: Loop, modes: ModalSet, mirror_port: str) -> StateSpace:
    """The plant of a sampled loop from computed torque to the sampled angle, with hold, delay and anti-alias filters.

    Outputs are what the controller is fed and the mirror angle at the samples [rad]. A free hub's drift, which the
    torque does not move, is left out.    [Astrom1997] Sec. 2.3

    Raises
    ------
    ModelError
        If the loop is not sampled, or its torque turns a free hub.
    """
    sampled = sampled_loop(loop, modes, mirror_port)
    moved, column, row = sampled.plant
    angle = np.append(sampled.line_of_sight, np.zeros(sampled.past))
    outputs = ("sensor_angle", "mirror_angle")
    return StateSpace(
        moved, column[:, None], np.vstack([row, angle]), np.zeros((2, 1)), (TORQUE,), outputs, sampled.period
    )
