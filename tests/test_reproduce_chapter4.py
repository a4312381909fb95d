"""Chapter 4 of the dissertation, computed again: entries, stability, inertias, loops and step responses."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal, localcontext
from functools import cache

import numpy as np
import pytest
import reference
from scipy import linalg, optimize

from fosopt.control import closed_loop_state_space, loop_transfer
from fosopt.modes import Damping, Hub
from fosopt.plant import coupled_modes
from fosopt.reproduce import (
    chapter4_inertias,
    chapter4_loops,
    chapter4_spectra,
    chapter4_steps,
    chapter4_table,
)
from fosopt.reproduce import chapter4_system as system
from fosopt.reproduce.judge import agrees
from fosopt.reproduce.published import PUBLISHED
from fosopt.units import HZ

ENTRIES = {
    entry.name: entry
    for module in (chapter4_inertias, chapter4_loops, chapter4_spectra, chapter4_steps, chapter4_table)
    for entry in module.ENTRIES
}
# What every entry comes to, and why it is not "matches".
DIFFERS = {
    "table-4.1": "the torque columns",
    "figure-4.24": "1/J̄_k is small where the spectrum is large",
    "figure-4.25": "energy is not spread wider",
    "figure-4.26": "1/J̄_k is small where the spectrum is large",
}
MODELS = ("reduced", "elastic", "late", "full")
PERCENTS = system.PERCENTS
TIME = np.arange(0.0, 0.1 + 1e-12, 1 / 16384)
LATE = np.flatnonzero(system.WINDOW[0] <= TIME)


@cache
def computed(name):
    return ENTRIES[name].compute()


def row(name, what):
    return next(each for each in computed(name).comparisons if each.what.startswith(what))


def fem(percent):
    """Mass and stiffness of truss and mirror in physical coordinates, and the row that reads the tip's angle."""
    frame = system.frame()
    shapes, eigenvalue = frame.shapes, frame.eigenvalue
    inverse = linalg.inv(shapes)
    mass, stiffness = inverse.T @ inverse, inverse.T * eigenvalue @ inverse
    return mass, stiffness, frame.structure.port("tip"), system.mirror(percent)


# --- entries


def test_every_figure_but_the_block_diagram_has_an_entry():
    assert set(ENTRIES) == {f"figure-4.{n}" for n in range(1, 27) if n != 10} | {"table-4.1"}


@pytest.mark.parametrize("name", ENTRIES)
def test_the_verdict_is_the_expected_one(name):
    found = computed(name)
    assert found.verdict == ("differs" if name in DIFFERS else "matches")
    assert bool(found.reason) == (name in DIFFERS)
    assert bool(found.panels) == name.startswith("figure")


@pytest.mark.parametrize("name", [n for n in ENTRIES if n not in DIFFERS])
def test_a_match_rests_on_a_row_with_a_published_side(name):
    rows = computed(name).comparisons
    assert any(each.published is not None for each in rows)
    assert all(agrees(each) for each in rows)


@pytest.mark.parametrize("name", [n for n in ENTRIES if n.startswith("figure")])
def test_curves_hold_finite_numbers_and_ascend_where_they_are_functions(name):
    for panel in computed(name).panels:
        for curve in panel.curves:
            assert curve.x.shape == curve.y.shape
            if "part" in panel.x_label:
                continue
            assert np.all(np.isfinite(curve.x)) and np.all(np.isfinite(curve.y))
            assert np.all(np.diff(curve.x) > 0)


def test_no_unstable_loop_has_a_jitter_number():
    for name in ("table-4.1", "figure-4.17", "figure-4.25"):
        for each in computed(name).comparisons:
            if each.what.startswith(("2 %", "20 %")) or name == "figure-4.25":
                assert each.unit != "µdu" and isinstance(each.computed, str | float)
                assert name == "figure-4.25" or each.computed == "unstable"
    assert "unstable" in computed("figure-4.25").computed


# --- stability and design


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("percent", system.TABULATED)
def test_stability_is_as_printed_by_the_eigenvalues_of_the_state_matrix(percent, model):
    of, _ = system.closed(percent, model)
    eigenvalue = linalg.eigvals(closed_loop_state_space(of.loop, of.modes, "tip").a)
    # The free rigid body's double zero, which is not the loop's.
    rest = eigenvalue[np.argsort(np.abs(eigenvalue))[2:]]
    assert ("unstable" if rest.real.max() > 0 else "stable") == system.said(percent)
    assert system.stability(percent, model) == system.said(percent)


@pytest.mark.parametrize("percent", system.TABULATED)
def test_the_table_shows_that_verdict_for_every_model(percent):
    shown = row("table-4.1", f"{percent:g} %, stability")
    assert shown.published == shown.computed == system.said(percent)


def test_table_4_1_prints_two_stable_and_two_unstable_systems():
    assert [system.said(percent) for percent in system.TABULATED] == ["stable"] * 2 + ["unstable"] * 2


def test_at_two_percent_a_mode_at_18_hz_grows_slowly():
    for model in ("reduced", "full"):
        (pole,) = system.growing(2.0, model)
        assert pole.imag / HZ == pytest.approx(18.2, abs=0.05)
        assert pole.real == pytest.approx(0.10, abs=0.005)


def test_instability_begins_between_the_stable_and_the_unstable_inertia():
    found = chapter4_steps.least_unstable()
    assert 0.2 < found < 2.0
    modes = system.support("reduced")
    for factor, growing in ((1 - 1e-6, False), (1 + 1e-6, True)):
        a = closed_loop_state_space(system.loop(factor * found), modes, "tip").a
        eigenvalue = linalg.eigvals(a)
        # The mode at 18 Hz crosses the axis.
        near = eigenvalue[np.argmin(np.abs(eigenvalue - 18.2j * HZ))]
        assert (near.real > 0) == growing


def test_a_little_more_damping_than_assumed_would_stabilize_two_percent():
    ratio = chapter4_table.stabilizing_damping(2.0)
    assert 1e-3 < ratio < 2e-3
    for factor, growing in ((0.999, True), (1.001, False)):
        modes = (
            system.frame().modal_set(Hub("free"), Damping((factor * ratio,)), ("hub", "tip")).keep(range(7))
        )
        eigenvalue = linalg.eigvals(closed_loop_state_space(system.loop(2.0), modes, "tip").a)
        assert (eigenvalue[np.abs(eigenvalue) > 1].real.max() > 0) == growing


def test_crossover_and_bandwidth_of_the_design_are_those_of_the_rigid_mirror_by_hand():
    of = system.loop(0.02)
    s = 1j * HZ * np.array([230.0, 302.0])
    pid, body = of.controller, of.mirror
    plant = 1 / (body.inertia * (s**2 + 2 * 0.01 * body.natural_frequency * s + body.natural_frequency**2))
    loop = plant * pid.gain * (s**2 + 600 * s + 50000) / s
    assert abs(loop[0]) == pytest.approx(1, rel=1e-12)
    assert abs(loop[1] / (1 + loop[1])) == pytest.approx(np.sqrt(0.5), rel=1e-4)
    assert row("figure-4.11", "closed-loop bandwidth").note.startswith("302.0 Hz")


# --- inertias and separations


@pytest.mark.parametrize("percent", PERCENTS)
def test_effective_modal_reaction_inertias_sum_to_one(percent):
    share = system.coupled(percent).effective_modal_reaction_inertia
    assert abs(share.sum() - 1) <= 1e-12
    assert share[0] == 0 and np.all(share[1:] > 0)


def test_mirror_and_reference_inertia_have_the_ratios_the_text_gives():
    mass, _, tip, small = fem(PERCENTS[0])
    reference_inertia = 1 / (tip @ linalg.solve(mass, tip))
    chapter = PUBLISHED["chapter_4"]
    # "About": one unit of the last digit given.
    assert small.inertia / reference_inertia == pytest.approx(
        chapter["mirror_inertia_0_002_percent_over_reference_inertia"], abs=0.01
    )
    assert system.mirror(PERCENTS[-1]).inertia / reference_inertia == pytest.approx(
        chapter["mirror_inertia_20_percent_over_reference_inertia"], abs=100
    )
    shown = float(row("figure-4.1", "J_m/J_ref").note.split(",")[0])
    assert shown == pytest.approx(small.inertia / reference_inertia, rel=1e-3)


@pytest.mark.parametrize("percent", PERCENTS[:3])
def test_at_small_coupling_the_fifth_mode_is_the_mirror_by_the_dense_eigenvalue_problem(percent):
    mass, stiffness, tip, mirror = fem(percent)
    h = np.append(tip, -1.0)
    _, shapes = linalg.eigh(
        linalg.block_diag(stiffness, 0.0) + mirror.stiffness * np.outer(h, h),
        linalg.block_diag(mass, mirror.inertia),
    )
    share = mirror.inertia * shapes[-1] * (shapes[-1] - tip @ shapes[:-1])
    assert np.argmax(share) + 1 == PUBLISHED["chapter_4"]["mirror_mode_number"]
    assert row(f"figure-4.{PERCENTS.index(percent) + 1}", "mode with the largest").computed == 5


@pytest.mark.parametrize("percent", PERCENTS)
def test_zeros_of_the_sum_over_coupled_modes_are_the_poles_of_the_uncoupled_structure(percent):
    modes = system.coupled(percent)
    pole, share = modes.eigenvalue[1:], modes.effective_modal_reaction_inertia[1:]
    mass, stiffness, _, _ = fem(percent)
    uncoupled = linalg.eigh(stiffness, mass, eigvals_only=True)[1:]

    def between(k):
        """The root of Eq. (4.10) between two coupled modes, from the nearer one."""
        low, high = pole[k], pole[k + 1]

        def total(from_low, base):
            gap = (pole - base) - from_low
            return float(np.sum(share / gap))

        middle = 0.5 * (high - low)
        base, ends = (low, (0, middle)) if total(middle, low) > 0 else (high, (-middle, 0))
        inside = [ends[0] or 1e-18 * base, ends[1] or -1e-18 * base]
        return base + optimize.brentq(total, *inside, args=(base,), xtol=1e-300, rtol=1e-15, maxiter=500)

    zeros = np.array([between(k) for k in range(pole.size - 1)])
    # The eigenvalue solver errs by rounding of the largest eigenvalue, 1e-11 of the smallest.
    assert np.sqrt(zeros / uncoupled) == pytest.approx(1, abs=1e-10)
    assert np.sqrt(zeros) == pytest.approx(system.support().natural_frequency[1:], rel=1e-10)


@pytest.mark.parametrize("percent", [1e-9, 1e-4, 0.002, 20.0])
def test_separations_are_right_to_eight_digits_in_fifty_digit_arithmetic(percent):
    modes, of = system.support(), system.mirror(percent)
    found = coupled_modes(modes, of, "tip")
    paired = np.flatnonzero(np.isfinite(found.zero))
    with localcontext() as context:
        context.prec = 50
        squares = [Decimal(float(w)) ** 2 for w in modes.natural_frequency]
        weights = [Decimal(float(p)) ** 2 for p in modes.at("tip")]
        stiffness = Decimal(float(of.inertia)) * Decimal(float(of.natural_frequency)) ** 2
        tuned = Decimal(float(of.natural_frequency)) ** 2

        def characteristic(eigenvalue):
            g = sum(p / (square - eigenvalue) for p, square in zip(weights, squares, strict=True))
            return tuned - eigenvalue * (1 + stiffness * g)

        for k in paired:
            guess = Decimal(float(found.one_minus_separation[k]))
            mode = int(np.argmin(np.abs(modes.stiffness - found.zero[k])))
            zero = squares[mode].sqrt()
            # The root lies within a part in 1e8 of the separation that was found.
            near, far = ((zero * (1 - guess * (1 + e))) ** 2 for e in (Decimal("-1e-8"), Decimal("1e-8")))
            assert characteristic(near) * characteristic(far) < 0
    smallest = np.abs(found.one_minus_separation[paired]).min()
    assert smallest < 1e-10 or percent == 20.0
    if percent <= 1e-4:
        assert smallest < 1e-12
        # What a difference of eigenvalues leaves of it.
        naive = 1 - np.sqrt(found.eigenvalue[paired] / found.zero[paired])
        assert np.abs(naive / found.one_minus_separation[paired] - 1).max() > 1e-8


def test_poles_fall_below_the_mirror_and_rise_above_it_in_every_figure():
    for number in range(1, 9):
        assert row(f"figure-4.{number}", "poles below").note == "3 of 3 modes"
        assert row(f"figure-4.{number}", "poles above").note == "57 of 57 modes"


def test_the_reciprocal_modal_inertias_add_up_to_that_of_the_reference_inertia():
    (panel,) = computed("figure-4.9").panels
    mass, _, tip, _ = fem(PERCENTS[0])
    assert panel.curves[0].y.sum() == pytest.approx(tip @ linalg.solve(mass, tip), rel=1e-9)
    assert panel.curves[0].y.size == 61


# --- loops


@pytest.mark.parametrize("name", ["figure-4.11", "figure-4.14", "figure-4.19", "figure-4.21"])
def test_the_phase_is_that_of_the_response_and_never_jumps(name):
    percent, model = chapter4_loops._RESPONSES[name]
    response = chapter4_loops.forward_loop(percent, model)
    of, _ = system.closed(percent, model)
    points = of.points(1j * response.frequency)
    angle = np.degrees(np.angle(loop_transfer(of.loop, points.s, points.g)))
    assert np.abs((response.phase - angle + 180) % 360 - 180).max() < 1e-6
    assert response.phase[0] == pytest.approx(-90, abs=5)
    assert response.phase[-1] == pytest.approx(-90, abs=5)
    # Between samples it turns by less than half a turn: the samples resolve it.
    assert np.abs(np.diff(response.phase)).max() < 90


@pytest.mark.parametrize("name", ["figure-4.11", "figure-4.21"])
def test_every_resonance_has_samples_within_its_width(name):
    percent, model = chapter4_loops._RESPONSES[name]
    frequency = chapter4_loops.forward_loop(percent, model).frequency
    _, poles = chapter4_loops.roots(percent, model)
    for pole in poles[poles.imag > HZ]:
        assert np.count_nonzero(np.abs(frequency - pole.imag) < 2 * abs(pole.real)) >= 3


def test_roots_of_the_loop_make_the_loop():
    percent, model = 0.2, "reduced"
    zeros, poles = chapter4_loops.roots(percent, model)
    of, _ = system.closed(percent, model)
    pid = of.loop.controller
    s = np.array([3.0 + 40.0j, 1.0 + 700.0j])
    points = of.points(s)
    product = [np.prod(at - zeros) / np.prod(at - poles) for at in s]
    expected = pid.gain * pid.kd / of.loop.mirror.inertia * np.array(product)
    assert loop_transfer(of.loop, points.s, points.g) == pytest.approx(expected, rel=1e-9)


def test_more_evenly_spaced_frequencies_miss_fewer_pairs_and_narrow_pairs_are_missed_first(monkeypatch):
    missed = [chapter4_loops.unresolved(percent, "reduced")[0] for percent in system.TABULATED]
    assert missed == sorted(missed, reverse=True) and missed[0] > missed[-1]
    monkeypatch.setattr(chapter4_loops, "_EVEN", 1_000_000)
    assert chapter4_loops.unresolved(0.02, "reduced")[0] < missed[0]


def test_loci_end_at_the_closed_loop_poles_and_begin_at_the_roots_of_the_loop():
    found = chapter4_loops.locus(2.0)
    assert reference.worst_match(found.branches[-1], system.closed(2.0, "reduced")[1].all) < 1e-9
    _, poles = chapter4_loops.roots(2.0, "reduced")
    assert np.abs(np.sort_complex(found.branches[0]) - np.sort_complex(poles)).max() < 1e-6


def test_the_loop_is_conditionally_stable():
    share = chapter4_loops._unstable_share(chapter4_loops.locus(0.2))
    of, _ = system.closed(0.2, "reduced")
    for factor, growing in ((0.97, True), (1.03, False)):
        gain = factor * share * of.loop.controller.gain
        loop = replace(of.loop, controller=replace(of.loop.controller, gain=gain))
        eigenvalue = linalg.eigvals(closed_loop_state_space(loop, of.modes, "tip").a)
        assert (eigenvalue[np.abs(eigenvalue) > 1].real.max() > 0) == growing


# --- step responses


@cache
def simulated(percent, model):
    """Error after a unit step by the matrix exponential of the state space."""
    of, _ = system.closed(percent, model)
    plant = closed_loop_state_space(of.loop, of.modes, "tip")
    column = plant.inputs.index("command")
    size = plant.a.shape[0]
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size], whole[:size, size] = plant.a, plant.b[:, column]
    carried = linalg.expm(whole * (TIME[1] - TIME[0]))
    state, output = np.append(np.zeros(size), 1.0), np.append(plant.c[0], plant.d[0, column])
    found = []
    for _ in TIME:
        found.append(output @ state)
        state = carried @ state
    return np.array(found) - 1


def test_eight_degrees_of_freedom_are_within_the_requirement_and_the_full_order_is_outside_by_simulation():
    required = PUBLISHED["table_3_1"]["jitter_total_udu"] * 1e-6
    for name, model, within in (("figure-4.18", "reduced", True), ("figure-4.20", "full", False)):
        error = simulated(0.002, model)[LATE]
        assert (error.std() <= required) == within
        # Sampling the window leaves a part in a thousand.
        assert row(name, "residual rms").computed == pytest.approx(1e6 * error.std(), rel=5e-3)
        assert row(name, "residual jitter").computed == ("within" if within else "outside") + " requirement"


def test_other_readings_of_seven_modes_are_within_the_requirement_too():
    for model in ("elastic", "late"):
        rms = system.residual(0.002, model).rms(*system.WINDOW)
        assert rms < PUBLISHED["table_3_1"]["jitter_total_udu"] * 1e-6
        shown = row("figure-4.18", f"the same with {system.MODELS[model]}")
        assert shown.computed == pytest.approx(1e6 * rms)


def test_the_strongest_modes_of_the_full_order_residual_lie_just_below_400_hz_by_simulation():
    error = simulated(0.002, "full")[LATE]
    # A window keeps the controller's slow transient away from the lines.
    spectrum = np.abs(np.fft.rfft((error - error.mean()) * np.hanning(error.size), 16 * error.size))
    frequency = np.fft.rfftfreq(16 * error.size, TIME[1] - TIME[0])
    fast = frequency > 150
    peak = frequency[fast][np.argmax(spectrum[fast])]
    assert 370 < peak < 400
    shown = row("figure-4.20", "modes of the largest participation")
    assert shown.computed == "just under 400 Hz" and shown.note.startswith("380.1 Hz and 385.3 Hz")


def test_lines_and_inertias_are_joined_by_the_zero_both_leave():
    for percent in (0.02, 2.0):
        lines, inertia = system.structural_lines(percent)
        assert len(set(lines)) == lines.size == inertia.size == 60
    # At small inertia a line stays at its zero, between which and the coupled pole it lies.
    lines, _ = system.structural_lines(0.002)
    zero = np.sqrt(system.coupled(0.002).zero)
    line = np.abs(system.residual(0.002).pole[lines])
    assert line == pytest.approx(zero[np.isfinite(zero)], rel=1e-4)
