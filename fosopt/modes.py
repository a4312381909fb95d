"""Modal sets: the hinge between any structure and everything that is attached to it.

A `ModalSet` holds natural frequencies, damping ratios and mass-normalized mode shapes at the ports; the plant,
the loop and the metrics need nothing else. A `ModalFrame` is the eigenbasis of a built-in structure at one
design; it also answers how receptances, frequencies and inertias change with the design, in the frozen modal
frame, where no difference of eigenvalues appears in a denominator and mode crossings do no harm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from fosopt.errors import ModelError
from fosopt.ops import Array, ComplexArray
from fosopt.structure import Structure, mass_matrix, stiffness_matrix

# A mode is rigid when its eigenvalue is at rounding level of the stiffest one.
_RIGID = 1e-12
# Modes closer than this (relative) are one eigenspace; its basis is free to choose.
_REPEATED = 1e-12


@dataclass(frozen=True)
class Damping:
    """Modal damping ratios of the elastic modes.

    Attributes
    ----------
    ratio
        One value for all modes, or one per elastic mode, the last one repeated for the modes beyond [-].
    frequency
        When given, `ratio` is a table over these ascending frequencies [rad/s], linear between them and
        constant outside.
    """

    ratio: tuple[float, ...]
    frequency: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for value in self.ratio:
            if not (np.isfinite(value) and value >= 0):
                raise ModelError(
                    f"damping ratio {value} is negative or not finite; give values of zero or above"
                )
        if not self.ratio:
            raise ModelError("damping: no ratio given; give at least one")
        if self.frequency is not None and (
            len(self.frequency) != len(self.ratio) or np.any(np.diff(self.frequency) <= 0)
        ):
            raise ModelError("damping table: frequencies must ascend, one ratio each")

    def of(self, frequency: Array) -> Array:
        """(n,) Damping ratio of each elastic mode, `frequency` ascending [rad/s]."""
        if self.frequency is not None:
            return np.interp(frequency, self.frequency, self.ratio)
        return np.array([self.ratio[min(k, len(self.ratio) - 1)] for k in range(frequency.size)])

    def slopes(self, frequency: Array, ratio: Array) -> Array:
        """(n, n) Divided differences (ζ_k − ζ_l)/(ω_k − ω_l) [s], the derivative on the diagonal.

        Ratios listed per mode are no function of frequency: where two such modes cross, jitter has a kink and
        these differences grow without limit.
        """
        if len(self.ratio) == 1:
            return np.zeros((frequency.size, frequency.size))
        apart = frequency[:, None] - frequency[None, :]
        same = np.abs(apart) <= 1e-9 * frequency[:, None]
        quotient = (ratio[:, None] - ratio[None, :]) / np.where(same, 1.0, apart)
        if self.frequency is None:
            return np.where(same, 0.0, quotient)
        step = 1e-7 * frequency
        local = (self.of(frequency + step) - self.of(frequency - step)) / np.where(step > 0, 2 * step, 1.0)
        return np.where(same, local[:, None], quotient)


@dataclass(frozen=True)
class Hub:
    """How the hub is held.

    ``free`` and ``fixed`` follow from the supports. ``held`` gives the rigid-body mode the natural frequency
    `bandwidth` [rad/s] and `damping_ratio` [-] of a slow attitude loop.

    Assumes the attitude loop is rolled off below the first elastic mode, so that it acts on the rigid-body
    mode alone and neither moves nor damps an elastic one.
    """

    type: Literal["free", "fixed", "held"] = "free"
    bandwidth: float = 0.0
    damping_ratio: float = 0.0


@dataclass(frozen=True)
class ModalSet:
    """Modes at the ports.

    Attributes
    ----------
    natural_frequency
        (n,) ascending, zero for a free rigid-body mode [rad/s].
    damping_ratio
        (n,) [-].
    mode_shape
        (n, p) mass-normalized, one column per port.
    ports
        (p,) port names.
    rigid
        (n,) true for rigid-body modes, free or held.
    """

    natural_frequency: Array
    damping_ratio: Array
    mode_shape: Array
    ports: tuple[str, ...]
    rigid: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for what in ("natural_frequency", "damping_ratio"):
            values = getattr(self, what)
            if not np.all(np.isfinite(values)) or np.any(values < 0):
                raise ModelError(
                    f"modal set: {what} holds {values.min()}; every value must be finite and not negative"
                )
        n = self.natural_frequency.size
        if self.mode_shape.shape != (n, len(self.ports)):
            raise ModelError(
                f"modal set: mode_shape has shape {self.mode_shape.shape}; expected {(n, len(self.ports))}, "
                "one row per mode and one column per port"
            )

    @property
    def stiffness(self) -> Array:
        """(n,) ω_k² [rad²/s²]."""
        return self.natural_frequency**2

    @property
    def damping(self) -> Array:
        """(n,) 2 ζ_k ω_k [rad/s]."""
        return 2 * self.damping_ratio * self.natural_frequency

    def at(self, port: str) -> Array:
        """(n,) Mode shapes at a port."""
        return self.mode_shape[:, self.ports.index(port)]

    def receptance(self, s: ComplexArray, port: str, other: str) -> ComplexArray:
        """Receptance Σ φ_pk φ_qk / (s² + 2ζ_k ω_k s + ω_k²) between two ports.    [Barker1991] Eq. (3.1)

        Returns
        -------
        (m,)
            One value per Laplace variable `s` (m,), [rad/(N m)] between rotations.
        """
        denominator = s[:, None] ** 2 + self.damping * s[:, None] + self.stiffness
        return np.sum(self.at(port) * self.at(other) / denominator, axis=1)

    def keep(self, chosen: Sequence[int] | NDArray[np.intp] | slice) -> ModalSet:
        """Modal truncation to the chosen modes (indices from zero).    [Barker1991] Sec. 2.3"""
        return ModalSet(
            self.natural_frequency[chosen],
            self.damping_ratio[chosen],
            self.mode_shape[chosen],
            self.ports,
            self.rigid[chosen],
        )


@dataclass(frozen=True)
class ModalFrame:
    """Eigenbasis of a structure at one design.

    Attributes
    ----------
    structure
        What was solved.
    eigenvalue
        (n,) elastic ω_k², zero for a rigid-body mode [rad²/s²].
    shapes
        (n_dof, n) mass-normalized mode shapes.
    stiffness_shapes, mass_shapes
        (k, n) and (m, n), the same seen by the rows of stiffness and mass.
    """

    structure: Structure
    eigenvalue: Array
    shapes: Array
    stiffness_shapes: Array
    mass_shapes: Array

    @property
    def n_rigid(self) -> int:
        """Number of rigid-body modes, which come first."""
        return int(np.count_nonzero(self.eigenvalue == 0.0))

    def modal_set(self, hub: Hub, damping: Damping, ports: Sequence[str]) -> ModalSet:
        """Modal set at the named ports under a damping model and a hub.

        Raises
        ------
        ModelError
            If the hub contradicts the supports.
        """
        rigid = self.eigenvalue == 0.0
        if hub.type == "fixed" and self.n_rigid:
            raise ModelError(
                "hub: type 'fixed', but the supports let the structure rotate; use 'free' or 'held', or hold the hub"
            )
        if hub.type == "held" and self.n_rigid != 1:
            raise ModelError(
                f"hub: type 'held' needs one rigid-body mode, the supports leave {self.n_rigid}; use 'fixed'"
            )
        frequency = np.sqrt(self.eigenvalue)
        ratio = np.zeros_like(frequency)
        ratio[~rigid] = damping.of(frequency[~rigid])
        if hub.type == "held":
            frequency = np.where(rigid, hub.bandwidth, frequency)
            ratio = np.where(rigid, hub.damping_ratio, ratio)
        rows = np.array([self.structure.port(name) for name in ports])
        return ModalSet(frequency, ratio, (rows @ self.shapes).T, tuple(ports), rigid)

    def eigenvalue_gradient(self, mode: int) -> tuple[Array, Array]:
        """Derivative of ω_k² for the stiffness (k,) and mass (m,) weights.    [Fox1968]

        Assumes the eigenvalue is simple; at a crossing it is that of the mode the solver returned.
        """
        return self.stiffness_shapes[:, mode] ** 2, -self.eigenvalue[mode] * self.mass_shapes[:, mode] ** 2

    def contract(self, stiffness: Array, mass: Array) -> tuple[Array, Array]:
        """Gradient for the row weights of a functional d = ⟨stiffness, dK⟩ + ⟨mass, dM⟩ in the modal frame.

        Parameters
        ----------
        stiffness, mass
            (n, n) coefficients.

        Returns
        -------
        (k,), (m,)
            Derivatives for the stiffness and mass weights.
        """
        b, d = self.stiffness_shapes, self.mass_shapes
        return np.einsum("ek,ek->e", b @ stiffness, b), np.einsum("ek,ek->e", d @ mass, d)


def modal_frame(
    structure: Structure, area: Array, batten_mass: Array, mirror_mass: float, rotation: str
) -> ModalFrame:
    """Solve K φ = ω² M φ for all modes at one design.    [Barker1991] Eq. (2.31)

    Rigid-body eigenvalues are set to zero exactly. In a repeated eigenspace the basis is turned so that one
    mode alone moves the port `rotation`: the others are exactly unobservable there.

    Raises
    ------
    ModelError
        If the structure is a mechanism: more than one motion without stiffness, or one that does not turn
        the hub.
    """
    k_rows, m_rows = structure.stiffness_rows, structure.mass_rows
    k = stiffness_matrix(structure, area)
    m = mass_matrix(structure, area, batten_mass, mirror_mass)
    try:
        eigenvalue, shapes = linalg.eigh(k, m, driver="gvd")
    except (linalg.LinAlgError, ValueError) as error:
        raise ModelError(
            f"modes cannot be computed: {error}; every degree of freedom needs mass above zero"
        ) from error
    rigid = eigenvalue <= _RIGID * eigenvalue[-1]
    if rigid.any():
        _refuse_mechanism(structure, shapes[:, rigid])
        eigenvalue = np.where(rigid, 0.0, eigenvalue)
    shapes = _turn_repeated(eigenvalue, shapes, structure.port(rotation))
    return ModalFrame(structure, eigenvalue, shapes, k_rows @ shapes, m_rows @ shapes)


def _refuse_mechanism(structure: Structure, shapes: Array) -> None:
    hub = structure.port("hub") @ shapes
    if shapes.shape[1] == 1 and np.abs(hub[0]) > 1e-6 * np.abs(shapes[:, 0]).max():
        return
    loosest = shapes[:, int(np.argmin(np.abs(hub)))]
    worst = structure.dofs[int(np.argmax(np.abs(loosest)))]
    raise ModelError(
        f"structure is a mechanism: {shapes.shape[1]} motion(s) without stiffness, the loosest at '{worst}'; "
        "only one rotation about the hub may be free: add bars or supports"
    )


def _turn_repeated(eigenvalue: Array, shapes: Array, row: Array) -> Array:
    gaps = np.diff(eigenvalue) > _REPEATED * eigenvalue[1:]
    edges = np.concatenate([[0], np.flatnonzero(gaps) + 1, [eigenvalue.size]])
    if edges.size == eigenvalue.size + 1:
        return shapes
    turned = shapes.copy()
    for first, last in pairwise(edges):
        size = last - first
        motion = row @ shapes[:, first:last]
        if size > 1 and np.any(motion):
            basis, _ = np.linalg.qr(np.column_stack([motion, np.eye(size)]))
            turned[:, first:last] = shapes[:, first:last] @ basis
    return turned


@dataclass(frozen=True)
class ImpedanceChange:
    """How modal damping and a held hub follow mass and stiffness, in the frozen modal frame.

    Modal damping C = M c(M⁻¹K) has dC_kl = Γ_kl dK_kl + Ψ_kl dM_kl with divided differences of c(λ) that stay
    finite where modes cross [Higham2008]; the stiffness of a held hub follows the mass alone.

    Attributes
    ----------
    damping_by_stiffness, damping_by_mass, hub_by_mass
        (n, n) Γ [s], Ψ [1/s], and that of the hub [1/s²].
    """

    damping_by_stiffness: Array
    damping_by_mass: Array
    hub_by_mass: Array


def impedance_change(eigenvalue: Array, modes: ModalSet, damping: Damping) -> ImpedanceChange:
    """Change of damping and hub stiffness with dK and dM for modes of the given elastic eigenvalues."""
    elastic = np.flatnonzero(~modes.rigid)
    by_stiffness, by_mass, hub = (np.zeros((eigenvalue.size, eigenvalue.size)) for _ in range(3))
    w, z = np.sqrt(eigenvalue[elastic]), modes.damping_ratio[elastic]
    mean = 0.5 * (z[:, None] + z) / (w[:, None] + w)
    slope = damping.slopes(w, z)
    block = np.ix_(elastic, elastic)
    by_stiffness[block] = 2 * mean + slope
    by_mass[block] = 2 * (w[:, None] * w) * (mean - slope / 2)
    for r in np.flatnonzero(modes.rigid):
        by_mass[r, :] = by_mass[:, r] = modes.damping[r]
        hub[r, :] = hub[:, r] = modes.stiffness[r]
    return ImpedanceChange(by_stiffness, by_mass, hub)


def receptance_functional(
    frame: ModalFrame,
    modes: ModalSet,
    damping: Damping,
    kept: NDArray[np.intp],
    s: ComplexArray,
    modal: ComplexArray,
    direct: ComplexArray,
    cross: ComplexArray,
    mirror_port: str,
) -> tuple[Array, Array]:
    """Gradient of Re Σ_i [a_i dg_hh(s_i) + b_i dg_h0(s_i)] for the row weights of stiffness and mass.

    With ψ_p = φ_p/(s² + c s + ω²), dg_pq = −ψ_pᵀ (s² dM + s dC + dK) ψ_q, and dC of `ImpedanceChange`.

    Parameters
    ----------
    modes
        All modes of the frame.
    kept
        Indices of the modes that make up g; the others enter through the change of the kept shapes.
    s, modal
        (m,) points and (m, r) modal receptances ψ/φ of the kept modes there.
    direct, cross
        (m,) coefficients a, b.

    Returns
    -------
    (k,), (m,)
        Derivatives for the stiffness and mass weights.
    """
    inside = modes if kept.size == modes.rigid.size else modes.keep(kept)
    h, o = inside.at(mirror_port), inside.at("hub")
    left = modal * h
    right = direct[:, None] * left + cross[:, None] * (modal * o)
    first = right * s[:, None]
    powers = [_real_product(left, right), _real_product(left, first), _real_product(left, first * s[:, None])]
    lam = frame.eigenvalue[kept]
    change = impedance_change(frame.eigenvalue[kept], inside, damping)
    in_stiffness = -(powers[0] + change.damping_by_stiffness * powers[1])
    in_mass = -(powers[2] + change.damping_by_mass * powers[1] + change.hub_by_mass * powers[0])
    if kept.size == frame.eigenvalue.size:
        return frame.contract(in_stiffness, in_mass)

    # The kept shapes also turn toward the modes left out: dφ_k = Σ_j φ_j (dK_jk − λ_k dM_jk)/(λ_k − λ_j).
    out = np.setdiff1d(np.arange(frame.eigenvalue.size), kept)
    by_h = np.real((2 * direct[:, None] * modal * h + cross[:, None] * modal * o).sum(axis=0))
    by_o = np.real((cross[:, None] * modal * h).sum(axis=0))
    shapes_h, shapes_o = modes.at(mirror_port)[out], modes.at("hub")[out]
    turn = (by_h[:, None] * shapes_h + by_o[:, None] * shapes_o) / (lam[:, None] - frame.eigenvalue[out])
    n = frame.eigenvalue.size
    full_stiffness, full_mass = np.zeros((n, n)), np.zeros((n, n))
    full_stiffness[np.ix_(kept, kept)], full_mass[np.ix_(kept, kept)] = in_stiffness, in_mass
    full_stiffness[np.ix_(kept, out)] = turn
    full_mass[np.ix_(kept, out)] = -lam[:, None] * turn
    return frame.contract(full_stiffness, full_mass)


def _real_product(left: ComplexArray, right: ComplexArray) -> Array:
    """Re(leftᵀ right) as one real product."""
    a = np.concatenate([left.real, -left.imag])
    b = np.concatenate([right.real, right.imag])
    return a.T @ b


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
