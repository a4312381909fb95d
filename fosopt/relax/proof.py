"""Proofs of lower bounds on the cost of a sizing, and what they prove.

For x within the box and whatever meets the requirements, every vector (u, τ) gives q(u, τ; x) ≥ 0, see `sizing`.
With such vectors and multipliers λ ≥ 0 of the linear limits,

    cost(x) ≥ cost₀ + cᵀ x − Σ q(u, τ; x) + λᵀ(N x − b) = κ + gᵀ x ≥ κ + Σ min(gᵢ lᵢ, gᵢ uᵢ):

weak duality over a box, with the positive semidefinite dual matrix Σ (u, τ)(u, τ)ᵀ written by its factors
[Boyd2004, Ohsaki1999]. No vector is wrong, however it was found; a poor one proves less. Without the cost, a positive
right-hand side proves that nothing meets the requirements: a Farkas certificate, here a `Leaf` that is a ray.

A structure that may turn is split by the values t = Q/P of one or several directions u. Where t₁ ≤ t ≤ t₂ the secant
of t² gives Q²/P ≤ (t₁ + t₂) Q − t₁ t₂ P, which is linear in x [McCormick1976], and the sides of the piece, such as
Q − t₁ P ≥ 0, carry multipliers of their own. Pieces without end have these alone. The bound is the least of all pieces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from math import inf, nextafter
from typing import Any

import numpy as np

from fosopt.errors import SolverError
from fosopt.ops import Array
from fosopt.relax.arithmetic import Arithmetic, Exact, Floating, Magnitude, growth
from fosopt.relax.sizing import AffineForm, Requirement, Sizing

Affine = tuple[Any, Any]
"""A constant and a gradient of a linear function of the parameters."""
Path = tuple[tuple[int, float, bool], ...]
"""The sides of a piece: direction, value of t, and whether the piece lies above it."""


@dataclass(frozen=True)
class Leaf:
    """Multipliers of one piece.

    Attributes
    ----------
    vectors
        Per requirement (n + 1, k) columns (u, τ); none for a structure that may turn.
    limits
        (m,) λ of the linear limits.
    secants, sides
        Per direction, later ones left out, and (s,) per side of the piece.
    ray
        Whether it proves that the piece is empty.
    """

    vectors: tuple[Array, ...]
    limits: Array
    secants: Array
    sides: Array
    ray: bool = False


@dataclass(frozen=True)
class Split:
    """Two parts of a piece: below and above a value of t of one direction."""

    direction: int
    at: float
    below: Leaf | Split
    above: Leaf | Split


@dataclass(frozen=True)
class Proof:
    """A tree of pieces that together are everything, with their multipliers.

    Attributes
    ----------
    root
        The tree.
    directions
        (n, d) displacements u by whose t it is split.
    """

    root: Leaf | Split
    directions: Array

    def leaves(self) -> Iterator[tuple[Path, Leaf]]:
        """Every piece with its sides."""
        waiting: list[tuple[Path, Leaf | Split]] = [((), self.root)]
        while waiting:
            path, node = waiting.pop()
            if isinstance(node, Leaf):
                yield path, node
            else:
                waiting.append(((*path, (node.direction, node.at, False)), node.below))
                waiting.append(((*path, (node.direction, node.at, True)), node.above))

    def value(self, sizing: Sizing) -> tuple[float, float]:
        """The bound, and the rounding allowance that was taken off already; infinite where all pieces are empty.

        Raises
        ------
        SolverError
            If a multiplier is negative, or does not fit the sizing.
        """
        judge = Judge(sizing, self.directions)
        return min(judge.value(path, leaf) for path, leaf in self.leaves())

    def exact_value(self, sizing: Sizing) -> float:
        """The bound in rational arithmetic, rounded down once at the end.

        Raises
        ------
        SolverError
            As `value`.
        """
        judge = Judge(sizing, self.directions)
        a = Exact()
        known = lines(sizing, self.directions, a)
        return min(judge.exact_value(path, leaf, known, a) for path, leaf in self.leaves())


class Judge:
    """What pieces prove; the products all pieces share are computed once.

    Parameters
    ----------
    directions
        (n, d) of the proof.

    Raises
    ------
    SolverError
        If the rigid body of a structure that may turn has no inertia somewhere in the box, or the directions do not
        fit its requirement.
    """

    def __init__(self, sizing: Sizing, directions: Array) -> None:
        if sizing.turning is not None and directions.shape[0] != sizing.requirements[sizing.turning].size:
            raise SolverError(
                f"a proof with directions of {directions.shape[0]} entries does not fit the requirements; make it anew"
            )
        self._sizing, self._directions = sizing, directions
        self._floating, self._magnitude = Floating(), Magnitude()
        self.lines = lines(sizing, directions, self._floating)
        self._sizes = lines(sizing, directions, self._magnitude)
        self._endless = np.isinf(sizing.upper)
        self._upper = np.where(self._endless, sizing.lower, sizing.upper)
        for line, size in zip(self.lines[:1], self._sizes[:1], strict=True):
            least = line.p[0] + self._floating.least(line.p[1], sizing.lower, self._upper)
            most = size.p[0] + self._magnitude.least(size.p[1], sizing.lower, self._upper)
            if not least > growth(_roundings(sizing, 1)) * most or np.any(line.p[1][self._endless] < 0):
                raise SolverError(
                    "the rigid body of a proof has no inertia in part of the box; raise its bounds"
                )

    def cut(self, leaf: Leaf) -> tuple[float, Array]:
        """Constant and gradient of what the multipliers of a piece without sides say is not negative."""
        constant, gradient = _lagrangian(
            self._sizing, self.lines, (), replace(leaf, ray=True), self._floating
        )
        return -float(constant), -gradient

    def value(self, path: Path, leaf: Leaf) -> tuple[float, float]:
        """What one piece proves, and its allowance.

        Raises
        ------
        SolverError
            If a multiplier is negative, or does not fit the sizing.
        """
        sizing = self._sizing
        _refuse(sizing, self._directions, path, leaf)
        constant, gradient = _lagrangian(sizing, self.lines, path, leaf, self._floating)
        most, size = _lagrangian(sizing, self._sizes, path, leaf, self._magnitude)
        error = growth(_roundings(sizing, sum(v.shape[1] for v in leaf.vectors)))
        # A parameter without end may not lower the bound at all, rounding included.
        if np.any(gradient[self._endless] < error * size[self._endless]):
            return -inf, 0.0
        allowance = float(error * (most + self._magnitude.least(size, sizing.lower, self._upper)))
        value = float(constant + self._floating.least(gradient, sizing.lower, self._upper)) - allowance
        return (inf if value > 0 else -inf, 0.0) if leaf.ray else (value, allowance)

    def exact_value(self, path: Path, leaf: Leaf, known: tuple[Lines, ...], a: Exact) -> float:
        """What one piece proves in rational arithmetic.

        Raises
        ------
        SolverError
            As `value`.
        """
        sizing = self._sizing
        _refuse(sizing, self._directions, path, leaf)
        constant, gradient = _lagrangian(sizing, known, path, leaf, a)
        if any(g < 0 for g in gradient[self._endless]):
            return -inf
        value = constant + a.least(gradient, sizing.lower, self._upper)
        value = value if isinstance(value, Fraction) else value.item()
        if leaf.ray:
            return inf if value > 0 else -inf
        down = float(value)
        return down if Fraction(down) <= value else nextafter(down, -inf)


def pairing(form: AffineForm, u: Array, v: Array, a: Arithmetic) -> Affine:
    """Constant and gradient of Σ uᵀ F(x) v over the columns of u and v."""
    products = (a.rows(form.rows, u) * a.rows(form.rows, v)).sum(axis=1)
    return (a.number(form.constant) * products).sum(), a.columns(form.slope, products)


def quadratic(requirement: Requirement, vectors: Array, others: Array, a: Arithmetic) -> Affine:
    """Constant and gradient of Σ q over the columns (u, τ), or of its bilinear form with other columns."""
    u, v = vectors[:-1], others[:-1]
    constant, gradient = pairing(requirement.elastic, u, v, a)
    if requirement.inertial is not None:
        square = a.number(requirement.rate) * a.number(requirement.rate)
        mass = pairing(requirement.inertial, u, v, a)
        constant, gradient = a.minus(constant, square * mass[0]), a.minus(gradient, square * mass[1])
    if requirement.load is not None:
        tau, other = a.number(vectors[-1]), a.number(others[-1])
        load = a.number(requirement.load)
        work = (load[:, None] * (a.number(u) * other + a.number(v) * tau)).sum()
        constant = a.minus(constant, work) + a.number(requirement.limit) * (tau * other).sum()
    return constant, gradient


@dataclass(frozen=True)
class Lines:
    """uᵀ S u, Q = −rᵀ S u and P = −rᵀ S r of one direction u, linear functions of the parameters."""

    square: Affine
    q: Affine
    p: Affine

    def side(self, at: float, above: bool, a: Arithmetic) -> Affine:
        """Q − t P above, t P − Q below: what is not negative on a side of a piece."""
        t = a.number(at)
        tilted = t * self.p[0], t * self.p[1]
        more, less = (self.q, tilted) if above else (tilted, self.q)
        return a.minus(more[0], less[0]), a.minus(more[1], less[1])

    def secant(self, low: float, high: float, a: Arithmetic) -> Affine:
        """Squared form + (t₁ + t₂) Q − t₁ t₂ P, which is not negative where t₁ ≤ t ≤ t₂."""
        both, product = a.number(low) + a.number(high), a.number(low) * a.number(high)
        return (
            a.minus(self.square[0] + both * self.q[0], product * self.p[0]),
            a.minus(self.square[1] + both * self.q[1], product * self.p[1]),
        )


def lines(sizing: Sizing, directions: Array, a: Arithmetic) -> tuple[Lines, ...]:
    """What the cuts of each direction (n, d) are made of."""
    if sizing.turning is None:
        return ()
    requirement = sizing.requirements[sizing.turning]
    p = _coupling(requirement, None, a)
    vectors = np.vstack([directions, np.zeros(directions.shape[1])])
    return tuple(
        Lines(
            quadratic(requirement, vectors[:, [k]], vectors[:, [k]], a),
            _coupling(requirement, directions[:, [k]], a),
            p,
        )
        for k in range(directions.shape[1])
    )


def _coupling(requirement: Requirement, u: Array | None, a: Arithmetic) -> Affine:
    """−rᵀ S(x) u of a displacement (n, 1), or of the rigid body itself."""
    assert requirement.rigid is not None and requirement.inertial is not None
    rigid = requirement.rigid[:, None]
    square = a.number(requirement.rate) * a.number(requirement.rate)
    mass = pairing(requirement.inertial, rigid, rigid if u is None else u, a)
    spring = pairing(requirement.elastic, rigid, rigid if u is None else u, a)
    return a.minus(square * mass[0], spring[0]), a.minus(square * mass[1], spring[1])


def interval(path: Path, direction: int) -> tuple[float, float]:
    """The range of t of one direction on a piece."""
    low = max((at for k, at, above in path if k == direction and above), default=-inf)
    high = min((at for k, at, above in path if k == direction and not above), default=inf)
    return low, high


def _lagrangian(sizing: Sizing, known: tuple[Lines, ...], path: Path, leaf: Leaf, a: Arithmetic) -> Affine:
    """κ and g of the equation of this module."""
    if leaf.ray:
        constant, gradient = a.number(0.0), a.number(np.zeros_like(sizing.cost))
    else:
        constant, gradient = a.number(sizing.cost_constant), a.number(sizing.cost)
    for requirement, vectors in zip(sizing.requirements, leaf.vectors, strict=True):
        if vectors.shape[1]:
            q = quadratic(requirement, vectors, vectors, a)
            constant, gradient = a.minus(constant, q[0]), a.minus(gradient, q[1])
    if sizing.limits.size:
        multiplier = a.number(leaf.limits)
        constant = a.minus(constant, (multiplier * a.number(sizing.limits)).sum())
        gradient = gradient + (multiplier[:, None] * a.number(sizing.normals)).sum(axis=0)
    cuts = [
        (weight, known[k].side(at, above, a))
        for weight, (k, at, above) in zip(leaf.sides, path, strict=True)
        if weight
    ]
    cuts += [
        (weight, known[k].secant(*interval(path, k), a)) for k, weight in enumerate(leaf.secants) if weight
    ]
    for weight, cut in cuts:
        constant = a.minus(constant, a.number(weight) * cut[0])
        gradient = a.minus(gradient, a.number(weight) * cut[1])
    return constant, gradient


def _refuse(sizing: Sizing, directions: Array, path: Path, leaf: Leaf) -> None:
    """Multipliers that are negative, not finite, or where they have no meaning."""
    multipliers = np.concatenate([leaf.limits, leaf.secants, leaf.sides])
    if not (np.all(np.isfinite(multipliers)) and np.all(multipliers >= 0)):
        worst = multipliers[~(np.isfinite(multipliers) & (multipliers >= 0))][0]
        raise SolverError(f"a multiplier of a proof is {worst:g}; it must be zero or more")
    sizes = [v.shape[0] for v in leaf.vectors]
    if sizes != [r.size + 1 for r in sizing.requirements] or leaf.limits.size != sizing.limits.size:
        raise SolverError(
            f"a proof with vectors of {sizes} entries does not fit the requirements; make it anew"
        )
    splits = 0 if sizing.turning is None else directions.shape[1]
    if leaf.secants.size > splits or any(not 0 <= k < splits for k, _, _ in path):
        raise SolverError(
            f"a piece of a proof with {leaf.secants.size} secants and cuts along {sorted({k for k, _, _ in path})} "
            f"does not fit {splits} directions; make it anew"
        )
    if leaf.sides.size != len(path):
        raise SolverError(
            f"a proof with {leaf.sides.size} multipliers for {len(path)} sides does not fit; make it anew"
        )
    if not all(np.all(np.isfinite(v)) for v in (*leaf.vectors, directions)):
        raise SolverError("a vector of a proof is not finite; make it anew")
    if sizing.turning is not None and leaf.vectors[sizing.turning].shape[1]:
        raise SolverError("a structure that may turn has no vectors, only secants; split it by directions")
    for k in np.flatnonzero(leaf.secants):
        if not np.all(np.isfinite(interval(path, int(k)))):
            raise SolverError("a secant needs a piece with two ends; split it further")


def _roundings(sizing: Sizing, columns: int) -> int:
    """More roundings than any product passes through: a sum counts its terms, a factor is one."""
    forms = [f for r in sizing.requirements for f in (r.elastic, r.inertial) if f is not None]
    longest = max((f.constant.size for f in forms), default=0)
    return longest + sizing.cost.size + sizing.limits.size + 16 * (len(forms) + columns) + 64
