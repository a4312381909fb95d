"""Closed-loop poles are found in a few steps from good guesses, without the dense solver that would hide bad ones.

A guess is off by the square of what the loop couples, and each step is at least quadratic: four are enough where a
mirror is light, ten where it weighs as much as a fifth of what carries it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
import test_filters
import test_placement

from fosopt.control import closed_loop_poles, many, poles
from fosopt.control.open_loop import OpenLoopPoles
from fosopt.modes import Hub

FEW, SOME = 4, 10


@pytest.fixture
def steps(monkeypatch):
    """How often receptances are evaluated at all poles, one at a time or for many loops together."""
    counted = []

    def count(owner):
        own = owner.sums

        def sums(*given):
            counted.append(owner)
            return own(*given)

        monkeypatch.setattr(owner, "sums", sums)

    count(OpenLoopPoles)
    count(many)

    def refuse(*_):
        raise AssertionError("Aberth's method gave up")

    monkeypatch.setattr(poles, "_dense", refuse)
    return counted


@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_the_benchmark_problem_takes_a_few_steps(case, steps):
    loop, modes = reference.benchmark(case)
    closed_loop_poles(loop, modes, "tip")
    assert len(steps) <= FEW


@pytest.mark.parametrize("terms", [{}, {"rolloff_time": 1e-4}, {"ki": 0.0}, {"kd": 0.0}], ids=str)
@pytest.mark.parametrize(
    ("percent", "most"), [(1e-4, FEW), (0.02, FEW), (0.2, FEW), (2.0, SOME), (20.0, SOME)]
)
def test_a_truss_takes_more_steps_the_heavier_its_mirror(percent, most, terms, steps):
    of = reference.structure()
    closed_loop_poles(
        reference.loop_of(reference.mirror_of(of, percent), **terms), reference.modes_of(of), "tip"
    )
    assert len(steps) <= most


@pytest.mark.parametrize("rolloff_time", [0.0, 1e-4])
@pytest.mark.parametrize("name", test_filters.PATHS)
def test_filters_take_no_step_more(name, rolloff_time, steps):
    loop, modes = test_filters.filtered(test_filters.PATHS[name], rolloff_time)
    closed_loop_poles(loop, modes, "tip")
    assert len(steps) <= FEW


@pytest.mark.parametrize("hub", [reference.HELD, Hub("free")], ids=["held", "free"])
@pytest.mark.parametrize("name", test_placement.CASES)
def test_other_places_and_actuators_take_no_step_more(name, hub, steps):
    evaluation = test_placement.case(name, hub)
    modes = evaluation.modes
    steps.clear()
    closed_loop_poles(evaluation.design.loop, modes, "tip")
    assert len(steps) <= FEW


def test_poles_of_a_neighbor_are_the_best_guess(steps):
    of = reference.structure()
    modes = reference.modes_of(of)
    loop, near = (reference.loop_of(reference.mirror_of(of, percent)) for percent in (2.0, 2.02))
    guess = closed_loop_poles(near, modes, "tip")
    steps.clear()
    closed_loop_poles(loop, modes, "tip", near=guess)
    assert len(steps) <= 3
    steps.clear()
    closed_loop_poles(near, modes, "tip", near=guess)
    assert len(steps) <= 1


@pytest.mark.parametrize("reaction_mass", [None, test_placement.MISMATCH], ids=["plain", "reaction mass"])
def test_many_loops_together_take_no_more_steps_than_one(reaction_mass, steps):
    of = reference.structure()
    modes = reference.modes_of(of)
    loops = [
        reference.loop_of(replace(reference.mirror_of(of, percent), reaction_mass=reaction_mass))
        for percent in np.geomspace(0.02, 0.2, 9)
    ]
    near = closed_loop_poles(loops[0], modes, "tip")
    steps.clear()
    found = many.many_closed_loop_poles(loops, modes, "tip", near)
    assert None not in found
    # The first, the last, and three times those half way between.
    assert len(steps) <= 5 * FEW
