"""Large structures: cost against bays, gradients against a Schur-based adjoint, and a truss of 2,000 bays.

Jitter under disturbances at the mirror, the hub and the line of sight, with derivatives for every area.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

import common
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from fosopt.actuators import Mirror
from fosopt.control import PID, Loop, gain_for_crossover
from fosopt.expressions import parse_expression
from fosopt.metrics.disturbances import Disturbance, low_pass
from fosopt.modes import Damping, Hub, ModalFrame, impedance_change, truncated_frame
from fosopt.problem import Constraint, Design, Evaluation, ModeSelection, Problem, System, Variable
from fosopt.solve.ipopt import Options, Solution, solve
from fosopt.solve.nlp import NonlinearProgram, Task
from fosopt.structure import Structure, assemble, barker_truss

Array = NDArray[np.float64]

HZ = 2 * pi
TITLE = "Large structures"
CODESIGN = (20, 60, 200)
GROWTH = (20, 60, 200, 600, 2000)
SHIFT = 5.0  # [rad/s]
FIXED_MODES = 20  # of every truss in the table of growth
LARGEST, KEPT = 2000, 1200
BLOCK = 50  # modes whose derivatives are taken at once
MIRROR = Mirror(10.8, 20 * HZ, 0.01)
MIRROR_MASS = 250.0
GAINS = (600.0, 5e4, 1.0)
COOLING, AFT_BODY, TURBULENCE = (10 * HZ, 0.5), (10 * HZ, 50.0), (8.5 * HZ, 20e-6)

NOTES = """\
Times are processor seconds; medians of {repeats} where one takes less than a second. The truss is the dissertation's
with more bays, a mirror of {inertia:g} kg m² and {mass:g} kg at its tip, and every area a variable.

Schur adjoint: the state space of all modes, mirror, loop and three shaping filters; one real Schur form (LAPACK dgees)
serves the Lyapunov equation for the covariance and the one for its adjoint (two dtrsyl, all disturbances together),
and the products that turn them into derivatives for stiffness and mass. Modes and what follows for the areas are the
same code on both sides, counted on both.

Co-design: least mass under limits on jitter and first frequency that the start violates. At 200 bays the design model
keeps {few} modes with residual flexibility, as a study does by itself; before that, all.

Growth: {fixed} modes with the residual flexibility of two ports; "slope" is that of time over bays between the last two
rows, on logarithmic scales. So few modes of the longest trusses leave the loop unstable: the jitter is that of
H(s + 5), which takes the same sums.

The truss of {bays} bays: {kept} modes, judged on twice as many. "Stated" is the bound on what truncation takes from the
receptance at the mirror, over the receptance of the model. Memory is the peak of a fresh process that builds the
problem and finds the modes, their derivatives and the jitter with its derivatives. The profile is cProfile's, libraries
counted to the module that called them."""


def system_of(bays: int, kept: int | None) -> tuple[System, Design]:
    """A truss with a mirror and its loop; the hub's attitude loop is slower than the truss."""
    structure = assemble(barker_truss("pinned", bays), "tip")
    gain = gain_for_crossover(100 * HZ, MIRROR, *GAINS, 0.0)
    loop = Loop(MIRROR, PID(gain, *GAINS))
    design = Design(structure.area, structure.batten_mass, structure.spring_stiffness, MIRROR_MASS, loop)
    disturbances = (
        Disturbance("cooling", "mirror_torque", low_pass(*COOLING)),
        Disturbance("aft_body", "hub_torque", low_pass(*AFT_BODY, order=2)),
        Disturbance("turbulence", "line_of_sight", low_pass(*TURBULENCE)),
    )
    hub = Hub("held", 0.1 * HZ * (20 / bays) ** 2, 0.7)
    return System(
        structure, "tip", hub, Damping((0.002,)), disturbances, selection=ModeSelection(kept)
    ), design


def problem_of(bays: int, kept: int | None) -> Problem:
    """Least mass, with limits a little beyond what the start has."""
    system, design = system_of(bays, kept)
    start = Evaluation(system, design)
    jitter, frequency = start.value("jitter_total"), start.value("first_elastic_frequency")
    area = design.area
    variable = Variable(
        "area", "area", 0.2 * area, 5 * area, area, groups=tuple((i,) for i in range(area.size))
    )
    limits = (
        Constraint(parse_expression("jitter_total"), upper=0.97 * jitter),
        Constraint(parse_expression("first_elastic_frequency"), lower=1.03 * frequency),
    )
    return Problem(system, design, (variable,), (parse_expression("structural_mass"),), limits)


def solved(problem: Problem) -> Solution:
    """One solve from the start."""
    task = Task(problem, problem.objectives[0], problem.constraints, np.ones(problem.size, dtype=bool))
    return solve(NonlinearProgram(task, problem.start), Options(time_limit=600.0))


def jitter_with_gradient(system: System, design: Design) -> tuple[float, Array]:
    """Jitter and its derivatives for the areas, from nothing."""
    value, gradient = Evaluation(system, design).metric("jitter_total")
    return value, gradient[: design.area.size]


@dataclass(frozen=True)
class StateSpace:
    """Closed loop with its shaping filters in modal coordinates: q, θ and their rates, the integral, filter states."""

    a: Array
    b: Array
    c: Array


def state_space(evaluation: Evaluation) -> StateSpace:
    """The state space by hand: all modes, mirror, PID and filters."""
    modes, design = evaluation.modes, evaluation.design
    mirror, pid = design.loop.mirror, design.loop.controller
    n = modes.natural_frequency.size
    z = np.append(modes.at("tip"), -1.0)
    inverse = np.append(np.ones(n), 1 / mirror.inertia)
    stiffness = np.diag(np.append(modes.stiffness, 0.0)) + mirror.stiffness * np.outer(z, z)
    damping = np.diag(np.append(modes.damping, 0.0)) + mirror.damping * np.outer(z, z)
    # The torque on the mirror reacts at its port.
    stiffness[:, n] -= z * pid.gain * pid.kp
    damping[:, n] -= z * pid.gain * pid.kd
    loop = 2 * n + 3
    filters = [d.filter for d in evaluation.system.disturbances if d.filter is not None]
    orders = [len(f.denominator) - 1 for f in filters]
    size = loop + sum(orders)
    a, b, c = np.zeros((size, size)), np.zeros((size, len(filters))), np.zeros((1, size))
    a[: n + 1, n + 1 : 2 * n + 2] = np.eye(n + 1)
    a[n + 1 : 2 * n + 2, : n + 1] = -inverse[:, None] * stiffness
    a[n + 1 : 2 * n + 2, n + 1 : 2 * n + 2] = -inverse[:, None] * damping
    push = inverse * z * pid.gain  # of minus what the controller commands
    a[n + 1 : 2 * n + 2, 2 * n + 2] = push * pid.ki
    a[2 * n + 2, n] = c[0, n] = 1.0
    first = loop
    for k, (shape, order) in enumerate(zip(filters, orders, strict=True)):
        last = first + order
        own = np.diag(np.ones(order - 1), 1)
        own[-1] = -np.array(shape.denominator[:0:-1]) / shape.denominator[0]
        gain = np.zeros(order)
        gain[: len(shape.numerator)] = np.array(shape.numerator[::-1]) / shape.denominator[0]
        a[first:last, first:last], b[last - 1, k] = own, 1.0
        at = evaluation.system.disturbances[k].at
        if at == "line_of_sight":
            a[n + 1 : 2 * n + 2, first:last] = np.outer(push, pid.kp * gain + pid.kd * gain @ own)
            b[n + 1 : 2 * n + 2, k] = push * pid.kd * gain[-1]
            a[2 * n + 2, first:last] = c[0, first:last] = gain
        else:
            load = np.append(modes.at("hub"), 0.0) if at == "hub_torque" else np.eye(n + 1)[n]
            a[n + 1 : 2 * n + 2, first:last] = np.outer(inverse * load, gain)
        first = last
    return StateSpace(a, b, c)


def by_schur(system: System, design: Design) -> tuple[float, Array]:
    """Jitter and its derivatives for the areas by Lyapunov equations."""
    evaluation = Evaluation(system, design)
    modes, space = evaluation.modes, state_space(evaluation)
    # Displacements times their frequency, then balanced: without it most digits are lost.
    size = np.ones(space.a.shape[0])
    n = modes.natural_frequency.size
    size[:n] = 1 / np.maximum(modes.natural_frequency, 1.0)
    _, (scale, _) = linalg.matrix_balance(space.a * size / size[:, None], permute=False, separate=True)
    size *= scale
    b, c = space.b / size[:, None], space.c * size
    form, turn = linalg.schur(space.a * size / size[:, None])

    def lyapunov(right: Array, adjoint: bool) -> Array:
        inside = turn.T @ right @ turn
        trans = ("T", "N") if adjoint else ("N", "T")
        found, scale, _ = linalg.lapack.dtrsyl(form, form, -inside, trana=trans[0], tranb=trans[1])
        return np.asarray(turn @ (found / scale) @ turn.T)

    covariance = lyapunov(b @ b.T, adjoint=False)
    weight = lyapunov(c.T @ c, adjoint=True)
    square = float((c @ covariance @ c.T)[0, 0])
    rates = slice(n + 1, 2 * n + 1)
    by_a = 2 * (weight[rates] @ covariance) * size / size[rates, None]
    by_b = 2 * (weight[rates] @ b) / size[rates, None]
    by_stiffness, by_damping = -by_a[:, :n], -by_a[:, n + 1 : 2 * n + 1]
    by_mass = -(by_a @ space.a[rates].T + by_b @ space.b[rates].T)
    frame = evaluation.frame
    change = impedance_change(frame.eigenvalue, modes, system.damping)
    stiffness, mass = frame.contract(
        by_stiffness + change.damping_by_stiffness * by_damping,
        by_mass + change.damping_by_mass * by_damping + change.hub_by_mass * by_stiffness,
    )
    gradient = system.structure.weight_gradients @ np.concatenate([stiffness, mass])
    jitter = square**0.5
    return jitter, gradient[: design.area.size] / (2 * jitter)


def against_schur(bays: int) -> list[str]:
    """A row: jitter with its derivatives by residues, of all modes and of the lowest, and by a Schur form."""
    system, design = system_of(bays, None)
    few = 100 if bays >= 200 else None
    repeats = 21 if bays < 100 else 5
    ours = common.median_seconds(lambda: jitter_with_gradient(system, design), repeats)
    value, gradient = jitter_with_gradient(system, design)
    reference = [by_schur(system, design)]
    schur = (
        common.median_seconds(lambda: by_schur(system, design), 3)
        if bays < 100
        else common.seconds(lambda: by_schur(system, design))
    )
    apart = float(np.linalg.norm(gradient - reference[0][1]) / np.linalg.norm(gradient))
    if not (apart < 1e-4 and abs(value / reference[0][0] - 1) < 1e-6):
        raise SystemExit(f"not comparable: at {bays} bays gradients differ by {apart:.1e}")
    row = [str(bays), str(design.area.size), f"{1e3 * ours:.1f}", f"{schur:.3g}", f"{schur / ours:.0f}"]
    if few is None:
        return [*row, "", "", "", f"{apart:.0e}"]
    less = replace(system, selection=ModeSelection(few))
    truncated = common.median_seconds(lambda: jitter_with_gradient(less, design), repeats)
    lost = np.linalg.norm(jitter_with_gradient(less, design)[1] - gradient) / np.linalg.norm(gradient)
    return [*row, f"{1e3 * truncated:.1f}", f"{schur / truncated:.0f}", f"{lost:.0e}", f"{apart:.0e}"]


def codesign(bays: int) -> list[str]:
    """A row: one solve."""
    problem = problem_of(bays, 100 if bays >= 200 else None)
    found: list[Solution] = []
    spent = common.seconds(lambda: found.append(solved(problem)))
    answer = found[0]
    if answer.status != "optimal":
        raise SystemExit(f"co-design of {bays} bays: {answer.reason}")
    each = spent / max(answer.iterations, 1)
    mass = float(problem.evaluate(problem.start).value("structural_mass"))
    return [
        str(bays),
        str(problem.size),
        f"{spent:.2f}",
        str(answer.iterations),
        f"{1e3 * each:.0f}",
        f"{mass:.1f}",
        f"{answer.objective:.1f}",
    ]


def frequencies(frame: ModalFrame, structure: Structure, count: int) -> Array:
    """(b, count) derivatives of the first elastic ω² for every area."""
    first, last = frame.n_rigid, frame.n_rigid + count
    found = np.empty((structure.area.size, count))
    for start in range(first, last, BLOCK):
        block = slice(start, min(start + BLOCK, last))
        by_members = structure.weight_gradients @ np.concatenate(frame.eigenvalue_gradient(block))
        found[:, block.start - first : block.stop - first] = by_members[: structure.area.size]
    return found


def parts_of(bays: int) -> list[float]:
    """Times of assembly, modes, derivatives of their frequencies, and jitter with derivatives on known modes [s]."""
    truss = barker_truss("pinned", bays)
    structure = assemble(truss, "tip")
    sizes = structure.area, structure.batten_mass, MIRROR_MASS, ("tip", "hub"), FIXED_MODES
    frame = truncated_frame(structure, *sizes)
    evaluation = Evaluation(*system_of(bays, FIXED_MODES), SHIFT)
    evaluation.frame = frame
    work = (
        lambda: assemble(truss, "tip"),
        lambda: truncated_frame(structure, *sizes),
        lambda: frequencies(frame, structure, FIXED_MODES - 1),
        lambda: evaluation.neighbor(evaluation.design).metric("jitter_total"),
    )
    return [common.median_seconds(each, 5) for each in work]


def growth() -> list[list[str]]:
    """Time of each part over bays, for a fixed number of modes."""
    times = [parts_of(bays) for bays in GROWTH]
    rows = [
        [str(bays), str(3 * bays), *(f"{1e3 * t:.2f}" for t in each)]
        for bays, each in zip(GROWTH, times, strict=True)
    ]
    span = np.log(GROWTH[-1] / GROWTH[-2])
    slopes = np.log(np.array(times[-1]) / np.array(times[-2])) / span
    return [*rows, ["slope", "", *(f"{s:.2f}" for s in slopes)]]


def largest() -> list[list[str]]:
    """The truss of 2,000 bays."""
    built: list[tuple[System, Design]] = []
    building = common.seconds(lambda: built.append(system_of(LARGEST, KEPT)))
    system, design = built[0]
    evaluation = Evaluation(system, design)
    modes = common.seconds(lambda: evaluation.frame)
    gradients = common.seconds(lambda: frequencies(evaluation.frame, system.structure, KEPT - 1))
    rest = common.seconds(lambda: evaluation.metric("jitter_total"))
    value, gradient = evaluation.metric("jitter_total")
    truth = Evaluation(system.truth, design)
    exact, slope = truth.metric("jitter_total")
    outside = evaluation.frame.outside
    assert outside is not None
    at = np.array([20 * HZ])
    stated = float(outside.receptance_error(at)[0, 0, 0])
    size = float(np.abs(evaluation.modes.receptance(1j * at, "tip", "tip"))[0])
    lost = float(np.linalg.norm(gradient - slope) / np.linalg.norm(slope))
    total = modes + gradients + rest
    return [
        ["assembly [s]", f"{building:.2f}", ""],
        [f"{KEPT} modes with residual flexibility [s]", f"{modes:.2f}", ""],
        [f"derivatives of {KEPT - 1} frequencies for all areas [s]", f"{gradients:.2f}", ""],
        ["jitter with derivatives, modes known [s]", f"{rest:.2f}", ""],
        ["all of it [s]", f"{building + total:.2f}", "≤ 30"],
        ["peak memory [GiB]", f"{peak_memory():.2f}", "≤ 2"],
        [f"jitter over that of {2 * KEPT} modes, less one", f"{value / exact - 1:.1e}", ""],
        ["the same of its derivatives, norm", f"{lost:.1e}", ""],
        ["first frequency left out [Hz]", f"{outside.next_eigenvalue**0.5 / HZ:.1f}", ""],
        ["receptance at 20 Hz, stated error over size", f"{stated / size:.1e}", ""],
    ]


def alone() -> None:
    """All derivatives of the largest truss, in a process that does nothing else; prints its peak memory [GiB]."""
    system, design = system_of(LARGEST, KEPT)
    evaluation = Evaluation(system, design)
    found = frequencies(evaluation.frame, system.structure, KEPT - 1), evaluation.metric("jitter_total")
    assert all(len(each) for each in found)
    # Not getrusage, whose peak a process inherits from the one that started it.
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text("utf-8").splitlines())
    print(int(status["VmHWM"].split()[0]) / 2**20)


def peak_memory() -> float:
    """Largest resident memory of a process that only builds the largest problem and differentiates it [GiB]."""
    answer = subprocess.run(
        [sys.executable, __file__, "--largest"], check=True, capture_output=True, text=True
    )
    return float(answer.stdout)


def main() -> None:
    """Measure, print and write the section."""
    body = [
        "Jitter with derivatives for every area.",
        common.table(
            [
                "bays",
                "areas",
                "all modes [ms]",
                "Schur adjoint [s]",
                "ratio",
                "100 modes [ms]",
                "ratio",
                "lost by truncation",
                "largest difference",
            ],
            [against_schur(bays) for bays in CODESIGN],
        ),
        "Target at 200 bays: a ratio of at least 25.",
        "Co-design.",
        common.table(
            ["bays", "areas", "solve [s]", "iterations", "each [ms]", "start [kg]", "optimum [kg]"],
            [codesign(bays) for bays in CODESIGN],
        ),
        f"Growth for {FIXED_MODES} modes [ms].",
        common.table(
            ["bays", "areas", "assembly", "modes", "derivatives of frequencies", "jitter with derivatives"],
            growth(),
        ),
        f"{LARGEST} bays, {3 * LARGEST} areas.",
        common.table(["", "value", "target"], largest()),
        NOTES.format(
            repeats=5,
            inertia=MIRROR.inertia,
            mass=MIRROR_MASS,
            few=100,
            fixed=FIXED_MODES,
            bays=LARGEST,
            kept=KEPT,
        ),
        common.table(
            ["jitter with derivatives at 2,000 bays, by module", "share"],
            common.profile_by_module(lambda: jitter_with_gradient(*system_of(LARGEST, KEPT))),
        ),
    ]
    text = "\n\n".join(body)
    print(text)
    common.write_section(TITLE, text)


if __name__ == "__main__":
    common.one_thread()
    if "--largest" in sys.argv:
        alone()
    else:
        main()
