"""Run a study: from the understood file to a directory of verified results."""

from __future__ import annotations

import hashlib
import platform
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.certify import Certificate, certify
from fosopt.errors import StudyError
from fosopt.export import write_csv, write_json
from fosopt.ops import Array
from fosopt.problem import Problem
from fosopt.report import write_report
from fosopt.solve import Options, Outcome, Search, everything_free, solve_cases, trace_front
from fosopt.solve.ipopt import never
from fosopt.solve.strategies import Goal
from fosopt.study.build import build_problem, start_vector
from fosopt.study.detail import detail_of
from fosopt.study.files import side_files
from fosopt.study.load import dump_study
from fosopt.study.schema import Study
from fosopt.study.schema_names import QUANTITIES
from fosopt.study.schema_rules import known_metrics
from fosopt.study.store import Store
from fosopt.units import column, display

_INPUTS = "inputs"
_LIBRARIES = ("fosopt", "casadi", "numpy", "scipy")


@dataclass(frozen=True)
class Progress:
    """How far a run has come.

    Attributes
    ----------
    stage
        What is being done.
    done, total
        Points.
    point
        The point of the run data that was just finished, if one was.
    seconds
        Since the start.
    """

    stage: str
    done: int
    total: int
    point: Mapping[str, Any] | None
    seconds: float


def _quiet(progress: Progress) -> None:
    """Tell nobody."""


def run_study(
    study: Study,
    out: Path,
    *,
    progress: Callable[[Progress], None] = _quiet,
    stop: Callable[[], bool] = never,
) -> dict[str, Any]:
    """Run a study into a new directory and return its run data.

    Every point is written to ``run.sqlite`` as soon as it is finished; the other files are written at the end,
    also when the run is stopped.

    Parameters
    ----------
    out
        Directory to make; an existing one must be empty.
    progress
        Called when a stage starts and when a point is finished.
    stop
        Asked often; true ends the run with what it has.

    Raises
    ------
    StudyError
        If the study poses no problem, or `out` is not empty.
    """
    begin = time.perf_counter()
    problem = build_problem(study)
    start = start_vector(study, problem)
    header = _header(study, problem)
    _make_directory(out)
    resolved = _with_inputs(study, out)
    (out / "study.yaml").write_text(dump_study(resolved), encoding="utf-8")
    total = _count(study)
    points: list[dict[str, Any]] = []

    def tell(stage: str, point: Mapping[str, Any] | None = None) -> None:
        progress(Progress(stage, len(points), total, point, time.perf_counter() - begin))

    with Store.create(out / "run.sqlite", header) as store:
        tell("start design")
        for point in _points(study, problem, start, stop):
            _state_prices(point, header["quantities"])
            points.append(point)
            store.write_point(len(points) - 1, point)
            tell(str(point["label"]), point)
        if _mark_dominated(points, header["objectives"]):
            for position, point in enumerate(points):
                store.write_point(position, point)
        store.finish({"interrupted": stop(), "comparison": _comparison(study, points)})
        run = store.run()
    tell("writing files")
    _write_files(resolved, run, out)
    return run


def _make_directory(out: Path) -> None:
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise StudyError(f"output '{out}' exists and is not an empty directory; choose another with --out")
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise StudyError(
            f"output '{out}' cannot be written: {error.strerror}; choose another with --out"
        ) from error


def _with_inputs(study: Study, out: Path) -> Study:
    """The study with its side files copied into the run directory, so that the directory stands alone."""
    copies: dict[str, str] = {}

    def copied(name: str) -> str:
        if name not in copies:
            source = study.base / name
            (out / _INPUTS).mkdir(exist_ok=True)
            target = f"{_INPUTS}/{len(copies)}-{source.name}"
            shutil.copyfile(source, out / target)
            copies[name] = target
        return copies[name]

    return _renamed(study, copied)


def _renamed(study: Study, rename: Callable[[str], str]) -> Study:
    """The study with other names for its side files."""
    disturbances = tuple(
        d if d.psd is None else d.model_copy(update={"psd": rename(d.psd)}) for d in study.disturbances
    )
    damping = study.damping
    if isinstance(damping.table, str):
        damping = damping.model_copy(update={"table": rename(damping.table)})
    return study.model_copy(update={"disturbances": disturbances, "damping": damping})


def _count(study: Study) -> int:
    each = 1 + len(study.solve.compare)
    if study.kind == "analysis":
        return 1
    if study.front is not None:
        return 2 + (study.front.points - 1) * each
    return 1 + max(len(study.cases), 1) * each


def _points(
    study: Study, problem: Problem, start: Array, stop: Callable[[], bool]
) -> Iterator[dict[str, Any]]:
    """Points of the run data, the start design first."""
    begin = time.perf_counter()
    analysis = study.kind == "analysis"
    certificate = certify(problem, start, problem.constraints)
    label = "design" if analysis else "start design"
    yield _point(
        problem,
        start,
        certificate,
        key="000" if analysis else "start",
        label=label,
        status="evaluated" if certificate.stable else "unstable",
        seconds=time.perf_counter() - begin,
    )
    if analysis:
        return
    options = Options(study.solve.tolerance, study.solve.max_iterations, study.solve.time_limit)
    how = Search(study.solve.strategy, options, study.solve.starts, study.solve.seed, study.solve.compare)
    outcomes: Iterator[tuple[str | None, Outcome]]
    if study.front is not None:
        outcomes = ((None, o) for o in trace_front(problem, start, study.front.points, how, stop))
    elif study.cases:
        outcomes = ((n, o) for n, o in solve_cases(problem, start, _masks(study, problem), how, stop))
    else:
        outcomes = (
            (None, o)
            for _, o in solve_cases(problem, start, [("optimum", everything_free(problem))], how, stop)
        )
    for position, (case, outcome) in enumerate(outcomes):
        yield _judged(problem, position, case, outcome)


def _masks(study: Study, problem: Problem) -> list[tuple[str, NDArray[np.bool_]]]:
    slices = problem.slices()
    masks = []
    for case in study.cases:
        names = (
            {"all": tuple(slices), "none": ()}.get(case.free, case.free)
            if isinstance(case.free, str)
            else case.free
        )
        free = np.zeros(problem.size, dtype=bool)
        for name in names:
            free[slices[name]] = True
        masks.append((case.name, free))
    return masks


def _judged(problem: Problem, position: int, case: str | None, outcome: Outcome) -> dict[str, Any]:
    """An outcome with its certificate as a point of the run data."""
    begin = time.perf_counter()
    goal, solution = outcome.goal, outcome.solution
    judged = outcome.strategy != "sequential"
    certificate = certify(
        problem,
        solution.x,
        goal.constraints,
        goal.objective if judged else None,
        goal.free if judged else None,
    )
    status: str = solution.status
    reason = solution.reason
    if not goal.free.any():
        status, reason = ("evaluated", None) if certificate.stable else ("unstable", None)
    elif status == "optimal" and not certificate.verified:
        status, reason = "failed", "; ".join(certificate.reasons)
    if not certificate.stable and status != "infeasible":
        status = "unstable"
    return _point(
        problem,
        solution.x,
        certificate,
        key=f"{position:03d}",
        label=outcome.label,
        status=status,
        reason=reason or ("; ".join(certificate.reasons) or None),
        case=case,
        strategy=outcome.strategy,
        parent=None if outcome.parent is None else f"{outcome.parent:03d}",
        seconds=solution.seconds + time.perf_counter() - begin,
        iterations=solution.iterations,
        starts={"tried": outcome.tried, "agreed": outcome.agreed} if outcome.tried > 1 else None,
        history=[[i, _finite(o), _finite(v)] for i, o, v in solution.history],
        goal=goal,
    )


def _point(
    problem: Problem,
    x: Array,
    certificate: Certificate,
    *,
    key: str,
    label: str,
    status: str,
    reason: str | None = None,
    case: str | None = None,
    strategy: str | None = None,
    parent: str | None = None,
    seconds: float = 0.0,
    iterations: int = 0,
    starts: dict[str, int] | None = None,
    history: list[list[Any]] | None = None,
    goal: Goal | None = None,
) -> dict[str, Any]:
    sound = certificate.stable and status in ("optimal", "evaluated")
    return {
        "key": key,
        "label": label,
        "case": case,
        "strategy": strategy,
        "objective": None if goal is None else goal.objective.text,
        "status": status,
        "verified": certificate.verified if status == "optimal" else sound and not _doubts(certificate),
        "dominated": False,
        "reason": reason or ("; ".join(certificate.reasons) or None),
        "parent": parent,
        "seconds": seconds,
        "iterations": iterations,
        "starts": starts,
        "kkt_residual": _finite(certificate.kkt_residual),
        "spectral_abscissa": certificate.spectral_abscissa,
        "jitter_disagreement": _finite(certificate.jitter_disagreement),
        "variables": {name: values.tolist() for name, values in problem.values(x).items()},
        "metrics": certificate.metrics,
        "constraints": [
            {
                "name": c.name,
                "value": c.value,
                "lower": _finite(c.lower),
                "upper": _finite(c.upper),
                "slack": c.slack,
                "multiplier": c.multiplier,
                "active": c.active,
                "statement": None,
            }
            for c in certificate.constraints
        ],
        "history": history or [],
        "detail": detail_of(problem.evaluate(x, truth=True)),
    }


def _state_prices(point: dict[str, Any], quantities: Mapping[str, Mapping[str, Any]]) -> None:
    """Say in words what one unit more of each active bound costs or saves."""
    objective = quantities.get(point["objective"] or "")
    for constraint in point["constraints"]:
        quantity = quantities.get(constraint["name"])
        multiplier = constraint["multiplier"]
        if objective is None or quantity is None or not constraint["active"] or not multiplier:
            continue
        change = multiplier / quantity["factor"] * objective["factor"]
        verb = "costs" if change > 0 else "saves"
        unit = f" {quantity['unit']}" if quantity["unit"] else ""
        constraint["statement"] = f"1{unit} more {verb} {abs(change):.3g} {objective['unit']}".rstrip()


def _doubts(certificate: Certificate) -> bool:
    """Whether the numbers of an evaluated design are in doubt; a violated requirement is no doubt."""
    return any(not reason.startswith("constraint") for reason in certificate.reasons)


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def _mark_dominated(points: list[dict[str, Any]], objectives: list[str]) -> bool:
    """Mark verified points that another one beats in both objectives; says whether any is."""
    if len(objectives) != 2:
        return False
    values = {
        i: [p["metrics"].get(name) for name in objectives]
        for i, p in enumerate(points)
        if p["verified"] and p["strategy"] is not None and all(p["metrics"].get(name) is not None for name in objectives)
    }
    for i, mine in values.items():
        points[i]["dominated"] = any(
            j != i and all(a <= b for a, b in zip(other, mine, strict=True)) and other != mine
            for j, other in values.items()
        )
    return any(p["dominated"] for p in points)


def _comparison(study: Study, points: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The second objective by strategy at the same limit on the first."""
    if not study.solve.compare or len(study.objectives) != 2:
        return []
    first, second = (o.minimize.text for o in study.objectives)
    rows: dict[float, dict[str, Any]] = {}
    for point in points:
        limit = next(
            (c["upper"] for c in point["constraints"] if c["name"] == first and c["upper"] is not None), None
        )
        if limit is None or point["strategy"] is None:
            continue
        row = rows.setdefault(limit, {"at": {first: limit}})
        row[point["strategy"]] = point["metrics"].get(second) if point["verified"] else None
    return list(rows.values())


def _header(study: Study, problem: Problem) -> dict[str, Any]:
    digest = hashlib.sha256(dump_study(study).encode())
    for path in side_files(study):
        digest.update(path.read_bytes())
    known = known_metrics(study)
    quantities = {
        name: _quantity(known[name].dimension, known[name].label, name)
        for name in problem.system.metric_names
    }
    for variable in study.variables:
        label = variable.name.replace("_", " ")
        quantities.setdefault(variable.name, _quantity(QUANTITIES[variable.quantity], label, variable.name))
    objectives = [o.minimize.text for o in study.objectives]
    return {
        "name": study.name,
        "description": study.description,
        "kind": study.kind,
        "quantities": quantities,
        "objectives": objectives,
        "requirements": dict(study.requirements),
        "labels": {v.name: list(v.labels) for v in problem.variables if v.labels},
        "comparison_objective": objectives[1] if len(objectives) == 2 else None,
        "provenance": {
            "study": digest.hexdigest()[:16],
            **{name: metadata.version(name) for name in _LIBRARIES},
            "python": platform.python_version(),
            "machine": f"{platform.system()} {platform.machine()}",
            "seed": str(study.solve.seed),
        },
    }


def _quantity(dimension: str, label: str, name: str) -> dict[str, Any]:
    factor, unit = display(dimension)
    column_factor, suffix = column(dimension)
    return {
        "label": label,
        "unit": unit,
        "factor": factor,
        "column": f"{name}_{suffix}" if suffix else name,
        "column_factor": column_factor,
    }


def _write_files(study: Study, run: Mapping[str, Any], out: Path) -> None:
    write_csv(run, out / "front.csv")
    write_json(run, out / "front.json")
    designs = out / "designs"
    designs.mkdir(exist_ok=True)
    inside = _renamed(study, lambda name: f"../{name}")
    for point in run["points"]:
        single = inside.model_copy(
            update={
                "kind": "analysis",
                "name": f"{study.name}: {point['label']}"[:200],
                "design": {name: tuple(values) for name, values in point["variables"].items()},
                "front": None,
                "cases": (),
                "solve": study.solve.model_copy(update={"compare": ()}),
            }
        )
        (designs / f"{point['key']}.yaml").write_text(dump_study(single), encoding="utf-8")
    write_report(run, out / "report.html")
