"""The eigenbasis of a built-in structure at one design."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import linalg
from scipy.linalg import blas

from fosopt.errors import ModelError
from fosopt.modes.modal_set import Damping, Hub, ModalSet
from fosopt.modes.outside import Outside
from fosopt.ops import Array
from fosopt.structure import Structure, mass_matrix, stiffness_matrix

# A mode is rigid when its eigenvalue is at rounding level of the stiffest one.
_RIGID = 1e-12
# Modes closer than this (relative) are one eigenspace; its basis is free to choose.
_REPEATED = 1e-12
# The eigenvalue solver errs by this much of the largest eigenvalue.
_ROUNDING = 2e-15


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
    outside
        Of a truncated basis, whose last shapes are those of residual flexibility: what it leaves out.
    """

    structure: Structure
    eigenvalue: Array
    shapes: Array
    stiffness_shapes: Array
    mass_shapes: Array
    outside: Outside | None = None

    @property
    def n_exact(self) -> int:
        """Number of modes, without the shapes of residual flexibility."""
        return self.eigenvalue.size - (0 if self.outside is None else self.outside.residual.shape[1])

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

    def eigenvalue_gradient(self, mode: int | slice) -> tuple[Array, Array]:
        """Derivative of ω_k² for the stiffness (k,) and mass (m,) weights, a column per mode of a slice.    [Fox1968]

        Assumes the eigenvalue is simple; at a crossing it is that of the mode the solver returned.
        """
        return self.stiffness_shapes[:, mode] ** 2, -self.eigenvalue[mode] * self.mass_shapes[:, mode] ** 2

    def contract(
        self, stiffness: Array, mass: Array, motion: Mapping[str, Array] | None = None
    ) -> tuple[Array, Array]:
        """Gradient for the row weights of d = ⟨stiffness, dK⟩ + ⟨mass, dM⟩ + Σ_p ⟨u_p, dφ_p⟩ in the modal frame.

        All modes span whatever they may become, so that their frame stays as it is and u does not matter; a truncated
        basis follows the structure, see `Outside`.

        Parameters
        ----------
        stiffness, mass
            (n, n) coefficients.
        motion
            (n,) u of each port.

        Returns
        -------
        (k,), (m,)
            Derivatives for the stiffness and mass weights.
        """
        by_shapes = _by_half(self.shapes, stiffness), _by_half(self.shapes, mass)
        if self.outside is None:
            return self._summed(*by_shapes)
        rigid = self.shapes[:, 0] if self.n_rigid else np.zeros(self.shapes.shape[0])
        turning = self.outside.turning(self.eigenvalue, (stiffness, mass), motion or {})
        # Loads on a free structure are balanced by its rigid-body inertia, which the mass carries.
        balance = turning.static @ (self.outside.loads.T @ rigid)
        by_shapes[0][:, : self.n_exact] -= turning.modes
        by_shapes[1][:, : self.n_exact] += turning.modes * self.eigenvalue[: self.n_exact]
        by_shapes[1][:, 0] -= balance
        by_stiffness, by_mass = self._summed(*by_shapes)
        rows = self.structure.stiffness_rows
        return by_stiffness - _row_sums(rows @ turning.static, rows @ self.outside.static_shapes), by_mass

    def _summed(self, stiffness: Array, mass: Array) -> tuple[Array, Array]:
        """Products with the basis, both seen by the rows, of (n_dof, n) `stiffness` and `mass`."""
        of = self.structure
        return (
            _row_sums(of.stiffness_rows @ stiffness, self.stiffness_shapes),
            _row_sums(of.mass_rows @ mass, self.mass_shapes),
        )


def _by_half(shapes: Array, coefficients: Array) -> Array:
    """(n_dof, n) V for which Σ_k V_ak φ_bk, over pairs a, b alike, is that of φ times the coefficients.

    A quadratic form needs one triangle of them, which saves half of the product.
    """
    triangle = np.asfortranarray(coefficients + coefficients.T)
    triangle[np.diag_indices_from(triangle)] /= 2
    return np.asarray(blas.dtrmm(1.0, triangle, shapes, side=1, lower=1))


def _row_sums(left: Array, right: Array) -> Array:
    return np.einsum("ek,ek->e", left, right)


def modal_frame(
    structure: Structure,
    area: Array,
    batten_mass: Array,
    mirror_mass: float,
    rotation: str,
    spring_stiffness: Array | None = None,
) -> ModalFrame:
    """Solve K φ = ω² M φ for all modes at one design.    [Barker1991] Eq. (2.31)

    Rigid-body eigenvalues are set to zero exactly. In a repeated eigenspace the basis is turned so that one
    mode alone moves the port `rotation`: the others are exactly unobservable there.

    Parameters
    ----------
    spring_stiffness
        (s,) Of the springs to ground; by default those the structure was assembled with [N/m], [N m/rad].

    Raises
    ------
    ModelError
        If the structure is a mechanism: more than one motion without stiffness, or one that does not turn
        the hub.
    """
    k_rows, m_rows = structure.stiffness_rows, structure.mass_rows
    if spring_stiffness is None:
        spring_stiffness = structure.spring_stiffness
    refuse_negative(area, batten_mass, spring_stiffness, mirror_mass)
    k = stiffness_matrix(structure, area, spring_stiffness)
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
    shapes = turn_repeated(eigenvalue, shapes, structure.port(rotation))
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


def refuse_negative(area: Array, batten_mass: Array, spring_stiffness: Array, mirror_mass: float) -> None:
    """Refuse sizes that are below zero or not a number."""
    for what, values in (
        ("area", area),
        ("batten_mass", batten_mass),
        ("spring_stiffness", spring_stiffness),
        ("mirror_mass", np.atleast_1d(mirror_mass)),
    ):
        if not np.all(values >= 0):
            raise ModelError(f"{what}: {values.min():g} is negative or not a number; give zero or more")


def turn_repeated(eigenvalue: Array, shapes: Array, row: Array) -> Array:
    """Shapes of which one alone in each repeated eigenspace has a motion `row`."""
    gaps = np.diff(eigenvalue) > np.maximum(_REPEATED * eigenvalue[1:], _ROUNDING * eigenvalue[-1])
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
