"""Transfer functions as sums over modes, the dissertation's exact residues model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray
from fosopt.plant.matrices import CoupledMatrices

# Shapes of a rigid-body mode at two places that differ by less than this share are equal.
_SAME = 1e-9
# An eigenvalue below this share of the largest is that of a rigid-body mode.
_RIGID = 1e-12


@dataclass(frozen=True)
class ModalExpansion:
    """A transfer function Σ r_k/(s² + 2ζ_k ω_k s + ω_k²).    [Barker1991] Eqs. (3.1), (3.6)

    Attributes
    ----------
    natural_frequency, damping_ratio
        (n,) ω_k [rad/s] and ζ_k [-].
    residue
        (n,) r_k, zero for a mode that is not excited or not seen [1/kg] or [1/(kg m²)].
    rigid
        (n,) true for rigid-body modes.
    """

    natural_frequency: Array
    damping_ratio: Array
    residue: Array
    rigid: NDArray[np.bool_]

    @property
    def stiffness(self) -> Array:
        """(n,) ω_k² [rad²/s²]."""
        return self.natural_frequency**2

    @property
    def damping(self) -> Array:
        """(n,) 2 ζ_k ω_k [rad/s]."""
        return 2 * self.damping_ratio * self.natural_frequency

    def response(self, s: ComplexArray) -> ComplexArray:
        """(m,) Value at (m,) Laplace variables [m/N] or [rad/(N m)]."""
        return np.sum(self.residue / (s[:, None] ** 2 + self.damping * s[:, None] + self.stiffness), axis=1)


def modal_expansion(modes: ModalSet, sensor: str, action: str, reaction: str | None = None) -> ModalExpansion:
    """Motion of one port per load on another, r_k = φ_jk φ_ik, or per internal load, r_k = φ_jk (φ_ik − φ_hk).

    Rigid-body motion is not excited by an internal load whose two ends it moves alike: such residues are zero
    exactly.    [Barker1991] Eqs. (3.1), (3.6), (3.8)

    Parameters
    ----------
    sensor, action, reaction
        Ports j, i and h; without the latter the load is external.
    """
    acting = modes.at(action)
    if reaction is not None:
        acting = _difference(acting, modes.at(reaction), modes.rigid)
    return ModalExpansion(
        modes.natural_frequency, modes.damping_ratio, modes.at(sensor) * acting, modes.rigid
    )


def _difference(one: Array, other: Array, rigid: NDArray[np.bool_]) -> Array:
    """One − other, exactly zero for a rigid-body mode that moves both alike."""
    apart = one - other
    alike = rigid & (np.abs(apart) <= _SAME * (np.abs(one) + np.abs(other)))
    return np.where(alike, 0.0, apart)


def coupled_expansion(coupled: CoupledMatrices) -> ModalExpansion:
    """Sensed motion per control torque over the undamped modes of structure, mirror and actuators together.

    Any placement of sensor, action and reaction. Assumes that dampers do not couple these modes: each has the damping
    ratio φᵀCφ/(2ω).    [Barker1991] Eqs. (3.6), (3.10)
    """
    eigenvalue, shapes = linalg.eigh(coupled.stiffness, coupled.mass)
    rigid = eigenvalue <= _RIGID * eigenvalue[-1]
    frequency = np.sqrt(np.where(rigid, 0.0, eigenvalue))
    damping = np.einsum("ik,ij,jk->k", shapes, coupled.damping, shapes)
    ratio = np.where(rigid, 0.0, damping) / np.where(rigid, 1.0, 2 * frequency)
    # The torque's two ends apart, so that what cancels between them cancels exactly.
    pushed, held = np.maximum(coupled.control, 0.0) @ shapes, np.maximum(-coupled.control, 0.0) @ shapes
    acting = _difference(pushed, held, rigid)
    return ModalExpansion(frequency, ratio, (coupled.sensor @ shapes) * acting, rigid)
