"""The best proof that given displacements can give.

Every displacement is one linear inequality on the parameters, several of one requirement are a small linear matrix
inequality. Minimizing the cost over the box under them is a conic program with as many rows as displacements; its
multipliers make the proof. With a single inequality the best multiplier has a closed form: the bound is concave and
piecewise linear in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, sqrt
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from fosopt.ops import Array
from fosopt.relax.arithmetic import Floating
from fosopt.relax.proof import Leaf, Lines, Path, interval, quadratic
from fosopt.relax.sizing import Sizing

# More displacements than this of one requirement are compressed to their strongest combinations.
MOST_COMBINED = 4
# Combinations weaker than this (relative) say nothing new.
_WEAKEST = 1e-7
# A multiplier stays this far (relative) below where a parameter without upper bound would begin to pay.
_SHORT = 1e-10


@dataclass(frozen=True)
class Cut:
    """A constant and a gradient whose sum with x is not negative; matrices (r, r) and (r, r, p) for several."""

    constant: Array
    gradient: Array


@dataclass(frozen=True)
class BestLeaf:
    """A piece's multipliers, and the parameters its cuts allow at the least cost (None where not asked for)."""

    leaf: Leaf
    x: Array | None


def strongest(vectors: Array, weight: Array) -> Array:
    """(n + 1, r) Orthogonal combinations of columns that carry most of Σ (u, τ)(u, τ)ᵀ, four at most.

    Parameters
    ----------
    weight
        (n + 1,) size of the entries.
    """
    if vectors.shape[1] <= 1:
        return vectors
    u, size, _ = np.linalg.svd(vectors / weight[:, None], full_matrices=False)
    rank = min(int(np.count_nonzero(size > _WEAKEST * size[0])), MOST_COMBINED)
    return np.asarray(u[:, :rank] * size[:rank] * weight[:, None])


def best_scale(sizing: Sizing, constant: float, gradient: Array) -> float:
    """The ξ ≥ 0 with the largest cost₀ − ξ κ + Σ min over the box of (c − ξ g)ᵢ xᵢ; infinite where that has no end."""
    cost, low, high = sizing.cost, sizing.lower, sizing.upper
    span = high - low
    # Parameters at the minimum for a small ξ, and where each changes side.
    at_low = (cost > 0) | ((cost == 0) & (gradient < 0))
    start = np.where(at_low, low, high)
    slope = -constant - float(gradient @ np.where(gradient == 0, 0.0, start))
    ratio = np.divide(cost, gradient, out=np.full_like(cost, inf), where=gradient != 0)
    turns = np.flatnonzero((cost != 0) & (ratio > 0) & np.isfinite(ratio) & (span > 0))
    order = turns[np.argsort(ratio[turns])]
    scale = 0.0
    for i in order:
        if slope <= 0:
            return scale
        scale = float(ratio[i])
        if np.isinf(span[i]):
            return scale * (1 - _SHORT)
        slope -= abs(gradient[i]) * span[i]
    return scale if slope <= 0 else inf


def best_leaf(
    sizing: Sizing,
    bases: Sequence[Array],
    known: Sequence[Lines] = (),
    path: Path = (),
    where: bool = False,
) -> BestLeaf:
    """The best multipliers of one piece for the displacements (n + 1, r) of each requirement.

    Parameters
    ----------
    known, path
        Of the directions and the piece, for a structure that may turn.
    where
        Whether the parameters at the least cost are wanted.
    """
    owners: list[tuple[str, int]] = []
    cuts: list[Cut] = []

    def add(owner: tuple[str, int], constant: Any, gradient: Any) -> None:
        owners.append(owner)
        cuts.append(Cut(np.asarray(constant, dtype=float), np.asarray(gradient, dtype=float)))

    a = Floating()
    for i, (requirement, basis) in enumerate(zip(sizing.requirements, bases, strict=True)):
        r = basis.shape[1]
        if r == 1:
            add(("vectors", i), *quadratic(requirement, basis, basis, a))
        elif r > 1:
            pairs = [
                [quadratic(requirement, basis[:, [j]], basis[:, [k]], a) for k in range(r)] for j in range(r)
            ]
            add(
                ("vectors", i), [[p[0] for p in row] for row in pairs], [[p[1] for p in row] for row in pairs]
            )
    for i, (normal, limit) in enumerate(zip(sizing.normals, sizing.limits, strict=True)):
        add(("limits", i), limit, -normal)
    for i, (k, at, above) in enumerate(path):
        add(("sides", i), *known[k].side(at, above, a))
    for k, line in enumerate(known):
        ends = interval(path, k)
        if np.all(np.isfinite(ends)):
            add(("secants", k), *line.secant(*ends, a))
    empty = Leaf(
        tuple(np.zeros((r.size + 1, 0)) for r in sizing.requirements),
        np.zeros(sizing.limits.size),
        np.zeros(len(known)),
        np.zeros(len(path)),
    )
    x = None
    if len(cuts) == 1 and cuts[0].constant.ndim == 0 and not where:
        found = [np.ones(())]
    elif cuts:
        found, x = _conic(sizing, cuts)
    else:
        return BestLeaf(empty, np.where(sizing.cost >= 0, sizing.lower, sizing.upper))
    # One common factor repairs what a solver's tolerance left, exactly.
    constant = float(sum(np.sum(y * cut.constant) for y, cut in zip(found, cuts, strict=True)))
    gradient = sum(
        (np.tensordot(y, cut.gradient, y.ndim) for y, cut in zip(found, cuts, strict=True)),
        np.zeros_like(sizing.cost),
    )
    scale = best_scale(sizing, constant, gradient)
    ray = bool(np.isinf(scale))
    weights = found if ray else [scale * y for y in found]
    return BestLeaf(_assembled(empty, owners, weights, bases, ray), x)


def _assembled(
    leaf: Leaf, owners: Sequence[tuple[str, int]], weights: Sequence[Array], bases: Sequence[Array], ray: bool
) -> Leaf:
    vectors = list(leaf.vectors)
    numbers = {"limits": leaf.limits.copy(), "secants": leaf.secants.copy(), "sides": leaf.sides.copy()}
    for (kind, i), weight in zip(owners, weights, strict=True):
        if kind != "vectors":
            numbers[kind][i] = float(weight)
        elif weight.ndim == 0:
            vectors[i] = bases[i] * sqrt(float(weight))
        else:
            size, turned = np.linalg.eigh(weight)
            vectors[i] = bases[i] @ (turned * np.sqrt(np.maximum(size, 0.0)))
    return replace(leaf, vectors=tuple(vectors), ray=ray, **numbers)


def _conic(sizing: Sizing, cuts: Sequence[Cut]) -> tuple[list[Array], Array | None]:
    """Multipliers of each cut and the least x, by Clarabel [Goulart2024]; without x they prove there is none."""
    scale = sizing.scale
    sizes = np.array([np.abs(c.constant).max() + (np.abs(c.gradient) @ scale).max() for c in cuts])
    sizes = np.where(sizes > 0, sizes, 1.0)
    price = sizing.cost * scale
    unit = max(float(np.abs(price).sum()), 1e-300)
    p = price.size
    finite = np.flatnonzero(np.isfinite(sizing.upper))
    identity = sparse.eye_array(p, format="csr")
    rows: list[Any] = [identity[finite], -identity]
    right = [sizing.upper[finite] / scale[finite], -sizing.lower / scale]
    cones: list[Any] = []
    single = [i for i, cut in enumerate(cuts) if cut.constant.ndim == 0]
    for i in single:
        rows.append(sparse.csr_array(-(cuts[i].gradient * scale / sizes[i])[None, :]))
        right.append(np.array([float(cuts[i].constant) / sizes[i]]))
    cones.append(clarabel.NonnegativeConeT(finite.size + p + len(single)))
    several = [i for i in range(len(cuts)) if i not in single]
    for i in several:
        r = cuts[i].constant.shape[0]
        k, j = np.tril_indices(r)
        stretch = np.where(j == k, 1.0, sqrt(2)) / sizes[i]
        rows.append(sparse.csr_array(-(cuts[i].gradient[j, k] * scale) * stretch[:, None]))
        right.append(cuts[i].constant[j, k] * stretch)
        cones.append(clarabel.PSDTriangleConeT(r))
    answer = solved(price / unit, sparse.vstack(rows), np.concatenate(right), cones)
    duals = np.split(np.array(answer.z), np.cumsum([finite.size + p, len(single)]))
    found: list[Array] = [np.zeros(())] * len(cuts)
    for i, z in zip(single, duals[1], strict=True):
        found[i] = np.array(max(float(z), 0.0) * unit / sizes[i])
    rest = duals[2]
    for i in several:
        r = cuts[i].constant.shape[0]
        k, j = np.tril_indices(r)
        matrix = np.zeros((r, r))
        matrix[j, k] = rest[: k.size] / np.where(j == k, 1.0, sqrt(2))
        rest = rest[k.size :]
        matrix = matrix + np.triu(matrix, 1).T
        size, turned = np.linalg.eigh(matrix)
        found[i] = (turned * np.maximum(size, 0.0)) @ turned.T * (unit / sizes[i])
    return found, scale * np.array(answer.x) if "Solved" in str(answer.status) else None


def solved(cost: Array, rows: Any, right: Array, cones: list[Any], tolerance: float = 1e-10) -> Any:
    """Clarabel's answer to: minimize cost of x, right − rows x in the cones."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 100
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    nothing = sparse.csc_matrix((cost.size, cost.size))
    return clarabel.DefaultSolver(nothing, cost, sparse.csc_matrix(rows), right, cones, settings).solve()
