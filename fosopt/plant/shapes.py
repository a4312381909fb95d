"""Shapes of coupled modes, as motion of the structure's modes and of what is attached to it."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from fosopt.actuators import Mirror
from fosopt.modes import ModalSet
from fosopt.ops import Array
from fosopt.plant.coupled import SAME, CoupledModes, seen_by_mirror
from fosopt.plant.matrices import CoupledMatrices


def shapes_of_matrices(coupled: CoupledMatrices) -> Array:
    """(n, n) Shapes of the modes of `modes_of_matrices`, a column each, in the coordinates of the matrices."""
    shapes: Array = linalg.eigh(coupled.stiffness, coupled.mass)[1]
    return shapes


def coupled_shapes(modes: ModalSet, mirror: Mirror, mirror_port: str, coupled: CoupledModes) -> Array:
    """Shapes of the modes of `coupled_modes`, by the equations of the structure's modes under a torque of one.

    With the torque τ of the mirror's spring on its port, (λ̃_j − λ) q_j = φ_hj τ and λ J_m θ = τ. A mode that the
    mirror cannot move is one of the structure's own, with the mirror at rest, or turning along if all is rigid.
    [Barker1991] Eqs. (4.10), (4.12)

    Returns
    -------
    (n+1, n+1)
        A column per mode: coordinates of the structure's modes [m √kg] or [rad √(kg m²)], then the mirror's angle.
    """
    at_port, count = modes.at(mirror_port), modes.natural_frequency.size
    gap = (modes.stiffness[:, None] - coupled.base) - coupled.distance
    moved = (coupled.effective_modal_reaction_inertia != 0) | (coupled.distance != 0)
    shapes = np.zeros((count + 1, count + 1))
    shapes[:count, moved] = at_port[:, None] / gap[:, moved]
    shapes[count, moved] = 1 / (mirror.inertia * coupled.eigenvalue[moved])
    shapes[:, ~moved] = _unmoved(modes, mirror_port)
    return shapes


def _unmoved(modes: ModalSet, mirror_port: str) -> Array:
    """Shapes of the modes that the mirror cannot move, in the order in which `coupled_modes` has them."""
    at_port, count = modes.at(mirror_port), modes.natural_frequency.size
    eigenvalue, shape2 = seen_by_mirror(modes, mirror_port)
    order = np.argsort(modes.stiffness, kind="stable")
    places = np.flatnonzero((shape2 == 0) | (eigenvalue == 0))
    alike = np.flatnonzero(np.diff(eigenvalue) <= SAME * eigenvalue[1:])
    shapes = np.zeros((count + 1, places.size))
    for column, place in enumerate(places):
        j = order[place]
        shapes[j, column] = 1.0
        if eigenvalue[place] == 0:
            shapes[count, column] = at_port[j]
        elif at_port[j] != 0 and place in alike:
            # The next mode, of the same eigenvalue, takes back at the port what this one does there.
            after = order[place + 1]
            shapes[[j, after], column] = at_port[after], -at_port[j]
    return shapes
