"""Run a sweep: from its axes to a directory of arrays that fills up while it runs."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.errors import StoppedError
from fosopt.export.columns import provenance_of
from fosopt.export.sweep_matlab import write_sweep_arrays
from fosopt.expressions import Expression
from fosopt.files import replacing
from fosopt.study.build import build_problem
from fosopt.study.directory import make_directory, quantity_entry, run_header
from fosopt.study.engine import Pool
from fosopt.study.lock import only_writer
from fosopt.study.plan import identity
from fosopt.study.provenance import environment
from fosopt.study.resume import Origin, inputs_of
from fosopt.study.runner import Progress, Tell, Workers, going_on, options, pool_of, settle, told
from fosopt.study.schema import Study
from fosopt.study.schema_names import METRICS
from fosopt.study.schema_rules import expression_dimension
from fosopt.study.schema_sweep import AXES, STABLE, Axis
from fosopt.study.session import Session
from fosopt.study.store import RECORD, Store, StoreError
from fosopt.study.sweep_boundary import find_boundaries, write_boundaries
from fosopt.study.sweep_export import stored_pieces
from fosopt.study.sweep_job import Finding, Span, SweepJob, SweepPlan
from fosopt.study.sweep_outputs import OF_STRUCTURE
from fosopt.study.sweep_store import SweepFiles, array_files, refuse_too_large
from fosopt.units import DIMENSIONLESS, DIMENSIONS, Vector, dimension_name

SUMMARY = "sweep.json"
"""What a sweep was, with the names, units and files of all its axes and outputs."""
_HERE, _THERE = (
    4,
    16,
)  # blocks that are stored together, and blocks that make a task worth sending to a worker
_AHEAD = 8  # tasks per worker that are sent before the first is answered
_MATLAB = 64 * 2**20  # bytes up to which all arrays are also written as one MATLAB file


def run_sweep(
    study: Study,
    out: Path,
    progress: Tell,
    stop: Callable[[], bool],
    workers: Workers,
    origin: Origin | None,
) -> dict[str, Any]:
    """Run a sweep into a new directory and return what it was and what became of it.

    Results are in the record as soon as some points are finished; the other files are written from it at the end.

    Raises
    ------
    StudyError
        If the sweep cannot be run, its results would not fit on the disk, or `out` is not empty.
    StoppedError
        If the machine stops the run.
    """
    plan = SweepPlan.of(study)
    refuse_too_large(out, plan.points.count, len(plan.scalars), plan.widths)
    run = _header(study, plan)
    run["provenance"] |= {"options": options(workers, origin)}
    make_directory(out)
    with only_writer(out):
        resolved, files = settle(study, out)
        with Store.create(out / RECORD, run, inputs_of(study, files, origin)) as store:
            return _go_on(store, resolved, plan, progress, stop, workers)


def resume_sweep(
    store: Store, study: Study, progress: Tell, stop: Callable[[], bool], workers: Workers
) -> dict[str, Any]:
    """Do what the record of a sweep does not have yet, and write its files.

    Raises
    ------
    StoppedError
        If the machine stops the run.
    """
    return _go_on(store, study, SweepPlan.of(study), progress, stop, workers)


def _go_on(
    store: Store, study: Study, plan: SweepPlan, progress: Tell, stop: Callable[[], bool], workers: Workers
) -> dict[str, Any]:
    out, run, points = store.path.parent, store.header(), plan.points
    study_id, sessions = run["provenance"]["study"], store.sessions()
    finished = known = sum(block.last - block.first for block in store.blocks())
    session = Session.after(sessions, known, str(workers), environment())
    stopped: StoppedError | None = None

    def tell(stage: str) -> None:
        progress(Progress(stage, finished, points.count, None, session.seconds, known))

    def complete() -> None:
        """What can only be said of all points together, and the files."""
        cut, blocks = stop() or stopped is not None, store.blocks()
        run.update(
            finished=finished,
            interrupted=cut,
            unstable=sum(block.unstable for block in blocks) if plan.outputs.needs_loop else None,
            failed=sum(block.failed for block in blocks),
            reason=next((block.reason for block in blocks if block.reason), None),
            seconds=session.seconds + sum(each["seconds"] for each in sessions),
        )
        if run["boundary_along"] is not None and not cut and run["boundaries"] is None:
            tell("stability boundaries")
            assert study.sweep is not None
            boundaries = find_boundaries(study, study.sweep, points, stop)
            run.update(boundaries=boundaries, interrupted=stop())
        tell("writing files")
        _write(store, run, plan)
        # Boundaries that were cut short are searched for again.
        store.finish(run | ({"boundaries": None} if run["interrupted"] else {}))
        end = "interrupted" if run["interrupted"] else "finished"
        store.write_session(session.record(finished, points.count, end))

    tell("points")
    try:
        try:
            with pool_of(SweepJob(study, plan), study, workers, out) as pool:
                spans = plan.missing(store.blocks(), _HERE if workers.alone else _THERE)
                for found in _found(pool, spans, stop, _AHEAD * max(workers.count, 1)):
                    block = found.block
                    finished += block.last - block.first
                    name = identity(study_id, {"first": block.first, "last": block.last})
                    store.write_block(block, name, found.arrays, session.record(finished, points.count))
                    tell("points")
        except StoppedError as error:
            stopped = error
        complete()
    except (StoreError, OSError) as error:
        stopped = StoppedError(told(error))
    if stopped is not None:
        raise StoppedError(f"{stopped}; {going_on(finished, points.count, out)}")
    return run


def _found(pool: Pool, spans: Iterator[Span], stop: Callable[[], bool], ahead: int) -> Iterator[Finding]:
    """What becomes of spans, of which not all are made before the first is answered."""
    for span in islice(spans, ahead):
        pool.submit(span)
    while pool.busy and not stop():
        answer = pool.next(stop)
        if answer is None:
            continue
        for span in islice(spans, 1):
            pool.submit(span)
        if answer[1] is not None:
            yield answer[1]


def _write(store: Store, run: dict[str, Any], plan: SweepPlan) -> None:
    """All files but the record, from the record."""
    out, points, quantities = store.path.parent, plan.points, run["quantities"]
    names = plan.scalars
    head = [quantities[name]["column"] for name in names]
    factors = [quantities[name]["column_factor"] for name in names]
    labels = {a.name: a.list for a in points.axes if a.quantity == "mirror_port" and a.list is not None}
    origin = provenance_of(run)
    with SweepFiles(out, names, head, factors, plan.widths, labels, origin) as files:
        for scalars, arrays in stored_pieces(store, plan):
            files.append(scalars, arrays)
    if run["boundaries"] is not None:
        write_boundaries(run["boundaries"], quantities, points.axes, origin, out / "boundary.csv")
    with replacing(out / SUMMARY) as temporary:
        temporary.write_text(json.dumps(run, allow_nan=False, indent=1) + "\n", encoding="utf-8")
    _write_mat(run, out)
    from fosopt.report import write_sweep_report

    write_sweep_report(run, out)


def _header(study: Study, plan: SweepPlan) -> dict[str, Any]:
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
            "dimensions": ["point", "structure_mode" if name in OF_STRUCTURE else "mode"],
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
    with replacing(out / "sweep.mat") as temporary:
        arrays = {name: np.load(out / file) for name, file in entries.items()}
        write_sweep_arrays(run, arrays, temporary)
