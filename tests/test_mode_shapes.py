"""Mode shapes: of coupled modes, of the places that a picture shows, and as few bytes as it needs."""

from __future__ import annotations

from base64 import b64decode
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import reference
import test_study_structures as structures
import two_axes
from foreign_models import NATIVE, evaluated, study_text
from scipy import linalg
from small_studies import STUDIES, section

from fosopt.actuators import Mirror, MirrorReactionMass
from fosopt.control import loop_matrices, modal_matrices
from fosopt.modes import ModalSet
from fosopt.plant import coupled_modes, coupled_shapes, shapes_of_matrices
from fosopt.problem import Evaluation, evaluation_of
from fosopt.structure import (
    assemble,
    assemble_beam,
    barker_beam,
    barker_truss,
    lateral_motion,
    mass_weights,
    motion_at,
    stiffness_weights,
)
from fosopt.study import parse_study
from fosopt.study.build import build_problem
from fosopt.study.detail import detail_of
from fosopt.study.load import load_study
from fosopt.study.shapes import STEPS, kind_of, mode_shapes

MIRROR = Mirror(0.3, 12.0, 0.01)


def modes_of(stiffness: list[float], at_port: list[float]) -> ModalSet:
    frequency = np.sqrt(np.array(stiffness))
    shape = np.array(at_port)[:, None]
    return ModalSet(frequency, np.full(frequency.size, 0.01), shape, ("tip",), frequency == 0)


def residual(modes: ModalSet, mirror: Mirror) -> tuple[float, float, np.ndarray]:
    """Largest relative |K v − λ M v| and error of J̄ = J_m θ (θ − φᵀq), and the shapes, mass-normalized."""
    coupled = coupled_modes(modes, mirror, "tip")
    shapes = coupled_shapes(modes, mirror, "tip", coupled)
    n, port = modes.natural_frequency.size, np.append(-modes.at("tip"), 1.0)
    stiffness = np.diag(np.append(modes.stiffness, 0.0)) + mirror.stiffness * np.outer(port, port)
    mass = np.append(np.ones(n), mirror.inertia)
    shapes = shapes / np.sqrt(mass @ shapes**2)
    force = stiffness @ shapes - mass[:, None] * shapes * coupled.eigenvalue
    reaction = mirror.inertia * shapes[n] * (port @ shapes)
    scale = np.linalg.norm(stiffness)
    return (
        float(np.abs(force).max() / scale),
        float(np.abs(reaction - coupled.effective_modal_reaction_inertia).max()),
        shapes,
    )


# ---- coupled modes ----


@pytest.mark.parametrize("seed", range(4))
def test_coupled_shapes_solve_the_equations_of_structure_and_mirror(seed):
    rng = np.random.default_rng(seed)
    modes = modes_of([*np.sort(rng.uniform(20, 1e5, 8))], [*rng.normal(size=8)])
    error, inertia, shapes = residual(modes, MIRROR)
    assert error < 1e-13
    assert inertia < 1e-13
    gram = np.append(np.ones(8), MIRROR.inertia) * shapes.T @ shapes
    assert gram == pytest.approx(np.eye(9), abs=1e-9)


@pytest.mark.parametrize(
    ("stiffness", "at_port"),
    [
        ([0.0, 50.0, 400.0], [0.7, 1.0, -0.4]),  # free to turn
        ([30.0, 50.0, 400.0], [0.7, 0.0, -0.4]),  # a node at the port
        ([30.0, 400.0, 400.0], [0.7, 0.9, 0.0]),  # repeated, turned so that one mode alone is seen
        ([30.0, 400.0, 400.0], [0.7, 0.0, 0.9]),
        ([30.0, 400.0, 400.0, 400.0], [0.7, 0.5, -0.9, 0.2]),  # repeated, as a file may have them
        ([0.0, 50.0, 50.0, 0.5], [0.7, 1.0, 1.0, 0.0]),  # and out of order
    ],
)
def test_modes_that_the_mirror_cannot_move_have_shapes_of_their_own(stiffness, at_port):
    error, inertia, shapes = residual(modes_of(stiffness, at_port), MIRROR)
    assert error < 1e-13
    assert inertia < 1e-13
    assert np.linalg.matrix_rank(shapes, tol=1e-6) == len(stiffness) + 1


def test_a_mode_that_is_hardly_moved_keeps_its_shape():
    modes = modes_of([100.0, 5000.0], [0.8, 1e-170])
    error, _, shapes = residual(modes, MIRROR)
    assert error < 1e-13
    assert np.abs(shapes[:, 2]) == pytest.approx([0, 1, 0], abs=1e-12)


def test_shapes_of_matrices_belong_to_the_modes_of_matrices():
    loop, modes = two_axes.on_random_modes(3, actuators=True)
    matrices = modal_matrices(loop, modes, "tip")
    shapes = shapes_of_matrices(matrices)
    found = np.diag(shapes.T @ matrices.stiffness @ shapes)
    assert shapes.T @ matrices.mass @ shapes == pytest.approx(np.eye(found.size), abs=1e-12)
    assert np.all(np.diff(found) > 0)


# ---- places ----


def turned(nodes: np.ndarray, axis: np.ndarray) -> np.ndarray:
    return np.cross(axis, np.pad(nodes, ((0, 0), (0, 3 - nodes.shape[1]))))[:, : nodes.shape[1]]


@pytest.mark.parametrize("truss", [barker_truss("pinned", 3), reference.square_mast(2)])
def test_all_nodes_and_battens_turn_with_a_body_that_turns(truss):
    truss = replace(truss, supports={})
    structure = assemble(truss, next(iter(truss.ports)))
    nodes = np.array([*truss.nodes.values()])
    middles = np.array([np.mean([truss.nodes[n] for n in batten.nodes], axis=0) for batten in truss.battens])
    axis = np.array([0.0, 0.0, 1.0]) if nodes.shape[1] == 2 else np.array([0.3, -0.7, 0.5])
    # Motion of each degree of freedom in that rotation about the origin.
    center = dict(truss.nodes) | {b.name: tuple(m) for b, m in zip(truss.battens, middles, strict=True)}
    motion = []
    for name in structure.dofs:
        at, component = name.rsplit(".", 1)
        if component[0] == "r":
            motion.append(axis["xyz".index(component[1])])
        else:
            motion.append(turned(np.array([center[at]]), axis)[0]["xyz".index(component)])
    names = [*truss.nodes, *(batten.name for batten in truss.battens)]
    found = (motion_at(structure, names) @ np.array(motion)).reshape(-1, nodes.shape[1])
    assert found == pytest.approx(turned(np.vstack([nodes, middles]), axis), abs=1e-14)


def test_what_is_held_does_not_move():
    structure = assemble(barker_truss("fixed", 2), "tip")
    held = [at for at, components in structure.truss.supports.items() if len(components) == 3]
    assert held
    assert motion_at(structure, held).nnz == 0


@pytest.mark.parametrize("boundary", ["pinned", "fixed"])
def test_a_beam_moves_between_its_stations_as_at_them(boundary):
    beam = replace(barker_beam(boundary))
    stations = {"near": (2.0, "y"), "far": (6.5, "y"), "turning": (4.0, "rz")}
    structure = assemble_beam(beam, "tip", 5, 2, stations)
    x = np.array([2.0, 6.5, 4.0 - 1e-5, 4.0 + 1e-5])
    found = lateral_motion(structure, x)
    assert found[:2] == pytest.approx(np.array([structure.port("near"), structure.port("far")]), abs=1e-12)
    assert (found[3] - found[2]) / 2e-5 == pytest.approx(structure.port("turning"), abs=1e-6)
    assert not found[:, 5:].any()


# ---- shapes of a design ----


def decoded(text: str) -> np.ndarray:
    # As shape.js does it.
    return np.frombuffer(b64decode(text), np.int8) / 127


def physical(evaluation: Evaluation) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequencies and shapes of the undamped system in the structure's own coordinates [rad/s]."""
    structure, design = evaluation.system.structure, evaluation.design
    k = stiffness_weights(structure, design.area, design.spring_stiffness)
    m = mass_weights(structure, design.area, design.batten_mass, design.mirror_mass)
    b, d = structure.stiffness_rows.toarray(), structure.mass_rows.toarray()
    stiffness, mass = (b.T * k) @ b, (d.T * m) @ d
    if evaluation.system.hub.type == "held":
        # Of the attitude loop, which holds the rigid-body mode alone.
        rigid = mass @ evaluation.frame.shapes[:, 0]
        stiffness = stiffness + np.outer(rigid, rigid) * evaluation.system.hub.bandwidth**2
    whole = loop_matrices(
        design.loop, (mass, 0 * mass, stiffness), structure.port, evaluation.system.mirror_port
    )
    eigenvalue, shapes = linalg.eigh(whole.stiffness, whole.mass)
    return np.sqrt(np.maximum(eigenvalue, 0)), shapes


def design(name: str) -> Evaluation:
    problem = build_problem(load_study(STUDIES / f"{name}.yaml"))
    return problem.evaluate(problem.start, truth=True)


@pytest.mark.parametrize("name", ["quickstart", "reactionless-mirror"])
def test_shapes_are_those_of_the_whole_system_in_its_own_coordinates(name):
    evaluation = design(name)
    structure = evaluation.system.structure
    frequency, shapes = physical(evaluation)
    n = len(structure.dofs)
    places = [structure.truss.ports["tip"][0]]
    found = mode_shapes(evaluation, 25, places)
    assert found is not None
    assert frequency[:25] == pytest.approx(evaluation.coupled.natural_frequency[:25], rel=1e-6)
    nodes = motion_at(structure, [*structure.truss.nodes, *places]) @ shapes[:n]
    port = structure.port("tip") @ shapes[:n]
    for k in range(25):
        largest = np.linalg.norm(nodes[:, k].reshape(-1, 2), axis=1).max()
        drawn = decoded(found["values"][k])
        sign = np.sign(drawn @ nodes[:, k])
        assert drawn == pytest.approx(sign * nodes[:, k] / largest, abs=0.51 / STEPS)
        # Four digits, as a caption shows them.
        turns = sign * np.array([shapes[n, k], port[k]]) / largest
        assert [found["mirror"][k], found["port"][k]] == pytest.approx(turns, rel=6e-4, abs=1e-8)


def test_what_moves_most_moves_by_all_steps_and_to_the_positive_side():
    found = mode_shapes(design("tripod"), 40, [])
    assert found is not None
    for text in found["values"]:
        drawn = decoded(text)
        assert np.linalg.norm(drawn.reshape(-1, 3), axis=1).max() == pytest.approx(1, abs=1 / STEPS)
        assert drawn.max() >= -drawn.min() - 1 / STEPS


def test_a_mode_that_the_mirror_does_not_see_turns_it_by_nothing():
    evaluation = design("tripod")
    found = mode_shapes(evaluation, 3, [])
    assert found is not None
    # The lowest bending modes come as a pair, of which the mirror sees one.
    assert evaluation.coupled.effective_modal_reaction_inertia[1] < 1e-20
    assert (found["mirror"][1], found["port"][1]) == (0.0, 0.0)
    assert abs(found["port"][2]) > 0.1


def test_a_mode_of_the_mirror_and_its_reaction_mass_alone_is_not_drawn():
    known = design("quickstart")
    mirror = replace(known.design.loop.mirror, reaction_mass=MirrorReactionMass(1.0, 1.0, 1.0))
    alike = replace(known.design, loop=replace(known.design.loop, mirror=mirror))
    evaluation = evaluation_of(known.system, alike)
    found = mode_shapes(evaluation, 25, [])
    assert found is not None
    # They swing against each other and load their port with nothing.
    alone = int(np.argmin(np.abs(evaluation.coupled.natural_frequency - mirror.natural_frequency)))
    assert [k for k, text in enumerate(found["values"]) if text is None] == [alone]


def test_a_mirror_of_two_axes_has_shapes_too():
    system, given = two_axes.on_mast()
    evaluation = evaluation_of(system, given)
    found = mode_shapes(evaluation, 40, [])
    assert found is not None
    assert len(found["values"]) == min(40, evaluation.coupled.base.size)


def text_of(text: str) -> tuple[Evaluation, dict[str, Any]]:
    problem = build_problem(parse_study(text))
    evaluation = problem.evaluate(problem.start, truth=True)
    return evaluation, detail_of(evaluation)


def test_a_beam_is_drawn_across_and_its_longitudinal_modes_are_not():
    evaluation, detail = text_of(structures.BEAM)
    assert kind_of(evaluation.system.structure) == "beam"
    values = detail["shapes"]["values"]
    along = [k for k, row in enumerate(detail["modes"]) if row["effective_modal_reaction_inertia"] == 0]
    assert len(along) == 2
    assert [k for k, value in enumerate(values) if value is None] == along
    assert [detail["shapes"]["port"][k] for k in along] == [None, None]
    rigid = decoded(values[0])
    assert np.diff(rigid) == pytest.approx(np.full(60, 1 / 60), abs=1.01 / STEPS), "pinned at its root"


def test_a_chain_has_an_angle_for_each_body_the_held_one_included():
    evaluation, detail = text_of(structures.CHAIN)
    bodies = detail["structure"]["bodies"]
    assert kind_of(evaluation.system.structure) == "chain"
    for text, mirror in zip(detail["shapes"]["values"], detail["shapes"]["mirror"], strict=True):
        drawn = decoded(text)
        assert drawn.size == len(bodies)
        assert np.abs(drawn).max() == 1
        assert np.isfinite(mirror)
    held = structures.CHAIN.replace(section(structures.CHAIN, "hub"), "hub: {type: fixed}\n")
    held = held.replace("  type: chain\n", "  type: chain\n  held: true\n")
    for text in text_of(held)[1]["shapes"]["values"]:
        assert decoded(text).size == 3
        assert decoded(text)[0] == 0


def test_a_model_without_geometry_has_no_shapes():
    evaluation = design("own-model")
    assert kind_of(evaluation.system.structure) is None
    assert detail_of(evaluation)["shapes"] is None


def test_of_a_large_structure_the_modes_that_move_the_mirror_most_are_drawn():
    evaluation = evaluated(
        study_text("structure: {type: barker_truss, boundary: pinned, bays: 150}\n"), Path()
    )
    found = mode_shapes(evaluation, 40, [])
    assert found is not None
    drawn = [k for k, text in enumerate(found["values"]) if text is not None]
    # Of 302 nodes six thousand numbers are nine modes.
    assert len(drawn) == 6000 // 604
    reaction = np.abs(evaluation.coupled.effective_modal_reaction_inertia[:40])
    assert min(reaction[drawn]) >= max(np.delete(reaction, drawn))


def test_places_move_with_the_node_or_batten_they_are_at():
    evaluation, detail = text_of(study_text(NATIVE))
    truss, places = evaluation.system.structure.truss, detail["places"]
    tip = next(k for k, place in enumerate(places) if place["kind"] == "mirror")
    ends = [i for i, node in enumerate(truss.nodes) if node in truss.battens[-1].nodes]
    for text in detail["shapes"]["values"]:
        drawn = decoded(text).reshape(-1, 2)
        assert drawn.shape[0] == len(truss.nodes) + len(places)
        assert drawn[len(truss.nodes) + tip] == pytest.approx(drawn[ends].mean(axis=0), abs=1.01 / STEPS)
