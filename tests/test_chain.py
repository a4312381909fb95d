"""Chains of bodies and springs against closed forms and the dissertation's benchmark problem."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest
import reference

from fosopt.control import closed_loop_poles
from fosopt.errors import ModelError
from fosopt.modes import Damping, Hub, modal_frame
from fosopt.structure import Chain, assemble_chain, structural_mass, structure_inertia, two_body_stiffness

# A few operations on numbers that are known to rounding, squared frequencies of one magnitude.
ROUNDING = 1e-13
NONE = np.zeros(0)


def frame(chain, mirror_mass=0.0):
    return modal_frame(assemble_chain(chain), NONE, NONE, mirror_mass, "tip")


def test_two_free_bodies_swing_at_the_frequency_their_spring_was_chosen_for():
    stiffness = two_body_stiffness(30.0, 0.2, 0.7)
    assert stiffness == pytest.approx(30.0**2 / (1 / 0.2 + 1 / 0.7), rel=1e-15)
    found = frame(Chain({"a": 0.2, "b": 0.7}, (stiffness,)))
    assert found.n_rigid == 1
    assert np.sqrt(found.eigenvalue) == pytest.approx([0.0, 30.0], rel=ROUNDING)
    # Momentum is kept: J₁ φ₁ + J₂ φ₂ = 0 in the elastic mode.
    assert np.array([0.2, 0.7]) @ found.shapes[:, 1] == pytest.approx(0.0, abs=ROUNDING)


def test_three_equal_free_bodies_have_the_textbook_frequencies():
    found = frame(Chain({"a": 2.0, "b": 2.0, "c": 2.0}, (50.0, 50.0)))
    assert found.eigenvalue == pytest.approx([0.0, 25.0, 75.0], rel=ROUNDING)
    shape = found.shapes[:, 2] / found.shapes[0, 2]
    assert shape == pytest.approx([1.0, -2.0, 1.0], rel=ROUNDING)


@pytest.mark.parametrize("held", [False, True])
def test_three_unequal_bodies_have_the_roots_of_their_quadratic(held):
    j1, j2, j3, k1, k2 = 0.3, 1.1, 0.5, 40.0, 90.0
    found = frame(Chain({"a": j1, "b": j2, "c": j3}, (k1, k2), held))
    if held:
        sum_, product = (k1 + k2) / j2 + k2 / j3, k1 * k2 / (j2 * j3)
    else:
        sum_ = k1 * (1 / j1 + 1 / j2) + k2 * (1 / j2 + 1 / j3)
        product = k1 * k2 * (j1 + j2 + j3) / (j1 * j2 * j3)
    half = np.sqrt(sum_**2 / 4 - product)
    assert found.eigenvalue[-2:] == pytest.approx([sum_ / 2 - half, sum_ / 2 + half], rel=ROUNDING)
    assert found.eigenvalue.size == (2 if held else 3)
    assert found.n_rigid == (0 if held else 1)


def test_every_body_is_a_port_and_the_ends_are_hub_and_tip():
    chain = Chain({"aft": 1.0, "mid": 2.0, "bench": 3.0}, (1.0, 1.0))
    free = assemble_chain(chain)
    assert free.dofs == ("aft.rz", "mid.rz", "bench.rz")
    assert {name: row.tolist() for name, row in free.ports.items()} == {
        "aft": [1, 0, 0],
        "mid": [0, 1, 0],
        "bench": [0, 0, 1],
        "hub": [1, 0, 0],
        "tip": [0, 0, 1],
    }
    held = assemble_chain(Chain(chain.inertias, chain.springs, held=True))
    assert held.dofs == ("mid.rz", "bench.rz")
    assert held.ports["hub"].tolist() == held.ports["aft"].tolist() == [0, 0]
    assert held.ports["tip"].tolist() == [0, 1]
    assert held.truss.ports["hub"] == ("aft", "rz") and held.truss.ports["tip"] == ("bench", "rz")
    # The ends may bear the names of their ports.
    assert assemble_chain(Chain({"hub": 1.0, "tip": 2.0}, (1.0,))).ports["tip"].tolist() == [0, 1]


@pytest.mark.parametrize("held", [False, True])
def test_the_inertia_about_the_hub_is_the_sum_and_nothing_has_mass(held):
    structure = assemble_chain(Chain({"a": 0.25, "b": 0.5, "c": 2.0}, (1.0, 1.0), held))
    assert structure_inertia(structure, NONE, NONE) == 2.75
    assert structural_mass(structure, NONE, NONE) == 0.0


def test_the_mirrors_mass_moves_nothing():
    chain = Chain({"a": 0.3, "b": 1.1}, (40.0,))
    assert np.array_equal(frame(chain, 0.0).eigenvalue, frame(chain, 1e6).eigenvalue)


# ---- the benchmark problem ----


def test_receptances_of_two_bodies_are_those_of_the_dissertation():
    m1, m2, ratio, w = 0.3, 0.14, 0.02, 30.0
    total = m1 + m2
    structure = frame(Chain({"first": m1, "second": m2}, (two_body_stiffness(w, m1, m2),)))
    modes = structure.modal_set(Hub(), Damping((ratio,)), ("hub", "tip"))
    s = np.array([0.3 + 2j, -5 + 30j, 31j, 400j])
    below = total * s**2 * (s**2 + 2 * ratio * w * s + w**2)
    # Eqs. (3.18) and (3.19); the second one pushes the second mass the other way.
    cross = (2 * ratio * w * s + w**2) / below
    direct = (total / m2 * s**2 + 2 * ratio * w * s + w**2) / below
    assert modes.receptance(s, "tip", "hub") == pytest.approx(cross, rel=1e-11, abs=0)
    assert modes.receptance(s, "tip", "tip") == pytest.approx(direct, rel=1e-11, abs=0)


@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_the_chain_is_the_modified_benchmark_problem(case):
    given = reference.DISSERTATION["chapter_3"]
    loop, expected = reference.benchmark(case)
    m, w = given["end_mass"], given["structure_frequency"][case - 1] * reference.HZ
    structure = frame(Chain({"aft": m, "bench": m}, (two_body_stiffness(w, m, m),)))
    modes = structure.modal_set(Hub(), Damping((given["zeta_structure"],)), ("hub", "tip"))
    assert modes.natural_frequency == pytest.approx(expected.natural_frequency, rel=ROUNDING)
    assert np.abs(modes.mode_shape) == pytest.approx(np.abs(expected.mode_shape), rel=ROUNDING)
    stable = closed_loop_poles(loop, modes, "tip").spectral_abscissa < 0
    assert stable == (f"case_{case}" not in reference.DISSERTATION["table_3_4"]["unstable"])


# ---- refusals ----


@pytest.mark.parametrize(
    ("inertias", "springs", "message"),
    [
        ({"a": 1.0}, (), "1 bodies; give two or more"),
        ({"a": 1.0, "b": 1.0}, (), "2 bodies need 1 springs, one between each two neighbors; 0 given"),
        (
            {"a": 1.0, "b": 1.0},
            (1.0, 1.0),
            "2 bodies need 1 springs, one between each two neighbors; 2 given",
        ),
        ({"a": 1.0, "b": 0.0}, (1.0,), "body 'b': inertia 0.0 is not above zero"),
        ({"a": nan, "b": 1.0}, (1.0,), "body 'a': inertia nan is not above zero"),
        ({"a": 1.0, "b": 1.0}, (-1.0,), "between 'a' and 'b': stiffness -1.0 is not above zero"),
        ({"a": 1.0, "b": 1.0}, (inf,), "between 'a' and 'b': stiffness inf is not above zero"),
        ({"a": 1.0, "hub": 1.0}, (1.0,), "body 'hub': this is the port at the first body"),
        ({"tip": 1.0, "b": 1.0}, (1.0,), "body 'tip': this is the port at the last body"),
    ],
)
def test_a_chain_that_physics_or_its_names_do_not_allow_is_refused(inertias, springs, message):
    with pytest.raises(ModelError, match=message):
        Chain(inertias, springs)


def test_an_unknown_port_is_refused_with_the_nearest_one():
    with pytest.raises(ModelError, match="port 'bensh' does not exist; did you mean 'bench'"):
        assemble_chain(Chain({"aft": 1.0, "bench": 1.0}, (1.0,)), "bensh")
