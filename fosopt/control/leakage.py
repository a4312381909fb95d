"""Torque that a steering mirror leaves in its support structure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fosopt.actuators import Mirror
from fosopt.control.state_space import StateSpace

LEAKAGE = "torque_leakage"


def with_torque_leakage(plant: StateSpace, mirror: Mirror) -> StateSpace:
    """The plant with one more output, the torque leakage T_L = J_m θ̈_m + J_rm θ̈_rm [N m].

    Angles are inertial and count the same way, so that two bodies that counter-rotate cancel; the dissertation counts
    the reaction mass the other way and subtracts. The structure carries −T_L as long as nothing else turns the mirror.
    [Barker1991] Eq. (2.50)

    Parameters
    ----------
    plant
        Of `plant_state_space` for the same mirror.
    """
    momentum = mirror.inertia * plant.c[plant.outputs.index("mirror_angle")]
    if mirror.counter is not None:
        momentum = momentum + mirror.counter.inertia * plant.c[plant.outputs.index("reaction_mass_angle")]
    rate = momentum @ plant.a
    return replace(
        plant,
        c=np.vstack([plant.c, rate @ plant.a]),
        d=np.vstack([plant.d, rate @ plant.b]),
        outputs=(*plant.outputs, LEAKAGE),
    )
