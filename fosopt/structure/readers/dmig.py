"""Matrices on DMIG entries, as Nastran punches them.    [MscQrg2021] entry DMIG"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy import sparse

from fosopt.structure.readers.cards import Card, read_cards
from fosopt.structure.readers.common import bad, dof_name
from fosopt.units import quote

_SYMMETRIC, _SQUARE = 6, 1

Dof = tuple[int, int]
"""Grid and component number."""


@dataclass
class _Entries:
    form: int
    line: int
    value: dict[tuple[Dof, Dof], float] = field(default_factory=dict)


def read_dmig(file: Path) -> dict[str, tuple[sparse.csc_array, tuple[str, ...]]]:
    """Matrices of the DMIG entries of a file with the names of their degrees of freedom, by name in capitals.

    Rows and columns are in the order of grids and components. A symmetric matrix may give either triangle.

    Raises
    ------
    StudyError
        For a rectangular or complex matrix, a column without a header, or a term that stands twice.
    """
    found: dict[str, _Entries] = {}
    for card in read_cards(file):
        if card.name != "DMIG":
            continue
        name = card.text(1).upper()
        if card.text(2) == "0":
            found[name] = _header(card, name)
            continue
        if name not in found:
            raise bad(
                file, f"DMIG: column of {quote(name)} before its header; export the file again", card.line
            )
        _column(card, name, found[name])
    if not found:
        raise bad(file, "the file has no DMIG entries; check the path and the format")
    return {name: _matrix(entries) for name, entries in found.items()}


def _header(card: Card, name: str) -> _Entries:
    form, kind = card.integer(3, "form IFO"), card.integer(4, "type TIN")
    if form not in (_SYMMETRIC, _SQUARE):
        message = f"DMIG {name}: form {form} is neither square (1) nor symmetric (6); export a square matrix"
        raise bad(card.file, message, card.line)
    if kind not in (1, 2):
        raise bad(card.file, f"DMIG {name}: type {kind} is complex; export the real matrix", card.line)
    return _Entries(form, card.line)


def _dof(card: Card, grid: int, component: int) -> Dof:
    at = card.integer(grid, "grid"), card.integer(component, "component", 0)
    if not (at[0] > 0 and 0 <= at[1] <= 6):
        raise bad(
            card.file, f"DMIG: grid {at[0]}, component {at[1]} is no degree of freedom; correct it", card.line
        )
    return at


def _column(card: Card, name: str, entries: _Entries) -> None:
    column = _dof(card, 2, 3)
    for k in range(5, len(card.fields) + 1, 4):
        if not any(card.fields[k - 1 : k + 3]):
            continue
        row = _dof(card, k, k + 1)
        value = card.real(k + 2, f"{name}({row[0]}.{row[1]}, {column[0]}.{column[1]})")
        if (row, column) in entries.value:
            message = (
                f"DMIG {name}: the term ({row[0]}.{row[1]}, {column[0]}.{column[1]}) stands twice; remove one"
            )
            raise bad(card.file, message, card.line)
        entries.value[row, column] = value
        if entries.form == _SYMMETRIC:
            entries.value[column, row] = value


def _matrix(entries: _Entries) -> tuple[sparse.csc_array, tuple[str, ...]]:
    dofs = sorted({dof for pair in entries.value for dof in pair})
    index = {dof: k for k, dof in enumerate(dofs)}
    rows = [index[row] for row, _ in entries.value]
    columns = [index[column] for _, column in entries.value]
    values = np.array(list(entries.value.values()), dtype=float)
    names = tuple(dof_name(Path(), grid, component) for grid, component in dofs)
    return sparse.csc_array((values, (rows, columns)), shape=(len(dofs), len(dofs))), names
