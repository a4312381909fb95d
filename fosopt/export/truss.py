"""The truss of a design: tables of its members, nodes and battens, and a Nastran deck."""

from __future__ import annotations

import csv
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.export.columns import Cell
from fosopt.export.text import inert
from fosopt.export.writing import ExportError, written_to
from fosopt.ops import Array
from fosopt.structure import Structure, stiffness_weights

_COMMENT = 70  # characters of a line of the deck
_TITLE = 60  # and of its title, which a comma at the end would join with the line after it


@dataclass(frozen=True)
class DesignedTruss:
    """A structure with the sizes of a design.

    Attributes
    ----------
    area, batten_mass, spring_stiffness
        (b,) [m²], (r,) [kg], (s,) [N/m], [N m/rad].
    mirror_port, mirror_mass
        Where the mirror is, and its mass [kg].
    """

    structure: Structure
    area: Array
    batten_mass: Array
    spring_stiffness: Array
    mirror_port: str
    mirror_mass: float

    def __post_init__(self) -> None:
        truss = self.structure.truss
        if not (truss.bars or truss.battens or truss.springs):
            raise ExportError(
                "this structure has no members: a beam, a chain or an imported model is no truss; export its plant"
            )


def write_members(design: DesignedTruss, origin: str, path: Path) -> list[Path]:
    """Write a table of bars, and beside it one of nodes and, where there are some, one of battens.

    Units stand in the names of the columns, the last column says where the design came from.

    Returns
    -------
    list of Path
        What was written: all tables or, with an error, the older files.

    Raises
    ------
    ExportError
        If a file cannot be written.
    """
    stem = path.stem.removesuffix("-members")
    tables = {path: _bars(design), path.with_name(f"{stem}-nodes{path.suffix}"): _nodes(design)}
    if design.structure.truss.battens:
        tables[path.with_name(f"{stem}-battens{path.suffix}")] = _battens(design)
    with ExitStack() as stack:
        # Each takes its place when all of them are complete.
        for target, (head, rows) in tables.items():
            temporary = stack.enter_context(written_to(target))
            with temporary.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream:
                writer = csv.writer(stream, lineterminator="\n")
                writer.writerow([*head, "provenance"])
                writer.writerows(map(inert, (*row, origin)) for row in rows)
    return list(tables)


_Table = tuple[Sequence[str], Iterator[tuple[Cell, ...]]]
_MEMBERS = (
    *("name", "start", "end", "kind", "bay"),
    *("start_x_m", "start_y_m", "start_z_m", "end_x_m", "end_y_m", "end_z_m", "length_m"),
    *("area_m2", "young_pa", "density_kg_per_m3", "mass_kg", "axial_stiffness_n_per_m"),
)
_NODES = ("name", "x_m", "y_m", "z_m", "batten", "held", "ports")
_BATTENS = (
    *("name", "nodes", "x_m", "y_m", "z_m", "mass_kg"),
    *("inertia_x_kg_m2", "inertia_y_kg_m2", "inertia_z_kg_m2", "held", "ports"),
)


def _bars(design: DesignedTruss) -> _Table:
    structure, truss = design.structure, design.structure.truss
    mass = structure.bar_mass_per_area * design.area
    stiffness = stiffness_weights(structure, design.area, design.spring_stiffness)

    def rows() -> Iterator[tuple[Cell, ...]]:
        for k, bar in enumerate(truss.bars):
            start, end = (_three(truss.nodes[node]) for node in bar.nodes)
            length = float(np.linalg.norm(np.subtract(end, start)))
            sizes = float(design.area[k]), bar.young, bar.density, float(mass[k]), float(stiffness[k])
            yield (bar.name, *bar.nodes, bar.kind, bar.bay, *start, *end, length, *sizes)

    return _MEMBERS, rows()


def _nodes(design: DesignedTruss) -> _Table:
    truss = design.structure.truss
    carried = {node: batten.name for batten in truss.battens for node in batten.nodes}
    return _NODES, (
        (name, *_three(xyz), carried.get(name), *_roles(design, name)) for name, xyz in truss.nodes.items()
    )


def _battens(design: DesignedTruss) -> _Table:
    truss = design.structure.truss

    def rows() -> Iterator[tuple[Cell, ...]]:
        for batten, mass in zip(truss.battens, design.batten_mass.tolist(), strict=True):
            middle = batten.center or np.mean([truss.nodes[node] for node in batten.nodes], axis=0).tolist()
            inertia = mass / batten.mass * np.atleast_1d(batten.inertia)
            own = (None, None, *inertia.tolist()) if inertia.size == 1 else inertia.tolist()
            yield (
                batten.name,
                " ".join(batten.nodes),
                *_three(middle),
                mass,
                *own,
                *_roles(design, batten.name),
            )

    return _BATTENS, rows()


def _roles(design: DesignedTruss, place: str) -> tuple[str, str]:
    """Components that are held, and ports, at a node or batten."""
    truss = design.structure.truss
    ports = (name for name, (at, _) in truss.ports.items() if at == place)
    return " ".join(truss.supports.get(place, ())), " ".join(ports)


def _three(xyz: Sequence[float]) -> tuple[float, float, float]:
    """Coordinates in space; what lies in a plane has z = 0."""
    x, y, z = (*map(float, xyz), 0.0)[:3]
    return x, y, z


def write_deck(design: DesignedTruss, title: str, provenance: Mapping[str, Any], path: Path) -> None:
    """Write the truss and the mirror's mass as a Nastran deck in SI units, with its provenance in comments.

    Raises
    ------
    ExportError
        If the file cannot be written.
    """
    # Only this needs the readers and writers of other programs' models.
    from fosopt.structure.readers.bulk_writer import bulk_data

    deck = bulk_data(
        design.structure.truss,
        design.area,
        design.batten_mass,
        design.spring_stiffness,
        title=_printable(title)[:_TITLE].rstrip(" ,"),
        mirror=(design.mirror_port, design.mirror_mass),
    )
    lines = [
        f"design: {title}",
        "units: lengths m, masses kg, forces N, areas m^2, moduli Pa, densities kg/m^3",
    ]
    lines += [f"{key}: {value}" for key, value in provenance.items()]
    comments = chain.from_iterable(textwrap.wrap(_printable(line), _COMMENT) for line in lines)
    with written_to(path) as temporary:
        temporary.write_text(
            "".join(f"$ {line}\n" for line in comments) + deck, encoding="ascii", newline="\n"
        )


def _printable(text: str) -> str:
    """A text of one line in ASCII."""
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in " ".join(text.split()))
