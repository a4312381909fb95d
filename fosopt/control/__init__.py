"""The line-of-sight controller, the loop it closes, and the poles of that loop."""

from fosopt.actuators import Placement
from fosopt.control.filters import (
    Filter,
    lead_lag_filter,
    low_pass_filter,
    notch_filter,
    pade_delay,
    pade_error,
)
from fosopt.control.loop import (
    COMMANDED,
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
from fosopt.control.pid import (
    DIRECT,
    PID,
    Sampling,
    SignalPath,
    command_response,
    gain_for_crossover,
    pid_response,
)
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
    "COMMANDED",
    "DIRECT",
    "NUMERATORS",
    "PID",
    "ClosedLoopPoles",
    "Filter",
    "Loop",
    "OpenLoopPoles",
    "Placement",
    "Receptances",
    "Sampling",
    "SignalPath",
    "StateSpace",
    "characteristic",
    "closed_loop_poles",
    "closed_loop_response",
    "closed_loop_state_space",
    "command_response",
    "coupling",
    "gain_for_crossover",
    "lead_lag_filter",
    "loop_transfer",
    "low_pass_filter",
    "modal_matrices",
    "notch_filter",
    "open_loop_poles",
    "pade_delay",
    "pade_error",
    "pid_response",
    "plant_impedance",
    "plant_state_space",
    "port_pairs",
    "second_order_state_space",
    "structure_state_space",
    "with_attachments",
]
