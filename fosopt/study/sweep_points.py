"""Points of a sweep: from axes to rows of values, and from rows to designs of a system that is built once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import qmc

from fosopt.actuators import Mirror
from fosopt.modes import Damping
from fosopt.ops import Array
from fosopt.problem import Design, Evaluation, Problem, System, Variable, design_parameters, evaluation_of
from fosopt.study.build import build_problem
from fosopt.study.imports import imported_damping, read_imported, refuse_riding
from fosopt.study.schema import Study
from fosopt.study.schema_sweep import STRUCTURAL, Axis, Sweep

Row = Mapping[str, Any]
"""Values of all axes at a point, by quantity."""


class Points:
    """All points of a sweep, made as they are needed.

    Attributes
    ----------
    axes
        In the order of the results.
    shape
        Of the grid, or (count,).
    """

    def __init__(self, sweep: Sweep) -> None:
        self.axes, self.count = sweep.ordered, sweep.count
        self._drawn = None if sweep.sampling == "grid" else _drawn(sweep)
        self._values = [_grid_values(axis) if self._drawn is None else np.zeros(0) for axis in self.axes]
        self.shape = (self.count,) if self._drawn is not None else tuple(v.size for v in self._values)

    @property
    def grid(self) -> tuple[Array, ...] | None:
        """Values along each axis of a grid, as `rows` gives them; None where points were drawn."""
        return None if self._drawn is not None else tuple(self._values)

    def rows(self, first: int, last: int) -> Array:
        """(m, a) Numbers along each axis at points `first` to before `last`; a port by its place in the list."""
        if self._drawn is not None:
            return self._drawn[first:last]
        places = np.unravel_index(np.arange(first, last), self.shape)
        return np.column_stack([v[k] for v, k in zip(self._values, places, strict=True)])

    def row(self, numbers: Array) -> Row:
        """Values by quantity from the numbers of a point."""
        return {axis.quantity: value_of(axis, x) for axis, x in zip(self.axes, numbers, strict=True)}

    def blocks(self, longest: int) -> Iterator[tuple[int, int]]:
        """Consecutive points on one structure, at most `longest`, as first and one past the last."""
        structural = sum(axis.quantity in STRUCTURAL for axis in self.axes)
        for begin in range(0, self.count, longest):
            rows = self.rows(begin, min(begin + longest, self.count))[:, :structural]
            cuts = 1 + np.flatnonzero(np.any(rows[1:] != rows[:-1], axis=1))
            ends = [0, *cuts.tolist(), rows.shape[0]]
            yield from ((begin + a, begin + b) for a, b in pairwise(ends))


def _grid_values(axis: Axis) -> Array:
    if axis.list is not None:
        return (
            np.arange(len(axis.list), dtype=float)
            if axis.quantity == "mirror_port"
            else np.array(axis.list, float)
        )
    low, high = axis.ends
    values = (np.linspace if axis.linear else np.geomspace)(low, high, axis.span.points)
    values[[0, -1]] = low, high
    return values


def value_of(axis: Axis, number: float) -> Any:
    """What a number of `Points.rows` stands for: a whole number of bays, the name of a port."""
    if axis.quantity == "mirror_port":
        assert axis.list is not None
        return axis.list[int(number)]
    return int(number) if axis.quantity == "bays" else float(number)


def _drawn(sweep: Sweep) -> Array:
    """(m, a) Points drawn from the whole box, sorted so that those of one structure stand together."""
    kind = qmc.LatinHypercube if sweep.sampling == "latin_hypercube" else qmc.Sobol
    engine = kind(len(sweep.axes), seed=sweep.seed)
    if sweep.sampling == "sobol":
        # SciPy warns of a count that is no power of two; taking the first points of one is the usual practice.
        unit = engine.random(1 << (sweep.count - 1).bit_length())[: sweep.count]
    else:
        unit = engine.random(sweep.count)
    columns = [_placed(axis, u) for axis, u in zip(sweep.ordered, unit.T, strict=True)]
    rows = np.column_stack(columns)
    return rows[np.lexsort(rows.T[::-1])]


def _placed(axis: Axis, unit: Array) -> Array:
    if axis.list is not None:
        values = _grid_values(axis)
        return values[np.minimum((unit * values.size).astype(int), values.size - 1)]
    low, high = axis.ends
    return low * (high / low) ** unit if axis.log else low + (high - low) * unit


@dataclass(frozen=True)
class Bench:
    """A system with its modes, on which mirror and loop change from point to point.

    Attributes
    ----------
    problem, form
        Of the study, before its areas are scaled, and the number of bays and the mirror's port it is of.
    first
        Evaluation of the base design, whose modes all points share.
    """

    system: System
    base: Design
    problem: Problem
    form: tuple[Any, ...]
    first: Evaluation

    def design(self, row: Row) -> Design:
        """The design at a point."""
        base = self.base
        if "mirror_damping_ratio" in row:
            old = base.loop.mirror
            mirror = Mirror(
                old.inertia, old.natural_frequency, row["mirror_damping_ratio"], old.reaction_mass
            )
            base = replace(base, loop=replace(base.loop, mirror=mirror))
        variables = [_variable(q, x) for q, x in row.items() if q in _VARIABLES]
        x = np.array([float(v.start[0]) for v in variables])
        return base.with_parameters(
            design_parameters(self.system, base, self.problem.definitions, variables, x)
        )


_VARIABLES = (
    "mirror_inertia",
    "mirror_inertia_ratio",
    "mirror_frequency",
    "gain",
    "crossover",
    "kp",
    "ki",
    "kd",
)


def _variable(quantity: Any, value: float) -> Variable:
    start = np.array([value])
    return Variable(quantity, quantity, start - 1, start + 1 + value, start, log=False)


def bench(study: Study, row: Row, known: Bench | None = None) -> Bench:
    """The system of a study where the structural axes have the values of a point.

    Parameters
    ----------
    known
        Of another point of the same study: what does not differ is not built again.

    Raises
    ------
    StudyError
        For what physics does not allow.
    """
    form = row.get("bays"), row.get("mirror_port")
    problem = known.problem if known is not None and known.form == form else build_problem(_with(study, row))
    system, base = replace(problem.system, as_built=True), problem.base
    if "mirror_mass" in row:
        refuse_riding(study, system.structure, row["mirror_mass"])
        base = replace(base, mirror_mass=row["mirror_mass"])
    if "area_scale" in row:
        # Inertia and gain follow the areas where they are given by ratios: `Bench.design` sees to it.
        base = replace(base, area=base.area * row["area_scale"])
    if "damping_ratio" in row:
        damping, imported = Damping((row["damping_ratio"],)), read_imported(study)
        system = replace(system, damping=damping if imported is None else imported_damping(imported, damping))
    first = evaluation_of(system, base)
    if known is not None and known.problem is problem and _same_structure(known.base, base):
        first.frame = known.first.frame
    return Bench(system, base, problem, form, first)


def _same_structure(one: Design, other: Design) -> bool:
    return np.array_equal(one.area, other.area) and one.mirror_mass == other.mirror_mass


def _with(study: Study, row: Row) -> Study:
    """The study as an analysis of one design, with the values of structural axes in its sections."""
    structure, mirror, damping = study.structure, study.mirror, study.damping
    if "bays" in row:
        structure = structure.model_copy(update={"bays": row["bays"]})
    if "mirror_port" in row:
        mirror = mirror.model_copy(update={"port": row["mirror_port"]})
    if "mirror_mass" in row:
        mirror = mirror.model_copy(update={"mass": row["mirror_mass"], "mass_fraction": None})
    if "damping_ratio" in row:
        damping = damping.model_copy(
            update={"uniform": row["damping_ratio"], "per_mode": None, "table": None, "imported": None}
        )
    changes = {
        "structure": structure,
        "mirror": mirror,
        "damping": damping,
        "kind": "analysis",
        "sweep": None,
    }
    return study.model_copy(update=changes)
