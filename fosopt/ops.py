"""Operations that mean the same for NumPy arrays and CasADi expressions.

Each formula of the field is written once, with ``+ - * / ** @ .T`` and the names below; the same text then
serves numbers, symbols and, through `ComplexPair`, symbols at complex frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

__all__ = [
    "Array",
    "ComplexArray",
    "ComplexPair",
    "Dual",
    "congruence",
    "congruence_entries",
    "exp",
    "fabs",
    "fmax",
    "fmin",
    "is_symbolic",
    "linear",
    "log",
    "sqrt",
    "stack",
    "total",
]


def is_symbolic(value: Any) -> bool:
    """Whether a value is a CasADi expression."""
    return isinstance(value, (ca.SX, ca.MX))


def sqrt(value: Any) -> Any:
    """Square root."""
    return ca.sqrt(value) if is_symbolic(value) else np.sqrt(value)


def log(value: Any) -> Any:
    """Natural logarithm."""
    return ca.log(value) if is_symbolic(value) else np.log(value)


def exp(value: Any) -> Any:
    """Exponential."""
    return ca.exp(value) if is_symbolic(value) else np.exp(value)


def fabs(value: Any) -> Any:
    """Absolute value."""
    return ca.fabs(value) if is_symbolic(value) else np.abs(value)


def fmin(left: Any, right: Any) -> Any:
    """Smaller of two values."""
    return ca.fmin(left, right) if is_symbolic(left) or is_symbolic(right) else np.minimum(left, right)


def fmax(left: Any, right: Any) -> Any:
    """Larger of two values."""
    return ca.fmax(left, right) if is_symbolic(left) or is_symbolic(right) else np.maximum(left, right)


def total(values: Any) -> Any:
    """Sum of all elements of a vector."""
    return ca.sum(values) if is_symbolic(values) else np.sum(values)


def stack(*parts: Any) -> Any:
    """Vectors and scalars one after another in one vector."""
    if any(is_symbolic(part) for part in parts):
        return ca.vertcat(*parts)
    return np.concatenate([np.atleast_1d(np.asarray(part, dtype=float)) for part in parts])


def linear(matrix: sparse.csr_array, vector: Any) -> Any:
    """Product of a constant sparse matrix and a vector."""
    return _constant(matrix) @ vector if is_symbolic(vector) else matrix @ vector


def congruence_entries(rows: sparse.csr_array) -> sparse.csc_array:
    """(n², k) What each weight of `congruence` adds to each entry, for many evaluations with the same rows."""
    n, counts = rows.shape[1], np.diff(rows.indptr)
    places, values = [], []
    for first, last in pairwise(rows.indptr):
        index, value = rows.indices[first:last], rows.data[first:last]
        places.append((n * index[:, None] + index).ravel())
        values.append(np.outer(value, value).ravel())
    starts = np.concatenate([[0], np.cumsum(counts**2)])
    return sparse.csc_array(
        (np.concatenate(values), np.concatenate(places), starts), shape=(n * n, counts.size)
    )


def congruence(rows: sparse.csr_array, weights: Any, entries: sparse.csc_array) -> Any:
    """``rows.T @ diag(weights) @ rows``, the form of every stiffness and mass matrix here.

    Building the symbolic matrix from this product takes 0.1 s for 500 bars, where a sum of element matrices
    takes more than ten.

    Returns
    -------
    (n, n)
        Dense array for numbers, sparse expression for symbols.
    """
    if is_symbolic(weights):
        constant = _constant(rows)
        return constant.T @ ca.diag(weights) @ constant
    return (entries @ weights).reshape(rows.shape[1], -1)


def _constant(matrix: sparse.csr_array) -> ca.DM:
    # CasADi stores zeros that SciPy holds explicitly; they would spoil the sparsity of every product.
    columns = sparse.csc_matrix(matrix)
    columns.eliminate_zeros()
    return ca.DM(columns)


@dataclass(frozen=True)
class ComplexPair:
    """A complex number as a pair of real CasADi expressions, for formulas in the Laplace variable.

    CasADi has real numbers only. A loop formula is a rational function of `s`, so its text runs on this pair
    unchanged, and real and imaginary part become expressions that CasADi differentiates.
    """

    re: Any
    im: Any

    def __add__(self, other: Any) -> ComplexPair:
        o = _pair(other)
        return ComplexPair(self.re + o.re, self.im + o.im)

    def __neg__(self) -> ComplexPair:
        return ComplexPair(-self.re, -self.im)

    def __sub__(self, other: Any) -> ComplexPair:
        o = _pair(other)
        return ComplexPair(self.re - o.re, self.im - o.im)

    def __mul__(self, other: Any) -> ComplexPair:
        o = _pair(other)
        return ComplexPair(self.re * o.re - self.im * o.im, self.re * o.im + self.im * o.re)

    def __truediv__(self, other: Any) -> ComplexPair:
        o = _pair(other)
        size = o.re * o.re + o.im * o.im
        return ComplexPair(
            (self.re * o.re + self.im * o.im) / size,
            (self.im * o.re - self.re * o.im) / size,
        )

    def __pow__(self, exponent: int) -> ComplexPair:
        result = self
        for _ in range(exponent - 1):
            result = result * self
        return result

    def __radd__(self, other: Any) -> ComplexPair:
        return self + other

    def __rsub__(self, other: Any) -> ComplexPair:
        return _pair(other) - self

    def __rmul__(self, other: Any) -> ComplexPair:
        return self * other

    def __rtruediv__(self, other: Any) -> ComplexPair:
        return _pair(other) / self


def _pair(value: Any) -> ComplexPair:
    if isinstance(value, ComplexPair):
        return value
    if isinstance(value, complex):
        return ComplexPair(value.real, value.imag)
    return ComplexPair(value, 0)


@dataclass(frozen=True)
class Dual:
    """A number with its derivative along one direction, for the numerical derivative of a formula in `s`."""

    value: Any
    slope: Any

    # An array on the left leaves the operation to the methods below.
    __array_ufunc__ = None

    def __add__(self, other: Any) -> Dual:
        if not isinstance(other, Dual):
            return Dual(self.value + other, self.slope)
        return Dual(self.value + other.value, self.slope + other.slope)

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __sub__(self, other: Any) -> Dual:
        o = _dual(other)
        return Dual(self.value - o.value, self.slope - o.slope)

    def __mul__(self, other: Any) -> Dual:
        if not isinstance(other, Dual):
            return Dual(self.value * other, self.slope * other)
        return Dual(self.value * other.value, self.slope * other.value + self.value * other.slope)

    def __truediv__(self, other: Any) -> Dual:
        o = _dual(other)
        quotient = self.value / o.value
        return Dual(quotient, (self.slope - quotient * o.slope) / o.value)

    def __pow__(self, exponent: int) -> Dual:
        lower = self.value ** (exponent - 1)
        return Dual(lower * self.value, exponent * lower * self.slope)

    def __radd__(self, other: Any) -> Dual:
        return self + other

    def __rsub__(self, other: Any) -> Dual:
        return _dual(other) - self

    def __rmul__(self, other: Any) -> Dual:
        return self * other

    def __rtruediv__(self, other: Any) -> Dual:
        return _dual(other) / self


def _dual(value: Any) -> Dual:
    return value if isinstance(value, Dual) else Dual(value, 0.0)
