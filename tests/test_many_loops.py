"""Closed loops of many mirrors together, against one at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
from test_placement import CASES
from test_placement import case as placement_case
from test_placement import loop_of as placed_loop

from fosopt.actuators import MirrorReactionMass
from fosopt.control import Loop, closed_loop_poles
from fosopt.control.many import _levels, many_closed_loop_poles
from fosopt.errors import UnstableError
from fosopt.metrics.disturbances import Disturbance, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.jitter_many import many_jitter_variances
from fosopt.modes import Hub
from fosopt.plant.sums import modal_sums, repulsion
from fosopt.problem import Evaluation


def sweep(percents, **gains):
    """Loops of the reference truss over the mirror's inertia."""
    of = reference.structure()
    return [reference.loop_of(reference.mirror_of(of, p), **gains) for p in percents]


@pytest.mark.parametrize("hub", [reference.HELD, Hub("free")], ids=["held", "free"])
@pytest.mark.parametrize("gains", [{}, {"rolloff_time": 1e-4}, {"ki": 0.0}, {"kd": 0.0}], ids=str)
def test_poles_found_together_are_those_found_alone(hub, gains):
    modes = reference.modes_of(reference.structure(), hub)
    loops = sweep(np.geomspace(0.02, 20, 24), **gains)
    near = closed_loop_poles(loops[0], modes, "tip")
    together = many_closed_loop_poles(loops, modes, "tip", near)
    assert sum(poles is None for poles in together) <= 2
    for loop, poles in zip(loops, together, strict=True):
        if poles is None:
            continue
        alone = closed_loop_poles(loop, modes, "tip")
        assert poles.spectral_abscissa == pytest.approx(alone.spectral_abscissa, rel=1e-9)
        assert reference.worst_match(poles.all, alone.all) < 1e-12


def test_shifts_found_together_keep_their_relative_accuracy():
    modes = reference.modes_of(reference.structure())
    loops = sweep(np.geomspace(1e-6, 1e-5, 5))
    together = many_closed_loop_poles(loops, modes, "tip", closed_loop_poles(loops[0], modes, "tip"))
    for loop, poles in zip(loops, together, strict=True):
        assert poles is not None
        alone = closed_loop_poles(loop, modes, "tip", near=poles)
        pairs = poles.multiplicity == 2
        order, other = np.argsort(poles.value.imag[pairs]), np.argsort(alone.value.imag[pairs])
        np.testing.assert_allclose(poles.shift[pairs][order], alone.shift[pairs][other], rtol=1e-9)


def test_jitter_found_together_is_that_found_alone_and_none_where_unstable():
    modes = reference.modes_of(reference.structure())
    loops = sweep(np.geomspace(0.02, 5, 12), rolloff_time=1e-4)
    poles = many_closed_loop_poles(loops, modes, "tip", closed_loop_poles(loops[0], modes, "tip"))
    found = many_jitter_variances(loops, poles, reference.DISTURBANCES)
    unstable = 0
    for loop, each, row in zip(loops, poles, found, strict=True):
        model = LoopModel(loop, modes, "tip")
        try:
            alone = jitter_variances(model, each, reference.DISTURBANCES)
        except UnstableError:
            unstable += 1
            assert np.isnan(row).all()
            continue
        assert row == pytest.approx([variance.value for variance in alone], rel=1e-11, abs=0)
    assert 0 < unstable < len(loops)


def test_a_spectrum_without_residues_is_left_to_the_quadrature():
    modes = reference.modes_of(reference.structure())
    loops = sweep([0.1, 0.2])
    poles = many_closed_loop_poles(loops, modes, "tip", closed_loop_poles(loops[0], modes, "tip"))
    banded = Disturbance("banded", "line_of_sight", low_pass(50.0, 1e-5), band=(1.0, 100.0))
    found = many_jitter_variances(loops, poles, (banded, reference.DISTURBANCES[2]))
    assert np.isnan(found[:, 0]).all()
    assert not np.isnan(found[:, 1]).any()


def test_loops_of_other_forms_are_left_alone():
    modes = reference.modes_of(reference.structure())
    plain = sweep([0.1, 0.2])
    near = closed_loop_poles(plain[0], modes, "tip")
    counter = Loop(replace(plain[1].mirror, reaction_mass=MirrorReactionMass(0.9)), plain[1].controller)
    no_integral = Loop(plain[1].mirror, replace(plain[1].controller, ki=0.0))
    for odd in (counter, no_integral):
        assert many_closed_loop_poles([plain[0], odd], modes, "tip", near) == [None, None]


# ---- any placement, with what hangs on the structure ----

FREE = Hub("free")
PERCENTS = np.geomspace(0.05, 20, 12)


def general(name, hub):
    """Evaluation of a loop that acts, reacts or senses elsewhere, and designs with mirrors of other inertia."""
    first = placement_case(name, hub)
    return first, [replace(first.design, loop=placed_loop(name, percent)) for percent in PERCENTS]


@pytest.mark.parametrize("hub", [reference.HELD, FREE], ids=["held", "free"])
@pytest.mark.parametrize("name", CASES)
def test_loops_of_any_placement_found_together_are_those_found_alone(name, hub):
    first, designs = general(name, hub)
    found = first.neighbors(designs)
    for design, each in zip(designs, found, strict=True):
        # Found together, but where the drift a sensor on the structure sees hides slow poles in rounding.
        assert "poles" in each.__dict__ or (hub == FREE and design.loop.placement.sensor)
        alone = Evaluation(first.system, design)
        expected = alone.poles.all
        assert each.poles.all.size == expected.size
        distance = np.abs(each.poles.all[:, None] - expected).min(axis=0)
        # Near the double zero of a free hub, where receptances cancel, a slow pole keeps few digits.
        lost = 1e-11 * np.abs(expected).max() if hub == FREE else 0.0
        assert np.all(distance <= 1e-9 * np.abs(expected) + lost)
        assert each.stable == alone.stable
        # Bands, which a structure free to turn needs, are left to the quadrature.
        assert ("mean_squares" in each.__dict__) == (each.stable and hub != FREE)
        if each.stable and hub != FREE:
            for metric, value in each.mean_squares.items():
                # Residues of a disturbance that hardly reaches the line of sight cancel to a ten millionth.
                assert value == pytest.approx(alone.value(metric) ** 2, rel=1e-6, abs=0), metric


@pytest.mark.parametrize(
    "name", ["reactionless with mismatch", "all of it", "sensor and action on the structure"]
)
def test_every_other_metric_follows_from_poles_of_a_structure_with_something_hung_on_it(name):
    first, designs = general(name, reference.HELD)
    stable = 0
    for design, each in zip(designs, first.neighbors(designs), strict=True):
        assert each.poles.open_loop.hung
        if not each.stable:
            continue
        stable += 1
        alone = Evaluation(first.system, design)
        for metric in ("spectral_abscissa", "modulus_margin"):
            assert each.value(metric) == pytest.approx(alone.value(metric), rel=1e-7), metric
    assert stable


def test_receptances_of_a_structure_with_something_hung_on_it_are_those_of_its_own_poles():
    first, designs = general("reactionless with mismatch", reference.HELD)
    together, alone = first.neighbors(designs[:1])[0], Evaluation(first.system, designs[0])
    assert together.poles.open_loop.hung and not alone.poles.open_loop.hung
    s = np.array([-30 + 200j, 5 + 47j, -800 + 3000j])
    found, expected = (each.poles.open_loop.receptances(0.9 * s, 0.1 * s) for each in (together, alone))
    for one, other in zip(found.values, expected.values, strict=True):
        np.testing.assert_allclose(one.value, other.value, rtol=1e-9)
        np.testing.assert_allclose(one.slope, other.slope, rtol=1e-9)


def test_a_pair_that_becomes_two_real_poles_is_followed_on_both_sides():
    # On a rigid support, J s² + (c + g k_d) s + k + g k_p without integral is critically damped at one gain.
    modes = reference.modes_of(reference.structure()).keep(slice(0, 3))
    loop = reference.loop_of(reference.mirror_of(reference.structure(), 0.01), ki=0.0)
    gains = loop.controller.gain * np.geomspace(0.5, 5.0, 40)
    loops = [Loop(loop.mirror, replace(loop.controller, gain=g)) for g in gains]
    found = many_closed_loop_poles(loops, modes, "tip", closed_loop_poles(loops[0], modes, "tip"))
    assert len({int((each.multiplicity == 1).sum()) for each in found}) > 1
    for each, alone in zip(found, loops, strict=True):
        expected = closed_loop_poles(alone, modes, "tip")
        assert reference.worst_match(each.all, expected.all) < 1e-9
    variances = many_jitter_variances(loops, found, reference.DISTURBANCES[:3])
    assert not np.isnan(variances).any()


def test_poles_of_a_distant_loop_lead_there():
    modes = reference.modes_of(reference.structure())
    loops = sweep(np.geomspace(0.002, 20, 9))
    for near in (loops[0], loops[-1]):
        for each, loop in zip(
            many_closed_loop_poles(loops, modes, "tip", closed_loop_poles(near, modes, "tip")),
            loops,
            strict=True,
        ):
            assert reference.worst_match(each.all, closed_loop_poles(loop, modes, "tip").all) < 1e-9


# ---- sums ----


def test_sums_over_modes_are_those_of_plain_arithmetic_with_all_digits_of_a_small_shift():
    rng = np.random.default_rng(5)
    first = -rng.uniform(0.1, 3, 9) + 1j * np.sort(rng.uniform(10, 900, 9))
    second = first.conj()
    constant, linear = rng.normal(size=(2, 3, 9))
    base, shift = first[:4], (1e-13 * np.array([1, 1j, -1, 1 - 1j])).astype(complex)
    value, slope, known = modal_sums(first, second, constant, linear, base, shift)
    x, y = (base[:, None] - first) + shift[:, None], (base[:, None] - second) + shift[:, None]
    numerator = constant[:, None] + (base + shift)[:, None] * linear[:, None]
    np.testing.assert_allclose(value, (numerator / (x * y)).sum(axis=2), rtol=1e-13)
    change = linear[:, None] / (x * y) - numerator * (x + y) / (x * y) ** 2
    np.testing.assert_allclose(slope, change.sum(axis=2), rtol=1e-13)
    np.testing.assert_allclose(known, ((x + y) / (x * y)).sum(axis=1), rtol=1e-13)


def test_a_double_pole_at_zero_pushes_nobody():
    first = np.array([0.0, -0.1 + 5j])
    constant, none = np.ones((1, 2)), np.zeros((0, 2))
    s = np.array([1.0 + 2j])
    value, _, known = modal_sums(first, first.conj(), constant, none, s, np.zeros(1, complex))
    structural = (s - first[1]) * (s - first[1].conj())
    assert value[0, 0] == pytest.approx((1 / s**2 + 1 / structural)[0], rel=1e-14)
    assert known[0] == pytest.approx(((2 * s - 2 * first[1].real) / structural)[0], rel=1e-14)


def test_repulsion_counts_every_other_pole_and_the_conjugates_of_pairs():
    base = np.array([[-1.0 + 5j, -2.0 + 9j, -4.0 + 0j]])
    shift = 1e-9 * np.array([[1.0 + 1j, -1.0, 2.0]])
    pair = np.array([True, True, False])
    poles = (base + shift)[0]
    found = repulsion(base, shift, pair, np.zeros(3, np.intp), np.arange(3))
    for k in range(3):
        others = [*np.delete(poles, k), *poles[pair].conj()]
        assert found[k] == pytest.approx(sum(1 / (poles[k] - p) for p in others), rel=1e-12)


def test_neighbors_of_an_evaluation_have_its_modes_and_their_own_metrics():
    first = reference.evaluation(percent=0.1)
    designs = [reference.system_and_design(percent=p)[1] for p in (0.1, 0.3, 3.0)]
    for design, each in zip(designs, first.neighbors(designs), strict=True):
        alone = type(first)(first.system, design)
        assert each.modes is first.modes
        assert each.stable == alone.stable
        names = [
            "spectral_abscissa",
            *(["jitter_total", "jitter_air", "modulus_margin"] if each.stable else []),
        ]
        for name in names:
            value, gradient = each.metric(name)
            expected, expected_gradient = alone.metric(name)
            assert value == pytest.approx(expected, rel=1e-9)
            np.testing.assert_allclose(
                gradient, expected_gradient, rtol=1e-6, atol=1e-9 * np.abs(expected_gradient).max()
            )
        if not each.stable:
            with pytest.raises(UnstableError):
                each.value("jitter_total")


@pytest.mark.parametrize("count", [1, 2, 3, 10, 24])
def test_each_line_starts_half_way_between_its_nearest_neighbors_that_are_known(count):
    known = []
    for lines, left, right in _levels(count):
        for line, a, b in zip(lines, left, right, strict=True):
            below, above = [k for k in known if k < line], [k for k in known if k > line]
            assert a == (max(below) if below else -1)
            assert b == (min(above) if above else -1)
            assert b < 0 or line == (a + b) // 2
        known += lines.tolist()
    assert sorted(known) == list(range(count))
