"""Stability boundaries of a sweep: one search per line of the grid along the axis that is searched."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

from fosopt.control import Loop, closed_loop_poles
from fosopt.control.sampled_poles import sampled_poles
from fosopt.export.text import inert
from fosopt.metrics.boundary import Boundary, Poles, boundary_mode, branches, stability_boundaries
from fosopt.metrics.functional import LoopModel
from fosopt.modes import ModalSet
from fosopt.study.schema import Study
from fosopt.study.schema_sweep import STRUCTURAL, Axis, Sweep
from fosopt.study.sweep_points import Bench, Points, bench, value_of
from fosopt.units import HZ

P = TypeVar("P", bound=Poles)


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

    def boundaries(self, samples: int) -> list[Boundary]:
        """Those of stability along it, of a loop that samples as built."""
        log = self._axis.log is not None
        if self.period is None:
            path = _path(self.model, closed_loop_poles)
            return stability_boundaries(path, *self._axis.ends, log=log, samples=samples)
        as_built = _path(self.model, sampled_poles)
        return stability_boundaries(as_built, *self._axis.ends, log=log, samples=samples)

    @property
    def period(self) -> float | None:
        """Of a loop that samples [s]."""
        sampling = self._study.controller.sampling
        return None if sampling is None else sampling.seconds


def _path(
    model: Callable[[float], LoopModel], of: Callable[[Loop, ModalSet, str, P | None], P]
) -> Callable[[float, P | None], P]:
    """Closed-loop poles over the value of an axis."""

    def found(value: float, near: P | None) -> P:
        here = model(value)
        return of(here.loop, here.modes, here.mirror_port, near)

    return found


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
        lines.append(line.boundaries(sweep.boundary.samples))
        known = line.bench
        places.append(({a.name: row[a.quantity] for a in others}, line))
    found = []
    for (place, line), boundaries, numbers_ in zip(places, lines, branches(lines, log), strict=True):
        for each, branch in zip(boundaries, numbers_, strict=True):
            model = line.model(each.value)
            mode = boundary_mode(model, each.pole, line.period)
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
    origin: str,
    path: Path,
) -> None:
    """Write the boundaries as a table; units stand in the names of its columns, where it came from in the first row."""
    names, origin = [axis.name for axis in axes], inert(origin)
    with path.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        head = [quantities[name]["column"] for name in names]
        writer.writerow(
            [
                *head,
                "rising",
                "frequency_hz",
                "structural_mode",
                "structure_frequency_hz",
                "branch",
                "provenance",
            ]
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
                    origin,
                ]
            )
            origin = ""


def _cell(value: Any, factor: float) -> Any:
    return value * factor if isinstance(value, float) else value
