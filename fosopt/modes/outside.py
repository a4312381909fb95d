"""What a truncated basis of modes leaves out, as far as its change with the structure needs it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fosopt.ops import Array


@dataclass(frozen=True)
class Turning:
    """Adjoint shapes a and b of a change of basis, −Σ_k a_kᵀ(dK − λ_k dM)φ_k − Σ_p b_pᵀ(dK w_p + dM r rᵀe_p).

    Attributes
    ----------
    modes
        (n, r) a, one per mode.
    static
        (n, p) b, one per port; w is the static shape of a load there, r a free rigid-body mode.
    """

    modes: Array
    static: Array


@dataclass(frozen=True)
class Outside:
    """The complement of a basis of r exact modes and q residual shapes, in s shapes that the ports reach.

    A functional of the reduced matrices VᵀKV and VᵀMV and of the motions Vᵀe of the ports follows the basis V by
    ⟨R, dV⟩, R = 2 K V S + 2 M V T + Σ_p e_p u_pᵀ, which no change within the basis alters. Exact modes turn outward
    by (K − λ_k M) dφ_k = −(dK − λ_k dM) φ_k, residual shapes by K dψ = −dK ψ; with right-hand sides that come from the
    ports both are solved in the mass-normalized shapes here, of Rayleigh quotients θ.    [Nelson1976]

    Shapes: n degrees of freedom, m mass rows, p ports.

    Attributes
    ----------
    eigenvalue
        (s,) θ [rad²/s²].
    shapes
        (n, s).
    ports, loads, motion
        (p,) names, (n, p) unit loads there, and (s, p) motions of the shapes.
    residual
        (p, q) residual shapes are the residual flexibilities of the ports times these.
    overlap
        (s, q) of the residual shapes in the mass.
    carried
        (r, q) part of the modes in the static shapes times `residual`.
    static_shapes
        (n, p) the elastic displacement under a unit load at each port.
    residual_flexibility
        (p, p) receptance at rest of all that the exact modes leave out [rad/(N m)] between rotations.
    next_eigenvalue
        The lowest that is left out [rad²/s²].
    impulse_shapes
        (m,) motion of the mass rows under a unit impulse at the mirror's port, by the whole mass matrix.
    mobility
        Motion of that port itself, 1/J_ref [1/(kg m²)].
    """

    eigenvalue: Array
    shapes: Array
    ports: tuple[str, ...]
    loads: Array
    motion: Array
    residual: Array
    overlap: Array
    carried: Array
    static_shapes: Array
    residual_flexibility: Array
    next_eigenvalue: float
    impulse_shapes: Array
    mobility: float

    def turning(
        self, eigenvalue: Array, coefficients: tuple[Array, Array], motion: Mapping[str, Array]
    ) -> Turning:
        """The adjoint shapes of ⟨R, dV⟩.

        Parameters
        ----------
        eigenvalue
            (r + q,) of the basis.
        coefficients
            (r + q, r + q) S and T.
        motion
            (r + q,) u of each port.
        """
        exact = eigenvalue.size - self.residual.shape[1]
        in_stiffness, in_mass = ((c + c.T)[exact:] for c in coefficients)
        by_motion = np.array([motion.get(p, np.zeros(eigenvalue.size)) for p in self.ports])
        right = self.motion @ (self.residual @ in_stiffness + by_motion) + self.overlap @ in_mass
        # The basis is [modes, static shapes] times a matrix that may stay as it is.
        by_mode = right[:, :exact] - right[:, exact:] @ self.carried.T
        by_static = right[:, exact:] @ self.residual.T
        return Turning(
            self.shapes @ (by_mode / (self.eigenvalue[:, None] - eigenvalue[:exact])),
            self.shapes @ (by_static / self.eigenvalue[:, None]),
        )

    def receptance_error(self, frequency: Array) -> Array:
        """Bound on what the truncation takes from |g_pq(jω)|, undamped, (m, p, p) at (m,) frequencies.

        On all that is left out, stiffness less inertia forces stays positive below √Λ, the lowest frequency left out.
        There a Galerkin solution is the best in energy, so that the error is at most that of the static shape,
        √(ρ_pp ρ_qq) ω⁴/(Λ (Λ − ω²)) with the residual flexibility ρ. Zero at rest, infinite from √Λ on.
        """
        squared = frequency**2
        size = np.sqrt(np.diag(self.residual_flexibility))
        with np.errstate(divide="ignore"):
            factor = squared**2 / (self.next_eigenvalue * (self.next_eigenvalue - squared))
        factor = np.where(squared < self.next_eigenvalue, factor, np.inf)
        return factor[:, None, None] * np.outer(size, size)
