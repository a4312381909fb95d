"""The reference of the study file as a Markdown page, made from the sections themselves.

`fosopt schema --page docs/study-file.md` writes it.
"""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Iterable, Iterator
from textwrap import fill
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from fosopt.expressions import FUNCTIONS, Expression
from fosopt.study.schema import Study
from fosopt.study.schema_base import OrFile, Quantity, Section, quantity_of
from fosopt.study.schema_imports import BulkData
from fosopt.study.schema_names import BOUNDS, BY_AXIS, JITTER, METRICS, Metric
from fosopt.study.schema_structures import Structure
from fosopt.study.schema_sweep import AXES, LISTED, ONE_MINUS, STABLE, Axis
from fosopt.units import DIMENSIONS, UNITS

_OPENING = """# The study file

A study is one YAML file. This page lists every section in the order of the file, every key with what it means, how
its value is written, and what holds when it is left out. It is made from the program itself by
`fosopt schema --page docs/study-file.md`; `fosopt schema` prints the same as JSON Schema, with which an editor
completes and explains keys. `fosopt new` writes a study to start from, `fosopt check` prints the one it understood.

- A quantity is a number with a unit, such as `66 mm^2`, or a bare number in SI units. A bare frequency is in rad/s.
- A key that does not exist is refused, and so is a value of the wrong unit.
- Files are named relative to the study.
- On the command line, `--set mirror.frequency="30 Hz"` or `--set variables.0.upper="300 mm^2"` replaces one value;
  list items are counted from zero.
- Conditions between keys (one of two, or one only with another) are checked when the file is read; an error names line,
  value, rule and way out."""

_EXPRESSIONS = """## Expressions

Objectives, constraints and outputs of a sweep are names of metrics, or arithmetic on them, on names of variables and on
plain numbers: `+ - * / **`, parentheses, and {functions}. `name[k]` is the
k-th mode of a metric that has one value per mode, or the k-th group of a variable, counted from 1. An exponent is a
plain number. Values of different units cannot be added; multiply one by a plain number, which may carry any unit:
`structural_mass + 2 * mirror_inertia`."""

_UNITS = """## Units

Units are multiplied by a space or `*`, divided by `/`, raised by `^`, and may stand in `sqrt(...)` and parentheses:
`N m/(rad s)`, `urad/sqrt(Hz)`. A hertz is 2π rad/s in a frequency and stays a hertz in a density. An angle has a unit
of its own: a torque is no rotational stiffness. Understood are
{units}; µ is the same as u.

What kinds of quantities there are, with the unit a bare number has:"""


def study_file_page() -> str:
    """The reference as Markdown."""
    functions = ", ".join(f"`{name}`" for name in FUNCTIONS)
    units = ", ".join(f"`{name}`" for name in sorted(UNITS, key=str.casefold) if "µ" not in name)
    parts = [
        _OPENING,
        *_Reference().page(),
        *_metrics(),
        _EXPRESSIONS.format(functions=functions),
        _UNITS.format(units=fill(units, 118)),
        _table(
            ("quantity", "SI unit", "shown in", "such as"),
            (
                (name.replace("_", " "), kind.unit, kind.shown, kind.example)
                for name, kind in DIMENSIONS.items()
            ),
        ),
    ]
    return "\n\n".join(parts) + "\n"


def anchor(heading: str) -> str:
    """What a link to a heading ends with."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


_TELLING = "quantity"
"""What tells the sections of a family apart: all of them are variables."""


class _Reference:
    """The sections of the file, each told once; a section that stands in several places is linked to the first."""

    def __init__(self) -> None:
        self.places: dict[type[Section], str] = {}
        self.parts: list[str] = []

    def page(self) -> list[str]:
        self._place(Study, "")
        self.parts = ["## Sections", self._keys([Study])]
        for key, field in Study.model_fields.items():
            self._told(key, _annotated(field), 2)
        return self.parts

    def _place(self, section: type[Section], path: str) -> None:
        """Give each section below this one the heading it will stand under."""
        for key, field in section.model_fields.items():
            self._place_in(_joined(path, key), _annotated(field))

    def _place_in(self, path: str, annotation: Any) -> None:
        sections = _sections(annotation)
        kinds = _kinds(sections)
        for section, kind in zip(sections, kinds, strict=True):
            heading = _joined(path, kind) if kind and _family(sections) is None else path
            if section not in self.places:
                self.places[section] = heading
                self._place(section, heading)

    def _told(self, path: str, annotation: Any, level: int) -> None:
        """Add what a key holds, if it holds sections and these have not been told."""
        sections = _sections(annotation)
        if not sections or not self.places[sections[0]].startswith(path):
            return
        title = f"{'#' * level} {path}"
        if len(sections) == 1:
            self._section(sections[0], title)
        elif _family(sections) is not None:
            rows = [
                (f"`{kind}`", self._range(section), _doc(section))
                for section, kind in zip(sections, _kinds(sections), strict=True)
                for kind in kind.split(", ")
            ]
            self.parts += [
                title,
                _table(("quantity", "its values", "what it is"), rows),
                self._keys(sections),
            ]
        else:
            rows_of_kinds = [
                (self._link(section, kind), _doc(section))
                for section, kind in zip(sections, _kinds(sections), strict=True)
            ]
            self.parts += [title, _table(("`type`", "what it is"), rows_of_kinds)]
            for section in sections:
                if self.places[section].startswith(path):
                    self._section(section, f"### {self.places[section]}")

    def _section(self, section: type[Section], title: str) -> None:
        self.parts += [title, *_doc_parts(section), self._keys([section])]
        if section is Axis:
            self.parts += [_axes()]
        for key, field in section.model_fields.items():
            self._told(_joined(self.places[section], key), _annotated(field), 3)

    def _keys(self, sections: list[type[Section]]) -> str:
        """A table of the keys of a section, or of all sections of a family at once."""
        rows = []
        keys = dict.fromkeys(key for section in sections for key in section.model_fields)
        for key in sorted(keys, key=lambda key: key not in ("type", _TELLING)):
            having = [section for section in sections if key in section.model_fields]
            meaning, field = having[0].meaning(key), having[0].model_fields[key]
            values = {self._value(_annotated(section.model_fields[key])): section for section in having}
            value = next(iter(values))
            if len(values) > 1 and (key == _TELLING or quantity_of(field) is not None):
                value = "see above"
            elif len(values) > 1:
                value = "; ".join(
                    f"{text} (of `{_kind(section, _TELLING)}`)" for text, section in values.items()
                )
            if len(having) < len(sections):
                meaning += f" Of {', '.join(f'`{_kind(section, _TELLING)}`' for section in having)} only."
            rows.append((f"`{key}`", meaning, value, _default(field)))
        return _table(("key", "meaning", "value", "if left out"), rows)

    def _range(self, section: type[Section]) -> str:
        return self._value(_annotated(section.model_fields["lower"]))

    def _link(self, section: type[Section], text: str) -> str:
        return f"[{text}](#{anchor(self.places[section])})"

    def _value(self, annotation: Any, bare: bool = False) -> str:
        """How a value is written; `bare` leaves out the limits of a quantity."""
        inner, metadata = _split(annotation)
        if any(isinstance(each, OrFile) for each in metadata):
            return f"{self._value(inner)}; or the name of a file"
        origin, arguments = get_origin(inner), get_args(inner)
        quantity = next((each for each in metadata if isinstance(each, Quantity)), None)
        if quantity is not None:
            return _quantity_text(quantity, bare)
        sections = _sections(annotation)
        if sections:
            place = self.places[sections[0]]
            if len(sections) > 1 and _family(sections) is None:
                place = place.rpartition(": ")[0]
            return f"[{'list of sections' if origin is tuple else 'section'}](#{anchor(place)})"
        if origin is Literal:
            *others, last = (f"`{str(each).lower() if each is True else each}`" for each in arguments)
            return f"{', '.join(others)} or {last}" if others else last
        if origin in (Union, types.UnionType):
            return " or ".join(self._value(each) for each in arguments if each is not type(None))
        if origin is tuple and arguments[-1] is Ellipsis:
            return f"list: {self._value(arguments[0])}"
        if origin is tuple:
            parts = [self._value(each, bare=True) for each in arguments]
            return f"list of {len(parts)}: {'; '.join(dict.fromkeys(parts))}"
        if origin is dict:
            return f"name: {self._value(arguments[1])}"
        if inner is int:
            return _whole_number(metadata)
        named = {bool: "`true` or `false`", str: "text", Expression: "[expression](#expressions)"}
        return named.get(inner, "value in the unit of the quantity")


def _joined(path: str, key: str) -> str:
    return f"{path}: {key}" if path else key


def _annotated(field: FieldInfo) -> Any:
    """The annotation of a key with the metadata pydantic took off it."""
    found: Any = field.annotation
    for each in field.metadata:
        found = Annotated[found, each]
    return found


def _split(annotation: Any) -> tuple[Any, list[Any]]:
    """An annotation and its metadata, those inside a nested `Field` included."""
    if get_origin(annotation) is not Annotated:
        return annotation, []
    inner, *metadata = get_args(annotation)
    flat = [part for each in metadata for part in (each.metadata if isinstance(each, FieldInfo) else [each])]
    return inner, flat


def _sections(annotation: Any) -> list[type[Section]]:
    """The sections an annotation speaks of, in its order; with a deck beside the structures that it becomes."""
    inner, _ = _split(annotation)
    if isinstance(inner, type) and issubclass(inner, Section):
        return [inner]
    found = list(dict.fromkeys(section for each in get_args(inner) for section in _sections(each)))
    return [*found, BulkData] if inner == _split(Structure)[0] else found


def _discriminator(sections: list[type[Section]]) -> str:
    """The key that tells the sections of a union apart."""
    return _TELLING if _family(sections) is not None else "type"


def _kinds(sections: list[type[Section]]) -> list[str]:
    """What each section of a union is called; a section that stands alone needs no name."""
    if len(sections) < 2:
        return ["" for _ in sections]
    return [_kind(section, _discriminator(sections)) for section in sections]


def _kind(section: type[Section], key: str) -> str:
    return ", ".join(get_args(section.model_fields[key].annotation))


def _family(sections: list[type[Section]]) -> type[Section] | None:
    """The kind of section that all of a union are, beside being sections."""
    if len(sections) < 2:
        return None
    shared = [c for c in sections[0].__mro__ if all(issubclass(each, c) for each in sections)]
    return next((c for c in shared if issubclass(c, Section) and c is not Section), None)


def _quantity_text(quantity: Quantity, bare: bool = False) -> str:
    if quantity.dimension is None:
        text = "quantity"
    else:
        unit = DIMENSIONS[quantity.dimension].unit
        text = quantity.dimension.replace("_", " ") + ("" if unit == "1" else f" in {unit}")
    limits = {"positive": ["above zero"], "nonnegative": ["zero or more"]}.get(quantity.sign, [])
    limits += [] if quantity.below is None else [f"below {quantity.below:g}"]
    return f"{text}, {' and '.join(limits)}" if limits and not bare else text


def _whole_number(metadata: Iterable[Any]) -> str:
    limits = {
        name: getattr(each, name) for each in metadata for name in ("ge", "le", "lt") if hasattr(each, name)
    }
    most = limits.get("le", limits["lt"] - 1 if "lt" in limits else None)
    return f"whole number from {limits['ge']}" + ("" if most is None else f" to {most}")


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if field.default_factory is not None or value is None or value in ((), "", {}):
        return ""
    if isinstance(value, Section):
        return "as its section says"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def _doc_parts(section: type[Section]) -> list[str]:
    """The docstring, an equation as code."""
    parts = re.split(r"\n\s*\n", inspect.getdoc(section) or "")
    return [" ".join(part.split()) for part in parts]


def _doc(section: type[Section]) -> str:
    return _doc_parts(section)[0]


def _axes() -> str:
    rows = [(f"`{name}`", _quantity_text(quantity)) for name, quantity in AXES.items()]
    return _table(
        ("what an axis may vary", "its values"),
        [*rows, *((f"`{name}`", "listed values only") for name in LISTED)],
    )


def _metrics() -> Iterator[str]:
    def rows(metrics: Iterable[tuple[str, Metric]]) -> Iterator[tuple[str, str, str]]:
        for name, metric in metrics:
            unit = DIMENSIONS[metric.dimension].unit
            shown = f"{name}[k]" if metric.indexed else name
            yield f"`{shown}`", "-" if unit == "1" else unit, metric.meaning

    yield "## Metrics"
    yield (
        "What a design is judged by. Those with `[k]` have one value per mode, counted from one; in the outputs of a "
        "sweep the name without an index stands for all modes. Jitter and step metrics of an unstable loop have no "
        "value."
    )
    yield _table(("metric", "SI unit", "meaning"), rows([*METRICS.items(), ("jitter_<name>", JITTER)]))
    yield (
        "With `second_axis`, jitter is that about both axes together, root sum square, `modulus_margin` and "
        "`loop_crossover` are the least of both, and there are"
    )
    yield _table(("metric", "SI unit", "meaning"), rows(BY_AXIS.items()))
    yield f"A sweep has two more outputs: `{STABLE}`, 1 or 0, and `{ONE_MINUS}`, 1 − β of every mode to its last digit."
    yield (
        "[Certificates](certificates.md) put these beside each point. They are columns of its files, and not to be "
        "used in expressions."
    )
    yield _table(("bound", "SI unit", "meaning"), rows(BOUNDS.items()))


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines)
