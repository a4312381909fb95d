"""Comparison of mode shapes: the modal assurance criterion, and which mode belongs to which."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from fosopt.errors import ModelError
from fosopt.ops import Array

Shapes = NDArray[np.floating[Any]] | NDArray[np.complexfloating[Any, Any]]


def modal_assurance(first: Shapes, second: Shapes) -> Array:
    """Modal assurance criterion |φ_iᴴ ψ_j|²/((φ_iᴴ φ_i)(ψ_jᴴ ψ_j)) of two sets of mode shapes.    [Allemang1982]

    One for shapes that are proportional, zero for those that are orthogonal in the plain sense: modes of one
    structure are orthogonal in its mass, so that few or uneven points leave some criterion between them. Compare
    displacements with displacements: a rotation beside them counts by its unit.

    Parameters
    ----------
    first, second
        (d, p) and (d, q) shapes at the same d degrees of freedom, one column per mode, of any scale or phase.

    Returns
    -------
    (p, q)
        Between zero and one [-].

    Raises
    ------
    ModelError
        If the degrees of freedom differ in number, or a shape is zero or not finite there.
    """
    if first.ndim != 2 or second.ndim != 2 or first.shape[0] != second.shape[0]:
        raise ModelError(
            f"modal assurance: shapes of {first.shape} and {second.shape}; give both as (dof, mode) at the same dofs"
        )
    unit = []
    for which, shapes in (("first", first), ("second", second)):
        size = np.linalg.norm(shapes, axis=0)
        for k in np.flatnonzero(~(np.isfinite(size) & (size > 0)))[:1]:
            raise ModelError(
                f"modal assurance: mode {k + 1} of the {which} set is zero or not finite at these degrees of freedom; "
                "leave it out or add degrees of freedom that it moves"
            )
        unit.append(shapes / size)
    return np.abs(unit[0].conj().T @ unit[1]) ** 2


def match_modes(assurance: Array, least: float = 0.5) -> NDArray[np.intp]:
    """Which mode of the second set each mode of the first belongs to.

    The pairing of largest total assurance, each mode used once.

    Parameters
    ----------
    assurance
        (p, q) of `modal_assurance`.
    least
        Modes that agree less than this are no pair.

    Returns
    -------
    (p,)
        Indices into the second set, −1 for a mode without partner.
    """
    worth = np.where(assurance >= least, assurance, 0.0)
    rows, columns = optimize.linear_sum_assignment(worth, maximize=True)
    partner = np.full(assurance.shape[0], -1)
    paired = worth[rows, columns] > 0
    partner[rows[paired]] = columns[paired]
    return partner
