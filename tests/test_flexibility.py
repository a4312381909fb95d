"""Structural flexibility types: closed forms, the benchmark problem and placements on the truss."""

from __future__ import annotations

from dataclasses import replace
from math import inf, sqrt

import numpy as np
import pytest
import reference
from hypothesis import assume, given
from hypothesis import strategies as st

from fosopt.actuators import Mirror, Placement
from fosopt.control import PID, Loop, modal_matrices
from fosopt.errors import ModelError
from fosopt.metrics.flexibility import (
    Collocation,
    FlexibilityType,
    PoleZeroPattern,
    SingleModeExpansions,
    collocation,
    flexibility_type,
    reaction_flexibility,
    rigid_body_flexibility,
    rigid_body_inertia,
)
from fosopt.modes import Damping, Hub, ModalSet
from fosopt.plant import (
    ModalExpansion,
    coupled_expansion,
    coupled_matrices,
    coupled_modes,
    modal_expansion,
    plant_zeros,
)
from fosopt.structure import barker_truss

HZ = reference.HZ
APPENDAGE, MINIMUM, NONMINIMUM, CANCELLED, DEGENERATE = (
    FlexibilityType.APPENDAGE,
    FlexibilityType.IN_THE_LOOP_MINIMUM_PHASE,
    FlexibilityType.IN_THE_LOOP_NONMINIMUM_PHASE,
    FlexibilityType.CANCELLED,
    FlexibilityType.DEGENERATE,
)


def two_masses(m1, m2, k2, ratio):
    """The modes of two masses on a spring, in closed form."""
    total = m1 + m2
    shape = np.array(
        [[1 / sqrt(total)] * 2, [sqrt(m2 / (m1 * total)), -sqrt(m1 / (m2 * total))]],
    )
    frequency = np.array([0.0, sqrt(total / (m1 * m2) * k2)])
    return ModalSet(frequency, np.array([0.0, ratio]), shape, ("x1", "x2"), np.array([True, False]))


def single(actuator, mode):
    """One flexible mode beside an actuator's, each as (frequency, damping ratio, residue)."""
    w, zeta, residue = (np.array([x], dtype=float) for x in mode)
    return SingleModeExpansions(np.array([1]), w, zeta, residue, 0, *actuator)


# --------------------------------------------------------------------------------------- rigid-body control


def test_two_masses_follow_equations_3_18_and_3_19():
    m1, m2, k2, zeta = 0.3, 0.7, 40.0, 0.02
    total, modes = m1 + m2, two_masses(m1, m2, k2, zeta)
    w = modes.natural_frequency[1]
    # The far mass: no s² term, a zero at −ω/(2ζ) and none without damping.
    far = rigid_body_flexibility(modal_expansion(modes, "x2", "x1"))
    assert (far.types[0], far.participation[0]) == (DEGENERATE, 0.0)
    assert (far.ratio[0], far.zero_squared[0]) == (inf, inf)
    assert np.isinf(far.zeros[0, 0])
    assert far.zeros[0, 1] == pytest.approx(-w / (2 * zeta))
    assert np.all(
        np.isinf(rigid_body_flexibility(modal_expansion(two_masses(m1, m2, k2, 0.0), "x2", "x1")).zeros)
    )
    # The mass that is pushed: (M/m2) s² + 2ζω s + ω².
    near = rigid_body_flexibility(modal_expansion(modes, "x2", "x2"))
    assert near.types[0] == APPENDAGE
    assert near.participation[0] == pytest.approx(total / m2, rel=1e-14)
    assert near.zeros[0] == pytest.approx(np.roots([total / m2, 2 * zeta * w, w**2]), rel=1e-13)
    for sensor in ("x1", "x2"):
        assert rigid_body_inertia(modal_expansion(modes, sensor, "x2")) == pytest.approx(total)
    against = modal_expansion(modes, "x1", "x2")
    assert rigid_body_inertia(replace(against, residue=-against.residue)) == pytest.approx(-total)


@given(st.floats(-20, 20), st.floats(0.1, 30), st.sampled_from([0.0, 0.05]))
def test_rigid_body_control_has_the_numerator_of_equation_3_4(residue, frequency, zeta):
    inertia = 0.4
    of = ModalExpansion(
        np.array([0.0, 0.0, frequency]),
        np.array([0.0, 0.0, zeta]),
        np.array([3.0, 1 / inertia - 3.0, residue]),
        np.array([True, True, False]),
    )
    alpha = 1 + inertia * residue
    assume(abs(alpha) > 1e-3 and abs(alpha - 1) > 1e-9)
    found = rigid_body_flexibility(of)
    assert rigid_body_inertia(of) == pytest.approx(inertia)
    assert found.mode.tolist() == [2]
    assert found.participation[0] == pytest.approx(alpha, rel=1e-12)
    expected = np.roots([alpha, 2 * zeta * frequency, frequency**2])
    reach = np.abs(np.sort_complex(found.zeros[0]) - np.sort_complex(expected))
    assert reach == pytest.approx(np.zeros(2), abs=1e-7 * np.abs(expected).max())
    assert found.types[0] == (APPENDAGE if alpha > 1 else MINIMUM if alpha > 0 else NONMINIMUM)
    # A nonminimum phase mode, and no other, has a zero in the right half plane.
    assert (found.zeros.real.max() > 1e-12) == (alpha < 0)
    case = {APPENDAGE: "I", MINIMUM: "II", NONMINIMUM: "III"}[FlexibilityType(found.types[0])]
    assert found.patterns[0].case == case


def test_a_mode_without_residue_is_cancelled():
    of = ModalExpansion(np.array([0.0, 3.0]), np.zeros(2), np.array([2.0, 0.0]), np.array([True, False]))
    found = rigid_body_flexibility(of)
    assert (found.types[0], found.participation[0]) == (CANCELLED, 1.0)
    assert found.patterns[0] == PoleZeroPattern(None, CANCELLED, ("actuator", "mode", "zero"))
    assert found.zeros[0] == pytest.approx([3j, -3j])


def test_types_are_strings_by_participation():
    alpha = np.array([2.0, 1.0, 0.5, 0.0, -0.1, inf, np.nextafter(1.0, 0)])
    expected = [APPENDAGE, CANCELLED, MINIMUM, DEGENERATE, NONMINIMUM, APPENDAGE, MINIMUM]
    assert flexibility_type(alpha).tolist() == [str(kind) for kind in expected]


def test_collocated_control_of_the_free_truss_gives_appendage_modes_only_and_a_far_sensor_all_types(frame3):
    modes = frame3.modal_set(Hub("free"), Damping((0.0,)), ("hub", "tip"))
    whole = reference.inertia_of(frame3.structure)
    near = rigid_body_flexibility(modal_expansion(modes, "tip", "tip"))
    assert near.mode.size == modes.natural_frequency.size - 1
    assert set(near.types) == {APPENDAGE}
    far = rigid_body_flexibility(modal_expansion(modes, "tip", "hub"))
    assert set(far.types) == {APPENDAGE, MINIMUM, NONMINIMUM}
    # The first flexible mode of a pinned beam turns its ends in opposite senses, more than it turns as a whole.
    assert far.types[0] == NONMINIMUM
    # J, Eq. (3.2), is the inertia about the hub with the mirror's mass at its arm.
    arm = np.linalg.norm(barker_truss("pinned").nodes["N20a"][:1])
    expected = whole + reference.MIRROR_MASS * arm**2
    assert rigid_body_inertia(modal_expansion(modes, "tip", "hub")) == pytest.approx(expected, rel=1e-9)


def test_an_internal_load_moves_no_rigid_body(frame3):
    modes = frame3.modal_set(Hub("free"), Damping((0.0,)), ("hub", "tip"))
    of = modal_expansion(modes, "tip", "tip", "hub")
    assert of.residue[0] == 0.0  # exactly, Eq. (3.8)
    assert rigid_body_inertia(of) == inf
    with pytest.raises(ModelError, match="use reaction_flexibility"):
        rigid_body_flexibility(of)


# ---------------------------------------------------------------------------------- reaction-actuator control


@given(
    st.floats(0.1, 30),
    st.floats(0.1, 30),
    st.floats(-10, 10),
    st.floats(-10, 10),
    st.sampled_from([(0.0, 0.0), (0.01, 0.001), (0.2, 0.05)]),
)
def test_a_reaction_actuator_has_the_numerator_of_equation_3_11(wa, wk, a, k, zeta):
    assume(abs(a + k) > 1e-3 and min(abs(a), abs(k)) > 1e-3 and abs(wa - wk) > 1e-3)
    of = single((wa, zeta[0], a), (wk, zeta[1], k))
    numerator = [a + k, 2 * (a * zeta[1] * wk + k * zeta[0] * wa), a * wk**2 + k * wa**2]
    assume(abs(numerator[2]) > 1e-6)
    assert of.zeros[0] == pytest.approx(of.zeros[0])
    residual = np.abs(np.polyval(numerator, of.zeros[0]))
    terms = np.polyval(np.abs(numerator), np.abs(of.zeros[0]))
    assert np.all(residual <= 1e-14 * terms)
    # Eqs. (3.12) and (3.13).
    assert of.zero_squared[0] == pytest.approx(numerator[2] / numerator[0], rel=1e-12)
    ratio = of.ratio[0]
    assert ratio * wk**2 + (1 - ratio) * wa**2 == pytest.approx(
        of.zero_squared[0], rel=1e-9, abs=1e-9 * wk**2
    )
    pattern = of.patterns[0]
    assert pattern.type == of.types[0]
    if 0 < ratio < 1:  # Eqs. (3.14)-(3.16)
        assert pattern.case == "I"
        below, above = sorted((wa**2, wk**2))
        assert below < of.zero_squared[0] < above
        assert pattern.type == (MINIMUM if wa > wk else APPENDAGE)
        assert np.all(of.zeros.real <= 0)
    else:
        assert pattern.case == ("II" if ratio > 1 else "III")
    if of.zero_squared[0] > 0:
        squares = {"actuator": wa**2, "mode": wk**2, "zero": of.zero_squared[0]}
        assert list(pattern.order) == sorted(squares, key=squares.__getitem__)
    else:
        assert pattern.type == NONMINIMUM
        assert "zero" not in pattern.order
        assert of.zeros.real.max() > 0


# Patterns by the ratio and the side of the actuator on which the mode lies. The two outer cases have a second
# pattern on one side each: the zero falls through the origin and becomes real.
PATTERNS = {
    (1.0, 2.0, 1.0): PoleZeroPattern("I", MINIMUM, ("mode", "zero", "actuator")),
    (1.0, 0.5, 1.0): PoleZeroPattern("I", APPENDAGE, ("actuator", "zero", "mode")),
    (1.0, 0.5, -0.4): PoleZeroPattern("II", MINIMUM, ("actuator", "mode", "zero")),
    (1.0, 1.1, -0.4): PoleZeroPattern("II", APPENDAGE, ("zero", "mode", "actuator")),
    (1.0, 2.0, -0.4): PoleZeroPattern("II", NONMINIMUM, ("mode", "actuator")),
    (0.4, 2.0, -1.0): PoleZeroPattern("III", MINIMUM, ("mode", "actuator", "zero")),
    (0.4, 0.9, -1.0): PoleZeroPattern("III", APPENDAGE, ("zero", "actuator", "mode")),
    (0.4, 0.5, -1.0): PoleZeroPattern("III", NONMINIMUM, ("actuator", "mode")),
}


@pytest.mark.parametrize("numbers", PATTERNS, ids=str)
def test_every_pattern_of_figure_3_3_is_named(numbers):
    own, frequency, other = numbers
    of = single((frequency, 0.0, own), (1.0, 0.0, other))
    assert of.patterns == (PATTERNS[numbers],)


def test_borders_between_the_cases_have_no_case():
    # A zero at infinity, a cancelled mode, and modes tuned to each other.
    assert single((2.0, 0.0, 1.0), (1.0, 0.0, -1.0)).patterns[0] == PoleZeroPattern(
        None, DEGENERATE, ("mode", "actuator")
    )
    assert single((2.0, 0.0, 1.0), (3.0, 0.0, 0.0)).patterns[0].case is None
    assert single((2.0, 0.0, 1.0), (2.0, 0.0, 0.5)).types[0] == CANCELLED


def test_damping_can_turn_a_minimum_phase_type_into_zeros_in_the_right_half_plane():
    of = single((1.0, 0.1, 1.0), (2.0, 0.001, -0.4))
    assert of.types[0] == MINIMUM
    assert np.all(of.zeros.real > 0)
    # Equal damping factors 2ζω would keep it on the left.
    assert np.all(single((1.0, 0.1, 1.0), (2.0, 0.05, -0.4)).zeros.real < 0)


def test_the_actuator_is_the_mode_with_the_largest_residue_unless_named():
    of = ModalExpansion(
        np.array([0.0, 2.0, 3.0, 5.0]),
        np.zeros(4),
        np.array([0.0, 0.5, -4.0, 1.0]),
        np.array([True] + [False] * 3),
    )
    found = reaction_flexibility(of)
    assert (found.actuator, found.mode.tolist()) == (2, [1, 3])
    # Beside the largest residue no ratio is negative: case III needs an actuator that does not dominate.
    assert np.all(found.ratio > 0)
    named = reaction_flexibility(of, 1)
    assert (named.actuator, named.mode.tolist()) == (1, [2, 3])
    assert named.patterns[0].case == "III"
    of = replace(of, residue=np.array([0.0, 0.5, -4.0, 0.0]))
    for wrong in (0, 3, 7):
        with pytest.raises(ModelError, match=f"mode {wrong} does not carry"):
            reaction_flexibility(of, wrong)
    with pytest.raises(ModelError, match="mode None does not carry"):
        reaction_flexibility(ModalExpansion(np.zeros(1), np.zeros(1), np.ones(1), np.array([True])))


# ----------------------------------------------------------------------------------- the benchmark problem


@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_table_3_3_comes_out(case, dissertation):
    loop, modes = reference.benchmark(case)
    undamped = replace(modes, damping_ratio=np.zeros(2))
    of = coupled_expansion(modal_matrices(loop, undamped, "tip"))
    found = reaction_flexibility(of)
    assert found.mode.size == 1
    printed = {name: values[case - 1] for name, values in dissertation["table_3_3"].items()}
    # With two flexible modes the expansion is the whole model, and the zero is the support's frequency.
    assert found.zero_squared[0] == pytest.approx(modes.stiffness[1], rel=1e-9)
    assert found.types[0] == printed["type"]
    assert found.participation[0] == pytest.approx(printed["alpha"], abs=0.5e-4)
    # The ratios of cases 3 and 4 are printed with a fourth digit that is not theirs: 0.976|32, 0.999|09.
    digits = 4 if case <= 2 else 3
    assert found.ratio[0] == pytest.approx(printed["participation"], abs=0.5 * 10.0**-digits)
    assert found.patterns[0].case == "I"


def test_three_masses_have_the_numerators_of_equations_3_20_to_3_23():
    m1, m2, ma, k2, ka, c2, ca = 0.3, 0.5, 1.1, 60.0, 90.0, 0.4, 0.7
    mirror = Mirror(ma, sqrt(ka / ma), ca / (2 * sqrt(ka * ma)))
    M = np.diag([m1, m2])
    K, C = (x * np.array([[1.0, -1.0], [-1.0, 1.0]]) for x in (k2, c2))
    rows = {"x1": np.array([1.0, 0.0]), "x2": np.array([0.0, 1.0])}

    def zeros(place, external=False):
        coupled = coupled_matrices((M, C, K), rows, "x2", mirror, place)
        if external:
            coupled = replace(coupled, control=np.array([1.0, 0.0, 0.0]))
        return plant_zeros(coupled)

    # An internal force leaves the rigid body at rest: s² over s² is left to cancel.
    pushed = np.roots([m1 * m2, c2 * (m1 + m2), k2 * (m1 + m2)])
    for place, expected in (
        (Placement(), pushed),  # (3.20)
        (Placement(sensor="x2"), np.roots([m1, c2, k2])),  # (3.21)
        (Placement(sensor="x1"), np.array([-k2 / c2])),  # (3.22)
    ):
        found = zeros(place)
        assert found[:2].tolist() == [0, 0]
        assert reference.worst_match(found[2:], expected) < 1e-12
    through = zeros(Placement(), external=True)  # (3.23), the force on the far mass
    assert reference.worst_match(through, np.array([-k2 / c2, -ka / ca])) < 1e-12
    # No zero knows the actuated mass.
    heavy = replace(mirror, inertia=2 * ma, natural_frequency=sqrt(ka / (2 * ma)))
    coupled = coupled_matrices((M, C, K), rows, "x2", heavy, Placement())
    assert reference.worst_match(plant_zeros(coupled)[2:], pushed) < 1e-12


# --------------------------------------------------------------------------------------- placements on the truss


@pytest.mark.parametrize(
    ("place", "kind"),
    [
        (Placement(), Collocation.BICOLLOCATED),
        (Placement("r3"), Collocation.COLLOCATED),
        (Placement("r3", sensor="r5", action="r5"), Collocation.COLLOCATED),
        (Placement(sensor="r5", action="r5"), Collocation.BICOLLOCATED),
        (Placement(sensor="r3"), Collocation.NON_COLLOCATED),
        (Placement("r3", sensor="r5"), Collocation.NON_COLLOCATED),
    ],
    ids=str,
)
def test_placements_are_classified(place, kind):
    assert collocation(place) is kind


@pytest.fixture(scope="module")
def stations():
    """Modes of the pinned truss with a port at every batten."""
    frame = reference.stations()
    ports = (*reference.PORTS, *reference.STATIONS)
    return frame.modal_set(Hub("free"), Damping((0.001,)), ports), reference.inertia_of(frame.structure)


def flexibility(stations, place, percent):
    """Single-mode expansions beside the mode of the mirror, below 150 Hz."""
    modes, whole = stations
    mirror = Mirror(percent / 100 * whole, 20 * HZ, 0.01)
    of = coupled_expansion(modal_matrices(Loop(mirror, PID(1.0, 1.0, 1.0, 1.0), place), modes, "tip"))
    low = ModalExpansion(
        *(getattr(of, f)[:30] for f in ("natural_frequency", "damping_ratio", "residue", "rigid"))
    )
    return reaction_flexibility(low, coupled_modes(modes, mirror, "tip").mirror_mode)


@pytest.mark.parametrize("percent", [0.002, 0.2, 20.0])
def test_a_bicollocated_mirror_has_case_1_only_in_the_loop_below_it_and_appendage_above(stations, percent):
    found = flexibility(stations, Placement(), percent)
    assert {p.case for p in found.patterns} == {"I"}
    below = found.natural_frequency < found.actuator_frequency
    assert set(found.types[below]) == {MINIMUM}
    assert set(found.types[~below]) == {APPENDAGE}


def test_placements_on_the_truss_show_every_pattern_and_so_do_those_with_sensor_and_action_together(stations):
    together = [
        Placement("r0"),
        Placement("r10"),
        *(Placement(sensor=f"r{i}", action=f"r{i}") for i in range(8)),
    ]
    apart = [Placement(sensor=f"r{i}") for i in range(12)]
    for places in (together, apart):
        found = {p for place in places for p in flexibility(stations, place, 0.2).patterns}
        assert set(PATTERNS.values()) <= found


def test_residues_of_a_bicollocated_mirror_are_its_effective_modal_reaction_inertias(stations):
    modes, whole = stations
    mirror = Mirror(0.002 * whole, 20 * HZ, 0.01)
    of = coupled_expansion(modal_matrices(Loop(mirror, PID(1.0, 1.0, 1.0, 1.0)), modes, "tip"))
    coupled = coupled_modes(modes, mirror, "tip")
    # Eqs. (4.6), (4.7); eigh's vectors turn by rounding over the gap to the next mode.
    assert mirror.inertia * of.residue == pytest.approx(coupled.effective_modal_reaction_inertia, abs=1e-8)
    assert of.natural_frequency[1:] == pytest.approx(coupled.natural_frequency[1:], rel=1e-8)
    # Modal damping adds up to the trace of M⁻¹C.
    matrices = modal_matrices(Loop(mirror, PID(1.0, 1.0, 1.0, 1.0)), modes, "tip")
    trace = np.trace(np.linalg.solve(matrices.mass, matrices.damping))
    assert of.damping.sum() == pytest.approx(trace, rel=1e-12)
    assert of.damping_ratio[0] == 0.0
