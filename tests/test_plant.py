"""Coupled modes of structure and mirror: the dissertation's five inertias and pole-zero separations."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import reference
from scipy import linalg

from fosopt.actuators import Mirror
from fosopt.metrics.inertias import (
    mirror_inertia_from_modes,
    modal_inertia,
    modal_reaction_inertia,
    reference_inertia,
)
from fosopt.modes import Damping, Hub, ModalSet
from fosopt.plant import coupled_modes, secular, secular_slope

HZ, PORTS = reference.HZ, reference.PORTS
HUBS = pytest.mark.parametrize("hub", [reference.HELD, Hub("free")], ids=["held", "free"])
PERCENTS = (1e-9, 0.002, 0.02, 0.2, 2.0, 20.0, 1e5)


def truss_modes(hub=reference.HELD):
    return reference.modes_of(reference.structure(), hub)


def mirror(percent):
    return reference.mirror_of(reference.structure(), percent)


def dense(modes, of):
    """Coupled eigenvalues and mass-normalized shapes (structure coordinates, mirror angle) by eigh."""
    h = np.append(modes.at("tip"), -1.0)
    K = np.diag(np.append(modes.stiffness, 0.0)) + of.stiffness * np.outer(h, h)
    M = np.diag(np.append(np.ones(h.size - 1), of.inertia))
    return linalg.eigh(K, M)


def angles(modes, shapes):
    """(n+1,) Mirror angle and port angle of each coupled mode."""
    return shapes[-1], modes.at("tip") @ shapes[:-1]


@HUBS
@pytest.mark.parametrize("percent", PERCENTS)
def test_coupled_modes_are_those_of_the_dense_eigenvalue_problem(hub, percent):
    modes, of = truss_modes(hub), mirror(percent)
    coupled = coupled_modes(modes, of, "tip")
    eigenvalue, shapes = dense(modes, of)
    # eigh is the less accurate side: rounding of the largest eigenvalue.
    assert np.abs(coupled.eigenvalue - eigenvalue).max() < 1e-13 * eigenvalue[-1]
    mirror_angle, port_angle = angles(modes, shapes)
    expected = of.inertia * mirror_angle * (mirror_angle - port_angle)
    # Its vectors turn by rounding over the gap to the next mode, 1e-3 of the largest eigenvalue.
    assert np.abs(coupled.effective_modal_reaction_inertia - expected).max() < 1e-8


@HUBS
@pytest.mark.parametrize("percent", PERCENTS)
def test_effective_modal_reaction_inertias_are_not_negative_and_sum_to_one(hub, percent):
    coupled = coupled_modes(truss_modes(hub), mirror(percent), "tip")
    shares = coupled.effective_modal_reaction_inertia
    assert np.all(shares >= 0)
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("percent", [0.002, 0.2, 20.0])
def test_the_five_inertias_obey_equations_4_3_to_4_9(percent):
    modes, of = truss_modes(Hub("free")), mirror(percent)
    coupled = coupled_modes(modes, of, "tip")
    _, shapes = dense(modes, of)
    mirror_angle, port_angle = angles(modes, shapes)
    # Mirror inertia, Eq. (4.3), and reference inertia, Eq. (4.5), from the coupled mode shapes.
    assert mirror_inertia_from_modes(mirror_angle) == pytest.approx(of.inertia, rel=1e-10, abs=0)
    assert 1 / np.sum(port_angle**2) == pytest.approx(reference_inertia(modes, "tip"), rel=1e-10, abs=0)
    # Orthogonality of mirror and port, Eq. (4.4).
    assert abs(mirror_angle @ port_angle) < 1e-9 * np.linalg.norm(mirror_angle) * np.linalg.norm(port_angle)
    # Modal reaction inertia, Eqs. (4.6) and (4.7): 1/J_k = φ_mk (φ_mk − φ_hk), and Σ 1/J_k = 1/J_m.
    J = modal_reaction_inertia(coupled, of)
    assert pytest.approx(mirror_angle * (mirror_angle - port_angle), abs=1e-8 / of.inertia) == 1 / J
    assert np.sum(1 / J) == pytest.approx(1 / of.inertia, rel=1e-12, abs=0)
    assert of.inertia / J == pytest.approx(coupled.effective_modal_reaction_inertia)
    assert np.isinf(J[0])  # the rigid-body mode
    # Modal inertia of the uncoupled structure, Eq. (4.9).
    assert modal_inertia(modes, "tip") == pytest.approx(1 / modes.at("tip") ** 2)


@HUBS
def test_coupled_eigenvalues_are_zeros_of_the_secular_equation_and_its_slope_is_the_inertia(hub):
    modes, of = truss_modes(hub), mirror(2.0)
    coupled = coupled_modes(modes, of, "tip")
    moved = coupled.effective_modal_reaction_inertia > 0
    lam, base, distance = coupled.eigenvalue[moved], coupled.base[moved], coupled.distance[moved]
    gap = (modes.stiffness[:, None] - base) - distance
    square = modes.at("tip")[:, None] ** 2
    g, g_slope = (square / gap).sum(axis=0), (square / gap**2).sum(axis=0)
    slope = secular_slope(of.stiffness, lam, g, g_slope)
    # A root that is right to rounding leaves slope times rounding of its distance, or of the terms of F.
    terms = of.natural_frequency**2 + lam * (1 + of.stiffness * (square / np.abs(gap)).sum(axis=0))
    allowed = 1e-14 * np.abs(slope * distance) + 1e-14 * terms
    assert np.all(np.abs(secular(of.stiffness, of.natural_frequency**2, lam, 0.0, g)) <= allowed)
    assert -1 / slope == pytest.approx(coupled.effective_modal_reaction_inertia[moved], rel=1e-9, abs=0)
    step = 1e-7 * np.abs(distance)

    def at(shift):
        apart = gap - shift
        return secular(of.stiffness, of.natural_frequency**2, lam, shift, (square / apart).sum(axis=0))

    assert (at(step) - at(-step)) / (2 * step) == pytest.approx(slope, rel=1e-5, abs=0)


def test_the_mirror_mode_is_the_fifth_at_small_coupling(dissertation):
    chapter = dissertation["chapter_4"]
    coupled = coupled_modes(truss_modes(Hub("free")), mirror(0.002), "tip")
    assert coupled.mirror_mode + 1 == chapter["mirror_mode_number"]
    assert np.argmax(coupled.effective_modal_reaction_inertia) == coupled.mirror_mode
    assert np.isnan(coupled.zero[coupled.mirror_mode])
    tiny = coupled_modes(truss_modes(Hub("free")), mirror(1e-9), "tip")
    found = tiny.natural_frequency[tiny.mirror_mode] / HZ
    assert found == pytest.approx(chapter["mirror_frequency"], rel=1e-6, abs=0)


@HUBS
def test_poles_below_the_mirror_fall_and_poles_above_it_rise_as_its_inertia_grows(hub):
    modes = truss_modes(hub)
    series = [coupled_modes(modes, mirror(percent), "tip") for percent in (0.002, 0.02, 0.2, 2.0, 20.0)]
    mode = series[0].mirror_mode
    distance = np.array([c.separation for c in series])
    moved = np.flatnonzero(series[0].effective_modal_reaction_inertia > 0)
    below, above = moved[moved < mode], moved[moved > mode]
    assert np.all(distance[:, below] < 0)
    assert np.all(distance[:, above] > 0)
    assert np.all(np.diff(distance[:, below], axis=0) < 0)
    assert np.all(np.diff(distance[:, above], axis=0) > 0)


@HUBS
def test_zeros_are_the_uncoupled_frequencies_and_poles_interlace_them(hub):
    modes = truss_modes(hub)
    coupled = coupled_modes(modes, mirror(20.0), "tip")
    zeros = coupled.zero[~np.isnan(coupled.zero)]
    assert np.array_equal(zeros, modes.stiffness[modes.stiffness > 0])
    moved = coupled.effective_modal_reaction_inertia > 0
    poles = np.sort(coupled.eigenvalue[moved])
    assert np.all((poles[:-1] < zeros) & (zeros < poles[1:]))


def test_separation_and_participation_are_ratios_of_pole_and_zero():
    coupled = coupled_modes(truss_modes(), mirror(20.0), "tip")
    kept = ~np.isnan(coupled.zero)
    ratio = np.sqrt(coupled.eigenvalue[kept] / coupled.zero[kept])
    assert coupled.pole_zero_separation[kept] == pytest.approx(ratio, rel=1e-12, abs=0)
    assert coupled.participation[kept] == pytest.approx(ratio**2, rel=1e-12, abs=0)
    assert coupled.one_minus_separation[kept] == pytest.approx(1 - ratio, abs=1e-12)
    assert coupled.natural_frequency[kept] == pytest.approx(
        ratio * np.sqrt(coupled.zero[kept]), rel=1e-12, abs=0
    )


@pytest.mark.parametrize("percent", [1e-6, 1e-12])
def test_a_separation_of_a_trillionth_is_right_to_ten_digits(percent):
    modes, of = truss_modes(), mirror(percent)
    coupled = coupled_modes(modes, of, "tip")
    wm2 = of.natural_frequency**2
    paired = np.flatnonzero(~np.isnan(coupled.zero))
    # First order in k = J_m ω_m² at a zero Ω²: λ − Ω² = k φ² Ω²/(Ω² − ω_m²); with λ(1 + k g) = ω_m².
    zero = coupled.zero[paired]
    order = np.searchsorted(modes.stiffness, zero)
    phi2 = modes.at("tip")[order] ** 2
    expected = of.stiffness * phi2 / (zero - wm2)
    second = np.max(np.abs(expected)) + of.stiffness * np.sum(modes.at("tip") ** 2 / modes.stiffness)
    assert np.abs(expected).min() < 1e-11
    assert coupled.separation[paired] == pytest.approx(expected, rel=1e-10 + 100 * second, abs=0)
    assert coupled.one_minus_separation[paired] == pytest.approx(
        -expected / 2, rel=1e-10 + 100 * second, abs=0
    )


@pytest.mark.parametrize(
    "mirror_frequency", [4.0, 8.0, 2.0], ids=["between", "on the second", "on the first"]
)
def test_roots_are_right_to_the_last_digits_in_exact_arithmetic(mirror_frequency):
    # Two modes and a mirror whose data are exact in binary; F is evaluated in rational numbers.
    shape = np.array([[0.5, 0.5], [0.25, 2.0**-20]])
    modes = ModalSet(np.array([2.0, 8.0]), np.zeros(2), shape, PORTS, np.zeros(2, bool))
    of = Mirror(2.0**-10, mirror_frequency, 0.0)
    coupled = coupled_modes(modes, of, "tip")

    def exact(base, distance):
        lam = Fraction(float(base)) + distance
        weights = [Fraction(float(p)) ** 2 for p in modes.at("tip")]
        g = sum(p / (Fraction(float(w)) - lam) for p, w in zip(weights, modes.stiffness, strict=True))
        return Fraction(mirror_frequency) ** 2 - lam * (1 + Fraction(of.stiffness) * g)

    # The root lies within nine units in the last place of the distance.
    near, far = 1 - Fraction(1, 2**49), 1 + Fraction(1, 2**49)
    for base, distance in zip(coupled.base, coupled.distance, strict=True):
        d = Fraction(float(distance))
        assert exact(base, d * near) * exact(base, d * far) < 0


def test_without_coupling_nothing_moves():
    modes = truss_modes()
    still = replace(modes, mode_shape=modes.mode_shape * np.array([1.0, 0.0]))
    of = mirror(0.2)
    coupled = coupled_modes(still, of, "tip")
    expected = np.sort(np.append(modes.stiffness, of.natural_frequency**2))
    assert coupled.eigenvalue == pytest.approx(expected, rel=1e-14, abs=0)
    assert coupled.effective_modal_reaction_inertia[coupled.mirror_mode] == pytest.approx(
        1.0, rel=1e-14, abs=0
    )
    assert coupled.natural_frequency[coupled.mirror_mode] == pytest.approx(of.natural_frequency)
    others = np.delete(coupled.separation, coupled.mirror_mode)
    assert np.all(others == 0)


def test_a_mode_with_a_node_at_the_mirror_stays_and_has_no_share():
    modes = truss_modes()
    shape = modes.mode_shape.copy()
    shape[6, 1] = 0.0
    coupled = coupled_modes(replace(modes, mode_shape=shape), mirror(2.0), "tip")
    at = int(np.flatnonzero(coupled.eigenvalue == modes.stiffness[6])[0])
    assert coupled.effective_modal_reaction_inertia[at] == 0
    assert coupled.pole_zero_separation[at] == 1
    assert coupled.effective_modal_reaction_inertia.sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("percent", [1e-6, 0.02, 2.0])
def test_a_mirror_tuned_to_a_structural_frequency_shares_its_mode_evenly(percent):
    modes = truss_modes()
    of = replace(mirror(percent), natural_frequency=modes.natural_frequency[2])
    coupled = coupled_modes(modes, of, "tip")
    eigenvalue, _ = dense(modes, of)
    assert np.abs(coupled.eigenvalue - eigenvalue).max() < 1e-13 * eigenvalue[-1]
    assert coupled.effective_modal_reaction_inertia.sum() == pytest.approx(1.0, abs=1e-12)
    if percent == 1e-6:
        # Degenerate perturbation: λ/Ω² − 1 = ±√k |φ|/Ω. The other modes' k g detunes the mirror and spoils the
        # even shares by its ratio to the split.
        lam = of.natural_frequency**2
        split = np.sqrt(of.stiffness / lam) * abs(modes.at("tip")[2])
        rest = np.delete(modes.at("tip") ** 2, 2) / np.delete(modes.stiffness - lam, 2)
        detuned = of.stiffness * abs(rest.sum()) / split
        assert detuned < 0.1
        pair = coupled.effective_modal_reaction_inertia[2:4]
        assert pair == pytest.approx([0.5, 0.5], abs=detuned)
        assert coupled.eigenvalue[2:4] / lam - 1 == pytest.approx([-split, split], rel=detuned, abs=0)


@HUBS
def test_a_two_body_system_has_its_closed_form(hub):
    # A free disk and a mirror on a spring: one elastic mode at ω_m √(1 + J_m/J).
    J, of = 3.0, Mirror(0.75, 20.0, 0.0)
    held = hub.type == "held"
    shape = np.full((1, 2), 1 / np.sqrt(J))
    modes = ModalSet(np.array([5.0 if held else 0.0]), np.zeros(1), shape, PORTS, np.ones(1, bool))
    coupled = coupled_modes(modes, of, "tip")
    k, K = of.stiffness, 25.0 * J if held else 0.0
    expected = linalg.eigh(np.array([[K + k, -k], [-k, k]]), np.diag([J, 0.75]), eigvals_only=True)
    assert coupled.eigenvalue == pytest.approx(expected, rel=1e-13, abs=1e-12)
    if not held:
        assert coupled.natural_frequency[1] == pytest.approx(20 * np.sqrt(1.25), rel=1e-14, abs=0)
        assert coupled.effective_modal_reaction_inertia == pytest.approx([0.0, 1.0])


@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_the_separations_of_the_benchmark_problem_are_those_of_table_3_3(dissertation, case):
    loop, modes = reference.benchmark(case)
    coupled = coupled_modes(modes, loop.mirror, "tip")
    elastic = np.flatnonzero(~np.isnan(coupled.zero))
    # Four printed digits.
    assert coupled.participation[elastic] == pytest.approx(
        [dissertation["table_3_3"]["alpha"][case - 1]], abs=1.1e-4
    )


def test_undamped_and_damped_structures_have_the_same_coupled_modes():
    damped = reference.modes_of(reference.structure(), damping=Damping((0.3,)))
    one, other = (coupled_modes(m, mirror(0.2), "tip") for m in (truss_modes(), damped))
    assert np.array_equal(one.eigenvalue, other.eigenvalue)
