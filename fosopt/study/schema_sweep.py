"""The section ``sweep`` of a study file: what is varied, how it is sampled, and what is computed at every point."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, create_model, model_validator

from fosopt.errors import did_you_mean
from fosopt.study.schema_base import (
    AnyQuantity,
    Count,
    Identifier,
    MetricExpression,
    Quantity,
    RuleError,
    Section,
    exactly_one,
    parsed,
    unique,
)
from fosopt.study.schema_imports import IMPORTED
from fosopt.units import quote

if TYPE_CHECKING:
    from fosopt.study.schema import Study

AXES: dict[str, Quantity] = {
    "mirror_inertia": Quantity("inertia", "positive"),
    "mirror_inertia_ratio": Quantity("ratio", "positive"),
    "mirror_frequency": Quantity("frequency", "positive"),
    "mirror_damping_ratio": Quantity("ratio", "nonnegative"),
    "gain": Quantity("control_gain", "positive"),
    "crossover": Quantity("frequency", "positive"),
    "kp": Quantity("rate", "nonnegative"),
    "ki": Quantity("rate_squared", "nonnegative"),
    "kd": Quantity("ratio", "nonnegative"),
    "mirror_mass": Quantity("mass", "nonnegative"),
    "damping_ratio": Quantity("ratio", "nonnegative", below=1.0),
    "area_scale": Quantity("ratio", "positive"),
}
"""What a numeric axis may vary; `damping_ratio` is that of every structural mode, `area_scale` multiplies all areas."""
LISTED = ("bays", "mirror_port")
"""What an axis may vary by listed values only: a whole number and a name."""
STRUCTURAL = ("bays", "mirror_port", "mirror_mass", "area_scale", "damping_ratio")
"""Axes that change the structure's modal set; all others change mirror and controller only."""
STABLE, ONE_MINUS = "stable", "one_minus_separation"
"""Outputs of a sweep that are no metrics: stability as 0 or 1, and 1 − β_k of every mode to its last digit."""
_EXCLUSIVE = (("gain", "crossover"), ("mirror_inertia", "mirror_inertia_ratio"))
_MOST_POINTS, _MOST_BAYS = 1_000_000_000, 5000


class _Span(Section):
    """Values between two ends."""

    points: Annotated[int, Field(strict=True, ge=2, le=1_000_000)] | None = None
    """Number of values, both ends included; on a grid only."""


# 'from' is no name Python can spell.
_ENDS: dict[str, Any] = {
    "from": (AnyQuantity, Field(description="First value.")),
    "to": (AnyQuantity, Field(description="Last value.")),
}
Range: Any = create_model("Range", __base__=_Span, **_ENDS)


class Axis(Section):
    """A quantity and its values: evenly spaced, spaced by equal ratios, or listed."""

    quantity: str
    """What varies, such as `mirror_inertia_ratio`."""
    name: Identifier = Field(default_factory=lambda data: data["quantity"])
    """Name in files and figures; the quantity if left out."""
    linear: Range | None = None
    """Evenly spaced values."""
    log: Range | None = None
    """Values spaced by equal ratios."""
    list: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None
    """Listed values."""

    @property
    def span(self) -> Any:
        """The range, where it is given by one."""
        return self.linear or self.log

    @property
    def ends(self) -> tuple[float, float]:
        """Least and largest value of a numeric axis."""
        if self.list is not None:
            return min(self.list), max(self.list)
        return getattr(self.span, "from"), self.span.to

    @model_validator(mode="before")
    @classmethod
    def _in_units_of_the_quantity(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or not isinstance(data.get("quantity"), str):
            return data
        quantity = data["quantity"]
        if quantity not in AXES and quantity not in LISTED:
            raise RuleError(
                f"no axis varies '{quantity}'; {did_you_mean(quantity, (*AXES, *LISTED))}", "quantity"
            )
        found = dict(data)
        if isinstance(data.get("list"), list | tuple):
            found["list"] = tuple(_value(quantity, v, "list", k) for k, v in enumerate(data["list"]))
        for key in ("linear", "log"):
            span = data.get(key)
            if span is not None and quantity in LISTED:
                raise RuleError(f"'{quantity}' has no range; write 'list: [...]'", key, of_key=True)
            if isinstance(span, Mapping):
                ends = {e: _value(quantity, span[e], key, e) for e in ("from", "to") if e in span}
                found[key] = {**span, **ends}
        return found

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, "linear", "log", "list")
        if self.list is not None:
            unique(((str(v), ("list", k)) for k, v in enumerate(self.list)), "value")
            return self
        key = "linear" if self.linear is not None else "log"
        low, high = self.ends
        if not low < high:
            raise RuleError("'to' is not above 'from'; swap or change them", key, "to")
        if key == "log" and low <= 0:
            raise RuleError("a range by equal ratios needs 'from' above zero; write 'linear'", key, "from")
        return self


def _value(quantity: str, value: object, *at: str | int) -> object:
    """A value of an axis in SI units, refused where it is out of the physical range."""
    if quantity in AXES:
        return parsed(value, AXES[quantity], *at)
    if quantity == "bays":
        good = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MOST_BAYS
    else:
        good = isinstance(value, str)
    if not good:
        wanted = f"a whole number from 1 to {_MOST_BAYS}" if quantity == "bays" else "the name of a port"
        raise RuleError(f"{quote(value)} is not allowed; give {wanted}", *at)
    return value


class BoundarySearch(Section):
    """Search for the boundaries of stability along one axis, on one line per point of the other axes.

    Of a loop that samples they are those of the sampled loop.
    """

    along: Identifier
    """Name of the axis to search along."""
    samples: Annotated[int, Field(strict=True, ge=3, le=100_000)] = 41
    """Values tried on each line before boundaries between them are solved for."""


class Sweep(Section):
    """One system over a set of points."""

    axes: Annotated[tuple[Axis, ...], Field(min_length=1, max_length=8)]
    """The quantities that vary."""
    sampling: Literal["grid", "latin_hypercube", "sobol"] = "grid"
    """All combinations of the axes' values, or points drawn within their ranges."""
    points: Count | None = None
    """Number of points to draw; not on a grid."""
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 1
    """Seed of the drawing."""
    outputs: Annotated[tuple[MetricExpression, ...], Field(min_length=1)]
    """What to compute: metrics, expressions, `stable`, `one_minus_separation`; an indexed metric without
    index stands for all modes."""
    boundary: BoundarySearch | None = None
    """Where the loop loses stability, solved for along one axis."""

    @property
    def ordered(self) -> tuple[Axis, ...]:
        """The axes in the order of the results: first those that change the structure, the last one varying fastest."""
        return tuple(sorted(self.axes, key=lambda axis: axis.quantity not in STRUCTURAL))

    @property
    def count(self) -> int:
        """Number of points."""
        if self.points is not None:
            return self.points
        total = 1
        for axis in self.axes:
            total *= axis.span.points if axis.list is None else len(axis.list)
        return total

    @model_validator(mode="after")
    def _check(self) -> Self:
        unique(((a.quantity, ("axes", k, "quantity")) for k, a in enumerate(self.axes)), "quantity")
        unique(((a.name, ("axes", k, "name")) for k, a in enumerate(self.axes)), "axis")
        unique(((e.text, ("outputs", k)) for k, e in enumerate(self.outputs)), "output")
        quantities = [axis.quantity for axis in self.axes]
        for first, second in _EXCLUSIVE:
            if first in quantities and second in quantities:
                raise RuleError(
                    f"'{first}' and '{second}' set the same thing; keep one of the axes",
                    *("axes", quantities.index(second), "quantity"),
                )
        self._check_points()
        self._check_boundary()
        return self

    def _check_points(self) -> None:
        grid = self.sampling == "grid"
        if grid and self.points is not None:
            raise RuleError("a grid has the points of its axes; remove 'points'", "points", of_key=True)
        if not grid and self.points is None:
            raise RuleError(f"'{self.sampling}' needs 'points'; add it", "sampling")
        for k, axis in enumerate(self.axes):
            if axis.list is not None:
                continue
            key = "linear" if axis.linear is not None else "log"
            if grid and axis.span.points is None:
                raise RuleError("the key 'points' is required on a grid; add it", "axes", k, key)
            if not grid and axis.span.points is not None:
                raise RuleError(
                    "points are drawn for all axes together; remove 'points' here",
                    *("axes", k, key, "points"),
                    of_key=True,
                )
        if self.count > _MOST_POINTS:
            raise RuleError(f"{self.count:.3g} points; a sweep has at most {_MOST_POINTS:.0e}", "axes")

    def _check_boundary(self) -> None:
        if self.boundary is None:
            return
        along = self.boundary.along
        axis = next((a for a in self.axes if a.name == along), None)
        if axis is None:
            names = did_you_mean(along, (a.name for a in self.axes))
            raise RuleError(f"no axis is named '{along}'; {names}", "boundary", "along")
        if axis.quantity in LISTED:
            raise RuleError(
                f"'{along}' has no values between its values; choose another axis", "boundary", "along"
            )
        if not axis.ends[0] < axis.ends[1]:
            raise RuleError(f"'{along}' has a single value; give a range to search", "boundary", "along")
        if self.sampling != "grid" and len(self.axes) > 1:
            raise RuleError(
                "boundaries over several axes need lines to search; write 'sampling: grid'",
                "boundary",
                of_key=True,
            )


def check_sweep(study: Study, check_output: Any) -> None:
    """Refuse a sweep that does not fit its system; `check_output` judges an expression of metrics."""
    sweep = study.sweep
    if study.kind != "sweep":
        if sweep is not None:
            raise RuleError(f"'kind: {study.kind}' has no 'sweep'; write 'kind: sweep'", "sweep", of_key=True)
        return
    if sweep is None:
        raise RuleError("a sweep needs the section 'sweep'; add it", "kind")
    none = (
        "variables",
        "objectives",
        "constraints",
        "front",
        "cases",
        "certificates",
        "design",
        "requirements",
    )
    for key in none:
        if getattr(study, key):
            raise RuleError(f"a sweep has no '{key}'; remove it or write 'kind: codesign'", key, of_key=True)
    for k, axis in enumerate(sweep.axes):
        _check_axis(study, axis, ("sweep", "axes", k))
    for k, output in enumerate(sweep.outputs):
        if array_of(output.text) is None and output.text != STABLE:
            check_output(output, ("sweep", "outputs", k))


def _check_axis(study: Study, axis: Axis, at: tuple[str | int, ...]) -> None:
    if axis.quantity == "bays" and study.structure.type != "barker_truss":
        raise RuleError(
            f"a {study.structure.type} has no bays to vary; use another axis or 'type: barker_truss'",
            *(*at, "quantity"),
        )
    if axis.quantity == "area_scale" and study.structure.type in ("beam", "chain", *IMPORTED):
        raise RuleError(
            f"a {study.structure.type.replace('_', ' ')} has no areas; use another axis", *at, "quantity"
        )
    for k, port in enumerate(axis.list or () if axis.quantity == "mirror_port" else ()):
        if port not in study.structure.ports:
            raise RuleError(
                f"unknown port '{port}'; {did_you_mean(port, study.structure.ports)}", *at, "list", k
            )


def array_of(text: str) -> str | None:
    """The metric of which an output asks for every mode; None for a single value."""
    from fosopt.study.schema_names import METRICS

    return text if text == ONE_MINUS or (text in METRICS and METRICS[text].indexed) else None
