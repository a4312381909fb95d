"""The reference of the study file: it is what the program makes of itself, and it tells every key."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fosopt.cli.commands import app
from fosopt.study.schema import Study
from fosopt.study.schema_base import Quantity, Section, quantity_of
from fosopt.study.schema_names import BOUNDS, METRICS, QUANTITIES
from fosopt.study.schema_page import study_file_page
from fosopt.study.schema_sweep import AXES, LISTED
from fosopt.units import DIMENSIONS

PAGE = Path(__file__).parents[1] / "docs" / "study-file.md"


def sections(of: type[Section] = Section) -> Iterator[type[Section]]:
    for each in of.__subclasses__():
        yield each
        yield from sections(each)


SECTIONS = sorted({each for each in sections() if each.model_fields}, key=lambda each: each.__name__)
TOLD = [each for each in SECTIONS if not each.__name__.startswith("_")]


@cache
def rows() -> dict[str, list[list[str]]]:
    """Cells of all tables of the page, by the heading above them."""
    found: dict[str, list[list[str]]] = {}
    heading = ""
    for line in study_file_page().splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
            found[heading] = []
        elif line.startswith("| ") and not line.startswith("| ---"):
            found[heading].append([cell.strip() for cell in line.strip("|").split(" | ")])
    return found


def test_the_page_is_what_the_program_makes():
    assert PAGE.read_text(encoding="utf-8") == study_file_page(), "run: make docs"


@pytest.mark.parametrize("section", SECTIONS, ids=lambda each: each.__name__)
def test_every_key_says_what_it_means(section: type[Section]) -> None:
    for key in section.model_fields:
        assert section.meaning(key).endswith("."), f"{section.__name__}.{key} has no sentence below it"


def test_a_key_that_is_narrowed_keeps_its_meaning():
    class Parent(Section):
        """A section."""

        key: float
        """What it is."""

    class Child(Parent):
        """A narrower one."""

        key: int

    assert Child.meaning("key") == "What it is."


@pytest.mark.parametrize("section", TOLD, ids=lambda each: each.__name__)
def test_every_key_stands_in_a_table_of_the_page(section: type[Section]) -> None:
    told = [{row[0] for row in table} for table in rows().values()]
    wanted = {f"`{key}`" for key in section.model_fields}
    assert any(wanted <= keys for keys in told)


def test_sections_stand_in_the_order_of_the_file():
    headings = [line[3:] for line in study_file_page().splitlines() if line.startswith("## ")]
    of_file = [key for key in Study.model_fields if key in headings]
    assert headings[1 : 1 + len(of_file)] == of_file
    assert {"structure", "mirror", "variables", "sweep"} <= set(of_file)


@pytest.mark.parametrize(
    ("heading", "key", "cells"),
    [
        ("mirror", "`frequency`", ("frequency in rad/s, zero or more", "")),
        ("mirror", "`damping_ratio`", ("ratio, zero or more", "required")),
        ("damping", "`uniform`", ("ratio, zero or more and below 1", "")),
        ("solve", "`seed`", ("whole number from 0 to 4294967295", "`1`")),
        ("solve", "`tolerance`", ("ratio, above zero and below 1", "`1e-06`")),
        ("step", "`window`", ("list of 2: time in s", "required")),
        ("certificates", "`structure`", ("`true` or `false`", "`true`")),
        ("objectives", "`minimize`", ("[expression](#expressions)", "required")),
        ("disturbances", "`filter`", ("[section](#disturbances-filter)", "")),
        (
            "structure: matrices",
            "`mass`",
            ("[section](#structure-matrices-stiffness); or the name of a file", "required"),
        ),
        ("variables", "`lower`", ("see above", "required")),
        (
            "structure: truss",
            "`bars`",
            ("[list of sections](#structure-truss-bars); or the name of a file", "required"),
        ),
    ],
)
def test_a_row_tells_value_and_default(heading: str, key: str, cells: tuple[str, str]) -> None:
    row = next(row for row in rows()[heading] if row[0] == key)
    assert (row[2], row[3].rstrip(" |")) == cells


def test_all_metrics_variables_axes_and_units_stand_in_their_tables():
    tables = rows()
    metrics = {row[0].strip("`").removesuffix("[k]"): row for row in tables["Metrics"]}
    for name, metric in (METRICS | BOUNDS).items():
        unit = DIMENSIONS[metric.dimension].unit
        assert metrics[name][1:] == ["-" if unit == "1" else unit, metric.meaning]
    assert {f"`{name}`" for name in QUANTITIES} <= {row[0] for row in tables["variables"]}
    assert {f"`{name}`" for name in (*AXES, *LISTED)} <= {row[0] for row in tables["sweep: axes"]}
    assert {name.replace("_", " ") for name in DIMENSIONS} <= {row[0] for row in tables["Units"]}


def described(about: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every property of a JSON schema with its name."""
    if isinstance(about, dict):
        for name, each in about.get("properties", {}).items():
            yield name, each
        for each in about.values():
            yield from described(each)


def test_the_schema_for_editors_explains_every_key_and_its_unit():
    found = Study.model_json_schema()
    properties = list(described(found))
    assert len(properties) > 150
    for name, each in properties:
        assert each.get("description"), name
    for section in TOLD:
        for key, field in section.model_fields.items():
            quantity = quantity_of(field)
            if quantity is not None and section.__name__ in found["$defs"]:
                text = found["$defs"][section.__name__]["properties"][key]["description"]
                first, *rest = quantity.written
                assert text == f"{section.meaning(key)} {first.upper()}{''.join(rest)}."


def accepts(about: Any, kind: str) -> bool:
    """Whether a part of a JSON schema, in one of its branches, is of a type."""
    own = about.get("type")
    inner = [*about.get("anyOf", ()), *about.get("oneOf", ())]
    return kind in (own if isinstance(own, list) else [own]) or any(accepts(each, kind) for each in inner)


@pytest.mark.parametrize(
    ("section", "key", "kind"),
    [
        ("Range", "from", "string"),
        ("Range", "to", "number"),
        ("Truss", "nodes", "string"),
        ("Truss", "nodes", "object"),
        ("Truss", "bars", "string"),
        ("Truss", "bars", "array"),
        ("Matrices", "stiffness", "string"),
        ("Matrices", "mass", "string"),
        ("Bar", "kind", "integer"),
        ("Bar", "kind", "string"),
    ],
)
def test_the_schema_for_editors_accepts_what_is_understood_before_the_sections(
    section: str, key: str, kind: str
) -> None:
    assert accepts(Study.model_json_schema()["$defs"][section]["properties"][key], kind)


def test_the_schema_for_editors_knows_decks_and_gains_of_other_forms():
    found = Study.model_json_schema()
    kinds = found["properties"]["structure"]["anyOf"]
    assert "bulk_data" in [each.get("properties", {}).get("type", {}).get("const") for each in kinds]
    assert found["$defs"]["Controller"]["required"] == ["type"]


@pytest.mark.parametrize("dimension", [None, "area"])
def test_a_quantity_says_how_it_is_written(dimension: str | None) -> None:
    text = Quantity(dimension).written
    assert "bare" in text
    assert dimension is None or "m^2" in text


def test_the_command_writes_the_page_and_prints_the_schema(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    written = CliRunner().invoke(app, ["schema", "--page", str(page)])
    assert (written.exit_code, written.stdout) == (0, "")
    assert page.read_text(encoding="utf-8") == study_file_page()
    assert json.loads(CliRunner().invoke(app, ["schema"]).stdout) == Study.model_json_schema()
