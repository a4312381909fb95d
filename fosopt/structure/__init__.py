"""Structures: trusses of pin-ended bars and rigid battens, and their mass and stiffness."""

from fosopt.structure.assembly import assemble, bar_lengths
from fosopt.structure.barker import barker_truss
from fosopt.structure.truss import (
    Bar,
    Batten,
    PointMass,
    Spring,
    Structure,
    Truss,
    mass_matrix,
    mass_weights,
    stiffness_matrix,
    stiffness_weights,
    structural_mass,
    structure_inertia,
)

__all__ = [
    "Bar",
    "Batten",
    "PointMass",
    "Spring",
    "Structure",
    "Truss",
    "assemble",
    "bar_lengths",
    "barker_truss",
    "mass_matrix",
    "mass_weights",
    "stiffness_matrix",
    "stiffness_weights",
    "structural_mass",
    "structure_inertia",
]
