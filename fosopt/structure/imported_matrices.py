"""Modes of imported stiffness and mass matrices, with the static flexibility of what they leave out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from fosopt.ops import Array
from fosopt.structure.imported import ImportedModes, ModelUnits
from fosopt.structure.readers.common import bad

MOST_KEPT = 400
"""Size of a model up to which all its modes are kept."""
LOWEST = 200
"""How many of the lowest modes are kept of a larger one."""
# Above this size only the lowest modes are computed, from sparse factors.
_DENSE = 2000
_RIGID = 1e-6
# Eigenvalues of matrices printed with few digits may be this far (relative) below zero.
_NEGATIVE = 1e-6
# Flexibility below this share of the whole is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ForeignMatrices:
    """Stiffness and mass of a foreign model in SI units.

    Attributes
    ----------
    stiffness, mass
        (n, n) symmetric [N/m], [N], [N m/rad]; [kg], [kg m], [kg m²].
    dofs
        (n,) names such as ``101.rz``.
    stiffness_file, mass_file
        Where they come from.
    """

    stiffness: sparse.csc_array
    mass: sparse.csc_array
    dofs: tuple[str, ...]
    stiffness_file: Path
    mass_file: Path


def matrices_in_si(
    stiffness: sparse.csc_array,
    mass: sparse.csc_array,
    dofs: Sequence[str],
    units: ModelUnits,
    files: tuple[Path, Path],
) -> ForeignMatrices:
    """Matrices of files in SI units.

    Raises
    ------
    StudyError
        If they differ in size from each other or from the list of degrees of freedom, or if a mass or stiffness is
        negative.
    """
    for matrix, file in zip((stiffness, mass), files, strict=True):
        if matrix.shape != (len(dofs), len(dofs)):
            n = matrix.shape[0]
            raise bad(
                file,
                f"the matrix is {n} x {n}, but {len(dofs)} degrees of freedom are named; make them agree",
            )
    for matrix, what, file in ((stiffness, "stiffness", files[0]), (mass, "mass", files[1])):
        least = int(np.argmin(matrix.diagonal()))
        if matrix.diagonal()[least] < 0:
            value = matrix.diagonal()[least]
            raise bad(file, f"negative {what} {value:g} at '{dofs[least]}'; correct the model")
    turn = sparse.diags_array(1 / units.displacement(dofs))
    # Energies ½ u'K u and ½ v'M v are the same in both systems, in their own units.
    k, m = (sparse.csc_array(turn @ each @ turn) for each in (stiffness, mass))
    return ForeignMatrices(k * units.energy, m * (units.wtmass * units.energy), tuple(dofs), *files)


def modes_of(
    model: ForeignMatrices,
    grids: Sequence[str],
    lowest: int | None = None,
    rigid_below: float | None = None,
) -> ImportedModes:
    """Modes of a foreign model at the degrees of freedom of some grids.

    Up to 400 degrees of freedom all modes are kept; of a larger model the lowest 200, and the static flexibility of all
    others between the grids as residual flexibility. Degrees of freedom without mass follow statically, exactly.

    Parameters
    ----------
    lowest
        How many of the lowest modes to keep instead.
    rigid_below
        Frequencies below are those of rigid-body modes; by default a millionth of the highest one kept [rad/s].

    Raises
    ------
    StudyError
        If the mass is not positive semidefinite, or the stiffness has a negative eigenvalue.
    """
    n = len(model.dofs)
    count = lowest if lowest is not None else n if n <= MOST_KEPT else LOWEST
    value, shape = _dense(model, count) if n <= _DENSE else _sparse(model, min(count, n - 2))
    top = float(value[-1])
    if value[0] < -_NEGATIVE * max(top, 0.0) or not top > 0:
        raise bad(
            model.stiffness_file,
            f"the stiffness has a negative eigenvalue ({value[0]:.3g} rad²/s², the highest is {top:.3g}): the "
            "structure is unstable, or the degrees of freedom are listed in another order",
        )
    limit = _RIGID * np.sqrt(top) if rigid_below is None else rigid_below
    frequency = np.sqrt(np.maximum(value, 0.0))
    frequency = np.where(frequency <= limit, 0.0, frequency)
    wanted = [k for k, name in enumerate(model.dofs) if name.rpartition(".")[0] in grids]
    residual = None
    if value.size < n:
        residual = _left_out(model, frequency, shape, wanted)
    names = tuple(model.dofs[k] for k in wanted)
    return ImportedModes(frequency, shape[wanted], names, residual_flexibility=residual)


def _dense(model: ForeignMatrices, count: int) -> tuple[Array, Array]:
    """Lowest modes; what has no mass is condensed out first."""
    k, m = model.stiffness.toarray(), model.mass.toarray()
    moving = np.any(m != 0, axis=1)
    held = ~moving
    follow = np.zeros((int(held.sum()), int(moving.sum())))
    if held.any():
        try:
            follow = -linalg.solve(k[np.ix_(held, held)], k[np.ix_(held, moving)], assume_a="pos")
        except linalg.LinAlgError:
            names = [name for name, at in zip(model.dofs, held, strict=True) if at]
            raise bad(
                model.stiffness_file,
                f"degrees of freedom with neither mass nor stiffness, '{names[0]}' or another of {len(names)} without "
                "mass; leave them out",
            ) from None
    reduced = k[np.ix_(moving, moving)] + k[np.ix_(moving, held)] @ follow
    if not moving.any():
        raise bad(model.mass_file, "the mass matrix is zero; export it again")
    last = min(count, reduced.shape[0]) - 1
    try:
        value, part = linalg.eigh(
            (reduced + reduced.T) / 2, m[np.ix_(moving, moving)], subset_by_index=(0, last)
        )
    except linalg.LinAlgError:
        raise bad(
            model.mass_file,
            "the mass matrix is not positive definite where it has terms: a negative or massless combination of "
            "degrees of freedom; correct the model",
        ) from None
    shape = np.zeros((len(model.dofs), value.size))
    shape[moving], shape[held] = part, follow @ part
    return value, shape


def _sparse(model: ForeignMatrices, count: int) -> tuple[Array, Array]:
    """Lowest modes by shift and invert, just below zero so that rigid-body modes do no harm."""
    mass = model.mass.diagonal()
    scale = float(np.max(model.stiffness.diagonal()[mass > 0] / mass[mass > 0], initial=0.0))
    try:
        value, shape = sparse_linalg.eigsh(
            model.stiffness,
            count,
            model.mass,
            sigma=-1e-9 * scale,
            v0=np.ones(len(model.dofs)),
        )
    except (RuntimeError, ValueError, sparse_linalg.ArpackError) as error:
        raise bad(
            model.stiffness_file,
            f"the lowest modes cannot be computed ({error}); check that every degree of freedom has stiffness or mass",
        ) from None
    order = np.argsort(value)
    value, shape = value[order], shape[:, order]
    norm = np.einsum("ij,ij->j", shape, model.mass @ shape)
    if not np.all(norm > 0):
        raise bad(model.mass_file, "the mass matrix is not positive semidefinite; correct the model")
    return value, shape / np.sqrt(norm)


def _left_out(model: ForeignMatrices, frequency: Array, shape: Array, wanted: Sequence[int]) -> Array | None:
    """(w, w) Static flexibility of the modes that are not kept, or None where it is rounding.

    That of all elastic modes is P' K⁻ P with P = 1 − M Φ_r Φ_r': loads are rid of what rigid-body modes take, and the
    singular stiffness is held at the degree of freedom that moves most in them, where it carries no load then.

    Assumes one rigid-body mode at most.
    """
    rigid, elastic = shape[:, frequency == 0], frequency > 0
    if rigid.shape[1] > 1:
        return None  # refused as a mechanism when the structure is evaluated
    n, w = shape.shape[0], len(wanted)
    loads = np.zeros((n, w))
    loads[wanted, np.arange(w)] = 1.0
    loads -= model.mass @ (rigid @ rigid[wanted].T)
    stiffness = model.stiffness
    if rigid.shape[1]:
        at = int(np.argmax(np.abs(rigid[:, 0])))
        hold = sparse.csc_array(([stiffness.diagonal().max()], ([at], [at])), shape=(n, n))
        stiffness = sparse.csc_array(stiffness + hold)
    moved = sparse_linalg.splu(stiffness).solve(loads)
    moved -= rigid @ (rigid.T @ (model.mass @ moved))
    whole, whole_shape = moved[wanted], shape[wanted]
    kept = whole_shape[:, elastic]
    residual = (whole + whole.T) / 2 - (kept / frequency[elastic] ** 2) @ kept.T
    size = np.sqrt(np.maximum(np.diag(whole), 0.0))
    size = np.where(size > 0, size, 1.0)
    value, vector = linalg.eigh(residual / np.outer(size, size))
    real = value > _ROUNDING
    if not real.any():
        return None
    side = size[:, None] * vector[:, real] * np.sqrt(value[real])
    return side @ side.T
