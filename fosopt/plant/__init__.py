"""The coupled plant: mirror and actuators on their structure."""

from fosopt.plant.coupled import CoupledModes, coupled_modes, modes_of_matrices, secular, secular_slope
from fosopt.plant.expansion import ModalExpansion, coupled_expansion, modal_expansion
from fosopt.plant.matrices import CoupledMatrices, attached, coupled_matrices
from fosopt.plant.shapes import coupled_shapes, shapes_of_matrices
from fosopt.plant.zeros import expansion_zeros, mirror_zeros, modal_poles, plant_zeros, quadratic_roots

__all__ = [
    "CoupledMatrices",
    "CoupledModes",
    "ModalExpansion",
    "attached",
    "coupled_expansion",
    "coupled_matrices",
    "coupled_modes",
    "coupled_shapes",
    "expansion_zeros",
    "mirror_zeros",
    "modal_expansion",
    "modal_poles",
    "modes_of_matrices",
    "plant_zeros",
    "quadratic_roots",
    "secular",
    "secular_slope",
    "shapes_of_matrices",
]
