"""Second-order equations of structure, mirror and actuators in inertial coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fosopt.actuators import Mirror, Placement, ReactionMassActuator, Suspended
from fosopt.ops import Array


@dataclass(frozen=True)
class CoupledMatrices:
    """M q̈ + C q̇ + K q = f with q = [structure, mirror, its reaction mass, proof masses, mirror about its other axis].

    Attributes
    ----------
    mass, damping, stiffness
        (n, n).
    mirror, counter
        Index of the mirror's angle, and of its reaction mass, None without one.
    control, sensor
        (n,) load per control torque, and what the controller is fed.
    relative
        (n_actuator, n) motion of each proof mass relative to its port; its transpose loads both with the
        interaction force.    [Barker1991] Eq. (2.40)
    other
        (n,) load per control torque about the mirror's other axis, whose angle is the last coordinate; None without
        one.
    """

    mass: Array
    damping: Array
    stiffness: Array
    mirror: int
    counter: int | None
    control: Array
    sensor: Array
    relative: Array
    other: Array | None = None


def attached(
    structure: tuple[Array, Array, Array], bodies: Sequence[tuple[Array, Suspended]]
) -> tuple[Array, Array, Array, Array]:
    """Mass, damping and stiffness with bodies on springs added, and the bodies' relative motions.

    Parameters
    ----------
    structure
        (n, n) mass, damping and stiffness.
    bodies
        (n,) row of the port each one is mounted on, and what is mounted.

    Returns
    -------
    (n+b, n+b), (n+b, n+b), (n+b, n+b), (b, n+b)
    """
    n = structure[0].shape[0]
    size = n + len(bodies)
    mass, damping, stiffness = (np.zeros((size, size)) for _ in range(3))
    for whole, part in zip((mass, damping, stiffness), structure, strict=True):
        whole[:n, :n] = part
    relative = np.zeros((len(bodies), size))
    for i, (port, body) in enumerate(bodies):
        relative[i, :n], relative[i, n + i] = -port, 1.0
        mass[n + i, n + i] = body.inertia
        damping += body.damping * np.outer(relative[i], relative[i])
        stiffness += body.stiffness * np.outer(relative[i], relative[i])
    return mass, damping, stiffness, relative


def coupled_matrices(
    structure: tuple[Array, Array, Array],
    ports: Mapping[str, Array],
    mirror_port: str,
    mirror: Mirror,
    placement: Placement,
    actuators: Sequence[ReactionMassActuator] = (),
    other: tuple[str, Mirror] | None = None,
) -> CoupledMatrices:
    """Attach a mirror and reaction-mass actuators to a structure.

    The dissertation's coordinates are relative to the mount; inertial ones leave the mass matrix block diagonal
    and describe the same motion.    [Barker1991] Eqs. (2.38), (2.42)-(2.49), (4.12)

    Parameters
    ----------
    structure
        (n, n) mass, damping and stiffness, in physical or modal coordinates.
    ports
        (n,) row that reads each port's motion in these coordinates.
    other
        Port and mirror about its other axis, the last coordinate.
    """
    n = structure[0].shape[0]
    bodies = [(ports[mirror_port], Suspended(mirror.inertia, mirror.stiffness, mirror.damping))]
    if mirror.counter is not None:
        bodies.append((ports[mirror_port], mirror.counter))
    first = len(bodies)
    bodies += [(ports[a.port], a.suspended) for a in actuators]
    last = len(bodies)
    if other is not None:
        bodies.append((ports[other[0]], Suspended(other[1].inertia, other[1].stiffness, other[1].damping)))
    mass, damping, stiffness, relative = attached(structure, bodies)
    size = mass.shape[0]

    def unit(port: str | None, otherwise: int | None) -> Array:
        row = np.zeros(size)
        if port is not None:
            row[:n] = ports[port]
        elif otherwise is not None:
            row[otherwise] = 1.0
        return row

    reaction = unit(placement.reaction or mirror_port, None)
    control = unit(placement.action, n) - reaction
    if mirror.reaction_mass is not None:
        control -= mirror.reaction_mass.torque_ratio * (unit(None, n + 1) - reaction)
    return CoupledMatrices(
        mass,
        damping,
        stiffness,
        n,
        n + 1 if mirror.counter is not None else None,
        control,
        unit(placement.sensor, n),
        relative[first:last],
        None if other is None else relative[last],
    )
