"""The text of a study file as plain data, with the line and column of every key and value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from fosopt.errors import StudyError, did_you_mean
from fosopt.units import quote

KeyPath = tuple[str | int, ...]

LARGEST_FILE = 10 * 1024**2
"""Size of the largest study or side file that is read [bytes]."""
_MOST_VALUES = 200_000
_MOST_ALIASES = 100
_DEEPEST = 20
_LONGEST_KEY = 200
_TAG = "tag:yaml.org,2002:"


@dataclass(frozen=True)
class Position:
    """Where a key or a value stands: a file, line and column, or a command-line override."""

    file: str
    line: int | None = None
    column: int | None = None


@dataclass(frozen=True)
class Source:
    """A study file that has been read but not understood.

    Parameters
    ----------
    file
        Its name as the user gave it.
    data
        Mappings, lists, text, numbers, booleans and None.
    values, keys
        Where the value at a path stands, and where its key stands.
    """

    file: str
    data: dict[str, Any]
    values: Mapping[KeyPath, Position]
    keys: Mapping[KeyPath, Position]

    def position(self, path: KeyPath, *, of_key: bool = False) -> Position:
        """Where a path stands, or the nearest enclosing one that the file has."""
        if of_key and path in self.keys:
            return self.keys[path]
        while path and path not in self.values:
            path = path[:-1]
        return self.values.get(path, Position(self.file))

    def error(self, message: str, path: KeyPath = (), *, of_key: bool = False) -> StudyError:
        """An error that says where in the file it stands."""
        at = self.position(path, of_key=of_key)
        dotted = ".".join(str(key) for key in path)
        return StudyError(message, file=at.file, line=at.line, column=at.column, path=dotted or None)


def read_text(path: Path, name: str) -> str:
    """Text of a file of at most `LARGEST_FILE` bytes in UTF-8; ``name`` is what messages call it.

    Raises
    ------
    StudyError
        For a file that is missing, unreadable, too large or not UTF-8.
    """
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise StudyError("no such file; check the path", file=name) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise StudyError(
            f"the file cannot be read: {reason}; check the path and permissions", file=name
        ) from None
    if len(content) > LARGEST_FILE:
        raise StudyError(
            f"the file is larger than {LARGEST_FILE >> 20} MiB; move bulk data to side files", file=name
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - content.rfind(b"\n", 0, error.start)
        message = f"byte 0x{content[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise StudyError(message, file=name, line=line, column=column) from None


def read_source(path: str | Path) -> Source:
    """Read a study file without judging its content.

    Raises
    ------
    StudyError
        For a file that cannot be read, broken YAML, a repeated key, too many aliases or values, or a
        file that is not a mapping.
    """
    return parse_source(read_text(Path(path), str(path)), str(path))


def parse_source(text: str, file: str) -> Source:
    """The same as `read_source` for text that is at hand.

    Raises
    ------
    StudyError
        As `read_source`.
    """
    node = _compose(text, file)
    reader = _Reader(file)
    if not isinstance(node, MappingNode):
        raise StudyError("a study is a mapping of keys; start from 'fosopt new'", file=file, line=1, column=1)
    data = reader.value(node, ())
    return Source(file, data, reader.values, reader.keys)


def _compose(text: str, file: str) -> Node | None:
    try:
        node: Node | None = YAML(typ="safe", pure=True).compose(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = " ".join(str(error.problem or error.context or "no YAML").split())
        line, column = (mark.line + 1, mark.column + 1) if mark else (None, None)
        raise StudyError(
            f"{problem}; check the YAML, and put text with any of []{{}}: in quotes",
            file=file,
            line=line,
            column=column,
        ) from None
    except RecursionError:
        raise StudyError(f"nested more than {_DEEPEST} deep; flatten it", file=file) from None
    except YAMLError as error:
        at = getattr(error, "position", 0) or 0
        line, column = text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at)
        character = getattr(error, "character", "")
        raise StudyError(
            f"character {character!r} is not allowed in YAML; remove it", file=file, line=line, column=column
        ) from None
    except Exception as error:  # a third-party parser may fail in its own ways on broken text
        raise StudyError(f"no YAML ({type(error).__name__}); check the syntax", file=file) from None
    return node


class _Reader:
    """Turns YAML nodes into plain data and keeps where each one stands."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.values: dict[KeyPath, Position] = {}
        self.keys: dict[KeyPath, Position] = {}
        self.met: set[int] = set()
        self.aliases = 0

    def at(self, node: Node) -> Position:
        return Position(self.file, node.start_mark.line + 1, node.start_mark.column + 1)

    def refuse(self, node: Node, path: KeyPath, message: str) -> StudyError:
        at = self.at(node)
        dotted = ".".join(str(key) for key in path)
        return StudyError(message, file=at.file, line=at.line, column=at.column, path=dotted or None)

    def value(self, node: Node, path: KeyPath) -> Any:
        if id(node) in self.met:
            self.aliases += 1
        self.met.add(id(node))
        if self.aliases > _MOST_ALIASES:
            raise self.refuse(node, (), f"more than {_MOST_ALIASES} aliases; write the values out")
        if len(self.values) >= _MOST_VALUES:
            raise self.refuse(node, (), f"more than {_MOST_VALUES} values; move bulk data to side files")
        if len(path) > _DEEPEST:
            raise self.refuse(node, (), f"nested more than {_DEEPEST} deep; flatten it")
        self.values[path] = self.at(node)
        if isinstance(node, MappingNode):
            return dict(self.items(node, path))
        if isinstance(node, SequenceNode):
            return [self.value(item, (*path, k)) for k, item in enumerate(node.value)]
        return self.scalar(node, path)

    def items(self, node: MappingNode, path: KeyPath) -> Iterator[tuple[str, Any]]:
        seen: dict[str, int] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, ScalarNode):
                raise self.refuse(
                    key_node, path, "a key is a name, not a list or mapping; write 'name: value'"
                )
            key = str(key_node.value)
            if not (key.isprintable() and 0 < len(key) <= _LONGEST_KEY):
                raise self.refuse(
                    key_node, path, f"{quote(key)} is no key; use 1 to {_LONGEST_KEY} printable characters"
                )
            line = key_node.start_mark.line + 1
            if key in seen:
                raise self.refuse(
                    key_node, (*path, key), f"the key stands twice, first in line {seen[key]}; remove one"
                )
            seen[key] = line
            self.keys[(*path, key)] = self.at(key_node)
            yield key, self.value(value_node, (*path, key))

    def scalar(self, node: Node, path: KeyPath) -> Any:
        tag, text = str(node.tag).removeprefix(_TAG), node.value
        try:
            match tag:
                case "str" | "timestamp" | "merge":
                    return str(text)
                case "null":
                    return None
                case "bool":
                    return {"true": True, "false": False}[text.lower()]
                case "int":
                    return _whole_number(text)
                case "float":
                    return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        except (ValueError, KeyError):
            pass
        raise self.refuse(
            node, path, f"{quote(text)} with the tag '{tag}' is no value; write it without a tag"
        )


def _whole_number(text: str) -> int:
    body = text.lstrip("+-").lower()
    return int(text, {"0x": 16, "0o": 8, "0b": 2}.get(body[:2], 10))


def override(source: Source, assignment: str) -> Source:
    """The source with one value replaced, for ``--set front.points=5``.

    The path is the keys joined by dots, list items counted from zero; the value is read as YAML.

    Raises
    ------
    StudyError
        For text without ``=``, a broken value, or a path that leads through a list item or value that
        does not exist.
    """
    file = f"--set {' '.join(assignment.split())}"
    dotted, equals, text = assignment.partition("=")
    keys = dotted.strip().split(".")
    if not equals or not all(keys):
        raise StudyError(
            f"{quote(assignment)} is no assignment; write key=value, such as front.points=5", file=file
        )
    node = _compose(text, file)
    value = None if node is None else _Reader(file).value(node, ())
    data, path = _replaced(source.data, keys, (), value, file)
    kept = {p: at for p, at in source.values.items() if p[: len(path)] != path}
    kept_keys = {p: at for p, at in source.keys.items() if p[: len(path)] != path}
    here = Position(file)
    for end in range(len(path), 0, -1):
        kept.setdefault(path[:end], here)
        if isinstance(path[end - 1], str):
            kept_keys.setdefault(path[:end], here)
    return replace(source, data=data, values=kept, keys=kept_keys)


def _replaced(data: Any, keys: list[str], done: KeyPath, value: Any, file: str) -> tuple[Any, KeyPath]:
    """A copy of the data with one value replaced, and the path with list indices as numbers."""
    if not keys:
        return value, done
    key, rest = keys[0], keys[1:]
    path = ".".join(str(each) for each in (*done, key))
    if isinstance(data, list):
        index = int(key) if key.isascii() and key.isdigit() and len(key) < 10 else len(data)
        if index >= len(data):
            raise StudyError(
                f"'{key}' is no item of a list of {len(data)}; count from 0", file=file, path=path
            )
        inner, where = _replaced(data[index], rest, (*done, index), value, file)
        return [*data[:index], inner, *data[index + 1 :]], where
    if data is None or (isinstance(data, dict) and (key in data or not rest or not done)):
        inner, where = _replaced((data or {}).get(key), rest, (*done, key), value, file)
        return {**(data or {}), key: inner}, where
    known = did_you_mean(key, data) if isinstance(data, dict) and data else "the value there has no keys"
    raise StudyError(f"the study has no '{path}' to look into; {known}", file=file, path=path)
