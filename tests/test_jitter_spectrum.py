"""Where in frequency the jitter comes from, by source and by mode."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest
import reference
from scipy import linalg, signal

from fosopt.control import closed_loop_response, closed_loop_state_space
from fosopt.errors import UnstableError
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.spectrum import jitter_spectrum
from fosopt.problem import Evaluation

# Of shares: what the quadrature of a resonance and eigenvectors of a 140-state matrix leave.
SHARE = 1e-8
# Of a sum of thousands of steps, each known to 16 digits.
ROUNDING = 1e-13


@pytest.fixture(scope="module")
def found(evaluation):
    return jitter_spectrum(evaluation.model, evaluation.poles, evaluation.system.disturbances)


def test_all_that_lies_below_the_last_frequency_is_the_variance_of_each_source(evaluation, found):
    for curve, disturbance in zip(found.by_source, evaluation.system.disturbances, strict=True):
        exact = evaluation.variances[f"jitter_{disturbance.name}"].value
        assert curve[-1] / exact == pytest.approx(1, rel=1e-9)
        assert np.diff(curve).min() >= -ROUNDING * exact
        assert 0 <= curve[0] < 1e-3 * exact


def test_the_mean_square_below_a_frequency_is_that_of_a_band_that_ends_there(evaluation, found):
    (torque,) = [d for d in evaluation.system.disturbances if d.at == "hub_torque"]
    row = evaluation.system.disturbances.index(torque)
    # The steepest place and two behind it.
    top = found.frequency[np.argmax(found.density[row])]
    for edge in (top, 1.001 * top, 3 * top):
        assert below(evaluation, torque, found, row, edge) == pytest.approx(1, rel=2e-3)


def below(evaluation, torque, found, row, edge):
    """Mean square below a frequency, as found over that by a fine trapezoid rule."""
    grid = np.linspace(1e-3, edge, 40_001)
    points = evaluation.model.points(1j * grid)
    density = (
        torque.one_sided_psd(grid)
        * np.abs(closed_loop_response(torque.at, evaluation.model.loop, points.s, points.g)) ** 2
        / (2 * pi)
    )
    return np.interp(edge, found.frequency, found.by_source[row]) / np.trapezoid(density, grid)


def test_the_density_is_that_of_the_line_of_sight(evaluation, found):
    some = found.frequency.size // 3
    for row, disturbance in zip(found.density, evaluation.system.disturbances, strict=True):
        points = evaluation.model.points(1j * found.frequency[some : some + 1])
        response = closed_loop_response(disturbance.at, evaluation.model.loop, points.s, points.g)[0]
        expected = disturbance.one_sided_psd(found.frequency[some : some + 1])[0] * abs(response) ** 2
        assert row[some] == pytest.approx(expected, rel=1e-12, abs=0)


def shares_by_lyapunov(evaluation, pole):
    """Covariance of what an eigenvector contributes to the line of sight with the whole, summed over the sources."""
    loop = closed_loop_state_space(evaluation.design.loop, evaluation.modes, evaluation.system.mirror_port)
    row = loop.outputs.index("line_of_sight")
    values, left, right = linalg.eig(loop.a, left=True, right=True)
    here = np.argmin(np.abs(values - pole))
    assert abs(values[here] - pole) < 1e-7 * abs(pole)
    onto = np.outer(right[:, here], left[:, here].conj()) / (left[:, here].conj() @ right[:, here])
    total = 0.0
    for disturbance in evaluation.system.disturbances:
        shape, column = disturbance.filter, loop.inputs.index(disturbance.at)
        b, d = loop.b[:, [column]], loop.d[row, column]
        fa, fb, fc, fd = signal.tf2ss(shape.numerator, shape.denominator)
        size, own = loop.a.shape[0], fa.shape[0]
        a = np.block([[loop.a, b @ fc], [np.zeros((own, size)), fa]])
        drive = np.vstack([b @ fd, fb])
        output = np.concatenate([loop.c[row], d * fc[0]])
        covariance = linalg.solve_continuous_lyapunov(a, -drive @ drive.T)
        part = np.concatenate([2 * np.real(loop.c[row] @ onto), np.zeros(own)])
        total += part @ covariance @ output
    return total


def test_the_share_of_a_mode_is_the_covariance_of_its_part_with_the_whole(evaluation, found):
    rational = all(d.by_residues for d in evaluation.system.disturbances)
    assert rational, "the Lyapunov route needs rational spectra over all frequencies"
    whole = found.by_source[:, -1].sum()
    largest = np.argsort(-np.abs(found.by_mode[:, -1]))[:4]
    for k in largest:
        expected = shares_by_lyapunov(evaluation, found.pole[k])
        assert found.by_mode[k, -1] / whole == pytest.approx(expected / whole, abs=SHARE)
    assert np.abs(found.by_mode[largest, -1]).max() > 1e-3 * whole, "a share that is nothing shows nothing"


def test_shares_of_modes_and_loop_add_to_the_whole_at_every_frequency(found):
    below = found.by_source.sum(axis=0)
    together = found.by_mode.sum(axis=0) + found.by_loop
    assert together / below[-1] == pytest.approx(below / below[-1], abs=1e-12)


def test_each_mode_is_counted_once_and_knows_where_it_came_from(evaluation, found):
    elastic = evaluation.modes.natural_frequency
    assert np.sort(np.abs(found.origin)) == pytest.approx(np.sort(elastic[elastic > 0]), rel=1e-9)
    assert found.by_mode.shape == (found.pole.size, found.frequency.size)
    assert np.all(np.diff(found.frequency) > 0)


def test_bands_and_tables_end_where_they_end():
    of = reference.evaluation()
    rows = 2 * pi * np.array([2.0, 5.0, 30.0])
    table = Disturbance("table", "hub_torque", frequency=rows, psd=np.array([1.0, 4.0, 0.5]))
    first = of.system.disturbances[0]
    banded = replace(first, name="banded", band=(2 * pi * 3.0, 2 * pi * 40.0))
    system = replace(of.system, disturbances=(table, banded))
    other = Evaluation(system, of.design)
    found = jitter_spectrum(other.model, other.poles, system.disturbances)
    for k, each in enumerate(system.disturbances):
        exact = other.variances[f"jitter_{each.name}"].value
        assert found.by_source[k, -1] / exact == pytest.approx(1, rel=1e-9)
        low, high = each.counted
        assert not found.density[k, (found.frequency < low) | (found.frequency > high)].any()


def test_an_unstable_loop_has_no_spectrum(evaluation):
    poles = replace(
        evaluation.poles, shift=evaluation.poles.shift + 2 * np.abs(evaluation.poles.value.real).max()
    )
    with pytest.raises(UnstableError, match="unstable"):
        jitter_spectrum(evaluation.model, poles, evaluation.system.disturbances)


def test_a_spectrum_that_falls_over_many_decades_below_every_pole_keeps_its_variance():
    # Two rows a million times apart, with nothing but a power law between them.
    of = reference.evaluation()
    slowest = np.abs(of.poles.all).min()
    rows = slowest * np.array([1e-6, 1.0])
    steep = Disturbance(
        "drift", "line_of_sight", frequency=rows, psd=np.array([1.0, 1e-18]), interpolation="log"
    )
    other = Evaluation(replace(of.system, disturbances=(steep,)), of.design)
    found = jitter_spectrum(other.model, other.poles, (steep,))
    assert found.by_source[0, -1] / other.variances["jitter_drift"].value == pytest.approx(1, rel=1e-9)
