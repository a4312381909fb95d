"""Sizing of a structure as data: a boxed vector of parameters, a linear cost, and requirements on K(x) and M(x).

Stiffness and mass are Rᵀ diag(w₀ + W x) R with constant sparse R and W. A requirement says of one such matrix,
S(x) = A(x) − ω² B(x) with a load f and a limit γ, that

    q(u, τ; x) = uᵀ S(x) u − 2 τ fᵀ u + γ τ² ≥ 0    for every displacement u and number τ,

which is S ⪰ 0 where there is no load, and fᵀ S⁻¹ f ≤ γ otherwise: a lowest frequency of at least ω (A = K, B = M), a
static compliance (A = K, ω = 0), a receptance below the first frequency, a reference inertia (A = M, ω = 0, f the
port, γ = 1/J). Since q is linear in x, each of these sets is convex.    [Boyd1994, Ohsaki1999]

A structure that may turn as a rigid body r has one more negative direction, whatever its parameters. Its elastic
frequencies are at least ω where S(x) has no second one. For P = −rᵀ S r > 0 and Q = −rᵀ S u this says

    uᵀ S(x) u + Q(u; x)²/P(x) ≥ 0    for every u,

the determinant of S on the span of r and u. It is not convex in x: see `free_hub`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from fosopt.errors import ModelError
from fosopt.ops import Array


@dataclass(frozen=True)
class AffineForm:
    """The matrix Rᵀ diag(w₀ + W x) R.

    Attributes
    ----------
    rows
        (m, n) R.
    constant, slope
        (m,) w₀ and (m, p) W.
    """

    rows: sparse.csr_array
    constant: Array
    slope: sparse.csr_array

    def weights(self, x: Array) -> Array:
        """(m,) w₀ + W x."""
        return self.constant + self.slope @ x

    def matrix(self, x: Array) -> Array:
        """(n, n) value at `x`."""
        return np.asarray((self.rows.T @ sparse.diags_array(self.weights(x)) @ self.rows).toarray())

    def on(self, keep: NDArray[np.intp]) -> AffineForm:
        """The block of some degrees of freedom."""
        return replace(self, rows=sparse.csr_array(self.rows[:, keep]))


@dataclass(frozen=True)
class Requirement:
    """What a structure must meet, see the equations of this module.

    Attributes
    ----------
    name
        In words.
    elastic, inertial
        A, and B if ω is not zero.
    rate
        ω [rad/s].
    load, limit
        (n,) f and γ where there is a load.
    rigid
        (n,) r where the structure may turn.
    """

    name: str
    elastic: AffineForm
    inertial: AffineForm | None = None
    rate: float = 0.0
    load: Array | None = None
    limit: float = 0.0
    rigid: Array | None = None

    @property
    def size(self) -> int:
        """Number of degrees of freedom n."""
        return int(self.elastic.rows.shape[1])

    def matrix(self, x: Array) -> Array:
        """(n, n) S(x)."""
        a = self.elastic.matrix(x)
        return a if self.inertial is None else a - self.rate**2 * self.inertial.matrix(x)

    def margin(self, x: Array) -> float:
        """How far inside a structure is, relative: ω₁²/ω² − 1, or 1 − fᵀ S⁻¹ f/γ; −inf where S is indefinite."""
        if self.load is None:
            assert self.inertial is not None
            first = 0 if self.rigid is None else 1
            squares = linalg.eigh(
                self.elastic.matrix(x),
                self.inertial.matrix(x),
                eigvals_only=True,
                subset_by_index=[first, first],
            )
            return float(squares[0] / self.rate**2 - 1)
        try:
            factor = linalg.cho_factor(self.matrix(x))
        except linalg.LinAlgError:
            return -inf
        return float(1 - self.load @ linalg.cho_solve(factor, self.load) / self.limit)


@dataclass(frozen=True)
class Sizing:
    """Minimize cost₀ + cᵀ x over l ≤ x ≤ u under requirements and linear limits N x ≤ b.

    Attributes
    ----------
    names
        (p,) Of the parameters.
    lower, upper
        (p,) Box; an upper side may be infinite where the cost grows.
    cost, cost_constant
        (p,) c and cost₀.
    requirements
        Convex ones, and at most one of a structure that may turn.
    normals, limits, limit_names
        (m, p) N, (m,) b and what they say.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    cost: Array
    cost_constant: float
    requirements: tuple[Requirement, ...] = ()
    normals: Array = field(default_factory=lambda: np.zeros((0, 0)))
    limits: Array = field(default_factory=lambda: np.zeros(0))
    limit_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "normals", self.normals.reshape(self.limits.size, self.lower.size))
        for name, low, high, cost in zip(self.names, self.lower, self.upper, self.cost, strict=True):
            if not (np.isfinite(low) and low <= high):
                raise ModelError(
                    f"'{name}': no value lies between {low:g} and {high:g}; put the bounds in order"
                )
            if np.isinf(high) and not cost > 0:
                raise ModelError(
                    f"'{name}' has no upper bound and costs nothing, so that no design is the least; give it one"
                )
        if sum(r.rigid is not None for r in self.requirements) > 1:
            raise ModelError(
                "two requirements on the frequencies of a structure that turns; keep the higher one"
            )

    @property
    def scale(self) -> Array:
        """(p,) A size above zero of each parameter."""
        size = np.where(np.isfinite(self.upper), self.upper, self.lower)
        size = np.maximum(np.abs(size), np.abs(self.lower))
        return np.where(size > 0, size, 1.0)

    @property
    def turning(self) -> int | None:
        """Which requirement is of a structure that may turn."""
        return next((i for i, r in enumerate(self.requirements) if r.rigid is not None), None)

    def value(self, x: Array) -> float:
        """Cost of a structure."""
        return float(self.cost_constant + self.cost @ x)

    def margin(self, x: Array) -> float:
        """The least relative distance from a requirement or linear limit, negative where one is missed."""
        size = np.abs(self.normals) @ np.abs(x) + np.abs(self.limits)
        rows = (self.limits - self.normals @ x) / np.where(size > 0, size, 1.0)
        return float(min([r.margin(x) for r in self.requirements] + rows.tolist(), default=inf))
