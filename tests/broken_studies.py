"""Study files that are broken in every way that hypothesis thinks of, and what they may lead to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hypothesis import strategies as st
from small_studies import STUDIES

from fosopt.errors import FosoptError
from fosopt.study.build import build_problem
from fosopt.study.load import _study
from fosopt.study.source import Source, parse_source

FILES = sorted(STUDIES.glob("*.yaml"))
SHORT = {"bays": 2, "points": 3}
"""Sizes of the shipped studies that would cost time and show nothing."""


def _shortened(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: SHORT[k] if k in SHORT and isinstance(v, int) else _shortened(v) for k, v in value.items()}
    return [_shortened(each) for each in value] if isinstance(value, list) else value


TREES = [_shortened(parse_source(path.read_text(encoding="utf-8"), path.name).data) for path in FILES]
TEXTS = [path.read_text(encoding="utf-8").replace("bays: 20", "bays: 2") for path in FILES]

_WORDS = st.sampled_from(
    (
        *("", "0", "-1", "1e-400", "1e400", ".nan", "-.inf", "5 parsecs", "10 Hz", "-3 mm^2", "tip", "held"),
        *(
            "all",
            "jitter_total",
            "1/0",
            "log(-1)",
            "a[0]",
            "((",
            "x" * 300,
            "\x00",
            "ÅΩ∞",
            "=1+1",
            "<script>",
        ),
        *("null", "true"),
    )
)
# A file whose keys are not printable is refused before its content is looked at.
_NAMES = _WORDS.filter(lambda name: 0 < len(name) <= 200 and name.isprintable())
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.integers(),
    st.floats(),
    _WORDS,
    st.text(max_size=8),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(_NAMES, inner, max_size=3)),
    max_leaves=5,
)


def _places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to all values of a tree but its root."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place for k, inner in items for place in ((*path, k), *_places(inner, (*path, k)))]


PLACES = [_places(tree) for tree in TREES]


def _changed(tree: Any, path: tuple[Any, ...], how: str, value: Any, name: str) -> Any:
    """A copy of a tree that is changed at a path."""
    key, *rest = path
    copy = dict(tree) if isinstance(tree, dict) else list(tree)
    if rest:
        copy[key] = _changed(tree[key], tuple(rest), how, value, name)
    elif how == "remove":
        del copy[key]
    elif how == "replace":
        copy[key] = value
    elif isinstance(copy, dict):
        copy[name if how == "add" else f"{key}{name}"] = value if how == "add" else copy.pop(key)
    else:
        copy.insert(key, value if how == "add" else copy[key])
    return copy


@st.composite
def broken_trees(draw: st.DrawFn) -> dict[str, Any]:
    """Content of a shipped study with one to three changes."""
    k = draw(st.integers(0, len(TREES) - 1))
    tree = TREES[k]
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(PLACES[k]))
        how = draw(st.sampled_from(["remove", "replace", "replace", "add", "rename"]))
        try:
            tree = _changed(tree, path, how, draw(VALUES), draw(_NAMES))
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change has removed the place
    return tree


@st.composite
def broken_texts(draw: st.DrawFn) -> str:
    """Text of a shipped study with pieces cut, doubled, moved or overwritten."""
    text = draw(st.sampled_from(TEXTS))
    for _ in range(draw(st.integers(1, 3))):
        first = draw(st.integers(0, len(text)))
        last = draw(st.integers(first, min(len(text), first + 40)))
        piece = draw(
            st.one_of(
                st.text(max_size=6),
                st.sampled_from(
                    ["\t", "  ", "\n", ": ", "- ", "&a ", "*a", "!!python/object:os.system ", "{", "]"]
                ),
                st.just(text[first:last] * 2),
            )
        )
        text = text[:first] + piece + text[last:]
    return text


def verdict(broken: str | dict[str, Any], base: Path = STUDIES) -> str | None:
    """What is said of a study, from its text or the content of it, in one line; None if nothing is wrong with it.

    Anything but an error of fosopt is a defect and passes through.
    """
    try:
        source = parse_source(broken, "study.yaml") if isinstance(broken, str) else Source("", broken, {}, {})
        study = _study(source, base)
        build_problem(study)
        if study.kind == "sweep":
            from fosopt.study.sweep_job import SweepPlan

            SweepPlan.of(study)
    except FosoptError as error:
        said = str(error)
        assert len(said.splitlines()) == 1
        return said
    return None
