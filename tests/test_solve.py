"""Optima: closed forms, other solvers, strategies against each other, fronts, and honest failures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_problems as small
from reference import HZ, loop_of, mirror_of, square_mast, structure
from scipy import linalg, optimize
from small_problems import (
    AT_OPTIMUM,
    POINT,
    SAME,
    TIGHT,
    areas_by_kind,
    expressions,
    goal,
    limit,
    mass_limited,
    truss_problem,
    variable,
)

from fosopt.certify import certify
from fosopt.modes import Damping, Hub
from fosopt.problem import Design, Problem, System
from fosopt.solve import NonlinearProgram, Options, reach
from fosopt.solve.ipopt import solve
from fosopt.solve.strategies import persist, stabilize
from fosopt.structure import assemble, mass_matrix, stiffness_matrix, structural_mass


@pytest.fixture(scope="module")
def least_jitter():
    problem = mass_limited()
    return problem, reach(goal(problem), problem.start, "simultaneous", TIGHT)


# ---- closed forms ----


@pytest.mark.parametrize("log", [True, False], ids=["log", "linear"])
@pytest.mark.parametrize("bound", [1000.0, 2500.0])
def test_the_lightest_rod_of_a_given_frequency_is_the_closed_form(bound, log):
    problem = small.rod_problem(bound, log)
    found = reach(goal(problem), problem.start, "simultaneous", TIGHT)
    assert (found.status, found.reason) == ("optimal", None)
    assert found.x[0] == pytest.approx(small.least_rod_area(bound), rel=AT_OPTIMUM)
    assert found.objective == problem.evaluate(found.x).value("structural_mass")


def test_a_bound_is_not_undercut():
    # IPOPT by itself relaxes bounds by 1e-8, which would be a rod lighter than the lightest.
    problem = small.rod_problem(1000.0)
    found = reach(goal(problem), problem.start, "simultaneous", Options(tolerance=1e-11))
    assert problem.evaluate(found.x).value("first_elastic_frequency") >= 1000.0 * (1 - 1e-10)
    assert found.x[0] >= small.least_rod_area(1000.0) * (1 - 1e-10)


@pytest.mark.parametrize("bound", [1000.0, 2500.0])
def test_the_multiplier_of_a_frequency_is_the_slope_of_the_least_mass(bound):
    problem = small.rod_problem(bound)
    found = reach(goal(problem), problem.start, "simultaneous", TIGHT)
    # IPOPT's sign: the Lagrangian is f + λ g, so a lower bound that binds has λ = −df*/dbound.
    total = sum(m for m, name in zip(found.multipliers, found.row_names, strict=True))
    assert total == pytest.approx(-small.rod_mass_slope(bound), rel=POINT)
    assert set(found.row_names) == {"first_elastic_frequency"}


def test_the_quietest_mirror_loop_between_torque_and_sensor_noise_is_the_closed_form():
    problem = replace(small.rod_problem(objective="jitter_total"), constraints=())
    gain, kp, jitter = small.least_jitter()
    found = reach(goal(problem, free=["gain", "kp"]), problem.start, "simultaneous", TIGHT)
    assert found.objective == pytest.approx(jitter, rel=AT_OPTIMUM)
    np.testing.assert_allclose(found.x[1:], [gain, kp], rtol=POINT)
    assert found.x[0] == problem.start[0], "the area was not free"


# ---- other solvers ----


def test_the_lightest_truss_of_a_given_frequency_is_that_of_another_solver():
    of = structure("fixed", 2)
    bound, mirror_mass = 50 * HZ, 20.0
    problem = Problem(
        System(of, "tip", Hub("fixed"), Damping((0.01,))),
        Design(of.area, of.batten_mass, of.spring_stiffness, mirror_mass, loop_of(mirror_of(of, 0.2))),
        (areas_by_kind(of),),
        expressions("structural_mass"),
        (limit("first_elastic_frequency", lower=bound),),
    )
    found = reach(goal(problem), problem.start, "simultaneous", TIGHT)
    groups = problem.variables[0].groups

    def area(z):
        full = np.empty(of.area.size)
        for group, value in zip(groups, z, strict=True):
            full[list(group)] = value * 1e-4
        return full

    def first(z):
        k = stiffness_matrix(of, area(z))
        m = mass_matrix(of, area(z), of.batten_mass, mirror_mass)
        return np.sqrt(linalg.eigh(k, m, eigvals_only=True, subset_by_index=[0, 0])[0])

    # On the bound, which is active, the longerons' area gives the diagonals'; the rest is a search on a line.
    def on_bound(longeron):
        return [longeron, optimize.brentq(lambda d: first([longeron, d]) - bound, 0.13, 3.3, xtol=1e-13)]

    other = optimize.minimize_scalar(
        lambda z: float(structural_mass(of, area(on_bound(z)), of.batten_mass)),
        bounds=found.x[0] * 1e4 * np.array([0.9, 1.1]),
        method="bounded",
        options={"xatol": 1e-8},
    )
    assert np.all((found.x > 13.5e-6) & (found.x < 320e-6)), "no area is at its bound"
    assert first(found.x * 1e4) == pytest.approx(bound, rel=AT_OPTIMUM)
    assert found.objective == pytest.approx(other.fun, rel=AT_OPTIMUM)
    np.testing.assert_allclose(found.x * 1e4, on_bound(other.x), rtol=POINT)


def test_least_jitter_is_no_more_than_a_dense_search_finds():
    problem = truss_problem(("jitter_total",), (limit("modulus_margin", lower=0.9),))
    found = reach(goal(problem, free=["crossover", "kp"]), problem.start, "simultaneous", TIGHT)
    rng = np.random.default_rng(3)
    lower, upper = problem.bounds
    best = np.inf
    for share in rng.uniform(size=(300, 2)):
        x = problem.start.copy()
        x[2:4] = lower[2:4] * (upper[2:4] / lower[2:4]) ** share
        at = problem.evaluate(x)
        if at.stable and at.value("modulus_margin") >= 0.9:
            best = min(best, at.value("jitter_total"))
    assert found.objective <= best
    # 300 points in two dimensions lie close enough for a factor, not for digits.
    assert best < 1.5 * found.objective


@pytest.mark.parametrize(("name", "bound", "step"), [("mass", 20.0, 2e-4), ("margin", 0.9, 2e-4)])
def test_a_multiplier_is_the_change_of_the_optimum_per_unit_of_its_bound(name, bound, step):
    def posed(value):
        bounds = {"mass": 20.0, "margin": 0.5} | {name: value}
        constraints = (
            limit("structural_mass", upper=bounds["mass"]),
            limit("modulus_margin", lower=bounds["margin"]),
        )
        return truss_problem(("jitter_total",), constraints)

    optimum = {}
    for value in (bound * (1 - step), bound, bound * (1 + step)):
        problem = posed(value)
        found = reach(goal(problem), problem.start, "simultaneous", TIGHT)
        assert found.status == "optimal"
        optimum[value] = found
    low, mid, high = optimum.values()
    slope = (high.objective - low.objective) / (2 * step * bound)
    metric = {"mass": "structural_mass", "margin": "modulus_margin"}[name]
    own = [m for m, row in zip(mid.multipliers, mid.row_names, strict=True) if row == metric]
    assert abs(slope) > 0
    # The optimum is good to 1e-9, its difference over 4e-4 of the bound to some 1e-5 of the slope.
    assert -sum(own) == pytest.approx(slope, rel=3e-4)


# ---- the answer does not depend on how it was sought ----


def test_the_optimum_depends_neither_on_scaling_nor_on_the_start(least_jitter):
    problem, reference = least_jitter
    linear = mass_limited(log=False)
    elsewhere = problem.vector({"area": [40e-6, 200e-6], "crossover": 200 * HZ, "kp": 300.0, "ki": 3e4})
    for posed, start in ((linear, linear.start), (problem, elsewhere)):
        found = reach(goal(posed), start, "simultaneous", Options(tolerance=1e-8))
        assert found.status == "optimal"
        assert found.objective == pytest.approx(reference.objective, rel=SAME)
        np.testing.assert_allclose(found.x[:4], reference.x[:4], rtol=1e-2)


def test_the_optimum_does_not_depend_on_what_else_was_solved_before(least_jitter):
    problem, reference = least_jitter
    again = reach(goal(problem), problem.start, "simultaneous", TIGHT)
    np.testing.assert_array_equal(again.x, reference.x)
    assert again.iterations == reference.iterations


@pytest.mark.parametrize("log", [True, False])
def test_the_scaled_program_has_the_gradient_of_its_rows(log):
    problem = truss_problem(
        ("jitter_total",),
        (limit("first_elastic_frequency", 4 * HZ, 900 * HZ), limit("kp/ki", upper=0.05)),
        log=log,
    )
    program = NonlinearProgram(goal(problem, free=["area", "kp"]).task(), problem.start)
    z = program.scaled(problem.start)
    assert z.size == 3
    value, gradient, rows, jacobian = program(z)
    assert rows.size == len(program.row_names) == program.row_scale.size
    np.testing.assert_allclose(program.unscaled(z), problem.start, rtol=1e-14)
    for i in range(z.size):
        h = 1e-5 * np.abs(z[i]) * np.eye(z.size)[i]
        (up, _, rows_up, _), (down, _, rows_down, _) = program(z + h), program(z - h)
        assert gradient[i] == pytest.approx((up - down) / (2 * h[i]), rel=1e-5, abs=1e-8)
        np.testing.assert_allclose(jacobian[:, i], (rows_up - rows_down) / (2 * h[i]), rtol=1e-5, atol=1e-8)
    jitter = problem.evaluate(problem.start).value("jitter_total")
    assert program.objective(value) == pytest.approx(jitter, rel=1e-14)
    assert program.scaled_objective(program.objective(0.7)) == pytest.approx(0.7)
    slope = (program.objective(0.7 + 1e-6) - program.objective(0.7 - 1e-6)) / 2e-6
    assert program.objective_slope(0.7) == pytest.approx(slope, rel=1e-6)


def test_variables_stay_inside_their_bounds_to_the_last_bit():
    problem = truss_problem()
    program = NonlinearProgram(goal(problem).task(), problem.start)
    lower, upper = problem.bounds
    assert np.any(np.exp(program.upper) > upper), "the test tests nothing: no bound is passed by rounding"
    for z in (program.lower, program.upper):
        assert np.all((lower <= program.unscaled(z)) & (program.unscaled(z) <= upper))


# ---- two bounds, two branches, rows that cannot move ----


def test_a_lower_and_an_upper_bound_on_the_first_frequency_both_hold():
    problem = truss_problem(("jitter_total",), (limit("first_elastic_frequency", 20 * HZ, 40 * HZ),))
    found = reach(goal(problem), problem.start, "simultaneous", Options())
    assert found.status == "optimal"
    assert problem.evaluate(found.x).value("first_elastic_frequency") == pytest.approx(40 * HZ, rel=1e-6)


def test_two_frequencies_that_meet_at_the_optimum_share_the_bound():
    of = assemble(square_mast(), "tip")
    name = [bar.name for bar in of.truss.bars]
    corners = [tuple(i for i, n in enumerate(name) if n[0] == "L" and n[2] == str(j)) for j in range(4)]
    braces = tuple(i for i, n in enumerate(name) if n[0] in "DE")
    area = variable("area", [1e-6] * 5, [1e-2] * 5, [1e-4, 2e-4, 1e-4, 3e-4, 1e-4], groups=(*corners, braces))
    bound = 60 * HZ
    problem = Problem(
        System(of, "tip", Hub("fixed"), Damping((0.01,))),
        Design(of.area, of.batten_mass, of.spring_stiffness, 5.0, loop_of(mirror_of(structure(), 0.02))),
        (area,),
        expressions("structural_mass"),
        (limit("first_elastic_frequency", lower=bound),),
    )
    found = reach(goal(problem), problem.start, "simultaneous", TIGHT)
    assert found.status == "optimal"
    frequency = np.sqrt(problem.evaluate(found.x).frame.eigenvalue[:3])
    np.testing.assert_allclose(frequency[:2], bound, rtol=AT_OPTIMUM)
    assert frequency[2] > 1.5 * bound
    # By symmetry the four longerons are alike; one shared area for them gives the same mast.
    np.testing.assert_allclose(found.x[:4], found.x[0], rtol=POINT)
    shared = replace(area, **{k: getattr(area, k)[3:] for k in ("lower", "upper", "start")})
    shared = replace(shared, groups=(sum(corners, ()), braces))
    simple = replace(problem, variables=(shared,))
    alike = reach(goal(simple), simple.start, "simultaneous", TIGHT)
    assert found.objective == pytest.approx(alike.objective, rel=AT_OPTIMUM)


def test_constraints_that_no_free_variable_can_move_are_left_out_of_the_program():
    constraints = (
        limit("structural_mass", upper=20.0),
        limit("jitter_total", upper=1.0),
        limit("area[1]", upper=1e-4),
        limit("ki/kp", upper=1e4),
    )
    problem = truss_problem(("jitter_total",), constraints)
    kept = {
        free: {c.name for c in goal(problem, free=free).task().constraints}
        for free in (("area",), ("kp",), ("crossover",))
    }
    assert kept[("area",)] == {"structural_mass", "jitter_total", "area[1]"}
    assert kept[("kp",)] == {"jitter_total", "ki/kp"}
    assert kept[("crossover",)] == {"jitter_total"}


# ---- trial points without numbers, unstable starts ----


class Cliff:
    """Least of −z − 0.1 log(2 − z), which has no value from two on."""

    start = np.zeros(1)
    lower, upper = np.array([-1.0]), np.array([100.0])
    row_lower = row_upper = row_scale = np.zeros(0)
    row_names = ()

    def __init__(self):
        self.fallen = 0

    def objective(self, value):
        return value

    def objective_slope(self, value):
        return 1.0

    def scaled(self, x):
        return x

    def unscaled(self, z):
        return z

    def __call__(self, z):
        if not z[0] < 2:
            self.fallen += 1
            return None
        value = float(-z[0] - 0.1 * np.log(2 - z[0]))
        return value, np.array([-1 + 0.1 / (2 - z[0])]), np.zeros(0), np.zeros((0, 1))


def test_trial_points_without_numbers_are_stepped_back_from():
    cliff = Cliff()
    found = solve(cliff, Options(tolerance=1e-8))
    assert cliff.fallen > 0, "the test tests nothing: no trial point fell off"
    assert found.status == "optimal"
    assert found.x[0] == pytest.approx(1.9, rel=1e-6)


def test_an_unstable_design_has_no_numbers_in_the_program():
    problem = truss_problem(("jitter_total",), bays=20, percent=2, damping=0.001)
    program = NonlinearProgram(goal(problem).task(), problem.vector({"crossover": 400 * HZ, "kp": 2000.0}))
    assert program(program.scaled(program.start)) is not None
    unstable = problem.vector({"crossover": 100 * HZ})
    assert program(program.scaled(unstable)) is None
    assert "unstable" in program.failure


def test_an_unstable_start_of_a_program_is_an_error_and_not_an_optimum():
    problem = truss_problem(("jitter_total",), bays=20, percent=2, crossover=230 * HZ, damping=0.001)
    with pytest.raises(Exception, match="unstable"):
        NonlinearProgram(goal(problem).task(), problem.start)


@pytest.mark.parametrize("percent", [2.0, 10.0])
def test_an_unstable_start_is_made_stable_and_then_optimized(percent):
    constraint = limit("modulus_margin", lower=0.3)
    problem = truss_problem(
        ("jitter_total",), (constraint,), bays=20, percent=percent, crossover=230 * HZ, damping=0.001
    )
    assert problem.evaluate(problem.start).value("spectral_abscissa") > 0
    stable = stabilize(goal(problem), problem.start, Options())
    assert isinstance(stable, np.ndarray)
    assert problem.evaluate(stable).value("spectral_abscissa") < 0
    found = reach(goal(problem), problem.start, "simultaneous", Options())
    assert found.status == "optimal"
    assert certify(problem, found.x, problem.constraints, problem.objectives[0], goal(problem).free).verified


def test_a_stable_start_is_left_as_it_is():
    problem = truss_problem()
    np.testing.assert_array_equal(stabilize(goal(problem), problem.start, Options()), problem.start)


@pytest.mark.parametrize("free", [[], ["area"]], ids=["nothing free", "too little free"])
def test_a_loop_that_cannot_be_made_stable_says_so(free):
    problem = truss_problem(("jitter_total",), bays=20, percent=10, crossover=230 * HZ, damping=0.001)
    narrow = replace(
        problem.variables[0], lower=problem.start[:2] * (1 - 1e-6), upper=problem.start[:2] * (1 + 1e-6)
    )
    problem = replace(problem, variables=(narrow, *problem.variables[1:]))
    found = reach(goal(problem, free=free), problem.start, "simultaneous", Options())
    assert found.status == "infeasible"
    assert "no stable design found: a pole keeps the real part" in found.reason
    assert not np.isfinite(found.objective), "an unstable design has no jitter"
    assert (found.iterations > 0, found.seconds > 0) == (bool(free), bool(free))


# ---- ends that are no optimum ----


def test_a_stop_ends_the_solve_as_interrupted_with_what_it_has(least_jitter):
    problem, optimum = least_jitter
    asked = iter(range(1000))
    found = reach(goal(problem), problem.start, "simultaneous", TIGHT, lambda: next(asked) >= 5)
    assert (found.status, found.reason) == ("interrupted", "stopped by the user")
    assert len(found.history) == 6
    start = problem.evaluate(problem.start).value("jitter_total")
    assert optimum.objective < found.objective < start


def test_the_history_counts_iterations_and_ends_at_the_optimum(least_jitter):
    problem, found = least_jitter
    steps, objective, violation = (np.array(column) for column in zip(*found.history, strict=True))
    assert steps.tolist() == list(range(found.iterations + 1))
    assert objective[0] == pytest.approx(problem.evaluate(problem.start).value("jitter_total"))
    assert objective[-1] == pytest.approx(found.objective)
    # The start is 1.5 % too heavy.
    assert violation[0] == pytest.approx(20.304761904761904 / 20 - 1, rel=1e-6)
    assert violation[-1] <= 1e-8


def test_an_iteration_limit_is_a_failure_with_its_remedy_and_no_verdict_on_the_constraints():
    problem = mass_limited(19.5)
    found = reach(goal(problem), problem.start, "simultaneous", Options(max_iterations=2))
    assert found.status == "failed"
    assert "raise solve.max_iterations" in found.reason
    assert "conflict" not in found.reason


def test_a_time_limit_is_a_failure_with_its_remedy():
    problem = mass_limited(19.5)
    found = reach(goal(problem), problem.start, "simultaneous", Options(time_limit=1e-3))
    assert found.status == "failed"
    assert "raise solve.time_limit" in found.reason


def test_an_infeasible_problem_names_the_constraints_in_conflict_and_no_other():
    constraints = (
        limit("first_elastic_frequency", lower=300 * HZ),
        limit("structural_mass", upper=19.2),
        limit("modulus_margin", lower=0.3),
    )
    problem = truss_problem(("jitter_total",), constraints)
    found = reach(goal(problem), problem.start, "simultaneous", Options())
    assert found.status == "infeasible"
    assert "constraints conflict" in found.reason
    assert "structural_mass" in found.reason
    assert "first_elastic_frequency" in found.reason
    assert "modulus_margin" not in found.reason


def test_the_least_violation_of_a_conflict_is_stated():
    # The bound asks for half as much again as the most there is.
    problem = truss_problem(("-first_elastic_frequency",))
    most = -reach(goal(problem, free=["area"]), problem.start, "simultaneous", TIGHT).objective
    problem = replace(problem, constraints=(limit("first_elastic_frequency", lower=1.5 * most),))
    found = persist(goal(problem, free=["area"]).task(), problem.start, Options())
    assert found.status == "infeasible"
    assert "misses the bound on first_elastic_frequency by 33.3 % or more" in found.reason
