"""Requirement lines: cumulative jitter judged at every corner and all along, and what a run says of it."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from math import inf, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_run import fake_run, point
from foreign_models import NATIVE, study_text
from scipy.io import loadmat
from small_studies import analysis
from typer.testing import CliRunner

from fosopt.certify import FEASIBILITY
from fosopt.cli.commands import app
from fosopt.cli.guard import Code
from fosopt.cli.outcome import closing, exit_code, summary
from fosopt.errors import ModelError
from fosopt.export import write_mat
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.requirement import TOLERANCE, RequirementLine, line_verdict
from fosopt.metrics.spectrum import jitter_spectrum
from fosopt.report.html import document
from fosopt.study import parse_study
from fosopt.study.requirement import unmet
from fosopt.study.runner import run_study

HZ = 2 * pi
# What the quadrature leaves of a mean square: 20 nodes a panel, 1e-11 of a resonance.
QUADRATURE = 1e-8


def rms_below(evaluation, frequency: float) -> float:
    """Root mean square of all disturbances that end at a frequency, by the route that jitter metrics take [rad]."""
    ended = [
        replace(d, band=(d.band[0], min(d.band[1], frequency)))
        for d in evaluation.system.disturbances
        if d.band[0] < frequency
    ]
    found = jitter_variances(evaluation.model, evaluation.poles, ended)
    return float(np.sqrt(sum(variance.value for variance in found)))


def spectrum(evaluation, *marks: float):
    return jitter_spectrum(
        evaluation.model, evaluation.poles, evaluation.system.disturbances, np.array(marks)
    )


def judged(evaluation, *corners: tuple[float, float]):
    line = RequirementLine(*(np.array(each) for each in zip(*corners, strict=True)))
    return line_verdict(spectrum(evaluation, *line.frequency), line)


@pytest.fixture(scope="module")
def sharpest(evaluation) -> float:
    """Frequency of the resonance at which most jitter accumulates [rad/s]."""
    found = spectrum(evaluation)
    return float(found.frequency[np.argmax(np.diff(found.by_source.sum(axis=0)))])


# ---- what has accumulated ----


def test_below_a_mark_lies_what_disturbances_that_end_there_cause(evaluation, sharpest):
    marks = np.array([0.3, 5.0, sharpest, 1.01 * sharpest, 10 * sharpest, 4e3])
    found = np.sqrt(spectrum(evaluation, *marks).below(marks))
    assert found == pytest.approx([rms_below(evaluation, mark) for mark in marks], rel=QUADRATURE, abs=0)


def test_below_every_node_lies_what_disturbances_that_end_there_cause(evaluation, sharpest):
    found = spectrum(evaluation)
    near = np.argmin(np.abs(found.frequency - sharpest))
    for k in (*range(7, found.frequency.size, 311), near, near + 1, near + 7):
        exact = rms_below(evaluation, found.frequency[k])
        # Relative to the whole, as a polynomial's error is where hardly anything has accumulated.
        assert np.sqrt(found.by_source[:, k].sum()) == pytest.approx(
            exact, abs=QUADRATURE * evaluation.value("jitter_total")
        )


def test_nothing_lies_below_the_lowest_frequency_and_all_below_the_highest(evaluation):
    found = spectrum(evaluation)
    low, high = found.below(np.array([0.0, 1e12]))
    assert low == 0
    assert np.sqrt(high) == pytest.approx(evaluation.value("jitter_total"), rel=QUADRATURE, abs=0)


# ---- verdicts ----


def test_a_level_line_is_judged_at_its_end(evaluation, sharpest):
    first, last = 0.5 * sharpest, 7 * sharpest
    reached = rms_below(evaluation, last)
    found = judged(evaluation, (first, 0.8 * reached), (last, 0.8 * reached))
    assert (found.met, found.frequency) == (False, last)
    assert found.reached == pytest.approx(reached, rel=QUADRATURE, abs=0)
    assert found.excess == pytest.approx(0.2 * reached, rel=10 * QUADRATURE, abs=0)
    above = judged(evaluation, (first, 1.25 * reached), (last, 1.25 * reached))
    assert (above.met, above.frequency) == (True, last)
    assert above.excess == pytest.approx(-0.25 * reached, rel=10 * QUADRATURE, abs=0)


@pytest.mark.parametrize(("share", "met"), [(1 - 0.5 * TOLERANCE, True), (1 - 2 * TOLERANCE, False)])
def test_a_line_may_be_exceeded_by_as_little_as_a_constraint(evaluation, sharpest, share, met):
    assert TOLERANCE == FEASIBILITY
    reached = rms_below(evaluation, 3 * sharpest)
    assert judged(evaluation, (1.0, share * reached), (3 * sharpest, share * reached)).met is met


def test_a_corner_is_judged_where_it_stands_and_not_beside_it(evaluation, sharpest):
    corner = 1.05 * sharpest
    reached = rms_below(evaluation, corner)
    # Just behind the corner the line jumps far above all jitter; no node of a curve need lie there.
    line = ((0.5 * sharpest, 0.999 * reached), (corner, 0.999 * reached), (corner * (1 + 1e-9), 10 * reached))
    found = judged(evaluation, *line)
    assert (found.met, found.frequency) == (False, corner)
    assert found.reached == pytest.approx(reached, rel=QUADRATURE, abs=0)


def test_an_excess_between_two_corners_is_found_where_it_is_largest(evaluation):
    # Across the lowest elastic mode jitter rises twentyfold, while the line between its corners rises evenly.
    mode = float(np.sqrt(evaluation.frame.eigenvalue[evaluation.frame.n_rigid]))
    first, last = 0.9 * mode, 40 * mode
    line = RequirementLine(
        np.array([first, last]),
        np.array([1.2 * rms_below(evaluation, first), 1.2 * rms_below(evaluation, last)]),
    )
    found = line_verdict(spectrum(evaluation, first, last), line)
    assert not found.met
    assert mode < found.frequency < 1.2 * mode
    dense = np.geomspace(0.95 * mode, 1.2 * mode, 400)
    share = np.sqrt(spectrum(evaluation, *dense).below(dense)) / line.allowed(dense)
    # Both look at points of a smooth curve near its top.
    assert found.reached / found.allowed == pytest.approx(share.max(), rel=2e-3)


def test_the_line_is_straight_over_the_logarithm_of_frequency():
    line = RequirementLine(np.array([1.0, 100.0]), np.array([2.0, 6.0]))
    assert line.allowed(np.array([1.0, 10.0, 100.0])) == pytest.approx([2, 4, 6], rel=1e-14)


def test_outside_of_its_corners_a_line_requires_nothing(evaluation, sharpest):
    low = rms_below(evaluation, 0.5 * sharpest)
    assert judged(evaluation, (0.1 * sharpest, 2 * low), (0.5 * sharpest, 2 * low)).met
    total = 2 * evaluation.value("jitter_total")
    assert judged(evaluation, (1e5 * sharpest, total), (1e6 * sharpest, total)).met


def test_where_nothing_is_allowed_nothing_may_have_accumulated(evaluation, sharpest):
    total = evaluation.value("jitter_total")
    found = judged(evaluation, (sharpest, 0.0), (50 * sharpest, 2 * total))
    assert (found.met, found.frequency, found.allowed) == (False, sharpest, 0.0)


def test_a_line_of_more_corners_than_panels_is_judged_too(evaluation, sharpest):
    corners = np.geomspace(0.01 * sharpest, 100 * sharpest, 3001)
    reached = rms_below(evaluation, corners[2000])
    rms = np.where(np.arange(3001) <= 2000, 0.99 * reached, 10 * evaluation.value("jitter_total"))
    line = RequirementLine(corners, rms)
    found = line_verdict(spectrum(evaluation, *corners), line)
    assert (found.met, found.frequency) == (False, corners[2000])
    assert found.reached == pytest.approx(reached, rel=1e-4)


@pytest.mark.parametrize(
    ("frequency", "rms", "message"),
    [
        ([1.0], [1.0], "two corners or more"),
        ([1.0, 2.0], [1.0], "2 frequencies and 1 values"),
        ([0.0, 2.0], [1.0, 1.0], "from above zero"),
        ([2.0, 2.0], [1.0, 1.0], "ascending"),
        ([1.0, 2.0], [2.0, 1.0], "falls"),
        ([1.0, 2.0], [-1.0, 1.0], "negative"),
        ([1.0, 2.0], [1.0, inf], "not finite"),
        ([1.0, 2.0], [0.0, 0.0], "allows nothing"),
    ],
)
def test_a_line_that_allows_nothing_definite_is_refused(frequency, rms, message):
    with pytest.raises(ModelError, match=message):
        RequirementLine(np.array(frequency), np.array(rms))


# ---- what a run says ----


def run_with(folder: Path, text: str, *rows: tuple[float, float]) -> dict[str, Any]:
    lines = "".join(f"{f:.17g},{rms:.17g}\n" for f, rms in rows)
    (folder / "line.csv").write_text(f"frequency_hz,cumulative_rms_urad\n{lines}")
    return run_study(parse_study(text + "requirement_line: line.csv\n", folder), folder / "out")


def test_a_run_says_where_a_point_exceeds_the_line_and_by_how_much(tmp_path):
    run = run_with(tmp_path, study_text(NATIVE), (0.1, 1e5), (1.0, 1e5), (500.0, 1e5))
    (met,) = run["points"]
    assert met["requirement_line"]["met"] is True
    total = met["metrics"]["jitter_total"]
    (tmp_path / "again").mkdir()
    half = 0.5e6 * total
    run = run_with(tmp_path / "again", study_text(NATIVE), (0.1, half), (1e5, half))
    (found,) = run["points"]
    # The line is no constraint: the design is verified all the same, and nothing else about it has changed.
    assert found["verified"] and found["metrics"] == met["metrics"]
    line = found["requirement_line"]
    assert (line["met"], line["frequency_hz"]) == (False, pytest.approx(1e5, rel=1e-12))
    assert line["reached"] == pytest.approx(total, rel=1e-6)
    assert line["excess"] == line["reached"] - line["allowed"] == pytest.approx(0.5 * total, rel=1e-5)
    assert list(unmet(run, found)) == [
        f"requirement line: {1e6 * line['reached']:.5g} urad of {half:.5g} urad at 1e+05 Hz, "
        f"{1e6 * line['excess']:.5g} urad above"
    ]
    with (tmp_path / "again" / "out" / "front.csv").open(encoding="utf-8") as stream:
        (row,) = csv.DictReader(stream)
    assert row["requirement_line_met"] == "false"
    assert float(row["requirement_line_excess_rad"]) == line["excess"]
    assert float(row["requirement_line_frequency_hz"]) == line["frequency_hz"]
    write_mat(run, tmp_path / "front.mat")
    arrays = loadmat(tmp_path / "front.mat", squeeze_me=True)
    assert (arrays["requirement_line_met"], arrays["requirement_line_excess_rad"]) == (0, line["excess"])
    written = json.loads((tmp_path / "again" / "out" / "front.json").read_text())
    assert written["points"][0]["requirement_line"] == line


def test_without_a_line_nothing_is_judged_and_no_column_is_written(tmp_path):
    run = run_study(parse_study(study_text(NATIVE)), tmp_path / "out")
    assert run["points"][0]["requirement_line"] is None
    assert "requirement_line" not in (tmp_path / "out" / "front.csv").read_text()


def test_an_unstable_design_is_not_judged(tmp_path):
    text = analysis(("inertia_ratio: 0.2 %", "inertia_ratio: 20 %"), bays=20)
    (found,) = run_with(tmp_path, text, (1.0, 1.0), (100.0, 5.0))["points"]
    assert found["status"] == "unstable"
    assert set(found["requirement_line"].values()) == {None}


def test_a_report_shows_no_verdict_on_a_point_that_failed():
    line = {"met": False, "frequency_hz": 3.25, "reached": 2.125e-6, "allowed": 1e-6, "excess": 1.125e-6}
    run = fake_run(
        point("000", "failed", requirement_line=line), requirement_line={"frequency_hz": [], "rms": []}
    )
    data = document(run).partition('id="run">')[2].partition("</script>")[0]
    assert json.loads(data)["points"][0]["requirement_line"] == dict.fromkeys(line)


# ---- exit codes ----

MET = {"met": True, "frequency_hz": 3.0, "reached": 1e-6, "allowed": 2e-6, "excess": -1e-6}
EXCEEDED = MET | {"met": False, "reached": 3e-6, "excess": 1e-6}
NOT_JUDGED = dict.fromkeys(MET)
LINE = {"frequency_hz": [1.0, 2.0], "rms": [1e-6, 2e-6]}


def of(*points: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return fake_run(*points, **changes)


def violated(**changes: Any) -> dict[str, Any]:
    """A point whose first constraint is not met."""
    made = point("000", "evaluated", **changes)
    made["constraints"][0] |= {"met": False, "value": 4.0, "slack": -1.0}
    return made


@pytest.mark.parametrize(
    ("run", "code"),
    [
        (of(point("000", "evaluated")), Code.DONE),
        (of(violated()), Code.UNMET),
        (of(violated(), point("001", "optimal")), Code.DONE),
        (of(point("000", "evaluated"), requirements={"jitter_total": 1e-9}), Code.UNMET),
        (of(point("000", "evaluated"), requirements={"natural_frequency[3]": 1.0}), Code.UNMET),
        (of(point("000", requirement_line=MET), requirement_line=LINE), Code.DONE),
        (of(point("000", requirement_line=EXCEEDED), requirement_line=LINE), Code.UNMET),
        (of(point("000", requirement_line=NOT_JUDGED), requirement_line=LINE), Code.UNMET),
        (of(point("000"), requirement_line=LINE), Code.UNMET),
        (of(point("start", requirement_line=MET), point("000", requirement_line=EXCEEDED), requirement_line=LINE),
         Code.UNMET),
        (of(violated(), point("001", "failed")), Code.UNVERIFIED),
        (of(point("000", "unstable", verified=False)), Code.UNVERIFIED),
    ],
)  # fmt: skip
def test_the_exit_code_says_whether_any_verified_point_meets_all_that_is_required(run, code):
    assert exit_code(run, stopped=False) == code
    assert exit_code(run, stopped=True) == Code.INTERRUPTED
    assert [*closing(run, Path("out"), 1.0)]


def test_a_requirement_may_be_missed_by_as_little_as_a_constraint():
    found = point("000", "evaluated")
    value = found["metrics"]["jitter_total"]
    assert exit_code(of(found, requirements={"jitter_total": value * (1 - 5e-7)}), stopped=False) == Code.DONE
    assert (
        exit_code(of(found, requirements={"jitter_total": value * (1 - 2e-6)}), stopped=False) == Code.UNMET
    )


def test_the_end_of_a_run_says_what_the_only_design_misses():
    run = of(violated(requirement_line=EXCEEDED), requirements={"jitter_total": 1e-6}, requirement_line=LINE)
    lines = [*closing(run, Path("out"), 1.0)]
    said = [line for line in lines if line.startswith("000 misses ")]
    constraint, requirement, line = said
    assert constraint.startswith(f"000 misses constraint {run['points'][0]['constraints'][0]['name']}: ")
    assert requirement.startswith("000 misses requirement jitter_total: ")
    assert requirement.endswith(" urad, at most 1 urad")
    assert line == "000 misses requirement line: 3 urad of 2 urad at 3 Hz, 1 urad above"
    assert summary(run, Path("out"), Code.UNMET, 1.0)["points"][0]["misses"] == [
        each.removeprefix("000 misses ") for each in said
    ]


def test_the_end_of_a_run_says_that_the_only_design_keeps_below_the_line():
    run = of(point("000", requirement_line=MET), requirement_line=LINE)
    lines = [*closing(run, Path("out"), 1.0)]
    assert (
        "000 keeps below the requirement line, closest with 1 urad of 2 urad at 3 Hz, 1 urad below" in lines
    )
    assert "000 meets all requirements" in lines


def test_the_end_of_a_front_counts_the_points_that_meet_all():
    run = of(violated(), point("001"), point("002"), requirements={})
    assert "2 of 3 verified points meet all requirements" in [*closing(run, Path("out"), 1.0)]
    quiet = [*closing(of(point("001"), point("002"), requirements={}), Path("out"), 1.0)]
    assert not any("requirement" in line for line in quiet)


def test_an_analysis_that_misses_a_constraint_ends_with_code_6(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bound = "constraints:\n  - {metric: modulus_margin, lower: 0.99}\n"
    Path("study.yaml").write_text(study_text(NATIVE) + bound)
    result = CliRunner().invoke(app, ["run", "study.yaml"])
    assert result.exit_code == Code.UNMET == 6, result.output
    assert "000 misses constraint modulus_margin: 0." in result.stdout
    assert ", at least 0.99\n" in result.stdout
    again = CliRunner().invoke(app, ["resume", "runs/study", "--json"])
    assert (again.exit_code, json.loads(again.stdout)["exit_code"]) == (6, 6)
    Path("loose.yaml").write_text(study_text(NATIVE) + bound.replace("0.99", "0.1"))
    assert CliRunner().invoke(app, ["run", "loose.yaml"]).exit_code == 0
