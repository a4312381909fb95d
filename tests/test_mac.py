"""The modal assurance criterion, the matching of modes, and the dissertation's truss beside its beam."""

from __future__ import annotations

import numpy as np
import pytest
import reference

from fosopt.errors import ModelError
from fosopt.modes import match_modes, modal_assurance
from fosopt.structure import barker_beam

ROUNDING = 1e-14


def test_the_criterion_is_the_squared_cosine_between_two_shapes():
    first = np.array([[1.0, 3.0], [2.0, 0.0]])
    second = np.array([[2.0, 0.0, 1.0], [4.0, 5.0, 1.0]])
    expected = np.array([[1.0, 4 / 5, 9 / 10], [1 / 5, 0.0, 1 / 2]])
    assert np.abs(modal_assurance(first, second) - expected).max() <= ROUNDING


def test_scale_sign_and_phase_do_not_count():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(9, 4)), rng.normal(size=(9, 3)) + 1j * rng.normal(size=(9, 3))
    plain = modal_assurance(first, second)
    scaled = modal_assurance(
        first * [2.0, -1e-6, 1e8, 1.0], second * np.exp([1j, 2j, 3j]) * [5.0, -1.0, 1e-9]
    )
    assert np.abs(scaled - plain).max() <= ROUNDING
    assert np.abs(modal_assurance(second, second).diagonal() - 1).max() <= ROUNDING
    assert np.abs(modal_assurance(second, first) - plain.T).max() <= ROUNDING
    # Without conjugation the criterion of a circular shape with itself would be zero.
    circle = np.array([[1.0], [1j]])
    assert modal_assurance(circle, circle) == pytest.approx(np.ones((1, 1)))
    assert modal_assurance(circle, circle.conj()) == pytest.approx(np.zeros((1, 1)))


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (np.ones((3, 1)), np.ones((4, 1)), r"shapes of \(3, 1\) and \(4, 1\)"),
        (np.ones(3), np.ones((3, 1)), r"shapes of \(3,\) and \(3, 1\)"),
        (
            np.ones((2, 2)),
            np.array([[1.0, 0.0], [1.0, 0.0]]),
            "mode 2 of the second set is zero or not finite",
        ),
        (np.array([[np.nan], [1.0]]), np.ones((2, 1)), "mode 1 of the first set is zero or not finite"),
    ],
)
def test_shapes_that_cannot_be_compared_are_refused(first, second, message):
    with pytest.raises(ModelError, match=message):
        modal_assurance(first, second)


def test_a_permuted_set_is_matched_back():
    rng = np.random.default_rng(1)
    shapes = rng.normal(size=(12, 6))
    order = rng.permutation(6)
    found = match_modes(modal_assurance(shapes, shapes[:, order]))
    assert order[found].tolist() == list(range(6))


def test_each_mode_is_used_once_and_the_total_counts():
    # The first mode likes the same partner best as the second one, which has no other.
    assurance = np.array([[0.9, 0.8], [0.85, 0.1]])
    assert match_modes(assurance).tolist() == [1, 0]


def test_modes_that_agree_too_little_stay_alone():
    assurance = np.array([[0.95, 0.02, 0.0], [0.01, 0.4, 0.3]])
    assert match_modes(assurance).tolist() == [0, -1]
    assert match_modes(assurance, least=0.35).tolist() == [0, 1]
    assert match_modes(np.array([[0.6]])).tolist() == [0]
    # More modes than partners, and none at all.
    assert match_modes(assurance.T).tolist() == [0, -1, -1]
    assert match_modes(np.zeros((2, 0))).tolist() == [-1, -1]
    assert match_modes(np.zeros((2, 2)), least=0.0).tolist() == [-1, -1]


@pytest.mark.parametrize(("boundary", "count"), [("fixed", 5), ("pinned", 6)])
def test_the_modes_of_the_dissertations_truss_are_those_of_its_beam_in_order(boundary, count):
    of, beam = reference.structure(boundary), barker_beam(boundary)
    rows = [of.dofs.index(f"B{i}.{component}") for component in "yx" for i in range(1, 21)]
    truss = reference.frame(of, 0.0).shapes[rows, :count]
    x = np.arange(1, 21) * beam.length / 20
    bending, stretch = beam.lateral_modes(count - 1), beam.longitudinal_modes(1)
    shapes = np.zeros((40, count))
    shapes[:20, : count - 1], shapes[20:, count - 1] = bending.shape(x).T, stretch.shape(x)[0]
    order = np.argsort(np.concatenate([bending.natural_frequency, stretch.natural_frequency]))
    assurance = modal_assurance(truss, shapes[:, order])
    assert match_modes(assurance).tolist() == list(range(count))
    # Figures 2.4 and 2.6 show the two side by side; the higher, the more shear and rotary inertia tell.
    assert assurance.diagonal().min() > 0.95
    assert (assurance - np.diag(assurance.diagonal())).max() < 0.02
