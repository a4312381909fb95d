"""Arithmetics in which one formula gives a number, the size of its terms, and its exact value.

A sum of products computed in floating point differs from the exact one by at most γ_N = N u/(1 − N u) times the
sum of the absolute products, u = 2⁻⁵³, where no product passes through more than N roundings [Higham2002]. Running
the same formula on absolute values with every difference turned into a sum gives that sum; running it on
fractions gives the exact value.

Elongations are small differences of large displacements. Their sums of products are compensated, as if computed in
twice the precision: the error is u |s| + γ_n² Σ |products| [Ogita2005], here counted as two roundings of
|s| + n² u Σ |products|.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from fosopt.ops import Array

_UNIT = 2.0**-53


def growth(roundings: int) -> float:
    """γ_N of N roundings, with room for the rounding of the bound itself.    [Higham2002] Eq. (3.1)"""
    return 1.01 * roundings * _UNIT / (1 - roundings * _UNIT)


def compensated_product(matrix: sparse.csr_array, values: Array) -> Array:
    """(m, k) Matrix times (n, k) values, each sum as if in twice the precision.    [Ogita2005] Alg. 5.3"""
    total = np.zeros((matrix.shape[0], values.shape[1]))
    error = np.zeros_like(total)
    lengths = np.diff(matrix.indptr)
    for place in range(int(lengths.max(initial=0))):
        rows = np.flatnonzero(lengths > place)
        at = matrix.indptr[rows] + place
        product, lost = _two_product(matrix.data[at][:, None], values[matrix.indices[at]])
        summed = total[rows] + product
        part = summed - total[rows]
        error[rows] += lost + ((total[rows] - (summed - part)) + (product - part))
        total[rows] = summed
    return np.asarray(total + error)


def _two_product(left: Array, right: Array) -> tuple[Array, Array]:
    """Product and its rounding error, exactly.    [Ogita2005] Algs. 3.2, 3.3"""
    product = left * right
    (a, b), (c, d) = _halves(left), _halves(right)
    return product, b * d - (((product - a * c) - b * c) - a * d)


def _halves(value: Array) -> tuple[Array, Array]:
    carried = 134217729.0 * value  # 2²⁷ + 1
    upper = carried - (carried - value)
    return upper, value - upper


class Arithmetic(Protocol):
    """Numbers, products with a sparse matrix, and the least value of a linear function over a box."""

    def number(self, value: Any) -> Any:
        """Elementwise the number of this arithmetic."""

    def minus(self, left: Any, right: Any) -> Any:
        """Difference."""

    def rows(self, matrix: sparse.csr_array, values: Array) -> Any:
        """Matrix times doubles (n, k)."""

    def columns(self, matrix: sparse.csr_array, values: Any) -> Any:
        """Transposed matrix times numbers."""

    def least(self, gradient: Any, lower: Array, upper: Array) -> Any:
        """Σ min(gᵢ lᵢ, gᵢ uᵢ) over a box without infinite sides."""


class Floating:
    """Double precision."""

    def number(self, value: Any) -> Any:
        """The value itself."""
        return np.asarray(value, dtype=float)

    def minus(self, left: Any, right: Any) -> Any:
        """Difference."""
        return left - right

    def rows(self, matrix: sparse.csr_array, values: Array) -> Any:
        """Matrix times doubles, compensated."""
        return compensated_product(matrix, values)

    def columns(self, matrix: sparse.csr_array, values: Any) -> Any:
        """Transposed matrix times numbers."""
        return matrix.T @ values

    def least(self, gradient: Any, lower: Array, upper: Array) -> Any:
        """Σ min(gᵢ lᵢ, gᵢ uᵢ)."""
        return np.minimum(gradient * lower, gradient * upper).sum()


class Magnitude(Floating):
    """Absolute values, whose differences are sums: what the rounding of `Floating` is proportional to."""

    def number(self, value: Any) -> Any:
        """Absolute value."""
        return np.abs(np.asarray(value, dtype=float))

    def minus(self, left: Any, right: Any) -> Any:
        """Sum."""
        return left + right

    def rows(self, matrix: sparse.csr_array, values: Array) -> Any:
        """What the error of the compensated product is proportional to."""
        longest = int(np.diff(matrix.indptr).max(initial=0))
        small = (abs(matrix) @ np.abs(values)) * (2 * longest**2 * _UNIT)
        return np.abs(compensated_product(matrix, values)) + small

    def columns(self, matrix: sparse.csr_array, values: Any) -> Any:
        """Absolute transposed matrix times numbers."""
        return abs(matrix).T @ values

    def least(self, gradient: Any, lower: Array, upper: Array) -> Any:
        """Σ gᵢ max(|lᵢ|, |uᵢ|)."""
        return (gradient * np.maximum(np.abs(lower), np.abs(upper))).sum()


class Exact:
    """Rational numbers: a double is one, so that sums of products of doubles have no error."""

    def number(self, value: Any) -> Any:
        """Fractions, elementwise."""
        array = np.asarray(value)
        return np.array([Fraction(float(v)) for v in array.ravel()], dtype=object).reshape(array.shape)

    def minus(self, left: Any, right: Any) -> Any:
        """Difference."""
        return left - right

    def rows(self, matrix: sparse.csr_array, values: Array) -> Any:
        """Matrix times doubles."""
        return self._product(matrix, self.number(values), 0)

    def columns(self, matrix: sparse.csr_array, values: Any) -> Any:
        """Transposed matrix times numbers."""
        return self._product(matrix, values, 1)

    def _product(self, matrix: sparse.csr_array, values: Any, axis: int) -> Any:
        entries = matrix.tocoo()
        into, out = entries.coords[axis], entries.coords[1 - axis]
        factors = self.number(entries.data).reshape(-1, *(1 for _ in values.shape[1:]))
        product = np.full((matrix.shape[axis], *values.shape[1:]), Fraction(0), dtype=object)
        np.add.at(product, into, factors * values[out])
        return product

    def least(self, gradient: Any, lower: Array, upper: Array) -> Any:
        """Σ min(gᵢ lᵢ, gᵢ uᵢ)."""
        return sum(
            (
                g * Fraction(float(low if g > 0 else high))
                for g, low, high in zip(gradient, lower, upper, strict=True)
            ),
            Fraction(0),
        )
