"""From the files a structure is imported from to the structure."""

from __future__ import annotations

from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import TypeAdapter
from scipy import sparse

from fosopt.errors import ModelError, StudyError
from fosopt.modes import Damping
from fosopt.ops import Array
from fosopt.structure import Structure
from fosopt.structure.imported import (
    RESIDUAL_DAMPING,
    ImportedModes,
    ModelUnits,
    assemble_modes,
    modes_in_si,
)
from fosopt.structure.imported_matrices import ForeignMatrices, matrices_in_si, modes_of
from fosopt.structure.readers.common import bad, file_bytes
from fosopt.structure.readers.matrices import MatrixFile, read_dofs, read_matrix
from fosopt.structure.readers.modal_set import ModalFile, read_modal_set
from fosopt.structure.readers.punch import read_punch
from fosopt.study.schema_imports import Imported, Matrices, ModalSetFile, structure_files

if TYPE_CHECKING:
    from fosopt.study.schema import Study

_SECTION: TypeAdapter[Imported] = TypeAdapter(Imported)


def read_imported(study: Study) -> ImportedModes | None:
    """Modes of the files of a structure that comes from such; None of another one.

    Raises
    ------
    StudyError
        For a file that is missing or broken.
    """
    given = study.structure
    if not isinstance(given, Imported):
        return None
    try:
        content = tuple(sha256(file_bytes(study.base / name)).digest() for name in structure_files(given))
        return _modes(given.model_dump_json(), str(study.base), content)
    except StudyError as error:
        if error.line is None:
            raise study.error(f"{error.file}: {error.message}", "structure") from None
        raise


@lru_cache(maxsize=4)
def _modes(text: str, base: str, content: tuple[bytes, ...]) -> ImportedModes:
    """Modes by what they come from: a sweep asks for the same ones at every point."""
    given = _SECTION.validate_json(text)
    units = ModelUnits(*given.units.in_si)
    if isinstance(given, ModalSetFile):
        return modes_in_si(_modal_file(Path(base) / given.file), units, given.rigid_below)
    grids = [grid for grid, _ in given.ports.values()]
    return modes_of(_matrices(given, Path(base), units), grids, given.lowest_modes, given.rigid_below)


def _modal_file(file: Path) -> ModalFile:
    return read_punch(file) if file.suffix.lower() in (".pch", ".pun") else read_modal_set(file)


def _matrices(given: Matrices, base: Path, units: ModelUnits) -> ForeignMatrices:
    stiffness = read_matrix(base / given.stiffness.file, given.stiffness.matrix)
    mass = read_matrix(base / given.mass.file, given.mass.matrix)
    files = stiffness.file, mass.file
    if given.dofs is not None:
        dofs = read_dofs(base / given.dofs)
        k, m = (_ordered(each, dofs) for each in (stiffness, mass))
    elif stiffness.dofs is not None:
        dofs = stiffness.dofs
        k, m = stiffness.matrix, _ordered(mass, dofs)
    else:
        raise bad(stiffness.file, "the file does not name degrees of freedom; add 'dofs' to the structure")
    return matrices_in_si(k, m, dofs, units, files)


def _ordered(given: MatrixFile, dofs: tuple[str, ...]) -> sparse.csc_array:
    """The matrix in the order of `dofs`; what it does not name is zero."""
    if given.dofs is None:
        return given.matrix
    index = {name: k for k, name in enumerate(dofs)}
    for name in given.dofs:
        if name not in index:
            raise bad(
                given.file,
                f"the degree of freedom '{name}' is not among those of the stiffness; leave it out",
            )
    place = sparse.csc_array(
        (np.ones(len(given.dofs)), ([index[name] for name in given.dofs], range(len(given.dofs)))),
        shape=(len(dofs), len(given.dofs)),
    )
    return sparse.csc_array(place @ given.matrix @ place.T)


def imported_structure(given: Imported, modes: ImportedModes, mirror_port: str) -> Structure:
    """The structure with these modes.

    Raises
    ------
    ModelError
        For a port the modes do not know, or an inertia that does not follow.
    """
    return assemble_modes(modes, given.ports, mirror_port, given.structural_mass, given.structure_inertia)


def imported_damping(modes: ImportedModes, damping: Damping | None) -> Damping:
    """The damping model with that of the file where it is the file's, and with that of residual flexibility.

    Raises
    ------
    ModelError
        If the file has none.
    """
    elastic = slice(modes.n_rigid, None)
    frequency: Array = modes.natural_frequency[elastic]
    if damping is not None:
        ratio = damping.of(frequency)
    elif modes.damping_ratio is not None:
        ratio = modes.damping_ratio[elastic]
    else:
        raise ModelError("the structure's file has no damping; add 'damping_ratio' to it, or give 'uniform'")
    if modes.residual_flexibility is None:
        return damping or Damping(tuple(ratio.tolist()))
    return Damping((*ratio.tolist(), RESIDUAL_DAMPING))


def refuse_riding(study: Study, structure: Structure, mirror_mass: float) -> None:
    """Refuse a mirror's mass that has nothing to ride on.

    Raises
    ------
    ModelError
        If no translation of the mirror's grid is known.
    """
    if isinstance(study.structure, Imported) and mirror_mass > 0 and not np.any(structure.mass_by_mirror):
        raise ModelError(
            "the model has no translation at the mirror's grid for its mass to ride on, or floats; add x, y or z "
            "there, or count the mass in the model and write 'mass: 0 kg'"
        )
