"""The dissertation's inertias and pole-zero separations, and how they change with the structure.

Differentials are coefficients of dK and dM in the modal frame, ⟨stiffness, dK⟩ + ⟨mass, dM⟩.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror
from fosopt.modes import ModalFrame, ModalSet
from fosopt.ops import Array
from fosopt.plant import CoupledModes, secular_slope


@dataclass(frozen=True)
class ModalFunctional:
    """The differential of a modal metric, ⟨stiffness, dK⟩ + ⟨mass, dM⟩ + ⟨motion, dφ⟩ + inertia dJ_m + frequency dω_m.

    Attributes
    ----------
    stiffness, mass
        (n, n) in the basis of the modal frame.
    mirror_inertia, mirror_frequency
        Partial derivatives.
    motion
        (n,) of the shapes at each port, which a truncated frame needs, see `ModalFrame.contract`.
    """

    stiffness: Array
    mass: Array
    mirror_inertia: float = 0.0
    mirror_frequency: float = 0.0
    motion: Mapping[str, Array] = field(default_factory=dict)


def mirror_inertia_from_modes(mirror_shape: Array) -> float:
    """J_m = 1/Σ φ_ik² over the coupled mode shapes at the inertial mirror angle.    [Barker1991] Eq. (4.3)"""
    return float(1 / np.sum(mirror_shape**2))


def reference_inertia(modes: ModalSet, port: str) -> float:
    """J_ref = 1/Σ φ_hk² at the port the mirror is mounted on [kg m²].    [Barker1991] Eq. (4.5)"""
    return float(1 / np.sum(modes.at(port) ** 2))


def modal_inertia(modes: ModalSet, port: str, other: str | None = None) -> Array:
    """(n,) J̃_k = 1/(φ_jk φ_ik) of two ports, or of one with itself, infinite for a node at either [kg m²].

    [Barker1991] Eqs. (4.9), (4.16), (4.23), (4.24)
    """
    with np.errstate(divide="ignore"):
        return 1 / (modes.at(port) * modes.at(other or port))


def modal_reaction_inertia(coupled: CoupledModes, mirror: Mirror) -> Array:
    """(n+1,) J_k = J_m/J̄_k, infinite for a rigid-body mode [kg m²].    [Barker1991] Eqs. (4.6), (4.11)"""
    with np.errstate(divide="ignore"):
        return mirror.inertia / coupled.effective_modal_reaction_inertia


def _turning(
    frame: ModalFrame, mode: int, others: NDArray[np.intp], motion: Array, size: int
) -> tuple[Array, Array]:
    """Coefficients of d(φ_hk) = Σ_j φ_hj (dK_jk − λ_k dM_jk)/(λ_k − λ_j) from the modes `others`.  [Fox1968]"""
    stiffness, mass = np.zeros((size, size)), np.zeros((size, size))
    lam = frame.eigenvalue
    stiffness[mode, others] = motion[others] / (lam[mode] - lam[others])
    mass[mode, others] = -lam[mode] * stiffness[mode, others]
    return stiffness, mass


def reference_inertia_functional(
    frame: ModalFrame, modes: ModalSet, kept: NDArray[np.intp], port: str
) -> ModalFunctional:
    """Differential of J_ref over the kept modes.

    Over all modes 1/J_ref = eᵀ M⁻¹ e, so only the mass matrix matters.
    """
    motion = modes.at(port)
    n = motion.size
    inside = np.zeros(n)
    inside[kept] = motion[kept]
    stiffness, mass = np.zeros((n, n)), -np.outer(inside, inside)
    if kept.size < n:
        out = np.setdiff1d(np.arange(n), kept)
        for k in kept:
            by_stiffness, by_mass = _turning(frame, k, out, motion, n)
            stiffness += 2 * motion[k] * by_stiffness
            mass += 2 * motion[k] * by_mass
    factor = -1 / np.sum(inside**2) ** 2
    return ModalFunctional(factor * stiffness, factor * mass)


def modal_inertia_functional(frame: ModalFrame, modes: ModalSet, port: str, mode: int) -> ModalFunctional:
    """Differential of J̃_k.

    Assumes the mode is simple; at a crossing a single mode shape has no differential.
    """
    motion = modes.at(port)
    n = motion.size
    others = np.delete(np.arange(frame.n_exact), mode)
    stiffness, mass = _turning(frame, mode, others, motion, n)
    mass[mode, mode] = -0.5 * motion[mode]
    factor = -2 / motion[mode] ** 3
    own = np.zeros(n)
    own[mode] = factor
    return ModalFunctional(factor * stiffness, factor * mass, motion={port: own})


def coupled_functionals(
    frame: ModalFrame, modes: ModalSet, coupled: CoupledModes, mirror: Mirror, port: str, mode: int
) -> dict[str, ModalFunctional]:
    """Differentials of ω_k² and J̄_k of a coupled mode, by implicit differentiation of the secular equation.

    No difference of uncoupled eigenvalues appears. Assumes the modes are those of the whole frame, and that the mode is
    moved by the mirror.

    Returns
    -------
    dict
        ``eigenvalue`` and ``effective_modal_reaction_inertia``.
    """
    n = frame.eigenvalue.size
    k, w = mirror.stiffness, mirror.natural_frequency
    base, distance = coupled.base[mode], coupled.distance[mode]
    lam = base + distance
    gap = (modes.stiffness - base) - distance
    phi = modes.at(port)
    psi = phi / gap
    psi_slope = psi / gap
    g, g1, g2 = phi @ psi, phi @ psi_slope, 2 * phi @ (psi_slope / gap)
    slope = secular_slope(k, lam, g, g1)
    curvature = -2 * k * g1 - lam * k * g2
    # The held hub's stiffness belongs to the rigid-body mode and moves with its mass.
    held = np.where(modes.rigid, modes.stiffness, 0.0)
    hub = np.zeros((n, n))
    for r in np.flatnonzero(held):
        hub[r, :] = hub[:, r] = held[r]
    outer, outer_slope = np.outer(psi, psi), np.outer(psi, psi_slope)
    # dg at fixed λ = −ψᵀ(dK − λ dM)ψ, and its derivative in λ.
    g_k, g_m = -outer, lam * outer - hub * outer
    g1_k = -2 * outer_slope
    g1_m = 2 * lam * outer_slope + outer - 2 * hub * outer_slope
    # The same for the motions of the port, and
    g_u, g1_u = 2 * psi, 2 * psi_slope
    # partial derivatives of F for J_m and ω_m, with k = J_m ω_m².
    f_j, f_w = -lam * w**2 * g, 2 * w * (1 - lam * mirror.inertia * g)
    lam_k, lam_m, lam_u = lam * k * g_k / slope, lam * k * g_m / slope, lam * k * g_u / slope
    lam_j, lam_w = -f_j / slope, -f_w / slope
    factor = 1 / slope**2

    def total(by_lambda: Array | float, g_part: Array | float, g1_part: Array | float) -> Array | float:
        return factor * (curvature * by_lambda - k * g_part - lam * k * g1_part)

    direct = -(g + lam * g1)
    return {
        "eigenvalue": ModalFunctional(lam_k, lam_m, float(lam_j), float(lam_w), {port: lam_u}),
        "effective_modal_reaction_inertia": ModalFunctional(
            np.asarray(total(lam_k, g_k, g1_k)),
            np.asarray(total(lam_m, g_m, g1_m)),
            float(factor * (curvature * lam_j + w**2 * direct)),
            float(factor * (curvature * lam_w + 2 * w * mirror.inertia * direct)),
            {port: np.asarray(total(lam_u, g_u, g1_u))},
        ),
    }
