"""The coupled plant: mirror and actuators on their structure."""

from fosopt.plant.coupled import CoupledModes, coupled_modes, modes_of_matrices, secular, secular_slope
from fosopt.plant.matrices import CoupledMatrices, attached, coupled_matrices

__all__ = [
    "CoupledMatrices",
    "CoupledModes",
    "attached",
    "coupled_matrices",
    "coupled_modes",
    "modes_of_matrices",
    "secular",
    "secular_slope",
]
