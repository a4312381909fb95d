"""The judge: a good optimum passes, every deliberate damage is named."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest
import small_problems as small
from reference import HZ
from small_problems import TIGHT, expressions, goal, limit, truss_problem

import fosopt.problem.evaluation as fast
import fosopt.problem.system as system
from fosopt import certify as judge
from fosopt.certify import Certificate, certify
from fosopt.control import closed_loop_state_space
from fosopt.metrics.step import StepCommand
from fosopt.modes import Hub
from fosopt.problem import ModeSelection, Problem
from fosopt.solve import reach

LOOP_METRICS = {
    "jitter_total",
    "jitter_aft_body",
    "jitter_noise",
    "step_offset",
    "step_rms",
    "modulus_margin",
    "loop_crossover",
}


@pytest.fixture(scope="module")
def optimum():
    """Least jitter under a mass limit and a modulus margin that does not bind."""
    constraints = (limit("structural_mass", upper=20.0), limit("modulus_margin", lower=0.5))
    problem = truss_problem(("jitter_total",), constraints, step=StepCommand(1e-6, (0.05, 0.1)))
    found = reach(goal(problem), problem.start, "simultaneous", TIGHT)
    assert found.status == "optimal"
    return problem, found


@pytest.fixture(scope="module")
def unstable():
    problem = truss_problem(
        ("jitter_total",),
        (limit("jitter_total", upper=1.0), limit("modulus_margin", lower=0.1), limit("kp", upper=1e4)),
        bays=20,
        percent=10,
        crossover=230 * HZ,
        damping=0.001,
        step=StepCommand(1e-6, (0.05, 0.1)),
    )
    return problem, certify(problem, problem.start, problem.constraints)


def judged(problem: Problem, x: np.ndarray, *constraints) -> Certificate:
    """As an optimum of the first objective over all variables."""
    posed = goal(problem, 0, *constraints)
    return certify(problem, x, posed.constraints, posed.objective, posed.free)


def only(certificate: Certificate, *beginnings: str) -> bool:
    """Whether it is refused for exactly these reasons."""
    reasons = certificate.reasons
    return (
        not certificate.verified
        and len(reasons) == len(beginnings)
        and all(reason.startswith(begin) for reason, begin in zip(reasons, beginnings, strict=True))
    )


# ---- what is good passes ----


def test_a_good_optimum_is_verified(optimum):
    problem, found = optimum
    certificate = judged(problem, found.x)
    assert certificate.verified, certificate.reasons
    assert certificate.reasons == ()
    assert certificate.stable
    assert certificate.kkt_residual < 1e-6
    assert certificate.mode_residual < 1e-12
    assert certificate.pole_disagreement < 1e-11
    assert certificate.jitter_disagreement < 1e-9
    assert certificate.truncation_error == {}
    assert certificate.metrics["jitter_total"] / found.objective == pytest.approx(1, rel=1e-11)
    assert set(certificate.metrics) == set(problem.system.metric_names)


def test_constraints_come_with_value_slack_and_whether_they_bind(optimum):
    problem, found = optimum
    mass, margin = judged(problem, found.x).constraints
    at = problem.evaluate(found.x)
    assert (mass.name, mass.lower, mass.upper) == ("structural_mass", -inf, 20.0)
    assert mass.value == at.value("structural_mass")
    assert mass.slack == pytest.approx(20.0 - mass.value, abs=1e-12)
    assert mass.active
    assert (margin.name, margin.lower, margin.upper) == ("modulus_margin", 0.5, inf)
    assert margin.slack == pytest.approx(at.value("modulus_margin") - 0.5, rel=1e-12)
    assert margin.slack > 0.1
    assert not margin.active
    assert margin.multiplier == 0.0


def test_a_design_that_was_not_optimized_is_judged_without_multipliers(optimum):
    problem, _ = optimum
    x = problem.vector({"area": 4e-5})
    certificate = certify(problem, x, problem.constraints)
    assert certificate.verified
    assert certificate.kkt_residual is None
    assert all(each.multiplier is None for each in certificate.constraints)


def test_nothing_free_is_nothing_optimized(optimum):
    problem, _ = optimum
    x = problem.vector({"area": 4e-5})
    none = np.zeros(problem.size, dtype=bool)
    certificate = certify(problem, x, problem.constraints, problem.objectives[0], none)
    assert certificate.verified
    assert certificate.kkt_residual is None


def test_the_abscissa_is_that_of_a_dense_eigenvalue_solver(optimum):
    problem, found = optimum
    truth = problem.evaluate(found.x, truth=True)
    a = closed_loop_state_space(truth.design.loop, truth.modes, "tip").a
    abscissa = judged(problem, found.x).spectral_abscissa
    assert abscissa == pytest.approx(np.linalg.eigvals(a).real.max(), rel=1e-6)


# ---- multipliers ----


@pytest.mark.parametrize("bound", [1000.0, 2500.0])
@pytest.mark.parametrize("log", [True, False], ids=["log", "linear"])
def test_a_multiplier_is_the_price_of_the_bound_in_physical_units(bound, log):
    problem = small.rod_problem(bound, log)
    (frequency,) = judged(problem, problem.vector({"area": small.least_rod_area(bound)})).constraints
    assert frequency.multiplier == pytest.approx(small.rod_mass_slope(bound), rel=1e-9)
    assert frequency.multiplier > 0, "a stiffer rod is heavier"


def test_multipliers_computed_afresh_are_those_of_the_solver(optimum):
    problem, found = optimum
    mass, _ = judged(problem, found.x).constraints
    assert mass.multiplier < 0, "more mass, less jitter"
    # IPOPT gives the factor of the Lagrangian, the judge the change per unit of the bound.
    assert mass.multiplier == pytest.approx(-found.multipliers[found.row_names.index(mass.name)], rel=1e-4)


def test_the_upper_of_two_bounds_on_a_minimum_has_its_price_too():
    # The least stiffness within bounds: the lower bound costs, the upper one is idle, and the other way round.
    problem = small.rod_problem(1000.0)
    both = limit("first_elastic_frequency", 1000.0, 1100.0)
    low = replace(problem, constraints=(both,))
    (price,) = judged(low, low.vector({"area": small.least_rod_area(1000.0)})).constraints
    assert price.multiplier == pytest.approx(small.rod_mass_slope(1000.0), rel=1e-9)
    high = replace(low, objectives=expressions("-structural_mass"))
    (price,) = judged(high, high.vector({"area": small.least_rod_area(1100.0)})).constraints
    assert price.multiplier == pytest.approx(-small.rod_mass_slope(1100.0), rel=1e-9)


def test_variables_at_their_bounds_need_no_multiplier():
    problem = replace(truss_problem(("structural_mass",)), constraints=())
    lower, _ = problem.bounds
    x = problem.start.copy()
    x[:2] = lower[:2]
    assert judged(problem, x).kkt_residual < 1e-12
    assert judged(problem, x).verified
    upside_down = replace(problem, objectives=expressions("-structural_mass"))
    assert only(judged(upside_down, x), "optimality: KKT residual")
    _, upper = problem.bounds
    x[:2] = upper[:2]
    assert only(judged(problem, x), "optimality: KKT residual")
    assert judged(upside_down, x).verified


# ---- every damage is named ----


@pytest.mark.parametrize("name", ["area", "crossover", "kp", "ki"])
def test_a_point_beside_the_optimum_is_no_optimum(optimum, name):
    problem, found = optimum
    x = found.x.copy()
    x[problem.slices()[name]] *= 0.95
    certificate = judged(problem, x)
    assert only(certificate, "optimality: KKT residual")
    assert certificate.kkt_residual > judge.OPTIMALITY


def test_a_wrong_sign_of_the_multiplier_is_no_optimum(optimum):
    # The optimum of a mass limit is not one of a mass demanded: the multiplier would have to be negative.
    problem, found = optimum
    at_least = replace(problem, constraints=(limit("structural_mass", lower=20.0),))
    assert only(judged(at_least, found.x), "optimality: KKT residual")


@pytest.mark.parametrize(
    ("share", "verified"), [(0.0, True), (0.5e-6, True), (2e-6, False), (1e-2, False)], ids=str
)
def test_a_constraint_may_be_violated_by_the_tolerance_and_no_more(share, verified):
    problem = truss_problem()
    mass = problem.evaluate(problem.start).value("structural_mass")
    for constraint in (
        limit("structural_mass", upper=mass / (1 + share)),
        limit("structural_mass", lower=mass / (1 - share)),
    ):
        certificate = certify(problem, problem.start, (constraint,))
        assert certificate.verified == verified
        assert certificate.constraints[0].slack <= 0
        if not verified:
            assert only(certificate, "constraint 'structural_mass' is violated by")


def test_an_unstable_design_is_refused_and_has_no_loop_metric(unstable):
    problem, certificate = unstable
    assert not certificate.stable
    assert not certificate.verified
    assert certificate.reasons[0].startswith("unstable: a pole has the real part 1.02")
    assert certificate.spectral_abscissa == pytest.approx(
        problem.evaluate(problem.start).value("spectral_abscissa"), rel=1e-6
    )
    assert certificate.jitter_disagreement is None
    assert {name for name, value in certificate.metrics.items() if value is None} == LOOP_METRICS
    assert certificate.metrics["structural_mass"] == pytest.approx(108.3)
    assert certificate.metrics["spectral_abscissa"] > 0


def test_a_constraint_on_the_loop_has_no_value_where_the_loop_is_unstable(unstable):
    _, certificate = unstable
    assert [each.name for each in certificate.constraints] == ["kp"]
    assert certificate.reasons[1:] == tuple(
        f"constraint '{name}' has no value: the loop is unstable"
        for name in ("jitter_total", "modulus_margin")
    )


def test_an_unstable_design_is_no_optimum_of_anything(unstable):
    problem, _ = unstable
    certificate = judged(problem, problem.start)
    assert certificate.kkt_residual is None
    assert not certificate.verified


def test_a_design_made_on_too_few_modes_is_judged_on_all_of_them():
    few = truss_problem(("jitter_total",), bays=6, selection=ModeSelection(count=3))
    x = few.start
    all_modes = replace(few, system=few.system.truth)
    model, truth = few.evaluate(x), all_modes.evaluate(x)
    certificate = certify(few, x, ())
    assert certificate.metrics["jitter_total"] / truth.value("jitter_total") == pytest.approx(1, rel=1e-12)
    for name in ("jitter_total", "modulus_margin"):
        expected = abs(model.value(name) / truth.value(name) - 1)
        assert expected > 1e-6
        assert certificate.truncation_error[name] == pytest.approx(expected, rel=1e-6)
    assert "structural_mass" not in certificate.truncation_error


def test_a_constraint_met_on_too_few_modes_only_is_violated():
    few = truss_problem(("jitter_total",), bays=6, selection=ModeSelection(count=3))
    model = few.evaluate(few.start).value("modulus_margin")
    truth = few.evaluate(few.start, truth=True).value("modulus_margin")
    assert truth < model
    certificate = certify(few, few.start, (limit("modulus_margin", lower=0.5 * (model + truth)),))
    assert only(certificate, f"constraint 'modulus_margin' is violated by {0.5 * (model - truth):.3g} on")


@pytest.mark.parametrize(("share", "active"), [(5e-5, True), (2e-4, False)])
@pytest.mark.parametrize("name", ["structural_mass", "mirror_inertia"])
def test_a_bound_is_active_within_a_share_of_its_size(name, share, active):
    problem = truss_problem()
    value = problem.evaluate(problem.start).value(name)
    certificate = certify(problem, problem.start, (limit(name, upper=value / (1 - share)),))
    assert certificate.constraints[0].active == active


# Residues at wrong poles give what they give; the certificate says so, not the warning.
NONSENSE = pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")


def damaged_poles(factor):
    """A pole finder whose rightmost pole is off by a factor of its distance to the origin."""
    right = fast.closed_loop_poles

    def wrong(*arguments):
        poles = right(*arguments)
        shift = poles.shift.copy()
        shift[0] += factor * np.abs(poles.value).max()
        return replace(poles, shift=shift)

    return wrong


@NONSENSE
def test_a_wrong_pole_is_caught(optimum, monkeypatch):
    problem, _ = optimum
    x = problem.vector({"area": 5e-5})
    monkeypatch.setattr(fast, "closed_loop_poles", damaged_poles(-1e-8))
    certificate = certify(problem, x, ())
    assert not certificate.verified
    assert certificate.reasons[0].startswith("poles: two routes differ by 1.0e-08")


@NONSENSE
def test_a_missing_pole_is_caught(optimum, monkeypatch):
    problem, _ = optimum
    right = fast.closed_loop_poles

    def one_less(*arguments):
        poles = right(*arguments)
        return replace(poles, base=poles.base[1:], shift=poles.shift[1:], multiplicity=poles.multiplicity[1:])

    monkeypatch.setattr(fast, "closed_loop_poles", one_less)
    certificate = certify(problem, problem.start, ())
    assert any(reason.startswith("poles: two routes differ by inf") for reason in certificate.reasons)


def test_a_loop_that_one_route_calls_unstable_is_unstable(optimum, monkeypatch):
    problem, _ = optimum
    monkeypatch.setattr(fast, "closed_loop_poles", damaged_poles(1.0))
    certificate = certify(problem, problem.start, ())
    assert not certificate.stable
    assert certificate.metrics["jitter_total"] is None


def test_an_unstable_loop_that_the_fast_route_calls_stable_is_unstable(unstable, monkeypatch):
    problem, _ = unstable
    right = fast.closed_loop_poles

    def mirrored(*arguments):
        poles = right(*arguments)
        return replace(poles, shift=poles.shift - 2 * np.maximum(poles.value.real, 0) - 1e-3)

    monkeypatch.setattr(fast, "closed_loop_poles", mirrored)
    assert problem.evaluate(problem.start).stable, "the test tests nothing"
    certificate = certify(problem, problem.start, problem.constraints)
    assert not certificate.stable
    assert certificate.metrics["jitter_total"] is None


@pytest.mark.parametrize("error", [1e-5, -1e-5])
def test_a_wrong_jitter_is_caught(optimum, monkeypatch, error):
    problem, _ = optimum
    right = fast.jitter_variances

    def wrong(*arguments):
        first, *others = right(*arguments)
        return [replace(first, value=first.value * (1 + error)), *others]

    monkeypatch.setattr(fast, "jitter_variances", wrong)
    # A variance that is off by ε is a jitter that is off by ε/2.
    certificate = certify(problem, problem.start, ())
    assert only(certificate, "jitter: two routes differ by 5.0e-06, more than 1e-06")
    assert certificate.jitter_disagreement == pytest.approx(5e-6, rel=1e-3)


def test_a_wrong_jitter_of_any_disturbance_is_caught(optimum, monkeypatch):
    problem, _ = optimum
    right = fast.jitter_variances

    def wrong(*arguments):
        *others, last = right(*arguments)
        return [*others, replace(last, value=last.value * 1.1)]

    monkeypatch.setattr(fast, "jitter_variances", wrong)
    assert only(certify(problem, problem.start, ()), "jitter: two routes differ by")


@pytest.mark.parametrize(
    "damage",
    [
        lambda frame: replace(frame, eigenvalue=frame.eigenvalue * (1 + 1e-6)),
        lambda frame: replace(frame, shapes=frame.shapes * (1 + 1e-6)),
        lambda frame: replace(frame, shapes=np.roll(frame.shapes, 1, axis=1)),
    ],
    ids=["eigenvalues", "masses", "order"],
)
def test_wrong_modes_are_caught(optimum, monkeypatch, damage):
    problem, _ = optimum
    right = system.modal_frame
    monkeypatch.setattr(system, "modal_frame", lambda *arguments: damage(right(*arguments)))
    reasons = certify(problem, problem.start, ()).reasons
    assert any(reason.startswith("modes: residual") for reason in reasons)


def test_a_wrong_derivative_shows_in_the_residual_of_optimality(optimum, monkeypatch):
    problem, found = optimum
    clean = judged(problem, found.x).kkt_residual
    right, longerons = fast.Evaluation._jitter, list(problem.variables[0].groups[0])

    def wrong(self, names):
        found = right(self, names)
        gradient = found.gradient.copy()
        gradient[longerons] *= 1.1
        return replace(found, make_gradient=lambda: gradient)

    monkeypatch.setattr(fast.Evaluation, "_jitter", wrong)
    # The structure has little say in this optimum: a tenth of little is below the threshold, not below rounding.
    assert judged(problem, found.x).kkt_residual > 1e4 * clean


def test_a_disturbance_that_reaches_nothing_has_no_jitter_and_raises_no_doubt():
    # The hub is clamped: a torque on it moves nothing.
    of = small.structure("fixed", 3)
    problem = truss_problem(())
    system = replace(problem.system, structure=of, hub=Hub("fixed"))
    fixed = replace(problem, system=system)
    certificate = certify(fixed, fixed.start, ())
    assert certificate.verified
    assert certificate.metrics["jitter_aft_body"] == 0.0
    assert certificate.metrics["jitter_total"] == certificate.metrics["jitter_noise"] > 0
