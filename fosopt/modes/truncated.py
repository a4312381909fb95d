"""The lowest modes of a large structure with the residual flexibility of the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from fosopt.errors import ModelError
from fosopt.modes.frame import ModalFrame, refuse_negative, turn_repeated
from fosopt.modes.lanczos import SparsePencil, lowest_modes, reached_shapes, sparse_pencil
from fosopt.modes.outside import Outside
from fosopt.ops import Array
from fosopt.structure import Structure, mass_weights, stiffness_weights

# Modes beyond those kept: they show the gap above, and make what is beyond them easy to solve for.
_GUARDS = 8
_GUARD_SHARE = 5
# Modes closer than this (relative) are kept together.
_TOGETHER = 1e-8
# Residual flexibility below this share of the whole is rounding.
_NONE_LEFT = 1e-10


def truncated_frame(
    structure: Structure,
    area: Array,
    batten_mass: Array,
    mirror_mass: float,
    ports: Sequence[str],
    count: int,
    spring_stiffness: Array | None = None,
) -> ModalFrame:
    """The lowest modes and the residual flexibility of all others at the ports, by sparse factorizations.

    Each port adds the shape that a load there has beside the modes kept, as residual vectors of a finite-element
    program do [Dickens1997]: receptances between the ports are exact at rest, and right to second order in ω²/Λ below
    the frequency √Λ of the next mode. Cost is linear in the members for a given number of modes.

    Assumes that of `modal_frame`.

    Parameters
    ----------
    ports
        Where the structure is loaded and measured; the first is the mirror's, which alone moves in one mode of
        a repeated frequency.
    count
        Of modes kept, the lowest; a repeated frequency is kept as a whole.

    Raises
    ------
    ModelError
        For a mechanism, a degree of freedom without mass, or a choice of modes that cannot be had.
    """
    if spring_stiffness is None:
        spring_stiffness = structure.spring_stiffness
    refuse_negative(area, batten_mass, spring_stiffness, mirror_mass)
    weights = stiffness_weights(structure, area, spring_stiffness)
    masses = mass_weights(structure, area, batten_mass, mirror_mass)
    pencil = sparse_pencil(structure, weights, masses)
    guards = _GUARDS + count // _GUARD_SHARE
    if count < 1 or count + guards >= len(structure.dofs):
        raise ModelError(
            f"modes: {count} of {len(structure.dofs)} are no truncation; keep at least one and fewer, or all"
        )
    eigenvalue, shapes = lowest_modes(pencil, count + guards)
    while eigenvalue[count] - eigenvalue[count - 1] <= _TOGETHER * eigenvalue[count]:
        count += 1
    exact = turn_repeated(eigenvalue[:count], shapes[:, :count], structure.port(ports[0]))
    guards_found = eigenvalue[count:], shapes[:, count:]
    return _with_residual(structure, pencil, ports, (eigenvalue[:count], exact), guards_found)


def modes_below(
    structure: Structure, area: Array, batten_mass: Array, mirror_mass: float, frequency: float
) -> int:
    """Number of modes below a frequency [rad/s], by one sparse factorization."""
    weights = stiffness_weights(structure, area), mass_weights(structure, area, batten_mass, mirror_mass)
    return sparse_pencil(structure, *weights).count_below(frequency**2)


def _with_residual(
    structure: Structure,
    pencil: SparsePencil,
    ports: Sequence[str],
    kept: tuple[Array, Array],
    guards: tuple[Array, Array],
) -> ModalFrame:
    eigenvalue, modes = kept
    loads = np.array([structure.port(name) for name in ports]).T
    everything = np.hstack([modes, guards[1]])
    reached, beyond = reached_shapes(pencil, everything, loads, float(eigenvalue[-1]))
    theta, outside = np.concatenate([guards[0], reached]), np.hstack([guards[1], beyond])

    elastic = eigenvalue > 0
    carried = (modes[:, elastic].T @ loads) / eigenvalue[elastic, None]
    whole = pencil.flexibility(loads)
    left = loads - pencil.mass @ (modes @ (modes.T @ loads))
    static = pencil.flexibility(left)
    # The elastic inverse has rounding along the lowest modes of a long truss.
    static -= modes @ (modes.T @ (pencil.mass @ static))
    flexibility = static.T @ loads
    flexibility = (flexibility + flexibility.T) / 2
    size = np.sqrt(np.maximum(np.einsum("np,np->p", whole, loads), 0.0))
    unit = np.where(size > 0, size, 1.0)
    value, turn = linalg.eigh(flexibility / np.outer(unit, unit))
    independent = value > _NONE_LEFT
    turn = turn[:, independent] / unit[:, None]
    velocity, elongation = pencil.mass_rows @ (static @ turn), pencil.stiffness_rows @ (static @ turn)
    above, last = (
        linalg.eigh(elongation.T @ elongation, velocity.T @ velocity)
        if turn.size
        else (np.zeros(0), np.eye(0))
    )
    residual = turn @ last
    shapes = np.hstack([modes, static @ residual])
    impulse = pencil.mass_factors.solve(loads[:, 0])
    b, d = structure.stiffness_rows, structure.mass_rows
    carried_all = np.zeros((eigenvalue.size, residual.shape[1]))
    carried_all[elastic] = carried @ residual
    left_out = Outside(
        eigenvalue=theta,
        shapes=outside,
        ports=tuple(ports),
        loads=loads,
        motion=outside.T @ loads,
        residual=residual,
        overlap=outside.T @ (pencil.mass @ shapes[:, eigenvalue.size :]),
        carried=carried_all,
        static_shapes=whole,
        residual_flexibility=flexibility,
        next_eigenvalue=float(guards[0][0]),
        impulse_shapes=d @ impulse,
        mobility=float(loads[:, 0] @ impulse),
    )
    return ModalFrame(
        structure, np.concatenate([eigenvalue, above]), shapes, b @ shapes, d @ shapes, left_out
    )
