"""Stability boundaries of a sweep: one search per line of the grid along the axis that is searched."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from fosopt.control import ClosedLoopPoles, closed_loop_poles
from fosopt.metrics.boundary import Boundary, boundary_mode, branches, stability_boundaries
from fosopt.metrics.functional import LoopModel
from fosopt.study.schema import Study
from fosopt.study.schema_sweep import STRUCTURAL, Axis, Sweep
from fosopt.study.sweep_points import Bench, Points, bench, value_of
from fosopt.units import HZ


class _Line:
    """Closed loops along one axis, where the other axes have given values."""

    def __init__(self, study: Study, axis: Axis, row: Mapping[str, Any], known: Bench | None) -> None:
        self._study, self._axis, self._row = study, axis, dict(row)
        self.bench, self._ready = known, False

    def model(self, value: float) -> LoopModel:
        """The loop at a value of the axis."""
        row = {**self._row, self._axis.quantity: value}
        if not self._ready or self._axis.quantity in STRUCTURAL:
            self.bench, self._ready = bench(self._study, row, self.bench), True
        assert self.bench is not None
        design = self.bench.design(row)
        return LoopModel(design.loop, self.bench.first.modes, self.bench.system.mirror_port)

    def poles(self, value: float, near: ClosedLoopPoles | None) -> ClosedLoopPoles:
        """Closed-loop poles there."""
        model = self.model(value)
        return closed_loop_poles(model.loop, model.modes, model.mirror_port, near)


def find_boundaries(
    study: Study, sweep: Sweep, points: Points, stop: Callable[[], bool]
) -> list[dict[str, Any]]:
    """Every boundary of stability along an axis, for every combination of values of the others.

    Returns
    -------
    list
        Of each boundary: `at`, the values of all axes by name; `loses`, whether stability is lost as the axis rises;
        `frequency` [rad/s]; `structural_mode` that moves most, from one, and its `structure_frequency` [rad/s];
        `branch`, which numbers boundaries that continue each other from line to line.
    """
    assert sweep.boundary is not None
    along = next(axis for axis in points.axes if axis.name == sweep.boundary.along)
    others = [axis for axis in points.axes if axis is not along]
    grid = points.grid or ()
    values = [v.tolist() for axis, v in zip(points.axes, grid, strict=False) if axis is not along]
    log = along.log is not None
    lines: list[list[Boundary]] = []
    places: list[tuple[dict[str, Any], _Line]] = []
    known: Bench | None = None
    for numbers in product(*values):
        if stop():
            break
        row = {a.quantity: value_of(a, x) for a, x in zip(others, numbers, strict=True)}
        line = _Line(study, along, row, known)
        lines.append(stability_boundaries(line.poles, *along.ends, log=log, samples=sweep.boundary.samples))
        known = line.bench
        places.append(({a.name: row[a.quantity] for a in others}, line))
    found = []
    for (place, line), boundaries, numbers_ in zip(places, lines, branches(lines, log), strict=True):
        for each, branch in zip(boundaries, numbers_, strict=True):
            model = line.model(each.value)
            mode = boundary_mode(model, each.pole)
            found.append(
                {
                    "at": place | {along.name: each.value},
                    "loses": each.loses,
                    "frequency": each.frequency,
                    "structural_mode": mode,
                    "structure_frequency": float(model.modes.natural_frequency[mode - 1]),
                    "branch": branch,
                }
            )
    return found


def write_boundaries(
    found: Sequence[Mapping[str, Any]],
    quantities: Mapping[str, Mapping[str, Any]],
    axes: Sequence[Axis],
    path: Path,
) -> None:
    """Write the boundaries as a table; units stand in the names of its columns."""
    names = [axis.name for axis in axes]
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        head = [quantities[name]["column"] for name in names]
        writer.writerow(
            [*head, "rising", "frequency_hz", "structural_mode", "structure_frequency_hz", "branch"]
        )
        for each in found:
            cells = [_cell(each["at"][name], quantities[name]["column_factor"]) for name in names]
            writer.writerow(
                [
                    *cells,
                    "loses stability" if each["loses"] else "regains stability",
                    each["frequency"] / HZ,
                    each["structural_mode"],
                    each["structure_frequency"] / HZ,
                    each["branch"],
                ]
            )


def _cell(value: Any, factor: float) -> Any:
    return value * factor if isinstance(value, float) else value
