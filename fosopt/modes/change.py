"""How receptances change with a structure, in the frozen modal frame.

No difference of eigenvalues appears in a denominator, and mode crossings do no harm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fosopt.modes.frame import ModalFrame
from fosopt.modes.modal_set import Damping, ModalSet
from fosopt.ops import Array, ComplexArray


@dataclass(frozen=True)
class ImpedanceChange:
    """How modal damping and a held hub follow mass and stiffness, in the frozen modal frame.

    Modal damping C = M c(M⁻¹K) has dC_kl = Γ_kl dK_kl + Ψ_kl dM_kl with divided differences of c(λ) that stay
    finite where modes cross [Higham2008]; the stiffness of a held hub follows the mass alone.

    Attributes
    ----------
    damping_by_stiffness, damping_by_mass, hub_by_mass
        (n, n) Γ [s], Ψ [1/s], and that of the hub [1/s²].
    """

    damping_by_stiffness: Array
    damping_by_mass: Array
    hub_by_mass: Array


def impedance_change(eigenvalue: Array, modes: ModalSet, damping: Damping) -> ImpedanceChange:
    """Change of damping and hub stiffness with dK and dM for modes of the given eigenvalues, rigid ones first."""
    n_rigid = int(np.count_nonzero(modes.rigid))
    elastic = slice(n_rigid, None)
    by_stiffness, by_mass, hub = (np.zeros((eigenvalue.size, eigenvalue.size)) for _ in range(3))
    w, z = np.sqrt(eigenvalue[elastic]), modes.damping_ratio[elastic]
    mean = (z[:, None] + z) / (w[:, None] + w)
    slope = damping.slopes(w, z)
    by_stiffness[elastic, elastic] = mean + slope
    by_mass[elastic, elastic] = (w[:, None] * w) * (mean - slope)
    for r in range(n_rigid):
        by_mass[r, :] = by_mass[:, r] = modes.damping[r]
        hub[r, :] = hub[:, r] = modes.stiffness[r]
    return ImpedanceChange(by_stiffness, by_mass, hub)


def receptance_functional(
    frame: ModalFrame,
    modes: ModalSet,
    damping: Damping,
    kept: NDArray[np.intp],
    s: ComplexArray,
    modal: ComplexArray,
    coefficients: Mapping[tuple[str, str], ComplexArray],
) -> tuple[Array, Array]:
    """Gradient of Re Σ_i Σ_pq c_pq,i dg_pq(s_i) for the row weights of stiffness and mass.

    With ψ_p = φ_p/(s² + c s + ω²), dg_pq = −ψ_pᵀ (s² dM + s dC + dK) ψ_q, and dC of `ImpedanceChange`.

    Parameters
    ----------
    modes
        All modes of the frame.
    kept
        Indices of the modes that make up g; the others enter through the change of the kept shapes.
    s, modal
        (m,) points and (m, r) modal receptances ψ/φ of the kept modes there.
    coefficients
        (m,) c of each pair of ports.

    Returns
    -------
    (k,), (m,)
        Derivatives for the stiffness and mass weights.
    """
    inside = modes if kept.size == modes.rigid.size else modes.keep(kept)
    # Pairs that share their first port share one product.
    rights: dict[str, ComplexArray] = {}
    shares: dict[tuple[str, str], Array] = {}
    for (p, q), coefficient in coefficients.items():
        right = coefficient[:, None] * inside.at(q)
        rights[p] = rights[p] + right if p in rights else right
        shares[p, q] = np.real(coefficient @ modal)
    size = kept.size
    by_stiffness, by_damping = np.zeros((size, size)), np.zeros((size, size))
    left = np.concatenate([modal.real, -modal.imag]).T
    for p, right in rights.items():
        right *= modal
        by_stiffness += inside.at(p)[:, None] * (left @ np.concatenate([right.real, right.imag]))
        right *= s[:, None]
        by_damping += inside.at(p)[:, None] * (left @ np.concatenate([right.real, right.imag]))
    # That for the mass has s² ψ = φ − (2ζωs + ω²) ψ on the lower mode of each two, where no digits are lost.
    lower = inside.stiffness[:, None] <= inside.stiffness
    first = (
        np.array([inside.at(p) for p, _ in shares]),
        np.array([x * inside.at(q) for (_, q), x in shares.items()]),
    )
    second = (
        np.array([x * inside.at(p) for (p, _), x in shares.items()]),
        np.array([inside.at(q) for _, q in shares]),
    )
    inertial = np.where(lower, first[0].T @ first[1], second[0].T @ second[1])
    lam = frame.eigenvalue[kept]
    change = impedance_change(lam, inside, damping)
    in_stiffness = -(by_stiffness + change.damping_by_stiffness * by_damping)
    damping_left = np.where(lower, inside.damping[:, None], inside.damping) - change.damping_by_mass
    stiffness_left = np.where(lower, inside.stiffness[:, None], inside.stiffness) - change.hub_by_mass
    in_mass = damping_left * by_damping + stiffness_left * by_stiffness - inertial
    if frame.outside is not None:
        motion = {p: np.zeros(size) for p in frame.outside.ports}
        for (p, q), share in shares.items():
            motion[p] += share * inside.at(q)
            motion[q] += share * inside.at(p)
        return frame.contract(in_stiffness, in_mass, motion)
    if kept.size == frame.eigenvalue.size:
        return frame.contract(in_stiffness, in_mass)

    # The kept shapes also turn toward the modes left out: dφ_k = Σ_j φ_j (dK_jk − λ_k dM_jk)/(λ_k − λ_j).
    out = np.setdiff1d(np.arange(frame.eigenvalue.size), kept)
    turn = np.zeros((kept.size, out.size))
    for (p, q), share in shares.items():
        for one, other in ((p, q), (q, p)):
            turn += np.outer(share * inside.at(one), modes.at(other)[out])
    turn /= lam[:, None] - frame.eigenvalue[out]
    n = frame.eigenvalue.size
    full_stiffness, full_mass = np.zeros((n, n)), np.zeros((n, n))
    full_stiffness[np.ix_(kept, kept)], full_mass[np.ix_(kept, kept)] = in_stiffness, in_mass
    full_stiffness[np.ix_(kept, out)] = turn
    full_mass[np.ix_(kept, out)] = -lam[:, None] * turn
    return frame.contract(full_stiffness, full_mass)
