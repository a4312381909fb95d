"""Zeros, poles and phase of the loop transfer function."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
from small_studies import analysis

from fosopt.actuators import MirrorReactionMass, Placement, ReactionMassActuator
from fosopt.control import loop_transfer
from fosopt.control.filters import low_pass_filter, notch_filter
from fosopt.control.loop_phase import loop_phase, loop_transfer_roots
from fosopt.control.phase import resonance_grid
from fosopt.control.pid import SignalPath
from fosopt.errors import SolverError
from fosopt.metrics.functional import LoopModel
from fosopt.modes import Hub
from fosopt.problem import Evaluation
from fosopt.study.build import build_problem
from fosopt.study.load import parse_study

HZ = reference.HZ


@pytest.fixture(scope="module")
def small():
    problem = build_problem(parse_study(analysis()))
    return problem.evaluate(problem.start, truth=True)


@pytest.fixture(scope="module")
def free(small):
    """The small truss with nothing that holds its hub."""
    return Evaluation(replace(small.system, hub=Hub("free"), disturbances=()), small.design)


def with_parts(small, part):
    """The model of the small truss with another loop."""
    loop = small.design.loop
    if part == "filters":
        path = SignalPath(filters=(notch_filter(40 * HZ, 0.2, 0.1), low_pass_filter(2000 * HZ, 2)))
        loop = replace(loop, controller=replace(loop.controller, path=path))
    elif part == "derivative":
        loop = replace(loop, controller=replace(loop.controller, kd=0.5, rolloff_time=1e-4))
    elif part == "proportional":
        loop = replace(loop, controller=replace(loop.controller, ki=0.0))
    elif part == "reaction elsewhere":
        loop = replace(loop, placement=Placement(reaction="hub"))
    elif part == "reaction mass":
        loop = replace(loop, mirror=replace(loop.mirror, reaction_mass=MirrorReactionMass(0.9, 1.0, 1.1)))
    elif part == "absorber":
        loop = replace(loop, actuators=(ReactionMassActuator("tip", 0.01, 60.0, 0.05, 0.0, True),))
    return LoopModel(loop, small.modes, small.model.mirror_port)


PARTS = ["plain", "filters", "derivative", "proportional", "reaction elsewhere", "reaction mass", "absorber"]


def test_a_free_rigid_body_turns_no_phase(small, free):
    assert np.count_nonzero(free.modes.stiffness == 0) == 1
    for of in (small, free):
        zeros, poles = loop_transfer_roots(of.design.loop, of.modes, of.model.mirror_port)
        assert not np.any(zeros == 0)
        assert np.count_nonzero(poles == 0) == 1, "the integrator's"
        grid = resonance_grid(np.concatenate([zeros, poles]), 0.01 * HZ, 1e4 * HZ, 400)
        transfer = loop_transfer(of.design.loop, 1j * grid, of.model.points(1j * grid).g)
        phase = loop_phase(zeros, poles, transfer, grid)
        # An integrator at first; beyond all modes the mirror's inertia and the derivative.
        assert (phase[0], phase[-1]) == (pytest.approx(-90, abs=2), pytest.approx(-90, abs=2))


@pytest.mark.parametrize("part", PARTS)
def test_the_phase_is_that_of_the_loop_but_for_whole_turns_and_never_jumps(small, part):
    model = with_parts(small, part)
    zeros, poles = loop_transfer_roots(model.loop, model.modes, model.mirror_port)
    grid = resonance_grid(np.concatenate([zeros, poles]), 0.01 * HZ, 1e4 * HZ, 400, 201)
    transfer = loop_transfer(model.loop, 1j * grid, model.points(1j * grid).g)
    phase = loop_phase(zeros, poles, transfer, grid)
    turned = np.exp(1j * np.radians(phase))
    assert transfer / np.abs(transfer) == pytest.approx(turned, abs=1e-5)
    # So fine a grid leaves no step that unwrapping could mistake.
    expected = np.degrees(np.unwrap(np.angle(transfer)))
    assert phase - phase[0] == pytest.approx(expected - expected[0], abs=1e-3)
    integrators = int(model.loop.controller.ki != 0)
    assert -90 * integrators - 270 < phase[0] <= -90 * integrators + 90


def test_the_loop_vanishes_at_its_zeros_and_grows_without_limit_at_its_poles(small):
    model = with_parts(small, "filters")
    zeros, poles = loop_transfer_roots(model.loop, model.modes, model.mirror_port)

    def size(s, off):
        s = s[(s != 0) & (s.imag >= 0)] * (1 + off)
        return np.abs(loop_transfer(model.loop, s, model.points(s).g))

    # Ten times closer to a simple root, ten times less or more.
    near, nearer = 1e-8, 1e-9
    assert size(zeros, nearer) / size(zeros, near) == pytest.approx(0.1, rel=0.05)
    assert size(poles, nearer) / size(poles, near) == pytest.approx(10, rel=0.05)


def test_a_coarse_grid_has_the_phase_of_a_fine_one_where_unwrapping_goes_astray(small):
    model = with_parts(small, "plain")
    zeros, poles = loop_transfer_roots(model.loop, model.modes, model.mirror_port)
    coarse = np.geomspace(0.5 * HZ, 3000 * HZ, 30)
    fine = np.union1d(coarse, resonance_grid(np.concatenate([zeros, poles]), coarse[0], coarse[-1], 400, 201))
    of = {}
    for name, grid in (("coarse", coarse), ("fine", fine)):
        transfer = loop_transfer(model.loop, 1j * grid, model.points(1j * grid).g)
        of[name] = loop_phase(zeros, poles, transfer, grid)
    assert of["coarse"] == pytest.approx(of["fine"][np.isin(fine, coarse)], abs=1e-6)


def test_a_root_that_is_missing_is_noticed(small):
    model = with_parts(small, "plain")
    zeros, poles = loop_transfer_roots(model.loop, model.modes, model.mirror_port)
    grid = np.geomspace(HZ, 1000 * HZ, 300)
    transfer = loop_transfer(model.loop, 1j * grid, model.points(1j * grid).g)
    kept = np.abs(zeros) > 1.01 * np.sort(np.abs(zeros[zeros.imag != 0]))[0]
    with pytest.raises(SolverError, match="one of them is not found"):
        loop_phase(zeros[kept], poles, transfer, grid)


def test_a_loop_of_the_other_sign_starts_half_a_turn_away(small):
    model = with_parts(small, "plain")
    zeros, poles = loop_transfer_roots(model.loop, model.modes, model.mirror_port)
    grid = np.geomspace(HZ, 1000 * HZ, 300)
    transfer = loop_transfer(model.loop, 1j * grid, model.points(1j * grid).g)
    phase, other = loop_phase(zeros, poles, transfer, grid), loop_phase(zeros, poles, -transfer, grid)
    assert phase - other == pytest.approx(np.full(grid.size, 180.0))
