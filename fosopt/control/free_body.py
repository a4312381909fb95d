"""A free rigid body split off a plant: what turns as one, and what moves within it.

With R the rigid-body motions, K R = C R = 0, and N the motions that carry no momentum, Rᵀ M N = 0, every motion is
q = N y + R p, and the two do not know of each other:

    NᵀMN ÿ + NᵀCN ẏ + NᵀKN y = Nᵀ f,      RᵀMR p̈ = Rᵀ f.

Torques from within have Rᵀ f = 0: they cannot move p, and no state of the loop is lost with it. A load from outside
moves p = (RᵀMR)⁻¹ Rᵀ f/s², which reaches the outputs beside what it moves within.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fosopt.control.loop import Loop
from fosopt.control.state_space import StateSpace, modal_matrices
from fosopt.errors import ModelError
from fosopt.modes import ModalSet
from fosopt.ops import Array

# What may be left where action and reaction cancel, of the larger one.
_INTERNAL = 1e-9


def split(plant: StateSpace, loop: Loop, modes: ModalSet, mirror_port: str) -> tuple[StateSpace, Array]:
    """A plant of `plant_state_space` without its free rigid body, and the motion of that per load.

    Returns
    -------
    StateSpace, (p, m)
        The plant that moves within; its outputs read angles of the rigid body as well, by this over s² per load.

    Raises
    ------
    ModelError
        As `refuse_turning`.
    """
    free = np.flatnonzero(modes.stiffness == 0)
    if not free.size:
        return plant, np.zeros((len(plant.outputs), len(plant.inputs)))
    refuse_turning(loop, modes, mirror_port)
    mass = modal_matrices(loop, modes, mirror_port).mass
    size, n = mass.shape[0], modes.natural_frequency.size
    carried = [mirror_port, *(loop.ports(mirror_port)[port] for port, _ in loop.suspended)]
    rigid = np.zeros((size, free.size))
    rigid[free, np.arange(free.size)] = 1.0
    rigid[n:] = np.array([modes.at(port)[free] for port in carried])
    momentum = rigid.T @ mass
    force = momentum @ plant.b[size:]
    kept = np.delete(np.arange(size), free)
    within = np.zeros((size, kept.size))
    within[kept, np.arange(kept.size)] = 1.0
    within[free] = -momentum[:, kept]
    whole = momentum @ rigid
    taken = np.eye(size)[kept] - rigid[kept] @ np.linalg.solve(whole, momentum)
    into, out_of = np.kron(np.eye(2), taken), np.kron(np.eye(2), within)
    turned = (plant.c[:, :size] @ rigid) @ np.linalg.solve(whole, force)
    return replace(plant, a=into @ plant.a @ out_of, b=into @ plant.b, c=plant.c @ out_of), turned


def refuse_turning(loop: Loop, modes: ModalSet, mirror_port: str) -> None:
    """Refuse a control torque that turns a free rigid body, whose drift is no matter of the loop otherwise.

    Raises
    ------
    ModelError
        If action and reaction do not turn alike with it.
    """
    place = loop.placement
    if place.action is None and place.reaction is None:
        return
    free = modes.stiffness == 0
    action, reaction = (modes.at(port or mirror_port)[free] for port in (place.action, place.reaction))
    if np.any(np.abs(action - reaction) > _INTERNAL * np.maximum(np.abs(action), np.abs(reaction))):
        raise ModelError(
            "the control torque turns the free hub, as action and reaction do not turn alike; let it act and react on "
            "rotations about the hub's axis, or hold or fix the hub"
        )
