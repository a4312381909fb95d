"""State-space form of second-order equations of motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fosopt.control.state_space import StateSpace
from fosopt.errors import ModelError
from fosopt.modes import ModalSet
from fosopt.ops import Array


def second_order_state_space(
    mass: Array, damping: Array, stiffness: Array, ports: Mapping[str, Array]
) -> StateSpace:
    """State space of M q̈ + C q̇ + K q = f with a load and a motion at each port.

    The state is [q, q̇], the dissertation's two halves exchanged.    [Barker1991] Eqs. (2.51)-(2.54)

    Parameters
    ----------
    mass, damping, stiffness
        (n, n).
    ports
        Name to the (n,) row that reads a port's motion; its transpose applies the port's load.

    Returns
    -------
    StateSpace
        Inputs and outputs both carry the names of the ports.

    Raises
    ------
    ModelError
        If the mass matrix is singular.
    """
    n = mass.shape[0]
    rows = np.array(list(ports.values())).reshape(len(ports), n)
    try:
        moved = np.linalg.solve(mass, np.hstack([stiffness, damping, rows.T]))
    except np.linalg.LinAlgError as error:
        raise ModelError("state space: the mass matrix is singular; every coordinate needs mass") from error
    a = np.zeros((2 * n, 2 * n))
    a[:n, n:] = np.eye(n)
    a[n:] = -moved[:, : 2 * n]
    b = np.vstack([np.zeros((n, len(ports))), moved[:, 2 * n :]])
    c = np.hstack([rows, np.zeros((len(ports), n))])
    names = tuple(ports)
    return StateSpace(a, b, c, np.zeros((len(ports), len(ports))), names, names)


def structure_state_space(modes: ModalSet, ports: Sequence[str]) -> StateSpace:
    """State space of a modal set alone, with a load and a motion at each named port.

    The state is [modal coordinates, their velocities].    [Barker1991] Eqs. (2.51)-(2.54)
    """
    matrices = (np.eye(modes.natural_frequency.size), np.diag(modes.damping), np.diag(modes.stiffness))
    return second_order_state_space(*matrices, {port: modes.at(port) for port in ports})
