"""The two-sided account: bounds beside a design, held against it, and where they stand in a run."""

from __future__ import annotations

import csv
from dataclasses import replace
from math import inf

import numpy as np
import pytest
from small_problems import limit, truss_problem
from small_sizings import truss_of
from small_studies import STUDIES, analysis, edited, run_text

import fosopt.account as accounts
from fosopt.account import Entry, PidSearch, account, pid_box, refutation
from fosopt.errors import ModelError, StudyError
from fosopt.modes import Hub
from fosopt.relax.structural import own_receptance
from fosopt.study import describe_study, dump_study, parse_study

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


# --- as stiff as the design

RECEPTANCE = "mass_lower_bound_same_receptance"


def held_receptance(problem, x, rate):
    """At the mirror's port with the hub clamped, from the modes of the clamped structure."""
    modes = problem.evaluate(x).frame.modal_set(Hub("fixed"), problem.system.damping, ("tip",))
    return float(np.sum(modes.at("tip") ** 2 / (modes.natural_frequency**2 - rate**2)))


@pytest.mark.parametrize("rate", [0.0, 20.0])
def test_a_designs_own_receptance_is_that_of_its_modes(rate):
    problem = truss_of("fixed", 3)
    asked = own_receptance(problem, problem.start, "tip", rate)
    assert (asked.port, asked.frequency) == ("tip", rate)
    assert asked.upper == pytest.approx(held_receptance(problem, problem.start, rate), rel=1e-9)


@pytest.mark.parametrize("rate", [0.0, 20.0])
def test_no_random_structure_as_stiff_as_the_design_is_lighter_than_the_bound(rate):
    problem = truss_of("fixed", 3)
    (entry,) = account(
        problem, problem.start, (), structure=False, receptance=("tip", rate), any_controller=False
    )
    assert entry.name == RECEPTANCE
    assert 0 < entry.value < entry.reached
    assert "receptance at 20" in entry.of if rate else "compliance" in entry.of
    own, met = held_receptance(problem, problem.start, rate), 0
    rng = np.random.default_rng(4)
    for spread in rng.uniform(0.0, 0.3, 300):
        x = np.clip(problem.start * np.exp(spread * rng.normal(size=problem.start.size)), *problem.bounds)
        evaluation = problem.evaluate(x)
        if evaluation.value("first_elastic_frequency") > rate and held_receptance(problem, x, rate) <= own:
            met += 1
            assert evaluation.value("structural_mass") >= entry.value
    assert met > 30
    # The bound is that of a structure, which is found to be as stiff and almost as light.
    lighter = float(entry.remark.split("structure of ")[1].split(" kg")[0])
    assert entry.value == pytest.approx(lighter, rel=1e-5)


def test_a_receptance_above_the_first_frequency_has_no_bound_and_says_why():
    problem = truss_of("pinned", 3)
    with pytest.raises(ModelError, match=r"not below [\d.]+ rad/s, the first frequency"):
        own_receptance(problem, problem.start, "tip", 1e4)
    (entry,) = account(
        problem, problem.start, (), structure=False, receptance=("tip", 1e4), any_controller=False
    )
    assert entry.value is None
    assert "lower it" in entry.remark
    # Held at its hub, a pinned truss is the fixed one.
    held = truss_of("fixed", 3)
    first = held.evaluate(held.start).value("first_elastic_frequency")
    assert float(entry.remark.split("not below ")[1].split(" rad/s")[0]) == pytest.approx(first, rel=1e-5)


def test_an_entry_of_nothing_has_no_gap():
    assert Entry("jitter_bound_any", 0.0, 0.0).gap is None


# --- nothing in the box


def test_a_requirement_no_structure_meets_is_refuted_and_one_that_some_do_is_not(problem):
    asked = (limit("first_elastic_frequency", lower=1e4), limit("modulus_margin", lower=0.4))
    found = refutation(problem, problem.start, asked)
    assert found.name == "mass_lower_bound"
    assert found.value == inf
    assert found.gap is None
    assert found.remark == "proven: no structure in the box meets 10000 rad/s <= first_elastic_frequency"
    assert "no structure in the box does" in found.of
    assert refutation(problem, problem.start, problem.constraints) is None
    # The stiffest structure of the box meets what all of it is as stiff as.
    x = problem.start.copy()
    x[:2] = problem.bounds[1][:2]
    reached = problem.evaluate(x).value("first_elastic_frequency")
    barely = limit("first_elastic_frequency", lower=0.9 * reached)
    assert refutation(problem, problem.start, (barely,)) is None


def test_without_structural_variables_or_a_proof_that_comes_out_again_nothing_is_refuted(
    problem, monkeypatch
):
    asked = (limit("first_elastic_frequency", lower=1e4),)
    loop_only = replace(problem, variables=problem.variables[1:])
    assert refutation(loop_only, problem.start[2:], asked) is None
    monkeypatch.setattr("fosopt.relax.structure_floor.StructureFloor.recomputed", lambda self: 1e9)
    assert refutation(problem, problem.start, asked) is None


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


def test_a_run_has_the_receptance_floor_it_asks_for(tmp_path):
    asked = "\ncertificates: {structure: false, pid: null, any_controller: false, receptance: {port: tip}}\n"
    run = run_text(edited(("points: 5", "points: 2")) + asked, tmp_path)
    for point in run["points"][1:]:
        (found,) = point["bounds"]
        assert found["name"] == RECEPTANCE
        assert 0 <= found["gap"] < 1
        assert "compliance at port 'tip'" in found["of"]
    assert run["quantities"][RECEPTANCE]["label"] == "least mass for this receptance"


def test_a_run_whose_requirement_no_structure_meets_says_that_this_is_proven(tmp_path):
    run = run_text(
        edited(("points: 5", "points: 2"), ("lower: 4 Hz", "lower: 5 kHz")) + CERTIFICATES, tmp_path
    )
    refuted = run["points"][1]
    assert refuted["status"] == "infeasible"
    assert (
        "proven: no structure in the box meets 31415.92654 rad/s <= first_elastic_frequency"
        in refuted["reason"]
    )
    (entry,) = refuted["bounds"]
    assert (entry["value"], entry["gap"]) == (None, None)


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
        (
            "certificates: {receptance: {port: tipp}}",
            "certificates.receptance.port: .*'tipp'; did you mean 'tip'",
        ),
        ("certificates: {receptance: {port: tip, frequency: -1 Hz}}", "certificates.receptance.frequency"),
        ("certificates: {receptance: {}}", "certificates.receptance.port"),
    ],
)
def test_wrong_certificates_are_refused(text, words):
    with pytest.raises(StudyError, match=words):
        parse_study(edited() + f"\n{text}\n")


def test_a_sweep_takes_no_certificates():
    text = (STUDIES / "inertia-sweep.yaml").read_text(encoding="utf-8")
    with pytest.raises(StudyError, match="a sweep has no 'certificates'"):
        parse_study(f"{text}\ncertificates: {{pid: null}}\n")


def test_a_description_says_what_will_be_bounded():
    asked = "certificates: {receptance: {port: tip}, any_controller: false, pid: {gap: 3 %}}"
    text = "\n".join(describe_study(parse_study(f"{edited()}\n{asked}\n")))
    bounded = text.split("bounded")[1].split("\n\n")[0]
    assert "mass by requirements and by first frequency" in bounded
    assert "mass by receptance of port tip at zero frequency" in bounded
    assert "any controller" not in bounded
    assert "jitter of any PID in the box to 3 %, 10 s per point" in bounded
    assert "bounded" not in "\n".join(describe_study(parse_study(edited())))


@pytest.mark.parametrize("pid", ["null", "{gap: 3 %}"])
def test_a_search_that_was_declined_stays_declined_when_the_study_is_written_and_read(pid):
    study = parse_study(f"{edited()}\ncertificates: {{pid: {pid}}}\n")
    again = parse_study(dump_study(study))
    assert (again.certificates.pid is None) == (pid == "null")
    assert again == study
