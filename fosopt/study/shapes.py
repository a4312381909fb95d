"""Mode shapes of a design as finely as a picture needs them, by the rows of the report's table of modes."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from fosopt.control import modal_matrices
from fosopt.ops import Array
from fosopt.plant import coupled_shapes, shapes_of_matrices
from fosopt.problem import Evaluation
from fosopt.structure import Structure, lateral_motion, motion_at

STEPS = 127
"""Steps of the largest displacement of a shape: a byte holds them, and half of one is less than a pixel."""

_STATIONS = 61  # of a beam
_NUMBERS = 6_000  # in the shapes of a design, as far as the fewest modes leave the choice
_FEWEST = 8
# What moves by less than this share of the largest displacement, a rotation at the structure's length, stands still.
_STILL = 1e-9


def mode_shapes(evaluation: Evaluation, rows: int, places: Sequence[str]) -> dict[str, Any] | None:
    """Shapes of the lowest coupled modes; None where the structure has no geometry, as a modal set has none.

    Displacements of all nodes of a truss one by one and then of further places, of equidistant stations across a beam,
    or angles of the bodies of a chain, each in `STEPS` of the largest one of its mode: a signed byte each, in base64.
    A mode that moves none of these has None in their place, and so have those of a large structure that matter less to
    the mirror: what is left are the ones with the largest effective modal reaction inertias.

    Parameters
    ----------
    rows
        How many modes the table has.
    places
        Names of nodes and battens where something is attached to a truss.

    Returns
    -------
    dict
        `values`, and angles of `mirror` and `port` per displacement of what moves most [rad/m], or per its angle.
    """
    structure = evaluation.system.structure
    motion, components = _motion(structure, places)
    if motion is None:
        return None
    shapes = _in_modes(evaluation)[:, :rows]
    count = evaluation.modes.natural_frequency.size
    moved = evaluation.frame.shapes[:, evaluation.kept] @ shapes[:count]
    drawn = motion @ moved
    angles = shapes[count], structure.port(evaluation.system.mirror_port) @ moved
    reaction = np.abs(evaluation.coupled.effective_modal_reaction_inertia[: drawn.shape[1]])
    chosen = np.argsort(-reaction, kind="stable")[: max(_FEWEST, _NUMBERS // drawn.shape[0])]
    size = _size(structure)
    found: dict[str, Any] = {"values": [], "mirror": [], "port": []}
    for k, column in enumerate(drawn.T):
        # Of either sign a shape is the same: what moves most moves to the positive side.
        largest = np.linalg.norm(column.reshape(-1, components), axis=1).max()
        largest = np.copysign(largest, column[np.argmax(np.abs(column))])
        known = k in chosen and abs(largest) > _STILL * size * abs(angles[0][k])
        found["values"].append(_bytes(column / largest) if known else None)
        for name, angle in zip(("mirror", "port"), angles, strict=True):
            found[name].append(_turn(angle[k] / largest, size) if known else None)
    return found


def _turn(angle: float, size: float) -> float:
    """An angle as a caption shows it; what rounding has left of none is none."""
    return float(f"{angle:.4g}") if abs(angle) * size > _STILL else 0.0


def _bytes(shape: Array) -> str:
    return b64encode(np.rint(STEPS * shape).astype(np.int8).tobytes()).decode("ascii")


def _in_modes(evaluation: Evaluation) -> Array:
    """Coupled shapes in coordinates of the structure's modes, then the mirror's angle, then other bodies."""
    loop, port = evaluation.design.loop, evaluation.system.mirror_port
    if loop.plain:
        return coupled_shapes(evaluation.modes, loop.mirror, port, evaluation.coupled)
    return shapes_of_matrices(modal_matrices(loop, evaluation.modes, port))


def _motion(structure: Structure, places: Sequence[str]) -> tuple[Any, int]:
    """What a picture shows of the motion of the degrees of freedom, one row each, and how many rows a point has."""
    kind, nodes = kind_of(structure), structure.truss.nodes
    if kind == "truss":
        return motion_at(structure, [*nodes, *places]), len(next(iter(nodes.values())))
    if kind == "beam":
        return lateral_motion(structure, np.linspace(0.0, nodes["tip"][0], _STATIONS)), 1
    if kind == "chain":
        return np.array([[float(dof == f"{name}.rz") for dof in structure.dofs] for name in nodes]), 1
    return None, 0


def kind_of(structure: Structure) -> Literal["truss", "beam", "chain"] | None:
    """What a picture of a structure is one of; None of an imported model without geometry."""
    truss = structure.truss
    if truss.bars or truss.battens:
        return "truss"
    if structure.dofs[0].startswith("lateral."):
        return "beam"
    turning = {f"{name}.rz" for name in truss.nodes}
    joined = structure.stiffness_constant.size == len(turning) - 1
    return "chain" if joined and set(structure.dofs) <= turning else None


def _size(structure: Structure) -> float:
    """Largest side of the structure [m]; one of a chain, which only turns."""
    return float(np.ptp(list(structure.truss.nodes.values()), axis=0).max()) or 1.0
