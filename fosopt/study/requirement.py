"""Requirements of a study that no optimization knows of: the line of cumulative jitter, and what a point misses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from fosopt.metrics.requirement import TOLERANCE, LineVerdict, RequirementLine
from fosopt.study.files import read_requirement_line
from fosopt.study.schema import Study
from fosopt.units import HZ

_NOT_JUDGED: dict[str, Any] = {
    "met": None,
    "frequency_hz": None,
    "reached": None,
    "allowed": None,
    "excess": None,
}


def requirement_line(study: Study) -> RequirementLine | None:
    """The line of a study, if it states one.

    Raises
    ------
    StudyError
        If its file breaks a rule.
    """
    rows = read_requirement_line(study)
    if rows is None:
        return None
    return RequirementLine(HZ * np.array(rows["frequency_hz"]), np.array(rows["rms"]))


def line_entry(line: RequirementLine | None, verdict: LineVerdict | None) -> dict[str, Any] | None:
    """The ``requirement_line`` of a point: None without a line, all of its values None without a curve to judge."""
    if line is None:
        return None
    if verdict is None:
        return dict(_NOT_JUDGED)
    return {
        "met": verdict.met,
        "frequency_hz": verdict.frequency / HZ,
        "reached": verdict.reached,
        "allowed": verdict.allowed,
        "excess": verdict.excess,
    }


def unmet(run: Mapping[str, Any], point: Mapping[str, Any]) -> Iterator[str]:
    """What a point misses of the constraints, requirements and requirement line of its study, in words."""
    for constraint in point["constraints"]:
        if not constraint.get("met", True):
            lower, upper = constraint["lower"], constraint["upper"]
            below = lower is not None and constraint["value"] < lower
            rule = f"at least {_amount(run, constraint['name'], lower)}" if below else ""
            rule = rule or f"at most {_amount(run, constraint['name'], upper)}"
            yield f"constraint {constraint['name']}: {_amount(run, constraint['name'], constraint['value'])}, {rule}"
    for name, most in run["requirements"].items():
        value = point["metrics"].get(name)
        if value is None:
            yield f"requirement {name}: not judged, the point has no value of it; make it a constraint"
        elif value > most + TOLERANCE * abs(most):
            yield f"requirement {name}: {_amount(run, name, value)}, at most {_amount(run, name, most)}"
    if run.get("requirement_line") is None:
        return
    line = point.get("requirement_line") or _NOT_JUDGED
    if line["met"] is None:
        yield "requirement line: not judged, the point has no cumulative jitter"
    elif not line["met"]:
        yield f"requirement line: {line_said(run, line)}"


def line_said(run: Mapping[str, Any], line: Mapping[str, Any]) -> str:
    """The verdict of a point that was judged, in words."""
    reached, allowed, apart = (
        _amount(run, "jitter_total", value)
        for value in (line["reached"], line["allowed"], abs(line["excess"]))
    )
    word = "above" if line["excess"] > 0 else "below"
    return f"{reached} of {allowed} at {line['frequency_hz']:.4g} Hz, {apart} {word}"


def _amount(run: Mapping[str, Any], name: str, value: float) -> str:
    quantity = run["quantities"].get(name)
    if quantity is None:
        return f"{value:.5g}"
    return f"{value * quantity['factor']:.5g} {quantity['unit']}".rstrip(" -")
