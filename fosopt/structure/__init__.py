"""Structures: trusses of pin-ended bars and rigid battens, uniform beams, and chains of bodies and springs."""

from fosopt.structure.assembly import assemble, bar_lengths, motion_at
from fosopt.structure.barker import barker_truss
from fosopt.structure.beam import Beam, BeamModes, assemble_beam, barker_beam, lateral_motion
from fosopt.structure.chain import Chain, assemble_chain, two_body_stiffness
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
    "Beam",
    "BeamModes",
    "Chain",
    "PointMass",
    "Spring",
    "Structure",
    "Truss",
    "assemble",
    "assemble_beam",
    "assemble_chain",
    "bar_lengths",
    "barker_beam",
    "barker_truss",
    "lateral_motion",
    "mass_matrix",
    "mass_weights",
    "motion_at",
    "stiffness_matrix",
    "stiffness_weights",
    "structural_mass",
    "structure_inertia",
    "two_body_stiffness",
]
