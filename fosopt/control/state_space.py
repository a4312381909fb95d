"""State-space form of the closed loop, for time simulation, export and independent checks.

    ẋ = A x + B u,   y = C x + D u

with x = [modal coordinates q, velocities q̇, mirror angle θ_m, rate, integral of the error, derivative filter].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fosopt.control.loop import Loop
from fosopt.modes import ModalSet
from fosopt.ops import Array

INPUTS = ("mirror_torque", "hub_torque", "line_of_sight", "sensor_noise", "command")
OUTPUTS = ("mirror_angle", "line_of_sight")


@dataclass(frozen=True)
class StateSpace:
    """A linear system with named inputs and outputs.

    Attributes
    ----------
    a, b, c, d
        (n, n), (n, m), (p, n), (p, m).
    inputs, outputs
        (m,), (p,) names.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def plant_state_space(loop: Loop, modes: ModalSet, mirror_port: str) -> StateSpace:
    """Structure and mirror without the controller.    [Barker1991] Eqs. (2.51)-(2.54)

    Inputs are the control torque (on the mirror, reacting on the port), an external torque on the mirror and a
    torque on the hub [N m]; outputs are mirror angle [rad] and rate [rad/s].
    """
    n = modes.natural_frequency.size
    mirror = loop.mirror
    q, v = slice(0, n), slice(n, 2 * n)
    theta, rate = 2 * n, 2 * n + 1
    h = modes.at(mirror_port)
    a = np.zeros((2 * n + 2, 2 * n + 2))
    a[q, v] = np.eye(n)
    a[v, q] = -np.diag(modes.stiffness)
    a[v, v] = -np.diag(modes.damping)
    a[theta, rate] = 1.0
    for factor, position, speed in ((mirror.stiffness, q, theta), (mirror.damping, v, rate)):
        a[v, position] -= factor * np.outer(h, h)
        a[v, speed] += factor * h
        a[rate, position] += factor * h / mirror.inertia
        a[rate, speed] -= factor / mirror.inertia
    b = np.zeros((2 * n + 2, 3))
    b[v, 0], b[rate, 0] = -h, 1 / mirror.inertia
    b[rate, 1] = 1 / mirror.inertia
    b[v, 2] = modes.at("hub")
    c = np.zeros((2, 2 * n + 2))
    c[0, theta] = c[1, rate] = 1.0
    return StateSpace(
        a,
        b,
        c,
        np.zeros((2, 3)),
        ("control_torque", "mirror_torque", "hub_torque"),
        ("mirror_angle", "mirror_rate"),
    )


def closed_loop_state_space(loop: Loop, modes: ModalSet, mirror_port: str) -> StateSpace:
    """Closed loop from all disturbances and the command to mirror angle and line of sight.

    An ideal derivative differentiates what it measures. Those inputs u enter as B₀ u + B₁ u̇; with the states
    x − B₁ u the derivative disappears, A B₁ + B₀ takes the place of B, and y is unchanged because C B₁ = 0.
    """
    plant = plant_state_space(loop, modes, mirror_port)
    pid = loop.controller
    n = plant.a.shape[0]
    filtered = pid.rolloff_time > 0 and pid.kd != 0
    integrating = pid.ki != 0
    size = n + integrating + filtered
    xi, w = n, n + integrating
    torque = np.zeros(size)
    torque[:n] = pid.gain * plant.b[:, 0]
    angle, rate = np.zeros(size), np.zeros(size)
    angle[:n], rate[:n] = plant.c

    a = np.zeros((size, size))
    a[:n, :n] = plant.a
    proportional = pid.kp + (pid.kd / pid.rolloff_time if filtered else 0.0)
    # The error is −(θ + u): u is noise or line-of-sight displacement, and −u the command.
    a -= proportional * np.outer(torque, angle)
    measured, derivative = -proportional * torque, np.zeros(size)
    if integrating:
        a[:, xi] += pid.ki * torque
        a[xi] -= angle
        measured[xi] -= 1.0
    if filtered:
        a[:, w] -= pid.kd / pid.rolloff_time * torque
        a[w] -= angle / pid.rolloff_time
        a[w, w] -= 1 / pid.rolloff_time
        measured[w] -= 1 / pid.rolloff_time
    else:
        a -= pid.kd * np.outer(torque, rate)
        derivative = -pid.kd * torque
    column = measured + a @ derivative
    external = np.zeros((size, 2))
    external[:n] = plant.b[:, 1:]
    b = np.column_stack([external, column, column, -column])
    c = np.vstack([angle, angle])
    d = np.zeros((2, 5))
    d[1, INPUTS.index("line_of_sight")] = 1.0
    return StateSpace(a, b, c, d, INPUTS, OUTPUTS)
