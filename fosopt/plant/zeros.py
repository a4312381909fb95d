"""Zeros of transfer functions: of modal expansions, of a reaction mirror, and of the coupled plant in any placement.

All functions return every zero, both conjugates of a pair, in ascending size. Without any damping the zeros are found
in λ = −s²: a positive λ is a pair on the imaginary axis, whose real part is then zero exactly, a negative one a pair
on the real axis, and a complex pair of λ four zeros of s, two of them in the right half plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror, Placement
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray
from fosopt.plant.expansion import ModalExpansion
from fosopt.plant.interlacing import falling_roots
from fosopt.plant.matrices import CoupledMatrices, coupled_matrices
from fosopt.plant.pencil import finite_zeros

# A pair of λ closer to the real axis than this share is real and double but for rounding.
_DOUBLE = 1e-7
# A real part below this share of a zero is rounding.
_ON_AXIS = 1e-14


def quadratic_roots(a: Array, b: Array, c: Array) -> ComplexArray:
    """Both roots of a s² + b s + c for each of (n,) triples of real coefficients, without cancellation.

    Returns
    -------
    (n, 2)
        A conjugate pair, the upper one first, or two real roots; infinite where a leading coefficient is zero.
    """
    a, b, c = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (a, b, c)))
    half = 0.5 * b
    inside = half**2 - a * c
    root = np.sqrt(np.abs(inside))
    with np.errstate(divide="ignore", invalid="ignore"):
        # Adding 0.0 turns the real part −0.0 of a root without damping into 0.0.
        center, apart = -half / a + 0.0, root / np.abs(a)
        larger = -(half + np.where(half < 0, -root, root))
        first, second = larger / a, c / larger
        first = np.where(a == 0, np.inf, first)
        second = np.where(larger == 0, np.where(a == 0, np.inf, 0.0), second)
    pair = inside < 0
    upper = np.where(pair, center, first) + 1j * np.where(pair, apart, 0.0)
    lower = np.where(pair, center, second) - 1j * np.where(pair, apart, 0.0)
    return np.stack([upper, lower], axis=-1)


def modal_poles(modes: ModalSet | ModalExpansion) -> ComplexArray:
    """(2n,) Roots of s² + 2ζ_k ω_k s + ω_k², ascending in size [rad/s]."""
    return _ordered(
        quadratic_roots(np.ones(modes.natural_frequency.size), modes.damping, modes.stiffness).ravel()
    )


def expansion_zeros(expansion: ModalExpansion) -> ComplexArray:
    """Zeros of Σ r_k/(s² + 2ζ_k ω_k s + ω_k²) for residues of any sign, rigid-body modes included.

    Residues of one sign without damping, the case of a collocated pair, have exactly one zero between any two poles,
    found with full relative accuracy [Golub1973]. A mode without residue, and all but one of modes that share their
    poles, keep their poles as zeros, so that poles and zeros of the whole set cancel as they should. Zeros at infinity
    are left out.    [Barker1991] Eqs. (3.1), (3.6)

    Returns
    -------
    (m,)
        2n − 2 or fewer for n modes [rad/s].

    Raises
    ------
    ModelError
        If no mode has a residue, or the residues cancel at every frequency.
    SolverError
        If a zero does not satisfy its equation.
    """
    stiffness, damping, residue, cancelled = _distinct(expansion)
    apart = _ordered(quadratic_roots(np.ones(cancelled.shape[0]), cancelled[:, 1], cancelled[:, 0]).ravel())
    undamped = not damping.any()
    if undamped and (np.all(residue > 0) or np.all(residue < 0)) and residue.size:
        found = _from_squares(_interlaced(stiffness, np.abs(residue)).astype(complex))
    else:
        load, output = np.sign(residue) * np.sqrt(np.abs(residue)), np.sqrt(np.abs(residue))
        found = _zeros(np.diag(stiffness), np.diag(damping), np.eye(residue.size), load, output)
    return _ordered(np.concatenate([found, apart]))


def mirror_zeros(
    modes: ModalSet, mirror: Mirror, mirror_port: str, reaction: str | None = None
) -> ComplexArray:
    """Zeros of the mirror's inertial angle per mirror torque.    [Barker1991] Eqs. (4.19)-(4.22)

    A bicollocated mirror has the poles of the structure without it, exactly, whatever its inertia. One that reacts
    elsewhere than its spring has the zeros of 1 + κ(s)(g_rr − g_rh), κ = c_m s + k_m: the poles of the structure on
    which a still mirror's spring and damper, moved by port r, push on port h what they pull from port r. Without
    damping, φ_rk (φ_rk − φ_hk) of one sign over all modes leaves them on the two axes, a real pair appearing when the
    static 1 + k_m (g_rr − g_rh) falls below zero; with both signs there may be quadruples.

    Parameters
    ----------
    mirror_port, reaction
        Reference port r, and port h if it differs.

    Returns
    -------
    (2n,)
        For n modes [rad/s].

    Raises
    ------
    SolverError
        If a zero does not satisfy its equation.
    """
    if reaction is None or reaction == mirror_port:
        return modal_poles(modes)
    structure = (np.eye(modes.natural_frequency.size), np.diag(modes.damping), np.diag(modes.stiffness))
    rows = {port: modes.at(port) for port in (mirror_port, reaction)}
    return plant_zeros(coupled_matrices(structure, rows, mirror_port, mirror, Placement(reaction)))


def plant_zeros(coupled: CoupledMatrices) -> ComplexArray:
    """Zeros of sensed motion per control torque, wherever the loop acts, reacts and senses.

    They are the zeros of the sensor's response with every attachment in place, poles that no torque excites or no
    sensor sees included. Zeros at infinity are left out.    [Barker1991] Eqs. (3.6), (4.22)

    Returns
    -------
    (m,)
        2n − 2 or fewer for n degrees of freedom [rad/s].

    Raises
    ------
    ModelError
        If the sensor does not respond to the control torque.
    SolverError
        If a zero does not satisfy its equation.
    """
    return _ordered(_zeros(coupled.stiffness, coupled.damping, coupled.mass, coupled.control, coupled.sensor))


def _zeros(stiffness: Array, damping: Array, mass: Array, load: Array, output: Array) -> ComplexArray:
    if not damping.any():
        return _from_squares(finite_zeros((stiffness, -mass), load, output))
    s = finite_zeros((stiffness, damping, mass), load, output)
    return np.where(np.abs(s.real) <= _ON_AXIS * np.abs(s), 0.0, s.real) + 1j * s.imag


def _distinct(expansion: ModalExpansion) -> tuple[Array, Array, Array, Array]:
    """Stiffness, damping and residue of modes with poles of their own, and (k, 2) of what cancels."""
    table = np.column_stack([expansion.stiffness, expansion.damping])
    seen = expansion.residue != 0
    unique, place = np.unique(table[seen], axis=0, return_inverse=True)
    residue = np.bincount(place.ravel(), weights=expansion.residue[seen], minlength=unique.shape[0])
    repeated = np.repeat(unique, np.bincount(place.ravel(), minlength=unique.shape[0]) - 1, axis=0)
    alive = residue != 0
    cancelled = np.concatenate([table[~seen], repeated, unique[~alive]])
    return unique[alive, 0], unique[alive, 1], residue[alive], cancelled


def _interlaced(poles: Array, weight: Array) -> Array:
    """(n−1,) The root λ of Σ weight/(pole − λ) between each two of (n,) ascending poles."""

    def terms(base: Array, distance: Array, own: NDArray[np.intp]) -> tuple[Array, Array, Array, Array]:
        """The negative sum, which falls, in parts."""
        gap = (poles[None, :] - base[:, None]) - distance[:, None]
        rows = np.flatnonzero(own >= 0)
        gap[rows, own[rows]] = np.inf
        strength = np.zeros(base.size)
        strength[rows] = weight[own[rows]]
        return -(weight / gap).sum(axis=1), -(weight / gap**2).sum(axis=1), strength, np.zeros(base.size)

    count = poles.size - 1
    base, distance = falling_roots(poles[:-1], poles[1:], np.arange(count), np.arange(1, count + 1), terms)
    return base + distance


def _from_squares(square: ComplexArray) -> ComplexArray:
    """(2m,) s = ±√(−λ) of (m,) λ."""
    near = np.abs(square.imag) <= _DOUBLE * np.abs(square)
    square = np.where(near, square.real, square)
    root = np.sqrt(np.abs(square.real))
    on_axis = np.where(square.real >= 0, 1j * root, root)
    s = np.where(square.imag == 0, on_axis, np.sqrt(-square))
    # Adding zero leaves no minus zero.
    return np.concatenate([s, -s]) + 0j


def _ordered(s: ComplexArray) -> ComplexArray:
    return s[np.lexsort((s.imag, s.real, np.abs(s)))]
