"""Masses that ride on a structure known by its modes only."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import linalg

from fosopt.errors import ModelError, did_you_mean
from fosopt.modes.modal_set import Damping, ModalSet


def with_added_mass(modes: ModalSet, added: Mapping[str, float], damping: Damping) -> ModalSet:
    """Modes of the structure with masses fixed to some of its ports.

    In modal coordinates the mass matrix I becomes I + Σ m_p φ_p φ_pᵀ, the first block of [M_{r+2}] = Tᵀ M T.
    Exact for all modes of a structure; for a truncated set, the modes of the reduced model with the mass on it.
    [Barker1991] Eqs. (2.43)-(2.47)

    Assumes the same damping model for the modes with the masses.

    Parameters
    ----------
    added
        Port name to mass [kg], or to inertia [kg m²] at a rotation; a body that moves in two directions needs
        the ports of both.

    Raises
    ------
    ModelError
        For an unknown port, a negative mass, or a hub that is held already.
    """
    if np.any(modes.natural_frequency[modes.rigid] > 0):
        raise ModelError(
            "added mass: the hub is held already; add masses to the free structure, then hold it"
        )
    n = modes.natural_frequency.size
    mass = np.eye(n)
    for port, value in added.items():
        if port not in modes.ports:
            raise ModelError(f"port '{port}' does not exist; {did_you_mean(port, modes.ports)}")
        if not 0 <= value < np.inf:
            raise ModelError(f"added mass at '{port}': {value} kg is no physical value; give zero or more")
        mass += value * np.outer(modes.at(port), modes.at(port))
    eigenvalue, turn = linalg.eigh(np.diag(modes.stiffness), mass)
    rigid = np.arange(n) < np.count_nonzero(modes.rigid)
    frequency = np.sqrt(np.where(rigid, 0.0, eigenvalue))
    ratio = np.zeros(n)
    ratio[~rigid] = damping.of(frequency[~rigid])
    return ModalSet(frequency, ratio, turn.T @ modes.mode_shape, modes.ports, rigid)
