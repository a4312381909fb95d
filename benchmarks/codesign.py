"""Co-design of all 62 degrees of freedom: fosopt against finite differences of a Lyapunov equation.

Mass is minimized over 60 areas, mirror inertia and three gains, under limits on jitter and on the first elastic
frequency that are both active at the optimum.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from math import pi

import common
import numpy as np
from numpy.typing import NDArray
from plain_model import Numbers, PlainModel, plain_model
from scipy import optimize

from fosopt.actuators import Mirror
from fosopt.control import PID, Loop, gain_for_crossover
from fosopt.expressions import parse_expression
from fosopt.metrics.disturbances import Disturbance, high_pass, low_pass
from fosopt.modes import Damping, Hub
from fosopt.problem import Constraint, Design, Problem, System, Variable
from fosopt.solve.ipopt import Options, Solution, solve
from fosopt.solve.nlp import NonlinearProgram, Task
from fosopt.structure import assemble, barker, barker_truss, structure_inertia

Array = NDArray[np.float64]

HZ = 2 * pi
JITTER_LIMIT = 6.5e-6  # [rad]
FREQUENCY_LIMIT = 4 * HZ
MIRROR_MASS = 7 / 3 * barker.TOTAL_MASS  # 70 % of the total
MIRROR_FREQUENCY, MIRROR_DAMPING = 20 * HZ, 0.01
HUB_BANDWIDTH, HUB_DAMPING = 0.1 * HZ, 0.7
DAMPING = 0.002
KP, KI, KD, CROSSOVER = 600.0, 5e4, 1.0, 100 * HZ
COOLING = (10 * HZ, 3.0)  # corner and rms torque on the mirror [N m]
AFT_BODY = (10 * HZ, 50.0)  # on the hub, second order [N m]
TURBULENCE = (8.5 * HZ, 20e-6)  # of the line of sight [rad]
NOISE = (70 * HZ, 0.2e-6)  # corner and density of the sensor [rad/√Hz]

TITLE = "Co-design of 62 degrees of freedom"
REPEATS = 9
# The loosest SLSQP tolerance that still meets the agreement asked for, and the step at the bottom of the error.
AGREEMENT = 1e-4
SLSQP_TOLERANCE = 1e-6
STEP = 1e-6
SWEEP = (3e-3, 1e-3, 3e-4, 1e-4, 3e-5)  # steps of the fourth-order differences that judge the derivatives


NOTES = """\
Times are processor seconds. fosopt: the problem is built once; median of {repeats} solves, half of them before and
half after SciPy's one. SciPy: SLSQP on logarithmic variables and scaled rows with forward differences of relative
step 1e-6; {evaluations} evaluations, each an `eigh` of 61 degrees of freedom and one Lyapunov equation of 130
states. Its tolerance is the loosest power of ten that reaches the agreement asked for. Most of the mass is battens
that no variable changes, so the difference is given over the mass of the bars as well.

Derivatives are taken for the logarithms of the variables at the optimum and compared with fourth-order central
differences of the Lyapunov route, each at the best of a sweep of steps; a deviation is divided by the norm of the
gradient. One jitter alone needs the same eigenvalue problem on both sides.

Memory is the peak of a fresh process that builds and solves. The profile is cProfile's, libraries counted to the
module that called them; `fosopt.solve.ipopt` is IPOPT with its linear algebra. It slows Python code more than
compiled code."""


def codesign_problem() -> Problem:
    """The problem as fosopt states it."""
    structure = assemble(barker_truss(), "tip")
    inertia = 0.002 * float(structure_inertia(structure, structure.area, structure.batten_mass))
    mirror = Mirror(inertia, MIRROR_FREQUENCY, MIRROR_DAMPING)
    gain = gain_for_crossover(CROSSOVER, mirror, KP, KI, KD, 0.0)
    sizes = structure.area, structure.batten_mass, structure.spring_stiffness
    base = Design(*sizes, MIRROR_MASS, Loop(mirror, PID(gain, KP, KI, KD)))
    system = System(
        structure,
        "tip",
        Hub("held", HUB_BANDWIDTH, HUB_DAMPING),
        Damping((DAMPING,)),
        (
            Disturbance("cooling", "mirror_torque", low_pass(*COOLING)),
            Disturbance("aft_body", "hub_torque", low_pass(*AFT_BODY, order=2)),
            Disturbance("turbulence", "line_of_sight", low_pass(*TURBULENCE)),
            Disturbance("noise", "sensor_noise", high_pass(*NOISE)),
        ),
    )
    area = structure.area
    one_by_one = tuple((i,) for i in range(area.size))
    return Problem(
        system,
        base,
        (
            Variable("area", "area", 0.2 * area, 5 * area, area, groups=one_by_one),
            Variable("inertia", "mirror_inertia", *_around(inertia, 10.0)),
            Variable("kp", "kp", *_around(KP, 10.0)),
            Variable("ki", "ki", *_around(KI, 100.0)),
            Variable("kd", "kd", *_around(KD, 10.0)),
        ),
        (parse_expression("structural_mass"),),
        (
            Constraint(parse_expression("jitter_total"), upper=JITTER_LIMIT),
            Constraint(parse_expression("first_elastic_frequency"), lower=FREQUENCY_LIMIT),
        ),
    )


def _around(value: float, factor: float) -> tuple[Array, Array, Array]:
    return np.array([value / factor]), np.array([value * factor]), np.array([value])


def lyapunov_model(problem: Problem) -> PlainModel:
    """The same numbers for NumPy and SciPy alone."""
    return plain_model(
        Numbers(
            bays=barker.BAYS,
            bay_length=barker.BAY_LENGTH,
            tube_area=barker.TUBE_AREA,
            longeron_stiffness=barker.LONGERON_STIFFNESS,
            diagonal_stiffness=barker.DIAGONAL_STIFFNESS,
            longeron_mass=barker.LONGERON_MASS,
            diagonal_mass=barker.DIAGONAL_MASS,
            batten_mass=barker.BATTEN_MASS,
            batten_inertia=barker.BATTEN_INERTIA,
            mirror_mass=MIRROR_MASS,
            mirror_frequency=MIRROR_FREQUENCY,
            mirror_damping_ratio=MIRROR_DAMPING,
            hub_bandwidth=HUB_BANDWIDTH,
            hub_damping_ratio=HUB_DAMPING,
            damping_ratio=DAMPING,
            gain=float(problem.base.loop.controller.gain),
            mirror_torque=COOLING,
            hub_torque=AFT_BODY,
            line_of_sight=TURBULENCE,
            sensor_noise=NOISE,
        )
    )


def solve_with_fosopt(problem: Problem) -> Solution:
    """One solve from the start, including what IPOPT needs to be built."""
    everything = np.ones(problem.size, dtype=bool)
    task = Task(problem, problem.objectives[0], problem.constraints, everything)
    return solve(NonlinearProgram(task, problem.start), Options())


@dataclass
class FiniteDifferences:
    """The Lyapunov model as SLSQP sees it: logarithmic variables, scaled rows, each point evaluated once.

    Rows are mass over the start's mass, ln(limit/jitter) and frequency over its limit less one.
    """

    model: PlainModel
    start: Array
    evaluations: int = 0

    def __post_init__(self) -> None:
        self._known: tuple[bytes, Array, Array | None] = (b"", np.zeros(0), None)
        self.mass_scale = self.model.structural_mass(self.start)

    def design(self, z: Array) -> Array:
        """Values of all variables."""
        return self.start * np.exp(z)

    def evaluate(self, z: Array) -> Array:
        """The three rows."""
        self.evaluations += 1
        design = self.design(z)
        frequency, jitter = self.model.frequency_and_jitter(design)
        mass = self.model.structural_mass(design)
        # A trial step into an unstable design is sent back by a jitter far beyond the limit.
        jitter = min(jitter, 1e4 * JITTER_LIMIT)
        return np.array(
            [mass / self.mass_scale, np.log(JITTER_LIMIT / jitter), frequency / FREQUENCY_LIMIT - 1]
        )

    def rows(self, z: Array) -> Array:
        """The rows, remembered for the gradient at the same point."""
        if self._known[0] != z.tobytes():
            self._known = (z.tobytes(), self.evaluate(z), None)
        return self._known[1]

    def jacobian(self, z: Array) -> Array:
        """(3, n) Forward differences."""
        here = self.rows(z)
        if self._known[2] is None:
            columns = [(self.evaluate(z + STEP * e) - here) / STEP for e in np.eye(z.size)]
            self._known = (z.tobytes(), here, np.column_stack(columns))
        assert self._known[2] is not None
        return self._known[2]

    def solve(self, lower: Array, upper: Array) -> optimize.OptimizeResult:
        """SLSQP from the start."""
        return optimize.minimize(
            lambda z: self.rows(z)[0],
            np.zeros(self.start.size),
            jac=lambda z: self.jacobian(z)[0],
            bounds=optimize.Bounds(np.log(lower / self.start), np.log(upper / self.start)),
            constraints={
                "type": "ineq",
                "fun": lambda z: self.rows(z)[1:],
                "jac": lambda z: self.jacobian(z)[1:],
            },
            method="SLSQP",
            options={"ftol": SLSQP_TOLERANCE, "maxiter": 300},
        )


def jitter_with_gradient(problem: Problem, x: Array) -> tuple[float, Array]:
    """Jitter and its derivatives for the logarithms of all variables."""
    value, gradient = problem.evaluate(x).metric("jitter_total")
    return value, gradient @ problem.parameter_jacobian(x) * x


def jitter_alone(problem: Problem, x: Array) -> float:
    """Jitter by residues, without derivatives."""
    return float(np.sqrt(sum(variance.value for variance in problem.evaluate(x).variances.values())))


def forward_differences(model: PlainModel, x: Array) -> Array:
    """Derivatives of the jitter for the logarithms of all variables, one more evaluation each."""
    here = model.frequency_and_jitter(x)[1]
    moved = (model.frequency_and_jitter(x * np.exp(STEP * e))[1] for e in np.eye(x.size))
    return np.array([(jitter - here) / STEP for jitter in moved])


def best_differences(model: PlainModel, x: Array) -> Array:
    """The same by fourth-order central differences, each at the step where its neighbors agree best."""

    def moved(e: Array, step: float) -> float:
        return model.frequency_and_jitter(x * np.exp(step * e))[1]

    found = np.array(
        [
            [
                (8 * (moved(e, h) - moved(e, -h)) - (moved(e, 2 * h) - moved(e, -2 * h))) / (12 * h)
                for h in SWEEP
            ]
            for e in np.eye(x.size)
        ]
    )
    apart = np.abs(np.diff(found, axis=1))
    return found[np.arange(x.size), 1 + np.argmin(apart, axis=1)]


def peak_memory() -> float:
    """Largest resident memory of a process that only builds and solves the problem [GiB]."""
    answer = subprocess.run([sys.executable, __file__, "--solve"], check=True, capture_output=True, text=True)
    return float(answer.stdout)


def main() -> None:
    """Measure, print and write the section."""
    memory = peak_memory()
    begin = time.process_time()
    problem = codesign_problem()
    building = time.process_time() - begin
    model = lyapunov_model(problem)

    runs = [common.seconds(lambda: solve_with_fosopt(problem)) for _ in range(REPEATS)]
    differences = FiniteDifferences(model, problem.start)
    begin = time.process_time()
    answer = differences.solve(*problem.bounds)
    slsqp = time.process_time() - begin
    # Half of the runs before and half after, so that both sides see the same machine.
    runs += [common.seconds(lambda: solve_with_fosopt(problem)) for _ in range(REPEATS)]
    ours = float(np.median(runs))
    solution = solve_with_fosopt(problem)
    reference = differences.design(answer.x)
    check(problem, model, solution, reference, answer)

    x = solution.x
    mass = model.structural_mass(reference)
    value, gradient = jitter_with_gradient(problem, x)
    by_residues = common.median_seconds(lambda: jitter_with_gradient(problem, x), 300)
    by_differences = common.median_seconds(lambda: forward_differences(model, x), 7)
    exact = best_differences(model, x)
    scale = float(np.linalg.norm(exact))
    deviation = float(np.abs(gradient - exact).max()) / scale
    rough = float(np.abs(forward_differences(model, x) - exact).max()) / scale
    value_ours = common.median_seconds(lambda: jitter_alone(problem, x), 300)
    value_lyapunov = common.median_seconds(lambda: model.frequency_and_jitter(x), 100)
    value_apart = abs(value / model.frequency_and_jitter(x)[1] - 1)

    bars = solution.objective - model.mass_of_battens
    body = [
        common.table(
            ["", "fosopt", "SciPy", "ratio", "target"],
            [
                ("solve [s]", f"{ours:.3f}", f"{slsqp:.1f}", f"{slsqp / ours:.0f}", "≥ 200"),
                ("iterations", solution.iterations, answer.nit, "", ""),
                (
                    "jitter with 64 derivatives [ms]",
                    f"{1e3 * by_residues:.2f}",
                    f"{1e3 * by_differences:.0f}",
                    f"{by_differences / by_residues:.0f}",
                    "≥ 150",
                ),
                (
                    "jitter alone [ms]",
                    f"{1e3 * value_ours:.2f}",
                    f"{1e3 * value_lyapunov:.2f}",
                    f"{value_lyapunov / value_ours:.1f}",
                    "",
                ),
            ],
        ),
        common.table(
            ["", "value", "target"],
            [
                ("objective, fosopt [kg]", f"{solution.objective:.6f}", ""),
                ("objective, SciPy [kg]", f"{mass:.6f}", ""),
                ("relative difference", f"{mass / solution.objective - 1:.1e}", f"≤ {AGREEMENT:.0e}"),
                ("the same over the mass of the bars alone", f"{(mass - solution.objective) / bars:.1e}", ""),
                ("largest deviation of a derivative", f"{deviation:.1e}", "≤ 1e-6"),
                ("the same, forward differences", f"{rough:.1e}", ""),
                ("relative difference of the jitter", f"{value_apart:.1e}", ""),
                ("peak memory of build and solve [GiB]", f"{memory:.2f}", "< 1"),
                ("building the problem [s]", f"{building:.2f}", ""),
            ],
        ),
        NOTES.format(evaluations=differences.evaluations, repeats=2 * REPEATS),
        common.table(
            ["a solve by module", "share"],
            common.profile_by_module(lambda: solve_with_fosopt(problem)),
        ),
    ]
    text = "\n\n".join(body)
    print(text)
    common.write_section(TITLE, text)


def check(
    problem: Problem, model: PlainModel, solution: Solution, reference: Array, answer: optimize.OptimizeResult
) -> None:
    """Refuse to compare anything but two stable optima of one problem, both limits active."""
    evaluation = problem.evaluate(solution.x)
    jitter = evaluation.value("jitter_total") / JITTER_LIMIT
    frequency = evaluation.value("first_elastic_frequency") / FREQUENCY_LIMIT
    plain_frequency, plain_jitter = model.frequency_and_jitter(reference)
    wanted = {
        "fosopt converged": solution.status == "optimal",
        "SLSQP converged": bool(answer.success),
        "jitter limit active": abs(jitter - 1) < 1e-5 and solution.multipliers[0] > 0,
        "frequency limit active": abs(frequency - 1) < 1e-5 and solution.multipliers[1] < 0,
        "SLSQP meets the limits": plain_jitter < 1.00001 * JITTER_LIMIT
        and plain_frequency > 0.99999 * FREQUENCY_LIMIT,
        "SLSQP stable": model.spectral_abscissa(reference) < 0,
        "same optimum": abs(model.structural_mass(reference) / solution.objective - 1) < AGREEMENT,
    }
    failed = [name for name, holds in wanted.items() if not holds]
    if failed:
        raise SystemExit(f"not comparable: {', '.join(failed)} does not hold")


if __name__ == "__main__":
    common.one_thread()
    if "--solve" in sys.argv:
        solve_with_fosopt(codesign_problem())
        kibibytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(kibibytes / 2**20)
    else:
        main()
