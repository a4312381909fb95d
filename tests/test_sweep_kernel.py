"""Coupled modes of many mirrors at once, against one at a time and against arithmetic of fifty digits."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal, localcontext

import numpy as np
import pytest
import reference

from fosopt.actuators import Mirror
from fosopt.errors import ModelError
from fosopt.modes import Hub, ModalSet
from fosopt.plant import coupled_modes
from fosopt.plant.sweep import coupled_sweep

HZ = reference.HZ
PARTS = ("eigenvalue", "effective_modal_reaction_inertia", "zero", "separation")


def plain(frequency, shape):
    n = len(frequency)
    return ModalSet(
        np.array(frequency, dtype=float),
        np.zeros(n),
        np.array(shape, dtype=float)[:, None],
        ("tip",),
        np.zeros(n, bool),
    )


def same_as_one_by_one(modes, inertia, frequency, tolerance=1e-12):
    swept = coupled_sweep(modes, "tip", np.array(inertia), frequency)
    frequencies = np.broadcast_to(frequency, len(inertia))
    for q, (j, w) in enumerate(zip(inertia, frequencies, strict=True)):
        expected, found = coupled_modes(modes, Mirror(j, w, 0.0), "tip"), swept[q]
        assert found.mirror_mode == expected.mirror_mode
        for part in PARTS:
            a, b = getattr(found, part), getattr(expected, part)
            assert np.array_equal(np.isnan(a), np.isnan(b))
            known = ~np.isnan(b)
            assert np.all(np.abs(a[known] - b[known]) <= tolerance * np.abs(b[known])), (part, j, w)


@pytest.mark.parametrize("hub", [reference.HELD, Hub("free")], ids=["held", "free"])
def test_a_sweep_of_inertia_is_one_mirror_after_another(hub):
    modes = reference.modes_of(reference.structure(), hub)
    inertia = np.geomspace(1e-9, 1e3, 60) * reference.inertia_of(reference.structure())
    same_as_one_by_one(modes, inertia, 20 * HZ)


def test_points_in_any_order_and_of_any_frequency_are_one_mirror_after_another():
    modes = reference.modes_of(reference.structure())
    rng = np.random.default_rng(4)
    inertia = 10.0 ** rng.uniform(-9, 3, 60) * reference.inertia_of(reference.structure())
    same_as_one_by_one(modes, inertia, 10.0 ** rng.uniform(-1, 4.5, 60) * HZ)


def test_a_mirror_tuned_to_a_structural_mode_splits_it():
    modes = reference.modes_of(reference.structure()).keep(slice(0, 7))
    tuned = float(modes.natural_frequency[4])
    same_as_one_by_one(modes, np.geomspace(1e-8, 1e2, 40), tuned)
    # Two modes part as the square root of the coupling.
    swept = coupled_sweep(modes, "tip", np.array([1e-8, 1e-6]), tuned)
    gap = np.diff(swept.natural_frequency, axis=1)[:, 4]
    assert gap[1] / gap[0] == pytest.approx(10.0, rel=1e-3)


def test_modes_with_a_node_at_the_port_stay_where_they_are():
    modes = plain([10.0, 20.0, 35.0], [0.5, 0.0, 0.7])
    same_as_one_by_one(modes, np.geomspace(1e-3, 1e3, 9), 25.0)
    swept = coupled_sweep(modes, "tip", np.array([1.0]), 25.0)
    assert 20.0 in swept.natural_frequency[0]


def test_repeated_structural_frequencies_leave_one_mode_between_them():
    modes = plain([10.0, 20.0, 20.0 * (1 + 1e-12), 35.0], [0.5, 0.3, 0.4, 0.7])
    same_as_one_by_one(modes, np.geomspace(1e-3, 1e3, 9), 25.0, 1e-9)


def test_modes_of_one_frequency_act_as_one_and_leave_the_other_where_it_is():
    twins = plain([10.0, 20.0, 20.0, 35.0], [0.5, 0.3, 0.4, 0.7])
    one = plain([10.0, 20.0, 35.0], [0.5, 0.5, 0.7])
    inertia = np.geomspace(1e-3, 1e3, 9)
    same_as_one_by_one(twins, inertia, 25.0)
    found = coupled_sweep(twins, "tip", inertia, 25.0).natural_frequency
    expected = coupled_sweep(one, "tip", inertia, 25.0).natural_frequency
    for row, alone in zip(found, expected, strict=True):
        assert np.sort(row) == pytest.approx(np.sort([*alone, 20.0]), rel=1e-12)


def test_a_mirror_on_nothing_that_moves_is_alone():
    swept = coupled_sweep(plain([10.0, 20.0], [0.0, 0.0]), "tip", np.array([1.0, 2.0]), 15.0)
    assert swept.natural_frequency == pytest.approx(np.array([[10.0, 15.0, 20.0]] * 2), rel=1e-12)
    assert swept.effective_modal_reaction_inertia == pytest.approx(np.array([[0, 1.0, 0]] * 2), abs=1e-12)
    assert list(swept.mirror_mode) == [1, 1]


@pytest.mark.parametrize("hertz", [0.5, 20.0, 1e4])
def test_effective_inertias_sum_to_one_at_every_inertia(hertz):
    modes = reference.modes_of(reference.structure())
    inertia = np.geomspace(1e-9, 1e3, 200) * reference.inertia_of(reference.structure())
    total = coupled_sweep(modes, "tip", inertia, hertz * HZ).effective_modal_reaction_inertia.sum(axis=1)
    assert np.abs(total - 1).max() < 1e-11


def exact_separation(frequency, shape, inertia, mirror, below, digits=50):
    """1 − β of the modes paired with poles, by bisection in decimal arithmetic."""
    with localcontext() as context:
        context.prec = 2 * digits
        poles = [Decimal(float(w)) ** 2 for w in frequency]
        weights = [Decimal(float(h)) ** 2 for h in shape]
        square = Decimal(mirror) ** 2
        k = Decimal(inertia) * square

        def f(pole, x):
            value = square - (pole + x)
            for p, w in zip(poles, weights, strict=True):
                value -= (pole + x) * k * w / ((p - pole) - x)
            return value

        found = []
        for i, pole in enumerate(poles):
            # Below the mirror a root hangs under its pole, above it stands on it.
            edge = (
                (poles[i - 1] if i else Decimal(0))
                if i < below
                else (poles[i + 1] if i + 1 < len(poles) else 9 * pole)
            )
            near, far = Decimal(10) ** -60 * (edge - pole), (edge - pole) * (1 - Decimal(10) ** -40)
            up = f(pole, near) > 0
            for _ in range(400):
                # The root may be anywhere over sixty decades: halve its logarithm.
                middle = (near * far).sqrt().copy_sign(far)
                if (f(pole, middle) > 0) == up:
                    near = middle
                else:
                    far = middle
            ratio = (1 + near / pole).sqrt()
            found.append(-near / pole / (1 + ratio))
        return found


@pytest.mark.parametrize("exponent", [-28, -20, -12, -6, -2, 1])
def test_one_minus_beta_has_all_its_digits_down_to_thirty_decades(exponent):
    frequency, shape = [3.0, 31.0, 60.0, 190.0, 410.0, 905.0], [0.3, 1e-2, 0.7, 0.1, 1.1, 1e-4]
    inertia = 10.0**exponent
    swept = coupled_sweep(plain(frequency, shape), "tip", np.array([inertia]), 125.0)
    found = np.delete(swept.one_minus_separation[0], swept.mirror_mode[0])
    expected = exact_separation(frequency, shape, inertia, 125.0, below=3)
    error = [abs(float((Decimal(float(a)) - b) / b)) for a, b in zip(found, expected, strict=True)]
    assert max(error) < 1e-12
    if exponent == -28:
        assert np.abs(found).min() < 1e-30


@pytest.mark.parametrize(
    ("inertia", "frequency"), [([1.0, 0.0], 9.0), ([1.0, np.nan], 9.0), ([1.0], -3.0), ([np.inf], 3.0)]
)
def test_what_is_no_mirror_is_refused(inertia, frequency):
    with pytest.raises(ModelError, match="mirror: "):
        coupled_sweep(plain([10.0], [0.5]), "tip", np.array(inertia), frequency)


def test_a_sweep_depends_on_nothing_but_the_modes_at_the_port():
    modes = reference.modes_of(reference.structure()).keep(slice(0, 9))
    other = replace(modes, damping_ratio=modes.damping_ratio * 7)
    inertia = np.geomspace(1e-3, 1e3, 11)
    a, b = (coupled_sweep(m, "tip", inertia, 100.0) for m in (modes, other))
    assert np.array_equal(a.distance, b.distance)
