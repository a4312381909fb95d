"""Bandwidth of the closed loop."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
import reference

from fosopt.actuators import Mirror
from fosopt.control import PID, Loop, closed_loop_poles, closed_loop_response
from fosopt.errors import SolverError
from fosopt.metrics import bandwidth
from fosopt.metrics.bandwidth import closed_loop_bandwidth
from fosopt.metrics.functional import LoopModel
from fosopt.modes import ModalSet

NONE = ModalSet(np.zeros(0), np.zeros(0), np.zeros((0, 2)), reference.PORTS, np.zeros(0, bool))


def closed(loop, modes=NONE):
    model = LoopModel(loop, modes, "tip")
    return model, closed_loop_poles(loop, modes, "tip")


def test_a_second_order_loop_has_the_bandwidth_of_its_closed_form():
    # T = k/(J s² + c s + k) without a spring of the mirror: |T|² = 1/2 is a quadratic equation in ω².
    inertia, kp, damping = 2.0, 800.0, 0.3
    natural = np.sqrt(kp / inertia)
    loop = Loop(Mirror(inertia, natural * 1e-6, damping * 1e6), PID(1.0, kp, 0.0, 0.0))
    middle = 1 - 2 * damping**2
    expected = natural * np.sqrt(middle + sqrt(middle**2 + 1))
    assert closed_loop_bandwidth(*closed(loop)) == pytest.approx(expected, rel=1e-9)


def test_on_a_flexible_truss_nothing_passes_beyond_the_bandwidth_and_dips_below_do_not_count():
    of = reference.structure()
    model, poles = closed(reference.loop_of(reference.mirror_of(of, 0.2)), reference.modes_of(of))
    found = closed_loop_bandwidth(model, poles)

    def size(frequency):
        points = model.points(1j * frequency)
        return np.abs(closed_loop_response("command", model.loop, points.s, points.g))

    edge = np.array([found])
    assert size(edge) == pytest.approx(1 / sqrt(2), rel=1e-9)
    assert size(np.geomspace(1.0001 * found, 50 * found, 200_001)).max() < 1 / sqrt(2)
    assert size(np.geomspace(1.0, found, 200_001)).min() < 1 / sqrt(2)


def test_a_command_response_that_passes_nowhere_has_no_bandwidth():
    loop = Loop(Mirror(1.0, 100.0, 0.7), PID(1.0, 10.0, 0.0, 0.0))
    with pytest.raises(SolverError, match="passes at no frequency"):
        closed_loop_bandwidth(*closed(loop))


def test_a_command_response_that_passes_wherever_one_looks_has_no_bandwidth(monkeypatch):
    loop = Loop(Mirror(1.0, 100.0, 0.7), PID(1.0, 1e6, 0.0, 10.0))
    monkeypatch.setattr(bandwidth, "frequency_grid", lambda *_: np.array([1.0, 2.0, 3.0]))
    with pytest.raises(SolverError, match="passes at every frequency"):
        closed_loop_bandwidth(*closed(loop))
