"""What every part of the study file is made of: frozen sections and values that know their dimension."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    WithJsonSchema,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from fosopt.errors import did_you_mean
from fosopt.expressions import Expression, parse_expression
from fosopt.units import DIMENSIONS, QuantityError, noun, parse_quantity, quote

KeyPath = tuple[str | int, ...]


class RuleError(ValueError):
    """A broken rule; ``at`` leads from the section that found it to the value at fault."""

    def __init__(self, message: str, *at: str | int, of_key: bool = False) -> None:
        super().__init__(message)
        self.at = at
        self.of_key = of_key


class Section(BaseModel):
    """A part of the study file: frozen, and closed to unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    @classmethod
    def meaning(cls, key: str) -> str:
        """What a key is, as its docstring says, here or in the section this one is a kind of."""
        sections = (c for c in cls.__mro__ if issubclass(c, Section) and key in c.model_fields)
        text = next((text for c in sections if (text := c.model_fields[key].description)), "")
        return " ".join(text.split())

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Each key with its meaning and, of a quantity, how it is written."""
        found = handler(schema)
        for key, about in handler.resolve_ref_schema(found).get("properties", {}).items():
            quantity = quantity_of(cls.model_fields[key])
            written = "" if quantity is None else f" {quantity.written[:1].upper()}{quantity.written[1:]}."
            about["description"] = cls.meaning(key) + written
        return found

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            for key in data:
                if key not in cls.model_fields:
                    raise RuleError(
                        f"unknown key; {did_you_mean(str(key), cls.model_fields)}", key, of_key=True
                    )
        return data


@dataclass(frozen=True)
class Quantity:
    """Annotation of a float that may be written with a unit.

    Parameters
    ----------
    dimension
        A name of `fosopt.units.DIMENSIONS`, or None where the dimension follows from elsewhere.
    sign
        ``any``, ``nonnegative`` or ``positive``.
    below
        The value must stay below this, if given (SI).
    """

    dimension: str | None
    sign: str = "any"
    below: float | None = None

    def parse(self, value: object) -> float:
        """SI value of what the file says."""
        number = parse_quantity(value, self.dimension)
        kind = noun(self.dimension) if self.dimension else "a quantity"
        example = DIMENSIONS[self.dimension].example if self.dimension else "1"
        if self.sign == "positive" and number <= 0:
            raise QuantityError(f"{quote(value)} is not positive; give {kind} above zero, such as {example}")
        if self.sign == "nonnegative" and number < 0:
            raise QuantityError(f"{quote(value)} is negative; give {kind} of zero or more, such as {example}")
        if self.below is not None and number >= self.below:
            raise QuantityError(f"{quote(value)} is too large; give {kind} below {self.below:g}")
        return number

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.parse)

    @property
    def written(self) -> str:
        """How the file says it."""
        if self.dimension is None:
            return "a bare SI number, or text with a unit"
        kind = DIMENSIONS[self.dimension]
        name = self.dimension.replace("_", " ")
        return f"{name}: a bare number in {kind.unit}, or text such as {kind.example}"

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"anyOf": [{"type": "number"}, {"type": "string"}], "description": self.written}


def quantity_of(field: FieldInfo) -> Quantity | None:
    """The annotation of a key that is a quantity or may be one."""
    found = list(field.metadata)
    for part in get_args(field.annotation):
        found += getattr(part, "__metadata__", ())
    return next((each for each in found if isinstance(each, Quantity)), None)


AnyQuantity = Annotated[float, Quantity(None)]
Length = Annotated[float, Quantity("length")]
Area = Annotated[float, Quantity("area", "positive")]
Mass = Annotated[float, Quantity("mass", "nonnegative")]
Inertia = Annotated[float, Quantity("inertia", "nonnegative")]
PositiveInertia = Annotated[float, Quantity("inertia", "positive")]
Frequency = Annotated[float, Quantity("frequency", "nonnegative")]
PositiveFrequency = Annotated[float, Quantity("frequency", "positive")]
Time = Annotated[float, Quantity("time", "nonnegative")]
PositiveTime = Annotated[float, Quantity("time", "positive")]
Angle = Annotated[float, Quantity("angle", "positive")]
Fraction = Annotated[float, Quantity("ratio", "nonnegative", below=1.0)]
PositiveFraction = Annotated[float, Quantity("ratio", "positive", below=1.0)]
PositiveRatio = Annotated[float, Quantity("ratio", "positive")]
Number = Annotated[float, Quantity("ratio")]
Gain = Annotated[float, Quantity("control_gain", "positive")]
DerivativeGain = Annotated[float, Quantity("ratio", "nonnegative")]
ProportionalGain = Annotated[float, Quantity("rate", "nonnegative")]
IntegralGain = Annotated[float, Quantity("rate_squared", "nonnegative")]
RotationalStiffness = Annotated[float, Quantity("rotational_stiffness", "nonnegative")]
Stiffness = Annotated[float, Quantity(None, "nonnegative")]
"""Of a spring that resists a translation [N/m] or a rotation [N m/rad]."""
Pressure = Annotated[float, Quantity("pressure", "positive")]
Density = Annotated[float, Quantity("density", "positive")]

Count = Annotated[int, Field(strict=True, ge=1, le=1_000_000)]


def _identifier(value: object) -> object:
    if isinstance(value, str) and (
        not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]{0,63}", value, re.ASCII) or keyword.iskeyword(value)
    ):
        raise RuleError(
            f"{quote(value)} is no identifier; use a letter, then letters, digits and underscores"
        )
    return value


def _label(value: object) -> object:
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    if isinstance(value, str) and not (0 < len(value.strip()) <= 200 and value.isprintable()):
        raise RuleError(f"{quote(value)} is no name; use 1 to 200 printable characters")
    return value


def _prose(value: object) -> object:
    if isinstance(value, str):
        odd = next((c for c in value if not (c.isprintable() or c in "\n\t")), None)
        if odd is not None:
            raise RuleError(f"the text contains the control character {odd!r}; remove it")
    return value


Identifier = Annotated[str, BeforeValidator(_identifier)]
"""A name that expressions can use."""
Label = Annotated[str, BeforeValidator(_label), WithJsonSchema({"type": ["string", "integer"]})]
"""A name of a node or member; a whole number counts as its digits."""
Prose = Annotated[str, BeforeValidator(_prose)]
"""Text of several lines."""


class _ExpressionText:
    """Annotation of an `Expression` that is written as text."""

    @staticmethod
    def _parse(value: Any) -> Expression:
        expression = value if isinstance(value, Expression) else parse_expression(value)
        if not expression.references:
            raise RuleError(f"{quote(expression.text)} names no metric; use one such as structural_mass")
        return expression

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        text = core_schema.plain_serializer_function_ser_schema(lambda expression: expression.text)
        return core_schema.no_info_plain_validator_function(self._parse, serialization=text)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"type": "string", "description": "a metric, or arithmetic on metrics and variables"}


MetricExpression = Annotated[Expression, _ExpressionText()]


class OrFile:
    """Annotation of what may be given by the name of a file, which is read before sections are understood."""

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"anyOf": [handler(schema), {"type": "string"}]}


TEXT_OR_LIST = Discriminator(lambda value: "text" if isinstance(value, str) else "list")
"""Tells text from a list, so that a message speaks of the one that was meant."""
ONE_OR_LIST = Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "one")
"""Tells one value from a list of values."""


def parsed(value: object, quantity: Quantity, *at: str | int) -> float:
    """SI value of a quantity whose unit depends on another key."""
    try:
        return quantity.parse(value)
    except ValueError as error:
        raise RuleError(str(error), *at) from None


def exactly_one(section: BaseModel, *keys: str) -> None:
    """Refuse a section that does not give exactly one of the keys."""
    given = [key for key in keys if getattr(section, key) is not None]
    if len(given) > 1:
        raise RuleError(
            f"'{given[0]}' and '{given[1]}' exclude each other; remove one", given[1], of_key=True
        )
    if not given:
        raise RuleError(f"one of {', '.join(keys)} is required; add one")


def unique(names: Iterable[tuple[str, KeyPath]], kind: str) -> None:
    """Refuse the second of two equal names."""
    seen = set()
    for name, at in names:
        if name in seen:
            raise RuleError(f"the {kind} '{name}' stands twice; choose another name", *at)
        seen.add(name)


def ascending(values: Iterable[float], *at: str | int) -> None:
    """Refuse values that do not rise strictly."""
    last = None
    for k, value in enumerate(values):
        if last is not None and value <= last:
            raise RuleError(
                f"value {k + 1} is not above the one before; give them in ascending order", *at, k
            )
        last = value
