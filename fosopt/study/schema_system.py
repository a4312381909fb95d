"""The physical half of the study file beside the structure: hub, damping, mirror, loop, disturbances."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import ConfigDict, Field, Tag, model_validator

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
from fosopt.study.schema_loop import (
    AntiAlias,
    IdealGains,
    LoopFilter,
    LoopSampling,
    ParallelGains,
    SeriesGains,
    gains_of_form,
)
from fosopt.study.schema_names import SIGNAL

Order = Annotated[int, Field(strict=True, ge=1, le=8)]
PositiveSignal = Annotated[float, Quantity(None, "positive")]
Coefficients = Annotated[tuple[Number, ...], Field(min_length=1, max_length=50)]


class Hub(Section):
    """What holds the hub's rotation: nothing, a clamp, or an attitude loop."""

    type: Literal["free", "fixed", "held"] = "free"
    """Free to turn, clamped, or held by a slow attitude loop."""
    bandwidth: PositiveFrequency | None = None
    """Natural frequency the attitude loop gives the rigid-body mode; with `type: held`."""
    damping_ratio: PositiveRatio | None = None
    """Damping ratio the attitude loop gives the rigid-body mode; with `type: held`."""

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
    """Damping ratios of the modes: one for all, one per mode, a table over frequency, or the structure's file's."""

    uniform: Fraction | None = None
    """One damping ratio for every elastic mode."""
    per_mode: Annotated[tuple[Fraction, ...], Field(min_length=1)] | None = None
    """Damping ratios in the order of the elastic modes, the last one repeated."""
    table: Table | None = None
    """CSV file `frequency_hz,damping_ratio`, or rows of frequency and damping ratio, straight between."""
    imported: Literal[True] | None = None
    """As the file of an imported structure has it."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "uniform", "per_mode", "table", "imported")
        if isinstance(self.table, tuple):
            ascending((row[0] for row in self.table), "table")
        return self


class Modes(Section):
    """Modal truncation of the design model."""

    count: Count | None = None
    """Keep this many of the lowest modes."""
    below: PositiveFrequency | None = None
    """Keep all modes below this frequency."""
    keep: Annotated[tuple[Count, ...], Field(min_length=1)] | None = None
    """Keep the modes of these numbers, the first is 1."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "count", "below", "keep")
        ascending(self.keep or (), "keep")
        return self


class OtherAxis(Section):
    """The ports of a mirror's second axis, and of the hub about it."""

    port: Identifier
    """Port of the mirror about the second axis."""
    hub: Identifier | None = None
    """Port of the hub about the second axis, if it turns."""


class Mirror(Section):
    """The fast steering mirror and its flexure."""

    port: Identifier = "tip"
    """Where it is mounted."""
    mass_fraction: Fraction | None = None
    """Its mass as a share of structure and mirror together, at the start design."""
    mass: Mass | None = None
    """Its mass, in place of `mass_fraction`."""
    inertia_ratio: PositiveRatio | None = None
    """Its inertia over that of the structure about the hub, at the start design."""
    inertia: PositiveInertia | None = None
    """Its inertia, in place of `inertia_ratio`."""
    frequency: Frequency | None = None
    """Its natural frequency on a rigid support."""
    stiffness: RotationalStiffness | None = None
    """Stiffness of its flexure, in place of `frequency`."""
    damping_ratio: Annotated[float, Quantity("ratio", "nonnegative")]
    """Its damping ratio on a rigid support."""
    reaction_mass: ReactionMass | None = None
    """The reaction mass that makes it reactionless."""
    other_axis: OtherAxis | None = None
    """Ports of the second axis of a mirror for which one loop stands for both axes."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "mass_fraction", "mass")
        exactly_one(self, "inertia_ratio", "inertia")
        exactly_one(self, "frequency", "stiffness")
        return self


def _with_gains_of_any_form(schema: dict[str, Any]) -> None:
    schema["required"] = [key for key in schema["required"] if key not in ("kp", "ki")]


class Controller(Section):
    """The PID controller of the fast steering mirror.

    K(s) = gain (kd s² + kp s + ki)/s                              [Barker1991] Eq. (3.25)

    or in the parallel, ideal or series form of other tools; then filters, and how it is sampled.
    """

    model_config = ConfigDict(json_schema_extra=_with_gains_of_any_form)

    type: Literal["pid"]
    """Kind of controller."""
    kd: DerivativeGain = 1.0
    """Derivative gain."""
    kp: ProportionalGain
    """Proportional gain; left out where another form is given."""
    ki: IntegralGain
    """Integral gain; left out where another form is given."""
    gain: Gain | None = None
    """Factor before the whole controller."""
    crossover: PositiveFrequency | None = None
    """Crossover on a rigid support, which sets the gain in place of `gain`."""
    rolloff: PositiveFrequency | None = None
    """Corner of the first-order roll-off of the derivative; an ideal derivative if left out."""
    parallel: ParallelGains | None = None
    """The gains in parallel form."""
    ideal: IdealGains | None = None
    """The gains in ideal form, also called standard."""
    series: SeriesGains | None = None
    """The gains in series form, also called interacting."""
    filters: tuple[LoopFilter, ...] = ()
    """Filters in series with the controller."""
    anti_alias: AntiAlias | None = None
    """Analog filter between sensor and sampler."""
    sampling: LoopSampling | None = None
    """How the controller samples; continuous if left out."""

    @model_validator(mode="before")
    @classmethod
    def _of_other_form(cls, data: Any) -> Any:
        return gains_of_form(data)

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "gain", "crossover")
        if self.kd == self.kp == self.ki == 0:
            raise RuleError("kd, kp and ki are all zero; give at least one above zero", "kp")
        return self


class LowPass(Section):
    """Noise through a low pass, scaled to the rms of the filtered signal."""

    type: Literal["low_pass"]
    """Kind of filter."""
    corner: PositiveFrequency
    """Corner of the Butterworth filter."""
    order: Order = 1
    """Order of the Butterworth filter."""
    rms: PositiveSignal
    """Rms of the filtered signal, in the unit of what the disturbance adds: torque or angle."""

    relative_degree: ClassVar[int] = 1


class HighPass(Section):
    """Noise through a high pass, with its one-sided density far above the corner."""

    type: Literal["high_pass"]
    """Kind of filter."""
    corner: PositiveFrequency
    """Corner of the Butterworth filter."""
    order: Order = 1
    """Order of the Butterworth filter."""
    density: PositiveSignal
    """One-sided amplitude density far above the corner, torque or angle per root hertz."""

    relative_degree: ClassVar[int] = 0


class BandPass(Section):
    """Noise through a band pass, scaled to the rms of the filtered signal."""

    type: Literal["band_pass"]
    """Kind of filter."""
    lower: PositiveFrequency
    """Lower corner of the Butterworth filter."""
    upper: PositiveFrequency
    """Upper corner of the Butterworth filter."""
    order: Order = 1
    """Order of the low pass it is made from, half its own."""
    rms: PositiveSignal
    """Rms of the filtered signal, in the unit of what the disturbance adds: torque or angle."""

    relative_degree: ClassVar[int] = 1

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.upper <= self.lower:
            raise RuleError("'upper' is not above 'lower'; swap or change them", "upper")
        return self


class White(Section):
    """White noise of a one-sided density."""

    type: Literal["white"]
    """Kind of filter."""
    density: PositiveSignal
    """One-sided amplitude density, torque or angle per root hertz."""

    relative_degree: ClassVar[int] = 0


class Rational(Section):
    """White noise of two-sided density one through H(s); coefficients start at the highest power."""

    type: Literal["rational"]
    """Kind of filter."""
    numerator: Coefficients
    """Coefficients of the numerator in powers of s, SI."""
    denominator: Coefficients
    """Coefficients of the denominator in powers of s, SI."""

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
    """A random signal: where it acts, and its spectrum as a filter, a PSD table or a table of cumulative rms."""

    name: Identifier
    """Its jitter is the metric `jitter_<name>`."""
    at: Literal["mirror_torque", "hub_torque", "line_of_sight", "sensor_noise"]
    """Where it acts."""
    axis: Literal["first", "second", "both"] | None = None
    """With `second_axis`, the axis it acts about; `both`, the default there, are alike and independent."""
    filter: Filter | None = None
    """Filter that shapes white noise into it."""
    psd: Label | None = None
    """CSV file of its spectrum: `frequency_hz,psd_N m^2/Hz`, or `asd_...` of an amplitude density."""
    cumulative_rms: Label | None = None
    """CSV file of its rms accumulated over frequency: `frequency_hz,cumulative_rms_urad`."""
    interpolation: Literal["linear", "log"] | None = None
    """Axes on which a `psd` is straight between its rows: `linear`, the default, or `log`."""
    band: tuple[Frequency, PositiveFrequency] | None = None
    """Frequencies its jitter is counted between; all if left out."""

    @property
    def table(self) -> str | None:
        """The file that holds its spectrum, if one does."""
        return self.psd if self.psd is not None else self.cumulative_rms

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
        exactly_one(self, "filter", "psd", "cumulative_rms")
        if self.interpolation is not None and self.psd is None:
            raise RuleError("'interpolation' belongs to a 'psd'; remove it", "interpolation", of_key=True)
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
    """Size of the step."""
    window: tuple[Time, Time]
    """Start and end of the time in which the error is judged, counted from the step."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.window[1] <= self.window[0]:
            raise RuleError("the window's end is not after its start; swap or change them", "window")
        return self
