"""What a report shows of a design agrees with its numbers, and holds no more points than can be seen."""

from __future__ import annotations

import json
from itertools import pairwise
from math import pi
from typing import Any

import numpy as np
import pytest
import test_study_structures as structures
from small_studies import STUDIES, analysis

from fosopt.control import loop_transfer
from fosopt.control.loop_phase import loop_transfer_roots
from fosopt.report.pack import packed
from fosopt.study.build import build_problem
from fosopt.study.curves import HEIGHT, WIDTH, visible
from fosopt.study.detail import detail_of
from fosopt.study.load import load_study, parse_study

STEP = "\nstep:\n  command: 3 urad\n  window: [50 ms, 400 ms]\n"
PIXEL = 0.75  # what a curve may be off by


def of(text: str) -> tuple[Any, dict[str, Any]]:
    """Evaluation and detail of a study's start."""
    problem = build_problem(parse_study(text))
    evaluation = problem.evaluate(problem.start, truth=True)
    return evaluation, detail_of(evaluation)


@pytest.fixture(scope="module")
def small() -> tuple[Any, dict[str, Any]]:
    return of(analysis() + STEP)


# ---- curves ----


def off(x, y, kept):
    """Largest distance of the points of a curve from the polyline through the kept ones [px]."""
    across = (x - x.min()) / np.ptp(x) * WIDTH
    up = (y - y.min()) / np.ptp(y) * HEIGHT
    best = np.full(x.size, np.inf)
    for a, b in pairwise(kept):
        ax, ay, bx, by = across[a], up[a], across[b], up[b]
        along = np.clip(
            ((across - ax) * (bx - ax) + (up - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2), 0, 1
        )
        best = np.minimum(best, np.hypot(across - ax - along * (bx - ax), up - ay - along * (by - ay)))
    return best.max()


def test_nothing_that_can_be_seen_is_left_out():
    x = np.linspace(0, 1, 4001)
    smooth = np.sin(9 * x)
    peaked = 1 / (1e-6 + (x - 0.3) ** 2) ** 0.25
    kept = visible(x, smooth, peaked)
    assert off(x, smooth, kept) <= PIXEL
    assert off(x, peaked, kept) <= PIXEL
    assert kept.size < 200
    assert np.argmax(peaked) in kept and {0, 4000} <= set(kept)


def test_a_straight_line_needs_its_ends_and_a_constant_too():
    x = np.linspace(0, 1, 1000)
    assert visible(x, 2 * x, np.ones(1000)).tolist() == [0, 999]


def test_curves_of_one_axis_are_judged_by_its_height():
    x = np.linspace(0, 1, 2001)
    ripple = 1e-3 * np.sin(200 * x)
    assert visible(x, np.vstack([ripple, 0 * x + 1])).size < 20 < visible(x, ripple).size


# ---- structure ----


def test_a_truss_has_its_hub_mirror_and_supports(small):
    detail = small[1]
    kinds = {place["kind"]: place for place in detail["places"]}
    assert kinds["hub"]["xyz"] == [0.0, 0.0]
    assert kinds["mirror"]["port"] == "tip" and kinds["mirror"]["xyz"][0] > 0
    assert "support" in kinds
    assert detail["structure"] is None


def test_a_beam_has_its_stations():
    detail = of(structures.BEAM)[1]
    assert detail["truss"] is None
    beam = detail["structure"]
    assert (beam["kind"], beam["length"], beam["held"]) == ("beam", 7.06, False)
    assert beam["stations"] == {"hub": 0.0, "tip": 7.06, "middle": 3.5, "mount": 5.0}
    held = of(
        structures.BEAM.replace("pinned", "fixed")
        .replace("hub: {type: held, bandwidth: 0.1 Hz, damping_ratio: 0.7}", "hub: {type: fixed}")
        .replace("at: hub_torque", "at: mirror_torque")
    )[1]
    assert held["structure"]["held"] is True


def test_a_chain_has_its_bodies_and_springs():
    problem = build_problem(load_study(STUDIES / "modified-benchmark.yaml"))
    detail = detail_of(problem.evaluate(problem.start, truth=True))
    chain = detail["structure"]
    assert (chain["kind"], chain["bodies"], chain["held"]) == ("chain", ["aft_body", "bench"], False)
    assert chain["inertias"] == [0.22, 0.22]
    # ω² J₁ J₂/(J₁ + J₂) of the two bodies alone.
    assert chain["springs"] == pytest.approx([(2 * pi * 100) ** 2 * 0.11], rel=1e-12)
    assert [(place["kind"], place["at"]) for place in detail["places"]] == [
        ("hub", "aft_body"),
        ("mirror", "bench"),
    ]


# ---- loop ----


def test_the_phase_is_counted_and_equals_that_of_the_loop(small):
    evaluation, detail = small
    bode = detail["bode"]
    s = 2j * pi * np.array(bode["frequency_hz"])
    transfer = loop_transfer(evaluation.design.loop, s, evaluation.model.points(s).g)
    turned = np.exp(1j * np.radians(bode["loop_phase_deg"]))
    # Six digits of a frequency beside a resonance leave this much.
    assert transfer / np.abs(transfer) == pytest.approx(turned, abs=2e-3)
    assert bode["loop_magnitude"] == pytest.approx(np.abs(transfer), rel=2e-3)


def test_every_peak_and_notch_of_the_loop_is_in_the_picture():
    # The mirror's mode is neither a pole of the structure nor one of the closed loop.
    evaluation, detail = of(analysis(("  damping_ratio: 0.01", "  damping_ratio: 0.0002")))
    loop, bode = evaluation.design.loop, detail["bode"]
    roots = np.concatenate(loop_transfer_roots(loop, evaluation.modes, evaluation.model.mirror_port))
    sharp = np.abs(roots)[(roots.imag > 0) & (np.abs(roots.real) < 0.1 * np.abs(roots))]
    exact = np.abs(loop_transfer(loop, 1j * sharp, evaluation.model.points(1j * sharp).g))
    level = 20 * np.log10(bode["loop_magnitude"])
    shown = np.interp(np.log10(sharp / (2 * pi)), np.log10(bode["frequency_hz"]), level)
    assert sharp.size > 15
    # Three quarters of a pixel up or aside; the steepest flanks here rise by a few dB in that.
    assert np.abs(shown - 20 * np.log10(exact)).max() <= 0.02 * np.ptp(level)


def test_every_peak_of_the_sensitivity_is_in_the_picture(small):
    evaluation, detail = small
    peak = max(detail["bode"]["sensitivity"])
    assert peak * evaluation.value("modulus_margin") == pytest.approx(1, rel=0.01)


# ---- jitter ----


def test_spectrum_cumulative_and_shares_agree(small):
    evaluation, detail = small
    total = evaluation.value("jitter_total")
    assert detail["cumulative"]["total"][-1] == pytest.approx(total, rel=1e-5, abs=0)
    names = [d.name for d in evaluation.system.disturbances]
    assert list(detail["cumulative"]) == list(detail["spectrum"]) == ["frequency_hz", *names, "total"]
    spectrum = detail["spectrum"]
    squares = np.sum([np.square(spectrum[name]) for name in names], axis=0)
    # A source six decades below the peak stands at that floor.
    floor = len(names) * (1e-6 * max(spectrum["total"])) ** 2
    assert np.square(spectrum["total"]) == pytest.approx(squares, rel=1e-4, abs=2 * floor)
    found = detail["by_mode"]
    listed = sum(mode["share"] for mode in found["modes"])
    assert listed + found["other_modes"] + found["loop"] == pytest.approx(1, rel=1e-9)
    ends = {name: curve[-1] for name, curve in found["cumulative"].items() if name != "frequency_hz"}
    assert sum(ends.values()) == pytest.approx(1, rel=1e-5)
    assert ends["mode 1"] == pytest.approx(found["modes"][0]["share"], rel=1e-5)
    shares = [abs(mode["share"]) for mode in found["modes"]]
    assert shares == sorted(shares, reverse=True)


def test_the_mean_square_of_the_spectrum_is_the_jitter(small):
    evaluation, detail = small
    frequency, density = (np.array(detail["spectrum"][name]) for name in ("frequency_hz", "total"))
    # Straight lines in a double logarithmic figure, integrated exactly.
    slope = np.diff(np.log(density**2)) / np.diff(np.log(frequency))
    areas = (density[1:] ** 2 * frequency[1:] - density[:-1] ** 2 * frequency[:-1]) / (slope + 1)
    # Three quarters of a pixel of six decades are some percent of a density.
    assert np.sqrt(areas.sum()) / evaluation.value("jitter_total") == pytest.approx(1, rel=0.05)


def test_modes_of_the_table_know_their_share(small):
    detail = small[1]
    by_frequency = {mode["structure_frequency_hz"]: mode["share"] for mode in detail["by_mode"]["modes"]}
    shares = [row["jitter_share"] for row in detail["modes"] if row["jitter_share"] is not None]
    assert len(shares) >= 5
    # The mode that matters most is low enough to be in the table.
    assert max(shares) == pytest.approx(max(by_frequency.values()), rel=1e-12)
    assert max(shares) > 0.01
    for share in shares:
        if abs(share) > min(abs(each) for each in by_frequency.values()):
            assert min(abs(share - each) for each in by_frequency.values()) <= 1e-9 * abs(share)


def test_an_unstable_design_has_a_loop_and_no_jitter():
    problem = build_problem(load_study(STUDIES / "unstable-mirror.yaml"))
    evaluation = problem.evaluate(problem.start, truth=True)
    detail = detail_of(evaluation)
    assert not evaluation.stable
    assert detail["bode"]["loop_phase_deg"] is not None
    assert detail["jitter"] == {}
    assert [detail[name] for name in ("spectrum", "cumulative", "by_mode", "step")] == [None] * 4


# ---- step ----


def test_the_error_in_the_window_has_the_mean_and_rms_of_the_metrics(small):
    evaluation, detail = small
    step = detail["step"]
    assert abs(step["mean"]) == pytest.approx(evaluation.value("step_offset"), rel=1e-9, abs=0)
    assert step["rms"] == pytest.approx(evaluation.value("step_rms"), rel=1e-6, abs=0)
    time, error = np.array(step["window_time_s"]), np.array(step["window_error"])
    assert time[[0, -1]].tolist() == step["window"] == [0.05, 0.4]
    mean = np.trapezoid(error, time) / np.ptp(time)
    rms = np.sqrt(np.trapezoid((error - mean) ** 2, time) / np.ptp(time))
    # Chords between the points that can be seen, up to three quarters of 280 pixels off.
    assert mean == pytest.approx(step["mean"], abs=PIXEL / HEIGHT * np.ptp(error))
    assert rms == pytest.approx(step["rms"], abs=2 * PIXEL / HEIGHT * np.ptp(error))
    assert (step["time_s"][0], step["response"][0], step["time_s"][-1]) == (0.0, 0.0, 0.4)


# ---- size ----


def test_a_point_of_the_full_truss_takes_twenty_two_kilobytes_of_a_report():
    problem = build_problem(load_study(STUDIES / "mass-jitter.yaml"))
    point = {"key": "000", "detail": detail_of(problem.evaluate(problem.start, truth=True))}
    (first, second), trusses = packed([point, point])
    assert len(trusses) == 1
    assert first == second
    assert len(json.dumps(first, separators=(",", ":"))) < 22_000
    assert len(json.dumps(point)) < 60_000
