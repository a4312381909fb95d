"""The structure of a study: a truss, a beam, a chain of bodies and springs, or one from files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema

from fosopt.study.schema_base import (
    Count,
    Identifier,
    Length,
    PositiveFrequency,
    PositiveInertia,
    Quantity,
    RuleError,
    Section,
    exactly_one,
    unique,
)
from fosopt.study.schema_imports import BulkData, Imported
from fosopt.study.schema_truss import BarkerTruss, Truss

PositiveLength = Annotated[float, Quantity("length", "positive")]
MassPerLength = Annotated[float, Quantity("mass_per_length", "positive")]
BendingStiffness = Annotated[float, Quantity("bending_stiffness", "positive")]
AxialStiffness = Annotated[float, Quantity("force", "positive")]
PositiveRotationalStiffness = Annotated[float, Quantity("rotational_stiffness", "positive")]


class Beam(Section):
    """A uniform Euler-Bernoulli beam in the coordinates of its modes, its hub at one end, its tip at the other."""

    type: Literal["beam"]
    """Kind of structure."""
    boundary: Literal["fixed", "pinned"] = "pinned"
    """Clamped at the root, or free to turn about it."""
    length: PositiveLength
    """Length from root to tip."""
    mass_per_length: MassPerLength
    """Mass per length."""
    bending_stiffness: BendingStiffness
    """Bending stiffness E I."""
    axial_stiffness: AxialStiffness
    """Axial stiffness E A."""
    lateral_modes: Count = 6
    """Number of bending modes."""
    longitudinal_modes: Annotated[int, Field(strict=True, ge=0)] = 1
    """Number of modes along the beam."""
    stations: dict[Identifier, tuple[Length, Literal["x", "y", "rz"]]] = Field(default_factory=dict)
    """More ports: name to distance from the root and direction."""

    @property
    def ports(self) -> Mapping[str, tuple[float, str]]:
        """Name of each port to its distance from the root [m] and its component."""
        return {"hub": (0.0, "rz"), "tip": (self.length, "rz"), **self.stations}

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, (x, _) in self.stations.items():
            if name in ("hub", "tip"):
                raise RuleError(
                    f"every beam has the port '{name}'; choose another name", "stations", name, of_key=True
                )
            if not 0 <= x <= self.length:
                raise RuleError(
                    f"{x:g} m is not on the beam; give 0 to {self.length:g} m", "stations", name, 0
                )
        return self


class Body(Section):
    """A body of a chain, which turns."""

    name: Identifier
    """Name of the body, which is a port."""
    inertia: PositiveInertia
    """Its inertia."""


class ChainSpring(Section):
    """A torsion spring, given also by the frequency of its two bodies alone on it."""

    stiffness: PositiveRotationalStiffness | None = None
    """Stiffness of the spring."""
    frequency: PositiveFrequency | None = None
    """Natural frequency of its two bodies alone on it, in place of `stiffness`."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "stiffness", "frequency")
        return self


class Chain(Section):
    """Bodies in a row, each joined to the next by a torsion spring; its hub is the first one, its tip the last."""

    type: Literal["chain"]
    """Kind of structure."""
    held: Annotated[bool, Field(strict=True)] = False
    """Whether the first body is held still."""
    bodies: Annotated[tuple[Body, ...], Field(min_length=2)]
    """The bodies, from hub to tip."""
    springs: tuple[ChainSpring, ...]
    """The springs, one between each two neighbors."""

    @property
    def ports(self) -> frozenset[str]:
        """The names of its ports."""
        return frozenset({"hub", "tip", *(body.name for body in self.bodies)})

    @model_validator(mode="after")
    def _check(self) -> Self:
        unique(((body.name, ("bodies", k, "name")) for k, body in enumerate(self.bodies)), "body")
        last = len(self.bodies) - 1
        for k, body in enumerate(self.bodies):
            if k != {"hub": 0, "tip": last}.get(body.name, k):
                place = "first" if body.name == "hub" else "last"
                raise RuleError(
                    f"'{body.name}' is the port at the {place} body; choose another name", "bodies", k, "name"
                )
        if len(self.springs) != last:
            raise RuleError(
                f"{last + 1} bodies need {last} springs, one between each two neighbors; {len(self.springs)} given",
                "springs",
            )
        return self


class _OrDeck:
    """Annotation of a structure that may be a deck, which has become a truss when sections are understood."""

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"anyOf": [handler(schema), handler(BulkData.__pydantic_core_schema__)]}


Structure = Annotated[BarkerTruss | Truss | Beam | Chain | Imported, Field(discriminator="type"), _OrDeck()]
