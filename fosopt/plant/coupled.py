"""The coupled plant: natural modes of mirror and structure together, as roots of a secular equation.

A mirror on a spring adds one degree of freedom and one rank-one term to the diagonal modal stiffness. With
λ = −s² the undamped characteristic function over J_m is

    F(λ) = ω_m² − λ (1 + k_m g(λ)),    g(λ) = Σ_j φ_hj²/(λ̃_j − λ),

which falls monotonically from pole to pole, so that each interval between two uncoupled modes holds exactly one
coupled mode. Roots are kept as uncoupled eigenvalue plus distance, which makes 1 − β_k right to the last digits
however small it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror
from fosopt.modes import ModalSet
from fosopt.ops import Array
from fosopt.plant.expansion import coupled_expansion
from fosopt.plant.interlacing import falling_roots
from fosopt.plant.matrices import CoupledMatrices

_TUNED = 1e-9
SAME = 1e-13
"""Eigenvalues this close (relative) are one."""


def secular_slope(stiffness: Any, eigenvalue: Any, g: Any, g_slope: Any) -> Any:
    """dF/dλ = −(1 + k_m g) − λ k_m dg/dλ; −1 over it is J̄_k.    [Barker1991] Eqs. (4.7), (4.10)"""
    return -(1 + stiffness * g) - eigenvalue * stiffness * g_slope


def secular(stiffness: Any, constant: Any, base: Any, distance: Any, g: Any) -> Any:
    """F(λ) = ω_m² − λ (1 + k_m g) at λ = base + distance, zero at a coupled mode.

    Subtracted in this order, a mirror tuned to an uncoupled mode keeps the digits of its distance.
    [Barker1991] Eq. (4.18), [Golub1973]

    Parameters
    ----------
    constant
        ω_m², and k_m φ² of a free rigid body, whose part of −λ k_m g is constant [rad²/s²].
    g
        The rest of Σ φ²/(λ̃ − λ).
    """
    return ((constant - base) - distance) - (base + distance) * stiffness * g


def mirror_mode_index(poles: Array, natural_frequency: Any) -> Any:
    """How many uncoupled eigenvalues count as below the mirror's: the place of its mode among those it moves.

    A mode tuned to the mirror counts as one below it, as in the dissertation's case 2 (table 3.3).
    """
    return np.searchsorted(poles, np.square(natural_frequency) * (1 + _TUNED), side="right")


@dataclass(frozen=True)
class CoupledModes:
    """Undamped modes of structure and mirror together, ascending.

    Attributes
    ----------
    base, distance
        (n+1,) eigenvalue = base + distance, base an uncoupled eigenvalue or zero [rad²/s²].
    effective_modal_reaction_inertia
        (n+1,) J̄_k = J_m/J_k, zero for rigid-body modes [-].
    zero
        (n+1,) the transfer function zero (uncoupled eigenvalue) each mode is paired with, NaN for the mirror
        mode [rad²/s²].
    separation
        (n+1,) β_k² − 1, with full relative accuracy, NaN for the mirror mode [-].
    mirror_mode
        Index of the mirror mode.
    """

    base: Array
    distance: Array
    effective_modal_reaction_inertia: Array
    zero: Array
    separation: Array
    mirror_mode: int

    @property
    def eigenvalue(self) -> Array:
        """(n+1,) ω_k² [rad²/s²]."""
        return self.base + self.distance

    @property
    def natural_frequency(self) -> Array:
        """(n+1,) ω_k [rad/s]."""
        return np.sqrt(self.eigenvalue)

    @property
    def participation(self) -> Array:
        """(n+1,) α_k = β_k² [-].    [Barker1991] Eq. (3.5)"""
        return 1 + self.separation

    @property
    def pole_zero_separation(self) -> Array:
        """(n+1,) β_k = ω_k/Ω_k, one for a cancelled pair [-].    [Barker1991] Eq. (2.55)"""
        return np.sqrt(self.participation)

    @property
    def one_minus_separation(self) -> Array:
        """(n+1,) 1 − β_k without cancellation [-]."""
        return -self.separation / (1 + self.pole_zero_separation)


def modes_of_matrices(coupled: CoupledMatrices, mirror: Mirror) -> CoupledModes:
    """Undamped modes of any placement and any actuators, by the dense eigenvalue problem.

    J̄_k = J_m φ_jk (φ_ik − φ_hk) may have either sign where the loop is not bicollocated, and a mode has no zero
    of its own to be paired with.    [Barker1991] Eqs. (4.6), (4.7)
    """
    modes = coupled_expansion(coupled)
    reaction = mirror.inertia * modes.residue
    none = np.full(reaction.size, np.nan)
    own = int(np.argmax(np.abs(reaction)))
    return CoupledModes(modes.stiffness, np.zeros(reaction.size), reaction, none, none, own)


def coupled_modes(modes: ModalSet, mirror: Mirror, mirror_port: str) -> CoupledModes:
    """All coupled modes by the secular equation.    [Barker1991] Eqs. (4.10), (4.20)

    Raises
    ------
    SolverError
        If a root does not settle in its interval.
    """
    uncoupled, shape2 = seen_by_mirror(modes, mirror_port)
    moved = (shape2 > 0) & (uncoupled > 0)
    base, distance, reaction = _roots(mirror, uncoupled, shape2, moved)
    poles = uncoupled[moved]
    below = int(mirror_mode_index(poles, mirror.natural_frequency))
    zero = np.insert(poles, below, np.nan)
    same = base == zero
    separation = np.where(same, distance, base + distance - zero) / zero

    # Modes the mirror cannot move stay where they are: a node at the port, or a free rigid body.
    still = uncoupled[~moved]
    base = np.concatenate([base, still])
    distance = np.concatenate([distance, np.zeros(still.size)])
    position = np.argsort(base + distance, kind="stable")
    reaction, zero, separation = (
        np.concatenate(pair)[position]
        for pair in (
            (reaction, np.zeros(still.size)),
            (zero, np.where(still > 0, still, np.nan)),
            (separation, np.zeros(still.size)),
        )
    )
    mirror_mode = int(np.flatnonzero(position == below)[0])
    return CoupledModes(base[position], distance[position], reaction, zero, separation, mirror_mode)


def seen_by_mirror(modes: ModalSet, mirror_port: str) -> tuple[Array, Array]:
    """Uncoupled eigenvalues ascending [rad²/s²], and φ² at the mirror's port.

    Modes of one and the same eigenvalue act as one with the sum of their φ²; the others stand still there.
    """
    shape2, uncoupled = modes.at(mirror_port) ** 2, modes.stiffness
    order = np.argsort(uncoupled, kind="stable")
    uncoupled, shape2 = uncoupled[order], shape2[order]
    for i in np.flatnonzero((np.diff(uncoupled) <= SAME * uncoupled[1:]) & (uncoupled[1:] > 0)):
        shape2[i + 1] += shape2[i]
        shape2[i] = 0.0
    return uncoupled, shape2


def _roots(
    mirror: Mirror, uncoupled: Array, shape2: Array, moved: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """Base, distance and J̄ of the root in each interval between the poles of F."""
    k, wm2 = mirror.stiffness, mirror.natural_frequency**2
    poles, weight = uncoupled[moved], shape2[moved]
    # A free rigid body adds −λ k φ²/(0 − λ) = k φ², a constant.
    constant = wm2 + k * shape2[uncoupled == 0].sum()
    top = (poles[-1] if poles.size else 0.0) + 2 * (wm2 + k * (shape2.sum())) + 1.0
    low, high = np.concatenate([[0.0], poles]), np.concatenate([poles, [top]])

    def terms(base: Array, distance: Array, own: NDArray[np.intp]) -> tuple[Array, Array, Array, Array]:
        """F without its own pole term λ k φ²/(λ − λ̃), that numerator, and the slopes of both."""
        gap = (poles[None, :] - base[:, None]) - distance[:, None]
        rows = np.flatnonzero(own >= 0)
        gap[rows, own[rows]] = np.inf
        eigenvalue = base + distance
        g = (weight / gap).sum(axis=1)
        slope = (weight / gap**2).sum(axis=1)
        rest = secular(k, constant, base, distance, g)
        rest_slope = secular_slope(k, eigenvalue, g, slope)
        strength = np.zeros(base.size)
        strength[rows] = k * weight[own[rows]]
        return rest, rest_slope, eigenvalue * strength, strength

    count = poles.size
    low_pole, high_pole = np.arange(-1, count), np.append(np.arange(count), -1)
    base, distance = falling_roots(low, high, low_pole, high_pole, terms)
    gap = (poles[None, :] - base[:, None]) - distance[:, None]
    g = (weight / gap).sum(axis=1) - shape2[uncoupled == 0].sum() / (base + distance)
    g_slope = (weight / gap**2).sum(axis=1) + shape2[uncoupled == 0].sum() / (base + distance) ** 2
    reaction = -1.0 / secular_slope(k, base + distance, g, g_slope)
    return base, distance, reaction
