"""What acts on the structure beside the mirror, and where the loop acts, reacts and senses."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import model_validator

from fosopt.study.schema_base import (
    Inertia,
    Label,
    Mass,
    PositiveFrequency,
    PositiveRatio,
    Quantity,
    RuleError,
    Section,
    exactly_one,
    parsed,
)


class ReactionMass(Section):
    """The reaction mass of a reactionless mirror, as shares of the mirror's own properties."""

    inertia_ratio: PositiveRatio = 1.0
    """Its inertia over the mirror's."""
    stiffness_ratio: PositiveRatio = 1.0
    """Its stiffness over the mirror's."""
    torque_ratio: Annotated[float, Quantity("ratio", "nonnegative")] = 1.0
    """Torque on it over that on the mirror, in the opposite direction."""


class Placement(Section):
    """Ports of the loop that differ from a bicollocated mirror's."""

    reaction: Label | None = None
    """Port the control torque reacts on, in place of the mirror's own."""
    sensor: Label | None = None
    """Port whose motion is sensed, in place of the mirror's."""
    action: Label | None = None
    """Port the control torque acts on, in place of the mirror."""


class Actuator(Section):
    """A reaction-mass actuator at a port: a mass where the port moves along, an inertia where it turns."""

    port: Label
    """Where it is mounted."""
    mass: Mass | None = None
    """Its proof mass, at a port that moves along."""
    inertia: Inertia | None = None
    """Its inertia, at a port that turns."""
    frequency: PositiveFrequency
    """Its natural frequency on a rigid support."""
    damping_ratio: Annotated[float, Quantity("ratio", "nonnegative")]
    """Its damping ratio on a rigid support."""
    rate_gain: Annotated[float, Quantity(None, "nonnegative")] = 0.0
    """Gain of its relative rate feedback, [N s/m] or [N m s/rad]; zero makes it a passive absorber."""

    @model_validator(mode="before")
    @classmethod
    def _units(cls, data: Any) -> Any:
        # With both or neither of mass and inertia there is no right unit yet, and that is the error to name.
        if isinstance(data, dict) and "rate_gain" in data and ("mass" in data) != ("inertia" in data):
            dimension = "rotational_damper" if "inertia" in data else "damper"
            gain = parsed(data["rate_gain"], Quantity(dimension, "nonnegative"), "rate_gain")
            return {**data, "rate_gain": gain}
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "mass", "inertia")
        for key in ("mass", "inertia"):
            if getattr(self, key) == 0:
                raise RuleError("a proof mass of zero does nothing; give one above zero, or remove it", key)
        return self
