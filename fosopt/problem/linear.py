"""Masses and inertias of a design, which need no modes."""

from __future__ import annotations

import numpy as np

from fosopt.ops import Array
from fosopt.problem.system import Design
from fosopt.structure import Structure, structural_mass, structure_inertia


def linear_metric(structure: Structure, design: Design, name: str) -> tuple[float, Array]:
    """Value and gradient over `Design.parameters` of a mass or an inertia by its name."""
    b, r = design.area.size, design.batten_mass.size
    gradient = np.zeros(design.parameters.size)
    if name in ("structural_mass", "total_mass"):
        gradient[:b] = structure.bar_mass_per_area
        gradient[b : b + r] = 1.0
        mass = float(structural_mass(structure, design.area, design.batten_mass))
        proof = sum(a.mass for a in design.loop.actuators if not a.rotary)
        return (mass + design.mirror_mass + proof if name == "total_mass" else mass), gradient
    own = np.zeros_like(gradient)
    own[design.loop_start] = 1.0
    mirror = float(design.loop.mirror.inertia)
    if name == "mirror_inertia":
        return mirror, own
    inertia = float(structure_inertia(structure, design.area, design.batten_mass))
    arm2 = structure.hub_arm**2
    gradient[:b] = structure.mass_by_area.T @ arm2
    gradient[b : b + r] = structure.mass_by_batten.T @ arm2
    if name == "structure_inertia":
        return inertia, gradient
    return mirror / inertia, own / inertia - mirror / inertia**2 * gradient
