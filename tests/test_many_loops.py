"""Closed loops of many mirrors together, against one at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference

from fosopt.actuators import MirrorReactionMass
from fosopt.control import Loop, closed_loop_poles
from fosopt.control.many import many_closed_loop_poles
from fosopt.errors import UnstableError
from fosopt.metrics.disturbances import Disturbance, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.jitter_many import many_jitter_variances
from fosopt.modes import Hub


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
    together = many_closed_loop_poles(loops, near)
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
    together = many_closed_loop_poles(loops, closed_loop_poles(loops[0], modes, "tip"))
    for loop, poles in zip(loops, together, strict=True):
        assert poles is not None
        alone = closed_loop_poles(loop, modes, "tip", near=poles)
        pairs = poles.multiplicity == 2
        order, other = np.argsort(poles.value.imag[pairs]), np.argsort(alone.value.imag[pairs])
        np.testing.assert_allclose(poles.shift[pairs][order], alone.shift[pairs][other], rtol=1e-9)


def test_jitter_found_together_is_that_found_alone_and_none_where_unstable():
    modes = reference.modes_of(reference.structure())
    loops = sweep(np.geomspace(0.02, 5, 12), rolloff_time=1e-4)
    poles = many_closed_loop_poles(loops, closed_loop_poles(loops[0], modes, "tip"))
    found = many_jitter_variances(loops, poles, modes, "tip", reference.DISTURBANCES)
    unstable = 0
    for loop, each, row in zip(loops, poles, found, strict=True):
        model = LoopModel(loop, modes, "tip")
        try:
            alone = jitter_variances(model, each, reference.DISTURBANCES)
        except UnstableError:
            unstable += 1
            assert np.isnan(row).all()
            continue
        assert row == pytest.approx([variance.value for variance in alone], rel=1e-11)
    assert 0 < unstable < len(loops)


def test_a_spectrum_without_residues_is_left_to_the_quadrature():
    modes = reference.modes_of(reference.structure())
    loops = sweep([0.1, 0.2])
    poles = many_closed_loop_poles(loops, closed_loop_poles(loops[0], modes, "tip"))
    banded = Disturbance("banded", "line_of_sight", low_pass(50.0, 1e-5), band=(1.0, 100.0))
    found = many_jitter_variances(loops, poles, modes, "tip", (banded, reference.DISTURBANCES[2]))
    assert np.isnan(found[:, 0]).all()
    assert not np.isnan(found[:, 1]).any()


def test_loops_of_other_forms_are_left_alone():
    modes = reference.modes_of(reference.structure())
    plain = sweep([0.1, 0.2])
    near = closed_loop_poles(plain[0], modes, "tip")
    counter = Loop(replace(plain[1].mirror, reaction_mass=MirrorReactionMass(0.9)), plain[1].controller)
    no_integral = Loop(plain[1].mirror, replace(plain[1].controller, ki=0.0))
    for odd in (counter, no_integral):
        assert many_closed_loop_poles([plain[0], odd], near) == [None, None]


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
