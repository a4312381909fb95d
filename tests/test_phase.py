"""Phase by counting poles and zeros, and the frequencies that resolve them."""

from __future__ import annotations

import numpy as np
import pytest
import reference

from fosopt.control.phase import continuous_phase, resonance_grid
from fosopt.errors import ModelError
from fosopt.modes import Damping, Hub
from fosopt.plant import expansion_zeros, modal_expansion, modal_poles

HZ = reference.HZ


def pairs(frequency, ratio):
    """Both conjugates of each pair."""
    frequency, ratio = np.broadcast_arrays(np.atleast_1d(frequency), np.atleast_1d(ratio))
    upper = frequency * (-ratio + 1j * np.sqrt(1 - ratio**2))
    return np.concatenate([upper, upper.conj()])


def value(zeros, poles, gain, frequency):
    """Transfer function at jω as a product of ratios, so that nothing overflows."""
    s = 1j * frequency
    found = np.full(s.size, gain, dtype=complex)
    for k in range(max(zeros.size, poles.size)):
        found *= (s - zeros[k]) if k < zeros.size else 1.0
        found /= (s - poles[k]) if k < poles.size else 1.0
    return found


def test_phase_is_the_unwrapped_one_on_a_grid_fine_enough_to_unwrap():
    # Poles and zeros of every kind, damped enough for a grid of steps of a thousandth to follow.
    zeros = np.concatenate([pairs([3.0, 40.0], 0.01), pairs([9.0], -0.02), [-5.0, 70.0]])
    poles = np.concatenate([pairs([2.0, 11.0, 60.0], 0.005), pairs([25.0], -0.1), [-1.0, 33.0]])
    frequency = np.linspace(1e-3, 200, 200_001)
    for gain in (2.0, -0.5):
        found = continuous_phase(zeros, poles, gain, frequency)
        expected = np.degrees(np.unwrap(np.angle(value(zeros, poles, gain, frequency))))
        difference = found - expected
        assert difference == pytest.approx(
            np.full(frequency.size, 360 * round(difference[0] / 360)), abs=1e-8
        )


@pytest.mark.parametrize("damping", [1e-2, 1e-6, 1e-12])
def test_phase_on_a_coarse_grid_is_that_on_a_fine_one_however_light_the_damping(damping):
    zeros, poles = pairs([2.0, 4.0, 5.0001], damping), pairs([1.0, 3.0, 5.0, 7.0], damping)
    coarse = np.array([0.5, 1.5, 2.5, 3.5, 4.5, 6.0, 8.0])
    fine = np.union1d(coarse, resonance_grid(np.concatenate([zeros, poles]), 0.1, 10, 200))
    found = continuous_phase(zeros, poles, 1.0, coarse)
    assert found == pytest.approx(continuous_phase(zeros, poles, 1.0, fine)[np.isin(fine, coarse)], abs=1e-9)
    # Between its poles and zeros each is half a turn or none, but for what damping leaves: 2 ζ r/(1 − r²) each.
    assert found == pytest.approx([0, -180, 0, -180, 0, 0, -180], abs=40 * np.degrees(2 * damping))


def test_unwrapping_a_coarse_grid_goes_astray_where_counting_does_not():
    zeros, poles = pairs([2.0], 1e-6), pairs([1.0, 3.0], 1e-6)
    coarse = np.array([0.1, 2.9, 4.0, 50.0])  # steps over the first pair: a dip and a rise in one step
    counted = continuous_phase(zeros, poles, 1.0, coarse)
    assert counted == pytest.approx([0, 0, -180, -180], abs=0.01)
    # A zero in the right half plane between the same neighbors: same angles, another phase.
    right = continuous_phase(pairs([2.0], -1e-6), poles, 1.0, coarse)
    assert right == pytest.approx([0, -360, -540, -540], abs=0.01)
    for zero in (2e-6, -2e-6):
        z = np.array([zero + 2j, zero - 2j])
        unwrapped = np.degrees(np.unwrap(np.angle(value(z, poles, 1.0, coarse))))
        assert unwrapped[-1] == pytest.approx(-180, abs=0.01)


def test_an_undamped_root_jumps_by_half_a_turn_at_its_frequency_and_the_middle_stands_there():
    w = np.array([1.0, np.nextafter(2.0, 0), 2.0, np.nextafter(2.0, 3), 9.0])
    pole = np.array([2j, -2j])
    none = np.zeros(0, complex)
    assert np.array_equal(continuous_phase(none, pole, 1.0, w), [0, 0, -90, -180, -180])
    assert np.array_equal(continuous_phase(pole, none, 1.0, w), [0, 0, 90, 180, 180])
    # Minus zero is no other axis.
    assert np.array_equal(
        continuous_phase(none, np.array([-0.0 + 2j, -0.0 - 2j]), 1.0, w), [0, 0, -90, -180, -180]
    )
    assert np.array_equal(continuous_phase(pole, pole, 1.0, w), np.zeros(5))


def test_vanishing_damping_tends_to_the_undamped_phase():
    w = np.linspace(0.13, 10.03, 100)  # none of them at a root
    undamped = continuous_phase(pairs(2.5, 0.0), pairs([1.0, 4.0], 0.0), 1.0, w)
    light = continuous_phase(pairs(2.5, 1e-13), pairs([1.0, 4.0], 1e-13), 1.0, w)
    assert light == pytest.approx(undamped, abs=1e-8)


@pytest.mark.parametrize(
    ("zeros", "poles", "gain", "start", "end"),
    [
        ([], [0.0], 1.0, -90, -90),  # an integrator
        ([], [0.0, 0.0], 1.0, -180, -180),  # a rigid body
        ([0.0], [], 1.0, 90, 90),
        ([-3.0], [], 1.0, 0, 90),
        ([3.0], [], -1.0, 0, -90),  # 3 − s: starts positive and loses phase
        ([3.0], [], 1.0, 180, 90),
        ([], [-3.0], 1.0, 0, -90),
        ([], [3.0], 1.0, -180, -90),
        ([], [], -1.0, -180, -180),
        ([1 + 2j, 1 - 2j], [], 1.0, 0, -180),
        ([-1 + 2j, -1 - 2j], [], 1.0, 0, 180),
        ([], [1 + 2j, 1 - 2j], 1.0, 0, 180),
        # A quadruple: what the left pair gains the right one loses.
        ([1 + 2j, 1 - 2j, -1 + 2j, -1 - 2j], [], 1.0, 0, 0),
        ([2.0, -2.0], [], -1.0, 0, 0),
    ],
)
def test_each_root_turns_the_phase_by_its_share_from_zero_to_infinite_frequency(
    zeros, poles, gain, start, end
):
    w = np.array([1e-9, 1e9])
    zeros, poles = np.array(zeros, dtype=complex), np.array(poles, dtype=complex)
    assert continuous_phase(zeros, poles, gain, w) == pytest.approx([start, end], abs=1e-6)
    # Up to full turns it is the angle of the transfer function.
    for frequency in (0.3, 2.0, 30.0):
        at = np.array([frequency])
        turned = continuous_phase(zeros, poles, gain, at) - np.degrees(
            np.angle(value(zeros, poles, gain, at))
        )
        assert turned / 360 == pytest.approx(np.round(turned / 360), abs=1e-10)


@pytest.mark.parametrize("ratio", [0.0, 0.001])
def test_collocated_phase_of_the_truss_stays_within_half_a_turn_and_far_sensors_lose_more(ratio, frame3):
    modes = frame3.modal_set(Hub("free"), Damping((ratio,)), ("hub", "tip"))
    w = np.geomspace(0.1 * HZ, 3000 * HZ, 50)  # far coarser than 60 resonances
    poles = modal_poles(modes)
    collocated = continuous_phase(expansion_zeros(modal_expansion(modes, "tip", "tip")), poles, 1.0, w)
    assert np.all((collocated <= 1e-9) & (collocated >= -180 - 1e-9))
    expansion = modal_expansion(modes, "tip", "hub")
    far = continuous_phase(expansion_zeros(expansion), poles, 1.0, w)
    assert far.min() < -720
    for found, of in ((collocated, modal_expansion(modes, "tip", "tip")), (far, expansion)):
        turned = (found - np.degrees(np.angle(of.response(1j * w)))) / 180
        # Where the response is more than rounding; half turns because the gain's sign is not asked for here.
        seen = np.abs(of.response(1j * w)) > 1e-10 * np.sum(
            np.abs(of.residue) / np.abs(modes.stiffness - w[:, None] ** 2), axis=1
        )
        assert turned[seen] == pytest.approx(np.round(turned[seen]), abs=1e-4)


@pytest.mark.parametrize(
    ("zeros", "gain", "fault"),
    [
        ([1j], 1.0, "zeros come without their conjugates"),
        ([1j, -2j], 1.0, "zeros come without their conjugates"),
        ([-1 + 1j, -2 - 1j], 1.0, "zeros come without their conjugates"),
        ([np.inf], 1.0, "a zero is not finite"),
        ([], 0.0, "the gain 0.0 has no sign"),
        ([], np.nan, "the gain nan has no sign"),
    ],
)
def test_what_has_no_phase_is_refused(zeros, gain, fault):
    with pytest.raises(ModelError, match=fault):
        continuous_phase(np.array(zeros, dtype=complex), np.array([-1.0 + 0j]), gain, np.ones(1))


def test_conjugates_in_any_order_with_rounding_are_accepted():
    upper = np.array([-1e-17 + 5j, 1e-17 + 5j, 3j])
    roots = np.concatenate([upper, upper.conj()[::-1] * (1 + 1e-12)])
    found = continuous_phase(roots, roots, 1.0, np.array([4.0]))
    assert found == pytest.approx([0.0], abs=1e-9)


def test_the_resonance_grid_hits_every_damped_root_and_stays_in_its_range():
    roots = np.concatenate([pairs([2.0, 3.0, 400.0], [1e-3, 1e-9, 0.01]), pairs([9.0], -0.2), [-4.0]])
    grid = resonance_grid(roots, 1.0, 100.0, 30)
    assert np.all(np.diff(grid) > 0)
    assert (grid[0], grid[-1]) == pytest.approx((1.0, 100.0))
    upper = roots[(roots.imag > 0) & (roots.imag < 100)]
    for root in upper:
        near = grid[np.abs(grid - root.imag) <= 17 * abs(root.real)]
        assert root.imag in near
        assert near.size >= 9
        # Points at about each half width: the peak is within 3 dB of its top on both sides.
        assert np.abs(np.abs(near - root.imag) - abs(root.real)).min() < 0.01 * abs(root.real)
    assert resonance_grid(np.zeros(0, complex), 1.0, 100.0, 30) == pytest.approx(np.geomspace(1, 100, 30))


def test_an_undamped_root_is_approached_but_not_hit():
    grid = resonance_grid(np.array([5j, -5j]), 1.0, 10.0, 3, per_root=11)
    assert 5.0 not in grid
    assert np.count_nonzero(np.abs(grid - 5) < 0.01) == 10
