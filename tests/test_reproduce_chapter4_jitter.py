"""Chapter 4 of the dissertation, computed again: spectra, and the jitter of table 4.1."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fosopt.control import closed_loop_response
from fosopt.metrics.jitter import resonance_quadrature
from fosopt.reproduce import chapter4_spectra, chapter4_table
from fosopt.reproduce import chapter4_system as system
from fosopt.reproduce.published import PUBLISHED
from fosopt.units import HZ


@pytest.fixture(scope="module")
def table():
    """Table 4.1, and its rows by what they begin with."""
    rows = chapter4_table.table_4_1().comparisons
    return lambda what: next(each for each in rows if each.what.startswith(what))


# --- spectra


@pytest.mark.parametrize("percent", [0.02, 2.0])
def test_the_periodogram_holds_the_mean_square_of_its_record(percent):
    time = system.WINDOW[0] + np.arange(4096) / 4096
    record = system.residual(percent)(time)
    frequency, density = chapter4_spectra.periodogram(percent)
    assert density.sum() * (frequency[1] - frequency[0]) == pytest.approx(record.var(), rel=1e-9)
    assert frequency[-1] > system.coupled(percent).natural_frequency[-1] / HZ


def test_the_tallest_line_beyond_the_bandwidth_is_just_below_400_hz():
    frequency, density = chapter4_spectra.periodogram(0.02)
    beyond = frequency > 302
    assert 380 <= frequency[beyond][np.argmax(density[beyond])] <= 386


def test_inertias_resemble_the_spectrum_less_as_the_mirror_grows():
    rank = [chapter4_spectra.resemblance(percent) for percent in (0.02, 2.0, 20.0)]
    assert rank[0] > 0.95 > rank[1] > 0.5 > rank[2]


def test_energy_of_the_step_is_spread_wider_at_first_and_narrower_soon():
    def width(percent, *span):
        low, high = chapter4_spectra.central(percent, *span)
        return high - low

    assert width(2.0, 0.0, 1e-5) > 1.5 * width(0.02, 0.0, 1e-5)
    assert width(2.0, *system.WINDOW) < 0.5 * width(0.02, *system.WINDOW)
    assert chapter4_spectra.holding(2.0) > 5 * chapter4_spectra.holding(0.02)


# --- jitter


def test_the_rigid_case_gives_what_is_printed():
    for source in chapter4_table.SOURCES.values():
        assert source.jitter(0.02, source.rigid) == pytest.approx(50.0, rel=1e-12)


@pytest.mark.parametrize("percent", [0.02, 0.2])
def test_noise_and_line_of_sight_are_within_half_a_percent_of_the_print(table, percent):
    for name in ("measurement noise m", "line-of-sight disturbance θ_d"):
        shown = table(f"{percent:g} %, {name}")
        assert abs(shown.relative_error) < 0.005


def test_the_cooling_torque_has_the_printed_digits_a_thousandfold(table):
    first, second = (table(f"{p:g} %, mirror cooling torque").computed for p in (0.02, 0.2))
    printed = [PUBLISHED["table_4_1"][key]["force"] for key in ("jm_percent_0_02", "jm_percent_0_20")]
    assert first == pytest.approx(printed[0], rel=1e-3)
    assert second == pytest.approx(1000 * printed[1], rel=2e-3)


@pytest.mark.parametrize("model", ["turning", "reduced"])
def test_the_body_torque_is_counted_right_where_the_free_truss_drifts(model):
    source = chapter4_table.SOURCES["aft_body"]
    of, poles = system.closed(0.02, model)
    near = [p.imag + abs(p.real) * np.sinh(np.linspace(-9, 9, 4001)) for p in poles.value if p.imag > 0]
    frequency = np.unique(np.concatenate([np.geomspace(source.lowest * HZ, 1e5, 400_001), *near]))
    frequency = frequency[frequency >= source.lowest * HZ]
    points = of.points(1j * frequency)
    response = closed_loop_response("hub_torque", of.loop, points.s, points.g)
    density = 2 * np.abs(source.shape.response(points.s) * response) ** 2
    expected = np.sqrt(np.trapezoid(density, frequency) / (2 * np.pi))
    assert source.rms(0.02, model) == pytest.approx(expected, rel=1e-5)


def test_a_torque_of_one_size_moves_a_tenfold_mirror_a_tenth_as_much():
    source = chapter4_table.SOURCES["force"]
    held = replace(source, held=0.02)
    assert held.jitter(0.2) == pytest.approx(0.1 * source.jitter(0.2), rel=1e-9)


def test_a_torque_between_mirror_and_structure_is_not_amplified():
    source = replace(chapter4_table.SOURCES["force"], at="control_torque", lowest=0.0)
    assert source.jitter(0.2) == pytest.approx(50, abs=0.2)
    # By quadrature of the response to a control torque, T/K.
    squares = []
    for model in ("reduced", "rigid"):
        of, poles = system.closed(0.2, model)
        nodes, weights = resonance_quadrature(poles.all, 0.0, np.inf, np.zeros(0))
        points = of.points(1j * nodes)
        pid = of.loop.controller
        k = pid.gain * (pid.kp + pid.ki / points.s + pid.kd * points.s)
        response = closed_loop_response("command", of.loop, points.s, points.g) / k
        squares.append(np.sum(weights * np.abs(response) ** 2))
    assert source.jitter(0.2) == pytest.approx(50 * np.sqrt(squares[0] / squares[1]), rel=1e-6)


def test_the_body_torque_can_be_fitted_which_proves_nothing(table):
    corner, lowest = chapter4_table.needed()
    assert 1 < corner < 20 and 1e-3 < lowest < 1
    shown = table(f"f_h low pass at {corner:.2g} Hz")
    assert shown.computed == "4483.5 / 4632.7"
    assert "no evidence" in shown.note


def test_the_rigid_body_the_band_and_the_place_move_the_torque_numbers_as_the_table_says(table):
    def pair(what):
        return [float(x) for x in table(what).computed.split(" / ")]

    base = pair("f_h low pass at 8.5 Hz")
    # The lowest frequency sets what the rigid truss does, and so the size of the torque.
    assert pair("f_h counted from 0.1 Hz")[0] > 1.5 * base[0]
    assert pair("f_h counted from 1 Hz")[0] > 5 * base[0]
    # Neither it nor the hub changes the ratio of the two inertias; the corner does.
    for what in ("f_h counted from 0.1 Hz", "f_h, hub held"):
        assert pair(what)[1] / pair(what)[0] == pytest.approx(base[1] / base[0], rel=1e-4)
    assert pair("f_h low pass at 1 Hz")[1] / pair("f_h low pass at 1 Hz")[0] < base[1] / base[0] - 0.005
    # Against the flexible truss the same torque gives hardly more than its 50.
    assert pair("f_h of one size")[0] == pytest.approx(50, rel=0.01)
    # The cooling torque, set for each inertia, feels neither hub nor band.
    cooling = pair("f_d wide band, size")
    assert pair("f_d wide band, counted") == pytest.approx(cooling, rel=1e-4)
    assert pair("f_d wide band, hub held") == pytest.approx(cooling, rel=1e-4)
    assert pair("f_d low pass")[1] > 1.5 * cooling[1]
