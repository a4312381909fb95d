"""From a file to a study and back."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError
from ruamel.yaml import YAML

from fosopt.errors import StudyError
from fosopt.study.files import read_damping, read_psd, read_requirement_line
from fosopt.study.schema import Study
from fosopt.study.schema_imports import names_tables
from fosopt.study.source import KeyPath, Source, override, parse_source, read_source
from fosopt.units import quote

_T = TypeVar("_T")


def load_study(path: str | Path, overrides: Sequence[str] = ()) -> Study:
    """Read a study file and the side files it names.

    Parameters
    ----------
    path
        The study file; paths inside it start from its directory.
    overrides
        Assignments such as ``front.points=5`` that replace values of the file.

    Raises
    ------
    StudyError
        For the first rule the file breaks, with its line and column.
    """
    source = read_source(path)
    for assignment in overrides:
        source = override(source, assignment)
    return _study(source, Path(path).parent)


def parse_study(text: str, base: str | Path = ".", file: str = "study.yaml") -> Study:
    """The same as `load_study` for text that is at hand; ``base`` is where side files start from.

    Raises
    ------
    StudyError
        As `load_study`.
    """
    return _study(parse_source(text, file), Path(base))


def dump_study(study: Study) -> str:
    """The study as YAML in bare SI numbers with all defaults; it loads to an equal study, bit for bit."""
    yaml: Any = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False
    yaml.width = 110
    stream = io.StringIO()
    yaml.dump(_plain(study.model_dump(exclude_none=True)), stream)
    return stream.getvalue()


def _plain(value: Any) -> Any:
    """Lists and mappings of their own, so that nothing is written as an alias."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, tuple | list) else value


def _study(source: Source, base: Path) -> Study:
    try:
        source = _side_file(source, ("structure",), lambda: _inlined(source, base))
        study = Study.model_validate(source.data)
    except ValidationError as error:
        raise _first(error, source) from None
    study._base, study._source = base, source
    if isinstance(study.damping.table, str):
        _side_file(source, ("damping", "table"), lambda: read_damping(study))
    if study.requirement_line is not None:
        _side_file(source, ("requirement_line",), lambda: read_requirement_line(study))
    for k, disturbance in enumerate(study.disturbances):
        if disturbance.table is not None:
            key = "psd" if disturbance.psd is not None else "cumulative_rms"
            _side_file(source, ("disturbances", k, key), partial(read_psd, study, disturbance))
    return study


def _inlined(source: Source, base: Path) -> Source:
    """The source with a truss of tables or of a deck written out."""
    if not names_tables(source.data.get("structure")):
        return source
    # Reading other studies needs no numerical library.
    from fosopt.study.inlined import inlined

    return inlined(source, base)


def _first(error: ValidationError, source: Source) -> StudyError:
    """The first broken rule in the order of the file."""
    found: list[tuple[tuple[int, int], int, str, KeyPath, bool]] = []
    for details in error.errors(include_url=False):
        if details["type"] == "default_factory_not_called":
            continue  # a consequence of another error
        path, of_key, message = _explained(details, source.data)
        at = source.position(path, of_key=of_key)
        found.append(((at.line or 0, at.column or 0), len(found), message, path, of_key))
    # A list with a broken item counts as too short; the item is what is wrong.
    inner = [
        each for each in found if not any(each[3] == other[3][: len(each[3])] != other[3] for other in found)
    ]
    _, _, message, path, of_key = min(inner)
    return source.error(message, path, of_key=of_key)


def _explained(details: Mapping[str, Any], data: Any) -> tuple[KeyPath, bool, str]:
    """Path, whether its key is meant, and message of one error."""
    kind, context = details["type"], details.get("ctx", {})
    path = _path(details["loc"], data, missing=kind == "missing")
    value = quote(details["input"]) if not isinstance(details["input"], list | dict | tuple) else "this"
    cause = context.get("error")
    if isinstance(cause, ValueError):
        at = tuple(getattr(cause, "at", ()))
        return (*path, *at), bool(getattr(cause, "of_key", False)), str(cause)
    message = {
        "missing": _missing(path),
        "union_tag_not_found": f"the key {context.get('discriminator')} is required; add it",
        "union_tag_invalid": f"{context.get('discriminator')} is {quote(context.get('tag'))}; "
        f"use one of {context.get('expected_tags')}",
        "literal_error": f"{value} is not allowed; use {context.get('expected')}",
        "string_type": f"{value} is not text; put it in quotes or give a name",
        "tuple_type": f"{value} is no list; write [a, b]",
        "dict_type": f"{value} is no mapping; write keys and values",
        "model_type": f"{value} is no section; write keys and values",
        "model_attributes_type": f"{value} is no section; write keys and values",
        "bool_type": f"{value} is neither true nor false; write one of them",
        "int_type": f"{value} is no whole number; write one such as 5",
        "too_short": f"{context.get('actual_length')} values; give at least {context.get('min_length')}",
        "too_long": f"{context.get('actual_length')} values; give at most {context.get('max_length')}",
        "greater_than_equal": f"{value} is too small; give at least {context.get('ge')}",
        "less_than_equal": f"{value} is too large; give at most {context.get('le')}",
        "less_than": f"{value} is too large; give less than {context.get('lt')}",
        "extra_forbidden": "unknown key; remove it",
    }.get(kind, f"{value}: {details['msg']}; change it")
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        key = str(context.get("discriminator")).strip("'")
        return ((*path, key), False, message) if kind == "union_tag_invalid" else (path, False, message)
    return path, False, message


def _missing(path: KeyPath) -> str:
    last = path[-1] if path else ""
    return (
        f"value {last + 1} is missing; add it"
        if isinstance(last, int)
        else f"the key '{last}' is required; add it"
    )


def _path(location: Sequence[str | int], data: Any, *, missing: bool) -> KeyPath:
    """The keys of the file in an error's location, without the tags of unions."""
    path: list[str | int] = []
    for k, key in enumerate(location):
        known = data if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ()
        if key in known:
            data = data[key]
        elif not (missing and k == len(location) - 1):
            continue
        path.append(key)
    return tuple(path)


def _side_file(source: Source, path: KeyPath, read: Callable[[], _T]) -> _T:
    """Read a side file; where it is missing, the study file is at fault."""
    try:
        return read()
    except StudyError as error:
        if error.line is None:
            raise source.error(f"{error.file}: {error.message}", path) from None
        raise
