"""The least a structure can weigh for what it must do, and the highest first frequency for what it may weigh."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isinf, nan

import numpy as np

from fosopt.ops import Array
from fosopt.problem import Constraint, Evaluation, Problem
from fosopt.relax.bound import Bound
from fosopt.relax.free_hub import free_hub_floor
from fosopt.relax.least_sizing import Least, least_sizing, modal_vectors, prove
from fosopt.relax.proof import Proof
from fosopt.relax.sizing import Sizing
from fosopt.relax.structural import Compliance, Receptance, StructuralPart, structural_part

# Gaps (relative) at which the search stops: where the sizing is convex, and where the structure may turn.
TOLERANCE, FREE_HUB_TOLERANCE = 1e-6, 1e-3
# A proof and a design that meet closer than this (relative) are the same number: that design's own frequencies are
# good to about 1e-7 on a truss of 200 bays.
_SAME = 1e-6


@dataclass(frozen=True)
class StructureFloor:
    """A proven lower bound on a linear cost of a structure.

    Attributes
    ----------
    bound
        The bound in words and numbers; infinite where no structure in the box meets the requirements.
    sizing, proof
        What it was proven for, and how: enough to compute it again.
    kept, left_out
        Constraints that entered, and those that did not.
    design
        (n,) values of all variables of the least structure known to meet what entered; None if none is.
    upper
        What that structure costs; infinite if none is known.
    seconds
        What it took.
    """

    bound: Bound
    sizing: Sizing
    proof: Proof
    kept: tuple[str, ...]
    left_out: tuple[str, ...]
    design: Array | None
    upper: float
    seconds: float

    @property
    def gap(self) -> float:
        """How far the bound is from the least structure known, relative to that; NaN without one."""
        return (self.upper - self.bound.value) / abs(self.upper) if np.isfinite(self.upper) else nan

    def recomputed(self, exact: bool = False) -> float:
        """The bound once more from sizing and proof alone, with its rounding allowance or in rational arithmetic.

        Raises
        ------
        SolverError
            If the proof is none: a negative multiplier, or one that does not fit.
        """
        return self.proof.exact_value(self.sizing) if exact else self.proof.value(self.sizing)[0]


def structure_floor(
    problem: Problem,
    constraints: Sequence[Constraint],
    x: Array,
    objective: str = "structural_mass",
    *,
    also: Sequence[Compliance | Receptance] = (),
    tolerance: float | None = None,
    pieces: int = 8,
    exact: bool = False,
    evaluation: Evaluation | None = None,
) -> StructureFloor:
    """Prove how much every structure in the box costs that meets what the constraints ask of it.

    The modes of the design at `x` are tried first, which takes no solver; where they leave a gap, second-order cones
    find better displacements. The bound is computed from these in NumPy, whatever a solver said.

    Parameters
    ----------
    constraints, objective, also, evaluation
        See `structural.structural_part`.
    x
        (n,) values of all variables: the design the bound is compared with, or any start.
    tolerance
        Relative gap to stop at, by default 1e-6, and 1e-3 for a structure that may turn.
    pieces
        How many pieces with two ends a structure that may turn is split into, at most; see `free_hub`.
    exact
        Whether the bound is that of rational arithmetic instead of double precision with an allowance.

    Raises
    ------
    ModelError
        See `structural.structural_part`.
    SolverError
        For a structure that may turn and a parameter without upper bound, see `free_hub`.
    """
    began = time.perf_counter()
    part = structural_part(problem, constraints, x, objective, also, evaluation)
    found, proof = search(part, tolerance, pieces)
    value, allowance = (proof.exact_value(part.sizing), 0.0) if exact else proof.value(part.sizing)
    design = None
    if found is not None:
        design = x.copy()
        design[part.positions] = found
    upper = inf if found is None else part.value if found is part.x else part.sizing.value(found)
    # A lower number is a bound too: what is taken off is the rounding of the design's own frequency and mass.
    excess = value - upper
    if 0 < excess <= _SAME * abs(upper):
        value = upper
    asked = ", ".join(part.kept) or "nothing"
    of = f"{objective} of every structure in the box that meets: {asked}"
    if isinf(value):
        of = f"{of}; no structure in the box does"
    bound = Bound(value, of, assumptions(part, proof), allowance)
    if np.isfinite(upper):
        bound.hold(upper, "a structure that meets the requirements")
    return StructureFloor(
        bound,
        part.sizing,
        proof,
        part.kept,
        part.left_out,
        design,
        upper,
        time.perf_counter() - began,
    )


def search(part: StructuralPart, tolerance: float | None, pieces: int) -> tuple[Array | None, Proof]:
    """The least structure found (the design itself if that is it) and the best proof."""
    sizing = part.sizing
    known: Array | None = None if part.misses else part.x
    if tolerance is None:
        tolerance = TOLERANCE if sizing.turning is None else FREE_HUB_TOLERANCE
    if known is not None:
        modes = Least(known, known, None, modal_vectors(sizing, known), 0)
        better, proof = _proven(sizing, modes, known, tolerance, 1)
        if sizing.value(known) - proof.value(sizing)[0] <= tolerance * abs(sizing.value(known)):
            return better, proof
    least = least_sizing(sizing, part.x, tolerance / 100)
    if least.x is not None and (known is None or sizing.value(least.x) < sizing.value(known)):
        known = least.x
    if least.proof is not None:
        return known, least.proof
    return _proven(sizing, least, known, tolerance, pieces)


def _proven(
    sizing: Sizing, found: Least, known: Array | None, tolerance: float, pieces: int
) -> tuple[Array | None, Proof]:
    if sizing.turning is None:
        return known, prove(sizing, found.vectors)
    floor = free_hub_floor(sizing, found, known, tolerance, pieces)
    return floor.x, floor.proof


def assumptions(part: StructuralPart, proof: Proof) -> tuple[str, ...]:
    """What a bound from a structural part rests on, one sentence each."""
    count = part.positions.size
    said = [
        f"{count} structural variable{'s lie within their' if count != 1 else ' lies within its'} bounds",
        "all else of the structure is as given, undamped, with all its modes",
    ]
    if part.left_out:
        said.append(f"left out, which can only lower the bound: {', '.join(part.left_out)}")
    if part.sizing.turning is not None:
        pieces = sum(1 for _ in proof.leaves())
        said.append(
            f"the structure may turn about its hub: the least of {pieces} pieces, of all hyperplanes together"
        )
    return tuple(said)
