"""The catalogue holds every table and figure, and the page in ``docs`` is what the code writes now."""

from __future__ import annotations

import difflib
import re
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import pytest

import fosopt.reproduce
from fosopt.reproduce.catalogue import DRAWINGS, FIGURES, TABLES, catalogue
from fosopt.reproduce.markdown import markdown
from fosopt.reproduce.outcome import Outcome
from fosopt.reproduce.run import computed

# What is left of two numbers that agree differs between machines.
ROUND_OFF = re.compile(r"[-−]?\d(\.\d+)?e-(09|1\d)|(?<=off by )0\b")
PAGE = Path(__file__).parents[1] / "docs" / "reproduction.md"


@pytest.fixture(scope="module")
def outcomes() -> dict[str, Outcome]:
    """Every entry, computed."""
    return {outcome.entry.name: outcome for outcome in computed(list(catalogue().values()))}


def test_every_number_is_an_entry_or_a_drawing():
    numbered = {f"figure-{chapter}.{k + 1}" for chapter, last in FIGURES.items() for k in range(last)}
    numbered |= {f"table-{chapter}.{k + 1}" for chapter, last in TABLES.items() for k in range(last)}
    assert numbered - set(DRAWINGS) == set(catalogue())
    assert set(DRAWINGS) <= numbered
    assert len(numbered) == 37 + 43 + 26 + 4 + 4 + 1


def test_every_chapter_module_with_entries_is_in_the_catalogue():
    modules = (
        import_module(f"fosopt.reproduce.{each.name}") for each in iter_modules(fosopt.reproduce.__path__)
    )
    found = {entry.name for module in modules for entry in getattr(module, "ENTRIES", ())}
    assert found == set(catalogue())


def test_no_entry_fails(outcomes):
    assert {name: outcome.error for name, outcome in outcomes.items() if outcome.error} == {}


def test_every_figure_has_something_to_draw_and_every_table_something_to_compare(outcomes):
    bare = [
        name
        for name, outcome in outcomes.items()
        if outcome.result is not None
        and not (outcome.result.panels if name.startswith("figure") else outcome.result.comparisons)
    ]
    assert bare == []


def test_what_matches_or_differs_is_compared_with_something_published(outcomes):
    groundless = [
        name
        for name, outcome in outcomes.items()
        if outcome.result is not None
        and outcome.result.verdict != "not determinable"
        and all(row.published is None for row in outcome.result.comparisons)
    ]
    assert groundless == []


def test_the_committed_page_is_what_the_code_writes(outcomes):
    written = ROUND_OFF.sub("round-off", markdown(list(outcomes.values()))).splitlines()
    committed = ROUND_OFF.sub("round-off", PAGE.read_text(encoding="utf-8")).splitlines()
    changed = list(difflib.unified_diff(committed, written, "committed", "written", lineterm="", n=0))
    assert not changed, "\n".join(["run: fosopt reproduce --page docs/reproduction.md", *changed[:60]])
