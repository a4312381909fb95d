"""The study file: the whole of it, and the half that says what is optimized."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

from pydantic import Field, ModelWrapValidatorHandler, PrivateAttr, Tag, model_validator

from fosopt.errors import StudyError
from fosopt.study.schema_actuators import Actuator, Placement
from fosopt.study.schema_axes import SecondAxis
from fosopt.study.schema_base import (
    ONE_OR_LIST,
    TEXT_OR_LIST,
    AnyQuantity,
    Area,
    Count,
    DerivativeGain,
    Gain,
    Identifier,
    IntegralGain,
    Label,
    Mass,
    MetricExpression,
    PositiveFraction,
    PositiveFrequency,
    PositiveInertia,
    PositiveRatio,
    PositiveTime,
    ProportionalGain,
    Prose,
    RuleError,
    Section,
    Stiffness,
    unique,
)
from fosopt.study.schema_certificates import Certificates
from fosopt.study.schema_loop import Limits
from fosopt.study.schema_rules import check_study
from fosopt.study.schema_structures import Structure
from fosopt.study.schema_sweep import Sweep
from fosopt.study.schema_system import Controller, Damping, Disturbance, Hub, Mirror, Modes, Step
from fosopt.study.schema_truss import Component
from fosopt.study.source import Source

Groups = Annotated[dict[Identifier, Annotated[tuple[Label, ...], Field(min_length=1)]], Field(min_length=1)]


def _own_name(data: dict[str, Any]) -> Any:
    return data["quantity"]


def _default_scale(data: dict[str, Any]) -> Any:
    return "log" if data["lower"] > 0 else "linear"


class _Variable(Section):
    """What every design variable has beside its bounds."""

    quantity: str
    """What varies."""
    name: Identifier = Field(default_factory=_own_name)
    """Name in expressions, `cases` and `design`; the quantity itself if left out."""
    lower: float
    """Least value allowed."""
    upper: float
    """Largest value allowed."""
    start: float | None = None
    """Where the search begins; if left out, the value in the section of the system (of members their
    mean)."""
    scale: Literal["log", "linear"] = Field(default_factory=_default_scale)
    """How the solver sees it: `log` by ratios, the default with a lower bound above zero, or `linear`."""

    @property
    def is_scalar(self) -> bool:
        """Whether it has one value, whatever the structure."""
        return True

    @property
    def of_second_axis(self) -> bool:
        """Whether it is set about a second axis alone."""
        return False

    @model_validator(mode="after")
    def _check_bounds(self) -> Self:
        if self.upper <= self.lower:
            raise RuleError("'upper' is not above 'lower'; change one of them", "upper")
        if self.start is not None and not self.lower <= self.start <= self.upper:
            raise RuleError("the start lies outside the bounds; move it between 'lower' and 'upper'", "start")
        if self.scale == "log" and self.lower <= 0:
            raise RuleError("a log scale needs a lower bound above zero; write 'scale: linear'", "scale")
        return self


class _MemberVariable(_Variable):
    groups: Groups | None = None
    """Named groups of members, each with the names or patterns (`L*`) of members that share one value."""
    group_by: str | None = None
    """What shares one value: nothing (`member`, the default without `groups`), or bars of one kind and so on."""

    @property
    def is_scalar(self) -> bool:
        """Whether it has one value, whatever the structure."""
        return self.group_by == "all"

    @model_validator(mode="after")
    def _check_groups(self) -> Self:
        if self.groups is not None and self.group_by is not None:
            raise RuleError("'groups' and 'group_by' exclude each other; remove one", "group_by", of_key=True)
        if self.groups is None and self.group_by is None:
            raise RuleError("'group_by' is empty; give one, such as member or all", "group_by")
        return self


def _default_group_by(data: dict[str, Any]) -> Any:
    return "member" if data["groups"] is None else None


class AreaVariable(_MemberVariable):
    """Cross-section areas of bars."""

    quantity: Literal["area"]
    group_by: Literal["member", "bay", "kind", "all"] | None = Field(default_factory=_default_group_by)
    kinds: Annotated[tuple[Label, ...], Field(min_length=1)] | None = None
    """Kinds of bars it is about; all if left out."""
    lower: Area
    upper: Area
    start: Area | None = None


class BattenMassVariable(_MemberVariable):
    """Masses of battens."""

    quantity: Literal["batten_mass"]
    group_by: Literal["member", "bay", "all"] | None = Field(default_factory=_default_group_by)
    lower: Mass
    upper: Mass
    start: Mass | None = None


class SpringStiffnessVariable(_MemberVariable):
    """Stiffnesses of springs to ground, of translational or of rotational ones."""

    quantity: Literal["spring_stiffness"]
    group_by: Literal["member", "component", "all"] | None = Field(default_factory=_default_group_by)
    components: Annotated[tuple[Component, ...], Field(min_length=1)] | None = None
    """Directions of the springs it is about; all if left out."""
    lower: Stiffness
    upper: Stiffness
    start: Stiffness | None = None


class _AxisVariable(_Variable):
    axis: Literal["second"] | None = None
    """`second` sets it about the second axis alone; left out, about the first, and the second where that has no own."""

    @property
    def of_second_axis(self) -> bool:
        """Whether it is set about a second axis alone."""
        return self.axis is not None


class MirrorInertiaVariable(_AxisVariable):
    """The mirror's inertia."""

    quantity: Literal["mirror_inertia"]
    lower: PositiveInertia
    upper: PositiveInertia
    start: PositiveInertia | None = None


class MirrorInertiaRatioVariable(_Variable):
    """The mirror's inertia over that of the structure about the hub."""

    quantity: Literal["mirror_inertia_ratio"]
    lower: PositiveRatio
    upper: PositiveRatio
    start: PositiveRatio | None = None


class FrequencyVariable(_AxisVariable):
    """The mirror's flexure frequency, or the crossover that sets the gain."""

    quantity: Literal["mirror_frequency", "crossover"]
    lower: PositiveFrequency
    upper: PositiveFrequency
    start: PositiveFrequency | None = None


class GainVariable(_AxisVariable):
    """The gain of the controller."""

    quantity: Literal["gain"]
    lower: Gain
    upper: Gain
    start: Gain | None = None


class ProportionalVariable(_AxisVariable):
    """The proportional gain kp."""

    quantity: Literal["kp"]
    lower: ProportionalGain
    upper: ProportionalGain
    start: ProportionalGain | None = None


class IntegralVariable(_AxisVariable):
    """The integral gain ki."""

    quantity: Literal["ki"]
    lower: IntegralGain
    upper: IntegralGain
    start: IntegralGain | None = None


class DerivativeVariable(_AxisVariable):
    """The derivative gain kd."""

    quantity: Literal["kd"]
    lower: DerivativeGain
    upper: DerivativeGain
    start: DerivativeGain | None = None


Variable = Annotated[
    AreaVariable
    | BattenMassVariable
    | SpringStiffnessVariable
    | MirrorInertiaVariable
    | MirrorInertiaRatioVariable
    | FrequencyVariable
    | GainVariable
    | ProportionalVariable
    | IntegralVariable
    | DerivativeVariable,
    Field(discriminator="quantity"),
]


class Objective(Section):
    """What is made as small as possible, and what people call it."""

    minimize: MetricExpression
    """Metric or expression to make small."""
    label: Label | None = None
    """What tables and figures call it."""


class Constraint(Section):
    """Bounds on a metric or an expression of metrics, and what people call it."""

    metric: MetricExpression
    """Metric or expression to bound."""
    label: Label | None = None
    """What tables and figures call it."""
    lower: AnyQuantity | None = None
    """Least value allowed."""
    upper: AnyQuantity | None = None
    """Largest value allowed."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.lower is None and self.upper is None:
            raise RuleError("the constraint has no bound; add 'lower' or 'upper'")
        if self.lower is not None and self.upper is not None and self.upper < self.lower:
            raise RuleError("'upper' is below 'lower'; swap or change them", "upper")
        return self


class Front(Section):
    """How finely the Pareto front of two objectives is drawn."""

    points: Annotated[int, Field(strict=True, ge=2, le=10_000)]
    """Number of points of the Pareto front, both ends included."""


Strategy = Literal["simultaneous", "nested", "sequential"]


class Solve(Section):
    """How the problem is solved."""

    strategy: Strategy = "simultaneous"
    """Structure and control at once, control within structure, or structure first and control after it."""
    compare: tuple[Strategy, ...] = ()
    """Other strategies to draw a front with, beside the main one."""
    starts: Count = 1
    """Number of starts per point; those after the first are drawn at random within the bounds."""
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 1
    """Seed of the random starts."""
    tolerance: PositiveFraction = 1e-6
    """Scaled optimality tolerance of IPOPT."""
    max_iterations: Count = 300
    """Most iterations per optimization."""
    time_limit: PositiveTime = 60.0
    """Longest time per optimization."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        unique(((name, ("compare", k)) for k, name in enumerate(self.compare)), "strategy")
        if self.strategy in self.compare:
            at = self.compare.index(self.strategy)
            raise RuleError(
                f"'{self.strategy}' is the strategy itself; compare with another one", "compare", at
            )
        return self


class Case(Section):
    """The same problem with a subset of the variables free."""

    name: Label
    """What tables and figures call the case."""
    free: Annotated[
        Annotated[Literal["all", "none"], Tag("text")] | Annotated[tuple[Identifier, ...], Tag("list")],
        TEXT_OR_LIST,
    ]
    """Variables that are free, the others staying at their start: `all`, `none` or a list of names."""


Values = Annotated[
    Annotated[AnyQuantity, Tag("one")] | Annotated[tuple[AnyQuantity, ...], Field(min_length=1), Tag("list")],
    ONE_OR_LIST,
]


class Study(Section):
    """A study file that has been understood: all numbers in SI, all defaults filled in."""

    fosopt: Literal[1]
    """Version of this format."""
    name: Label
    """What the study is called."""
    kind: Literal["codesign", "analysis", "sweep"] = "codesign"
    """Optimize a design, judge one design, or compute many over axes."""
    description: Prose = ""
    """Text for whoever reads the report."""
    structure: Structure
    """What carries the mirror."""
    hub: Hub = Hub()
    """How the hub is held."""
    damping: Damping
    """Damping of the structure's modes."""
    modes: Modes | None = None
    """Which modes the design model keeps; all if left out (of a truss of more than 500 degrees of freedom the
    lowest)."""
    mirror: Mirror
    """The fast steering mirror."""
    controller: Controller
    """The controller of the mirror."""
    second_axis: SecondAxis | None = None
    """A second axis of the mirror, which the structure couples to the first; none if left out."""
    placement: Placement | None = None
    """Where the loop acts, reacts and senses; bicollocated if left out."""
    actuators: tuple[Actuator, ...] = ()
    """Reaction-mass actuators on the structure."""
    disturbances: tuple[Disturbance, ...] = ()
    """What makes the line of sight jitter; each has a metric `jitter_<name>`."""
    step: Step | None = None
    """The step command that `step_offset` and `step_rms` judge."""
    limits: Limits | None = None
    """What the mirror can do; every design is checked for it."""
    variables: tuple[Variable, ...] = ()
    """What an optimization may change."""
    objectives: Annotated[tuple[Objective, ...], Field(max_length=2)] = ()
    """What to make small: one, or two for a Pareto front."""
    constraints: tuple[Constraint, ...] = ()
    """What every design must keep."""
    front: Front | None = None
    """The Pareto front; needed with two objectives."""
    solve: Solve = Solve()
    """How to optimize."""
    cases: tuple[Case, ...] = ()
    """Optimizations of some of the variables each, with a single objective."""
    certificates: Certificates | None = None
    """Lower bounds to prove beside every point; none if left out."""
    sweep: Sweep | None = None
    """Axes and outputs; needed with `kind: sweep`."""
    requirements: dict[str, AnyQuantity] = Field(default_factory=dict)
    """Largest allowed value of a metric, by its name; the report says which are met."""
    requirement_line: Label | None = None
    """CSV file (`frequency_hz,cumulative_rms_urad`) of the most jitter may have accumulated below each
    frequency; judged, and no constraint."""
    design: dict[Identifier, Values] = Field(default_factory=dict)
    """Values of variables by name, one per group: the design to judge, or to start from."""

    _base: Path = PrivateAttr(default=Path())
    _source: Source | None = PrivateAttr(default=None)

    @model_validator(mode="wrap")
    @classmethod
    def _check_sections(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        study = handler(data)
        if isinstance(data, Mapping):
            check_study(study, data)
        return study

    @property
    def base(self) -> Path:
        """Directory that paths of side files start from; no part of what makes studies equal."""
        return self._base

    def error(self, message: str, *path: str | int) -> StudyError:
        """An error about what stands at a path, with its place in the file where the study came from one."""
        if self._source is not None:
            return self._source.error(message, path)
        return StudyError(message, path=".".join(str(key) for key in path) or None)

    def __eq__(self, other: object) -> bool:
        """Whether all keys are equal, wherever the files stand."""
        return isinstance(other, Study) and self.__dict__ == other.__dict__

    def variable(self, name: str) -> Variable | None:
        """The variable of this name, if there is one."""
        return next((variable for variable in self.variables if variable.name == name), None)

    def given(self, quantity: str, second_axis: bool = False) -> float | None:
        """Value of a scalar quantity in the sections of the system; None where another one fixes it."""
        of_controller = quantity in ("gain", "crossover", "kp", "ki", "kd")
        key = quantity.removeprefix("mirror_")
        second = self.second_axis if second_axis else None
        if second is not None and of_controller and second.controller is not None:
            return cast(float | None, getattr(second.controller, key))
        if second is not None and not of_controller and getattr(second, key) is not None:
            return cast(float | None, getattr(second, key))
        return cast(float | None, getattr(self.controller if of_controller else self.mirror, key))
