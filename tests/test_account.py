"""The two-sided account: bounds beside a design, held against it, and where they stand in a run."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
from small_problems import limit, truss_problem
from small_studies import analysis, edited, run_text

import fosopt.account as accounts
from fosopt.account import Entry, PidSearch, account, pid_box
from fosopt.errors import StudyError
from fosopt.study import parse_study

NAMES = ["mass_lower_bound", "mass_lower_bound_same_frequency", "jitter_bound_pid", "jitter_bound_any"]
QUICK = PidSearch(3.0, 0.2)


@pytest.fixture(scope="module")
def problem():
    return truss_problem(
        constraints=(limit("first_elastic_frequency", lower=60.0), limit("modulus_margin", lower=0.4))
    )


@pytest.fixture(scope="module")
def entries(problem):
    return {e.name: e for e in account(problem, problem.start, problem.constraints, pid=QUICK)}


def test_every_bound_is_below_what_the_design_has(problem, entries):
    assert list(entries) == NAMES
    truth = problem.evaluate(problem.start, truth=True)
    for name, entry in entries.items():
        metric = "structural_mass" if name.startswith("mass") else "jitter_total"
        assert entry.reached == truth.value(metric)
        assert 0 < entry.value <= entry.reached
        assert entry.gap == pytest.approx(1 - entry.value / entry.reached, rel=1e-12)
        assert entry.of and entry.assumptions


def test_fewer_choices_never_lower_a_bound(entries):
    """Any controller includes every PID, and the requirements are met by structures of other frequencies."""
    assert entries["jitter_bound_any"].value <= entries["jitter_bound_pid"].value
    assert entries["mass_lower_bound"].value <= entries["mass_lower_bound_same_frequency"].value * (1 + 1e-9)


def test_what_was_left_out_is_said(entries):
    assert "modulus_margin" in entries["mass_lower_bound"].remark


def test_no_random_structure_that_meets_the_requirement_is_lighter_than_the_bound(problem, entries):
    rng = np.random.default_rng(8)
    low, high = problem.bounds
    met = 0
    for _ in range(300):
        x = problem.start.copy()
        x[:2] = low[:2] * (high[:2] / low[:2]) ** rng.uniform(size=2)
        evaluation = problem.evaluate(x)
        if evaluation.value("first_elastic_frequency") >= 60.0:
            met += 1
            assert evaluation.value("structural_mass") >= entries["mass_lower_bound"].value
    assert met > 30


def test_the_box_of_gains_spans_the_corners_of_the_controllers_variables(problem):
    box = pid_box(problem, problem.start)
    pid = problem.design(problem.start).loop.controller
    assert box.kp[0] < pid.gain * pid.kp < box.kp[1]
    assert box.ki[0] < pid.gain * pid.ki < box.ki[1]
    assert (box.gain, box.rolloff_time) == ((1.0, 1.0), 0.0)


def test_fixed_gains_have_no_box(problem):
    fixed = replace(problem, variables=problem.variables[:1])
    start = problem.start[:2]
    found = {e.name: e for e in account(fixed, start, (), pid=QUICK, structure=False)}
    assert found["jitter_bound_pid"].value is None
    assert "no controller gain is a design variable" in found["jitter_bound_pid"].remark
    assert found["jitter_bound_pid"].gap is None
    assert found["jitter_bound_any"].value > 0


def test_a_problem_without_disturbances_has_bounds_on_its_structure_alone():
    quiet = truss_problem(("structural_mass",), disturbances=())
    assert [e.name for e in account(quiet, quiet.start, (), pid=QUICK)] == NAMES[:2]


def test_a_structure_without_variables_says_why_it_has_no_bound(problem):
    loop_only = replace(problem, variables=problem.variables[1:])
    found = account(loop_only, problem.start[2:], (), any_controller=False)
    assert all(e.value is None and e.remark for e in found)


def test_a_bound_above_the_design_stops_with_both_numbers(problem, monkeypatch):
    right = accounts.performance_limit

    def wrong(model, disturbances):
        found = right(model, disturbances)
        return replace(found, bound=replace(found.bound, value=1.0))

    monkeypatch.setattr(accounts, "performance_limit", wrong)
    jitter = problem.evaluate(problem.start).value("jitter_total")
    with pytest.raises(RuntimeError, match=f"reaches {jitter:.12g}, below the bound 1 of"):
        account(problem, problem.start, (), structure=False)


def test_a_bound_whose_proof_does_not_give_it_again_is_withheld(problem, monkeypatch):
    right = accounts.structure_floor

    def boasting(*arguments, **options):
        found = right(*arguments, **options)
        return replace(found, bound=replace(found.bound, value=found.bound.value * 1.001))

    monkeypatch.setattr(accounts, "structure_floor", boasting)
    found = account(problem, problem.start, problem.constraints, any_controller=False)
    assert all(e.value is None and "when computed again" in e.remark for e in found)


def test_an_entry_of_nothing_has_no_gap():
    assert Entry("jitter_bound_any", 0.0, 0.0).gap is None


# --- in a run

CERTIFICATES = "\ncertificates:\n  pid: {time_limit: 2 s, gap: 20 %}\n"


def test_a_run_with_certificates_has_them_in_every_file(tmp_path):
    run = run_text(edited(("points: 5", "points: 2")) + CERTIFICATES, tmp_path)
    start, *front = run["points"]
    assert start["bounds"] == []
    for point in front:
        assert point["verified"]
        assert [b["name"] for b in point["bounds"]] == NAMES
        assert all(b["value"] is not None and 0 <= b["gap"] < 1 for b in point["bounds"])
    text = (tmp_path / "out" / "front.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    assert rows[0]["mass_lower_bound_kg"] == ""
    assert float(rows[1]["mass_lower_bound_kg"]) == front[0]["bounds"][0]["value"]
    assert float(rows[2]["jitter_bound_any_gap"]) == front[1]["bounds"][3]["gap"]
    # The least mass is that of the bound: IPOPT's optimum of a problem that is all but convex.
    assert front[0]["bounds"][0]["gap"] < 1e-2
    assert "jitter_bound_pid" in run["quantities"]


def test_an_analysis_has_bounds_on_its_controller(tmp_path):
    (point,) = run_text(analysis() + "\ncertificates: {pid: null}\n", tmp_path)["points"]
    found = {b["name"]: b for b in point["bounds"]}
    assert found["mass_lower_bound"]["value"] is None
    assert found["jitter_bound_any"]["value"] > 0
    assert "jitter_bound_pid" not in found


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("certificates: {pid: {gap: 0}}", "certificates.pid.gap"),
        ("certificates: {pid: {time_limit: 0 s}}", "certificates.pid.time_limit"),
        ("certificates: {mass: true}", "certificates.mass: unknown key"),
    ],
)
def test_wrong_certificates_are_refused(text, words):
    with pytest.raises(StudyError, match=words.replace(".", r"\.")):
        parse_study(edited() + f"\n{text}\n")
