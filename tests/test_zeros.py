"""Zeros of modal expansions, of the reaction mirror and of the coupled plant in any placement."""

from __future__ import annotations

import control
import numpy as np
import pytest
import reference
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import linalg

from fosopt.actuators import Mirror, MirrorReactionMass, Placement, ReactionMassActuator
from fosopt.control import PID, Loop, modal_matrices, plant_state_space
from fosopt.control.loop import sensor_gain
from fosopt.errors import ModelError
from fosopt.metrics.functional import LoopModel
from fosopt.modes import Damping, Hub, ModalSet
from fosopt.plant import (
    ModalExpansion,
    coupled_expansion,
    coupled_modes,
    expansion_zeros,
    mirror_zeros,
    modal_expansion,
    modal_poles,
    plant_zeros,
    quadratic_roots,
)
from fosopt.plant.interlacing import falling_roots
from fosopt.structure import mass_matrix, stiffness_matrix

HZ = reference.HZ
FREE, HELD = Hub("free"), Hub("held", 0.1 * HZ, 0.0)


@pytest.fixture(scope="module")
def stations():
    """The pinned truss with a port at every batten."""
    return reference.stations()


def modes_of(frame, ratio=0.0, hub=FREE):
    return frame.modal_set(hub, Damping((ratio,)), (*reference.PORTS, *reference.STATIONS))


def expansion(frequency, ratio, residue):
    frequency, residue = np.array(frequency, float), np.array(residue, float)
    return ModalExpansion(frequency, np.broadcast_to(ratio, frequency.shape), residue, frequency == 0)


def loop(mirror, *place, **given):
    return Loop(mirror, PID(1.0, 1.0, 1.0, 1.0), *place, **given)


def roots_of_numerator(of):
    """Zeros of a small expansion by its polynomial, for residues that are not close to cancelling."""
    factors = [np.array([1.0, c, k]) for c, k in zip(of.damping, of.stiffness, strict=True)]
    total = np.zeros(2 * len(factors) - 1)
    for k, r in enumerate(of.residue):
        product = np.array([r])
        for other, factor in enumerate(factors):
            product = np.convolve(product, factor) if other != k else product
        total += product
    return np.roots(total)


def same(found, expected, rel):
    assert found.size == expected.size
    assert reference.worst_match(found, expected) < rel


def assert_closed_and_ordered(zeros):
    """Conjugates of every zero are there, and sizes ascend."""
    assert np.all(np.diff(np.abs(zeros)) >= -1e-12 * np.abs(zeros[1:]))
    for zero in zeros:
        assert np.count_nonzero(zeros == zero) == np.count_nonzero(zeros == zero.conjugate())


# ------------------------------------------------------------------------------------------------ expansions


def test_quadratic_roots_are_right_where_the_school_formula_cancels_or_divides_by_zero():
    a, b, c = np.array([[1, 1e9, 1], [1, -1e9, 1], [0, 2, 6], [0, 0, 3], [1, 0, 4], [-1, 0, 4], [2, 0, 0]]).T
    found = quadratic_roots(a, b, c)
    assert found[0] == pytest.approx([-1e9, -1e-9], rel=1e-15, abs=0)
    assert found[1] == pytest.approx([1e9, 1e-9], rel=1e-15, abs=0)
    assert np.isinf(found[2, 0])
    assert found[2, 1] == -3
    assert np.all(np.isinf(found[3]))
    assert np.array_equal(found[4], [2j, -2j])
    assert np.signbit(found[4].real).tolist() == [False, False]
    assert sorted(found[5].real) == [-2, 2]
    assert np.array_equal(found[6], [0, 0])


# Frequencies apart by their gaps, residues of either sign and away from zero.
@given(
    st.lists(
        st.tuples(st.floats(0.3, 20), st.floats(0.05, 3), st.sampled_from([-1, 1])), min_size=2, max_size=5
    ),
    st.sampled_from([0.0, 0.01, 0.3]),
)
def test_zeros_of_small_expansions_are_roots_of_the_numerator_polynomial(modes, ratio):
    gap, size, sign = np.array(modes).T
    frequency, residue = 0.2 + np.cumsum(gap), size * sign
    assume(abs(residue.sum()) > 0.05)
    of = expansion(frequency, ratio, residue)
    found, expected = expansion_zeros(of), roots_of_numerator(of)
    assert_closed_and_ordered(found)
    assert found.size == expected.size == 2 * len(modes) - 2
    # A zero that is nearly double is right to the root of the polynomial's rounding only: the equation judges.
    terms = of.residue / (found[:, None] ** 2 + of.damping * found[:, None] + of.stiffness)
    slope = np.abs(np.sum(terms**2 / of.residue * (2 * found[:, None] + of.damping), axis=1))
    assert np.all(
        np.abs(terms.sum(axis=1)) < 1e-13 * np.abs(terms).sum(axis=1) + 1e-14 * slope * np.abs(found)
    )
    assert reference.worst_match(found, expected) < 1e-4


def test_collocated_zeros_interlace_the_poles_and_are_the_modes_with_that_port_held(stations):
    modes = modes_of(stations)
    of = stations.structure
    row = of.port("r7")
    K, M = stiffness_matrix(of, of.area), mass_matrix(of, of.area, of.batten_mass, reference.MIRROR_MASS)
    free = linalg.null_space(row[None, :])
    held = linalg.eigh(free.T @ K @ free, free.T @ M @ free, eigvals_only=True)
    found = expansion_zeros(modal_expansion(modes, "r7", "r7"))
    assert np.array_equal(found.real, np.zeros(found.size))
    upper = found.imag[found.imag > 0]
    assert np.all((modes.natural_frequency[:-1] < upper) & (upper < modes.natural_frequency[1:]))
    # eigh errs by rounding of the largest eigenvalue.
    assert upper**2 == pytest.approx(held, rel=0, abs=1e-12 * held[-1])


def test_the_distance_of_a_zero_from_its_pole_has_full_relative_accuracy_however_small():
    # Two poles: the root is λ1 + w1 (λ2 − λ1)/(w1 + w2).
    for weak in (1e-3, 1e-13, 1e-30):
        poles, weight = np.array([3.0, 7.0]), np.array([weak, 2.0])

        def terms(base, distance, own, poles=poles, weight=weight):
            gap = (poles - base[:, None]) - distance[:, None]
            rows = np.flatnonzero(own >= 0)
            gap[rows, own[rows]] = np.inf
            strength = np.where(own >= 0, weight[own], 0.0)
            return -(weight / gap).sum(axis=1), -(weight / gap**2).sum(axis=1), strength, np.zeros(1)

        base, distance = falling_roots(poles[:1], poles[1:], np.array([0]), np.array([1]), terms)
        assert base[0] == 3.0
        assert distance[0] == pytest.approx(weak * 4 / (weak + 2), rel=1e-15, abs=0)


@pytest.mark.parametrize("seed", range(3))
def test_roots_between_even_poles_settle_in_a_handful_of_steps(seed):
    # Newton's method doubles the digits of a distance with each step; halving a bracket gains one in three steps.
    rng = np.random.default_rng(seed)
    poles, weight = np.arange(1.0, 30.0), 10 ** rng.uniform(-9, -1, 29)
    calls = []

    def terms(base, distance, own):
        calls.append(own)
        gap = (base[:, None] - poles) + distance[:, None]
        rows = np.flatnonzero(own >= 0)
        gap[rows, own[rows]] = np.inf
        strength = np.where(own >= 0, weight[own], 0.0)
        return (weight / gap).sum(axis=1) + 5.0, -(weight / gap**2).sum(axis=1), strength, np.zeros(1)

    base, distance = falling_roots(poles[:-1], poles[1:], np.arange(28), np.arange(1, 29), terms)
    assert len(calls) <= 6
    own = np.argmin(np.abs(base[:, None] - poles), axis=1)
    rest, _, strength, _ = terms(base, distance, own)
    assert distance * rest == pytest.approx(-strength, rel=1e-13, abs=0)


def test_an_interval_open_at_the_top_is_searched_to_its_end():
    # 1/x + 3 − x between zero and 3.5.
    def terms(base, distance, own):
        x = base + distance
        inverse = 1 / np.where(own < 0, x, np.inf)
        return 3 - x + inverse, -1 - inverse**2, np.ones(1), np.zeros(1)

    base, distance = falling_roots(np.zeros(1), np.array([3.5]), np.array([0]), np.array([-1]), terms)
    assert base + distance == pytest.approx([1.5 + 3.25**0.5], rel=1e-15)


def test_residues_over_thirty_decades_have_exactly_one_zero_between_any_two_poles():
    rng = np.random.default_rng(5)
    frequency = np.cumsum(10 ** rng.uniform(-7, 1, 50))
    of = expansion(frequency, 0.0, -(10 ** rng.uniform(-30, 0, 50)))
    found = expansion_zeros(of)
    upper = np.sort(found.imag[found.imag > 0])
    assert found.size == 98
    assert np.all((frequency[:-1] <= upper) & (upper <= frequency[1:]))


@pytest.mark.parametrize("seed", [0, 2, 7])
def test_zeros_closer_to_each_other_than_the_guesses_are_good_stay_apart(seed):
    # The highest modes take twelve digits of an eigenvalue solver's answer for the others.
    rng = np.random.default_rng(seed)
    frequency = np.concatenate([1 + 1e-6 * np.cumsum(rng.uniform(0.1, 1, 6)), 1e6 * rng.uniform(1, 2, 3)])
    residue = np.concatenate([rng.uniform(0.1, 1, 6), 100 * rng.normal(size=3)])
    found = expansion_zeros(expansion(frequency, 0.0, residue))
    upper = np.sort(found.imag[found.imag > 0])
    assert np.all((frequency[:5] < upper[:5]) & (upper[:5] < frequency[1:6]))


def test_near_cancelled_zeros_of_residues_of_both_signs_are_found_beside_their_poles():
    # To first order in the weak residue the zero moves from its pole by r_weak / Σ r/(λ − λ_weak).
    frequency, residue = [1.0, 4.0, 9.0, 100.0], np.array([1.0, -1e-11, 2.0, -0.3])
    found = expansion_zeros(expansion(frequency, 0.0, residue))
    square = np.array(frequency) ** 2
    rest = sum(residue[k] / (square[k] - 16.0) for k in (0, 2, 3))
    zero = found[np.argmin(np.abs(found - 4j))]
    assert zero.real == 0
    assert zero.imag**2 - 16.0 == pytest.approx(residue[1] / rest, rel=1e-3, abs=0)


def test_far_sensors_see_only_zeros_that_the_data_determine(stations):
    modes = modes_of(stations)
    for port, least in (("r19", 120), ("r10", 100), ("r0", 80)):
        of = modal_expansion(modes, port, "tip")
        found = expansion_zeros(of)
        assert_closed_and_ordered(found)
        assert least - 4 <= found.size <= least + 4
        terms = of.residue / (found[:, None] ** 2 + of.stiffness)
        slope = np.abs(np.sum(terms**2 / of.residue * 2 * found[:, None], axis=1))
        bound = np.abs(terms).sum(axis=1)
        assert np.all(np.abs(terms.sum(axis=1)) <= 1e-14 * bound + 1e-15 * slope * np.abs(found))
        # Rounding of the residues moves none of them by a thousandth.
        assert np.all(1e-16 * bound < 1e-3 * slope * np.abs(found))


def test_the_ends_of_a_chain_of_masses_have_no_zeros_between_them():
    n = 8
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[0, 0] = K[-1, -1] = 1.0
    eigenvalue, shapes = linalg.eigh(K)
    eigenvalue[0] = 0.0
    of = expansion(np.sqrt(eigenvalue), 0.0, shapes[0] * shapes[-1])
    assert expansion_zeros(of).size == 0
    # One mass nearer: that of the mass beyond, alone on its spring to ground.
    of = expansion(np.sqrt(eigenvalue), 0.0, shapes[1] * shapes[-1])
    same(expansion_zeros(of), np.array([1j, -1j]), 1e-12)


def test_a_mode_without_residue_and_modes_that_share_their_poles_are_their_own_zeros():
    of = expansion([1.0, 2.0, 3.0, 3.0, 5.0], 0.01, [1.0, 0.0, 0.5, 0.5, 2.0])
    found = expansion_zeros(of)
    assert found.size == 8
    simple = expansion_zeros(expansion([1.0, 3.0, 5.0], 0.01, [1.0, 1.0, 2.0]))
    poles = modal_poles(expansion([2.0, 3.0], 0.01, [1.0, 1.0]))
    same(found, np.concatenate([simple, poles]), 1e-14)
    # Shared poles whose residues cancel are not seen at all.
    none = expansion([1.0, 3.0, 3.0], 0.0, [1.0, 0.5, -0.5])
    same(expansion_zeros(none), np.array([3j, 3j, -3j, -3j]), 1e-15)


def test_an_expansion_that_never_responds_is_refused():
    with pytest.raises(ModelError, match="does not respond"):
        expansion_zeros(expansion([1.0, 2.0], 0.0, [0.0, 0.0]))


def test_only_rigid_body_modes_move_two_ports_exactly_alike():
    shape = np.array([[1.0, 1.0 + 1e-10], [1.0, 1.0 + 1e-10]])
    modes = ModalSet(np.array([0.0, 2.0]), np.zeros(2), shape, ("a", "b"), np.array([True, False]))
    found = modal_expansion(modes, "a", "a", "b").residue
    assert found[0] == 0
    assert found[1] == pytest.approx(-1e-10, rel=1e-5, abs=0)


def test_one_mode_has_no_zeros():
    assert expansion_zeros(expansion([2.0], 0.1, [1.0])).size == 0
    assert expansion_zeros(expansion([0.0], 0.0, [-1.0])).size == 0


@pytest.mark.parametrize("seed", range(6))
def test_damped_zeros_are_those_of_another_program(seed):
    rng = np.random.default_rng(seed)
    frequency, ratio = np.sort(rng.uniform(1, 30, 5)), rng.uniform(1e-3, 0.2, 5)
    of = expansion(frequency, ratio, rng.normal(size=5))
    # States alternate between each mode's coordinate and velocity.
    a, b, c = np.zeros((10, 10)), np.zeros((10, 1)), np.zeros((1, 10))
    for k in range(5):
        a[2 * k, 2 * k + 1] = 1.0
        a[2 * k + 1, 2 * k : 2 * k + 2] = -of.stiffness[k], -of.damping[k]
        b[2 * k + 1], c[0, 2 * k] = 1.0, of.residue[k]
    expected = control.ss(a, b, c, 0).zeros()
    # QZ leaves zeros at infinity behind, a million times the poles or more.
    same(expansion_zeros(of), expected[np.abs(expected) < 1e5], 1e-7)


# ------------------------------------------------------------------------------------------ mirror and plant


@pytest.mark.parametrize("inertia", [1e-6, 1e-4, 1e-2, 1.0, 30.0, 1e3])
def test_zeros_of_a_bicollocated_mirror_are_the_uncoupled_poles_whatever_its_inertia(stations, inertia):
    for ratio, hub in ((0.0, HELD), (0.001, FREE)):
        modes = modes_of(stations, ratio, hub)
        mirror = Mirror(inertia, 20 * HZ, 0.01)
        poles = modal_poles(modes)
        assert np.array_equal(mirror_zeros(modes, mirror, "tip"), poles)
        assert np.array_equal(mirror_zeros(modes, mirror, "tip", "tip"), poles)
        # By the determinant of the coupled plant, which knows nothing of this.
        moving = poles[poles != 0]
        found = plant_zeros(modal_matrices(loop(mirror), modes, "tip"))
        same(found[found != 0], moving, 1e-10)
        assert np.count_nonzero(found == 0) == np.count_nonzero(poles == 0)
        assert np.all((found.real == 0) | (ratio > 0))
        if ratio == 0:
            # By interlacing of the residues J̄_k/J_m of the coupled modes, Eqs. (4.7), (4.10).
            coupled = coupled_modes(modes, mirror, "tip")
            share = coupled.effective_modal_reaction_inertia / inertia
            of = expansion(coupled.natural_frequency, 0.0, share)
            same(expansion_zeros(of), moving, 1e-10)


PLACEMENTS = [
    Placement("r10"),
    Placement("r0"),
    Placement(sensor="r20"),
    Placement(sensor="r10", reaction="r15"),
    Placement(sensor="r3", action="r3"),
    Placement(action="r3"),
]


@pytest.mark.parametrize("place", PLACEMENTS, ids=str)
@pytest.mark.parametrize("damping", [0.0, 0.01])
def test_zeros_of_every_placement_make_the_numerator_of_the_loop_vanish(stations, place, damping):
    modes = modes_of(stations, 0.1 * damping, HELD)
    of = loop(Mirror(0.6, 20 * HZ, damping), place)
    found = plant_zeros(modal_matrices(of, modes, "tip"))
    assert_closed_and_ordered(found)
    model = LoopModel(of, modes, "tip")

    poles = modal_poles(modes)

    def size(s):
        # Next to a pole of the structure the numerator is not small; its pole is divided out.
        nearest = np.abs(s[:, None] - poles).min(axis=1)
        return nearest * np.abs(sensor_gain(of, s, model.points(s).g))

    s = found[(found != 0) & (found.imag >= 0)]
    # Twice as far away it is twice as large: simple zeros at these points, to a millionth of themselves.
    near, far = size(s * (1 + 1e-6)), size(s * (1 + 2e-6))
    assert far / near == pytest.approx(np.full(s.size, 2.0), rel=0.05)
    if not damping:
        assert np.all((found.real == 0) | (found.imag == 0) | np.isin(-found, found))
        flat = coupled_expansion(modal_matrices(of, modes, "tip"))
        expected = expansion_zeros(flat)
        common = min(found[found != 0].size, expected[expected != 0].size) // 2
        lowest = (
            np.sort(np.abs(found[found != 0]))[:common],
            np.sort(np.abs(expected[expected != 0]))[:common],
        )
        assert lowest[0] == pytest.approx(lowest[1], rel=1e-6)


def test_zeros_of_a_reactionless_mirror_with_an_absorber_are_those_of_its_state_space(stations):
    modes = modes_of(stations, 0.01, HELD).keep(range(4))
    mirror = Mirror(0.3, 20 * HZ, 0.01, MirrorReactionMass(0.9, 1.2, 0.95))
    of = loop(mirror, Placement("r5"), actuators=(ReactionMassActuator("r12", 2.0, 6 * HZ, 0.05, 3.0),))
    system = plant_state_space(of, modes, "tip")
    # In milliseconds, so that QZ sees entries of one size.
    unit = 1e3
    b, c = system.b[:, :1], system.c[system.outputs.index("sensor_angle")][None, :]
    n = system.a.shape[0] // 2
    scale = np.concatenate([np.ones(n), np.full(n, unit)])
    a = system.a * scale / scale[:, None] / unit
    expected = unit * control.ss(a, b / scale[:, None], c * scale, 0).zeros()
    found = plant_zeros(modal_matrices(of, modes, "tip"))
    assert found.size == 2 * n - 2
    same(found, expected[np.abs(expected) < 1e6], 1e-6)


def test_sensors_that_momentum_keeps_still_have_zeros_at_the_origin_exactly(stations):
    # Internal torque leaves the structure's static shape alone: −J_m s² g, Eq. (4.17).
    modes = modes_of(stations, 0.001, HELD)
    of = loop(Mirror(0.6, 20 * HZ, 0.01), Placement(sensor="r10"))
    found = plant_zeros(modal_matrices(of, modes, "tip"))
    assert np.count_nonzero(found == 0) == 2
    same(found[found != 0], expansion_zeros(modal_expansion(modes, "r10", "tip")), 1e-8)


@pytest.mark.parametrize("damping", [0.0, 0.01])
def test_zeros_of_a_mirror_that_reacts_elsewhere_are_poles_of_a_structure_on_its_spring(stations, damping):
    modes = modes_of(stations, 0.1 * damping, HELD)
    mirror = Mirror(0.2 * reference.inertia_of(stations.structure), 20 * HZ, damping)
    found = mirror_zeros(modes, mirror, "tip", "r10")
    apart = modes.at("tip") - modes.at("r10")
    K = np.diag(modes.stiffness) + mirror.stiffness * np.outer(apart, modes.at("tip"))
    C = np.diag(modes.damping) + mirror.damping * np.outer(apart, modes.at("tip"))
    n = modes.natural_frequency.size
    expected = linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-K, -C]]))
    assert np.count_nonzero(found.real > 0) == 2 * 4
    # The plain eigenvalue problem rounds at the size of K over the lowest frequency.
    same(found, expected, 1e-6)


def test_a_static_response_above_one_gives_a_real_zero_in_the_right_half_plane():
    # N(0) = 1 + k_m (g_rr − g_rh) below zero: between the origin and infinity N must vanish.
    modes = ModalSet(
        np.array([3.0, 8.0]),
        np.zeros(2),
        np.array([[0.4, 2.0], [0.5, -0.1]]),
        ("tip", "far"),
        np.zeros(2, bool),
    )
    mirror = Mirror(1.0, 10.0, 0.0)
    apart = modes.receptance(np.zeros(1), "tip", "tip") - modes.receptance(np.zeros(1), "tip", "far")
    assert 1 + mirror.stiffness * apart[0].real < 0
    found = mirror_zeros(modes, mirror, "tip", "far")
    assert np.count_nonzero((found.real > 0) & (found.imag == 0)) == 1
