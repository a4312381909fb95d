"""Stability boundaries against the Routh criterion, dense eigenvalues on both sides, and the dissertation's loop."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
import reference
from scipy import linalg

from fosopt.actuators import Mirror
from fosopt.control import PID, ClosedLoopPoles, Loop, closed_loop_poles, closed_loop_state_space
from fosopt.control.open_loop import OpenLoopPoles
from fosopt.errors import ModelError
from fosopt.metrics.boundary import (
    Boundary,
    _crossing,
    _vertex,
    boundary_mode,
    branches,
    stability_boundaries,
)
from fosopt.metrics.functional import LoopModel
from fosopt.modes import ModalSet

SUPPORT = ModalSet(np.zeros(0), np.zeros(0), np.zeros((0, 2)), ("hub", "tip"), np.zeros(0, bool))
MIRROR = Mirror(2.0, 30.0, 0.02)


def gain_path(kp, ki, kd=0.0):
    """Poles of a mirror on a rigid support over the controller's gain."""
    return lambda gain, near: closed_loop_poles(
        Loop(MIRROR, PID(gain, kp, ki, kd)), SUPPORT, "tip", near=near
    )


def test_a_rigidly_supported_mirror_loses_stability_where_routh_says():
    # J s³ + c s² + (k + g k_p) s + g k_i is stable while c (k + g k_p) > J g k_i.
    kp, ki = 5.0, 100.0
    j, c, k = MIRROR.inertia, MIRROR.damping, MIRROR.stiffness
    expected = c * k / (j * ki - c * kp)
    (found,) = stability_boundaries(gain_path(kp, ki), 0.1, 1e4)
    assert found.value == pytest.approx(expected, rel=1e-8)
    assert found.loses
    assert found.frequency == pytest.approx(sqrt((k + expected * kp) / j), rel=1e-8)


@pytest.mark.parametrize("width", [1.0, 1e-2, 1e-4])
def test_a_window_of_instability_narrower_than_the_samples_is_found(width):
    # (c + g k_d)(k + g k_p) = J g k_i has two roots; k_i is chosen so that they are g and (1 + width) g.
    kd, kp, j, c, k = 0.5, 3.0, MIRROR.inertia, MIRROR.damping, MIRROR.stiffness
    middle = sqrt(c * k / (kd * kp))
    low = middle / sqrt(1 + width)
    ki = (kd * kp * low * (2 + width) + c * kp + k * kd) / j
    found = stability_boundaries(gain_path(kp, ki, kd), 0.1, 1e4)
    assert [b.loses for b in found] == [True, False]
    assert [b.value for b in found] == pytest.approx([low, low * (1 + width)], rel=1e-6)


def drawn_path(*real_parts):
    """Poles whose real parts are given functions of the parameter."""

    def path(value, near):
        pole = np.array([f(value) + 10j * (k + 1) for k, f in enumerate(real_parts)])
        nothing = np.zeros(0, dtype=complex)
        open_loop = OpenLoopPoles(
            nothing, nothing, np.zeros((0, 2)), None, np.zeros(0, bool), nothing, drifting=False
        )
        return ClosedLoopPoles(pole, np.zeros_like(pole), np.full(pole.size, 2), open_loop)

    return path


def test_a_stable_window_between_two_growing_poles_is_found():
    path = drawn_path(lambda x: 1.0 - x, lambda x: x - 1.01, lambda x: -5.0)
    found = stability_boundaries(path, -1.0, 4.0, log=False, samples=4)
    assert [b.loses for b in found] == [False, True]
    assert [b.value for b in found] == pytest.approx([1.0, 1.01], rel=1e-8)
    assert [b.frequency for b in found] == pytest.approx([10.0, 20.0], rel=1e-8)


def test_poles_that_keep_their_distance_are_not_searched():
    calls = []

    def counted(x):
        calls.append(x)
        return -5.0 + 0.1 * np.sin(20 * x)

    assert stability_boundaries(drawn_path(counted), 0.0, 1.0, log=False, samples=10) == []
    assert len(calls) == 10


def inertia_path(modes, of):
    loop = reference.loop_of(reference.mirror_of(of, 1.0))

    def path(percent, near):
        mirror = reference.mirror_of(of, percent)
        scaled = replace(loop.controller, gain=loop.controller.gain * percent)
        return closed_loop_poles(Loop(mirror, scaled), modes, "tip", near=near)

    return path


def growing(modes, of, percent):
    """Number of growing poles by a dense eigenvalue solver."""
    state = closed_loop_state_space(reference.loop_of(reference.mirror_of(of, percent)), modes, "tip")
    return int((linalg.eigvals(state.a).real > 0).sum())


@pytest.mark.parametrize("count", [7, 61])
def test_boundaries_of_the_dissertation_s_loop_separate_dense_eigenvalues(count):
    of = reference.structure()
    modes = reference.modes_of(of).keep(slice(0, count))
    found = stability_boundaries(inertia_path(modes, of), 0.002, 20.0)
    assert found
    for boundary in found:
        below, above = (growing(modes, of, boundary.value * (1 + side)) for side in (-1e-6, 1e-6))
        assert (below == 0) == boundary.loses
        assert (above == 0) != boundary.loses
    # And nothing is missed between them: stability only changes where a boundary is.
    for percent in np.geomspace(0.002, 20.0, 60):
        last = [b for b in found if b.value < percent]
        assert (growing(modes, of, percent) == 0) == (not last or not last[-1].loses)


def test_the_mode_that_makes_the_two_percent_mirror_unstable_is_named():
    of = reference.structure()
    modes = reference.modes_of(of).keep(slice(0, 7))
    boundary = stability_boundaries(inertia_path(modes, of), 0.2, 2.0)[0]
    model = LoopModel(reference.loop_of(reference.mirror_of(of, boundary.value)), modes, "tip")
    number = boundary_mode(model, boundary.pole)
    near = np.argsort(np.abs(modes.natural_frequency - boundary.frequency))[:2]
    assert number - 1 in near
    assert boundary.pole.real == pytest.approx(0.0, abs=1e-7 * boundary.frequency)


def test_a_loop_that_is_stable_everywhere_has_no_boundary():
    assert stability_boundaries(gain_path(5.0, 0.0, 1.0), 0.1, 1e4) == []


@pytest.mark.parametrize(("low", "high", "log"), [(1.0, 1.0, True), (2.0, 1.0, False), (0.0, 1.0, True)])
def test_a_range_that_is_none_is_refused(low, high, log):
    with pytest.raises(ModelError, match="is no range to search"):
        stability_boundaries(gain_path(5.0, 1.0), low, high, log=log)


def test_branches_of_a_contour_follow_the_nearest_boundary_of_their_kind():
    a, b = Boundary(1.0, True, 10j), Boundary(5.0, False, 10j)
    c, d = Boundary(1.2, True, 11j), Boundary(4.0, False, 11j)
    other = Boundary(1.1, True, 90j)
    assert branches([[a, b], [c, d]]) == [[0, 1], [0, 1]]
    assert branches([[a], [other, c], [c]]) == [[0], [1, 0], [0]]


@pytest.mark.parametrize(("factor", "numbers"), [(0.55, [0]), (0.45, [1]), (1.9, [0]), (2.2, [1])])
def test_a_branch_goes_on_within_a_factor_of_two_in_frequency(factor, numbers):
    assert branches([[Boundary(1.0, True, 10j)], [Boundary(1.0, True, 10j * factor)]]) == [[0], numbers]


def test_of_two_boundaries_the_nearer_one_by_ratio_goes_on():
    a, b = Boundary(1.0, True, 10j), Boundary(10.0, True, 10j)
    near = Boundary(4.0, True, 10j)
    assert branches([[a, b], [near]]) == [[0, 1], [1]]
    assert branches([[a, b], [near]], log=False) == [[0, 1], [0]]
    assert branches([[a, b], [replace(near, value=8.0)]], log=False) == [[0, 1], [1]]


def test_the_lowest_place_of_a_parabola_is_found_with_its_value():
    places = [(x, 3 + 2 * (x - 1.3) ** 2) for x in (0.2, 1.1, 2.9)]
    assert _vertex(*places) == pytest.approx((1.3, 3.0), rel=1e-13)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_valley_that_is_like_no_parabola_is_followed_below_zero(mirrored):
    # Below zero on a millionth of the range, and two hundred times as steep on one side as on the other.
    def valley(u):
        right = (1 - u if mirrored else u) - 0.35
        return abs(right) ** 1.45 * (200.0 if right > 0 else 1.0) - 3e-9

    places = []

    def counted(u):
        places.append(u)
        return valley(u)

    middle = 0.6505 if mirrored else 0.3495
    u = _crossing(counted, *((u, valley(u)) for u in (middle, 0.0, 1.0)))
    assert valley(u) < 0
    assert len(places) < 40
    assert all(0 < place < 1 for place in places)
