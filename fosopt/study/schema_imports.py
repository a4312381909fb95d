"""Structures of a study that come from files of other tools, with the units the files are in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from fosopt.study.schema_base import (
    Count,
    Identifier,
    Label,
    OrFile,
    PositiveFrequency,
    PositiveInertia,
    PositiveRatio,
    Quantity,
    Section,
    exactly_one,
    parsed,
)
from fosopt.study.schema_truss import Component

PositiveMass = Annotated[float, Quantity("mass", "positive")]
Ports = Annotated[dict[Identifier, tuple[Label, Component]], Field(min_length=1)]


class Units(Section):
    """Units of a foreign model beside seconds and radians; force and mass follow from each other."""

    length: Label
    """Unit of length, such as `mm` or `in`."""
    force: Label | None = None
    """Unit of force, such as `N` or `lbf`."""
    mass: Label | None = None
    """Unit of mass, such as `kg` or `t`, in place of `force`."""
    wtmass: PositiveRatio | None = None
    """Factor that turns the file's mass into force per acceleration, as Nastran's PARAM WTMASS does."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "force", "mass")
        for key in ("length", "force", "mass"):
            if getattr(self, key) is not None:
                self._size(key)
        return self

    def _size(self, key: str) -> float:
        text = getattr(self, key)
        amount = text if text[:1].isdigit() else f"1 {text}"
        return parsed(amount, Quantity(key, "positive"), key)

    @property
    def in_si(self) -> tuple[float, float, float]:
        """One unit of length [m], of force [N], and the factor WTMASS."""
        length = self._size("length")
        force = self._size("force") if self.force is not None else self._size("mass") * length
        return length, force, 1.0 if self.wtmass is None else self.wtmass


class _Imported(Section):
    """What every imported structure has: units, ports, and what its modes need not tell."""

    files: ClassVar[tuple[str, ...]] = ()

    units: Units
    """Units the files are in."""
    ports: Ports
    """Where things are attached: name to grid and component of the file."""
    structural_mass: PositiveMass
    """Mass of the structure, which modes do not tell."""
    structure_inertia: PositiveInertia | None = None
    """Inertia of the structure about the hub, where its modes do not tell."""
    rigid_below: PositiveFrequency | None = None
    """Modes below this frequency count as rigid-body modes."""


class ModalSetFile(_Imported):
    """A structure known by its modes at the ports."""

    type: Literal["modal_set"]
    """Kind of structure."""
    file: Label
    """File of the modes: `.npz`, `.mat`, `.json`, `.csv` or Nastran `.pch`."""

    files: ClassVar[tuple[str, ...]] = ("file",)


class BulkData(Section):
    """A truss in a Nastran deck, which becomes a truss of the study when the study is read."""

    type: Literal["bulk_data"]
    """Kind of structure."""
    file: Label
    """The Nastran deck."""
    units: Units
    """Units the deck is in."""
    ports: Ports
    """Where things are attached: name to grid and component."""


class MatrixFile(Section):
    """A matrix in a file, with its name where the file holds several."""

    file: Label
    """The file: `.mtx`, `.mat`, `.npz`, `.op4` or `.pch`."""
    matrix: Label | None = None
    """Name of the matrix, where the file has several."""

    @model_validator(mode="before")
    @classmethod
    def _from_text(cls, data: Any) -> Any:
        return {"file": data} if isinstance(data, str) else data


class Matrices(_Imported):
    """A structure known by its stiffness and mass matrices."""

    type: Literal["matrices"]
    """Kind of structure."""
    stiffness: Annotated[MatrixFile, OrFile()]
    """The stiffness matrix: a file name, or a file and a name in it."""
    mass: Annotated[MatrixFile, OrFile()]
    """The mass matrix: a file name, or a file and a name in it."""
    dofs: Label | None = None
    """CSV file `grid,component` in the order of rows, where the matrices do not say."""
    lowest_modes: Count | None = None
    """How many modes of a large model to keep; 200 if left out."""

    files: ClassVar[tuple[str, ...]] = ("stiffness", "mass", "dofs")


Imported = ModalSetFile | Matrices
IMPORTED = ("modal_set", "matrices")
"""Types of structure that are known by their modes alone."""


def names_tables(given: object) -> bool:
    """Whether a section that is not yet understood names a deck or tables in place of a truss."""
    if not isinstance(given, Mapping):
        return False
    tables = any(isinstance(given.get(key), str) for key in ("nodes", "bars"))
    return given.get("type") == "bulk_data" or (given.get("type") == "truss" and tables)


def structure_files(structure: Any) -> tuple[str, ...]:
    """Names of the files a structure is read from."""
    found = (getattr(structure, key) for key in getattr(structure, "files", ()))
    return tuple(each.file if isinstance(each, MatrixFile) else each for each in found if each is not None)


def with_structure_files(structure: Any, rename: Callable[[str], str]) -> Any:
    """The structure with other names for its files."""
    changes: dict[str, Any] = {}
    for key in getattr(structure, "files", ()):
        given = getattr(structure, key)
        if isinstance(given, MatrixFile):
            changes[key] = given.model_copy(update={"file": rename(given.file)})
        elif given is not None:
            changes[key] = rename(given)
    return structure.model_copy(update=changes)
