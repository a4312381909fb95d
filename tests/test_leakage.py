"""Torque that a steering mirror leaves in its support structure."""

from __future__ import annotations

import numpy as np
import pytest
import reference

from fosopt.actuators import Mirror, MirrorReactionMass
from fosopt.control import PID, Loop, plant_state_space
from fosopt.control.leakage import LEAKAGE, with_torque_leakage
from fosopt.modes import ModalSet

HZ = reference.HZ
BODY = 3.0  # inertia of a structure that is one rigid body [kg m²]


def plant(shares: MirrorReactionMass | None, modes: ModalSet | None = None):
    mirror = Mirror(0.2, 20 * HZ, 0.01, shares)
    if modes is None:
        shape = np.full((1, 2), BODY**-0.5)
        modes = ModalSet(np.zeros(1), np.zeros(1), shape, reference.PORTS, np.ones(1, bool))
    loop = Loop(mirror, PID(0.0, 0.0, 0.0, 0.0))
    return with_torque_leakage(plant_state_space(loop, modes, "tip"), mirror)


@pytest.mark.parametrize("shares", [None, MirrorReactionMass(0.9, 1.05, 1.1)])
def test_what_leaks_out_of_the_mirror_turns_the_structure_the_other_way(shares):
    # One free rigid body: its own share of the angular momentum is all that balances the mirror's.
    system = plant(shares)
    # First state: its modal coordinate, angle times root of the inertia.
    body = np.zeros(system.a.shape[0])
    body[0] = BODY**0.5
    s = 1j * HZ * np.array([0.3, 20.5, 200.0])
    driven = [np.linalg.solve(x * np.eye(body.size) - system.a, system.b[:, 0]) for x in s]
    expected = -(s**2) * np.array([body @ x for x in driven])
    assert system.response(s, "control_torque", LEAKAGE) == pytest.approx(expected, rel=1e-9, abs=0)


def test_a_perfect_reaction_mass_leaks_nothing():
    modes = reference.modes_of(reference.structure())
    leaks, tight = plant(None, modes), plant(MirrorReactionMass(), modes)
    s = 1j * HZ * np.array([1.0, 5.0, 21.0, 90.0])
    lost = np.abs(leaks.response(s, "control_torque", LEAKAGE))
    assert np.all(np.abs(tight.response(s, "control_torque", LEAKAGE)) < 1e-10 * lost)


def test_the_first_torque_that_leaks_is_what_the_drives_do_not_cancel():
    # At infinite frequency springs do not matter: the drives' torques alone count, reaction on the structure apart.
    modes = reference.modes_of(reference.structure())
    system = plant(MirrorReactionMass(0.9, 1.0, 1.1), modes)
    assert system.d[-1, system.inputs.index("control_torque")] == pytest.approx(1 - 1.1, rel=1e-12, abs=0)
