"""The lowest modes of a large structure, and what its ports reach beside them, by sparse factorizations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from fosopt.errors import ModelError, SolverError
from fosopt.ops import Array
from fosopt.structure import Structure

# Elongation of a bar under a motion, over the sum of what it would have at each end, that counts as none.
_STILL = 1e-9
# A pivot at rounding level of its own diagonal entry is a motion without stiffness.
_PIVOT = 1e-14
_SEARCHES = 4
# A port's shapes are enough when the last ones carry less than this of the hardest answer, or less than the second and
# no longer fall: what rounding in a long truss leaves of it.
_ENOUGH, _ROUNDED = 1e-12, 1e-9
_MOST_STEPS = 120
_CHECK = 4
# Lanczos' method slows with the square of what it is asked for at once, so that many modes come slice by slice.
_SLICE = 80
_OVERLAP = 1.3
_HALVINGS = 4
_DEPENDENT = 1e-10


@dataclass(frozen=True)
class SparsePencil:
    """Stiffness and mass of one design as sparse matrices, with the factors that modes and static shapes need.

    Attributes
    ----------
    stiffness_rows, mass_rows
        (k, n) and (m, n), rows times the root of their weights: K = BᵀB and M = DᵀD.
    stiffness, mass
        (n, n).
    rigid
        (n, 0) or (n, 1), the mass-normalized rotation about the hub where nothing holds it.
    grounded, mass_factors
        Factors of the stiffness, with a spring at a free hub, and of the mass.
    """

    stiffness_rows: sparse.csr_array
    mass_rows: sparse.csr_array
    stiffness: sparse.csc_array
    mass: sparse.csc_array
    rigid: Array
    grounded: Any
    mass_factors: Any

    def flexibility(self, loads: Array) -> Array:
        """Elastic displacements under (n, c) loads that rigid-body inertia balances, orthogonal to rigid motion."""
        balanced = loads - self.mass @ (self.rigid @ (self.rigid.T @ loads))
        moved = self.grounded.solve(balanced)
        return np.asarray(moved - self.rigid @ (self.rigid.T @ (self.mass @ moved)))

    def count_below(self, eigenvalue: float) -> int:
        """Number of eigenvalues below a given one: negative pivots of K − μM.    [Parlett1998] Sec. 3.3"""
        for nudge in (0.0, 1e-7, -1e-7):
            factors = _factors(self.stiffness - eigenvalue * (1 + nudge) * self.mass)
            if factors is not None and np.array_equal(factors.perm_r, factors.perm_c):
                return int(np.count_nonzero(factors.U.diagonal() < 0))
        raise SolverError(f"modes below {eigenvalue**0.5:g} rad/s cannot be counted; choose another limit")


def sparse_pencil(structure: Structure, stiffness: Array, mass: Array) -> SparsePencil:
    """Assemble and factorize, at the weights of the rows.

    Raises
    ------
    ModelError
        If a degree of freedom has no mass, or the structure is a mechanism.
    """
    b, d = (
        sparse.csr_array(sparse.diags_array(np.sqrt(weights)) @ rows)
        for rows, weights in ((structure.stiffness_rows, stiffness), (structure.mass_rows, mass))
    )
    k, m = sparse.csc_array(b.T @ b), sparse.csc_array(d.T @ d)
    mass_factors = _factors(m)
    loose = None if mass_factors is None else _loosest(m, mass_factors)
    if mass_factors is None or loose is not None:
        where = "" if loose is None else f" at '{structure.dofs[loose]}'"
        raise ModelError(
            f"modes cannot be computed: no mass{where}; every degree of freedom needs mass above zero"
        )
    turned = mass_factors.solve(d.T @ (np.sqrt(mass) * structure.hub_arm))
    free = np.abs(b @ turned) <= _STILL * (np.abs(b) @ np.abs(turned))
    rigid, ground = np.zeros((k.shape[0], 0)), k
    hub = structure.port("hub")
    if free.all() and hub.any():
        rigid = (turned / np.linalg.norm(d @ turned))[:, None]
        ground = k + sparse.diags_array(np.abs(hub) * k.diagonal())
    grounded = _factors(ground)
    loose = None if grounded is None else _loosest(ground, grounded)
    if grounded is None or loose is not None:
        where = "" if loose is None else f", one at '{structure.dofs[loose]}'"
        raise ModelError(
            f"structure is a mechanism: motions without stiffness beside a rotation about the hub{where}; "
            "only one rotation about the hub may be free: add bars or supports"
        )
    return SparsePencil(b, d, k, m, rigid, grounded, mass_factors)


def _factors(matrix: sparse.csc_array) -> Any:
    """LU factors of a symmetric matrix with pivots on the diagonal, None where one is exactly zero."""
    try:
        return sparse_linalg.splu(
            sparse.csc_matrix(matrix),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:
        return None


def _loosest(matrix: sparse.csc_array, factors: Any) -> int | None:
    """The row of a positive definite matrix whose pivot is lost in rounding."""
    pivots = factors.U.diagonal()[factors.perm_c] / matrix.diagonal()
    worst = int(np.argmin(pivots))
    return None if pivots[worst] > _PIVOT else worst


def lowest_modes(pencil: SparsePencil, count: int) -> tuple[Array, Array]:
    """The lowest modes, a rigid-body mode first, none left out.

    By Lanczos' method on the elastic flexibility [Lehoucq1998], then about shifts further up [Grimes1994]; the pivots
    of K − μM say how many there must be, and a further search beside those found brings copies of repeated ones.

    Parameters
    ----------
    count
        At least so many, a few of the highest beyond it.

    Returns
    -------
    (c,), (n, c)
        Eigenvalues, ascending [rad²/s²], and mass-normalized shapes.

    Raises
    ------
    SolverError
        If modes stay missing.
    """
    n_rigid = pencil.rigid.shape[1]
    none = np.zeros((pencil.rigid.shape[0], 0))
    shapes = _slices(pencil, count - n_rigid) if count > 2 * _SLICE else None
    if shapes is None:
        shapes = _search(pencil, count - n_rigid, none, 0)
    for attempt in range(1, _SEARCHES):
        eigenvalue, shapes = ritz_shapes(pencil, shapes)
        missing = _missing(pencil, eigenvalue, n_rigid)
        if missing == 0:
            return np.concatenate([np.zeros(n_rigid), eigenvalue]), np.hstack([pencil.rigid, shapes])
        shapes = np.hstack([shapes, _search(pencil, max(missing, 1) + 2, shapes, attempt)])
    raise SolverError(
        "modes: some of the lowest were not found; choose a different number of modes, or change the start design"
    )


def _missing(pencil: SparsePencil, eigenvalue: Array, n_rigid: int) -> int:
    """Modes that are missing below the widest gap among the highest found."""
    limit, below = _gap(eigenvalue)
    return pencil.count_below(limit) - n_rigid - below


def _gap(eigenvalue: Array) -> tuple[float, int]:
    """The middle of the widest gap among the highest of ascending eigenvalues, and how many lie below it."""
    first = max(eigenvalue.size - max(6, eigenvalue.size // 10), 1)
    ratios = eigenvalue[first:] / eigenvalue[first - 1 : -1]
    last = first + int(np.argmax(ratios))
    return float(np.sqrt(eigenvalue[last - 1] * eigenvalue[last])), last


def _slices(pencil: SparsePencil, count: int) -> Array | None:
    """At least `count` of the lowest elastic shapes, about one shift after the other; None if a slice stays short."""
    n_rigid = pencil.rigid.shape[1]
    eigenvalue, shapes = ritz_shapes(pencil, _search(pencil, _SLICE, pencil.rigid[:, :0], 0))
    limit, below = _gap(eigenvalue)
    found = [shapes[:, :below]]
    known, lowest = below, eigenvalue[:below]
    while known < count:
        # Frequencies are about as far apart as those before.
        pitch = (lowest[-1] ** 0.5 - lowest[lowest.size // 2] ** 0.5) / (lowest.size - lowest.size // 2)
        for halving in range(_HALVINGS):
            half = _SLICE / 2 / _OVERLAP / 2**halving * pitch
            values, shapes = _about(pencil, (limit**0.5 + half) ** 2)
            new = values > limit
            if new.sum() < 3:
                continue
            above, more = _gap(values[new])
            if pencil.count_below(above) - n_rigid == known + more:
                break
        else:
            return None
        found.append(shapes[:, new][:, :more])
        known, lowest, limit = known + more, values[new][:more], above
    return np.hstack(found)


def _about(pencil: SparsePencil, shift: float) -> tuple[Array, Array]:
    """Modes closest to a shift on both sides, ascending."""
    n = pencil.mass.shape[0]
    factors = sparse_linalg.splu(sparse.csc_matrix(pencil.stiffness - shift * pencil.mass))
    inverse = sparse_linalg.LinearOperator((n, n), matvec=factors.solve, dtype=float)
    start = factors.solve(pencil.mass @ np.random.default_rng(0).standard_normal(n))
    values, shapes = _lanczos(pencil, _SLICE, shift, inverse, start)
    order = np.argsort(values)
    values, shapes = values[order], shapes[:, order]
    # The nearest on both sides: beyond the nearer end there may be others.
    reach = min(shift - values[0], values[-1] - shift) if values[0] < shift < values[-1] else 0.0
    inside = np.abs(values - shift) <= max(reach, 0.0) * (1 + 1e-12)
    return values[inside], shapes[:, inside]


def _search(pencil: SparsePencil, count: int, beside: Array, seed: int) -> Array:
    n = pencil.mass.shape[0]

    def apart(vectors: Array) -> Array:
        return vectors - beside @ (beside.T @ (pencil.mass @ vectors))

    def solve(load: Array) -> Array:
        return apart(pencil.flexibility(load - pencil.mass @ (beside @ (beside.T @ load))))

    start = solve(pencil.mass @ np.random.default_rng(seed).standard_normal(n))
    inverse = sparse_linalg.LinearOperator((n, n), matvec=solve, dtype=float)
    return _lanczos(pencil, count, 0.0, inverse, start)[1]


def _lanczos(
    pencil: SparsePencil, count: int, shift: float, inverse: Any, start: Array
) -> tuple[Array, Array]:
    try:
        values, shapes = sparse_linalg.eigsh(
            pencil.stiffness, k=count, M=pencil.mass, sigma=shift, OPinv=inverse, v0=start
        )
    except sparse_linalg.ArpackError as error:
        raise SolverError(
            f"modes: Lanczos' method stopped: {error}; choose another number of modes"
        ) from error
    return np.asarray(values), np.asarray(shapes)


def ritz_shapes(pencil: SparsePencil, shapes: Array) -> tuple[Array, Array]:
    """Rayleigh quotients, ascending, and mass-normalized shapes in the span of (n, c) `shapes`.

    Energies are sums of squares over the rows, which keeps the digits that K itself loses in a long truss.
    """
    elongation = pencil.stiffness_rows @ shapes
    eigenvalue, turn = linalg.eigh(elongation.T @ elongation, shapes.T @ (pencil.mass @ shapes), driver="gvd")
    return eigenvalue, shapes @ turn


def reached_shapes(pencil: SparsePencil, modes: Array, ports: Array, hardest: float) -> tuple[Array, Array]:
    """Shapes beside (n, c) `modes` in which (K − λM) x = e_p is solved for all λ up to `hardest`.

    The space of A e, A M A e, ... of the elastic flexibility A and the loads e at the ports, which is the same for
    every λ; it grows until the answer at `hardest` no longer needs its end.

    Returns
    -------
    (s,), (n, s)
        Rayleigh quotients [rad²/s²], mass-normalized shapes.
    """
    momentum = pencil.mass @ modes

    def beside(vectors: Array, basis: Array) -> Array:
        vectors = vectors - modes @ (momentum.T @ vectors)
        return vectors - basis @ (basis.T @ (pencil.mass @ vectors))

    # Each port in units of its own flexibility: what is left beside the modes may be nothing but rounding.
    unit = np.linalg.norm(pencil.mass_rows @ pencil.flexibility(ports), axis=0)
    loads = (ports - momentum @ (modes.T @ ports)) / np.where(unit > 0, unit, 1.0)
    scaled, share = loads, np.inf
    basis = np.zeros((modes.shape[0], 0))
    for step in range(1, _MOST_STEPS + 1):
        block = pencil.flexibility(loads)
        # Rounding is all that is left of what lies in the shapes already there.
        scale = 1.0 if step == 1 else float(np.linalg.norm(pencil.mass_rows @ block, axis=0).max())
        block = _orthonormal(pencil, beside(block, basis), _DEPENDENT * scale)
        # What a second pass takes more than half of was rounding.
        block = _orthonormal(pencil, beside(block, basis), 0.5)
        if block.shape[1] == 0:
            break
        basis = np.hstack([basis, block])
        if step % _CHECK == 0:
            before, share = share, _last_share(pencil, basis, scaled, hardest, block.shape[1])
            if share < _ENOUGH or _ROUNDED > share > before / 2:
                break
        loads = pencil.mass @ block
    return ritz_shapes(pencil, basis) if basis.size else (np.zeros(0), basis)


def _orthonormal(pencil: SparsePencil, shapes: Array, least: float) -> Array:
    """Mass-orthonormal shapes in the span of others, but for parts smaller than `least`."""
    size, turn = linalg.eigh(shapes.T @ (pencil.mass @ shapes))
    large = size > least**2
    return np.asarray(shapes @ (turn[:, large] / np.sqrt(size[large])))


def _last_share(pencil: SparsePencil, basis: Array, loads: Array, hardest: float, last: int) -> float:
    """What the last shapes of a basis carry of the answer to the loads, relative."""
    elongation = pencil.stiffness_rows @ basis
    answer = np.linalg.solve(elongation.T @ elongation - hardest * np.eye(basis.shape[1]), basis.T @ loads)
    size = np.linalg.norm(answer, axis=0)
    return float((np.linalg.norm(answer[-last:], axis=0)[size > 0] / size[size > 0]).max(initial=0.0))
