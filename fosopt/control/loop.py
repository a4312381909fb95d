"""The line-of-sight loop in closed form.

A mirror that reacts on one port of a structure sees it through two receptances only: g_hh from reaction torque
to reference angle, and g_h0 from hub torque to reference angle. With the coupling κ = c_m s + k_m the cross
terms of a bicollocated mirror cancel, and all transfer functions of the closed loop share one denominator

    Δ(s) = J_m s² (1 + κ g_hh) + κ + K.

Every formula is a rational function of `s`, the receptances and the parameters: it runs on NumPy arrays and on
`ops.ComplexPair`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fosopt.actuators import Mirror
from fosopt.control.pid import PID, pid_response


@dataclass(frozen=True)
class Loop:
    """A mirror and its controller."""

    mirror: Mirror
    controller: PID


@dataclass(frozen=True)
class Receptances:
    """What the mirror sees of its structure at one Laplace variable, [rad/(N m)].

    Attributes
    ----------
    direct
        g_hh, mirror port to itself.
    cross
        g_h0, hub to mirror port.
    """

    direct: Any
    cross: Any


def coupling(loop: Loop, s: Any) -> Any:
    """Spring and damper between mirror and port, κ(s) = c_m s + k_m [N m/rad]."""
    return loop.mirror.damping * s + loop.mirror.stiffness


def plant_impedance(loop: Loop, s: Any, g: Receptances) -> Any:
    """Torque per mirror angle of the coupled plant, 1/G(s).    [Barker1991] Eq. (4.18)"""
    kappa = coupling(loop, s)
    return loop.mirror.inertia * s**2 * (1 + kappa * g.direct) + kappa


def characteristic(loop: Loop, s: Any, g: Receptances) -> Any:
    """Δ(s), whose zeros are the closed-loop poles [N m/rad].    [Barker1991] Eq. (4.29)"""
    return plant_impedance(loop, s, g) + pid_response(loop.controller, s)


def loop_transfer(loop: Loop, s: Any, g: Receptances) -> Any:
    """L(s) = G(s) K(s) [-]."""
    return pid_response(loop.controller, s) / plant_impedance(loop, s, g)


def command_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """K: mirror angle per commanded angle times Δ.    [Barker1991] Eq. (4.28)"""
    return pid_response(loop.controller, s)


def line_of_sight_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """1/G: line-of-sight error per line-of-sight displacement times Δ."""
    return plant_impedance(loop, s, g)


def sensor_noise_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """−K: mirror angle per measurement noise times Δ."""
    return -pid_response(loop.controller, s)


def mirror_torque_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """1 + κ g_hh: mirror angle per external torque on the mirror times Δ."""
    return 1 + coupling(loop, s) * g.direct


def hub_torque_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """κ g_h0: mirror angle per torque on the hub (aft-to-fore body) times Δ."""
    return coupling(loop, s) * g.cross


Formula = Callable[[Loop, Any, Receptances], Any]

# Numerators over the common denominator Δ(s). The first four say where a disturbance enters the loop and how
# the line of sight answers; S = line_of_sight and T = command are the sensitivity functions.
NUMERATORS: dict[str, Formula] = {
    "mirror_torque": mirror_torque_numerator,
    "hub_torque": hub_torque_numerator,
    "line_of_sight": line_of_sight_numerator,
    "sensor_noise": sensor_noise_numerator,
    "command": command_numerator,
}


def closed_loop_response(name: str, loop: Loop, s: Any, g: Receptances) -> Any:
    """Closed-loop transfer function from an input to the line of sight, by its name in `NUMERATORS`."""
    return NUMERATORS[name](loop, s, g) / characteristic(loop, s, g)
