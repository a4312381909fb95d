"""Modal sets: the hinge between any structure and everything that is attached to it.

A `ModalSet` holds natural frequencies, damping ratios and mode shapes at the ports; the plant, the loop and the
metrics need nothing else. A `ModalFrame` is the eigenbasis of a built-in structure at one design; it also answers
how receptances, frequencies and inertias change with the design.
"""

from fosopt.modes.change import ImpedanceChange, impedance_change, receptance_functional
from fosopt.modes.frame import ModalFrame, modal_frame
from fosopt.modes.mac import match_modes, modal_assurance
from fosopt.modes.modal_set import Damping, Hub, ModalSet
from fosopt.modes.truncated import modes_below, truncated_frame
from fosopt.modes.truncation import reduced_matrices

__all__ = [
    "Damping",
    "Hub",
    "ImpedanceChange",
    "ModalFrame",
    "ModalSet",
    "impedance_change",
    "match_modes",
    "modal_assurance",
    "modal_frame",
    "modes_below",
    "receptance_functional",
    "reduced_matrices",
    "truncated_frame",
]
