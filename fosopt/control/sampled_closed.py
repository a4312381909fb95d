"""A sampled loop closed on itself, from sample to sample."""

from __future__ import annotations

import numpy as np

from fosopt.control.loop import Loop
from fosopt.control.state_space import StateSpace
from fosopt.control.systems import sampled_controller_state_space, sampled_plant_state_space
from fosopt.modes import ModalSet


def sampled_closed_loop_state_space(loop: Loop, modes: ModalSet, mirror_port: str) -> StateSpace:
    """The sampled loop from command to the angles at the samples and the computed torque.

    The plant G takes the torque u of the controller K, which sees its sensed angle y:    [Astrom1997] Sec. 2.3

        x_G' = A_G x_G + B_G u,   y = C_G x_G,   x_K' = A_K x_K + B_K (r, y),   u = C_K x_K + D_K (r, y).

    Raises
    ------
    ModelError
        If the loop is not sampled, or its torque turns a free hub.
    """
    plant = sampled_plant_state_space(loop, modes, mirror_port)
    controller = sampled_controller_state_space(loop.controller)
    seen = plant.c[:1]
    by_command, by_angle = controller.b[:, :1], controller.b[:, 1:]
    direct, back = controller.d[:, :1], controller.d[:, 1:]
    torque = np.hstack([back @ seen, controller.c])
    n, order = plant.a.shape[0], controller.a.shape[0]
    a = np.zeros((n + order, n + order))
    a[:n, :n], a[n:, n:], a[n:, :n] = plant.a, controller.a, by_angle @ seen
    a[:n] += plant.b @ torque
    b = np.vstack([plant.b @ direct, by_command])
    c = np.vstack([np.hstack([plant.c, np.zeros((plant.c.shape[0], order))]), torque])
    d = np.vstack([np.zeros((plant.c.shape[0], 1)), direct])
    return StateSpace(a, b, c, d, ("command",), (*plant.outputs, *controller.outputs), plant.period)
