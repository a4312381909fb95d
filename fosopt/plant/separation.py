"""Pole-zero separation of collocated transfer functions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fosopt.errors import ModelError
from fosopt.ops import Array
from fosopt.plant.expansion import ModalExpansion
from fosopt.plant.zeros import expansion_zeros


def collocated_separation(expansion: ModalExpansion) -> Array:
    """β_k = ω_k/Ω_k of each elastic mode of a free structure, Ω_k the exact zero below it, without damping.

    Poles and zeros interlace from the rigid body's pole at the origin on, so that every mode is an appendage mode:
    β_k is above one, and one where pole and zero cancel.    [Barker1991] Eq. (2.55), Sec. 3.2

    Returns
    -------
    (n−1,)
        For n modes, one of them rigid [-].

    Raises
    ------
    ModelError
        If residues differ in sign, as those of a non-collocated pair do, or there is not one rigid-body mode.
    """
    if np.any(expansion.residue < 0):
        raise ModelError(
            "separation: a residue is negative; sensor and action must share a degree of freedom"
        )
    if np.count_nonzero(expansion.rigid) != 1 or np.any(expansion.natural_frequency[expansion.rigid]):
        raise ModelError(
            f"separation: {np.count_nonzero(expansion.rigid)} rigid-body modes, or a held one; each elastic mode has a "
            "zero below it where one rigid-body mode is free"
        )
    undamped = replace(expansion, damping_ratio=np.zeros_like(expansion.damping_ratio))
    zeros = expansion_zeros(undamped).imag
    apart: Array = np.sort(expansion.natural_frequency[~expansion.rigid]) / np.sort(zeros[zeros > 0])
    return apart
