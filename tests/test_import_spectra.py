"""Measured spectra: what stands between the rows of a table, and amplitude densities and cumulative rms in files."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import inf, pi
from pathlib import Path

import numpy as np
import pytest
from foreign_models import NATIVE, evaluated, study_text
from scipy import integrate

from fosopt.control import closed_loop_response
from fosopt.errors import ModelError, StudyError
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.tabulated import density_between, levels_of_cumulative_rms, table_cuts
from fosopt.problem import Evaluation
from fosopt.study import dump_study, parse_study
from fosopt.study.runner import run_study

HZ = 2 * pi
FREQUENCY = HZ * np.array([0.4, 2.0, 30.0, 31.0, 400.0])
PSD = np.array([3.0, 40.0, 0.5, 0.7, 1e-5])
AFT = "filter: {type: low_pass, corner: 10 Hz, order: 2, rms: 150 N m}"


def start() -> Evaluation:
    """A stable loop on a short truss."""
    return evaluated(study_text(NATIVE), Path())


def variance(disturbance: Disturbance) -> float:
    """Mean square line of sight."""
    found = start()
    return jitter_variances(found.model, found.poles, [disturbance])[0].value


def brute(disturbance: Disturbance, edges: np.ndarray) -> float:
    """The same by adaptive quadrature over pieces, with breaks at resonances."""
    found = start()
    loop = found.design.loop

    def density(w: float) -> float:
        s = np.array([1j * w])
        response = closed_loop_response(disturbance.at, loop, s, found.model.points(s).g)[0]
        return float(disturbance.one_sided_psd(np.array([w]))[0] * abs(response) ** 2 / HZ)

    total = 0.0
    breaks = np.abs(found.poles.all.imag)
    for low, high in pairwise(edges):
        inner = np.unique(np.concatenate([[b * (1 - 1e-3), b, b * (1 + 1e-3)] for b in breaks] or [[]]))
        inner = inner[(inner > low) & (inner < high)]
        parts = np.concatenate([[low], inner, [high]])
        for a, b in pairwise(parts):
            total += integrate.quad(density, a, b, epsabs=0, epsrel=1e-10, limit=400)[0]
    return total


# ---- between the rows ----


def test_a_straight_line_on_logarithmic_axes_is_a_power_law():
    rows, psd = HZ * np.array([1.0, 10.0]), np.array([2.0, 2e-4])
    w = HZ * np.array([0.99, 1.0, 3.0, 10.0, 10.1])
    expected = [0, 2.0, 2.0 * 3.0**-4, 2e-4, 0]
    np.testing.assert_allclose(density_between(rows, rows, psd, "log"), psd, rtol=1e-13)
    np.testing.assert_allclose(density_between(w, rows, psd, "log"), expected, rtol=1e-12)


def test_a_level_holds_from_its_row_to_the_next():
    rows, psd = np.array([1.0, 2.0, 5.0]), np.array([3.0, 7.0, 7.0])
    w = np.array([0.9, 1.0, 1.99, 2.0, 5.0, 5.1])
    np.testing.assert_array_equal(density_between(w, rows, psd, "level"), [0, 3, 3, 7, 7, 0])


def test_at_the_last_row_a_level_still_holds_whatever_that_row_says():
    rows, psd = np.array([1.0, 2.0, 5.0]), np.array([3.0, 7.0, 99.0])
    np.testing.assert_array_equal(density_between(rows, rows, psd, "level"), [3, 7, 7])


@pytest.mark.parametrize("interpolation", ["linear", "log", "level"])
@pytest.mark.parametrize("at", ["hub_torque", "line_of_sight"])
def test_jitter_under_a_table_is_its_integral(interpolation, at):
    table = Disturbance("t", at, frequency=FREQUENCY, psd=PSD, interpolation=interpolation)
    assert variance(table) == pytest.approx(brute(table, FREQUENCY), rel=1e-8, abs=0)


def test_a_power_law_between_two_rows_decades_apart_is_integrated_exactly():
    """On logarithmic axes rows are not enough: pieces end where the frequency doubles."""
    rows = HZ * np.array([0.1, 1000.0])
    table = Disturbance("t", "line_of_sight", frequency=rows, psd=np.array([1e6, 1e-14]), interpolation="log")
    assert variance(table) == pytest.approx(brute(table, np.geomspace(*rows, 60)), rel=1e-8, abs=0)
    cuts = table_cuts(rows, "log")
    assert (cuts[1:] / cuts[:-1]).max() <= 2 * (1 + 1e-12) and cuts[[0, -1]] == pytest.approx(rows)


def test_rows_along_a_power_law_change_nothing():
    """A fall of 100 dB per decade from two rows, and from 161: the same spectrum, to rounding."""
    found = []
    for count in (2, 161):
        rows = HZ * np.geomspace(0.1, 1000.0, count)
        psd = 1e-6 * (rows / rows[0]) ** -10.0
        found.append(variance(Disturbance("t", "sensor_noise", frequency=rows, psd=psd, interpolation="log")))
    assert found[0] == pytest.approx(found[1], rel=1e-11, abs=0)


def test_a_narrower_band_counts_less_of_a_table():
    table = Disturbance("t", "hub_torque", frequency=FREQUENCY, psd=PSD, interpolation="log")
    split = HZ * 17.0
    parts = [replace(table, band=band) for band in ((0.0, split), (split, inf))]
    assert sum(map(variance, parts)) == pytest.approx(variance(table), rel=1e-9, abs=0)


def test_the_gradient_of_jitter_under_a_table_is_that_of_its_value():
    base = start()
    table = Disturbance("t", "hub_torque", frequency=FREQUENCY, psd=PSD, interpolation="log")
    system = replace(base.system, disturbances=(table,))
    value, gradient = Evaluation(system, base.design).metric("jitter_t")
    parameters = base.design.parameters
    for k in (0, parameters.size - 8, parameters.size - 5):
        step = 1e-4 * abs(parameters[k])
        ends = []
        for sign in (1, -1):
            moved = parameters.copy()
            moved[k] += sign * step
            ends.append(Evaluation(system, base.design.with_parameters(moved)).value("jitter_t"))
        # A central difference of 1e-4 errs by about its square, and by rounding over it.
        slope = (ends[0] - ends[1]) / (2 * step)
        assert slope == pytest.approx(gradient[k], rel=1e-5, abs=1e-7 * value / abs(parameters[k]))


def test_a_zero_has_no_place_on_logarithmic_axes():
    for frequency, psd in ((FREQUENCY, np.where(PSD == 0.5, 0.0, PSD)), (FREQUENCY - FREQUENCY[0], PSD)):
        with pytest.raises(ModelError, match="interpolation: linear"):
            Disturbance("t", "hub_torque", frequency=frequency, psd=psd, interpolation="log")


# ---- cumulative rms ----


def test_levels_accumulate_to_the_rms_they_came_from():
    f, rms = np.array([1.0, 3.0, 10.0, 20.0]), np.array([0.0, 0.2, 0.2, 0.5])
    levels = levels_of_cumulative_rms(f, rms)
    np.testing.assert_allclose(np.cumsum(levels[:-1] * np.diff(f)), rms[1:] ** 2, rtol=1e-14)
    assert levels[-1] == levels[-2] > 0
    # From the highest frequency down: the same levels of a table that ends with zero.
    backward = np.sqrt(rms[-1] ** 2 - rms**2)
    np.testing.assert_allclose(levels_of_cumulative_rms(f, backward), levels, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("rms", "message"),
    [
        ([0.0, 0.3, 0.2], "rises or falls throughout"),
        ([0.2, 0.2, 0.2], "rises or falls throughout"),
        ([0.1, 0.2, 0.3], "is 0.1 already at 1 Hz"),
        ([0.3, 0.2, 0.1], "is 0.1 already at 9 Hz"),
    ],
)
def test_a_cumulative_rms_that_tells_no_spectrum_is_refused(rms, message):
    with pytest.raises(ModelError, match=message):
        levels_of_cumulative_rms(np.array([1.0, 3.0, 9.0]), np.array(rms))


# ---- files ----


def with_table(folder, header: str, rows: str, key: str = "psd: t.csv", at: str = "hub_torque"):
    """A study whose disturbance is a table."""
    (folder / "t.csv").write_text(f"frequency_hz,{header}\n{rows}")
    return study_text(NATIVE, (AFT, key), ("at: hub_torque", f"at: {at}"))


def test_an_amplitude_density_is_the_root_of_a_power_density(tmp_path):
    rows = [(1, 9.0), (10, 4.0), (100, 0.01)]
    found = []
    for header, power in (("psd_N m^2/Hz", 1.0), ("asd_N m/sqrt(Hz)", 0.5), ("asd_mN m/sqrt(Hz)", 0.5)):
        unit = 1e3 if "mN" in header else 1.0
        text = "".join(f"{f},{unit * p**power!r}\n" for f, p in rows)
        problem = evaluated(with_table(tmp_path, header, text), tmp_path).system.disturbances[0]
        found.append(problem.psd)
    for psd in found:
        np.testing.assert_allclose(psd, [9.0, 4.0, 0.01], rtol=1e-13)


def test_a_table_of_cumulative_rms_seen_directly_has_that_rms(tmp_path):
    """Where the loop hardly acts, line-of-sight motion is seen as it is."""
    rows = "500,0\n600,1\n900,2.5\n"
    text = with_table(tmp_path, "cumulative_rms_urad", rows, "cumulative_rms: t.csv", "line_of_sight")
    found = evaluated(text.replace("crossover: 60 Hz", "gain: 1.0e-9 N m s/rad"), tmp_path)
    assert found.value("jitter_aft") == pytest.approx(2.5e-6, rel=1e-6, abs=0)


def test_a_run_keeps_its_tables(tmp_path):
    rows = "1,0\n30,1\n90,2.5\n"
    text = with_table(tmp_path, "cumulative_rms_N m", rows, "cumulative_rms: t.csv")
    study = parse_study(text, tmp_path)
    assert parse_study(dump_study(study), tmp_path) == study
    run_study(study, tmp_path / "out")
    kept = (tmp_path / "out" / "study.yaml").read_text()
    assert "cumulative_rms: inputs/0-t.csv" in kept
    parse_study(kept, tmp_path / "out")


@pytest.mark.parametrize(
    ("header", "rows", "key", "message"),
    [
        (
            "cumulative_rms_urad",
            "1,0\n2,1\n",
            "cumulative_rms: t.csv",
            "t.csv:1:14: 'cumulative_rms_urad' names no cumulative rms",
        ),
        ("psd_N m^2/Hz", "1,0\n2,1\n", "cumulative_rms: t.csv", "write cumulative_rms_N m"),
        ("cumulative_rms_N m", "1,0\n2,1\n", "psd: t.csv", "write psd_N m^2/Hz or asd_N m/sqrt(Hz)"),
        ("cumulative_rms_N m", "1,0\n2,x\n", "cumulative_rms: t.csv", "t.csv:3:3: 'x' is not a rms"),
        (
            "cumulative_rms_N m",
            "1,1\n2,2\n",
            "cumulative_rms: t.csv",
            "t.csv:1: the cumulative rms is 1 already at 1 Hz",
        ),
        (
            "psd_N m^2/Hz",
            "1,1\n2,0\n",
            "psd: t.csv, interpolation: log",
            "t.csv:3: a density of zero has no place",
        ),
        (
            "psd_N m^2/Hz",
            "1,1\n2,1\n",
            "psd: t.csv, band: [1 Hz, 5 Hz]",
            "the band of 'aft' leaves the table, which covers 1 to 2 Hz",
        ),
        (
            "psd_N m^2/Hz",
            "1,1\n2,1\n",
            "psd: t.csv, band: [0.5 Hz, 2 Hz]",
            "narrow the band or extend the table",
        ),
        ("psd_N m^2/Hz", "1,1\n2,1\n", "psd: t.csv, interpolation: cubic", "'cubic' is not allowed"),
        (
            "cumulative_rms_N m",
            "1,0\n2,1\n",
            "cumulative_rms: t.csv, interpolation: log",
            "'interpolation' belongs to a 'psd'",
        ),
        ("psd_N m^2/Hz", "1,1\n2,1\n", "psd: t.csv, cumulative_rms: t.csv", "exclude each other"),
    ],
)
def test_a_table_that_tells_no_spectrum_is_refused_with_its_place(tmp_path, header, rows, key, message):
    with pytest.raises(StudyError) as caught:
        parse_study(with_table(tmp_path, header, rows, key), tmp_path)
    assert message in str(caught.value)


# ---- requirement lines ----


LINE = "requirement_line: line.csv\n"


def test_a_requirement_line_is_kept_with_the_run_in_hertz_and_radians(tmp_path):
    (tmp_path / "line.csv").write_text("frequency_hz,cumulative_rms_urad\n1,0.5\n10,2\n100,2\n")
    run = run_study(parse_study(study_text(NATIVE) + LINE, tmp_path), tmp_path / "out")
    assert run["requirement_line"]["frequency_hz"] == pytest.approx([1, 10, 100], rel=1e-14, abs=0)
    assert run["requirement_line"]["rms"] == pytest.approx([0.5e-6, 2e-6, 2e-6], rel=1e-14, abs=0)
    assert "requirement_line: inputs/0-line.csv" in (tmp_path / "out" / "study.yaml").read_text()
    parse_study((tmp_path / "out" / "study.yaml").read_text(), tmp_path / "out")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frequency_hz,cumulative_rms_urad\n1,2\n10,1\n", "line.csv:3: the allowance falls from 2 to 1"),
        (
            "frequency_hz,cumulative_rms_N m\n1,1\n10,2\n",
            "line.csv:1:14: 'cumulative_rms_N m' names no cumulative rms",
        ),
        ("frequency_hz,rms\n1,1\n10,2\n", "line.csv:1:14: 'rms' names no cumulative rms"),
        ("frequency_hz,cumulative_rms_urad\n1,1\n10,nan\n", "line.csv:3:4: 'nan' is not a rms"),
    ],
)
def test_a_requirement_line_that_allows_nothing_definite_is_refused(tmp_path, text, message):
    (tmp_path / "line.csv").write_text(text)
    with pytest.raises(StudyError) as caught:
        parse_study(study_text(NATIVE) + LINE, tmp_path)
    assert message in str(caught.value)


def test_a_requirement_line_that_is_missing_is_refused_with_its_place(tmp_path):
    with pytest.raises(StudyError, match=r"study.yaml:\d+:19: requirement_line: .*line.csv: no such file"):
        parse_study(study_text(NATIVE) + LINE, tmp_path)
