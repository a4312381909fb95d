"""The line-of-sight controller, the loop it closes, and the poles of that loop."""

from fosopt.control.loop import (
    DISTURBANCE_RESPONSES,
    Loop,
    Receptances,
    characteristic,
    command_response,
    coupling,
    hub_torque_response,
    line_of_sight_response,
    loop_transfer,
    mirror_torque_response,
    plant_impedance,
    sensor_noise_response,
)
from fosopt.control.pid import PID, gain_for_crossover, pid_response
from fosopt.control.poles import ClosedLoopPoles, closed_loop_poles, open_loop_poles
from fosopt.control.state_space import StateSpace, closed_loop_state_space, plant_state_space

__all__ = [
    "DISTURBANCE_RESPONSES",
    "PID",
    "ClosedLoopPoles",
    "Loop",
    "Receptances",
    "StateSpace",
    "characteristic",
    "closed_loop_poles",
    "closed_loop_state_space",
    "command_response",
    "coupling",
    "gain_for_crossover",
    "hub_torque_response",
    "line_of_sight_response",
    "loop_transfer",
    "mirror_torque_response",
    "open_loop_poles",
    "pid_response",
    "plant_impedance",
    "plant_state_space",
    "sensor_noise_response",
]
