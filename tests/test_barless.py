"""Structures without bars, beams and chains, through everything that stands above a structure."""

from __future__ import annotations

import numpy as np
import pytest
import reference

from fosopt.metrics.step import StepCommand
from fosopt.modes import Hub
from fosopt.ops import Array
from fosopt.problem import Design, Evaluation, System
from fosopt.structure import (
    Chain,
    Structure,
    assemble_beam,
    assemble_chain,
    barker_beam,
    mass_matrix,
    stiffness_matrix,
    structural_mass,
    structure_inertia,
)
from fosopt.symbolic import structure_functions

NONE = np.zeros(0)
STEPS = (2e-4, 5e-5, 1.2e-5, 3e-6)
STRUCTURES = {
    "pinned beam": (assemble_beam(barker_beam(), lateral_modes=8), reference.HELD),
    "fixed beam": (assemble_beam(barker_beam("fixed"), lateral_modes=7, longitudinal_modes=2), Hub("fixed")),
    "free chain": (assemble_chain(Chain({"a": 30.0, "b": 9.0, "c": 4.0}, (4e4, 9e5))), reference.HELD),
    "held chain": (assemble_chain(Chain({"a": 30.0, "b": 9.0, "c": 4.0}, (4e4, 9e5), True)), Hub("fixed")),
}


def system_and_design(name: str) -> tuple[System, Design]:
    structure, hub = STRUCTURES[name]
    loop = reference.loop_of(reference.mirror_of(structure, 0.3), 1e-4)
    step = StepCommand(1e-6, (0.05, 0.1))
    system = System(structure, "tip", hub, reference.DAMPING, reference.DISTURBANCES, step)
    return system, Design(structure.area, structure.batten_mass, structure.spring_stiffness, 50.0, loop)


@pytest.mark.parametrize("name", STRUCTURES)
def test_gradients_over_the_mirror_and_the_loop_are_those_of_central_differences(name: str) -> None:
    system, design = system_and_design(name)
    base = design.parameters
    assert design.area.shape == design.batten_mass.shape == design.spring_stiffness.shape == (0,)
    evaluation = Evaluation(system, design)
    assert evaluation.stable
    names: list[tuple[str, int | None]] = [(metric, None) for metric in system.metric_names]
    names += [("natural_frequency", 1), ("modal_inertia", 2)]
    names.append(("pole_zero_separation", 2 if evaluation.coupled.mirror_mode == 2 else 3))
    gradients = np.array([evaluation.metric(*each)[1] for each in names])
    assert gradients.shape == (len(names), base.size)
    values = np.array([evaluation.value(*each) for each in names])
    rng = np.random.default_rng(4)
    for _ in range(2):
        direction = base * rng.normal(size=base.size)

        def along(t: float, direction: Array = direction) -> Array:
            moved = Evaluation(system, design.with_parameters(base + t * direction))
            return np.array([moved.value(*each) for each in names])

        expected, error = reference.plateau(along, STEPS)
        # Differences admit their own error; a derivative small against its value is known to 1e-8 of it.
        allowed = 1e-6 * np.abs(expected) + 3 * error + 1e-8 * np.abs(values)
        wrong = np.flatnonzero(~(np.abs(gradients @ direction - expected) <= allowed))
        assert not wrong.size, [names[i] for i in wrong]


@pytest.mark.parametrize("name", STRUCTURES)
def test_numbers_and_symbols_give_the_same_matrices_mass_and_inertia(name: str) -> None:
    structure: Structure = STRUCTURES[name][0]
    functions = structure_functions(structure)
    given = (NONE, NONE, NONE, 50.0)
    for symbolic, number in (
        (functions.stiffness_matrix, stiffness_matrix(structure, NONE)),
        (functions.mass_matrix, mass_matrix(structure, NONE, NONE, 50.0)),
        (functions.structural_mass, structural_mass(structure, NONE, NONE)),
        (functions.structure_inertia, structure_inertia(structure, NONE, NONE)),
    ):
        assert np.abs(symbolic(*given).full() - number).max() <= 1e-14 * np.abs(number).max()
