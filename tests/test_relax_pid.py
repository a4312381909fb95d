"""PID controllers in boxes of gains: bounds over boxes, proofs of instability, and the best one, certified."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import control_bounds as shared
import numpy as np
import pytest
from control_bounds import BENCHMARK, NOISE, TRUSS, WIDE
from reference import HZ
from test_placement import case as placed

from fosopt.control import PID, closed_loop_poles, gain_for_crossover
from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance, white
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.margins import modulus_margins
from fosopt.relax.performance_limit import performance_limit
from fosopt.relax.pid_bound import best_pid
from fosopt.relax.pid_box import Boxes, PidBox, box_of_crossovers
from fosopt.relax.pid_relaxation import relaxation
from fosopt.relax.pid_stability import encircles, judge

EVERY_CASE = pytest.mark.parametrize("case", shared.CASES)


# Bounds over boxes


def boxes_about(box: PidBox, rng: np.random.Generator, count: int, decades: float) -> Boxes:
    """Random boxes of gains within another."""
    whole = box.whole
    middle = box.at(rng.random((count, 4)))
    width = 10 ** (decades * rng.random((count, 4)))
    return Boxes(
        np.clip(middle / width, whole.low, whole.high), np.clip(middle * width, whole.low, whole.high)
    )


RELAXED = {
    "case 2": (lambda: shared.benchmark(2), BENCHMARK, WIDE),
    "gain and factors": (
        lambda: shared.benchmark(3),
        BENCHMARK,
        PidBox((100, 1e4), (10, 6e3), (100, 5e6), (1, 1)),
    ),
    "roll-off": (lambda: shared.benchmark(1), BENCHMARK, replace(WIDE, rolloff_time=3e-4)),
    "everything free": (
        lambda: shared.benchmark(4),
        BENCHMARK,
        PidBox((10, 1e4), (10, 6e3), (100, 5e6), (0.1, 1)),
    ),
    "bands": (
        lambda: shared.benchmark(3),
        tuple(replace(d, band=(1.0, 1e4)) for d in BENCHMARK),
        WIDE,
    ),
    "truss": (lambda: shared.truss(2.0, bays=4), TRUSS, PidBox((1, 1), (1e3, 1e8), (1e4, 1e12), (1e2, 1e6))),
    "sensor on the structure": (
        lambda: placed("sensor on the structure").model,
        TRUSS,
        PidBox((1, 1), (1.0, 1e4), (1e2, 1e6), (1e-3, 1e2)),
    ),
}
EVERY_RELAXATION = pytest.mark.parametrize(("model", "disturbances", "box"), RELAXED.values(), ids=RELAXED)


@EVERY_RELAXATION
@pytest.mark.parametrize("decades", [1.0, 0.1, 0.01])
def test_no_controller_in_a_box_passes_the_bound_of_the_box(model, disturbances, box, decades):
    limit = performance_limit(model(), disturbances)
    on_nodes = relaxation(limit, limit.open_loop.spectra(limit.open_loop.nodes(1e-2)), box.rolloff_time)
    rng = np.random.default_rng(1)
    boxes = boxes_about(box, rng, 60, decades)
    bounds, _ = on_nodes.bounds(boxes)
    tightest = np.full(60, inf)
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * 4)).reshape(4, -1).T
    for share in (*corners, *rng.random((40, 4))):
        gains = boxes.low * np.where(boxes.high > boxes.low, boxes.high / boxes.low, 1.0) ** share
        value = on_nodes.variance(gains)
        assert np.all(value >= bounds * (1 - 1e-9))
        tightest = np.minimum(tightest, value)
    if decades == 0.01:
        # Small boxes are bounded closely.
        assert np.median(bounds / tightest) > 0.9


def test_close_to_the_best_controller_the_bound_errs_by_the_square_of_the_box():
    model, best = shared.benchmark(3), np.array([1.0, 1.422750e6, 1.960355e8, 2075.19])
    limit = performance_limit(model, BENCHMARK)
    on_nodes = relaxation(limit, limit.open_loop.spectra(limit.open_loop.nodes(1e-3)), 0.0)
    widths = np.array([1.04, 1.02, 1.01])
    boxes = Boxes(best * np.outer(1 / widths, [0, 1, 1, 1]), best * np.outer(widths, [0, 1, 1, 1]))
    boxes = Boxes(np.where(boxes.low == 0, 1.0, boxes.low), np.where(boxes.high == 0, 1.0, boxes.high))
    short = on_nodes.variance(best[None])[0] - on_nodes.bounds(boxes)[0]
    assert np.all(short > 0)
    assert np.all(np.log2(short[:-1] / short[1:]) > 1.6)


@EVERY_RELAXATION
def test_over_a_tiny_box_the_bound_is_the_least_corner(model, disturbances, box):
    limit = performance_limit(model(), disturbances)
    on_nodes = relaxation(limit, limit.open_loop.spectra(limit.open_loop.nodes(1e-2)), box.rolloff_time)
    boxes = boxes_about(box, np.random.default_rng(5), 60, 1e-5)
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * 4)).reshape(4, -1).T
    least = np.min([on_nodes.variance(boxes.low + c * (boxes.high - boxes.low)) for c in corners], axis=0)
    # Changes of the first order, here 1e-5 and more, are met but for those of the second.
    assert np.median(1 - on_nodes.bounds(boxes)[0] / least) < 1e-7


def test_a_bound_over_a_single_controller_is_its_jitter():
    limit = performance_limit(shared.benchmark(3), BENCHMARK)
    on_nodes = relaxation(limit, limit.open_loop.spectra(limit.open_loop.nodes(1e-2)), 0.0)
    gains = np.array([[1300.0, 600.0, 5e4, 1.0]])
    assert on_nodes.bounds(Boxes(gains, gains))[0] == pytest.approx(on_nodes.variance(gains), rel=1e-9, abs=0)


@pytest.mark.parametrize("margin", [0.3, 0.7])
def test_controllers_of_boxes_that_come_too_close_have_less_than_the_margin(margin):
    model = shared.benchmark(3)
    limit = performance_limit(model, BENCHMARK)
    on_nodes = relaxation(limit, limit.open_loop.spectra(limit.open_loop.nodes(1e-2)), 0.0)
    boxes = boxes_about(WIDE, np.random.default_rng(2), 200, 0.3)
    close = on_nodes.too_close(boxes, margin)
    assert 5 < close.sum() < 195
    for gains in boxes.take(close).middle:
        here = replace(model, loop=replace(model.loop, controller=WIDE.controller(gains)))
        poles = closed_loop_poles(here.loop, here.modes, "tip")
        assert modulus_margins(here, poles, 1)[0][0] < margin


@pytest.mark.parametrize(
    ("model", "box"),
    [
        (lambda: shared.benchmark(2), WIDE),
        (lambda: shared.truss(2.0, bays=6), PidBox((1, 1), (1e3, 1e8), (1e4, 1e12), (1e2, 1e6))),
        (
            lambda: placed("sensor on the structure").model,
            PidBox((1, 1), (1.0, 1e6), (1e2, 1e9), (1e-3, 1e4)),
        ),
    ],
    ids=["case 2", "truss", "sensor on the structure"],
)
def test_no_controller_of_a_hopeless_box_is_stable(model, box):
    model, rng = model(), np.random.default_rng(3)
    low, high = np.concatenate([boxes_about(box, rng, 60, size).absolute for size in (1.0, 0.3)], axis=1)
    hopeless = np.array([judge(model, *ends, 0.0).hopeless for ends in zip(low, high, strict=True)])
    assert hopeless.sum() > 5
    for k in np.flatnonzero(hopeless):
        corners = np.array(np.meshgrid(*[[0.0, 1.0]] * 3)).reshape(3, -1).T
        for share in (*corners, *rng.random((4, 3))):
            pid = PID(1.0, *(low[k] * (high[k] / low[k]) ** share))
            loop = replace(model.loop, controller=pid)
            assert closed_loop_poles(loop, model.modes, "tip").spectral_abscissa >= 0


def test_only_a_curve_around_zero_that_no_change_moves_across_it_encircles_zero():
    circle = np.exp(2j * np.pi * np.arange(32) / 32)
    still = np.zeros(32)
    assert encircles(0.5 + circle, still)
    assert not encircles(1.5 + circle, still)
    assert not encircles(circle[::-1], still)
    # Its nearest point is half away from zero; what the curve bends by between points is taken off.
    assert encircles(0.5 + circle, still + 0.45)
    assert not encircles(0.5 + circle, still + 0.5)
    assert not encircles(0.5 + circle, np.where(np.arange(32) == 16, 0.6, 0.0))
    assert not encircles(np.ones(32, dtype=complex), still)


# The best one


@EVERY_CASE
def test_the_best_pid_controller_of_the_benchmark_problems_is_certified_within_two_percent(case):
    model = shared.benchmark(case)
    found = best_pid(model, BENCHMARK, WIDE, gap=0.02, time_limit=30.0)
    assert found.finished and not found.hurried
    assert found.gap <= 0.02
    assert found.jitter == pytest.approx(shared.jitter(model, BENCHMARK, found.controller), rel=1e-12)
    assert found.limit.bound.value <= found.bound.value <= found.jitter
    others = [shared.jitter(model, BENCHMARK, pid) for pid in shared.controllers(WIDE, 300)]
    assert np.isfinite(others).sum() > 50
    assert min(others) >= found.bound.value
    assert min(others) > 0.999 * found.jitter


def wide_box(model: LoopModel) -> PidBox:
    """Absolute gains over five to seven decades, those of a rigidly supported mirror in the middle."""
    inertia = float(model.loop.mirror.inertia)
    ranges = ((1e4, 1e9), (1e6, 1e13), (1e2, 1e7))
    kp, ki, kd = ((low * inertia, high * inertia) for low, high in ranges)
    return PidBox((1.0, 1.0), kp, ki, kd)


def test_the_best_pid_controller_of_a_truss_is_certified():
    model = shared.truss(2.0)
    found = best_pid(model, TRUSS, wide_box(model), gap=0.1, time_limit=60.0)
    assert found.finished
    assert found.gap <= 0.1


def test_a_controller_known_before_is_a_start_that_is_never_lost():
    model = shared.benchmark(3)
    start = PID(1.0, 1.42e6, 1.96e8, 2075.0)
    found = best_pid(model, BENCHMARK, WIDE, gap=0.05, start=start)
    assert found.jitter <= shared.jitter(model, BENCHMARK, start)
    # Rounding may put a design at the edge of a box a little outside.
    edge = replace(WIDE, kp=(1e4, start.kp * (1 - 1e-12)))
    assert edge.contains(start)
    assert not edge.contains(replace(start, kp=1.01 * start.kp))
    assert best_pid(model, BENCHMARK, edge, gap=0.05, start=start).jitter <= 1.01 * found.jitter


def test_a_margin_rules_out_better_controllers():
    model = shared.truss(2.0)
    free, held = (
        best_pid(model, TRUSS, wide_box(model), gap=0.1, modulus_margin=margin) for margin in (0.0, 0.7)
    )
    assert free.finished
    assert held.finished
    here = replace(model, loop=replace(model.loop, controller=held.controller))
    poles = closed_loop_poles(here.loop, here.modes, "tip")
    assert modulus_margins(here, poles, 1)[0][0] >= 0.7 * (1 - 1e-5)
    # What the margin costs is more than the gap admits.
    assert held.jitter > 1.03 * free.jitter
    assert held.bound.value > free.bound.value
    assert "0.7" in held.bound.of


def test_a_stable_controller_is_found_where_many_unstable_ones_would_have_less_jitter():
    # The box of the study that certifies a front, most of which is unstable or short of the margin.
    box = PidBox((1.0, 1.0), (0.3, 3e7), (20.0, 1e11), (0.03, 2e4))
    found = best_pid(shared.truss(0.2, bays=8), TRUSS, box, gap=0.99, modulus_margin=0.5, time_limit=0.0)
    assert found.controller is not None
    assert found.jitter < 1.5 * found.limit.bound.value


def test_when_time_is_up_the_bound_still_holds():
    model = shared.truss(2.0)
    found = best_pid(model, TRUSS, wide_box(model), gap=1e-4, time_limit=0.1)
    assert found.hurried and not found.finished
    assert 1e-4 < found.gap < 1
    assert found.limit.bound.value * (1 - 1e-6) <= found.bound.value < found.jitter


def test_a_box_without_a_stabilizing_controller_is_proved_to_have_none():
    # Around the dissertation's controller, case 2 is unstable.
    box = PidBox((1000, 1500), (500, 700), (4e4, 6e4), (1, 1))
    found = best_pid(shared.benchmark(2), BENCHMARK, box, time_limit=30.0)
    assert found.finished
    assert found.controller is None
    assert found.bound.value == inf
    assert found.jitter == inf


def test_the_best_of_one_controller_is_that_one():
    model = shared.benchmark(3)
    pid = model.loop.controller
    box = PidBox(*((value, value) for value in (pid.gain, pid.kp, pid.ki, pid.kd)))
    found = best_pid(model, BENCHMARK, box)
    assert found.jitter == pytest.approx(shared.jitter(model, BENCHMARK, pid), rel=1e-12)
    assert found.gap < 1e-6


@pytest.mark.parametrize(
    ("ranges", "match"),
    [
        (((1, 1), (2e4, 1e4), (1, 2), (1, 1)), "kp.*empty"),
        (((1, 1), (1, 2), (1, inf), (1, 1)), "ki.*finite"),
        (((0, 1), (1, 2), (1, 2), (1, 1)), "gain.*above zero"),
        (((1, 1), (1, 2), (1, 2), (-1, 1)), "kd.*negative"),
    ],
)
def test_boxes_that_are_none_are_refused(ranges, match):
    with pytest.raises(ModelError, match=match):
        PidBox(*ranges)


def test_searches_that_cannot_be_are_refused():
    model = shared.benchmark(3)
    with pytest.raises(ModelError, match="widen the box"):
        best_pid(model, BENCHMARK, WIDE, start=PID(1.0, 1.0, 1.0, 1.0))
    with pytest.raises(ModelError, match="gap"):
        best_pid(model, BENCHMARK, WIDE, gap=0.0)
    with pytest.raises(ModelError, match="drift"):
        best_pid(model, BENCHMARK, replace(WIDE, ki=(0.0, 0.0)))
    with pytest.raises(ModelError, match="infinite variance"):
        best_pid(model, (Disturbance("d", "line_of_sight", white(1e-6)), NOISE), WIDE)


def test_a_range_from_zero_is_searched():
    found = best_pid(shared.benchmark(3), BENCHMARK, PidBox((1, 1), (0, 1e7), (0, 1e10), (0, 1e4)), gap=0.02)
    assert found.finished


def test_the_box_of_a_range_of_crossovers_holds_their_controllers():
    mirror = shared.truss(0.2, bays=4).loop.mirror
    kp_range, ki_range = (10.0, 6e3), (100.0, 5e6)
    ranges = {"kp": kp_range, "ki": ki_range, "kd": (1.0, 1.0)}
    crossover = (5 * HZ, 500 * HZ)
    box = box_of_crossovers(mirror, crossover, **ranges, rolloff_time=1e-4)
    least, most = inf, 0.0
    for share in np.random.default_rng(0).random((3000, 3)):
        w = crossover[0] * 100 ** share[0]
        kp, ki = (
            low * (high / low) ** s for s, (low, high) in zip(share[1:], (kp_range, ki_range), strict=True)
        )
        gain = gain_for_crossover(w, mirror, kp, ki, 1.0, 1e-4)
        assert box.contains(PID(gain, kp, ki, 1.0, 1e-4))
        least, most = min(least, gain), max(most, gain)
    assert box.gain[0] > 0.05 * least
    assert box.gain[1] < 20 * most
    with pytest.raises(ModelError, match="crossover"):
        box_of_crossovers(mirror, (10.0, 1.0), **ranges)
    with pytest.raises(ModelError, match="cancel"):
        box_of_crossovers(mirror, crossover, kp=(0.0, 1.0), ki=(1.0, 1e6), kd=(1.0, 1.0))
