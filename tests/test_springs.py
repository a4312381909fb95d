"""Springs to ground as parameters of a design: matrices, frequencies in closed form, variables, the judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
from small_problems import expressions, variable

from fosopt.certify import certify
from fosopt.errors import ModelError
from fosopt.modes import Hub, modal_frame
from fosopt.problem import Design, Evaluation, Problem, System, system
from fosopt.structure import (
    Bar,
    Batten,
    PointMass,
    Spring,
    Structure,
    Truss,
    assemble,
    barker_truss,
    stiffness_matrix,
)

TABLE = reference.structure("table", 3)
INERTIA, TURNING, YOUNG, AREA, LENGTH, MASS = 0.4, 360.0, 70e9, 1e-4, 2.0, 3.0
# The judge takes a banded disturbance through the dynamic stiffness.
IN_A_BAND = replace(reference.DISTURBANCES[1], band=(1.0, 3000.0))
# Bars without mass of their own leave a point mass on a spring.
LIGHT = 1e-9


def two_oscillators() -> Structure:
    """A batten that turns on a spring, and beside it a mass on a bar with a spring in parallel."""
    truss = Truss(
        {"A": (0.0, 0.0), "B": (1.0, 0.0), "C": (1.0 + LENGTH, 0.0)},
        (Bar("bar", ("B", "C"), AREA, YOUNG, LIGHT),),
        {"hub": ("S", "rz"), "tip": ("S", "rz")},
        {"S": ("x", "y"), "B": ("y",), "C": ("x", "y")},
        (Batten("S", ("A",), 2.0, INERTIA),),
        (PointMass("B", MASS),),
        (Spring("S", "rz", TURNING), Spring("B", "x", 5e6, "anchor")),
    )
    return assemble(truss, "tip")


def table_problem(*springs: str) -> Problem:
    """The truss on its root table under a mirror; the named springs may vary by a factor of ten each way."""
    system, base = reference.system_and_design(
        boundary="table", bays=3, hub=Hub("free"), step=None, disturbances=(IN_A_BAND,)
    )
    names = [spring.name for spring in TABLE.truss.springs]
    at = [names.index(name) for name in springs]
    start = base.spring_stiffness[at]
    groups = tuple((i,) for i in at)
    free = variable("table", 0.1 * start, 10 * start, start, "spring_stiffness", groups=groups)
    return Problem(system, base, (free,), expressions("first_elastic_frequency"))


def test_a_spring_is_named_after_its_place_unless_it_has_a_name() -> None:
    assert [spring.name for spring in two_oscillators().truss.springs] == ["S.rz", "anchor"]
    assert replace(Spring("S", "rz", 1.0), stiffness=2.0).name == "S.rz"


def test_each_spring_stiffens_its_own_degree_of_freedom_and_nothing_else() -> None:
    given = np.array([3.0e6, 5.0e6, 7.0e6])
    bare = stiffness_matrix(TABLE, TABLE.area, np.zeros(3))
    added = stiffness_matrix(TABLE, TABLE.area, given) - bare
    expected = np.zeros_like(added)
    for spring, stiffness in zip(TABLE.truss.springs, given, strict=True):
        at = TABLE.dofs.index(f"{spring.at}.{spring.component}")
        expected[at, at] = stiffness
    assert np.abs(added - expected).max() <= 1e-13 * np.abs(bare).max()


def test_springs_keep_the_stiffness_of_the_truss_where_none_is_given() -> None:
    own = TABLE.spring_stiffness
    assert own.tolist() == [spring.stiffness for spring in barker_truss("table").springs]
    assert np.array_equal(stiffness_matrix(TABLE, TABLE.area), stiffness_matrix(TABLE, TABLE.area, own))
    sizes = TABLE.area, TABLE.batten_mass, 0.0, "tip"
    assert np.array_equal(modal_frame(TABLE, *sizes).eigenvalue, modal_frame(TABLE, *sizes, own).eigenvalue)


def test_frequencies_on_springs_and_their_slopes_are_those_of_the_closed_form() -> None:
    of = two_oscillators()
    loop = reference.loop_of(reference.mirror_of(reference.structure(), 0.02))
    turning, anchor = 900.0, 2e6
    design = Design(of.area, of.batten_mass, np.array([turning, anchor]), 0.0, loop)
    found = Evaluation(System(of, "tip", Hub("free"), reference.DAMPING), design)
    springs = slice(of.area.size + of.batten_mass.size, -8)
    for index, stiffness, mass, own in (
        (1, turning, INERTIA, [1.0, 0.0]),
        (2, YOUNG * AREA / LENGTH + anchor, MASS, [0.0, 1.0]),
    ):
        value, gradient = found.metric("structure_frequency", index)
        # The bar weighs 1e-10 of the mass it carries.
        assert value == pytest.approx((stiffness / mass) ** 0.5, rel=1e-9, abs=0)
        slope = 1 / (2 * value * mass) * np.array(own)
        assert np.abs(gradient[springs] - slope).max() <= 1e-9 * slope.max()


def test_a_design_is_the_vector_of_its_parameters_and_back() -> None:
    _, design = reference.system_and_design(boundary="table", bays=3, seed=2)
    parts = (design.area, design.batten_mass, design.spring_stiffness)
    assert design.spring_stiffness.size == 3
    assert np.array_equal(design.parameters[:-8], np.concatenate(parts))
    again = design.with_parameters(design.parameters)
    assert np.array_equal(again.spring_stiffness, design.spring_stiffness)
    assert again.loop == design.loop
    assert again.mirror_mass == design.mirror_mass


def test_a_variable_sets_its_springs_and_leaves_the_others_alone() -> None:
    problem = table_problem("B0.rz", "B0.x")
    design = problem.design(np.array([7.0e6, 9.0e7]))
    x, y, turning = design.spring_stiffness
    assert (x, turning) == (9.0e7, 7.0e6)
    assert y == problem.base.spring_stiffness[1]
    assert np.array_equal(design.batten_mass, problem.base.batten_mass)


@pytest.mark.parametrize("value", [-1.0, np.nan])
def test_a_spring_of_negative_or_unknown_stiffness_is_refused(value: float) -> None:
    with pytest.raises(ModelError, match=r"spring_stiffness: .* is negative or not a number"):
        modal_frame(TABLE, TABLE.area, TABLE.batten_mass, 0.0, "tip", np.array([1e6, value, 1e6]))


def test_the_judge_knows_the_springs_of_the_design(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = table_problem("B0.y")
    x = 2 * problem.start
    assert certify(problem, x, ()).verified
    right = system.modal_frame
    monkeypatch.setattr(system, "modal_frame", lambda *given: right(*given[:5]))
    wrong = certify(problem, x, ())
    assert not wrong.verified
    assert any(reason.startswith("modes: residual") for reason in wrong.reasons)
