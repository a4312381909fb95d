"""Strategies against each other, fronts, cases and many starts."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from reference import HZ
from small_problems import (
    POINT,
    SAME,
    TIGHT,
    expressions,
    goal,
    limit,
    mass_limited,
    truss_problem,
)

from fosopt.solve import Options, Search, everything_free, reach, solve_cases, trace_front
from fosopt.solve.front import _random, search


@pytest.fixture(scope="module")
def least_jitter():
    problem = mass_limited()
    return problem, reach(goal(problem), problem.start, "simultaneous", TIGHT)


# ---- strategies ----


@pytest.fixture(scope="module")
def by_strategy():
    problem = mass_limited(26.0, bays=4)
    return problem, {
        name: reach(goal(problem), problem.start, name, Options())
        for name in ("simultaneous", "nested", "sequential")
    }


def test_all_strategies_reach_a_design_that_meets_the_constraints(by_strategy):
    problem, found = by_strategy
    for solution in found.values():
        assert solution.status == "optimal"
        at = problem.evaluate(solution.x)
        assert at.value("structural_mass") <= 26.0 * (1 + 1e-6)
        assert at.value("modulus_margin") >= 0.5 * (1 - 1e-6)
        assert at.value("jitter_total") == pytest.approx(solution.objective, rel=1e-6)


def test_simultaneous_is_as_good_as_nested_and_sequential_is_never_better(by_strategy):
    _, found = by_strategy
    best = found["simultaneous"].objective
    assert found["nested"].objective == pytest.approx(best, rel=SAME)
    assert found["sequential"].objective >= best * (1 - 1e-6)


def test_sequential_pays_where_stiffness_is_not_what_the_loop_needs():
    # Noise alone asks for a light structure that the stiffest one of the limit is not.
    constraints = (limit("structural_mass", upper=25.0), limit("modulus_margin", lower=0.5))
    problem = truss_problem(("structural_mass*jitter_total",), constraints)
    best, habit = (
        reach(goal(problem), problem.start, name, Options()) for name in ("simultaneous", "sequential")
    )
    assert best.status == habit.status == "optimal"
    assert habit.objective > best.objective * 1.01


def test_sequential_makes_the_stiffest_structure_first(by_strategy):
    problem, found = by_strategy
    aim = replace(problem, objectives=expressions("-first_elastic_frequency"))
    stiff = reach(goal(aim, free=["area"]), problem.start, "simultaneous", Options())
    np.testing.assert_allclose(found["sequential"].x[:2], stiff.x[:2], rtol=POINT)
    assert found["sequential"].iterations > stiff.iterations


def test_sequential_serves_an_objective_of_the_structure_first():
    problem = truss_problem(
        ("structural_mass",), (limit("first_elastic_frequency", lower=60 * HZ), limit("modulus_margin", 0.3))
    )
    one, two = (
        reach(goal(problem), problem.start, name, Options()) for name in ("simultaneous", "sequential")
    )
    assert two.status == "optimal"
    assert two.objective == pytest.approx(one.objective, rel=1e-5)


def test_sequential_says_which_step_failed():
    problem = mass_limited(5.0)
    found = reach(goal(problem), problem.start, "sequential", Options())
    assert found.status == "infeasible"
    assert found.reason.startswith("structure first: constraints conflict: structural_mass")


def test_nested_keeps_limits_on_the_loop_variables_themselves():
    problem = mass_limited(20.0)
    posed = goal(problem, 0, limit("ki / kp", upper=200.0))
    one, inner = (reach(posed, problem.start, name, Options()) for name in ("simultaneous", "nested"))
    assert one.status == inner.status == "optimal"
    assert inner.objective == pytest.approx(one.objective, rel=SAME)
    assert inner.x[4] / inner.x[3] == pytest.approx(200.0, rel=1e-5)


def test_nested_handles_an_objective_that_needs_no_loop():
    problem = truss_problem(("structural_mass",), (limit("jitter_total", upper=7e-6),), bays=4)
    one, inner = (reach(goal(problem), problem.start, name, Options()) for name in ("simultaneous", "nested"))
    assert one.status == inner.status == "optimal"
    assert inner.objective == pytest.approx(one.objective, rel=SAME)


def test_without_free_structure_all_strategies_are_one(least_jitter):
    problem, _ = least_jitter
    alone = goal(replace(problem, constraints=problem.constraints[1:]), free=["crossover", "kp", "ki"])
    found = {n: reach(alone, problem.start, n, TIGHT) for n in ("simultaneous", "nested", "sequential")}
    assert found["nested"].objective == found["sequential"].objective == found["simultaneous"].objective


# ---- fronts, cases, many starts ----


@pytest.fixture(scope="module")
def front():
    problem = truss_problem(constraints=(limit("modulus_margin", lower=0.5),), bays=4)
    return problem, list(trace_front(problem, problem.start, 4, Search(options=TIGHT)))


def test_a_front_goes_down_from_the_lightest_to_the_quietest(front):
    problem, outcomes = front
    assert len(outcomes) == 4
    assert all(each.solution.status == "optimal" for each in outcomes)
    at = [problem.evaluate(each.solution.x) for each in outcomes]
    mass = [each.value("structural_mass") for each in at]
    jitter = [each.value("jitter_total") for each in at]
    assert all(a < b for a, b in pairwise(mass))
    assert all(a > b for a, b in pairwise(jitter))


def test_the_ends_of_a_front_are_the_least_of_each_objective(front):
    problem, outcomes = front
    mass = reach(goal(problem, 0), problem.start, "simultaneous", TIGHT)
    # From the heavy side jitter has another local minimum; the front is traced from the light one.
    jitter = reach(goal(problem, 1), mass.x, "simultaneous", TIGHT)
    light, quiet = (problem.evaluate(outcomes[k].solution.x) for k in (0, -1))
    heaviest = quiet.value("structural_mass")
    assert mass.objective <= light.value("structural_mass") * (1 + 1e-6)
    # A thousandth of the range above the least mass, a ten-thousandth above the least jitter.
    share = (light.value("structural_mass") - mass.objective) / (heaviest - mass.objective)
    assert share == pytest.approx(1e-3, rel=1e-2)
    assert quiet.value("jitter_total") / jitter.objective - 1 == pytest.approx(1e-4, rel=1e-2)
    assert heaviest < problem.evaluate(jitter.x).value("structural_mass"), "which saves mass"


def test_limits_on_the_first_objective_lie_denser_toward_the_light_end(front):
    _, outcomes = front
    limits = [o.goal.constraints[-1].upper for o in outcomes[:-1]]
    least = limits[1] - (limits[2] - limits[1]) / 3  # shares 0, 1/9, 4/9 of the range
    assert limits[0] - least == pytest.approx(1e-3 * 9 * (limits[1] - least), rel=1e-3)


def test_each_point_of_a_front_says_which_one_it_started_from(front):
    _, outcomes = front
    assert [each.parent for each in outcomes] == [None, 0, 1, None]
    assert [each.label for each in outcomes] == [
        "least structural_mass",
        "structural_mass limited",
        "structural_mass limited",
        "least jitter_total",
    ]


def test_parents_count_the_points_of_other_strategies_too():
    problem = truss_problem(constraints=(limit("modulus_margin", lower=0.5),))
    how = Search(compare=("sequential",))
    outcomes = list(trace_front(problem, problem.start, 3, how))
    assert [each.strategy for each in outcomes] == [*("simultaneous", "sequential") * 3]
    assert [each.parent for each in outcomes] == [None, None, 0, None, None, None]
    assert outcomes[1].goal.constraints == outcomes[0].goal.constraints


def test_a_front_without_a_feasible_design_is_one_point_that_says_why():
    problem = truss_problem(constraints=(limit("first_elastic_frequency", lower=3000 * HZ),))
    (only,) = trace_front(problem, problem.start, 5, Search())
    assert only.solution.status == "infeasible"
    assert "first_elastic_frequency" in only.solution.reason


def test_a_stopped_front_keeps_what_it_has():
    problem = truss_problem(constraints=(limit("modulus_margin", lower=0.5),))
    done = []
    for outcome in trace_front(problem, problem.start, 6, Search(), lambda: len(done) >= 2):
        done.append(outcome)
    assert len(done) == 2


@pytest.mark.parametrize("strategy", ["sequential", "nested"])
def test_a_front_of_another_strategy_ends_at_designs_too(strategy):
    problem = truss_problem(constraints=(limit("first_elastic_frequency", lower=60 * HZ),))
    outcomes = list(trace_front(problem, problem.start, 2, Search(strategy)))
    assert [each.solution.status for each in outcomes] == ["optimal", "optimal"]
    light, quiet = (problem.evaluate(each.solution.x) for each in outcomes)
    assert light.value("structural_mass") < quiet.value("structural_mass")
    assert light.value("jitter_total") > quiet.value("jitter_total")


def test_many_starts_find_the_same_for_one_seed_and_count_who_agrees(least_jitter):
    problem, reference = least_jitter
    found = [search(goal(problem), problem.start, Search(starts=3, seed=4), 0) for _ in range(2)]
    np.testing.assert_array_equal(found[0][0].x, found[1][0].x)
    best, tried, agreed = found[0]
    assert tried == 3
    assert 1 <= agreed <= 3
    assert best.objective <= reference.objective * (1 + SAME)


def test_random_starts_depend_on_the_seed_and_stay_inside_the_bounds(least_jitter):
    problem, _ = least_jitter
    posed = goal(problem, free=["area", "kp"])
    lower, upper = problem.bounds
    drawn = np.array([_random(posed, problem.start, np.random.default_rng([s, 0])) for s in range(200)])
    assert np.all((lower <= drawn) & (drawn <= upper))
    np.testing.assert_array_equal(drawn[:, [2, 4]], np.tile(problem.start[[2, 4]], (200, 1)))
    assert np.unique(drawn[:, 0]).size == 200
    # On a logarithmic scale the median is the geometric mean; 200 draws place it to a tenth of the range.
    share = np.log(drawn[:, 3] / lower[3]) / np.log(upper[3] / lower[3])
    assert np.median(share) == pytest.approx(0.5, abs=0.1)


def test_random_starts_of_a_linear_variable_are_even_on_a_linear_scale():
    problem = mass_limited(log=False)
    posed = goal(problem)
    lower, upper = problem.bounds
    drawn = np.array([_random(posed, problem.start, np.random.default_rng([s, 0])) for s in range(200)])
    share = (drawn - lower) / (upper - lower)
    np.testing.assert_allclose(np.median(share, axis=0), 0.5, atol=0.1)


def test_starts_agree_also_where_the_objective_is_negative():
    problem = truss_problem(("-first_elastic_frequency",), (limit("structural_mass", upper=22.0),))
    _, tried, agreed = search(goal(problem, free=["area"]), problem.start, Search(starts=3), 0)
    assert (tried, agreed) == (3, 3)


def test_of_many_starts_a_failed_one_never_wins(least_jitter):
    problem, reference = least_jitter
    # The first start has its iterations, later ones are stopped at once.
    calls = iter(range(10**6))
    stop = lambda: next(calls) > reference.iterations + 1  # noqa: E731
    best, _, _ = search(goal(problem), problem.start, Search(options=TIGHT, starts=3), 0, stop)
    np.testing.assert_array_equal(best.x, reference.x)


def test_cases_free_what_they_name_and_start_alike():
    problem = mass_limited(20.3)
    masks = {}
    for name in ("area", "kp"):
        masks[name] = goal(problem, free=[name]).free
    masks["all"] = everything_free(problem)
    found = dict(solve_cases(problem, problem.start, list(masks.items()), Search()))
    assert list(found) == ["area", "kp", "all"]
    for name, mask in masks.items():
        x = found[name].solution.x
        np.testing.assert_array_equal(x[~mask], problem.start[~mask])
        assert np.any(x[mask] != problem.start[mask])
    assert found["all"].solution.objective <= found["area"].solution.objective
    assert found["all"].solution.objective <= found["kp"].solution.objective * (1 + 1e-6)


def test_a_stopped_run_of_cases_keeps_the_finished_ones():
    problem = mass_limited(20.3)
    cases = [("a", everything_free(problem)), ("b", everything_free(problem))]
    done = []
    for name, _ in solve_cases(problem, problem.start, cases, Search(), lambda: bool(done)):
        done.append(name)
    assert done == ["a"]
