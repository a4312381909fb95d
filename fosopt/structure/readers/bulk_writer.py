"""A truss as a Nastran deck, which `bulk_data.read_bulk_data` reads back.    [MscQrg2021] section Bulk Data"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fosopt.errors import ModelError
from fosopt.ops import Array
from fosopt.structure.readers.common import COMPONENTS
from fosopt.structure.truss import Batten, Truss

_WIDTH = 16
_MOST_NUMBERS = 99_999_999


def bulk_data(
    truss: Truss,
    area: Array | None = None,
    batten_mass: Array | None = None,
    spring_stiffness: Array | None = None,
    title: str = "",
    mirror: tuple[str, float] | None = None,
) -> str:
    """A deck for the modes of a truss (SOL 103) in SI units, in large fields of ten digits or more.

    Grids, elements and rigid bodies keep their names where all are numbers, and are numbered else, with comments that
    tell the names. Battens become RBE2 with a CONM2 at the independent grid.

    Assumes that the reader knows how its program lumps the mass of rods: fosopt's is consistent in all directions.

    Parameters
    ----------
    area, batten_mass, spring_stiffness
        (b,) [m²], (r,) [kg], (s,) [N/m], [N m/rad] of a design; by default those of the truss.
    title
        Of the deck.
    mirror
        Port that carries the mirror, and the mirror's mass [kg].

    Raises
    ------
    ModelError
        If a number of values differs from that of members.
    """
    sizes = (
        _values("area", area, [bar.area for bar in truss.bars]),
        _values("batten_mass", batten_mass, [batten.mass for batten in truss.battens]),
        _values("spring_stiffness", spring_stiffness, [spring.stiffness for spring in truss.springs]),
    )
    head = [
        "SOL 103",
        "CEND",
        *([f"TITLE = {title}"[:72]] if title else []),
        *(["SPC = 1"] if truss.supports else []),
        "METHOD = 1",
        "VECTOR(PUNCH) = ALL",
        "BEGIN BULK",
        "$ SI units: m, kg, N",
    ]
    lines = [*head, *_cards(truss, *sizes, mirror), "EIGRL          1", "ENDDATA"]
    return "\n".join(lines) + "\n"


def _values(what: str, given: Array | None, own: Sequence[float]) -> list[float]:
    if given is None:
        return list(own)
    if len(given) != len(own):
        raise ModelError(f"{what}: {len(given)} values for {len(own)} members; give one each")
    return [float(value) for value in given]


def _cards(
    truss: Truss,
    area: Sequence[float],
    batten_mass: Sequence[float],
    stiffness: Sequence[float],
    mirror: tuple[str, float] | None,
) -> Iterator[str]:
    dim = len(next(iter(truss.nodes.values())))
    grids = _numbers([*truss.nodes, *(batten.name for batten in truss.battens)])
    elements = _numbers([bar.name for bar in truss.bars])
    carried = {node for batten in truss.battens for node in batten.nodes}
    for kind, names in (("grid", grids), ("rod", elements)):
        if any(name != str(number) for name, number in names.items()):
            yield from (f"$ {kind} {number} = {_comment(name)}" for name, number in names.items())
    # Held for good: rotations of pin-ended nodes, and what leaves the plane of a planar truss.
    node_held, body_held = ("456", "") if dim == 3 else ("3456", "345")
    for name, xyz in truss.nodes.items():
        yield from _card("GRID", grids[name], "", *_three(xyz), "", "" if name in carried else node_held)
    for batten in truss.battens:
        yield from _card("GRID", grids[batten.name], "", *_three(_center(truss, batten)), "", body_held)
    materials: dict[tuple[float, float], int] = {}
    for bar, size in zip(truss.bars, area, strict=True):
        material = materials.setdefault((bar.young, bar.density), len(materials) + 1)
        ends = grids[bar.nodes[0]], grids[bar.nodes[1]]
        yield from _card("CONROD", elements[bar.name], *ends, material, size)
    for (young, density), material in materials.items():
        yield from _card("MAT1", material, young, "", 0.3, density)
    number = max(elements.values(), default=0)
    for spring, value in zip(truss.springs, stiffness, strict=True):
        number += 1
        component = COMPONENTS.index(spring.component) + 1
        yield from _card("CELAS2", number, value, grids[spring.at], component)
    for batten, mass in zip(truss.battens, batten_mass, strict=True):
        number += 2
        yield from _card(
            "RBE2", number - 1, grids[batten.name], 123456, *(grids[node] for node in batten.nodes)
        )
        inertia = _principal(batten, dim) * (mass / batten.mass)
        yield from _mass(number, grids[batten.name], mass, inertia)
    for point in truss.points:
        number += 1
        yield from _mass(number, grids[point.at], point.mass, np.full(3, point.inertia))
    if mirror is not None:
        yield "$ the mirror's mass"
        yield from _mass(number + 1, grids[truss.ports[mirror[0]][0]], mirror[1], np.zeros(3))
    for name, components in truss.supports.items():
        text = "".join(sorted(str(COMPONENTS.index(c) + 1) for c in components))
        yield from _card("SPC1", 1, text, grids[name])


def _mass(number: int, grid: int, mass: float, inertia: Array) -> Iterator[str]:
    i11, i22, i33 = (float(value) for value in inertia)
    if any((i11, i22, i33)):
        yield from _card("CONM2", number, grid, 0, mass, "", "", "", "", i11, "", i22, "", "", i33)
    else:
        yield from _card("CONM2", number, grid, 0, mass)


def _principal(batten: Batten, dim: int) -> Array:
    """(3,) Principal inertias; those out of the plane of a planar truss move nothing."""
    values = np.atleast_1d(np.asarray(batten.inertia, dtype=float))
    return np.full(3, values[0]) if dim == 2 else np.array(np.broadcast_to(values, (3,)))


def _center(truss: Truss, batten: Batten) -> tuple[float, ...]:
    if batten.center is not None:
        return batten.center
    return tuple(np.mean([truss.nodes[node] for node in batten.nodes], axis=0).tolist())


def _three(xyz: Sequence[float]) -> tuple[float, float, float]:
    x, y, *z = xyz
    return x, y, (z[0] if z else 0.0)


def _numbers(names: Sequence[str]) -> dict[str, int]:
    """A number of each name: its own where all names are numbers."""
    digits = [name for name in names if name.isascii() and name.isdigit() and 0 < int(name) <= _MOST_NUMBERS]
    if len(digits) == len(names) == len({int(name) for name in names}):
        return {name: int(name) for name in names}
    return {name: k for k, name in enumerate(names, 1)}


def _comment(name: str) -> str:
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in name)[:60]


def _card(name: str, *fields: str | int | float) -> Iterator[str]:
    """Lines of a card in large fields."""
    cells = [_cell(value) for value in fields]
    lines = [cells[k : k + 4] for k in range(0, len(cells), 4)]
    if len(lines) % 2:
        lines.append([])
    for k, line in enumerate(lines):
        head = f"{name}*" if k == 0 else "*"
        text = f"{head:<8}{''.join(f'{cell:>16}' for cell in line)}".rstrip()
        if k + 1 < len(lines) or line:
            yield text


def _cell(value: str | int | float) -> str:
    if isinstance(value, str | int):
        return str(value)
    for digits in range(16, 5, -1):
        text = f"{float(value):.{digits}G}"
        if "." not in text:
            mantissa, e, power = text.partition("E")
            text = f"{mantissa}.{e}{power}"
        if len(text) <= _WIDTH:
            return text
    raise AssertionError(value)
