"""Trusses as structures of a study: the dissertation's, or any pin-ended one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Self

from pydantic import Field, Tag, model_validator

from fosopt.errors import did_you_mean
from fosopt.study.schema_base import (
    ONE_OR_LIST,
    Area,
    Count,
    Density,
    Identifier,
    Inertia,
    KeyPath,
    Label,
    Length,
    Mass,
    OrFile,
    Pressure,
    Quantity,
    RuleError,
    Section,
    Stiffness,
    exactly_one,
    parsed,
    unique,
)

Component = Literal["x", "y", "z", "rx", "ry", "rz"]
BattenInertia = Annotated[
    Annotated[Inertia, Tag("one")] | Annotated[tuple[Inertia, Inertia, Inertia], Tag("list")], ONE_OR_LIST
]
"""About the center: one value, or in space three along the axes."""
Coordinates = Annotated[tuple[Length, ...], Field(min_length=2, max_length=3)]


class BarkerTruss(Section):
    """The dissertation's planar truss with alternating diagonals and rigid battens."""

    type: Literal["barker_truss"]
    """Kind of structure."""
    boundary: Literal["table", "fixed", "pinned"] = "pinned"
    """On the flexible root table (FEM1), clamped (FEM2), or free to turn about the hub (FEM3)."""
    bays: Annotated[int, Field(strict=True, ge=1, le=5000)] = 20
    """Number of square bays of 0.3535 m."""
    longeron_area: Area | None = None
    """Cross section of the longerons; the published tube's if left out."""
    diagonal_area: Area | None = None
    """Cross section of the diagonals; the published tube's if left out."""
    batten_mass: Mass | None = None
    """Mass of a batten; the fitted one if left out."""

    @property
    def kinds(self) -> frozenset[str]:
        """The kinds of bars it has."""
        return frozenset({"longeron", "diagonal"})

    @property
    def ports(self) -> frozenset[str]:
        """The names of its ports."""
        return frozenset({"hub", "tip"})

    @property
    def ground_springs(self) -> Iterable[tuple[str, str]]:
        """Name and component of each spring to ground: the root table has three."""
        return [(f"B0.{c}", c) for c in ("x", "y", "rz")] if self.boundary == "table" else []


class Bar(Section):
    """A pin-ended bar between two nodes."""

    name: Label | None = None
    """Its name; `<node>-<node>` if left out."""
    nodes: tuple[Label, Label]
    """The nodes it joins."""
    area: Area
    """Cross section."""
    young: Pressure
    """Young's modulus."""
    density: Density
    """Mass per volume."""
    kind: Label = "bar"
    """Name shared by bars of a kind, for `group_by: kind`."""
    bay: Count | None = None
    """Number of the bay it belongs to, for `group_by: bay`."""


class Batten(Section):
    """A rigid body that carries nodes."""

    name: Label
    """Its name."""
    nodes: Annotated[tuple[Label, ...], Field(min_length=1)]
    """The nodes it carries."""
    mass: Mass
    """Its mass."""
    inertia: BattenInertia
    """About its center: one value in the plane, three along the axes in space."""
    center: Coordinates | None = None
    """Where its mass center is; the mean of its nodes if left out."""


class Point(Section):
    """A mass added to a node or batten."""

    node: Label | None = None
    """The node it sits on."""
    batten: Label | None = None
    """The batten it sits on, in place of `node`."""
    mass: Mass = 0.0
    """Added mass."""
    inertia: Inertia = 0.0
    """Added inertia; on a batten only."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "node", "batten")
        if self.node is not None and self.inertia > 0:
            raise RuleError("a pin-ended node has no rotation; give the inertia to a batten", "inertia")
        return self


class Spring(Section):
    """A spring from a node or batten to ground."""

    name: Label | None = None
    """Its name; `<node or batten>.<component>` if left out."""
    node: Label | None = None
    """The node it holds."""
    batten: Label | None = None
    """The batten it holds, in place of `node`."""
    component: Component
    """The direction it resists."""
    stiffness: Stiffness
    """Its stiffness, per meter or per radian as the component says."""

    @model_validator(mode="before")
    @classmethod
    def _units(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("component"), str) and "stiffness" in data:
            dimension = "rotational_stiffness" if data["component"].startswith("r") else "stiffness"
            stiffness = parsed(data["stiffness"], Quantity(dimension, "nonnegative"), "stiffness")
            return {**data, "stiffness": stiffness}
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "node", "batten")
        return self


class Truss(Section):
    """Any pin-ended truss, planar or spatial."""

    type: Literal["truss"]
    """Kind of structure."""
    nodes: Annotated[dict[Label, Coordinates], Field(min_length=2), OrFile()]
    """Coordinates of each node by its name, two in the plane or three in space; or a CSV file `node,x [m],y
    [m]`."""
    bars: Annotated[tuple[Bar, ...], Field(min_length=1), OrFile()]
    """The bars; or a CSV file `start,end,area [mm^2],young [GPa],density [kg/m^3],kind,bay,name`."""
    battens: tuple[Batten, ...] = ()
    """Rigid bodies, each carrying some nodes."""
    points: tuple[Point, ...] = ()
    """Masses added to nodes or battens."""
    springs: tuple[Spring, ...] = ()
    """Springs to ground."""
    supports: dict[Label, Annotated[tuple[Component, ...], Field(min_length=1)]] = Field(default_factory=dict)
    """What is held still: name of a node or batten to its held components."""
    ports: Annotated[dict[Identifier, tuple[Label, Component]], Field(min_length=1)]
    """Where things are attached: name to node or batten and component; `hub` is where the structure turns."""

    @property
    def kinds(self) -> frozenset[str]:
        """The kinds of bars it has."""
        return frozenset(bar.kind for bar in self.bars)

    @property
    def ground_springs(self) -> Iterable[tuple[str, str]]:
        """Name and component of each spring to ground."""
        return [(s.name or f"{s.node or s.batten}.{s.component}", s.component) for s in self.springs]

    @model_validator(mode="after")
    def _check(self) -> Self:
        dimension = len(next(iter(self.nodes.values())))
        for name, coordinates in self.nodes.items():
            if len(coordinates) != dimension:
                raise RuleError(
                    f"{len(coordinates)} coordinates beside nodes of {dimension}; give all alike",
                    "nodes",
                    name,
                )
        unique(((bar.name, ("bars", k, "name")) for k, bar in enumerate(self.bars) if bar.name), "bar")
        unique(((batten.name, ("battens", k, "name")) for k, batten in enumerate(self.battens)), "batten")
        unique(((s.name, ("springs", k, "name")) for k, s in enumerate(self.springs) if s.name), "spring")
        for k, bar in enumerate(self.bars):
            self._known_nodes(bar.nodes, "bars", k, "nodes")
            if self.nodes[bar.nodes[0]] == self.nodes[bar.nodes[1]]:
                raise RuleError("the bar has no length; join two nodes that lie apart", "bars", k, "nodes")
        for k, batten in enumerate(self.battens):
            if batten.name in self.nodes:
                raise RuleError(f"'{batten.name}' is a node too; choose another name", "battens", k, "name")
            self._known_nodes(batten.nodes, "battens", k, "nodes")
            if batten.center is not None and len(batten.center) != dimension:
                raise RuleError(f"{len(batten.center)} coordinates; give {dimension}", "battens", k, "center")
        shared = Counter(node for batten in self.battens for node in batten.nodes)
        for k, batten in enumerate(self.battens):
            for i, node in enumerate(batten.nodes):
                if shared[node] > 1:
                    raise RuleError(
                        f"node '{node}' stands {shared[node]} times in battens; a node has one rigid body",
                        *("battens", k, "nodes", i),
                    )
        for section in ("points", "springs"):
            for k, item in enumerate(getattr(self, section)):
                key = "node" if item.node is not None else "batten"
                component = getattr(item, "component", None)
                self._carrier(getattr(item, key), component, dimension, (section, k, key), only=key)
        for name, components in self.supports.items():
            for k, component in enumerate(components):
                self._carrier(name, component, dimension, ("supports", name, k))
            unique(((c, ("supports", name, k)) for k, c in enumerate(components)), "component")
        for port, (name, component) in self.ports.items():
            self._carrier(name, component, dimension, ("ports", port))
        return self

    def _known_nodes(self, names: tuple[str, ...], *at: str | int) -> None:
        for k, name in enumerate(names):
            if name not in self.nodes:
                raise RuleError(f"unknown node '{name}'; {did_you_mean(name, self.nodes)}", *at, k)

    def _carrier(self, name: str, component: str | None, dimension: int, at: KeyPath, only: str = "") -> None:
        """Refuse a name that is no node or batten, or a component it does not have."""
        battens = {batten.name for batten in self.battens}
        known = {"node": set(self.nodes), "batten": battens}.get(only, {*self.nodes, *battens})
        if name not in known:
            raise RuleError(f"unknown {only or 'node or batten'} '{name}'; {did_you_mean(name, known)}", *at)
        if component is None:
            return
        if dimension == 2 and component not in ("x", "y", "rz"):
            raise RuleError(f"'{component}' is no component of a planar truss; use x, y or rz", *at)
        if component.startswith("r") and name not in battens:
            raise RuleError(f"'{component}': the pin-ended node '{name}' has no rotation; name a batten", *at)
