"""Chapter 3 of the dissertation, computed again: what must hold, and what does not."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import linalg

from fosopt.control import closed_loop_state_space
from fosopt.metrics.disturbances import Disturbance
from fosopt.modes import modal_frame
from fosopt.plant import coupled_modes
from fosopt.reproduce import (
    chapter3_cases,
    chapter3_flexibility,
    chapter3_jitter,
    chapter3_retargeting,
    chapter3_rigid,
)
from fosopt.reproduce import chapter3_system as system
from fosopt.reproduce.judge import agrees
from fosopt.reproduce.published import PUBLISHED
from fosopt.structure import Chain, assemble_chain, two_body_stiffness
from fosopt.units import HZ

ENTRIES = {
    entry.name: entry
    for module in (
        chapter3_cases,
        chapter3_flexibility,
        chapter3_jitter,
        chapter3_retargeting,
        chapter3_rigid,
    )
    for entry in module.ENTRIES
}
# Drawings and block diagrams.
NOT_PLOTTED = {2, 4, 5, 10, 12}

# What every entry comes to, and why it is not "matches".
DIFFERS = {
    "table-3.1": "the three budgets add to 103.9, not 100",
    "table-3.2": "the total jitter is 103.92, above what the table allows",
    "table-3.3": "one printed number is off by 3e-4, another cut off",
    "table-3.4": "the force column",
    "figure-3.11": "nearly 2.3",
    "figure-3.42": "the seventh engagement is not the calmest",
    "figure-3.43": "nor does the vibration grow from there",
}
OPEN = {
    "figure-3.6",
    "figure-3.7",
    "figure-3.8",
    "figure-3.9",
    "figure-3.17",
    "figure-3.18",
    "figure-3.24",
} | {
    "figure-3.32",
    "figure-3.41",
}
NUMBERS = {name: case for name, case in PUBLISHED["table_3_4"].items() if isinstance(case, dict)}


@cache
def computed(name):
    return ENTRIES[name].compute()


def row(name, what):
    return next(each for each in computed(name).comparisons if each.what == what)


def case_of(name):
    return system.smd() if name == "rigid" else system.case(int(name[-1]))


def test_every_plotted_figure_and_every_table_has_an_entry():
    expected = {f"figure-3.{n}" for n in range(1, 44) if n not in NOT_PLOTTED}
    assert set(ENTRIES) == expected | {f"table-3.{n}" for n in range(1, 5)}


@pytest.mark.parametrize("name", ENTRIES)
def test_the_verdict_is_the_expected_one(name):
    expected = "differs" if name in DIFFERS else "not determinable" if name in OPEN else "matches"
    found = computed(name)
    assert found.verdict == expected
    assert bool(found.reason) == (expected != "matches")
    assert bool(found.panels) == name.startswith("figure")


@pytest.mark.parametrize("name", [n for n in ENTRIES if n not in DIFFERS and n not in OPEN])
def test_a_match_rests_on_a_row_with_a_published_side(name):
    assert any(each.published is not None for each in computed(name).comparisons)
    assert all(agrees(each) for each in computed(name).comparisons)


# --- table 3.3


def test_table_3_3_agrees_to_the_printed_digits_but_for_two():
    apart = {each.what: each for each in computed("table-3.3").comparisons if not agrees(each)}
    assert set(apart) == {"case 3, φ_a/(φ_a + φ_k)", "case 4, φ_a/(φ_a + φ_k)"}
    off = {name: each.computed - each.published for name, each in apart.items()}
    assert off["case 3, φ_a/(φ_a + φ_k)"] == pytest.approx(3e-4, abs=0.5e-4)
    # This one was cut off instead of rounded.
    assert 0.5e-4 < off["case 4, φ_a/(φ_a + φ_k)"] < 1e-4


def test_the_parameters_of_table_3_3_follow_from_modes_by_the_secular_equation_too():
    for number in (1, 2, 3, 4):
        of = system.case(number).model
        modes = coupled_modes(of.modes, of.loop.mirror, "tip")
        share = modes.effective_modal_reaction_inertia
        found = row("table-3.3", f"case {number}, φ_a/(φ_a + φ_k)").computed
        assert found == pytest.approx(share.max() / share.sum(), rel=1e-9)
        alpha = np.delete(modes.participation, modes.mirror_mode)[-1]
        assert row("table-3.3", f"case {number}, α_k").computed == pytest.approx(alpha, rel=1e-9)


def test_unequal_masses_do_not_give_table_3_3():
    printed = PUBLISHED["table_3_3"]["alpha"][0]
    found = {}
    for share in (0.45, 0.5, 0.55):
        near = share * system.SUPPORT_MASS
        masses = {"m1": system.SUPPORT_MASS - near, "m2": near}
        chain = Chain(masses, (two_body_stiffness(system.FREQUENCIES[0] * HZ, *masses.values()),))
        built = assemble_chain(chain)
        modes = modal_frame(built, built.area, built.batten_mass, 0.0, "tip").modal_set(
            system.FREE, system.DAMPING, system.PORTS
        )
        coupled = coupled_modes(modes, system.MIRROR, "tip")
        found[share] = np.delete(coupled.participation, coupled.mirror_mode)[-1]
    assert found[0.5] == pytest.approx(printed, abs=0.5e-4)
    assert abs(found[0.45] - printed) > 0.01
    assert abs(found[0.55] - printed) > 0.01


# --- table 3.4


@pytest.mark.parametrize("source", ["displacement", "noise"])
@pytest.mark.parametrize("name", NUMBERS)
def test_displacement_and_noise_columns_are_within_one_percent(name, source):
    found = case_of(name).rms([system.disturbance(source)])[0] / system.UDU
    assert found == pytest.approx(NUMBERS[name][source], rel=0.01)
    label = name.replace("_", " ")
    assert row("table-3.4", f"{label}, {source}").computed == pytest.approx(found, rel=1e-12)


def test_a_spectrum_far_below_the_loop_does_not_fit_the_displacement_column():
    # Case 1 resonates at 1 Hz: a low pass that ends there gives it more.
    unit = [Disturbance("d", "line_of_sight", system.shape("displacement", 1.0))]
    ratio = system.case(1).rms(unit)[0] / system.smd().rms(unit)[0]
    printed = PUBLISHED["table_3_4"]
    assert ratio > 1.03 * printed["case_1"]["displacement"] / printed["rigid"]["displacement"]
    fits = row("table-3.4", "displacement: corners with the column within 1 %").computed
    assert fits == "4 to 128 Hz"


@pytest.mark.parametrize("source", system.SOURCES)
def test_the_inputs_have_the_size_that_gives_the_rigid_support_its_row(source):
    found = system.smd().rms([system.disturbance(source)])[0] / system.UDU
    assert found == pytest.approx(PUBLISHED["table_3_4"]["rigid"][source], rel=1e-12)


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_stability_is_as_printed_and_as_the_state_matrix_has_it(number):
    of = system.case(number)
    printed = PUBLISHED["table_3_4"][f"case_{number}"]
    assert (of.stability == "unstable") == (printed == "unstable")
    poles = linalg.eigvals(closed_loop_state_space(of.model.loop, of.model.modes, "tip").a)
    # Two of them are the free rigid body's, zero to the square root of rounding.
    poles = poles[np.argsort(np.abs(poles))[2:]]
    assert poles.real.max() == pytest.approx(of.poles.spectral_abscissa, abs=1e-6)


def test_case_2_grows_slowly():
    assert system.case(2).poles.spectral_abscissa == pytest.approx(0.114, abs=5e-4)


def test_a_drifting_support_hides_what_tells_cases_3_and_4_apart():
    drift = chapter3_jitter.Assumption("free", lowest_hz=0.1)
    assert drift.jitter(3) == pytest.approx(drift.jitter(4), rel=1e-3)
    printed = PUBLISHED["table_3_4"]
    assert drift.jitter(4) > 10 * printed["case_4"]["force"]
    assert printed["case_3"]["force"] > 1.2 * printed["case_4"]["force"]


def test_the_drift_goes_with_the_lowest_frequency_counted():
    # The output goes as 1/s with integral action, so that its power above ω goes as 1/ω.
    low, lower = (chapter3_jitter.Assumption("free", lowest_hz=hz).jitter(4) for hz in (1e-3, 1e-5))
    assert lower / low == pytest.approx(10.0, rel=0.02)


def test_an_internal_force_is_not_amplified_by_the_support():
    between = chapter3_jitter.Assumption("free", internal=True)
    for number in (1, 3, 4):
        assert between.jitter(number) < PUBLISHED["table_3_4"]["rigid"]["force"]


def test_a_flat_spectrum_would_need_the_stated_densities():
    for number in (1, 3):
        density = chapter3_jitter.needed_density(number)
        # Independently: the mean square of a resonance, |r|²/(2 σ) at density one, from its pole and residue.
        of = system.without_rigid_body(number)
        mode = int(np.argmin(np.abs(of.poles.value - 1j * HZ * of.structure_hz)))
        pole = of.poles.value[mode]
        beside = of.closed("mirror_torque", np.array([pole.imag]))[0]
        residue = beside * -pole.real
        power = np.abs(residue) ** 2 / (-2 * pole.real)
        printed = PUBLISHED["table_3_4"]
        more = printed[f"case_{number}"]["force"] ** 2 - printed["rigid"]["force"] ** 2
        grid = np.geomspace(1e-2, 1e6, 200001)
        rigid = np.trapezoid(np.abs(system.smd().closed("mirror_torque", grid)) ** 2, grid) / np.pi / 2
        flat = printed["rigid"]["force"] ** 2 / rigid
        # A lone resonance holds the power to the share of what the rest of the loop has in its band.
        assert density == pytest.approx(more / power / flat, rel=1e-2 if number == 1 else 0.5)


# --- the rigid support


def test_table_3_2_settles_and_dwells_as_printed():
    assert agrees(row("table-3.2", "settling time to the rms window"))
    assert agrees(row("table-3.2", "dwell time in the window"))
    # Zero to the digits of the print, and to rounding when the transient has gone.
    assert agrees(row("table-3.2", "offset error"))
    assert system.smd().step(np.array([1.0]))[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", ["rigid", "case_3"])
def test_the_crossover_is_approximately_the_printed_one(name):
    # Within one unit of the last digit of "approximately 230 Hz" that is not zero.
    found = chapter3_rigid.crossover_row(case_of(name))
    assert found.published == found.computed
    assert float(found.note.split(" Hz")[0]) == pytest.approx(PUBLISHED["benchmark"]["crossover_hz"], abs=10)
    loop = case_of(name).loop_gain(np.array([float(found.note.split(" Hz")[0]) * HZ]))
    assert abs(loop[0]) == pytest.approx(1.0, rel=1e-3)


# --- figures


@pytest.mark.parametrize(
    ("name", "number"), [("figure-3.19", 1), ("figure-3.27", 2), ("figure-3.34", 3), ("figure-3.38", 4)]
)
def test_a_plotted_forward_loop_reaches_the_bottom_of_its_antiresonance(name, number):
    curve = computed(name).panels[0].curves[0]
    zero = system.FREQUENCIES[number - 1]
    near = (curve.x > 0.99 * zero) & (curve.x < 1.01 * zero)
    fine = np.linspace(0.9995, 1.0005, 4001) * zero * HZ
    bottom = 20 * np.log10(np.abs(system.case(number).loop_gain(fine))).min()
    assert curve.y[near].min() == pytest.approx(bottom, abs=0.1)


def test_the_plotted_phase_is_that_of_the_loop():
    of = system.case(3)
    response = of.open_response(0.1, 1e3)
    assert np.exp(1j * np.radians(response.phase)) == pytest.approx(
        response.value / np.abs(response.value), abs=1e-9
    )
    assert response.phase[0] == pytest.approx(-90, abs=1)


def test_only_case_2_falls_below_0_db_at_its_zero():
    for number, sign in ((1, 1), (2, -1)):
        zero = HZ * system.FREQUENCIES[number - 1]
        assert np.sign(np.log(np.abs(system.case(number).loop_gain(np.array([zero]))[0]))) == sign


def test_the_vibration_of_case_4_is_least_in_the_second_engagement():
    amplitude = chapter3_retargeting.vibration(system.case(4))
    least = PUBLISHED["section_3_4"]["least_vibration_engagement"]
    assert amplitude.argmin() + 1 == 2 != least
    # A geometric series: each engagement adds one step and keeps a share of what there was.
    mode = int(np.argmax(system.case(4).poles.value.imag))
    carried = -np.exp(system.case(4).poles.value[mode] * system.RETARGETING.period)
    series = np.abs((1 - carried ** np.arange(1, 11)) / (1 - carried))
    assert amplitude == pytest.approx(amplitude[0] * series, rel=1e-9)
    # After six engagements what is left of the first is too little to make the seventh the least.
    assert abs(carried) ** 6 < 0.06


def test_case_3_is_nearly_two_orders_of_magnitude_above_its_jitter():
    found = system.case(3).engagements.rms[0] / system.UDU / PUBLISHED["table_3_1"]["jitter_total_udu"]
    assert 10**1.5 < found < 100


def test_the_factor_of_figure_3_11_is_that_of_a_soft_support_and_not_the_printed_one():
    said = PUBLISHED["section_3_3"]
    ratio = said["actuated_share"] / (1 - said["actuated_share"])
    # On a support without stiffness the actuated mass swings against half of the support's.
    soft = np.sqrt(1 + 2 * ratio)
    found = row("figure-3.11", "factor on the frequency of the actuated mass at 70 %").computed
    assert found == pytest.approx(soft, rel=1e-3)
    assert found - said["frequency_factor"] > 0.05
