"""Bounds on structure and controller together: how close, and what they take.

Systems are those of the studies that ship: the modified benchmark problem of chapter 3 with the spring of its structure
free, and the full truss with its areas in one or two groups.
"""

from __future__ import annotations

import time
from dataclasses import replace
from math import pi
from pathlib import Path

import common
import numpy as np

from fosopt.expressions import parse_expression
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.functional import LoopModel
from fosopt.problem import Constraint, Problem
from fosopt.relax.joint_family import StructureFamily, chain_family, structure_family
from fosopt.relax.joint_limit import JointLimit, family_limit, joint_limit
from fosopt.relax.performance_limit import performance_limit
from fosopt.relax.pid_bound import best_pid
from fosopt.relax.pid_box import PidBox
from fosopt.solve import Goal, Options, everything_free, reach
from fosopt.structure import Chain, two_body_stiffness
from fosopt.study.build import build_problem, start_vector
from fosopt.study.load import load_study

STUDIES = Path(__file__).resolve().parents[1] / "studies"
TITLE = "Bounds on structure and controller together"
HZ = 2 * pi
BODY, DAMPING = 0.22, 0.001  # of chapter 3 [kg m²], [-]
RATES = (1, 10, 100, 500)
WIDE = PidBox((1.0, 1.0), (1e4, 1e8), (1e4, 1e11), (1e2, 1e5))
TIME_LIMIT = 120.0
TRUSSES = (
    ("mass-jitter.yaml", "all", 112.0),
    ("mass-jitter.yaml", "kind", 112.0),
    ("mass-jitter.yaml", "member", 125.0),
    ("certified-front.yaml", "all", 112.0),
    ("certified-front.yaml", "kind", 112.0),
)
MIRROR = ("mirror_inertia_ratio", "mirror_frequency")

NOTES = f"""\
Processor seconds. "Any" is the limit of performance of any controller on one structure, "attained" what the joint bound
is at its lowest: finer boxes would not raise it above that. The springs of chapter 3 are those of a structure that
swings at 1 to 500 Hz on its own; the PID controller is the best in the wide box of `certificates_control.py`, on the
stiffest. Designs of the truss are IPOPT's least jitter at the limit on the mass with the other constraints of the
study, its areas in one or two groups (longerons, diagonals) or member by member, and the mirror as given; for 60 areas
the bound is that of the whole box. Up to {TIME_LIMIT:g} s by the clock each. Jitter in µrad."""


def study(file: str, *overrides: str) -> tuple[Problem, np.ndarray]:
    """A study's problem without the mirror's variables, and its start."""
    loaded = load_study(STUDIES / file, overrides)
    problem = build_problem(loaded)
    x = start_vector(loaded, problem)
    kept = [v.quantity not in MIRROR for v in problem.variables]
    x = np.concatenate([x[s] for s, keep in zip(problem.slices().values(), kept, strict=True) if keep])
    variables = tuple(v for v, keep in zip(problem.variables, kept, strict=True) if keep)
    return replace(problem, variables=variables), x


def chains(low: float, high: float, model: LoopModel) -> StructureFamily:
    """The modified benchmark problem with its structure between two frequencies [rad/s]."""
    springs = [float(two_body_stiffness(rate, BODY, BODY)) for rate in (low, high)]
    chain = Chain({"aft_body": BODY, "bench": BODY}, (springs[0],), False)
    return chain_family(chain, np.array(springs[:1]), np.array(springs[1:]), model.loop.mirror, DAMPING)


def one(family: StructureFamily, x: np.ndarray) -> StructureFamily:
    """A family of one structure."""
    return replace(family, sizing=replace(family.sizing, lower=x, upper=x))


def timed(
    family: StructureFamily, disturbances: tuple[Disturbance, ...], tolerance: float
) -> tuple[JointLimit, float]:
    """A joint bound, and what it took."""
    begin = time.process_time()
    found = family_limit(family, disturbances, tolerance=tolerance, time_limit=TIME_LIMIT)
    return found, time.process_time() - begin


def at_one_structure() -> list[list[str]]:
    """What is lost by looking at responses away from the imaginary axis only."""
    rows = []
    for rate in RATES:
        problem, x = study("modified-benchmark.yaml", f"structure.springs.0.frequency={rate} Hz")
        model, disturbances = problem.evaluate(x, truth=True).model, problem.system.disturbances
        family = chains(rate * HZ, rate * HZ, model)
        rows.append(compared(f"chapter 3, {rate} Hz", model, disturbances, family))
    for file in ("unstable-mirror.yaml", "mass-jitter.yaml", "certified-front.yaml"):
        areas = () if file == "unstable-mirror.yaml" else ("variables.0.group_by=kind",)
        problem, x = study(file, *areas)
        truth = problem.evaluate(x, truth=True)
        family, _ = structure_family(problem, x, (), truth)
        here = one(family, x[: family.sizing.lower.size])
        rows.append(compared(file, truth.model, problem.system.disturbances, here))
    return rows


def compared(
    name: str, model: LoopModel, disturbances: tuple[Disturbance, ...], family: StructureFamily
) -> list[str]:
    """A row of the first table."""
    limit = performance_limit(model, disturbances).bound.value
    found, seconds = timed(family, disturbances, 0.02)
    value = found.bound.value
    return [name, f"{1e6 * limit:.4f}", f"{1e6 * value:.4f}", f"{value / limit:.4f}", f"{seconds:.1f}"]


def benchmark_problem() -> list[list[str]]:
    """The joint bound of chapter 3 against a PID controller on the stiffest structure."""
    problem, x = study("modified-benchmark.yaml", f"structure.springs.0.frequency={RATES[-1]} Hz")
    model, disturbances = problem.evaluate(x, truth=True).model, problem.system.disturbances
    limit = performance_limit(model, disturbances).bound.value
    design = best_pid(model, disturbances, WIDE, gap=0.01, time_limit=TIME_LIMIT)
    rows = []
    for tolerance in (0.05, 0.01):
        found, seconds = timed(chains(RATES[0] * HZ, RATES[-1] * HZ, model), disturbances, tolerance)
        found.bound.hold(design.jitter, "the PID controller")
        rows.append(
            [f"chapter 3, spring, {tolerance:g}", *numbers(found, design.jitter, limit), f"{seconds:.1f}"]
        )
    return rows


def numbers(found: JointLimit, jitter: float, limit: float) -> list[str]:
    """What both tables of joint bounds say."""
    value = found.bound.value
    return [
        f"{1e6 * jitter:.3f}",
        f"{1e6 * limit:.3f}",
        f"{1e6 * value:.3f}",
        f"{1e6 * found.attained:.3f}",
        f"{100 * (1 - value / jitter):.1f} %",
        f"{found.boxes} / {found.weights}" + ("" if found.finished else ", time up"),
    ]


def truss(file: str, group: str, mass: float) -> list[str]:
    """The joint bound of a truss under a limit on its mass against IPOPT's design."""
    problem, x = study(file, f"variables.0.group_by={group}")
    constraints = (*problem.constraints, Constraint(parse_expression("structural_mass"), upper=mass))
    goal = Goal(problem, parse_expression("jitter_total"), constraints, everything_free(problem))
    design = reach(goal, x, "simultaneous", Options()).x
    truth = problem.evaluate(design, truth=True)
    limit = performance_limit(truth.model, problem.system.disturbances).bound.value
    begin = time.process_time()
    found = joint_limit(problem, design, constraints, time_limit=TIME_LIMIT)
    seconds = time.process_time() - begin
    name = f"{file.removesuffix('.yaml')}, {group}, {mass:g} kg"
    return [name, *numbers(found, truth.value("jitter_total"), limit), f"{seconds:.1f}"]


def main() -> None:
    """Measure, print and write the section."""
    head = ["", "design", "any, there", "joint bound", "attained", "gap", "boxes / weights", "s"]
    body = [
        "The bound at one structure, against the limit of performance.",
        common.table(["", "any", "bound", "ratio", "s"], at_one_structure()),
        "No structure in the box with any linear controller leaves less than the joint bound.",
        common.table(head, [*benchmark_problem(), *(truss(*case) for case in TRUSSES)]),
        NOTES,
    ]
    text = "\n\n".join(body)
    print(text)
    common.write_section(TITLE, text)


if __name__ == "__main__":
    common.one_thread()
    main()
