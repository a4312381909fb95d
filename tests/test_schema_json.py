"""The JSON schema that editors are given agrees with what the program accepts."""

from __future__ import annotations

import json

import jsonschema
import pytest
from ruamel.yaml import YAML
from small_studies import STUDIES
from typer.testing import CliRunner

from fosopt.cli.commands import app
from fosopt.study.template import TEMPLATE

TEXTS = {path.stem: path.read_text(encoding="utf-8") for path in sorted(STUDIES.glob("*.yaml"))}
TEXTS["template"] = TEMPLATE


@pytest.fixture(scope="module")
def validator():
    schema = json.loads(CliRunner().invoke(app, ["schema"], prog_name="fosopt").stdout)
    kind = jsonschema.validators.validator_for(schema)
    kind.check_schema(schema)
    return kind(schema)


def read(text: str):
    return YAML(typ="safe").load(text)


@pytest.mark.parametrize("name", TEXTS)
def test_an_editor_finds_no_fault_in_a_study_that_runs(validator, name):
    assert [error.message for error in validator.iter_errors(read(TEXTS[name]))] == []


@pytest.mark.parametrize(
    ("good", "bad", "place"),
    [
        ("kind: codesign", "kind: codesine", ["kind"]),
        ("\nmirror:", "\nmirrors:", []),
        ("  bays: 20", "  bays: [20]", ["structure"]),
        ("  ki: 50000", "  ki: 50000\n  kj: 1", ["controller"]),
        ("at: hub_torque", "at: hub", ["disturbances", 0, "at"]),
        ("- minimize: structural_mass", "- maximize: structural_mass", ["objectives", 0]),
        ("  time_limit: 60 s", "  time_limit: [60]", ["solve", "time_limit"]),
    ],
)
def test_an_editor_marks_what_the_program_refuses(validator, good, bad, place):
    assert TEMPLATE.count(good) == 1
    found = list(validator.iter_errors(read(TEMPLATE.replace(good, bad))))
    assert place in [list(error.absolute_path)[: len(place)] for error in found]
