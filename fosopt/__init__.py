"""Co-design of flexible optical systems: structure, mirror and controller optimized as one.

    import fosopt

    study = fosopt.load_study("studies/quickstart.yaml")     # the models of the study file
    problem = fosopt.build_problem(study)                    # system, variables, objectives, constraints
    design = problem.evaluate(problem.start)                 # modes, poles, metrics with gradients
    design.metric("jitter_total")                            # value and gradient
    problem.metric_function("jitter_total")                  # the same as a CasADi function of the variables
    run = fosopt.run_study(study, "runs/first")              # what `fosopt run` does
    fosopt.certify(problem, problem.start, problem.constraints)

Names are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fosopt.certify import certify
    from fosopt.problem import Problem
    from fosopt.study import Study, dump_study, load_study, parse_study
    from fosopt.study.build import build_problem
    from fosopt.study.runner import run_study

__all__ = [
    "Problem",
    "Study",
    "build_problem",
    "certify",
    "dump_study",
    "load_study",
    "parse_study",
    "run_study",
]

_HOMES = {
    "Problem": "problem",
    "Study": "study",
    "build_problem": "study.build",
    "certify": "certify",
    "dump_study": "study",
    "load_study": "study",
    "parse_study": "study",
    "run_study": "study.runner",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return metadata.version("fosopt")
    if name not in _HOMES:
        raise AttributeError(f"module 'fosopt' has no attribute {name!r}")
    return getattr(import_module(f"fosopt.{_HOMES[name]}"), name)
