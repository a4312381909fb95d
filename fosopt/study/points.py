"""Points of the run data: outcomes of a search with their certificates, as plain numbers and text."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fosopt.account import Entry, PidSearch, account, refutation
from fosopt.certify import Certificate, certify
from fosopt.errors import FosoptError
from fosopt.ops import Array
from fosopt.problem import Constraint, Problem
from fosopt.solve import Outcome
from fosopt.solve.front import objective_value
from fosopt.solve.strategies import Goal
from fosopt.study.detail import detail_of
from fosopt.study.requirement import line_entry
from fosopt.study.schema import Study
from fosopt.study.schema_certificates import Certificates


def judged_point(
    problem: Problem,
    position: int,
    case: str | None,
    outcome: Outcome,
    bounds: Certificates | None = None,
) -> dict[str, Any]:
    """An outcome with its certificate, and the bounds asked for, as a point of the run data."""
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
        bounds=bounds,
        constraints=goal.constraints,
    )


# Objectives this close (relative) are one: above what a converged solver leaves.
SAME = 1e-6


def evaluated_point(
    problem: Problem, x: Array, key: str, label: str, bounds: Certificates | None = None
) -> dict[str, Any]:
    """A design that was not searched for, judged as it is."""
    begin = time.perf_counter()
    certificate = certify(problem, x, problem.constraints)
    status = "evaluated" if certificate.stable else "unstable"
    seconds = time.perf_counter() - begin
    return _point(
        problem, x, certificate, key=key, label=label, status=status, seconds=seconds, bounds=bounds
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
    bounds: Certificates | None = None,
    constraints: Sequence[Constraint] = (),
) -> dict[str, Any]:
    sound = certificate.stable and status in ("optimal", "evaluated")
    verified = certificate.verified if status == "optimal" else sound and not _doubts(certificate)
    detail = detail_of(problem.evaluate(x, truth=True))
    entries: Sequence[Entry] = ()
    if bounds is not None and verified:
        entries = _account(problem, x, constraints, bounds)
    elif bounds is not None and bounds.structure and status in ("infeasible", "failed"):
        proven = refutation(problem, x, constraints)
        if proven is not None:
            entries, status = (proven,), "infeasible"
            reason = f"{reason}; {proven.remark}" if reason else proven.remark
    return {
        "key": key,
        "label": label,
        "case": case,
        "strategy": strategy,
        "objective": None if goal is None else goal.objective.text,
        "status": status,
        "verified": verified,
        "dominated": False,
        "reason": reason or ("; ".join(certificate.reasons) or None),
        "parent": parent,
        "seconds": seconds,
        "iterations": iterations,
        "starts": starts,
        "kkt_residual": _finite(certificate.kkt_residual),
        "spectral_abscissa": certificate.spectral_abscissa,
        "jitter_disagreement": _finite(certificate.jitter_disagreement),
        "truncation_error": certificate.truncation_error,
        "variables": {name: values.tolist() for name, values in problem.values(x).items()},
        "metrics": certificate.metrics | _composed(problem, x, certificate),
        "constraints": [
            {
                "name": c.name,
                "value": c.value,
                "lower": _finite(c.lower),
                "upper": _finite(c.upper),
                "slack": c.slack,
                "multiplier": c.multiplier,
                "active": c.active,
                "met": not c.violated,
                "statement": None,
            }
            for c in certificate.constraints
        ],
        "bounds": [_entry(entry) for entry in entries],
        "history": history or [],
        "requirement_line": line_entry(problem.system.requirement_line, detail.pop("requirement_line")),
        "detail": detail,
    }


def _account(
    problem: Problem, x: Array, constraints: Sequence[Constraint], asked: Certificates
) -> tuple[Entry, ...]:
    """The two-sided account of a design, as far as it is asked for."""
    pid = None if asked.pid is None else PidSearch(asked.pid.time_limit, asked.pid.gap)
    at = None if asked.receptance is None else (asked.receptance.port, asked.receptance.frequency)
    return account(
        problem,
        x,
        constraints,
        structure=asked.structure,
        receptance=at,
        any_controller=asked.any_controller,
        pid=pid,
    )


def _entry(entry: Entry) -> dict[str, Any]:
    """A line of an account as plain numbers and text."""
    return {
        "name": entry.name,
        "value": _finite(entry.value),
        "reached": entry.reached,
        "gap": _finite(entry.gap),
        "of": entry.of,
        "assumptions": list(entry.assumptions),
        "allowance": entry.allowance,
        "remark": entry.remark,
        "hurried": entry.hurried,
    }


def state_prices(point: dict[str, Any], quantities: Mapping[str, Mapping[str, Any]]) -> None:
    """Say in words what one unit more of each active bound costs or saves."""
    if point["status"] != "optimal":
        return
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


def _composed(problem: Problem, x: Array, certificate: Certificate) -> dict[str, float | None]:
    """Values of objectives that are expressions of metrics, by their text."""
    values: dict[str, float | None] = {}
    for objective in problem.objectives:
        if objective.reference is None or objective.text not in certificate.metrics:
            try:
                values[objective.text] = objective_value(problem, x, objective)
            except FosoptError:
                values[objective.text] = None
    return values


def _doubts(certificate: Certificate) -> bool:
    """Whether the numbers of an evaluated design are in doubt; a violated requirement is no doubt."""
    return any(not reason.startswith("constraint") for reason in certificate.reasons)


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def mark_dominated(points: list[dict[str, Any]], objectives: list[str]) -> bool:
    """Mark verified points that another one beats in both objectives; says whether any is."""
    if len(objectives) != 2:
        return False
    values = {
        i: [p["metrics"].get(name) for name in objectives]
        for i, p in enumerate(points)
        if p["verified"]
        and p["strategy"] is not None
        and all(p["metrics"].get(name) is not None for name in objectives)
    }
    for i, mine in values.items():
        points[i]["dominated"] = any(
            all(a <= b + SAME * abs(b) for a, b in zip(other, mine, strict=True))
            and any(a < b - SAME * abs(b) for a, b in zip(other, mine, strict=True))
            for other in values.values()
        )
    return any(p["dominated"] for p in points)


def comparison(study: Study, points: list[dict[str, Any]]) -> list[dict[str, Any]]:
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
