"""Closed loops over a sweep of extreme structures and mirrors, against dense eigenvalues and one loop at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
from scipy import linalg

from fosopt.actuators import Mirror, MirrorReactionMass
from fosopt.control import PID, Loop, closed_loop_poles, closed_loop_state_space, gain_for_crossover
from fosopt.control.many import many_closed_loop_poles
from fosopt.metrics.disturbances import Disturbance, high_pass, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.jitter_many import many_jitter_variances
from fosopt.modes import Hub, ModalSet

HZ = reference.HZ
PORTS = ("hub", "tip")
DISTURBANCES = (
    Disturbance("air", "line_of_sight", low_pass(8.5 * HZ, 1e-5)),
    Disturbance("sensor", "sensor_noise", high_pass(70 * HZ, 1e-8)),
)


def loop_of(inertia, hertz=20.0, crossover=230.0, counter=None):
    mirror = Mirror(inertia, hertz * HZ, 0.01)
    gain = gain_for_crossover(crossover * HZ, mirror, 600.0, 5e4, 1.0, 1e-4)
    return Loop(replace(mirror, reaction_mass=counter), PID(gain, 600.0, 5e4, 1.0, 1e-4))


def few_modes(frequency, tip, damping=0.002):
    shape = np.column_stack([np.full(len(tip), 0.3), tip])
    return ModalSet(
        np.array(frequency), np.full(len(tip), damping), shape, PORTS, np.zeros(len(tip), dtype=bool)
    )


def same_as_alone_and_dense(loops, modes):
    """Every loop of a sweep has its own poles, jitter where it is stable, and none where it is not."""
    found = many_closed_loop_poles(loops, modes, "tip", closed_loop_poles(loops[0], modes, "tip"))
    assert all(found)
    variances = many_jitter_variances(loops, found, DISTURBANCES)
    for loop, poles, row in zip(loops, found, variances, strict=True):
        alone = closed_loop_poles(loop, modes, "tip")
        distance = np.abs(poles.all[:, None] - alone.all).min(axis=0)
        assert poles.all.size == alone.all.size
        # The complex modes a single loop starts from keep eight digits under a thousand times the truss's own inertia.
        assert np.all(distance <= 1e-8 * np.abs(alone.all) + 1e-14 * np.abs(alone.all).max())
        state = closed_loop_state_space(loop, modes, "tip").a
        balanced, _ = linalg.matrix_balance(state, permute=False)
        # A free rigid body's double zero is no pole of the loop.
        dense = linalg.eigvals(balanced)
        dense = dense[np.argsort(np.abs(dense))[2 * alone.open_loop.drifting :]]
        growing = int((dense.real > 1e-7 * np.abs(dense)).sum())
        assert (poles.all.real > 1e-7 * np.abs(poles.all)).sum() == growing
        if poles.spectral_abscissa < 0:
            expected = jitter_variances(LoopModel(loop, modes, "tip"), alone, DISTURBANCES)
            assert row == pytest.approx([each.value for each in expected], rel=1e-9)
        else:
            assert np.isnan(row).all()
    return found


COUNTERS = pytest.mark.parametrize("counter", [None, MirrorReactionMass(0.9)], ids=["plain", "reactionless"])


@COUNTERS
@pytest.mark.parametrize("hub", [reference.HELD, Hub("free")], ids=["held", "free"])
def test_mirrors_from_a_billionth_to_a_thousand_times_the_truss(counter, hub):
    of = reference.structure()
    modes = reference.modes_of(of, hub).keep(slice(0, 12))
    inertia = np.geomspace(1e-9, 1e3, 25) * reference.inertia_of(of)
    same_as_alone_and_dense([loop_of(j, counter=counter) for j in inertia], modes)


@COUNTERS
def test_mirrors_up_to_ten_kilohertz(counter):
    of = reference.structure()
    modes = reference.modes_of(of).keep(slice(0, 12))
    hertz = np.geomspace(0.5, 1e4, 21)
    loops = [loop_of(0.002 * reference.inertia_of(of), f, counter=counter) for f in hertz]
    same_as_alone_and_dense(loops, modes)


@COUNTERS
def test_mirrors_tuned_through_a_structural_mode(counter):
    of = reference.structure()
    modes = reference.modes_of(of).keep(slice(0, 7))
    tuned = float(modes.natural_frequency[4]) / HZ
    around = tuned * np.array([0.99, 1 - 1e-6, 1.0, 1 + 1e-6, 1.01])
    for ratio in (1e-6, 1e-3):
        loops = [loop_of(ratio * reference.inertia_of(of), f, counter=counter) for f in around]
        same_as_alone_and_dense(loops, modes)


def test_without_coupling_every_mirror_is_alone():
    modes = few_modes([10.0, 70.0, 300.0], [0.0, 0.0, 0.0])
    for poles in same_as_alone_and_dense([loop_of(j) for j in (0.1, 1.0, 10.0)], modes):
        assert poles.open_loop.uncoupled.size == 6
        assert poles.value.size < 6


def test_a_reaction_mass_on_a_port_that_does_not_move_changes_nothing_but_its_own_pole():
    modes = few_modes([10.0, 70.0, 300.0], [0.0, 0.0, 0.0])
    plain, counter = (
        [loop_of(j, counter=each) for j in (0.1, 1.0, 10.0)] for each in (None, MirrorReactionMass(0.9))
    )
    near = closed_loop_poles(counter[0], modes, "tip")
    for loop, without, found in zip(
        counter, plain, many_closed_loop_poles(counter, modes, "tip", near), strict=True
    ):
        # Its own pole cancels everywhere: where that leaves no number, the loop is found alone.
        poles = found or closed_loop_poles(loop, modes, "tip")
        body = loop.mirror.counter
        own = np.roots([body.inertia, body.damping, body.stiffness])
        expected = np.concatenate([closed_loop_poles(without, modes, "tip").all, own])
        assert reference.worst_match(poles.all, expected) < 1e-9


@COUNTERS
def test_a_mode_with_a_node_at_the_port_stays_where_it_is(counter):
    modes = few_modes([10.0, 70.0, 300.0], [0.4, 0.0, 0.7])
    found = same_as_alone_and_dense([loop_of(j, counter=counter) for j in np.geomspace(0.1, 10, 7)], modes)
    still = -0.002 * 70 + 1j * 70 * np.sqrt(1 - 0.002**2)
    for poles in found:
        assert np.abs(poles.all - still).min() < 1e-12 * 70


@COUNTERS
@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-8])
def test_repeated_structural_frequencies(counter, apart):
    modes = few_modes([10.0, 70.0, 70.0 * (1 + apart), 300.0], [0.4, 0.3, 0.5, 0.7])
    loops = [loop_of(j, counter=counter) for j in np.geomspace(0.1, 10, 7)]
    same_as_alone_and_dense(loops, modes)
