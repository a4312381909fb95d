"""What proves a bound and what does not: arithmetic, cuts, trees, wrong duals and lying solvers."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from math import isinf

import numpy as np
import pytest
from scipy import sparse
from small_sizings import form, sizing, truss_of, two_inertias

from fosopt.errors import SolverError
from fosopt.relax.arithmetic import Exact, Floating, Magnitude, compensated_product, growth
from fosopt.relax.free_hub import free_hub_floor
from fosopt.relax.least_sizing import Least, least_sizing, prove
from fosopt.relax.multipliers import best_leaf, best_scale
from fosopt.relax.proof import Judge, Leaf, Proof, Split, pairing, quadratic
from fosopt.relax.semidefinite import AGREEMENT, Claim, checked, claimed
from fosopt.relax.sizing import AffineForm, Requirement
from fosopt.relax.structural import structural_part
from fosopt.relax.structure_floor import structure_floor

# ---- arithmetic ----


def test_compensated_products_survive_cancellation():
    rng = np.random.default_rng(0)
    matrix = sparse.csr_array(np.array([[1.0, -1.0, 0.0], [0.1, 0.2, -0.3], [0.0, 0.0, 0.0]]))
    values = 1 + 1e-9 * rng.normal(size=(3, 4))
    exact = Exact().rows(matrix, values)
    found = compensated_product(matrix, values)
    for i, j in np.ndindex(found.shape):
        truth = Fraction(exact[i, j])
        assert abs(Fraction(float(found[i, j])) - truth) <= abs(truth) * Fraction(2) ** -52
    # Plain products lose seven digits here.
    assert np.abs(matrix @ values - found)[:2].max() > 1e-18


def test_the_size_of_terms_bounds_the_rounding_of_their_sum():
    rng = np.random.default_rng(1)
    for _ in range(20):
        rows = sparse.csr_array(rng.normal(size=(30, 6)) * (rng.uniform(size=(30, 6)) < 0.5))
        slope = sparse.csr_array(rng.normal(size=(30, 5)) * 10.0 ** rng.uniform(-8, 8, size=(30, 1)))
        of = AffineForm(rows, rng.normal(size=30), slope)
        u = rng.normal(size=(6, 2))
        exact, floating, size = (pairing(of, u, u, a) for a in (Exact(), Floating(), Magnitude()))
        for e, f, s in zip(exact[1], floating[1], size[1], strict=True):
            assert abs(Fraction(float(f)) - e) <= Fraction(float(growth(40) * s))
        assert abs(Fraction(float(floating[0])) - exact[0]) <= Fraction(float(growth(40) * size[0]))


def test_differences_are_as_large_as_the_sum_of_their_terms():
    stiffness, inertia = form([1.0], [2.0], [[3.0]]), form([1.0], [5.0], [[7.0]])
    requirement = Requirement("both", stiffness, inertia, 2.0, np.array([11.0]), 13.0)
    vector = np.array([[1.0], [-1.0]])
    # 2 + 3 x − 4 (5 + 7 x) + 2·11 + 13 and the same with every sign positive.
    signed, sizes = (quadratic(requirement, vector, vector, a) for a in (Floating(), Magnitude()))
    assert np.hstack(signed).tolist() == [17, -25]
    np.testing.assert_allclose(np.hstack(sizes), [57, 31], rtol=1e-14)


@pytest.mark.parametrize("boundary", ["fixed", "pinned"])
def test_rational_arithmetic_agrees_within_the_allowance(boundary):
    problem = truss_of(boundary, 5)
    floor = structure_floor(problem, problem.constraints, problem.start)
    exact = floor.recomputed(exact=True)
    assert floor.recomputed() == floor.bound.value
    assert 0 <= exact - floor.bound.value <= 2 * floor.bound.allowance
    assert 0 < floor.bound.allowance < 1e-10 * floor.bound.value
    again = structure_floor(problem, problem.constraints, problem.start, exact=True)
    assert (again.bound.value, again.bound.allowance) == (exact, 0.0)


# ---- cuts ----


@pytest.mark.parametrize("boundary", ["fixed", "pinned"])
def test_any_displacements_prove_a_bound_and_none_a_false_one(boundary):
    problem = truss_of(boundary, 3)
    part = structural_part(problem, problem.constraints, problem.start)
    whole = part.sizing
    best = structure_floor(problem, problem.constraints, problem.start)
    rng = np.random.default_rng(7)
    for _ in range(20):
        u = rng.normal(size=(whole.requirements[0].size, 2)) * 10.0 ** rng.uniform(-3, 3)
        if boundary == "fixed":
            value, _ = prove(whole, (np.vstack([u, np.zeros(2)]),)).value(whole)
        else:
            guess = Least(best.sizing.upper, best.sizing.upper, None, (np.vstack([u, np.zeros(2)]),), 0)
            value, _ = free_hub_floor(whole, guess, part.x, 1e-3, 1).proof.value(whole)
        assert value <= best.upper


def test_cuts_of_a_free_hub_hold_for_every_structure_that_is_stiff_enough():
    problem = truss_of("pinned", 3, 0.7)
    part = structural_part(problem, problem.constraints, problem.start)
    requirement = part.sizing.requirements[0]
    assert requirement.rigid is not None
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(requirement.size, 3))
    judge = Judge(part.sizing, directions)
    held = 0
    for _ in range(60):
        x = part.x * rng.uniform(0.3, 3.0, part.x.size)
        s = requirement.matrix(x)
        if requirement.margin(x) < 0:
            continue
        held += 1
        for k, line in enumerate(judge.lines):
            q, p = (float(c + g @ x) for c, g in (line.q, line.p))
            u = directions[:, k]
            np.testing.assert_allclose(
                [q, p], [-requirement.rigid @ s @ u, -requirement.rigid @ s @ requirement.rigid]
            )
            exact = float(u @ s @ u) + q * q / p
            assert exact >= 0
            t = q / p
            for low, high in ((t - 1.0, t + 0.5), (t, t + 1.0), (t - 3.0, t)):
                constant, gradient = line.secant(low, high, Floating())
                assert constant + gradient @ x >= exact * (1 - 1e-9)
            assert float(np.dot(line.side(t - 1e-3, True, Floating())[1], x)) == pytest.approx(
                (q + 1e-3 * p - t * p) - float(line.side(t - 1e-3, True, Floating())[0])
            )
    assert held > 10


def test_the_best_scale_is_that_of_a_fine_grid():
    rng = np.random.default_rng(2)
    for _ in range(50):
        p = 6
        whole = sizing(rng.normal(size=p), lower=0.0, upper=1.0)
        whole = replace(whole, lower=rng.uniform(-1, 0, p), upper=rng.uniform(0, 1, p))
        constant, gradient = float(rng.normal()), rng.normal(size=p)
        scale = best_scale(whole, constant, gradient)

        def bound(xi, whole=whole, constant=constant, gradient=gradient):
            slope = whole.cost - xi * gradient
            return -xi * constant + np.minimum(slope * whole.lower, slope * whole.upper).sum()

        if isinf(scale):
            # Such a cut leaves the box empty: its largest value there is negative.
            assert constant + np.maximum(gradient * whole.lower, gradient * whole.upper).sum() < 0
            continue
        grid = np.linspace(0, 3 * scale + 1, 2001)
        assert bound(scale) >= max(bound(xi) for xi in grid) - 1e-12


# ---- wrong duals and liars ----


@pytest.fixture(scope="module")
def proven():
    problem = truss_of("fixed", 4)
    floor = structure_floor(problem, problem.constraints, problem.start)
    assert isinstance(floor.proof.root, Leaf)
    return problem, floor


@pytest.mark.parametrize("factor", [0.0, 0.5, 0.999, 1.001, 2.0, 1e3, -1.0])
def test_a_wrongly_scaled_dual_proves_less(proven, factor):
    _, floor = proven
    leaf = floor.proof.root
    wrong = replace(leaf, vectors=tuple(factor * v for v in leaf.vectors))
    value, _ = Proof(wrong, floor.proof.directions).value(floor.sizing)
    assert value <= floor.bound.value * (1 + 1e-12)
    if abs(factor) != 1:
        assert value < floor.bound.value * (1 - 1e-5)


def test_an_indefinite_dual_is_cut_down_to_its_positive_part(proven):
    problem, floor = proven
    part = structural_part(problem, problem.constraints, problem.start)
    claim = claimed(part.sizing, part.x)
    _, proof = checked(part.sizing, claim)
    assert proof.value(part.sizing)[0] == pytest.approx(floor.bound.value, rel=AGREEMENT)
    unit = np.sqrt(np.abs(np.diag(claim.duals[0])))
    shift = 0.01 * np.outer(unit, unit) * np.diag(np.where(np.arange(unit.size) % 2, 1.0, -1.0))
    with pytest.raises(SolverError, match="proves"):
        checked(part.sizing, replace(claim, duals=(claim.duals[0] + shift,)))


@pytest.mark.parametrize("factor", [0.9, 0.999])
def test_a_solver_that_calls_an_infeasible_point_solved_is_caught(proven, factor):
    problem, _ = proven
    part = structural_part(problem, problem.constraints, problem.start)
    claim = claimed(part.sizing, part.x)
    with pytest.raises(SolverError, match="misses a requirement"):
        checked(part.sizing, Claim("optimal", factor * claim.x, claim.duals, claim.limits))


def test_a_solver_that_calls_a_poor_point_solved_is_caught(proven):
    problem, _ = proven
    part = structural_part(problem, problem.constraints, problem.start)
    claim = claimed(part.sizing, part.x)
    with pytest.raises(SolverError, match="says 'optimal' at"):
        checked(part.sizing, replace(claim, x=1.01 * claim.x))


def test_multipliers_that_are_none_are_refused(proven):
    _, floor = proven
    leaf, nothing = floor.proof.root, floor.proof.directions
    for wrong, reason in (
        (replace(leaf, limits=np.array([1.0])), "does not fit"),
        (replace(leaf, vectors=(leaf.vectors[0][1:],)), "does not fit"),
        (replace(leaf, vectors=(np.full_like(leaf.vectors[0], np.nan),)), "not finite"),
    ):
        with pytest.raises(SolverError, match=reason):
            Proof(wrong, nothing).value(floor.sizing)


def test_a_negative_multiplier_of_a_linear_limit_is_refused():
    whole = sizing([1.0], normals=np.array([[-1.0]]), limits=np.array([-1e-3]), limit_names=("at least",))
    leaf = best_leaf(whole, ()).leaf
    assert Proof(leaf, np.zeros((0, 0))).value(whole)[0] == pytest.approx(1e-3, rel=1e-12)
    with pytest.raises(SolverError, match="zero or more"):
        Proof(replace(leaf, limits=-leaf.limits), np.zeros((0, 0))).value(whole)


def test_a_piece_of_a_free_hub_takes_no_plain_vectors_and_no_endless_secants():
    whole, _ = two_inertias()
    u = np.array([[1.0], [-1.0]])
    empty = (np.zeros((3, 0)),)
    none = np.zeros(0)
    plain = Leaf((np.array([[1.0], [-1.0], [0.0]]),), none, np.zeros(1), none)
    with pytest.raises(SolverError, match="only secants"):
        Proof(plain, u).value(whole)
    endless = Leaf(empty, none, np.ones(1), none)
    with pytest.raises(SolverError, match="two ends"):
        Proof(endless, u).value(whole)
    one_end = Split(
        0, 0.3, Leaf(empty, none, np.ones(1), np.zeros(1)), Leaf(empty, none, np.zeros(1), np.zeros(1))
    )
    with pytest.raises(SolverError, match="two ends"):
        Proof(one_end, u).value(whole)


def test_a_piece_that_does_not_fit_its_directions_or_sides_is_refused():
    whole, _ = two_inertias()
    u, none, one = np.array([[1.0], [-1.0]]), np.zeros(0), np.zeros(1)
    empty = (np.zeros((3, 0)),)
    fitting = Leaf(empty, none, one, none)
    assert Proof(fitting, u).value(whole)[0] >= 0
    for wrong, directions in (
        (Leaf(empty, none, np.zeros(2), none), u),
        (Leaf(empty, none, one, one), u),
        (Split(1, 0.3, Leaf(empty, none, one, one), Leaf(empty, none, one, one)), u),
        (Split(-1, 0.3, Leaf(empty, none, one, one), Leaf(empty, none, one, one)), u),
        (Split(0, 0.3, fitting, Leaf(empty, none, one, one)), u),
        (fitting, np.vstack([u, u])),
    ):
        for value in (Proof.value, Proof.exact_value):
            with pytest.raises(SolverError, match="does not fit"):
                value(Proof(wrong, directions), whole)


def test_a_structure_that_cannot_turn_takes_no_secants():
    whole = sizing([1.0])
    for secants, sides in ((np.ones(1), np.zeros(0)), (np.zeros(0), np.ones(1))):
        with pytest.raises(SolverError, match="does not fit"):
            Proof(Leaf((), np.zeros(0), secants, sides), np.zeros((0, 0))).value(whole)


def test_a_tree_proves_what_its_worst_piece_does_and_every_structure_lies_in_one_piece():
    problem = truss_of("pinned", 4, mirror_mass=0.0, box=(0.01, 20.0))
    whole = structural_part(problem, problem.constraints, problem.start).sizing
    found = least_sizing(whole, problem.start)
    floor = free_hub_floor(whole, found, found.x, 1e-9, 8)
    judge = Judge(whole, floor.proof.directions)
    leaves = list(floor.proof.leaves())
    assert len(leaves) > 5
    assert floor.proof.value(whole)[0] == min(judge.value(path, leaf)[0] for path, leaf in leaves)
    assert floor.x is not None
    assert 0 <= whole.value(floor.x) - floor.proof.value(whole)[0] < 1e-2 * whole.value(floor.x)
    rng = np.random.default_rng(6)
    lower, upper = problem.bounds
    for _ in range(100):
        x = lower * (upper / lower) ** rng.uniform(size=lower.size)
        t = [(line.q[0] + line.q[1] @ x) / (line.p[0] + line.p[1] @ x) for line in judge.lines]
        assert sum(all((t[k] > at) == above for k, at, above in path) for path, _ in leaves) == 1


def test_a_bound_above_a_design_stops_with_both_numbers(proven):
    _, floor = proven
    with pytest.raises(RuntimeError, match=r"internal error: .* reaches .* below the bound"):
        floor.bound.hold(floor.bound.value * (1 - 1e-9), "a design")


def test_a_proof_above_a_design_that_meets_everything_stops(monkeypatch):
    problem = truss_of("fixed", 4)
    floor = structure_floor(problem, problem.constraints, problem.start)
    assert floor.design is not None
    lighter = 0.99 * floor.design
    monkeypatch.setattr("fosopt.relax.structure_floor.search", lambda *_: (lighter, floor.proof))
    with pytest.raises(
        RuntimeError, match=r"internal error: a structure that meets the requirements reaches \d"
    ):
        structure_floor(problem, problem.constraints, problem.start)
