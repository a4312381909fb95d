"""The line-of-sight controller, the loop it closes, and the poles of that loop."""

from fosopt.actuators import Placement
from fosopt.control.loop import (
    NUMERATORS,
    Loop,
    Receptances,
    characteristic,
    closed_loop_response,
    coupling,
    loop_transfer,
    plant_impedance,
    port_pairs,
    with_attachments,
)
from fosopt.control.open_loop import OpenLoopPoles, open_loop_poles
from fosopt.control.pid import PID, gain_for_crossover, pid_response
from fosopt.control.poles import ClosedLoopPoles, closed_loop_poles
from fosopt.control.state_space import (
    StateSpace,
    closed_loop_state_space,
    modal_matrices,
    plant_state_space,
    second_order_state_space,
    structure_state_space,
)

__all__ = [
    "NUMERATORS",
    "PID",
    "ClosedLoopPoles",
    "Loop",
    "OpenLoopPoles",
    "Placement",
    "Receptances",
    "StateSpace",
    "characteristic",
    "closed_loop_poles",
    "closed_loop_response",
    "closed_loop_state_space",
    "coupling",
    "gain_for_crossover",
    "loop_transfer",
    "modal_matrices",
    "open_loop_poles",
    "pid_response",
    "plant_impedance",
    "plant_state_space",
    "port_pairs",
    "second_order_state_space",
    "structure_state_space",
    "with_attachments",
]
