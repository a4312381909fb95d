"""Lower bounds on structures: closed forms, weak duality, repeated frequencies, free hubs, and wrong duals."""

from __future__ import annotations

from dataclasses import replace
from math import inf, isinf, sqrt
from typing import Any

import numpy as np
import pytest
import small_problems as small
from numpy.typing import NDArray
from reference import DAMPING, square_mast
from small_problems import TIGHT, expressions, goal, limit, truss_problem
from small_sizings import ASKED, CLOSED, FORM, NOTHING, bars_of, form, sizing, truss_of, two_inertias

from fosopt.errors import ModelError
from fosopt.modes import Hub
from fosopt.problem import Problem
from fosopt.relax.energy import outer
from fosopt.relax.free_hub import free_hub_floor
from fosopt.relax.frequency_ceiling import frequency_ceiling
from fosopt.relax.least_sizing import Least, least_sizing, modal_vectors, prove
from fosopt.relax.multipliers import best_leaf
from fosopt.relax.proof import Leaf, Proof
from fosopt.relax.semidefinite import AGREEMENT, semidefinite_proof
from fosopt.relax.sizing import Requirement
from fosopt.relax.structural import Compliance, Receptance, own_requirements, structural_part
from fosopt.relax.structure_floor import structure_floor
from fosopt.solve import Options, reach
from fosopt.structure import assemble

Array = NDArray[np.float64]

# ---- closed forms ----


@pytest.mark.parametrize("bound", [1000.0, 2500.0])
def test_the_lightest_rod_of_a_frequency_is_the_closed_form(bound):
    problem = small.rod_problem(bound)
    area = small.least_rod_area(bound)
    least = problem.evaluate(problem.vector({"area": area})).value("structural_mass")
    floor = structure_floor(problem, problem.constraints, problem.start)
    assert floor.bound.value <= least * (1 + 1e-15)
    assert floor.bound.value == pytest.approx(least, rel=FORM)
    assert floor.design is not None
    assert floor.design[0] == pytest.approx(area, rel=1e-6)


def test_two_bars_in_a_row_share_a_compliance_as_the_closed_form_says():
    # Minimize c·a under f² Σ L/(E a) ≤ γ: a_i = √(e_i/c_i) Σ √(e_j c_j)/γ with e_i = f² L_i/E_i.
    length, young, density = np.array([1.0, 2.0]), np.array([70e9, 200e9]), np.array([2700.0, 7800.0])
    force, allowed = 3e3, 0.5
    cost, energy = density * length, force**2 * length / young
    total = np.sqrt(energy * cost).sum()
    stiffness = form([[1, 0], [-1, 1]], [0, 0], np.diag(young / length))
    work = force * np.array([0.0, 1.0])
    whole = sizing(cost, Requirement("work", stiffness, load=work, limit=allowed))
    best = np.sqrt(energy / cost) * total / allowed
    found = least_sizing(whole, np.full(2, 1e-3))
    assert found.proof is not None
    value, allowance = found.proof.value(whole)
    assert value <= total**2 / allowed * (1 + 1e-15)
    assert value == pytest.approx(total**2 / allowed, rel=FORM)
    assert 0 < allowance < 1e-12 * value
    # At a flat optimum areas are good to the root of the solver's tolerance.
    np.testing.assert_allclose(found.outer, best, rtol=1e-5)


def test_two_crossed_bars_carry_a_mass_at_a_repeated_frequency():
    # Bars at right angles that weigh themselves: M = (m + ρ L (a₁ + a₂)/3) I, so both frequencies meet at the optimum.
    young, density, length, mass, rate = 70e9, 2700.0, 1.0, 10.0, 900.0
    turn = np.array([[1, 1], [1, -1]]) / sqrt(2)
    stiffness = form(turn, [0, 0], np.eye(2) * young / length)
    inertia = form(np.eye(2), [mass, mass], np.full((2, 2), density * length / 3))
    whole = sizing(np.full(2, density * length), Requirement("frequency", stiffness, inertia, rate))
    area = rate**2 * mass / (young / length - 2 * rate**2 * density * length / 3)
    assert whole.requirements[0].margin(np.full(2, area)) == pytest.approx(0, abs=1e-12)
    found = least_sizing(whole, np.array([1e-3, 2e-3]))
    assert found.proof is not None
    assert found.proof.value(whole)[0] == pytest.approx(2 * density * length * area, rel=FORM)
    # One mode alone cannot prove it: the multipliers are a matrix of rank two.
    least = found.proof.value(whole)[0]
    both = np.vstack([turn, np.zeros(2)])
    assert prove(whole, (both[:, [0]],)).value(whole)[0] < 0.9 * least
    assert prove(whole, (both,)).value(whole)[0] == pytest.approx(least, rel=FORM)
    # Any two displacements of the plane do, if the matrix is not diagonal.
    skew = both @ np.array([[1.0, 0.9], [0.3, 1.1]])
    assert Proof(best_leaf(whole, (skew,)).leaf, NOTHING).value(whole)[0] == pytest.approx(least, rel=FORM)


def test_two_free_inertias_need_the_spring_of_the_closed_form():
    whole, least = two_inertias()
    assert whole.requirements[0].margin(np.array([least])) == pytest.approx(0, abs=1e-12)
    found = least_sizing(whole, np.array([50.0]))
    floor = free_hub_floor(whole, found, found.x, 1e-6, 40)
    value, _ = floor.proof.value(whole)
    assert value <= least * (1 + 1e-15)
    assert value == pytest.approx(least, rel=1e-5)


# ---- trusses ----


@pytest.mark.parametrize("boundary", ["fixed", "pinned"])
def test_the_design_of_the_optimizer_is_proven_from_its_own_modes(boundary):
    problem = truss_of(boundary, 20)
    found = reach(goal(problem), problem.start, "simultaneous", TIGHT)
    floor = structure_floor(problem, problem.constraints, found.x)
    assert floor.bound.value <= found.objective
    assert floor.upper == found.objective
    assert floor.gap <= (ASKED if boundary == "fixed" else 1e-4)
    # Over the mass of the bars alone, the rest of which no variable changes.
    bars = float(problem.system.structure.bar_mass_per_area @ found.x)
    assert (found.objective - floor.bound.value) / bars <= (1e-5 if boundary == "fixed" else 1e-2)


@pytest.mark.parametrize(("boundary", "bays"), [("fixed", 20), ("fixed", 60), ("pinned", 20), ("pinned", 60)])
def test_the_relaxation_finds_bound_and_design_without_an_optimizer(boundary, bays):
    problem = truss_of(boundary, bays)
    floor = structure_floor(problem, problem.constraints, problem.start)
    assert 0 <= floor.gap <= (CLOSED if boundary == "fixed" else 1e-4)
    assert floor.design is not None
    reached = problem.evaluate(floor.design)
    assert reached.value("structural_mass") == pytest.approx(floor.upper, rel=1e-13)
    wanted = problem.constraints[0].lower
    assert reached.value("first_elastic_frequency") >= wanted * (1 - 1e-8)


@pytest.mark.parametrize("bays", [4, 8])
def test_a_semidefinite_program_proves_the_same_bound(bays):
    problem = truss_of("fixed", bays)
    part = structural_part(problem, problem.constraints, problem.start)
    x, proof = semidefinite_proof(part.sizing, part.x)
    floor = structure_floor(problem, problem.constraints, problem.start, tolerance=CLOSED)
    assert proof.value(part.sizing)[0] == pytest.approx(floor.bound.value, rel=CLOSED)
    assert part.sizing.value(x) == pytest.approx(floor.upper, rel=CLOSED)


def many_requirements(problem: Problem) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Constraints of every kind that are all at work at the optimum, and requirements that are no metrics."""
    start = problem.evaluate(problem.start)
    inertia = start.value("structure_inertia")
    constraints = (
        *problem.constraints,
        limit("reference_inertia", lower=0.999 * start.value("reference_inertia")),
        limit("structure_inertia", upper=0.999 * inertia),
        limit("area[2]", lower=float(problem.start[1])),
        limit("modulus_margin", lower=0.5),
    )
    return constraints, (Compliance("tip", 4.6e-6), Receptance("tip", 3.0, 5.2e-6))


def test_requirements_of_every_kind_hold_together():
    problem = truss_of("fixed", 5, 0.8)
    constraints, also = many_requirements(problem)
    floor = structure_floor(problem, constraints, problem.start, also=also)
    assert 0 <= floor.gap <= 1e-5
    assert floor.left_out == ("0.5 <= modulus_margin",)
    assert len(floor.kept) == 6
    part = structural_part(problem, constraints, problem.start, also=also)
    _, proof = semidefinite_proof(part.sizing, part.x)
    assert proof.value(part.sizing)[0] == pytest.approx(floor.bound.value, rel=AGREEMENT)
    # Each is at work: without it the bound is lower.
    for dropped in range(6):
        fewer = [c for k, c in enumerate(constraints[:4]) if k != dropped]
        rest = [a for k, a in enumerate(also) if k + 4 != dropped]
        weaker = structure_floor(problem, fewer, problem.start, also=rest)
        assert weaker.bound.value <= floor.bound.value * (1 + 1e-9)


def test_receptance_and_compliance_are_those_of_the_matrices():
    problem = truss_of("fixed", 3)
    rate, allowed = 20.0, 3.0e-6
    part = structural_part(
        problem, (), problem.start, also=(Compliance("tip", allowed), Receptance("tip", rate, allowed))
    )
    evaluation = problem.evaluate(problem.start)
    modes = evaluation.frame.modal_set(Hub("fixed"), DAMPING, ("tip",))
    squares = modes.at("tip") ** 2
    for requirement, at in zip(part.sizing.requirements, (0.0, rate), strict=True):
        value = float(np.sum(squares / (modes.natural_frequency**2 - at**2)))
        assert requirement.margin(part.x) == pytest.approx(1 - value / allowed, rel=1e-6)
    assert part.sizing.margin(part.x) == min(r.margin(part.x) for r in part.sizing.requirements)


@pytest.mark.parametrize("stretch", [1.0, 1.3], ids=["square", "flat"])
def test_a_mast_that_bends_alike_in_two_directions_is_proven(stretch):
    problem = bars_of(assemble(square_mast(4, stretch), "tip"), 0.9, mirror_mass=5.0, box=(0.1, 5.0))
    floor = structure_floor(problem, problem.constraints, problem.start)
    assert 0 <= floor.gap <= ASKED
    assert floor.design is not None
    frequency = np.sqrt(problem.evaluate(floor.design).frame.eigenvalue[:2])
    assert frequency[1] == pytest.approx(frequency[0], rel=1e-4)
    # From the modes of that design too: two of them, with a matrix of multipliers.
    part = structural_part(problem, problem.constraints, floor.design)
    vectors = modal_vectors(part.sizing, part.x)
    assert vectors[0].shape[1] == 2
    assert prove(part.sizing, vectors).value(part.sizing)[0] >= floor.bound.value * (1 - 1e-3)


# ---- weak duality ----


@pytest.mark.parametrize("boundary", ["fixed", "pinned"])
def test_no_random_design_that_meets_the_requirements_is_lighter(boundary):
    problem = truss_of(boundary, 4, 0.9)
    start = problem.evaluate(problem.start)
    constraints = (*problem.constraints, limit("reference_inertia", lower=start.value("reference_inertia")))
    floor = structure_floor(problem, constraints, problem.start)
    rng = np.random.default_rng(5)
    lower, upper = problem.bounds
    met = 0
    assert floor.design is not None
    for share in np.linspace(0.02, 1, 150):
        x = np.clip(floor.design * rng.uniform(1 - share / 2, 1 + 2 * share, lower.size), lower, upper)
        design = problem.evaluate(x)
        if all(design.value(c.name) >= c.lower for c in constraints):
            met += 1
            assert design.value("structural_mass") >= floor.bound.value
    assert met > 30


def test_branch_and_bound_finds_the_structure_itself_from_a_poor_one():
    problem = truss_of("pinned", 4)
    whole = structural_part(problem, problem.constraints, problem.start).sizing
    poor = 2 * problem.start
    modes = Least(poor, poor, None, modal_vectors(whole, poor), 0)
    floor = free_hub_floor(whole, modes, poor, 1e-4, 12)
    best = least_sizing(whole, problem.start)
    assert best.x is not None and floor.x is not None
    assert whole.value(poor) > 1.05 * whole.value(best.x)
    assert whole.value(floor.x) == pytest.approx(whole.value(best.x), rel=1e-6)
    assert 0 <= whole.value(floor.x) - floor.proof.value(whole)[0] <= 1e-4 * whole.value(floor.x)


# ---- what no structure does, and boxes without end ----


@pytest.mark.parametrize("boundary", ["fixed", "pinned"])
def test_a_frequency_that_no_structure_reaches_is_proven_to_be_one(boundary):
    problem = truss_of(boundary, 4, 3.0)
    floor = structure_floor(problem, problem.constraints, problem.start)
    assert isinf(floor.bound.value)
    assert floor.bound.of.endswith("no structure in the box does")
    assert (floor.design, floor.upper) == (None, inf)
    assert isinf(floor.recomputed())
    assert isinf(floor.recomputed(exact=True))
    for _, leaf in floor.proof.leaves():
        assert leaf.ray
    # The certificate is one: for a frequency that some structure reaches it proves nothing.
    slower = tuple(replace(r, rate=r.rate / 4) for r in floor.sizing.requirements)
    assert floor.proof.value(replace(floor.sizing, requirements=slower))[0] == -inf


def test_requirements_that_contradict_each_other_are_proven_to_do_so():
    problem = truss_of("fixed", 4)
    inertia = problem.evaluate(problem.start).value("structure_inertia")
    constraints = (*problem.constraints, limit("structure_inertia", upper=0.5 * inertia))
    floor = structure_floor(problem, constraints, problem.start)
    assert isinf(floor.bound.value)
    assert isinf(floor.recomputed(exact=True))


def test_the_stiffest_structure_of_the_box_is_still_found():
    problem = truss_of("fixed", 3)
    ceiling = frequency_ceiling(problem, problem.start, limit=1e6)
    assert ceiling.reached == pytest.approx(ceiling.value, rel=1e-5)
    below = (limit("first_elastic_frequency", lower=ceiling.reached * (1 - 1e-6)),)
    assert np.isfinite(structure_floor(problem, below, problem.start).bound.value)
    above = (limit("first_elastic_frequency", lower=ceiling.value),)
    assert isinf(structure_floor(problem, above, problem.start).bound.value)


def test_a_box_without_upper_bounds_is_proven_where_areas_cost():
    problem = truss_of("fixed", 4)
    part = structural_part(problem, problem.constraints, problem.start)
    endless = replace(part.sizing, upper=np.full_like(part.sizing.upper, inf))
    found = least_sizing(endless, part.x)
    assert found.proof is not None
    value, _ = found.proof.value(endless)
    leaf = found.proof.root
    assert isinstance(leaf, Leaf)
    # A little more of the same, and one more area would pay without end.
    greedy = Proof(replace(leaf, vectors=(1.0001 * leaf.vectors[0],)), NOTHING)
    assert greedy.value(endless)[0] == greedy.exact_value(endless) == -inf
    boxed = structure_floor(problem, problem.constraints, problem.start)
    assert value <= boxed.bound.value * (1 + 1e-9)
    assert value == pytest.approx(endless.value(found.outer), rel=1e-6)
    assert found.proof.exact_value(endless) >= value


def test_a_box_without_upper_bounds_is_refused_where_areas_are_free():
    with pytest.raises(ModelError, match=r"'a1' has no upper bound and costs nothing"):
        sizing([0.0], upper=inf)


def test_an_empty_box_is_refused():
    with pytest.raises(ModelError, match=r"'a1': no value lies between 0\.01 and 1e-06"):
        sizing([1.0], lower=1e-2, upper=1e-6)


def test_two_frequencies_of_a_free_hub_are_refused():
    whole, _ = two_inertias()
    with pytest.raises(ModelError, match="keep the higher one"):
        replace(whole, requirements=whole.requirements * 2)


def test_an_outer_approximation_is_never_above_the_least_cost():
    problem = truss_of("fixed", 4)
    floor = structure_floor(problem, problem.constraints, problem.start)
    part = structural_part(problem, problem.constraints, problem.start)
    rng = np.random.default_rng(4)
    for _ in range(10):
        guess = rng.normal(size=(part.sizing.requirements[0].size, 1))
        found = outer(part.sizing, (guess,), part.x)
        assert found.x is not None
        assert part.sizing.value(found.x) <= floor.upper


# ---- reading a problem ----


def test_constraints_of_the_loop_are_left_out_and_named():
    problem = truss_problem(("structural_mass",), bays=3)
    constraints = (
        limit("first_elastic_frequency", lower=100.0, upper=1000.0),
        limit("jitter_total", upper=1e-5),
        limit("structural_mass / 2", upper=100.0),
        limit("structural_mass", upper=50.0),
        limit("area[1]", lower=5e-5),
    )
    floor = structure_floor(problem, constraints, problem.start)
    assert floor.kept == ("100 rad/s <= first_elastic_frequency", "5e-05 m^2 <= area[1]")
    assert floor.left_out == (
        "first_elastic_frequency <= 1000 rad/s",
        "jitter_total <= 1e-05 rad",
        "structural_mass / 2 <= 100",
        "structural_mass <= 50 kg",
    )
    assert any("jitter_total" in said for said in floor.bound.assumptions)
    assert floor.bound.of.startswith(
        "structural_mass of every structure in the box that meets: 100 rad/s <= first"
    )


def test_a_floor_needs_an_objective_that_is_linear():
    problem = truss_of("fixed", 3)
    with pytest.raises(ModelError, match="did you mean 'structural_mass'"):
        structure_floor(problem, (), problem.start, "structural_mas")


def test_a_port_that_does_not_move_has_no_compliance():
    problem = truss_of("pinned", 3)
    with pytest.raises(ModelError, match="'hub': the port does not move"):
        structure_floor(problem, (), problem.start, also=(Compliance("hub", 1e-6),))


def test_a_problem_without_structural_variables_has_its_own_mass_as_floor():
    problem = truss_problem(("structural_mass",), bays=3)
    fixed = replace(problem, variables=problem.variables[1:])
    own = fixed.evaluate(fixed.start).value("structural_mass")
    possible = structure_floor(fixed, (limit("first_elastic_frequency", lower=100.0),), fixed.start)
    assert possible.bound.value == pytest.approx(own, rel=1e-12)
    impossible = structure_floor(fixed, (limit("first_elastic_frequency", lower=1e4),), fixed.start)
    assert isinf(impossible.bound.value)


def test_a_design_that_misses_by_rounding_is_never_below_its_bound():
    problem = truss_of("fixed", 10)
    found = reach(goal(problem), problem.start, "simultaneous", Options(tolerance=1e-6))
    wanted = problem.constraints[0].lower
    for missed in (0.0, 1e-9, 5e-7):
        asked = (limit("first_elastic_frequency", lower=wanted * (1 + missed)),)
        floor = structure_floor(problem, asked, found.x, tolerance=CLOSED)
        floor.bound.hold(problem.evaluate(found.x).value("structural_mass"), "the design")
        assert floor.upper <= found.objective
        (asking,) = floor.sizing.requirements
        assert asking.margin(found.x) >= -1e-11
    far = structure_floor(problem, (limit("first_elastic_frequency", lower=wanted * 1.01),), found.x)
    assert far.bound.value > found.objective


def test_a_limit_that_a_design_misses_by_rounding_is_that_of_the_design():
    problem = truss_of("fixed", 4)
    inertia = problem.evaluate(problem.start).value("structure_inertia")
    for missed, misses in ((5e-7, ()), (1e-3, ("structure_inertia",))):
        asked = limit("structure_inertia", upper=inertia * (1 - missed))
        part = structural_part(problem, (asked,), problem.start)
        assert [said.split()[0] for said in part.misses] == list(misses)
        (row,) = part.sizing.limits - part.sizing.normals @ part.x
        assert row == pytest.approx(-missed * inertia if misses else 0.0, abs=1e-12 * inertia)


def test_a_structure_as_stiff_as_a_design_may_be_lighter():
    problem = truss_of("pinned", 5)
    asked = own_requirements(problem, problem.start, ("first_elastic_frequency", "reference_inertia"))
    floor = structure_floor(problem, asked, problem.start)
    own = problem.evaluate(problem.start).value("structural_mass")
    assert floor.bound.value < floor.upper < own
    assert floor.gap < 1e-3


# ---- the highest frequency ----


@pytest.mark.parametrize("boundary", ["fixed", "pinned"])
def test_no_structure_of_a_mass_reaches_a_higher_frequency(boundary):
    problem = truss_of(boundary, 5)
    mass = problem.evaluate(problem.start).value("structural_mass")
    ceiling = frequency_ceiling(problem, problem.start)
    assert ceiling.limit == mass
    assert ceiling.recomputed()
    assert ceiling.recomputed(exact=True)
    assert ceiling.design is not None
    reached = problem.evaluate(ceiling.design)
    assert reached.value("structural_mass") <= mass
    assert reached.value("first_elastic_frequency") == pytest.approx(ceiling.reached, rel=1e-8)
    assert 0 <= 1 - ceiling.reached / ceiling.value <= (1e-5 if boundary == "fixed" else 1e-2)
    # IPOPT maximizes the same frequency and stays below.
    maximal = replace(
        problem,
        objectives=expressions("-first_elastic_frequency"),
        constraints=(limit("structural_mass", upper=mass),),
    )
    found = reach(goal(maximal), maximal.start, "simultaneous", Options(tolerance=1e-7))
    best = maximal.evaluate(found.x).value("first_elastic_frequency")
    assert best <= ceiling.value * (1 + 1e-8)
    assert best >= ceiling.reached * (1 - 1e-5)


def test_the_relaxed_start_saves_the_optimizer_iterations():
    problem = truss_of("fixed", 20)
    cold = reach(goal(problem), problem.start, "simultaneous", TIGHT)
    floor = structure_floor(problem, problem.constraints, problem.start)
    assert floor.design is not None
    warm = reach(goal(problem), floor.design, "simultaneous", TIGHT)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-7)
    assert warm.iterations < cold.iterations
