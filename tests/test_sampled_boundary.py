"""Stability boundaries of sampled loops: Jury's test, windows, dense eigenvalues on both sides, fast sampling."""

from __future__ import annotations

import csv
from dataclasses import replace
from math import cos, exp, pi, sin, sqrt

import numpy as np
import pytest
import reference
from sampled_loops import rigid, sampled
from small_studies import HELD_KEYS, analysis, run_text, section

from fosopt.control import Loop, Sampling, closed_loop_poles
from fosopt.control.sampled import sampled_loop
from fosopt.control.sampled_poles import SampledPoles, sampled_poles
from fosopt.metrics.boundary import boundary_mode, stability_boundaries
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.sampled import SampledModel
from fosopt.modes import Hub, ModalSet
from fosopt.study import TEMPLATE, parse_study
from fosopt.study.build import build_problem, start_vector

HZ = reference.HZ


def gain_path(period, damping_ratio=0.05, of=lambda value: value, **pid):
    """Poles of a sampled loop on a rigid support over what sets its gain."""

    def path(value, near):
        return sampled_poles(*rigid(of(value), Sampling(period), damping_ratio, **pid), "tip", near)

    return path


def jury(period, damping_ratio):
    """a1, a2 and b1, b2 of a held mirror: its poles are the zeros of z² + (a1 + K b1) z + a2 + K b2."""
    w = 100.0
    decay, wd = exp(-damping_ratio * w * period), w * sqrt(1 - damping_ratio**2)
    c, s = cos(wd * period), sin(wd * period) * damping_ratio * w / wd
    return -2 * decay * c, decay**2, (1 - decay * (c + s)) / w**2, (decay**2 + decay * (s - c)) / w**2


def test_a_mirror_under_proportional_control_loses_stability_where_jurys_test_says():
    period, ratio = 1e-3, 0.05
    a1, a2, b1, b2 = jury(period, ratio)
    expected = (1 - a2) / b2
    (found,) = stability_boundaries(gain_path(period, ratio), 1.0, 1e5)
    assert found.loses
    assert found.value == pytest.approx(expected, abs=0, rel=1e-9)
    turned = np.arccos(-(a1 + expected * b1) / 2)
    assert found.frequency == pytest.approx(turned / period, abs=0, rel=1e-6)


def test_a_loop_that_alternates_from_sample_to_sample_loses_stability_at_the_nyquist_frequency():
    period, ratio = 2.9e-2, 0.9
    a1, a2, b1, b2 = jury(period, ratio)
    # At z = −1, and sooner than where both poles leave as a pair.
    expected = (1 - a1 + a2) / (b1 - b2)
    assert 0 < expected < (1 - a2) / b2 or b2 < 0
    (found,) = stability_boundaries(gain_path(period, ratio), 100.0, 1e6)
    assert found.value == pytest.approx(expected, abs=0, rel=1e-9)
    assert found.frequency == pytest.approx(pi / period, abs=0, rel=1e-9)


@pytest.mark.parametrize("width", [1e-1, 1e-3])
def test_a_window_of_instability_narrower_than_the_samples_is_found(width):
    period, ratio = 1e-3, 0.05
    _, a2, _, b2 = jury(period, ratio)
    critical = (1 - a2) / b2

    def gain(value):
        return critical * (1 + 0.25 * (width**2 - (value - 2.03) ** 2))

    found = stability_boundaries(gain_path(period, ratio, gain), 1.0, 3.0, log=False, samples=9)
    assert [b.loses for b in found] == [True, False]
    assert [b.value for b in found] == pytest.approx([2.03 - width, 2.03 + width], abs=1e-9 * 100 / width)


def test_a_pair_that_turns_near_the_unit_circle_is_looked_at_once():
    calls = []

    def path(pair):
        def poles(value, near):
            calls.append(value)
            s = complex(-1e-3 - (value - 2.03) ** 2, 50.0)
            return SampledPoles(np.exp(1e-3 * np.array([s, s.conjugate()] if pair else [s])), 1e-3)

        return poles

    counts = []
    for pair in (False, True):
        calls.clear()
        assert stability_boundaries(path(pair), 1.0, 3.0, log=False, samples=9) == []
        counts.append(len(calls))
    assert counts[0] == counts[1] > 9


def inertia_path(modes, period):
    of = reference.structure()
    base, _ = sampled(period, 0.6 * period)

    def path(percent, near):
        mirror = reference.mirror_of(of, percent)
        gain = base.controller.gain * percent / 0.2
        loop = Loop(mirror, replace(base.controller, gain=3 * gain))
        return sampled_poles(loop, modes, "tip", near)

    return path


@pytest.mark.parametrize("hub", [reference.HELD, Hub("free")])
def test_boundaries_separate_stable_from_unstable_loops_and_none_is_missed(hub):
    modes = reference.modes_of(reference.structure(), hub).keep(np.arange(8))
    path = inertia_path(modes, 2e-4)
    found = stability_boundaries(path, 0.005, 50.0, samples=21)
    assert found
    for boundary in found:
        below, above = (path(boundary.value * (1 + side), None).spectral_abscissa for side in (-1e-8, 1e-8))
        assert (below < 0) == boundary.loses == (above > 0)
        assert abs(boundary.pole.real) < 1e-9
    for percent in np.geomspace(0.005, 50.0, 60):
        last = [b for b in found if b.value < percent]
        stable = path(percent, None).spectral_abscissa < 0
        assert stable == (not last or not last[-1].loses)


def test_boundaries_of_a_loop_sampled_ever_faster_are_the_continuous_ones():
    modes = reference.modes_of(reference.structure(), Hub("free")).keep(np.arange(8))
    of = reference.structure()
    base = reference.loop_of(reference.mirror_of(of, 1.0), 1e-4)

    def loop(percent, period):
        sampling = None if period is None else Sampling(period)
        path = replace(base.controller.path, sampling=sampling)
        gain = base.controller.gain * percent
        return Loop(reference.mirror_of(of, percent), replace(base.controller, gain=gain, path=path))

    def continuous(percent, near):
        return closed_loop_poles(loop(percent, None), modes, "tip", near)

    def fast(period):
        return lambda percent, near: sampled_poles(loop(percent, period), modes, "tip", near)

    (limit,) = stability_boundaries(continuous, 0.01, 2.0)
    found = [stability_boundaries(fast(period), 0.01, 2.0, samples=7)[0] for period in (4e-5, 2e-5)]
    off = [each.value / limit.value - 1 for each in found]
    assert abs(off[1]) < 0.05
    assert off[0] / off[1] == pytest.approx(2, abs=0, rel=0.1)
    assert found[1].frequency == pytest.approx(limit.frequency, abs=0, rel=1e-4)
    model = LoopModel(loop(limit.value, None), modes, "tip")
    assert boundary_mode(model, found[1].pole, 2e-5) == boundary_mode(model, limit.pole)


def test_poles_come_in_the_order_of_those_they_are_followed_from():
    loop, modes = sampled(2e-4, 1e-4)
    modes = modes.keep(np.arange(10))
    first = sampled_poles(loop, modes, "tip")
    shuffled = SampledPoles(np.random.default_rng(1).permutation(first.z), first.period)
    more = replace(loop, controller=replace(loop.controller, gain=1.0001 * loop.controller.gain))
    followed = sampled_poles(more, modes, "tip", shuffled)
    kept = np.abs(shuffled.z) > 1e-3
    assert np.abs(followed.z - shuffled.z)[kept].max() < 1e-4
    assert np.array_equal(
        np.sort_complex(followed.z), np.sort_complex(sampled_loop(more, modes, "tip").poles)
    )
    # Of loops with other states the order says nothing.
    fewer = sampled_poles(loop, modes.keep(np.arange(5)), "tip", shuffled)
    assert fewer.z.size == shuffled.z.size - 10
    assert np.array_equal(sampled_poles(loop, modes, "tip", fewer).z, first.z)
    model = SampledModel(loop, modes, "tip")
    # To the rounding of z near one, over the period.
    assert first.spectral_abscissa == pytest.approx(model.spectral_abscissa, abs=1e-15 / 2e-4, rel=0)
    gone = SampledPoles(np.array([0.5 + 0j, 0j, -0.25 + 0j]), 0.1)
    assert gone.value[[0, 2]] == pytest.approx([np.log(0.5) / 0.1, np.log(0.25) / 0.1 + 10j * pi], abs=1e-12)
    assert gone.value[1].real < -1e3


def test_the_mode_that_moves_most_may_look_slower_than_it_is():
    # A thousand rad/s of sampling: 899 rad/s look like 101.
    period = 2 * pi / 1e3
    loop, _ = rigid(1.0, Sampling(period))

    def model(frequencies, shapes):
        size = len(frequencies)
        shape = np.outer(shapes, [1.0, 1.0])
        modes = ModalSet(
            np.array(frequencies), np.full(size, 1e-4), shape, reference.PORTS, np.zeros(size, bool)
        )
        return LoopModel(loop, modes, "tip")

    fast = model([40.0, 899.0], [1.0, 1.0])
    assert boundary_mode(fast, 101j) == 1
    assert boundary_mode(fast, 101j, period) == 2
    # What the hold passes of an image at 899 rad/s is a ninth of what it passes at 101.
    for share, mode in ((50.0, 1), (200.0, 2)):
        assert boundary_mode(model([100.0, 898.0], [1.0, share]), 101j, period) == mode
    # Nothing of a torque that stands still is seen at its images.
    assert boundary_mode(model([3.0, 1000.0], [1e-4, 1.0]), 0j, period) == 1


BUILT = (
    "  crossover: 100 Hz              # sets the gain, on a rigid support\n",
    "  crossover: 100 Hz\n  rolloff: 3 kHz\n  sampling: {rate: 5 kHz, delay: 100 us}\n",
)
FREE = (("type: held                     #", "type: free #"), *HELD_KEYS)
SWEEP = (
    "sweep:\n  axes:\n    - {quantity: mirror_inertia_ratio, list: [0.1 %, 0.3 %]}\n"
    "    - {quantity: crossover, log: {from: 100 Hz, to: 2 kHz, points: 3}}\n"
    "  outputs: [stable]\n  boundary: {along: crossover, samples: 9}\n"
)


def test_a_sweep_of_a_sampled_loop_on_a_free_hub_finds_its_boundaries(tmp_path, monkeypatch):
    asked = []

    def seen(model, pole, period):
        asked.append((boundary_mode(model, pole, period), period))
        return asked[-1][0]

    monkeypatch.setattr("fosopt.study.sweep_boundary.boundary_mode", seen)
    cut = ((section(TEMPLATE, name), "") for name in ("constraints", "disturbances"))
    point = *cut, BUILT, *FREE
    text = analysis(*point).replace("kind: analysis", "kind: sweep") + SWEEP
    run = run_text(text, tmp_path)
    boundaries = run["boundaries"]
    assert [each["branch"] for each in boundaries] == [0, 0]
    assert asked == [(each["structural_mode"], pytest.approx(2e-4)) for each in boundaries]
    for each in boundaries:
        stable = []
        for side in (-1e-6, 1e-6):
            ratio, crossover = each["at"]["mirror_inertia_ratio"], each["at"]["crossover"] / HZ * (1 + side)
            changes = (
                ("inertia_ratio: 0.2 %", f"inertia_ratio: {ratio!r}"),
                ("crossover: 100 Hz", f"crossover: {crossover!r} Hz"),
            )
            text = analysis(*point)
            for old, new in changes:
                text = text.replace(old, new)
            study = parse_study(text)
            problem = build_problem(study)
            stable.append(problem.evaluate(start_vector(study, problem), truth=True).stable)
        assert stable == [each["loses"], not each["loses"]]
    with (tmp_path / "out" / "boundary.csv").open(encoding="utf-8") as stream:
        assert len(list(csv.DictReader(stream))) == len(boundaries)
