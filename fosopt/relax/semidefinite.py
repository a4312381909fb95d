"""The whole sizing as one semidefinite program: an independent and slow answer to the same question.

Nothing of `energy` is used: every requirement is a linear matrix inequality [Boyd1994], modeled with cvxpy
[Diamond2016] and solved by Clarabel [Goulart2024]. It is reliable for some twenty bays. The matrices are taken in
coordinates in which the stiffness at a given structure is the identity, because in meters and newtons solvers miss by
many percent and say "solved"; Clarabel's chordal decomposition stays off, because it does the same at fifty bays. The
solver's word counts for nothing in any case: its dual matrices become a `Proof`, and the two numbers must meet.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from fosopt.errors import ModelError, SolverError
from fosopt.ops import Array
from fosopt.relax.multipliers import best_scale
from fosopt.relax.proof import Judge, Leaf, Proof
from fosopt.relax.sizing import Requirement, Sizing

# Cost and proof of the same optimum must agree to this, and its parameters meet the requirements to this.
AGREEMENT = 1e-5


@dataclass(frozen=True)
class Claim:
    """What a solver says it found.

    Attributes
    ----------
    status
        In its words.
    x
        (p,) parameters.
    duals
        Per requirement (n + 1, n + 1) dual matrix, in the coordinates of the requirement.
    limits
        (m,) multipliers of the linear limits.
    """

    status: str
    x: Array
    duals: tuple[Array, ...]
    limits: Array


def semidefinite_proof(sizing: Sizing, around: Array) -> tuple[Array, Proof]:
    """Solve a sizing as a semidefinite program, and prove the answer.

    Parameters
    ----------
    around
        (p,) parameters whose stiffness sets the coordinates.

    Returns
    -------
    (p,), Proof
        The parameters found, and the proof of their cost.

    Raises
    ------
    ModelError
        For a structure that may turn: that program is not convex.
    SolverError
        If the solver's answer does not stand.
    """
    return checked(sizing, claimed(sizing, around))


def checked(sizing: Sizing, claim: Claim) -> tuple[Array, Proof]:
    """Hold a solver's claim against the requirements and against what its dual matrices prove.

    Raises
    ------
    SolverError
        If the parameters miss a requirement, or cost more than the proof by more than `AGREEMENT`.
    """
    x = np.clip(claim.x, sizing.lower, sizing.upper)
    vectors = []
    for dual in claim.duals:
        # Displacements and numbers τ differ by many decades: bring them to one size before anything is cut off.
        unit = np.sqrt(np.abs(np.diag(dual)))
        unit = np.where(unit > 0, unit, 1.0)
        size, turned = linalg.eigh((dual + dual.T) / (2 * np.outer(unit, unit)))
        # An indefinite matrix is no dual; its positive part is one, if a poorer one.
        vectors.append(unit[:, None] * turned * np.sqrt(np.maximum(size, 0.0)))
    limits = np.maximum(claim.limits, 0.0)
    leaf = Leaf(tuple(vectors), limits, np.zeros(0), np.zeros(0))
    judge = Judge(sizing, np.zeros((0, 0)))
    constant, gradient = judge.cut(leaf)
    scale = best_scale(sizing, constant, gradient)
    if not np.isfinite(scale):
        raise SolverError(
            f"the solver says '{claim.status}', but its dual proves that nothing meets the requirements"
        )
    leaf = Leaf(tuple(np.sqrt(scale) * v for v in vectors), scale * limits, np.zeros(0), np.zeros(0))
    proof = Proof(leaf, np.zeros((0, 0)))
    value, _ = proof.value(sizing)
    cost, margin = sizing.value(x), sizing.margin(x)
    if margin < -AGREEMENT:
        raise SolverError(
            f"the solver says '{claim.status}', but its structure misses a requirement by {-margin:.2g}"
        )
    if abs(cost - value) > AGREEMENT * abs(cost):
        raise SolverError(
            f"the solver says '{claim.status}' at {cost:.8g}, but its dual proves {value:.8g} only; use structure_floor"
        )
    return x, proof


def claimed(sizing: Sizing, around: Array) -> Claim:
    """Solve a sizing as a semidefinite program, and take the solver's word.

    Raises
    ------
    ModelError
        For a structure that may turn.
    """
    import cvxpy as cp

    if sizing.turning is not None:
        raise ModelError(
            "a structure that may turn has no semidefinite program; hold its hub or use structure_floor"
        )
    scale = sizing.scale
    p = scale.size
    xi = cp.Variable(p)
    finite = np.flatnonzero(np.isfinite(sizing.upper))
    box = [xi >= sizing.lower / scale, xi[finite] <= (sizing.upper / scale)[finite]]
    linear = []
    if sizing.limits.size:
        normals = sizing.normals * scale
        size = np.maximum(np.abs(normals).sum(axis=1), 1e-300)
        linear = [(normals / size[:, None]) @ xi <= sizing.limits / size]
    matrices, maps = [], []
    for requirement in sizing.requirements:
        constant, slope, back = _congruent(requirement, around, scale)
        n = back.shape[1]
        matrix: Any = constant.ravel() + slope @ xi
        matrices.append(matrix.reshape((n, n), order="C") >> 0)
        maps.append(back)
    price = sizing.cost * scale
    unit = float(np.abs(price).sum())
    program: Any = cp.Problem(cp.Minimize((price / unit) @ xi), [*box, *linear, *matrices])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate answer is judged, not believed
        program.solve(solver=cp.CLARABEL, chordal_decomposition_enable=False, tol_gap_rel=1e-9, tol_feas=1e-9)
    if xi.value is None:
        raise SolverError(f"the semidefinite program ended as '{program.status}'; relax a requirement")
    duals = [unit * back @ m.dual_value @ back.T for back, m in zip(maps, matrices, strict=True)]
    limits = unit * linear[0].dual_value / size if linear else np.zeros(0)
    return Claim(str(program.status), scale * xi.value, tuple(duals), limits)


def _congruent(requirement: Requirement, around: Array, scale: Array) -> tuple[Array, Array, Array]:
    """Matrix inequality where A(around) is the identity: constant, (N², p) slope, and the way back to displacements."""
    n, p = requirement.size, scale.size
    factor = linalg.cholesky(requirement.elastic.matrix(around), lower=True)
    back = linalg.solve_triangular(factor, np.eye(n), lower=True).T
    constant, slope = np.zeros((n, n)), np.zeros((n * n, p))
    parts = [(1.0, requirement.elastic)]
    if requirement.inertial is not None:
        parts.append((-(requirement.rate**2), requirement.inertial))
    for sign, form in parts:
        rows = form.rows @ back
        outer = np.einsum("mi,mj->mij", rows, rows).reshape(-1, n * n)
        constant += sign * (form.constant @ outer).reshape(n, n)
        slope += sign * (form.slope.T @ outer).T * scale
    if requirement.load is None:
        return constant, slope, np.vstack([back, np.zeros(n)])
    # The load's row and column, with the number τ in units in which the limit is one.
    tau = 1 / np.sqrt(requirement.limit)
    column = -tau * (back.T @ requirement.load)
    bordered = np.block([[constant, column[:, None]], [column, 1.0]])
    wide = np.zeros((n + 1, n + 1, p))
    wide[:n, :n] = slope.reshape(n, n, p)
    return bordered, wide.reshape(-1, p), linalg.block_diag(back, tau)
