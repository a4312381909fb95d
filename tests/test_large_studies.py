"""Studies and problems of large trusses: which modes they keep, how they are judged, and what it costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
import small_problems
from scipy import optimize, sparse
from small_studies import analysis, run_text, single

from fosopt.account import account
from fosopt.certify import certify
from fosopt.cli.outcome import _truncation
from fosopt.control import gain_for_crossover
from fosopt.errors import ModelError
from fosopt.expressions import parse_expression
from fosopt.problem import Evaluation, ModeSelection, Rows
from fosopt.solve.kkt import active_multipliers
from fosopt.study import parse_study
from fosopt.study.build import build_problem

HZ = reference.HZ
AIR = reference.DISTURBANCES[2]
# Both solvers err by some units in the last place of the largest eigenvalue, 1e5 to 1e7 times the lowest here.
EIGEN = 1e-8


@pytest.fixture
def everything_is_large(monkeypatch):
    """Trusses of any size are solved as large ones are."""
    monkeypatch.setattr("fosopt.problem.system.LARGE", 0)
    monkeypatch.setattr("fosopt.study.build.LARGE", 0)


def test_a_large_structure_is_truncated_by_its_number_of_modes_and_judged_on_twice_as_many():
    system, _ = reference.system_and_design(bays=180, selection=ModeSelection(90))
    assert len(system.structure.dofs) == 541
    assert system.truncated == 90 and system.truth.truncated == 180
    assert system.model == "the first 90 of 541 with residual flexibility, judged on 180"
    # Beyond half of all, the dense solver takes over.
    more = replace(system, selection=ModeSelection(200))
    assert more.truncated == 200 and more.truth.selection == ModeSelection()
    assert more.model.endswith("judged on 541")
    most = replace(system, selection=ModeSelection(300))
    assert most.truncated is None and most.model == "some of 541, judged on all"
    assert replace(system, selection=ModeSelection()).model == "all 541"


def test_a_structure_too_large_to_be_solved_whole_says_what_it_would_take():
    system, design = reference.system_and_design(bays=1200, selection=ModeSelection())
    with pytest.raises(
        ModelError, match=r"all modes of 3601 degrees of freedom would take about \d+ GiB; keep"
    ):
        _ = Evaluation(system, design).frame
    few = replace(system, selection=ModeSelection(1500))
    assert few.truth.truncated == 1800


@pytest.mark.usefixtures("everything_is_large")
def test_a_study_of_a_large_truss_is_judged_on_more_modes(tmp_path):
    text = analysis(("damping:", "modes: {count: 8}\n\ndamping:"), bays=12)
    run = run_text(text, tmp_path)
    (point,) = run["points"]
    assert point["status"] == "evaluated" and point["verified"]
    error = point["truncation_error"]
    assert 0 < error["jitter_total"] < 0.1
    # Modes that both models have are the same.
    assert error.get("first_elastic_frequency", 0.0) < EIGEN
    assert run["provenance"]["modes"] == "the first 8 of 37 with residual flexibility, judged on 16"


@pytest.mark.usefixtures("everything_is_large")
@pytest.mark.parametrize(
    ("given", "count"), [("", 18), ("modes: {below: 100 Hz}\n", None), ("modes: {count: 7}\n", 7)]
)
def test_a_study_keeps_what_it_asks_for_or_what_the_mirror_needs(given, count, monkeypatch, tmp_path):
    monkeypatch.setattr("fosopt.study.build._FEWEST", 18)
    study = parse_study(analysis(("damping:", f"{given}\ndamping:"), bays=12), tmp_path)
    problem = build_problem(study)
    if count is None:
        frequency = Evaluation(replace(problem.system, selection=ModeSelection()), problem.base)
        count = int(np.count_nonzero(np.sqrt(frequency.frame.eigenvalue) < 100 * HZ))
    assert problem.system.selection == ModeSelection(count)


@pytest.mark.usefixtures("everything_is_large")
def test_a_study_keeps_the_modes_about_the_crossover_of_its_loop(monkeypatch, tmp_path):
    monkeypatch.setattr("fosopt.study.build._FEWEST", 1)
    monkeypatch.setattr("fosopt.study.build._BEYOND", 0.0)
    problem = build_problem(parse_study(analysis(bays=8), tmp_path))
    whole = Evaluation(replace(problem.system, selection=ModeSelection()), problem.base)
    pid, mirror = problem.base.loop.controller, problem.base.loop.mirror
    crossover = optimize.brentq(
        lambda w: gain_for_crossover(w, mirror, pid.kp, pid.ki, pid.kd, pid.rolloff_time) - pid.gain,
        2 * mirror.natural_frequency,
        1e5,
    )
    frequency = np.sqrt(whole.frame.eigenvalue)
    # The crossover is taken from a grid of one percent.
    assert np.all(np.abs(frequency / (1.25 * crossover) - 1) > 0.02)
    count = int(np.count_nonzero(frequency < 1.25 * crossover))
    assert problem.system.selection == ModeSelection(count)


def test_the_end_of_a_run_names_what_truncation_changes_most_and_asks_for_more_modes():
    def lines(error):
        return list(_truncation([{"truncation_error": {}}, {"truncation_error": error}]))

    assert lines({}) == []
    (small,) = lines({"jitter_total": 1e-3, "modulus_margin": 1e-2})
    assert "jitter_total by up to 0.1 % and modulus_margin by up to 1 %" in small
    assert "modes: {count:" in lines({"jitter_total": 1e-3, "modulus_margin": 0.23})[-1]


@pytest.mark.usefixtures("everything_is_large")
def test_a_wrong_mode_or_a_wrong_jitter_of_a_truncated_model_is_caught(monkeypatch):
    problem = small_problems.truss_problem(
        bays=12,
        selection=ModeSelection(8),
        disturbances=(replace(AIR, band=(1.0, 500.0)), small_problems.DISTURBANCES[0]),
    )
    good = certify(problem, problem.start, ())
    assert good.verified, good.reasons
    assert good.mode_residual < 1e-11 and good.jitter_disagreement < 1e-7
    right = Evaluation.frame.func

    def wrong(self):
        frame = right(self)
        return replace(
            frame, shapes=frame.shapes * np.where(np.arange(frame.eigenvalue.size) == 3, 1 + 1e-6, 1.0)
        )

    monkeypatch.setattr(Evaluation, "frame", property(wrong))
    assert any(reason.startswith("modes") for reason in certify(problem, problem.start, ()).reasons)


def test_multipliers_of_many_bounds_are_those_of_nonnegative_least_squares():
    rng = np.random.default_rng(4)
    for _ in range(30):
        n, m = 30, int(rng.integers(0, 4))
        rows, gradient = rng.normal(size=(n, m)), rng.normal(size=n)
        place = rng.integers(0, 3, n)
        upper, lower = place == 1, place == 2
        unit = np.eye(n)
        every = np.hstack([rows, unit[:, upper], -unit[:, lower]])
        expected, least = optimize.nnls(every, -gradient)
        weights, residual = active_multipliers(rows, gradient, upper, lower)
        assert np.linalg.norm(residual) == pytest.approx(least, rel=1e-9)
        assert weights == pytest.approx(expected[:m], rel=1e-7, abs=1e-9)


def test_the_jacobian_of_very_many_variables_is_sparse_and_the_same(monkeypatch):
    problem = small_problems.truss_problem()
    dense = problem.parameter_jacobian(problem.start)
    monkeypatch.setattr("fosopt.symbolic.LARGE_JACOBIAN", 1)
    small = replace(problem)
    found = small.parameter_jacobian(problem.start)
    assert sparse.issparse(found) and found.nnz < dense.size
    assert np.array_equal(found.toarray(), dense)
    value, gradient = problem.evaluate(problem.start).metric("jitter_total")
    both_rows = [Rows(p, (parse_expression("jitter_total"),)) for p in (problem, small)]
    rows = [row(problem.start, problem.evaluate(problem.start)) for row in both_rows]
    assert rows[0][0][0] == value and gradient.size
    assert rows[1][1] == pytest.approx(rows[0][1], rel=1e-12)


@pytest.mark.usefixtures("everything_is_large")
def test_an_optimum_on_few_modes_meets_its_limits_on_the_truth_model(tmp_path):
    limits = "  - {metric: jitter_total, upper: 6 urad}\n  - {metric: modulus_margin, lower: 0.5}\n"
    text = single("structural_mass", limits, **{"damping:": "modes: {count: 6}\n\ndamping:"})
    run = run_text(text.replace("bays: 3", "bays: 6"), tmp_path)
    optimum = run["points"][1]
    assert optimum["status"] == "optimal" and optimum["verified"], optimum["reason"]
    # Without the correction the limit would be missed by about as much.
    assert optimum["truncation_error"]["jitter_total"] > 1e-5
    assert optimum["metrics"]["jitter_total"] == pytest.approx(6e-6, rel=2e-6)


def test_a_proof_that_would_take_too_long_is_left_out_with_the_reason(monkeypatch):
    monkeypatch.setattr("fosopt.account._PROVABLE", 5)
    problem = small_problems.truss_problem()
    entries = account(problem, problem.start, (), any_controller=False)
    assert entries and all(e.value is None and "up to 5 of them" in e.remark for e in entries)
