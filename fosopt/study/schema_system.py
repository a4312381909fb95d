"""The physical half of the study file beside the structure: hub, damping, mirror, loop, disturbances."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, Tag, model_validator

from fosopt.study.schema_actuators import ReactionMass
from fosopt.study.schema_base import (
    TEXT_OR_LIST,
    Angle,
    Count,
    DerivativeGain,
    Fraction,
    Frequency,
    Gain,
    Identifier,
    IntegralGain,
    Label,
    Mass,
    Number,
    PositiveFrequency,
    PositiveInertia,
    PositiveRatio,
    ProportionalGain,
    Quantity,
    RotationalStiffness,
    RuleError,
    Section,
    Time,
    ascending,
    exactly_one,
    parsed,
)
from fosopt.study.schema_names import SIGNAL

Order = Annotated[int, Field(strict=True, ge=1, le=8)]
PositiveSignal = Annotated[float, Quantity(None, "positive")]
Coefficients = Annotated[tuple[Number, ...], Field(min_length=1, max_length=50)]


class Hub(Section):
    """What holds the hub's rotation: nothing, a clamp, or an attitude loop."""

    type: Literal["free", "fixed", "held"] = "free"
    bandwidth: PositiveFrequency | None = None
    damping_ratio: PositiveRatio | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key in ("bandwidth", "damping_ratio"):
            given = getattr(self, key) is not None
            if given and self.type != "held":
                raise RuleError(
                    f"'{key}' belongs to a held hub; remove it or write 'type: held'", key, of_key=True
                )
            if not given and self.type == "held":
                raise RuleError(f"a held hub needs '{key}'; add it")
        return self


DampingRows = Annotated[tuple[tuple[Frequency, Fraction], ...], Field(min_length=2)]
Table = Annotated[Annotated[Label, Tag("text")] | Annotated[DampingRows, Tag("list")], TEXT_OR_LIST]


class Damping(Section):
    """Damping ratios of the structure's modes: one for all, one per mode, or a table over frequency."""

    uniform: Fraction | None = None
    per_mode: Annotated[tuple[Fraction, ...], Field(min_length=1)] | None = None
    table: Table | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "uniform", "per_mode", "table")
        if isinstance(self.table, tuple):
            ascending((row[0] for row in self.table), "table")
        return self


class Modes(Section):
    """Modal truncation of the design model."""

    count: Count | None = None
    below: PositiveFrequency | None = None
    keep: Annotated[tuple[Count, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "count", "below", "keep")
        ascending(self.keep or (), "keep")
        return self


class Mirror(Section):
    """The fast steering mirror and its flexure."""

    port: Identifier = "tip"
    mass_fraction: Fraction | None = None
    mass: Mass | None = None
    inertia_ratio: PositiveRatio | None = None
    inertia: PositiveInertia | None = None
    frequency: Frequency | None = None
    stiffness: RotationalStiffness | None = None
    damping_ratio: Annotated[float, Quantity("ratio", "nonnegative")]
    reaction_mass: ReactionMass | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "mass_fraction", "mass")
        exactly_one(self, "inertia_ratio", "inertia")
        exactly_one(self, "frequency", "stiffness")
        return self


class Controller(Section):
    """The PID controller of the fast steering mirror.

    K(s) = gain (kd s² + kp s + ki)/s                              [Barker1991] Eq. (3.25)
    """

    type: Literal["pid"]
    kd: DerivativeGain = 1.0
    kp: ProportionalGain
    ki: IntegralGain
    gain: Gain | None = None
    crossover: PositiveFrequency | None = None
    rolloff: PositiveFrequency | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "gain", "crossover")
        if self.kd == self.kp == self.ki == 0:
            raise RuleError("kd, kp and ki are all zero; give at least one above zero", "kp")
        return self


class LowPass(Section):
    """Noise through a low pass, scaled to the rms of the filtered signal."""

    type: Literal["low_pass"]
    corner: PositiveFrequency
    order: Order = 1
    rms: PositiveSignal

    relative_degree: ClassVar[int] = 1


class HighPass(Section):
    """Noise through a high pass, with its one-sided density far above the corner."""

    type: Literal["high_pass"]
    corner: PositiveFrequency
    order: Order = 1
    density: PositiveSignal

    relative_degree: ClassVar[int] = 0


class BandPass(Section):
    """Noise through a band pass, scaled to the rms of the filtered signal."""

    type: Literal["band_pass"]
    lower: PositiveFrequency
    upper: PositiveFrequency
    order: Order = 1
    rms: PositiveSignal

    relative_degree: ClassVar[int] = 1

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.upper <= self.lower:
            raise RuleError("'upper' is not above 'lower'; swap or change them", "upper")
        return self


class White(Section):
    """White noise of a one-sided density."""

    type: Literal["white"]
    density: PositiveSignal

    relative_degree: ClassVar[int] = 0


class Rational(Section):
    """White noise of two-sided density one through H(s); coefficients start at the highest power."""

    type: Literal["rational"]
    numerator: Coefficients
    denominator: Coefficients

    @property
    def relative_degree(self) -> int:
        """Degree of the denominator less that of the numerator."""
        return len(self.denominator) - len(self.numerator)

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key in ("numerator", "denominator"):
            if getattr(self, key)[0] == 0:
                raise RuleError(
                    "the first coefficient is zero; start at the highest power that occurs", key, 0
                )
        if self.relative_degree < 0:
            raise RuleError("H(s) has more zeros than poles; raise the denominator's degree", "denominator")
        return self


Filter = Annotated[LowPass | HighPass | BandPass | White | Rational, Field(discriminator="type")]


class Disturbance(Section):
    """A random signal: where it acts, and its spectrum as a filter or a PSD table."""

    name: Identifier
    at: Literal["mirror_torque", "hub_torque", "line_of_sight", "sensor_noise"]
    filter: Filter | None = None
    psd: Label | None = None
    band: tuple[Frequency, PositiveFrequency] | None = None

    @model_validator(mode="before")
    @classmethod
    def _units(cls, data: Any) -> Any:
        """Convert what has the unit of the signal, which the filter alone cannot know."""
        if not isinstance(data, dict) or not isinstance(data.get("filter"), dict):
            return data
        signal = SIGNAL.get(data["at"]) if isinstance(data.get("at"), str) else None
        inner = dict(data["filter"])
        for key, dimension in (("rms", signal), ("density", f"{signal}_density")):
            if signal is not None and key in inner:
                inner[key] = parsed(inner[key], Quantity(dimension, "positive"), "filter", key)
        return {**data, "filter": inner}

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "filter", "psd")
        if self.band is not None and self.band[1] <= self.band[0]:
            raise RuleError("the band's end is not above its start; swap or change them", "band")
        endless = self.filter is not None and self.band is None and self.filter.relative_degree == 0
        if endless and self.at == "line_of_sight":
            raise RuleError(
                "this line-of-sight disturbance has infinite power; add a band such as [0.1 Hz, 2 kHz]"
            )
        return self


class Step(Section):
    """The step command whose response is judged in a window."""

    command: Angle
    window: tuple[Time, Time]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.window[1] <= self.window[0]:
            raise RuleError("the window's end is not after its start; swap or change them", "window")
        return self
