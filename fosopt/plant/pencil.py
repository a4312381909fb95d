"""Finite zeros of output·P(x)⁻¹·load for a matrix polynomial P, as roots of a bordered determinant.

With P = Σ A_i xⁱ the zeros are those of det [[P, load], [output, 0]], which has no poles: a zero next to a pole is
found like any other. Guesses come from the generalized eigenvalue problem of P between the null spaces of load and
output; Newton's method with Aberth's repulsion [Aberth1973] on the scaled determinant makes each exact.

Which zeros are finite is a question of rounding: residues that should cancel leave large spurious zeros behind. Such a
zero gives itself away, because the points around it satisfy its equation as well as it does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from fosopt.errors import ModelError, SolverError
from fosopt.ops import Array, ComplexArray

_MAX_ITERATIONS = 30
_CONVERGED = 4e-16
# A root has settled when its steps stop shrinking below this share of it.
_SETTLED = 1e-8
# Distance to singularity of the scaled bordered matrix at a zero, and all around what is none.
_RESIDUAL = 1e-11
_NOWHERE_ELSE = 1e-13
_AROUND = 1e-3 * np.array([1, 1j])
# The same at the origin, where shapes of rigid-body modes cancel no better; and the determinant's slope there.
_AT_ORIGIN = 1e-8
_SLOPE = 1e-5
# Where a response that exists is not lost in rounding everywhere.
_ANYWHERE = (0.8 + 0.6j) * np.array([1.0, 1e-2, 1e-4, 1e-6, 1e-8])


def finite_zeros(polynomial: Sequence[Array], load: Array, output: Array) -> ComplexArray:
    """Zeros x of output·P(x)⁻¹·load, both conjugates of a pair, those at infinity left out.

    A zero that rounding of the data could move by a thousandth of itself is one at infinity.

    Parameters
    ----------
    polynomial
        (n, n) coefficients A_0, A_1, ...; the last one is regular.
    load, output
        (n,).

    Raises
    ------
    ModelError
        If the output does not respond to the load at all.
    SolverError
        If a zero does not satisfy its equation.
    """
    degree = len(polynomial) - 1
    # The unit of x in which the coefficients are of one size.
    lead = np.linalg.inv(polynomial[-1])
    unit = max(
        float(np.linalg.norm(lead @ a, np.inf)) ** (1 / (degree - i)) for i, a in enumerate(polynomial[:-1])
    )
    unit = unit or 1.0
    pencil = _Pencil([a * unit ** (i - degree) for i, a in enumerate(polynomial)], load, output)
    if not (load.any() and output.any()) or all(pencil.singular_around(x) for x in _ANYWHERE):
        raise ModelError("zeros: the sensor does not respond to the torque at all; choose other places")
    at_origin = pencil.zeros_at_origin()
    every = pencil.guesses()
    every = every[np.argsort(np.abs(every), kind="stable")][at_origin:]
    x = np.array([x for x in every if x.imag >= 0 and not pencil.singular_around(x)], dtype=complex)
    x = pencil.polished(x, at_origin)
    for root in x:
        residual = pencil.residual(root, abs(root))
        if residual > _RESIDUAL:
            raise SolverError(
                f"zeros: {root * unit:.6g} misses its equation by {residual:.1e}; rescale the model's units"
            )
    x = np.array([root for root in x if not pencil.singular_around(root)], dtype=complex)
    every = np.concatenate([np.zeros(at_origin), x, x[x.imag > 0].conj()])
    return every * unit


class _Pencil:
    """A matrix polynomial between a load and an output; of a conjugate pair it speaks of the upper zero."""

    def __init__(self, polynomial: Sequence[Array], load: Array, output: Array) -> None:
        self.polynomial, self.load, self.output = polynomial, load, output
        self.sizes = [np.abs(np.diag(a)) for a in polynomial]

    def guesses(self) -> ComplexArray:
        """Eigenvalues of P between the loads that do nothing and the motions that are not seen."""
        n, degree = self.load.size - 1, len(self.polynomial) - 1
        if n == 0:
            return np.zeros(0, dtype=complex)
        unseen = np.linalg.qr(self.output[:, None], mode="complete")[0][:, 1:]
        unloaded = np.linalg.qr(self.load[:, None], mode="complete")[0][:, 1:]
        inner = [unloaded.T @ a @ unseen for a in self.polynomial]
        a, b = np.eye(degree * n, k=n), np.eye(degree * n)
        a[-n:] = -np.hstack(inner[:-1])
        b[-n:, -n:] = inner[-1]
        alpha, beta = linalg.eigvals(a, b, homogeneous_eigvals=True)
        finite = np.abs(beta) > np.finfo(float).tiny * np.abs(alpha)
        return (alpha[finite] / beta[finite]).astype(complex)

    def scale(self, size: float) -> Array:
        """(n,) What rows and columns of P are multiplied by at |x| = size, so that entries are of size one."""
        return 1 / np.sqrt(sum((a * size**i for i, a in enumerate(self.sizes)), np.zeros(self.load.size)))

    def bordered(self, x: complex, size: float) -> ComplexArray:
        """(n+1, n+1) The scaled bordered matrix."""
        n, scale = self.load.size, self.scale(size)
        whole = np.zeros((n + 1, n + 1), dtype=complex)
        for i, a in enumerate(self.polynomial):
            whole[:-1, :-1] += a * x**i
        whole[:-1, :-1] *= scale[:, None] * scale
        column, row = self.load * scale, self.output * scale
        whole[:-1, -1], whole[-1, :-1] = column / np.linalg.norm(column), row / np.linalg.norm(row)
        return whole

    def residual(self, x: complex, size: float) -> float:
        """Relative distance of the scaled bordered matrix from a singular one."""
        values = np.linalg.svd(self.bordered(x, size), compute_uv=False)
        return float(values[-1] / values[0])

    def singular_around(self, x: complex) -> bool:
        """Whether every point near x satisfies the equation but for rounding, so that x means nothing."""
        return all(self.residual(x * (1 + shift), abs(x)) <= _NOWHERE_ELSE for shift in _AROUND)

    def polished(self, x: ComplexArray, at_origin: int) -> ComplexArray:
        """Each zero by Newton's method with all others divided out, those at the origin included."""
        pair = x.imag > 0
        last = np.full(x.size, np.inf)
        moving = np.ones(x.size, dtype=bool)
        for _ in range(_MAX_ITERATIONS):
            for k in np.flatnonzero(moving):
                others = np.concatenate([np.delete(x, k), x[pair].conj(), np.zeros(at_origin)])
                step = self._step(x[k], others)
                step = step if pair[k] else complex(step.real)
                size = abs(step)
                settled = size >= 0.5 * last[k] and size <= _SETTLED * abs(x[k])
                moving[k] = size > _CONVERGED * abs(x[k]) and not settled
                if not settled:
                    x[k] -= step
                    last[k] = size
            if not moving.any():
                break
        return x

    def _step(self, x: complex, others: ComplexArray) -> complex:
        """1/(d log det/dx − Σ 1/(x − others)), zero where the matrix is singular to the last digit."""
        size = abs(x) or 1.0
        slope = np.zeros((self.load.size, self.load.size), dtype=complex)
        for i, a in enumerate(self.polynomial[1:], start=1):
            slope += i * a * x ** (i - 1)
        try:
            inverse = np.linalg.inv(self.bordered(x, size))[:-1, :-1]
        except np.linalg.LinAlgError:
            return 0j
        scale = self.scale(size)
        with np.errstate(all="ignore"):
            logarithmic = np.sum(inverse.T * slope * (scale[:, None] * scale))
            step = 1 / (logarithmic - np.sum(1 / (x - others)))
        return complex(step) if np.isfinite(step) else 0j

    def zeros_at_origin(self) -> int:
        """How many zeros, none to two, lie at the origin exactly: what vanishes there but for rounding."""
        positive = (self.sizes[0] > 0) & (self.sizes[-1] > 0)
        ratio = self.sizes[0][positive] / self.sizes[-1][positive]
        size = float(ratio.min(initial=1.0)) ** (1 / (len(self.polynomial) - 1))
        left, values, right = np.linalg.svd(self.bordered(0j, size))
        small = int(np.count_nonzero(values <= _AT_ORIGIN * values[0]))
        if small != 1:
            return min(small, 2)
        scale = self.scale(size)
        u, v = left[:-1, -1] * scale, right[-1, :-1].conj() * scale
        slope, terms = u.conj() @ self.polynomial[1] @ v, np.abs(u) @ np.abs(self.polynomial[1]) @ np.abs(v)
        return 2 if abs(slope) <= _SLOPE * terms else 1
