"""Pole-zero separation of collocated transfer functions."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from scipy import linalg

from fosopt.errors import ModelError
from fosopt.modes import Hub
from fosopt.plant import ModalExpansion, modal_expansion
from fosopt.plant.separation import collocated_separation
from fosopt.structure import mass_matrix, stiffness_matrix

FREE = Hub()


def expansion(frequency, residue, rigid):
    n = len(frequency)
    return ModalExpansion(
        np.array(frequency), np.full(n, 0.01), np.array(residue), np.array([k < rigid for k in range(n)])
    )


def test_one_elastic_mode_has_the_separation_of_its_participation():
    # r0/λ + r1/(λ + ω²): the zero is at ω² r0/(r0 + r1), so that β² = 1 + r1/r0.
    found = collocated_separation(expansion([0.0, 30.0], [0.2, 0.6], 1))
    assert found == pytest.approx([2.0], rel=1e-14, abs=0)


def test_zeros_are_the_frequencies_of_the_structure_held_at_the_port():
    of = reference.structure()
    modes = reference.modes_of(of, FREE)
    found = collocated_separation(modal_expansion(modes, "tip", "tip"))
    free = np.flatnonzero(of.port("tip") == 0)
    block = np.ix_(free, free)
    k = stiffness_matrix(of, of.area)
    m = mass_matrix(of, of.area, of.batten_mass, reference.MIRROR_MASS)
    held = np.sqrt(linalg.eigh(k[block], m[block], eigvals_only=True))
    assert found == pytest.approx(modes.natural_frequency[1:] / held, rel=1e-9, abs=0)
    # A node at the port cancels to one but for the rounding of two square roots.
    assert np.all(found > 1 - 1e-14)


def test_a_mode_that_is_not_seen_cancels():
    found = collocated_separation(expansion([0.0, 10.0, 30.0], [0.2, 0.0, 0.6], 1))
    assert found == pytest.approx([1.0, 2.0], rel=1e-14, abs=0)


@pytest.mark.parametrize(
    ("of", "message"),
    [
        (expansion([0.0, 30.0], [0.2, -0.6], 1), "negative"),
        (expansion([3.0, 30.0], [0.2, 0.6], 1), "held"),
        (expansion([3.0, 30.0], [0.2, 0.6], 0), "0 rigid-body modes"),
    ],
)
def test_a_pair_without_a_zero_below_each_mode_is_refused(of, message):
    with pytest.raises(ModelError, match=message):
        collocated_separation(of)
