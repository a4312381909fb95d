"""How far two axes of one structure are from being alike and apart."""

from __future__ import annotations

import numpy as np

from fosopt.modes.modal_set import ModalSet
from fosopt.ops import Array

# Modes closer than this (relative) are one eigenspace, of which only the sum over it has a meaning.
_REPEATED = 1e-6


def axis_coupling(modes: ModalSet, port: str, other: str) -> float:
    """Largest modal constant Σ φ_p φ_q of an eigenspace between two ports, over the largest of their own [-].

    Zero where the receptance between the two ports is zero at all frequencies; one where a single mode moves both.
    """
    own, cross = _own(modes, port, other), _sums(modes, modes.at(port) * modes.at(other))
    scale = np.sqrt(own[0].max() * own[1].max())
    return float(np.abs(cross).max() / scale) if scale > 0 else 0.0


def axis_difference(modes: ModalSet, first: tuple[str, str], second: tuple[str, str]) -> float:
    """Largest difference of modal constants of two pairs of ports, over the largest of the first pair [-].

    Zero where the receptance is the same in both pairs at all frequencies.
    """
    constants = [_sums(modes, modes.at(p) * modes.at(q)) for p, q in (first, second)]
    scale = np.abs(constants[0]).max()
    return float(np.abs(constants[0] - constants[1]).max() / scale) if scale > 0 else 0.0


def _own(modes: ModalSet, port: str, other: str) -> tuple[Array, Array]:
    return _sums(modes, modes.at(port) ** 2), _sums(modes, modes.at(other) ** 2)


def _sums(modes: ModalSet, values: Array) -> Array:
    """Sums over each eigenspace."""
    frequency = modes.natural_frequency
    first = np.concatenate([[True], np.diff(frequency) > _REPEATED * frequency[1:]])
    return np.add.reduceat(values, np.flatnonzero(first))
