"""Modal truncation to chosen degrees of freedom and modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fosopt.errors import ModelError
from fosopt.modes.frame import ModalFrame
from fosopt.modes.modal_set import ModalSet
from fosopt.ops import Array


def reduced_matrices(
    frame: ModalFrame, modes: ModalSet, dofs: Sequence[str], keep: Sequence[int]
) -> tuple[Array, Array, Array]:
    """Reduced mass, damping and stiffness in chosen degrees of freedom and modes.

    M_r = φ⁻ᵀ φ⁻¹, C_r = φ⁻ᵀ [2ζω] φ⁻¹, K_r = φ⁻ᵀ λ φ⁻¹ with φ the chosen rows and columns of the modal
    matrix.    [Barker1991] Eqs. (2.32)-(2.36)

    Parameters
    ----------
    dofs
        Names of the chosen degrees of freedom, such as ``B20.y``.
    keep
        Indices of the chosen modes from zero, as many as `dofs`.

    Returns
    -------
    (r, r), (r, r), (r, r)
        M_r, C_r, K_r.

    Raises
    ------
    ModelError
        If numbers differ, a name is unknown, or φ is singular.
    """
    if len(dofs) != len(keep):
        raise ModelError(
            f"modal truncation: {len(dofs)} degrees of freedom but {len(keep)} modes; choose as many of each"
        )
    names = list(frame.structure.dofs)
    for dof in dofs:
        if dof not in names:
            raise ModelError(f"modal truncation: degree of freedom '{dof}' does not exist")
    phi = frame.shapes[np.ix_([names.index(dof) for dof in dofs], list(keep))]
    if np.linalg.cond(phi) > 1e12:
        raise ModelError(
            "modal truncation: the chosen modes are not independent in the chosen degrees of freedom "
            "(singular reduced modal matrix, Eq. 2.33); choose others"
        )
    inverse = np.linalg.inv(phi)
    chosen = modes.keep(list(keep))
    return (
        inverse.T @ inverse,
        (inverse.T * chosen.damping) @ inverse,
        (inverse.T * chosen.stiffness) @ inverse,
    )
