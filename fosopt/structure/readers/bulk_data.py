"""A subset of Nastran bulk data as a truss: rods, springs to ground, masses, rigid bodies and supports.

Of a rigid body (RBE2) the independent grid becomes a batten with the mass of its CONM2. Coordinates are basic, damping
is the study's.    [MscQrg2021] section Bulk Data
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fosopt.errors import StudyError
from fosopt.structure.readers.cards import Card, read_cards
from fosopt.structure.readers.common import COMPONENTS, bad, text_lines
from fosopt.structure.truss import Bar, Batten, PointMass, Spring, Truss

if TYPE_CHECKING:
    from fosopt.structure.imported import ModelUnits

_PLANE = {3, 4, 5}
"""Components held by what moves in the plane of x and y alone."""
# fmt: off
_PASSED_OVER = frozenset((
    "PARAM",
    "EIGRL", "EIGR", "EIGB", "EIGC", "PLOTEL", "FREQ", "FREQ1", "FREQ2", "FREQ3", "FREQ4", "FREQ5",
    "TABDMP1", "TABLED1", "TABRND1", "RANDPS", "FORCE", "MOMENT", "LOAD", "DLOAD", "DAREA", "RLOAD1",
    "RLOAD2", "TLOAD1", "TLOAD2", "TSTEP", "DPHASE", "DELAY", "GRAV", "SUPORT", "SUPORT1", "DESVAR",
    "DCONSTR", "DCONADD", "DRESP1", "DVPREL1", "DOPTPRM", "ECHOON", "ECHOOFF",
))
# fmt: on
"""Entries that change neither mass nor stiffness: loads, requests and design models; WTMASS is for the caller."""


@dataclass
class _Deck:
    """Entries by number."""

    file: Path
    grids: dict[int, Card] = field(default_factory=dict)
    rods: dict[int, Card] = field(default_factory=dict)
    rod_properties: dict[int, Card] = field(default_factory=dict)
    materials: dict[int, Card] = field(default_factory=dict)
    springs: dict[int, Card] = field(default_factory=dict)
    spring_properties: dict[int, tuple[Card, int]] = field(default_factory=dict)
    masses: dict[int, Card] = field(default_factory=dict)
    bodies: dict[int, Card] = field(default_factory=dict)
    supports: dict[int, list[Card]] = field(default_factory=dict)

    def add(self, card: Card) -> None:
        table = {
            "GRID": self.grids,
            "CROD": self.rods,
            "CONROD": self.rods,
            "PROD": self.rod_properties,
            "MAT1": self.materials,
            "CELAS1": self.springs,
            "CELAS2": self.springs,
            "CONM2": self.masses,
            "RBE2": self.bodies,
        }.get(card.name)
        if table is not None:
            number = card.integer(1, "its number")
            if number <= 0:
                raise bad(self.file, f"{card.name} {number}: its number is not above zero", card.line)
            if number in table:
                first = table[number].line
                raise bad(
                    self.file,
                    f"{card.name} {number} stands twice, first in line {first}; remove one",
                    card.line,
                )
            table[number] = card
        elif card.name == "PELAS":
            for k in (1, 5):
                if card.text(k):
                    self.spring_properties[card.integer(k, "its number")] = card, k
        elif card.name in ("SPC", "SPC1"):
            self.supports.setdefault(card.integer(1, "its set"), []).append(card)
        elif card.name not in _PASSED_OVER:
            raise bad(
                self.file,
                f"{card.name} is not in the subset that is read (GRID, CROD, CONROD, PROD, MAT1, CELAS1, CELAS2, "
                "PELAS, CONM2, RBE2, SPC, SPC1); import the model's modes or matrices instead",
                card.line,
            )


def deck_wtmass(file: Path) -> float | None:
    """Value of PARAM WTMASS in a deck, if it has one.

    Raises
    ------
    StudyError
        If the deck cannot be read.
    """
    found = [card for card in read_cards(file) if card.name == "PARAM" and card.text(1).upper() == "WTMASS"]
    return found[-1].real(2, "WTMASS") if found else None


def read_bulk_data(file: Path, units: ModelUnits, ports: Mapping[str, tuple[str, str]]) -> Truss:
    """The truss of a bulk data file, in SI units.

    Nodes, bars and battens are named by the numbers of grids, elements and independent grids; a rod that ends at an
    independent grid ends at the node ``<grid>_center`` of its batten. A model that is held to a plane of constant z
    becomes a planar truss. Bars are of the kind ``PROD <number>`` or ``CONROD``.

    Parameters
    ----------
    ports
        Port name to (grid, component).

    Raises
    ------
    StudyError
        For entries outside of the subset and values without a meaning, with their line.
    """
    deck = _Deck(file)
    for card in read_cards(file):
        deck.add(card)
    if not deck.grids or not deck.rods:
        raise bad(file, f"{len(deck.grids)} grids and {len(deck.rods)} rods are no truss; check the path")
    return _Builder(deck, units).truss(ports)


class _Builder:
    def __init__(self, deck: _Deck, units: ModelUnits) -> None:
        self.deck, self.units, self.file = deck, units, deck.file
        self.owner: dict[int, int] = {}  # dependent grid to independent one
        self.center: dict[int, Card] = {}
        self.held: dict[int, set[int]] = {}

    def bad(self, card: Card, message: str) -> StudyError:
        return bad(self.file, f"{card.name} {card.text(1)}: {message}", card.line)

    def truss(self, ports: Mapping[str, tuple[str, str]]) -> Truss:
        for card in self.deck.bodies.values():
            self._body(card)
        for grid, card in self.deck.grids.items():
            self._held_by_grid(grid, card)
        for card in self._chosen_supports():
            self._support(card)
        used = self._ends()
        points = {grid: self._point(card) for grid, card in self.deck.grids.items()}
        masses = self._masses()
        alone = {grid for grid in self.center if grid not in used}
        nodes = {self._node(grid): xyz for grid, xyz in points.items() if grid not in alone}
        battens = tuple(self._batten(grid, masses, points[grid], grid in used) for grid in self.center)
        loose = [grid for grid in masses if grid not in self.center]
        found = tuple(PointMass(str(grid), masses[grid][0]) for grid in loose)
        supports = {
            str(grid): tuple(COMPONENTS[c - 1] for c in sorted(held) if c <= 3 or grid in self.center)
            for grid, held in self.held.items()
            if grid not in self.owner
        }
        supports = {name: components for name, components in supports.items() if components}
        springs = tuple(self._spring(card) for card in self.deck.springs.values())
        bars = tuple(self._bar(card) for card in self.deck.rods.values())
        truss = Truss(nodes, bars, dict(ports), supports, battens, found, springs)
        return _planar(truss) if self._in_plane(points) else truss

    # ---- grids ----

    def _grid(self, card: Card, k: int, what: str = "grid") -> int:
        grid = card.integer(k, what)
        if grid not in self.deck.grids:
            raise self.bad(card, f"{what} {grid} does not exist; correct it")
        return grid

    def _node(self, grid: int) -> str:
        return f"{grid}_center" if grid in self.center else str(grid)

    def _point(self, card: Card) -> tuple[float, ...]:
        for k, what in ((2, "CP"), (6, "CD")):
            if card.integer(k, what, 0) != 0:
                raise self.bad(
                    card, f"coordinate system {what} {card.text(k)}; give basic coordinates, 0 or blank"
                )
        return tuple(self.units.length * card.real(k, f"X{k - 2}", 0.0) for k in (3, 4, 5))

    def _components(self, card: Card, text: str) -> set[int]:
        if not text.isdigit() or set(text) - set("0123456"):
            raise self.bad(card, f"components '{text}' are none of 1 to 6; correct them")
        return {int(c) for c in text if c != "0"}

    def _held_by_grid(self, grid: int, card: Card) -> None:
        if card.text(7):
            self._hold(card, grid, self._components(card, card.text(7)))

    def _hold(self, card: Card, grid: int, components: set[int]) -> None:
        if grid in self.owner and components:
            raise self.bad(
                card, f"grid {grid} depends on RBE2 grid {self.owner[grid]}; hold that one instead"
            )
        self.held.setdefault(grid, set()).update(components)

    def _chosen_supports(self) -> list[Card]:
        sets = self.deck.supports
        if len(sets) < 2:
            return [card for cards in sets.values() for card in cards]
        chosen = _case_control_spc(self.file)
        if chosen not in sets:
            names = ", ".join(str(number) for number in sorted(sets))
            card = next(iter(sets.values()))[0]
            raise bad(
                self.file,
                f"{len(sets)} sets of supports ({names}); choose one with SPC = in the case control",
                card.line,
            )
        return sets[chosen]

    def _support(self, card: Card) -> None:
        if card.name == "SPC":
            for k in (2, 5):
                if card.text(k):
                    if card.real(k + 2, "D", 0.0) != 0:
                        raise self.bad(card, f"an enforced motion {card.text(k + 2)}; supports hold at zero")
                    self._hold(card, self._grid(card, k), self._components(card, card.text(k + 1)))
            return
        components = self._components(card, card.text(2))
        if card.text(4).upper() == "THRU":
            first, last = card.integer(3, "first grid"), card.integer(5, "last grid")
            grids = [grid for grid in self.deck.grids if first <= grid <= last]
        else:
            grids = [self._grid(card, k) for k in range(3, len(card.fields) + 1) if card.text(k)]
        for grid in grids:
            self._hold(card, grid, components)

    # ---- rigid bodies and masses ----

    def _body(self, card: Card) -> None:
        center = self._grid(card, 2, "independent grid")
        if not {1, 2, 3} <= self._components(card, card.text(3)):
            raise self.bad(card, f"components '{card.text(3)}' leave translations free; write 123456")
        if center in self.owner or center in self.center:
            raise self.bad(card, f"grid {center} belongs to two rigid bodies; join them into one")
        self.center[center] = card
        for k in range(4, len(card.fields) + 1):
            text = card.text(k)
            if not text or "." in text:  # the last one may be a thermal expansion
                continue
            if text.upper() == "THRU":
                raise self.bad(card, "THRU in a list of grids; write every grid")
            grid = self._grid(card, k, "dependent grid")
            if grid in self.owner or grid in self.center:
                raise self.bad(card, f"grid {grid} belongs to two rigid bodies; a node has one")
            self.owner[grid] = center

    def _masses(self) -> dict[int, tuple[float, tuple[float, float, float]]]:
        found: dict[int, tuple[float, tuple[float, float, float]]] = {}
        for card in self.deck.masses.values():
            grid = self._grid(card, 2)
            if grid in self.owner:
                raise self.bad(
                    card, f"grid {grid} depends on RBE2 grid {self.owner[grid]}; put the mass there"
                )
            mass = card.real(4, "M", 0.0)
            inertia = tuple(card.real(k, what, 0.0) for k, what in ((9, "I11"), (11, "I22"), (14, "I33")))
            if card.integer(3, "CID", 0) != 0:
                raise self.bad(card, f"coordinate system {card.text(3)}; give basic coordinates, 0 or blank")
            for k, what in ((5, "X1"), (6, "X2"), (7, "X3"), (10, "I21"), (12, "I31"), (13, "I32")):
                if card.real(k, what, 0.0) != 0:
                    raise self.bad(
                        card, f"{what} is {card.text(k)}; give the mass at its grid, in principal axes"
                    )
            if mass < 0 or min(inertia) < 0:
                raise self.bad(card, f"negative mass: M {mass:g}, I {inertia}; correct it")
            if any(inertia) and grid not in self.center:
                raise self.bad(
                    card, f"inertia at grid {grid}, where pin-ended rods resist no rotation; use an RBE2"
                )
            before = found.get(grid, (0.0, (0.0, 0.0, 0.0)))
            size = self.units.mass * self.units.length**2
            a, b, c = (size * new + old for new, old in zip(inertia, before[1], strict=True))
            found[grid] = before[0] + self.units.mass * mass, (a, b, c)
        return found

    def _batten(
        self,
        grid: int,
        masses: Mapping[int, tuple[float, tuple[float, float, float]]],
        center: tuple[float, ...],
        carries_center: bool,
    ) -> Batten:
        mass, inertia = masses.get(grid, (0.0, (0.0, 0.0, 0.0)))
        if mass <= 0 or max(inertia) <= 0:
            raise self.bad(
                self.center[grid],
                f"no mass or no inertia at its independent grid {grid}; add a CONM2 with M, I11, I22 and I33",
            )
        own = (self._node(grid),) if carries_center else ()
        carried = tuple(str(each) for each, owner in self.owner.items() if owner == grid)
        return Batten(str(grid), (*own, *carried), mass, inertia, center)

    # ---- elements ----

    def _ends(self) -> set[int]:
        first = {"CROD": 3, "CONROD": 2}
        return {self._grid(card, first[card.name] + k) for card in self.deck.rods.values() for k in range(2)}

    def _material(self, card: Card, number: int) -> tuple[float, float]:
        """Young's modulus and density."""
        if number not in self.deck.materials:
            raise self.bad(card, f"material {number} does not exist; add a MAT1")
        material = self.deck.materials[number]
        young, density = material.real(2, "E"), material.real(5, "RHO", 0.0)
        if not young > 0 or density < 0:
            raise self.bad(material, f"E {young:g}, RHO {density:g}; E is above zero and RHO not negative")
        return young, density

    def _bar(self, card: Card) -> Bar:
        if card.name == "CONROD":
            source, at, kind, number = card, 5, "CONROD", card.integer(4, "material")
            first = 2
        else:
            property_number = card.integer(2, "property", card.integer(1, "its number"))
            if property_number not in self.deck.rod_properties:
                raise self.bad(card, f"property {property_number} does not exist; add a PROD")
            source, first = self.deck.rod_properties[property_number], 3
            at, kind, number = 3, f"PROD {property_number}", source.integer(2, "material")
        area, per_length = source.real(at, "A"), source.real(at + 3, "NSM", 0.0)
        if not area > 0:
            raise self.bad(source, f"area {area:g} is not above zero; leave the rod out")
        if source.real(at + 1, "J", 0.0) != 0:
            raise self.bad(
                source, f"J {source.text(at + 1)}: rods are pin-ended and carry no torsion; leave J blank"
            )
        young, density = self._material(source, number)
        density += per_length / area
        if not density > 0:
            raise self.bad(source, "the rod has no mass; give RHO or NSM, however small")
        unit = self.units
        ends = self._node(self._grid(card, first)), self._node(self._grid(card, first + 1))
        return Bar(
            card.text(1),
            ends,
            area * unit.length**2,
            young * unit.force / unit.length**2,
            density * unit.mass / unit.length**3,
            kind,
        )

    def _spring(self, card: Card) -> Spring:
        if card.name == "CELAS2":
            stiffness = card.real(2, "K")
        else:
            number = card.integer(2, "property", card.integer(1, "its number"))
            if number not in self.deck.spring_properties:
                raise self.bad(card, f"property {number} does not exist; add a PELAS")
            holder, k = self.deck.spring_properties[number]
            stiffness = holder.real(k + 1, "K")
        ends = [k for k in (3, 5) if card.text(k) and card.text(k + 1, "0") != "0"]
        if len(ends) != 1:
            raise self.bad(card, "a spring between two grids; only springs to ground are read: use a CONROD")
        if stiffness < 0:
            raise self.bad(card, f"stiffness {stiffness:g} is negative; correct it")
        grid, component = self._grid(card, ends[0]), card.integer(ends[0] + 1, "component")
        if grid in self.owner:
            raise self.bad(card, f"grid {grid} depends on RBE2 grid {self.owner[grid]}; put the spring there")
        if not 1 <= component <= 6 or (component > 3 and grid not in self.center):
            raise self.bad(
                card, f"component {component} of grid {grid}; a pin-ended grid has 1 to 3, an RBE2 1 to 6"
            )
        size = self.units.force * (1 / self.units.length if component <= 3 else self.units.length)
        return Spring(str(grid), COMPONENTS[component - 1], stiffness * size, f"CELAS {card.text(1)}")

    def _in_plane(self, points: Mapping[int, tuple[float, ...]]) -> bool:
        """Whether all moves in one plane of constant z."""
        if len({xyz[2] for xyz in points.values()}) > 1:
            return False
        return all(
            (_PLANE if grid in self.center else {3}) <= self.held.get(grid, set())
            for grid in points
            if grid not in self.owner
        )


def _planar(truss: Truss) -> Truss:
    """The truss in the plane of x and y."""
    battens = tuple(
        Batten(b.name, b.nodes, b.mass, float(np.atleast_1d(b.inertia)[-1]), (b.center or (0.0, 0.0))[:2])
        for b in truss.battens
    )
    supports = {
        name: tuple(c for c in components if c in ("x", "y", "rz"))
        for name, components in truss.supports.items()
    }
    return Truss(
        {name: xyz[:2] for name, xyz in truss.nodes.items()},
        truss.bars,
        truss.ports,
        {name: components for name, components in supports.items() if components},
        battens,
        truss.points,
        tuple(s for s in truss.springs if s.component in ("x", "y", "rz")),
    )


def _case_control_spc(file: Path) -> int | None:
    """Number of the set of supports the case control chooses."""
    for line in text_lines(file):
        words = line.split("$")[0].upper().replace("=", " ").split()
        if words[:2] == ["BEGIN", "BULK"]:
            return None
        if len(words) == 2 and words[0] == "SPC" and words[1].isdigit():
            return int(words[1])
    return None
