"""Root loci against their ends, closed forms and the poles in between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
from scipy import linalg

from fosopt.actuators import Mirror, MirrorReactionMass, ReactionMassActuator
from fosopt.control import PID, Loop, closed_loop_poles, plant_state_space
from fosopt.control.locus import RootLocus, root_locus
from fosopt.errors import ModelError
from fosopt.modes import ModalSet

SUPPORT = ModalSet(np.zeros(0), np.zeros(0), np.zeros((0, 2)), ("hub", "tip"), np.zeros(0, bool))


def with_gain(loop, gain):
    return replace(loop, controller=replace(loop.controller, gain=gain))


def apart(found, expected):
    """Largest distance from a set of poles to the nearest of another, both ways."""
    gaps = np.abs(np.asarray(found)[:, None] - np.asarray(expected))
    return max(gaps.min(axis=0).max(), gaps.min(axis=1).max())


@pytest.mark.parametrize("case", [None, 1, 2, 3, 4])
def test_branches_start_at_the_open_loop_poles_and_end_at_the_closed_loop_ones(case):
    loop, modes = reference.benchmark(case)
    locus = root_locus(loop, modes, "tip")
    plant = linalg.eigvals(plant_state_space(loop, modes, "tip").a)
    # A free rigid body's double zero is known to the square root of rounding, and not a matter of the locus.
    plant = plant[np.abs(plant) > 1e-3]
    assert apart(locus.branches[0], [*plant, 0.0]) < 1e-9 * np.abs(plant).max()
    assert locus.gain[0] == 0
    assert locus.gain[-1] == loop.controller.gain
    assert apart(locus.branches[-1], closed_loop_poles(loop, modes, "tip").all) < 1e-12


def test_a_filtered_derivative_starts_a_branch_at_its_own_pole():
    rng = np.random.default_rng(5)
    loop, modes = reference.random_loop(rng, rolloff_time=2e-3)
    locus = root_locus(loop, modes, "tip")
    assert np.abs(locus.branches[0] + 500.0).min() < 1e-9
    assert locus.branches.shape[1] == closed_loop_poles(loop, modes, "tip").all.size


def test_a_reactionless_mirror_with_a_reaction_mass_actuator_starts_at_the_poles_of_its_plant():
    loop, modes = reference.random_loop(np.random.default_rng(3), rolloff_time=1e-3)
    mirror = replace(loop.mirror, reaction_mass=MirrorReactionMass(0.9, 1.1, 0.95))
    loop = replace(loop, mirror=mirror, actuators=(ReactionMassActuator("hub", 0.5, 40.0, 0.1, 2.0),))
    locus = root_locus(loop, modes, "tip", count=20)
    plant = linalg.eigvals(plant_state_space(loop, modes, "tip").a)
    assert apart(locus.branches[0], [*plant, 0.0, -1000.0]) < 1e-7 * np.abs(plant).max()
    assert apart(locus.branches[-1], closed_loop_poles(loop, modes, "tip").all) < 1e-9


def test_every_row_holds_the_poles_of_its_gain():
    loop, modes = reference.benchmark(3)
    locus = root_locus(loop, modes, "tip", count=20)
    for gain, row in zip(locus.gain[1:], locus.branches[1:], strict=True):
        assert apart(row, closed_loop_poles(with_gain(loop, gain), modes, "tip").all) < 1e-9


def test_a_second_order_locus_meets_on_the_real_axis_and_parts_along_it():
    # s² + 2 s + 25 with rate feedback K s: on the circle |s| = 5 up to K = 8, beyond it two real poles of product 25.
    loop = Loop(Mirror(1.0, 5.0, 0.2), PID(20.0, 0.0, 0.0, 1.0))
    locus = root_locus(loop, SUPPORT, "tip")
    before = locus.gain < 8
    assert np.abs(locus.branches[before]) == pytest.approx(5.0, rel=1e-9)
    assert np.abs(locus.branches[~before].imag).max() == 0
    assert np.prod(locus.branches[~before], axis=1).real == pytest.approx(25.0, rel=1e-9)
    assert before.sum() > 10
    assert (~before).sum() > 10


@pytest.mark.parametrize("seed", range(4))
def test_branches_do_not_jump(seed):
    # Random structures: flexible modes that the loop carries far, past each other.
    loop, modes = reference.random_loop(np.random.default_rng(seed), rolloff_time=1e-3)
    locus = root_locus(loop, modes, "tip")
    rows = np.arange(1, locus.gain.size, 25)
    for k in rows:
        # From one gain to the next in many small steps, the poles arrive where the branches say.
        gains = np.linspace(locus.gain[k - 1], locus.gain[k], 40)[1:]
        followed = locus.branches[k - 1]
        for gain in gains:
            poles = closed_loop_poles(with_gain(loop, gain), modes, "tip").all
            followed = poles[np.abs(followed[:, None] - poles).argmin(axis=1)]
        assert followed == pytest.approx(locus.branches[k], rel=1e-9)


def test_the_branch_of_a_mode_is_the_one_that_leaves_it():
    loop, modes = reference.benchmark(2)
    locus = root_locus(loop, modes, "tip")
    branch = locus.branch(46j)
    assert abs(branch[0]) == pytest.approx(7.385 * reference.HZ, rel=1e-3)
    # Case 2: the structure's branch ends unstable, and at lower gains it was more so.
    assert 0 < branch[-1].real < branch.real.max()
    assert locus.spectral_abscissa[-1] == branch[-1].real


@pytest.mark.parametrize(("case", "count"), [(1, 1), (2, 1), (3, 0)])
def test_gains_that_make_a_branch_unstable_end_where_it_crosses_the_axis(case, count):
    loop, modes = reference.benchmark(case)
    locus = root_locus(loop, modes, "tip")
    branch = locus.branches[:, np.argmax(locus.branches[-1].imag * (np.abs(locus.branches[-1].real) < 10))]
    found = locus.unstable_gains(branch)
    assert len(found) == count
    for low, high in found:
        ends = [low] if high == loop.controller.gain else [low, high]
        for gain in ends:
            # A pole at either end is within a hundredth of the way the branch goes into the right half plane.
            poles = closed_loop_poles(with_gain(loop, gain), modes, "tip").all
            near = poles[np.argmin(np.abs(poles - branch[np.argmin(np.abs(locus.gain - gain))]))]
            assert abs(near.real) < 0.01 * branch.real.max()
        assert case != 2 or high == loop.controller.gain


def test_bends_are_resolved():
    loop, modes = reference.benchmark(3)
    branch = root_locus(loop, modes, "tip", count=10).branch(635j)
    turn = np.angle(np.diff(branch)[1:] / np.diff(branch)[:-1])
    assert np.abs(turn).max() < np.radians(30)


@pytest.mark.parametrize("gain", [0.0, -1.0])
def test_a_locus_without_gain_is_refused(gain):
    loop, modes = reference.benchmark(1)
    with pytest.raises(ModelError, match="is not above zero; give the largest gain"):
        root_locus(with_gain(loop, gain), modes, "tip")


def test_a_branch_that_is_unstable_twice_has_two_intervals_of_gains():
    real = np.array([-1.0, 1.0, -3.0, 1.0, 2.0, -2.0])
    locus = RootLocus(np.array([0.0, 1.0, 2.0, 4.0, 5.0, 6.0]), real[:, None] + 3j)
    assert locus.unstable_gains(locus.branches[:, 0]) == ((0.5, 1.25), (3.5, 5.5))
    # From the first gain on, and up to the last.
    assert locus.unstable_gains(-locus.branches[:, 0]) == ((0.0, 0.5), (1.25, 3.5), (5.5, 6.0))


def test_of_two_branches_the_one_that_starts_nearer_is_asked_for():
    branches = np.array([[-1 + 5j, -1 - 5j, -4 + 1j], [-2 + 6j, -2 - 6j, -3 + 1j]])
    locus = RootLocus(np.array([0.0, 1.0]), branches)
    assert [locus.branch(start)[1] for start in (4j, -4j, -3.5)] == [-2 + 6j, -2 - 6j, -3 + 1j]
