"""Trusses that a study takes from tables and decks, written into it when it is read.

What is read becomes the section ``structure`` of the type ``truss`` in SI numbers, so that all that holds for a truss
holds for it, and a run directory is complete without the files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from fosopt.structure import Truss
from fosopt.structure.imported import ModelUnits
from fosopt.structure.readers.bulk_data import deck_wtmass, read_bulk_data
from fosopt.structure.readers.common import bad
from fosopt.structure.readers.truss_tables import read_bars, read_nodes
from fosopt.study.schema_imports import BulkData
from fosopt.study.source import Source


class _Deck(BaseModel):
    """A study of which only the structure is understood."""

    structure: BulkData


def inlined(source: Source, base: Path) -> Source:
    """The source with the truss of tables or of a deck in place of their names, which it has.

    Raises
    ------
    StudyError
        For a file that is missing or broken.
    pydantic.ValidationError
        For a section that names a deck wrongly.
    """
    given = source.data["structure"]
    if given["type"] == "bulk_data":
        return _with(source, _deck(_Deck.model_validate({"structure": given}).structure, base))
    found = dict(given)
    if isinstance(given.get("nodes"), str):
        found["nodes"] = {name: list(xyz) for name, xyz in read_nodes(base / given["nodes"]).items()}
    if isinstance(given.get("bars"), str):
        found["bars"] = _bars(Truss({}, read_bars(base / given["bars"]), {}))
    return _with(source, found)


def _with(source: Source, structure: Mapping[str, Any]) -> Source:
    return replace(source, data={**source.data, "structure": dict(structure)})


def _deck(given: BulkData, base: Path) -> dict[str, Any]:
    file = base / given.file
    length, force, wtmass = given.units.in_si
    own = deck_wtmass(file)
    if own is not None:
        if given.units.wtmass is not None and given.units.wtmass != own:
            raise bad(
                file,
                f"PARAM WTMASS is {own:g} and the study's wtmass {given.units.wtmass:g}; leave the study's out",
            )
        wtmass = own
    return truss_section(read_bulk_data(file, ModelUnits(length, force, wtmass), given.ports))


def truss_section(truss: Truss) -> dict[str, Any]:
    """The section of a study that describes a truss, in SI numbers."""
    battens = {batten.name for batten in truss.battens}

    def place(name: str) -> dict[str, str]:
        return {"batten" if name in battens else "node": name}

    return {
        "type": "truss",
        "nodes": {name: [float(x) for x in xyz] for name, xyz in truss.nodes.items()},
        "bars": _bars(truss),
        "battens": [
            {
                "name": b.name,
                "nodes": list(b.nodes),
                "mass": b.mass,
                "inertia": np.asarray(b.inertia).tolist(),
                **({} if b.center is None else {"center": list(b.center)}),
            }
            for b in truss.battens
        ],
        "points": [{**place(p.at), "mass": p.mass, "inertia": p.inertia} for p in truss.points],
        "springs": [
            {**place(s.at), "component": s.component, "stiffness": s.stiffness, "name": s.name}
            for s in truss.springs
        ],
        "supports": {name: list(components) for name, components in truss.supports.items()},
        "ports": {name: list(place) for name, place in truss.ports.items()},
    }


def _bars(truss: Truss) -> list[dict[str, Any]]:
    return [
        {
            "name": bar.name,
            "nodes": list(bar.nodes),
            "area": bar.area,
            "young": bar.young,
            "density": bar.density,
            "kind": bar.kind,
            **({"bay": bar.bay} if bar.bay else {}),
        }
        for bar in truss.bars
    ]
