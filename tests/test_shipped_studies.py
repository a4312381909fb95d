"""The studies that ship: they are understood, posed, and the quick ones solved."""

from __future__ import annotations

from pathlib import Path

import pytest

from fosopt.study import TEMPLATE, dump_study, load_study, parse_study
from fosopt.study.build import build_problem, start_vector

STUDIES = sorted((Path(__file__).resolve().parents[1] / "studies").glob("*.yaml"))


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_shipped_study_poses_a_problem_and_survives_a_dump(path: Path) -> None:
    study = load_study(path)
    problem = build_problem(study)
    assert problem.evaluate(start_vector(study, problem)).value("first_elastic_frequency") > 0
    assert parse_study(dump_study(study), study.base) == study


def test_the_quickstart_is_what_fosopt_new_writes() -> None:
    path = next(path for path in STUDIES if path.stem == "quickstart")
    assert path.read_text(encoding="utf-8") == TEMPLATE
