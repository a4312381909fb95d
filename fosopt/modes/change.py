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
    """Change of damping and hub stiffness with dK and dM for modes of the given elastic eigenvalues."""
    elastic = np.flatnonzero(~modes.rigid)
    by_stiffness, by_mass, hub = (np.zeros((eigenvalue.size, eigenvalue.size)) for _ in range(3))
    w, z = np.sqrt(eigenvalue[elastic]), modes.damping_ratio[elastic]
    mean = 0.5 * (z[:, None] + z) / (w[:, None] + w)
    slope = damping.slopes(w, z)
    block = np.ix_(elastic, elastic)
    by_stiffness[block] = 2 * mean + slope
    by_mass[block] = 2 * (w[:, None] * w) * (mean - slope / 2)
    for r in np.flatnonzero(modes.rigid):
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
    for (p, q), coefficient in coefficients.items():
        right = coefficient[:, None] * (modal * inside.at(q))
        rights[p] = rights[p] + right if p in rights else right
    size = kept.size
    powers = [np.zeros((size, size)) for _ in range(3)]
    for p, right in rights.items():
        left = modal * inside.at(p)
        for k in range(3):
            powers[k] += _real_product(left, right)
            right = right * s[:, None]
    lam = frame.eigenvalue[kept]
    change = impedance_change(frame.eigenvalue[kept], inside, damping)
    in_stiffness = -(powers[0] + change.damping_by_stiffness * powers[1])
    in_mass = -(powers[2] + change.damping_by_mass * powers[1] + change.hub_by_mass * powers[0])
    if kept.size == frame.eigenvalue.size:
        return frame.contract(in_stiffness, in_mass)

    # The kept shapes also turn toward the modes left out: dφ_k = Σ_j φ_j (dK_jk − λ_k dM_jk)/(λ_k − λ_j).
    out = np.setdiff1d(np.arange(frame.eigenvalue.size), kept)
    turn = np.zeros((kept.size, out.size))
    for (p, q), coefficient in coefficients.items():
        share = np.real(coefficient @ modal)[:, None]
        for one, other in ((p, q), (q, p)):
            turn += share * inside.at(one)[:, None] * modes.at(other)[out]
    turn /= lam[:, None] - frame.eigenvalue[out]
    n = frame.eigenvalue.size
    full_stiffness, full_mass = np.zeros((n, n)), np.zeros((n, n))
    full_stiffness[np.ix_(kept, kept)], full_mass[np.ix_(kept, kept)] = in_stiffness, in_mass
    full_stiffness[np.ix_(kept, out)] = turn
    full_mass[np.ix_(kept, out)] = -lam[:, None] * turn
    return frame.contract(full_stiffness, full_mass)


def _real_product(left: ComplexArray, right: ComplexArray) -> Array:
    """Re(leftᵀ right) as one real product."""
    a = np.concatenate([left.real, -left.imag])
    b = np.concatenate([right.real, right.imag])
    return a.T @ b
