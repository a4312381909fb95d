"""The run directory: made once, complete on its own, and filled at the end."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fosopt.errors import StudyError, printable
from fosopt.export import write_csv, write_json
from fosopt.export.columns import provenance_of
from fosopt.problem import Problem
from fosopt.report import write_report
from fosopt.study.files import read_requirement_line, side_files
from fosopt.study.load import dump_study
from fosopt.study.lock import LOCK
from fosopt.study.provenance import environment, machine, revision
from fosopt.study.schema import Study
from fosopt.study.schema_imports import with_structure_files
from fosopt.study.schema_names import BOUNDS
from fosopt.study.schema_rules import expression_dimension, known_metrics, variable_dimension
from fosopt.units import DIMENSIONLESS, Vector, column, dimension_name, display

_INPUTS = "inputs"


def make_directory(out: Path) -> None:
    """Make the run directory, or take an empty one.

    Raises
    ------
    StudyError
        If it holds something already, or cannot be written.
    """
    taken = not out.is_dir() or any(path.name != LOCK for path in out.iterdir()) if out.exists() else False
    if taken:
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


def with_inputs(study: Study, out: Path) -> Study:
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
        d.model_copy(
            update={
                key: rename(name)
                for key in ("psd", "cumulative_rms")
                if (name := getattr(d, key)) is not None
            }
        )
        for d in study.disturbances
    )
    damping = study.damping
    if isinstance(damping.table, str):
        damping = damping.model_copy(update={"table": rename(damping.table)})
    structure = with_structure_files(study.structure, rename)
    changes: dict[str, Any] = {"disturbances": disturbances, "damping": damping, "structure": structure}
    if study.requirement_line is not None:
        changes["requirement_line"] = rename(study.requirement_line)
    return study.model_copy(update=changes)


def study_hash(study: Study) -> str:
    """A digest of a study and the content of its side files."""
    digest = hashlib.sha256(dump_study(study).encode())
    for path in side_files(study):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def run_header(study: Study, problem: Problem) -> dict[str, Any]:
    """The run data but for its points: what was asked, in which units, and where it came from."""
    known = known_metrics(study)
    quantities = {
        name: quantity_entry(known[name].dimension, known[name].label, name)
        for name in problem.system.metric_names
    }
    for disturbance in study.disturbances:
        quantities[f"jitter_{disturbance.name}"]["label"] = (
            f"jitter from {disturbance.name.replace('_', ' ')}"
        )
    for variable in study.variables:
        label = variable.name.replace("_", " ")
        dimension = variable_dimension(study, variable)
        quantities.setdefault(variable.name, quantity_entry(dimension, label, variable.name))
    if study.certificates is not None:
        quantities |= {name: quantity_entry(b.dimension, b.label, name) for name, b in BOUNDS.items()}
    objectives = [o.minimize.text for o in study.objectives]
    given = [(o.minimize, o.label, "objective") for o in study.objectives]
    given += [(c.metric, c.label, "constraint") for c in study.constraints]
    for expression, called, kind in given:
        text = expression.text
        if text not in quantities:
            vector = expression_dimension(study, expression)
            quantities[text] = quantity_entry(vector or DIMENSIONLESS, text, f"{kind}_{len(quantities)}")
        if called is not None:
            quantities[text]["label"] = called
    return {
        "name": study.name,
        "description": study.description,
        "kind": study.kind,
        "quantities": quantities,
        "objectives": objectives,
        "requirements": dict(study.requirements),
        "requirement_line": read_requirement_line(study),
        "labels": {v.name: list(v.labels) for v in problem.variables if v.labels},
        "comparison_objective": objectives[1] if len(objectives) == 2 else None,
        "provenance": {
            "study": study_hash(study),
            "revision": revision(),
            **environment(),
            "machine": machine(),
            "seed": str(study.solve.seed),
            "modes": problem.system.model,
        },
    }


def quantity_entry(dimension: str | Vector, label: str, name: str) -> dict[str, Any]:
    """How a quantity of the run data is shown: label, unit, factor from SI, and the same for a table's column."""
    kind = dimension if isinstance(dimension, str) else dimension_name(dimension)
    if kind is None:
        # An expression in a unit that has no name of its own is shown as it is computed.
        return {"label": label, "unit": "SI", "factor": 1.0, "column": f"{name}_si", "column_factor": 1.0}
    factor, unit = display(kind)
    column_factor, suffix = column(kind)
    return {
        "label": label,
        "unit": unit,
        "factor": factor,
        "column": f"{name}_{suffix}" if suffix else name,
        "column_factor": column_factor,
    }


def write_files(study: Study, run: Mapping[str, Any], out: Path) -> None:
    """Write what people take away: tables, one study per design, and the report."""
    write_csv(run, out / "front.csv")
    write_json(run, out / "front.json")
    designs = out / "designs"
    designs.mkdir(exist_ok=True)
    # A comment holds no line break and no control character, whatever a --set or a file's name had of them.
    origin = printable(provenance_of(run))
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
        text = f"# {origin}\n{dump_study(single)}"
        (designs / f"{point['key']}.yaml").write_text(text, encoding="utf-8", errors="backslashreplace")
    write_report(run, out / "report.html")
