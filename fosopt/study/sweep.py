"""Run a sweep: from its axes to a directory of arrays that fills up while it runs."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.errors import FosoptError
from fosopt.expressions import Expression
from fosopt.files import replacing
from fosopt.ops import Array
from fosopt.study.build import build_problem
from fosopt.study.directory import make_directory, quantity_entry, run_header, with_inputs
from fosopt.study.load import dump_study
from fosopt.study.runner import Progress
from fosopt.study.schema import Study
from fosopt.study.schema_names import METRICS
from fosopt.study.schema_rules import expression_dimension
from fosopt.study.schema_sweep import AXES, STABLE, STRUCTURAL, Axis, Sweep
from fosopt.study.sweep_boundary import find_boundaries, write_boundaries
from fosopt.study.sweep_outputs import Chunk, Outputs
from fosopt.study.sweep_points import Bench, Points, Row, bench
from fosopt.study.sweep_store import SweepStore, array_files, refuse_too_large
from fosopt.units import DIMENSIONLESS, DIMENSIONS, Vector, dimension_name

SUMMARY = "sweep.json"
"""What a sweep was, with the names, units and files of all its axes and outputs."""
_LOOPS, _MODES = 64, 1024  # points at hand: of closed loops, and of coupled modes alone
_MATLAB = 64 * 2**20  # bytes up to which all arrays are also written as one MATLAB file
_INDEXED = ("structure_frequency", "modal_inertia")


@dataclass(frozen=True)
class _Plan:
    """A sweep that can be run: points, outputs, and the first of its systems."""

    points: Points
    outputs: Outputs
    start: Bench
    widths: dict[str, int]

    @classmethod
    def of(cls, study: Study, sweep: Sweep) -> _Plan:
        points, outputs = Points(sweep), Outputs.of(sweep)
        first = bench(study, points.row(points.rows(0, 1)[0]))
        modes = first.first.modes.natural_frequency.size
        bays = next((axis.list for axis in sweep.axes if axis.quantity == "bays"), None)
        if bays is not None:
            row = {**points.row(points.rows(0, 1)[0]), "bays": max(bays)}
            modes = bench(study, row).first.modes.natural_frequency.size
        _check_modes(study, sweep, first, modes)
        bodies = 1 + sum(1 for _ in first.base.loop.attachments)
        return cls(points, outputs, first, outputs.widths(modes, modes + bodies))


def _check_modes(study: Study, sweep: Sweep, first: Bench, modes: int) -> None:
    """Refuse outputs of modes that no point has."""
    for k, output in enumerate(sweep.outputs):
        for name, index in output.references:
            if index is None:
                continue
            if name not in _INDEXED and not first.base.loop.plain:
                raise study.error(
                    f"{name}[{index}] is a metric of a bicollocated mirror without reaction masses only; write "
                    f"'{name}', which gives it for every mode",
                    *("sweep", "outputs", k),
                )
            most = modes + (name not in _INDEXED)
            if index > most:
                raise study.error(f"{name}[{index}]: the model has modes 1 to {most}", "sweep", "outputs", k)


def run_sweep(
    study: Study, out: Path, progress: Callable[[Progress], None], stop: Callable[[], bool]
) -> dict[str, Any]:
    """Run a sweep into a new directory and return what it was and what became of it.

    Results are on disk as soon as a chunk of points is finished; an interrupted sweep keeps what it has.

    Raises
    ------
    StudyError
        If the sweep cannot be run, its results would not fit on the disk, or `out` is not empty.
    """
    begin, sweep = time.perf_counter(), study.sweep
    assert sweep is not None
    plan = _Plan.of(study, sweep)
    points, outputs = plan.points, plan.outputs
    names = [a.name for a in points.axes] + [e.text for e in outputs.scalars]
    refuse_too_large(out, points.count, len(names), plan.widths)
    run = _header(study, plan)
    make_directory(out)
    (out / "study.yaml").write_text(dump_study(with_inputs(study, out)), encoding="utf-8")
    finished = 0

    def tell(stage: str) -> None:
        progress(Progress(stage, finished, points.count, None, time.perf_counter() - begin))

    def save() -> None:
        tally = outputs.tally
        run.update(
            finished=finished,
            interrupted=stop(),
            unstable=tally.unstable if outputs.needs_loop else None,
            failed=tally.failed,
            reason=tally.reason,
            seconds=time.perf_counter() - begin,
        )
        with replacing(out / SUMMARY) as temporary:
            temporary.write_text(json.dumps(run, allow_nan=False, indent=1) + "\n", encoding="utf-8")

    quantities = run["quantities"]
    head = [quantities[name]["column"] for name in names]
    factors = [quantities[name]["column_factor"] for name in names]
    labels = {a.name: a.list for a in points.axes if a.quantity == "mirror_port" and a.list is not None}
    save()
    tell("points")
    with SweepStore(out, names, head, factors, plan.widths, labels) as store:
        for rows, chunk in _chunks(study, plan, stop):
            store.append(np.hstack([rows, chunk.scalars]), chunk.arrays)
            finished += rows.shape[0]
            tell("points")
    save()
    if sweep.boundary is not None and not stop():
        tell("stability boundaries")
        run["boundaries"] = find_boundaries(study, sweep, points, stop)
        write_boundaries(run["boundaries"], quantities, points.axes, out / "boundary.csv")
    tell("writing files")
    save()
    _write_mat(run, out)
    from fosopt.report import write_sweep_report

    write_sweep_report(run, out)
    return run


def _chunks(study: Study, plan: _Plan, stop: Callable[[], bool]) -> Iterator[tuple[Array, Chunk]]:
    """Results in the order of the points, until asked to stop."""
    points, outputs = plan.points, plan.outputs
    at: Bench | None = plan.start
    structure = _structural(points, points.row(points.rows(0, 1)[0]))
    for first, last in points.blocks(_LOOPS if outputs.needs_loop else _MODES):
        if stop():
            return
        numbers = points.rows(first, last)
        rows = [points.row(each) for each in numbers]
        if _structural(points, rows[0]) != structure:
            structure, at = _structural(points, rows[0]), _bench(study, rows[0], outputs)
        if at is None:
            outputs.tally.failed += len(rows) - 1
            yield numbers, _nothing(len(rows), outputs, plan.widths)
        else:
            yield numbers, outputs.chunk(at, rows, plan.widths)


def _bench(study: Study, row: Row, outputs: Outputs) -> Bench | None:
    """The system at a point; None, and counted, where physics does not allow it."""
    try:
        return bench(study, row)
    except FosoptError as error:
        outputs.tally.fail(error)
        return None


def _structural(points: Points, row: Row) -> tuple[Any, ...]:
    return tuple(row[a.quantity] for a in points.axes if a.quantity in STRUCTURAL)


def _nothing(count: int, outputs: Outputs, widths: dict[str, int]) -> Chunk:
    return Chunk(
        np.full((count, len(outputs.scalars)), nan),
        {name: np.full((count, n), nan) for name, n in widths.items()},
    )


def _header(study: Study, plan: _Plan) -> dict[str, Any]:
    """What the sweep is; all numbers in files but tables are SI."""
    points, outputs = plan.points, plan.outputs
    header = run_header(study, build_problem(study))
    quantities = {
        axis.name: quantity_entry(_dimension(axis), axis.name.replace("_", " "), axis.name)
        for axis in points.axes
    }
    for expression in outputs.scalars:
        quantities[expression.text] = header["quantities"].get(expression.text) or _entry(study, expression)
    for name in outputs.arrays:
        metric = METRICS.get(name)
        label = metric.label if metric else "1 − pole-zero separation"
        quantities[name] = quantity_entry(metric.dimension if metric else "ratio", label, name)
    scalars, grid = [e.text for e in outputs.scalars], points.grid
    files = array_files([*(a.name for a in points.axes), *scalars, *outputs.arrays])
    axes = [
        {
            "name": axis.name,
            "quantity": axis.quantity,
            "unit": _unit(_dimension(axis)),
            "file": files[axis.name],
            "scale": "log" if axis.log else "linear",
            "labels": list(axis.list) if axis.quantity == "mirror_port" and axis.list is not None else None,
            "values": None if grid is None else grid[k].tolist(),
        }
        for k, axis in enumerate(points.axes)
    ]
    arrays: list[dict[str, Any]] = [
        {
            "name": e.text,
            "unit": _unit(None if e.text == STABLE else expression_dimension(study, e)),
            "file": files[e.text],
            "dimensions": ["point"],
            "shape": [points.count],
        }
        for e in outputs.scalars
    ]
    arrays += [
        {
            "name": name,
            "unit": _unit(METRICS[name].dimension if name in METRICS else None),
            "file": files[name],
            "dimensions": ["point", "mode"],
            "shape": [points.count, width],
        }
        for name, width in plan.widths.items()
    ]
    return {
        "name": study.name,
        "description": study.description,
        "kind": study.kind,
        "sampling": study.sweep.sampling if study.sweep else "",
        "shape": list(points.shape),
        "count": points.count,
        "axes": axes,
        "outputs": arrays,
        "quantities": quantities,
        "boundary_along": study.sweep.boundary.along if study.sweep and study.sweep.boundary else None,
        "boundaries": None,
        "provenance": header["provenance"],
    }


def _dimension(axis: Axis) -> str:
    return (AXES[axis.quantity].dimension or "ratio") if axis.quantity in AXES else "ratio"


def _unit(dimension: str | Vector | None) -> str:
    """Unit of the numbers in the arrays."""
    kind = dimension_name(dimension or DIMENSIONLESS) if not isinstance(dimension, str) else dimension
    return "SI" if kind is None else DIMENSIONS[kind].unit


def _entry(study: Study, expression: Expression) -> dict[str, Any]:
    """How an expression that is no plain metric is shown."""
    if expression.text == STABLE:
        return quantity_entry("ratio", "stable", STABLE)
    vector = expression_dimension(study, expression) or DIMENSIONLESS
    return quantity_entry(vector, expression.text, re.sub(r"[^A-Za-z0-9]+", "_", expression.text).strip("_"))


def _write_mat(run: dict[str, Any], out: Path) -> None:
    """All arrays as one MATLAB file, unless they are large."""
    entries = {each["name"]: each["file"] for each in (*run["axes"], *run["outputs"])}
    if sum((out / file).stat().st_size for file in entries.values()) > _MATLAB:
        return
    from scipy.io import savemat

    content = {Path(file).stem[:63].lstrip("_0123456789"): np.load(out / file) for file in entries.values()}
    savemat(out / "sweep.mat", content, long_field_names=True, do_compression=True, oned_as="column")
