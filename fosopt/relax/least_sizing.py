"""The least sizing: outer approximations by second-order cones, refined at what they find.

Each round guesses the motions of the structure found last, solves the outer approximation of `energy`, and lets its
displacements prove what they can. Cost and proof close in on each other from the first round; for a simple frequency
the error of the guess is squared each time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, sqrt

import numpy as np
from scipy import linalg

from fosopt.ops import Array
from fosopt.relax.energy import Outer, outer
from fosopt.relax.multipliers import best_leaf, strongest
from fosopt.relax.proof import Proof
from fosopt.relax.sizing import Requirement, Sizing

ROUNDS = 15
# Modes within this of the required frequency (relative, squared) are guesses too.
_NEAR = 1e-3
# A guess this parallel to a newer one (squared cosine) is dropped, because solvers dislike twins. Where progress is
# slow, as where modes meet or several structures are optimal, even near twins are needed.
_PARALLEL, _NEARLY = 0.999, 1 - 1e-6
_MOST_GUESSES = 12
# Rounds without progress after which there is none to come.
_STILL = 2
# Limits that give way by this share of them are met.
_MET = 1e-7
# Requirements are tightened by these multiples of what an outer approximation misses, and by this at least (relative).
_TIGHTER, _LEAST_TIGHTER = (2.0, 20.0, 200.0), 1e-10


@dataclass(frozen=True)
class Least:
    """What the rounds found.

    Attributes
    ----------
    x
        (p,) parameters that meet every requirement; None if none were found.
    outer
        (p,) parameters of the last outer approximation, a good start for other solvers.
    proof
        Of the least cost, or that no parameters meet the requirements. Of a structure that may turn there is none here.
    vectors
        Per requirement (n + 1, k) displacements.
    rounds
        How many.
    """

    x: Array | None
    outer: Array
    proof: Proof | None
    vectors: tuple[Array, ...]
    rounds: int


def least_sizing(sizing: Sizing, around: Array, tolerance: float = 1e-9, rounds: int = ROUNDS) -> Least:
    """Minimize the cost of a sizing, starting anywhere in its box.

    Parameters
    ----------
    around
        (p,) parameters to start from.
    tolerance
        Gap between cost and proof to stop at, relative to the cost.
    """
    x = np.clip(around, sizing.lower, sizing.upper)
    guesses = [np.zeros((r.size, 0)) for r in sizing.requirements]
    best, proof, last, still, short, parallel = -inf, None, -inf, 0, inf, _PARALLEL
    responses = [_response(r, x) for r in sizing.requirements]
    for count in range(1, rounds + 1):
        guesses = _renewed(sizing, x, guesses, responses, parallel)
        found = outer(sizing, guesses, x, hyperplane(sizing, x))
        if found.x is None:
            back = _least_violation(sizing, x, guesses, rounds)
            if back.violation > _MET:
                proof = prove(sizing, back.vectors) if sizing.turning is None else None
                return Least(None, x, proof, back.vectors, count)
            # The hyperplane of a structure that misses the requirements may leave no other structure.
            found = back
        assert found.x is not None
        x = found.x
        cost = sizing.value(x)
        responses = [_response(r, x) for r in sizing.requirements]
        close = tolerance * abs(cost)
        if sizing.turning is None:
            new = prove(sizing, found.vectors)
            value, _ = new.value(sizing)
            if value > best:
                best, proof = value, new
            met = min((margin for margin, _ in responses), default=inf) >= -max(_MET, 10 * tolerance)
            if met and cost >= best - close:
                break
            parallel = _NEARLY if best - cost > short / 2 else parallel
            short = best - cost
        still = still + 1 if abs(cost - last) <= close else 0
        if still >= _STILL:
            break
        last = cost
    return Least(_inside(sizing, found, guesses), x, proof, found.vectors, count)


def prove(sizing: Sizing, vectors: Sequence[Array]) -> Proof:
    """The best proof from displacements (n + 1, k) of each requirement."""
    bases = [strongest(v, entry_size(r)) for r, v in zip(sizing.requirements, vectors, strict=True)]
    return Proof(best_leaf(sizing, bases).leaf, np.zeros((0, 0)))


def entry_size(requirement: Requirement) -> Array:
    """(n + 1,) Typical displacements of the degrees of freedom: of equal energy in the stiffest rows."""
    rows = requirement.elastic.rows
    size = np.asarray(abs(rows).sum(axis=0)).ravel()
    return np.append(1 / np.where(size > 0, size, 1.0), 1.0)


def hyperplane(sizing: Sizing, x: Array) -> Array | None:
    """(n,) y = S r/rᵀ S r, to which the elastic motions of a structure that may turn are orthogonal."""
    if sizing.turning is None:
        return None
    requirement = sizing.requirements[sizing.turning]
    assert requirement.rigid is not None
    momentum = requirement.matrix(x) @ requirement.rigid
    return np.asarray(momentum / (momentum @ requirement.rigid))


def motions(requirement: Requirement, x: Array, count: int = 4) -> tuple[Array, Array]:
    """(k,) ω_k²/ω² and (n, k) modes, the lowest ones that a frequency requirement counts."""
    assert requirement.inertial is not None
    first = 0 if requirement.rigid is None else 1
    last = min(first + count, requirement.size) - 1
    squares, shapes = linalg.eigh(
        requirement.elastic.matrix(x), requirement.inertial.matrix(x), subset_by_index=[first, last]
    )
    return squares / requirement.rate**2, shapes


def modal_vectors(sizing: Sizing, x: Array) -> tuple[Array, ...]:
    """Displacements (n + 1, k) of each requirement from the structure at `x` alone, by no optimization.

    The modes at the required frequency, or the displacement under the load: at an optimum these are multipliers of
    the requirement.    [Ohsaki1999]
    """
    found = []
    for requirement in sizing.requirements:
        if requirement.load is None:
            squares, shapes = motions(requirement, x)
            near = shapes[:, squares <= squares[0] + _NEAR]
            found.append(np.vstack([near, np.zeros(near.shape[1])]))
        else:
            u = linalg.solve(requirement.matrix(x), requirement.load, assume_a="sym")
            found.append(np.append(u, 1.0)[:, None])
    return tuple(found)


def _response(requirement: Requirement, x: Array) -> tuple[float, Array]:
    """How far inside a structure is, see `Requirement.margin`, and (n, k) its motions as guesses."""
    if requirement.inertial is None:
        return requirement.margin(x), np.zeros((requirement.size, 0))
    squares, shapes = motions(requirement, x)
    if requirement.load is None:
        return float(squares[0] - 1), shapes[:, (squares <= 1 + _NEAR) | (np.arange(squares.size) == 0)]
    if squares[0] > 1:
        u = linalg.solve(requirement.matrix(x), requirement.load, assume_a="sym")
        return float(1 - requirement.load @ u / requirement.limit), u[:, None]
    # Beyond resonance: a motion so large that the load does not count, and one that just uses up the limit.
    large = shapes[:, :1] * np.sqrt(1e6 * requirement.limit) / requirement.rate
    below = replace(requirement, rate=requirement.rate * np.sqrt(0.9 * max(squares[0], 0.0)))
    u = linalg.solve(below.matrix(x), requirement.load, assume_a="sym")
    return -inf, np.column_stack([large, u * (requirement.limit / (requirement.load @ u))])


def _renewed(
    sizing: Sizing,
    x: Array,
    guesses: Sequence[Array],
    responses: Sequence[tuple[float, Array]],
    parallel: float = _PARALLEL,
) -> list[Array]:
    """Per requirement (n, k) the motions of the structure at `x`, and the old guesses that differ from them."""
    found = []
    for requirement, old, (_, new) in zip(sizing.requirements, guesses, responses, strict=True):
        if requirement.inertial is None or not old.shape[1]:
            found.append(new)
            continue
        mass = requirement.inertial.matrix(x)
        sizes = np.einsum("nk,nk->k", new, mass @ new), np.einsum("nk,nk->k", old, mass @ old)
        cosine = (new.T @ mass @ old) ** 2 / np.outer(*sizes)
        if requirement.load is not None:
            # Under a load the size of a motion counts as well.
            cosine = cosine * np.minimum.outer(*sizes) / np.maximum.outer(*sizes)
        found.append(np.hstack([new, old[:, cosine.max(axis=0) < parallel]])[:, :_MOST_GUESSES])
    return found


def _inside(sizing: Sizing, found: Outer, guesses: Sequence[Array]) -> Array | None:
    """Parameters near the outer approximation that meet everything: the same with all requirements tightened."""
    x = found.x
    assert x is not None
    missed = -sizing.margin(x)
    if missed <= 0:
        return x
    size = np.abs(sizing.normals) @ np.abs(x) + np.abs(sizing.limits)
    for factor in _TIGHTER:
        by = min(max(factor * missed, _LEAST_TIGHTER), 0.5)
        tight = replace(
            sizing,
            requirements=tuple(
                replace(r, rate=r.rate * sqrt(1 + by))
                if r.load is None
                else replace(r, limit=r.limit * (1 - by))
                for r in sizing.requirements
            ),
            limits=sizing.limits - by * size,
        )
        inside = outer(tight, guesses, x, hyperplane(sizing, x)).x
        if inside is not None and sizing.margin(inside) >= 0:
            return inside
    return None


def _least_violation(sizing: Sizing, x: Array, guesses: Sequence[Array], rounds: int) -> Outer:
    """The outer approximation whose limits have to give way least, refined until it meets them or none does."""
    best = outer(sizing, guesses, x, hyperplane(sizing, x), give_way=True)
    for _ in range(rounds):
        if best.x is None or best.violation <= _MET or np.isinf(_proven(sizing, best)):
            break
        guesses = _renewed(sizing, best.x, guesses, [_response(r, best.x) for r in sizing.requirements])
        found = outer(sizing, guesses, best.x, hyperplane(sizing, best.x), give_way=True)
        if found.x is None:
            break
        best = found
    return best


def _proven(sizing: Sizing, found: Outer) -> float:
    """What the displacements of an outer approximation prove; nothing for a structure that may turn."""
    return prove(sizing, found.vectors).value(sizing)[0] if sizing.turning is None else -inf
