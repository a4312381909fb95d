"""Affine arithmetic over a box, with a disc for what is not linear.

A number that depends on p parameters is enclosed as v + Σ gᵢ δᵢ + ε with −1 ≤ δᵢ ≤ 1 across the box and |ε| ≤ ρ. What
products and functions leave beyond first order goes into ρ, which therefore shrinks with the square of the box.
[Stolfi2003]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.ops import Array

Numbers = NDArray[Any]


@dataclass(frozen=True)
class Affine:
    """Many numbers over one box.

    Attributes
    ----------
    value
        (m,) v, in the middle of the box.
    slope
        (m, p) g, per half width of the box.
    radius
        (m,) ρ; infinite where nothing is known.
    """

    value: Numbers
    slope: Numbers
    radius: Array

    @property
    def reach(self) -> Array:
        """(m,) How far from the middle it can be."""
        return np.abs(self.slope).sum(axis=1) + self.radius

    def __add__(self, other: Affine | Any) -> Affine:
        if isinstance(other, Affine):
            return Affine(self.value + other.value, self.slope + other.slope, self.radius + other.radius)
        return Affine(self.value + other, self.slope, self.radius)

    def __mul__(self, other: Affine | Any) -> Affine:
        if not isinstance(other, Affine):
            factor = np.broadcast_to(other, self.value.shape)
            return Affine(self.value * factor, self.slope * factor[:, None], self.radius * np.abs(factor))
        a, b = np.abs(self.value), np.abs(other.value)
        return Affine(
            self.value * other.value,
            self.slope * other.value[:, None] + other.slope * self.value[:, None],
            a * other.radius + b * self.radius + self.reach * other.reach,
        )

    def reciprocal(self) -> Affine:
        """1/x: with z = x/v − 1 and |z| ≤ t, 1/(1 + z) departs from 1 − z by t²/(1 − t)."""
        size, t = self._relative
        bend = np.divide(t**2, 1 - t, out=np.full_like(t, np.inf), where=t < 1)
        inverse = 1 / np.where(t < np.inf, self.value, 1.0)
        return Affine(inverse, -self.slope * inverse[:, None] ** 2, (self.radius / size + bend) / size)

    def log_magnitude(self) -> Affine:
        """log|x|: with z = x/v − 1 and |z| ≤ t, log(1 + z) departs from z by −log(1 − t) − t."""
        size, t = self._relative
        bend = np.full_like(t, np.inf)
        bend[t < 1] = -np.log1p(-t[t < 1]) - t[t < 1]
        slope = (self.slope / np.where(t < np.inf, self.value, 1.0)[:, None]).real
        return Affine(np.log(size), slope, self.radius / size + bend)

    @property
    def _relative(self) -> tuple[Array, Array]:
        """Size in the middle, and share of it by which it may differ; one and infinite where it is zero."""
        size = np.abs(self.value)
        share = np.divide(self.reach, size, out=np.full_like(size, np.inf), where=size > 0)
        return np.where(size > 0, size, 1.0), share
