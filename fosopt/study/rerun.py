"""One point of a run again: from the same start, with the same numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from fosopt.errors import StudyError, did_you_mean
from fosopt.problem import Problem
from fosopt.solve import Request
from fosopt.study.build import start_vector
from fosopt.study.plan import plan_of, request_identity
from fosopt.study.points import evaluated_point, state_prices
from fosopt.study.provenance import LIBRARIES, environment
from fosopt.study.resume import recorded_files
from fosopt.study.schema import Study
from fosopt.study.store import Store
from fosopt.study.work import PointJob, laid_out, opened

# What a point says of the process that found it, and of other points.
_NOT_OF_THE_POINT = ("seconds", "dominated")


def rerun_point(path: Path, key: str, stop: Callable[[], bool]) -> dict[str, Any]:
    """Compute a point of a run again and compare it with the recorded one; nothing is written.

    Returns
    -------
    dict
        `request`, what it was asked, in words; `point` as found now; `differs`, the recorded and the new value of
        each number that is another one; `hurried`, the same of bounds whose time was up; `environment`, versions that
        are other ones; `interrupted`.

    Raises
    ------
    StoreError
        If there is no record, or it is damaged.
    StudyError
        If the run has no such point, or the point needs one that is not finished.
    """
    with Store.open(path) as store:
        header, answers, files = store.header(), store.answers(), recorded_files(store)
        if header["kind"] == "sweep":
            from fosopt.study.sweep_job import rerun_sweep_point

            # Every structure of a sweep is built anew, from the study's files.
            with laid_out(files) as study:
                return rerun_sweep_point(store, study, key)
        points = {point["key"]: point for point in store.run()["points"]}
    if key not in points:
        raise StudyError(f"the run has no point '{key}'; {did_you_mean(key, points)}")
    study, problem = opened(files)
    request = _request(study, problem, key, header["provenance"]["study"], answers)
    if request is None:
        x = start_vector(study, problem)
        label = points[key]["label"]
        point = evaluated_point(problem, x, key, label, study.certificates if key != "start" else None)
        said_ = "judge the start design"
    else:
        found = PointJob(study, problem).respond(request, stop)
        assert found.point is not None
        point, said_ = found.point, _asked(problem, request)
    state_prices(point, header["quantities"])
    hurried, differs = _apart(_differences(_own(points[key]), _own(point)), points[key], point)
    before = {k: header["provenance"].get(k) for k in (*LIBRARIES, "python", "threads")}
    return {
        "request": said_,
        "point": point,
        "differs": differs,
        "hurried": hurried,
        "environment": {
            name: [before[name], value]
            for name, value in environment().items()
            if before.get(name) not in (None, value)
        },
        "interrupted": point["status"] == "interrupted" or stop(),
    }


def _request(
    study: Study, problem: Problem, key: str, study_id: str, answers: Mapping[str, Any]
) -> Request | None:
    """What a point was asked, made from the answers it depends on; None for a design that was not searched for."""
    if study.kind == "analysis" or key == "start":
        return None
    plan = plan_of(study, problem, start_vector(study, problem))
    while requests := plan.ready():
        for request in requests:
            if request.position is not None and request.name == key:
                return request
            known = answers.get(request_identity(study_id, request))
            if known is not None:
                plan.take(request, known.x, known.status, known.objective)
    raise StudyError(f"point '{key}' starts from one that is not finished; continue the run first")


def _asked(problem: Problem, request: Request) -> str:
    names = [o.text for o in problem.objectives]
    limits = "".join(f", {names[k]} at most {value:.17g} (SI)" for k, value in request.limits)
    start = "the study's or an end of the front" if request.parent is None else f"point {request.parent:03d}"
    return f"minimize {names[request.minimized]}{limits}; {request.strategy}; start: {start}"


def _own(point: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in point.items() if name not in _NOT_OF_THE_POINT}


def _apart(
    found: Iterable[tuple[str, list[Any]]], before: Mapping[str, Any], now: Mapping[str, Any]
) -> tuple[dict[str, list[Any]], dict[str, list[Any]]]:
    """Differences of bounds for which time was up, which the machine decides, and all others."""
    late = tuple(
        f"bounds.{k}."
        for k, pair in enumerate(zip(before.get("bounds", ()), now.get("bounds", ()), strict=False))
        if any(entry.get("hurried") for entry in pair)
    )
    hurried: dict[str, list[Any]] = {}
    others: dict[str, list[Any]] = {}
    for path, pair in found:
        (hurried if late and path.startswith(late) else others)[path] = pair
    return hurried, others


def _differences(before: Any, now: Any, path: str = "") -> Iterator[tuple[str, list[Any]]]:
    if isinstance(before, dict) and isinstance(now, dict):
        for key in dict.fromkeys([*before, *now]):
            at = f"{path}.{key}" if path else str(key)
            yield from _differences(before.get(key), now.get(key), at)
    elif isinstance(before, list) and isinstance(now, list | tuple) and len(before) == len(now):
        for k, (a, b) in enumerate(zip(before, now, strict=True)):
            yield from _differences(a, b, f"{path}.{k}")
    elif before != now:
        yield path, [before, now]


def said(found: Mapping[str, Any]) -> Iterator[str]:
    """What a repeated point did and whether it is the same, in lines for people."""
    point = found["point"]
    yield found["request"]
    for name, (before, now) in found["environment"].items():
        yield f"note: {name} was {before}, here it is {now}"
    if point.get("history"):
        yield f"{'iteration':>9}  {'objective':>24}  {'infeasibility':>13}"
        for iteration, objective, violation in point["history"]:
            yield f"{iteration:>9}  {_number(objective):>24}  {_number(violation, 6):>13}"
    for constraint in point.get("constraints", ()):
        mark = " active" if constraint["active"] else ""
        yield f"{constraint['name']}: {_number(constraint['value'])}, slack {_number(constraint['slack'], 3)}{mark}"
    for name, value in point["metrics"].items():
        yield f"{name} = {_number(value)}"
    if "status" in point:
        verdict = "verified" if point["verified"] else f"not verified: {point['reason']}"
        yield f"{point['status']}, {verdict}, {point['iterations']} iterations, {point['seconds']:.2f} s"
    for path, (before, now) in found["hurried"].items():
        yield f"note: {path} was {before!r}, here {now!r}: its time limit was reached, which depends on the machine"
    if not found["differs"]:
        yield "all numbers are the recorded ones to the last bit"
        return
    yield f"{len(found['differs'])} numbers are not the recorded ones:"
    for path, (before, now) in list(found["differs"].items())[:20]:
        yield f"  {path}: {now!r}, recorded {before!r}"


def _number(value: float | None, digits: int = 17) -> str:
    return "-" if value is None else f"{value:.{digits}g}"
