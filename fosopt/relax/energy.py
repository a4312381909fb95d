"""Sizing by second-order cones: complementary energy under guessed inertial loads.

S = A − ω² B ⪰ 0 bounds two quadratic forms against each other. With a guess v for the motion, B ⪰ 0 gives
uᵀ B u ≥ 2 uᵀ B v − vᵀ B v, and with the load g = τ f + ω² B(x) v every structure that meets a requirement meets

    max over u of 2 uᵀ g − uᵀ A(x) u = gᵀ A(x)⁻¹ g ≤ γ τ² + ω² vᵀ B(x) v.

The left-hand side is the complementary energy: the least Σ qₑ²/aₑ(x) over forces q in equilibrium with g, Rᵀ q = g,
a second-order cone for each bar [Lobo1998, BenTal1997]. Loads and the right-hand side are linear in x. So for any
guesses the program is an outer approximation of the sizing, exact for compliance and reference inertia (ω = 0), exact
for a frequency or a receptance where v is the motion of the optimum; the error is of second order in v. Its
equilibrium multipliers are the displacements u of a proof.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from fosopt.ops import Array
from fosopt.relax.multipliers import solved
from fosopt.relax.sizing import Requirement, Sizing

# Multipliers below this share of the largest are zero.
_IDLE = 1e-9


@dataclass(frozen=True)
class Outer:
    """The least cost of an outer approximation.

    Attributes
    ----------
    x
        (p,) parameters; None where even the outer approximation has none.
    vectors
        Per requirement (n + 1, k) displacements (u, τ), scaled by the roots of their multipliers.
    violation
        How much of each limit had to be given way, relative; zero unless asked for.
    """

    x: Array | None
    vectors: tuple[Array, ...]
    violation: float


@dataclass(frozen=True)
class _Block:
    """One guess of one requirement, in scaled unknowns: forces q, energies e, and the reaction of a free hub."""

    equilibrium: sparse.csr_array  # (n, k) forces on the degrees of freedom
    reaction: Array  # (n, h)
    by_x: sparse.csr_array  # (n, p) inertial load
    load: Array  # (n,)
    limit_by_x: Array  # (p,)
    limit: float
    stiffness_by_x: sparse.csr_array  # (k, p)
    stiffness: Array  # (k,)
    displacement: Array  # (n,) unit of u
    tau: float


def outer(
    sizing: Sizing,
    guesses: Sequence[Array],
    around: Array,
    hyperplane: Array | None = None,
    give_way: bool = False,
) -> Outer:
    """Solve the outer approximation.

    Parameters
    ----------
    guesses
        Per requirement (n, k) motions v; with a load, no guess is a guess of no motion.
    around
        (p,) parameters whose stiffnesses set the scale.
    hyperplane
        (n,) y of a structure that may turn: only motions with yᵀ u = 0 count. An inner approximation then, since the
        structure has one such hyperplane and this may be another.
    give_way
        Whether to look for the least violation instead of the least cost.
    """
    scale = sizing.scale
    p = scale.size
    blocks: list[_Block] = []
    owner: list[int] = []
    for i, (requirement, guess) in enumerate(zip(sizing.requirements, guesses, strict=True)):
        y = hyperplane if requirement.rigid is not None else None
        columns = guess.T if guess.shape[1] or requirement.load is None else np.zeros((1, requirement.size))
        for v in columns:
            blocks.append(_block(requirement, v, around, scale, y))
            owner.append(i)
    price = sizing.cost * scale
    unit = max(float(np.abs(price).sum()), 1e-300)
    sizes = np.concatenate(
        [[p, 1], *([b.stiffness.size, b.stiffness.size, b.reaction.shape[1]] for b in blocks)]
    )
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    total = int(starts[-1])

    def placed(*parts: tuple[int, sparse.sparray]) -> sparse.csr_array:
        entries = [(part.tocoo(), starts[position]) for position, part in parts]
        data = np.concatenate([e.data for e, _ in entries])
        rows = np.concatenate([e.coords[0] for e, _ in entries])
        columns = np.concatenate([e.coords[1] + start for e, start in entries])
        return sparse.csr_array((data, (rows, columns)), shape=(parts[0][1].shape[0], total))

    equal, equal_to, below, below_to, cones, cones_to = [], [], [], [], [], []
    way = sparse.csr_array(np.array([[-1.0 if give_way else 0.0]]))
    for j, b in enumerate(blocks):
        q, e, h = 2 + 3 * j, 3 + 3 * j, 4 + 3 * j
        equal.append(placed((0, -b.by_x), (q, b.equilibrium), (h, sparse.csr_array(b.reaction))))
        equal_to.append(b.load)
        ones = sparse.csr_array(np.ones((1, b.stiffness.size)))
        below.append(placed((0, sparse.csr_array(-b.limit_by_x[None, :])), (1, way), (e, ones)))
        below_to.append(np.array([b.limit]))
        identity = sparse.eye_array(b.stiffness.size, format="csr")
        # 4 e a ≥ (2 q)², written as |(2 q, e − a)| ≤ e + a, three rows for each member.
        cone = [
            placed((0, -b.stiffness_by_x), (e, -identity)),
            placed((0, b.stiffness_by_x), (e, -identity)),
            placed((q, -2 * identity)),
        ]
        turn = np.arange(3 * b.stiffness.size).reshape(3, -1).T.ravel()
        cones.append(sparse.vstack(cone, format="csr")[turn])
        cones_to.append(np.stack([b.stiffness, -b.stiffness, np.zeros_like(b.stiffness)], axis=1).ravel())
    finite = np.flatnonzero(np.isfinite(sizing.upper))
    identity = sparse.eye_array(p, format="csr")
    for row, limit in zip(sizing.normals, sizing.limits, strict=True):
        size = max(float((np.abs(row) * scale).sum()), 1e-300)
        below.append(placed((0, sparse.csr_array((row * scale / size)[None, :])), (1, way)))
        below_to.append(np.array([limit / size]))
    below += [placed((0, identity[finite])), placed((0, -identity)), placed((1, sparse.csr_array([[-1.0]])))]
    below_to += [sizing.upper[finite] / scale[finite], -sizing.lower / scale, np.zeros(1)]
    cost = np.zeros(total)
    if give_way:
        cost[p] = 1.0
    else:
        cost[:p] = price / unit
    right = np.concatenate([*equal_to, *below_to, *cones_to])
    n_equal, n_below = (sum(v.size for v in part) for part in (equal_to, below_to))
    kinds = [clarabel.ZeroConeT(n_equal), clarabel.NonnegativeConeT(n_below)]
    kinds += [clarabel.SecondOrderConeT(3)] * sum(b.stiffness.size for b in blocks)
    answer = solved(cost, sparse.vstack([*equal, *below, *cones]), right, kinds)
    status = str(answer.status)
    x = np.array(answer.x) if "Solved" in status else None
    return Outer(
        None if x is None else np.clip(scale * x[:p], sizing.lower, sizing.upper),
        _displacements(sizing, blocks, owner, np.array(answer.z), n_equal),
        0.0 if x is None else float(x[p]),
    )


def _block(requirement: Requirement, v: Array, around: Array, scale: Array, y: Array | None) -> _Block:
    """One guess, in units in which stiffnesses, energies and the loads of single members are about one."""
    elastic, p = requirement.elastic, scale.size
    now = elastic.weights(around)
    used = np.flatnonzero((now > 0) | (np.abs(elastic.slope).sum(axis=1) > 0))
    rows, now = elastic.rows[used], np.maximum(now[used], 1e-300)
    by_x = sparse.csr_array(elastic.slope[used] @ sparse.diags_array(scale))
    force = np.sqrt(now)
    dof = np.sqrt(np.asarray((rows.multiply(rows)).T @ now))
    dof = np.where(dof > 0, dof, 1.0)
    load = np.zeros(requirement.size) if requirement.load is None else requirement.load
    limit, limit_by_x, inertial = requirement.limit, np.zeros(p), sparse.csr_array((requirement.size, p))
    if requirement.inertial is not None:
        mass, square = requirement.inertial, requirement.rate**2
        motion = mass.rows @ v
        slope = sparse.csr_array(mass.slope @ sparse.diags_array(scale))
        limit = limit + square * float(motion**2 @ mass.constant)
        limit_by_x = square * (slope.T @ motion**2)
        load = load + square * (mass.rows.T @ (motion * mass.constant))
        inertial = square * sparse.csr_array(mass.rows.T @ (sparse.diags_array(motion) @ slope))
    energy = limit + float(limit_by_x @ (around / scale))
    root = np.sqrt(energy) if energy > 0 else 1.0
    left = sparse.diags_array(1 / dof)
    return _Block(
        equilibrium=sparse.csr_array(left @ rows.T @ sparse.diags_array(force)),
        reaction=np.zeros((dof.size, 0)) if y is None else (y / dof / np.abs(y / dof).max())[:, None],
        by_x=sparse.csr_array(left @ inertial / root),
        load=load / dof / root,
        limit_by_x=limit_by_x / root**2,
        limit=limit / root**2,
        stiffness_by_x=sparse.csr_array(sparse.diags_array(1 / now) @ by_x),
        stiffness=elastic.constant[used] / now,
        displacement=1 / dof,
        tau=0.0 if requirement.load is None else 1 / root,
    )


def _displacements(
    sizing: Sizing, blocks: Sequence[_Block], owner: Sequence[int], dual: Array, start: int
) -> tuple[Array, ...]:
    """Displacements from the multipliers of equilibrium z and of the limit μ: u = −z/(2 μ), times √μ."""
    found: list[list[Array]] = [[] for _ in sizing.requirements]
    limits = np.maximum(dual[start : start + len(blocks)], 0.0)
    offset = 0
    for i, b, limit in zip(owner, blocks, limits, strict=True):
        z = dual[offset : offset + b.load.size]
        offset += b.load.size
        if limit > _IDLE * limits.max(initial=0.0):
            root = np.sqrt(limit)
            found[i].append(np.append(-z * b.displacement / (2 * root), root * b.tau))
    return tuple(
        np.stack(columns, axis=1) if columns else np.zeros((r.size + 1, 0))
        for r, columns in zip(sizing.requirements, found, strict=True)
    )
