"""Turns of the Nyquist plot against the poles of the closed loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference

from fosopt.control import closed_loop_poles
from fosopt.errors import SolverError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.nyquist import encirclements


def counted(loop, modes):
    return encirclements(LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip"))


def unstable(loop, modes):
    poles = closed_loop_poles(loop, modes, "tip")
    return int(poles.multiplicity[poles.value.real > 0].sum())


def test_the_plot_turns_around_minus_one_once_for_each_unstable_pole():
    rng = np.random.default_rng(1)
    loops = [
        reference.random_loop(rng, **pid)
        for pid in ({}, {"rolloff_time": 1e-3}, {"ki": 0.0})
        for _ in range(25)
    ]
    expected = [unstable(*each) for each in loops]
    assert [counted(*each) for each in loops] == expected
    assert len(set(expected)) >= 3  # stable loops and loops with one and more unstable pairs are among them


@pytest.mark.parametrize(("case", "turns"), [(1, 0), (2, 2), (3, 0), (4, 0)])
def test_the_benchmark_problem_has_one_unstable_pair_in_case_2(case, turns):
    assert counted(*reference.benchmark(case)) == turns


def test_a_plot_through_minus_one_is_refused():
    loop, modes = reference.benchmark(2)

    def abscissa(gain):
        with_gain = replace(loop, controller=replace(loop.controller, gain=gain))
        return with_gain, closed_loop_poles(with_gain, modes, "tip").spectral_abscissa

    # Above the published gain the pair comes back into the left half plane.
    low, high = 1300.0, 5000.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if abscissa(middle)[1] > 0 else (low, middle)
    with pytest.raises(SolverError, match="passes through −1"):
        counted(abscissa(low)[0], modes)
