"""Structural flexibility types: where the zero of a flexible mode lies beside its pole.

A transfer function cut down to what the actuator itself does and one flexible mode k has a single zero beside its two
pairs of poles. For an external load the first is rigid-body motion, φ_a = 1/J at ω_a = 0; for a reaction actuator it
is the mode a that the actuator dominates. One formula serves both:

    [(φ_a + φ_k) s² + 2(φ_a ζ_k ω_k + φ_k ζ_a ω_a) s + φ_a ω_k² + φ_k ω_a²] over the poles.

Types follow from the undamped zero Ω_k. It is that of the two modes alone, not the exact one of the whole model.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror, Placement
from fosopt.errors import ModelError
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray
from fosopt.plant import ModalExpansion, modal_expansion, quadratic_roots

# Residues that should cancel do so to this share of the larger one.
_CANCELLED = 64 * np.finfo(float).eps


class FlexibilityType(StrEnum):
    """Type of a flexible mode by its participation α_k = ω_k²/Ω_k².    [Spanos1989], [Barker1991] Sec. 3.2

    The two degenerate types stand at the limits: a cancelled mode (α = 1) has its zero at its pole, a degenerate
    in-the-loop one (α = 0) has it at infinity, or with damping far out on the negative real axis, as the far mass of
    two masses on a spring.    [Barker1991] Eq. (3.18)
    """

    APPENDAGE = "appendage"
    IN_THE_LOOP_MINIMUM_PHASE = "in-the-loop minimum phase"
    IN_THE_LOOP_NONMINIMUM_PHASE = "in-the-loop nonminimum phase"
    CANCELLED = "cancelled"
    DEGENERATE = "degenerate in-the-loop minimum phase"


class Collocation(StrEnum):
    """How sensor, action, reaction and reference stand to each other.    [Barker1991] Sec. 3.2, Fig. 3.2"""

    BICOLLOCATED = "bicollocated"
    COLLOCATED = "collocated"
    NON_COLLOCATED = "non-collocated"


@dataclass(frozen=True)
class PoleZeroPattern:
    """One of the pole-zero patterns of a reaction actuator and a flexible mode.    [Barker1991] Fig. 3.3

    Attributes
    ----------
    case
        By the ratio φ_a/(φ_a + φ_k): I between zero and one, II above one, III below zero; None on a border, where
        a mode is cancelled or the zero is at infinity.
    type
        Of the flexible mode.
    order
        ``actuator``, ``mode`` and ``zero`` in ascending frequency, equal ones in this order. A zero off the
        imaginary axis or at infinity is left out.
    """

    case: Literal["I", "II", "III"] | None
    type: FlexibilityType
    order: tuple[str, ...]


def collocation(placement: Placement) -> Collocation:
    """Collocated when the torque acts where the sensor is, bicollocated when it also reacts where the spring refers to.

    Bicollocation with the action on the mirror makes all residues positive and all zeros minimum phase. With sensor
    and action together on the structure the words hold as well, the guarantee does not.    [Barker1991] Sec. 3.2
    """
    if placement.bicollocated:
        return Collocation.BICOLLOCATED
    return Collocation.COLLOCATED if placement.collocated else Collocation.NON_COLLOCATED


def flexibility_type(participation: Array) -> NDArray[np.str_]:
    """(n,) Type by α_k, as strings that equal the members of `FlexibilityType`.    [Barker1991] Sec. 3.2"""
    return np.select(
        [participation > 1, participation == 1, participation > 0, participation == 0],
        [
            FlexibilityType.APPENDAGE.value,
            FlexibilityType.CANCELLED.value,
            FlexibilityType.IN_THE_LOOP_MINIMUM_PHASE.value,
            FlexibilityType.DEGENERATE.value,
        ],
        FlexibilityType.IN_THE_LOOP_NONMINIMUM_PHASE.value,
    )


@dataclass(frozen=True)
class SingleModeExpansions:
    """What an actuator itself does, with each of (m,) flexible modes in turn.    [Barker1991] Eqs. (3.3), (3.10)

    Attributes
    ----------
    mode
        (m,) index of each flexible mode in the expansion it is from.
    natural_frequency, damping_ratio, residue
        (m,) ω_k [rad/s], ζ_k [-] and φ_k [1/(kg m²)].
    actuator
        Index of the mode the actuator dominates, None for rigid-body motion.
    actuator_frequency, actuator_damping_ratio, actuator_residue
        ω_a, ζ_a and φ_a; zero, zero and 1/J for rigid-body motion.
    """

    mode: NDArray[np.intp]
    natural_frequency: Array
    damping_ratio: Array
    residue: Array
    actuator: int | None
    actuator_frequency: float
    actuator_damping_ratio: float
    actuator_residue: float

    @property
    def _total(self) -> Array:
        total = self.actuator_residue + self.residue
        larger = np.maximum(abs(self.actuator_residue), np.abs(self.residue))
        return np.where(np.abs(total) <= _CANCELLED * larger, 0.0, total)

    @property
    def _static(self) -> Array:
        return self.actuator_residue * self.natural_frequency**2 + self.residue * self.actuator_frequency**2

    @property
    def ratio(self) -> Array:
        """(m,) φ_a/(φ_a + φ_k), infinite where the sum vanishes [-].    [Barker1991] Eqs. (3.13), (3.14)"""
        with np.errstate(divide="ignore"):
            return self.actuator_residue / self._total

    @property
    def zero_squared(self) -> Array:
        """(m,) Ω_k², negative for a real pair, infinite for none [rad²/s²].    [Barker1991] Eqs. (3.12), (3.13)"""
        with np.errstate(divide="ignore"):
            return self._static / self._total

    @property
    def participation(self) -> Array:
        """(m,) α_k = ω_k²/Ω_k², 1 + J φ_ik φ_jk for rigid-body control [-].    [Barker1991] Eqs. (3.4), (3.5)"""
        with np.errstate(divide="ignore"):
            return self._total * self.natural_frequency**2 / self._static

    @property
    def types(self) -> NDArray[np.str_]:
        """(m,) `FlexibilityType` of each mode."""
        return flexibility_type(self.participation)

    @property
    def zeros(self) -> ComplexArray:
        """(m, 2) Both zeros of each numerator with its damping, infinite for none [rad/s].

        Damping can move the zeros of a mode whose residue has another sign than the actuator's into the right half
        plane although the type is one of minimum phase.    [Barker1991] Eqs. (3.4), (3.11)
        """
        linear = self.actuator_residue * self.damping_ratio * self.natural_frequency
        linear = linear + self.residue * self.actuator_damping_ratio * self.actuator_frequency
        return quadratic_roots(self._total, 2 * linear, self._static)

    @property
    def patterns(self) -> tuple[PoleZeroPattern, ...]:
        """Pattern of each mode.    [Barker1991] Fig. 3.3"""
        rows = zip(self.ratio, self.zero_squared, self.natural_frequency, self.types, strict=True)
        return tuple(
            _pattern(ratio, zero, w, self.actuator_frequency, str(kind)) for ratio, zero, w, kind in rows
        )


def _pattern(ratio: float, zero: float, mode: float, actuator: float, kind: str) -> PoleZeroPattern:
    case: Literal["I", "II", "III"] | None = None
    if 0 < ratio < 1:
        case = "I"
    elif 1 < ratio < np.inf:
        case = "II"
    elif -np.inf < ratio < 0:
        case = "III"
    marks = {"actuator": actuator**2, "mode": mode**2}
    if 0 <= zero < np.inf:
        marks["zero"] = zero
    return PoleZeroPattern(case, FlexibilityType(kind), tuple(sorted(marks, key=lambda name: marks[name])))


def rigid_body_inertia(expansion: ModalExpansion) -> float:
    """J = 1/Σ r_k over the rigid-body modes, infinite for an internal load [kg m²].    [Barker1991] Eqs. (3.2), (3.7)

    Negative where the sensor moves against the load.
    """
    total = float(expansion.residue[expansion.rigid].sum())
    return 1 / total if total else np.inf


def rigid_body_flexibility(expansion: ModalExpansion) -> SingleModeExpansions:
    """Rigid-body control: every flexible mode beside rigid-body motion.    [Barker1991] Eqs. (3.3)-(3.5), Fig. 3.1

    Assumes that a hub, if it holds the rigid-body mode, does so far below the flexible modes.

    Raises
    ------
    ModelError
        If the load does not move the structure as a rigid body.
    """
    inertia = rigid_body_inertia(expansion)
    if np.isinf(inertia):
        raise ModelError(
            "flexibility: the load moves no rigid-body mode that the sensor sees; use reaction_flexibility"
        )
    return _single_modes(expansion, np.flatnonzero(~expansion.rigid), None, (0.0, 0.0, 1 / inertia))


def reaction_flexibility(expansion: ModalExpansion, actuator: int | None = None) -> SingleModeExpansions:
    """Reaction-actuator control: every flexible mode beside the one the actuator dominates.

    [Barker1991] Eqs. (3.9)-(3.16), Fig. 3.3

    Parameters
    ----------
    expansion
        Of the coupled plant, see `plant.coupled_expansion`.
    actuator
        Index of mode a; by default the one with the largest residue, the most controllable and observable. Where no
        mode dominates, the distinction between actuator and structure is lost.

    Raises
    ------
    ModelError
        If that mode has no residue, or no frequency.
    """
    flexible = np.flatnonzero(expansion.natural_frequency > 0)
    if actuator is None and flexible.size:
        actuator = int(flexible[np.argmax(np.abs(expansion.residue[flexible]))])
    if actuator is None or actuator not in flexible or expansion.residue[actuator] == 0:
        raise ModelError(
            f"flexibility: mode {actuator} does not carry the actuator's motion; name one that does"
        )
    own = (
        float(expansion.natural_frequency[actuator]),
        float(expansion.damping_ratio[actuator]),
        float(expansion.residue[actuator]),
    )
    return _single_modes(expansion, flexible[flexible != actuator], actuator, own)


def _single_modes(
    expansion: ModalExpansion,
    mode: NDArray[np.intp],
    actuator: int | None,
    own: tuple[float, float, float],
) -> SingleModeExpansions:
    return SingleModeExpansions(
        mode,
        expansion.natural_frequency[mode],
        expansion.damping_ratio[mode],
        expansion.residue[mode],
        actuator,
        *own,
    )


def nonminimum_phase_excess(
    modes: ModalSet, mirror: Mirror, mirror_port: str, reaction: str
) -> tuple[Array, Array]:
    """By how much each mode alone fails to keep the zeros of a non-bicollocated mirror in the left half plane.

    With one mode of the structure the zeros are the roots of s² − b s − a,

        a = k_m (1/J̃_rh − 1/J̃_rr) − ω̃_k²,    b = c_m (1/J̃_rh − 1/J̃_rr) − 2ζ̃_k ω̃_k.

    The dissertation's condition is a > 0: one real zero in the right half plane, √a without damping, where it is
    necessary as well as sufficient. With damping b > 0 suffices too, for a complex pair, and comes first as the mirror
    grows in every mode above ω_m ζ̃_k/ζ_m. All this holds for the single-mode expansion. With all modes in the sum
    zeros may lie in the right half plane though no mode fulfills a condition, and none though the first does;
    `plant.mirror_zeros` tells.
    [Barker1991] Eqs. (4.23), (4.24), (4.27)

    Returns
    -------
    (n,), (n,)
        a [rad²/s²] and b [rad/s].
    """
    apart = -modal_expansion(modes, mirror_port, mirror_port, reaction).residue
    return mirror.stiffness * apart - modes.stiffness, mirror.damping * apart - modes.damping
