"""Small co-design problems the tests of the optimization share."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from reference import HELD, HZ, mirror_of, structure

from fosopt.actuators import Mirror
from fosopt.control import PID, Loop, gain_for_crossover
from fosopt.expressions import parse_expression
from fosopt.metrics.disturbances import Disturbance, high_pass, low_pass, white
from fosopt.modes import Damping, Hub
from fosopt.problem import Constraint, Definitions, Design, Problem, System, Variable
from fosopt.solve import Goal, Options, everything_free
from fosopt.structure import Bar, Batten, Spring, Truss, assemble

Array = NDArray[np.float64]

DISTURBANCES = (
    Disturbance("aft_body", "hub_torque", low_pass(10 * HZ, 150.0, 2)),
    Disturbance("noise", "sensor_noise", high_pass(70 * HZ, 2e-7)),
)
KINDS = ("longeron", "diagonal")


def variable(name: str, lower: Any, upper: Any, start: Any, quantity: str = "", **parts: Any) -> Variable:
    """A variable from plain numbers; its quantity is its name unless given."""
    bounds = (np.atleast_1d(np.array(value, dtype=float)) for value in (lower, upper, start))
    return Variable(name, quantity or name, *bounds, **parts)


def limit(text: str, lower: float = -inf, upper: float = inf) -> Constraint:
    """A constraint from text."""
    return Constraint(parse_expression(text), lower, upper)


def expressions(*texts: str) -> tuple[Any, ...]:
    """Expressions from text."""
    return tuple(parse_expression(text) for text in texts)


def areas_by_kind(of: Any, lower: float = 13e-6, upper: float = 330e-6, **parts: Any) -> Variable:
    """Areas of the dissertation's truss, one for the longerons and one for the diagonals."""
    groups = tuple(tuple(i for i, bar in enumerate(of.truss.bars) if bar.kind == kind) for kind in KINDS)
    start = [float(of.area[list(group)].mean()) for group in groups]
    return variable("area", [lower] * 2, [upper] * 2, start, groups=groups, labels=KINDS, **parts)


def truss_problem(
    objectives: Sequence[str] = ("structural_mass", "jitter_total"),
    constraints: Sequence[Constraint] = (),
    *,
    bays: int = 3,
    percent: float = 0.2,
    crossover: float = 100 * HZ,
    damping: float = 0.002,
    log: bool = True,
    disturbances: tuple[Disturbance, ...] = DISTURBANCES,
    **parts: Any,
) -> Problem:
    """The quickstart on a short truss: two areas, crossover, kp and ki."""
    of = structure("pinned", bays)
    mirror = mirror_of(of, percent)
    gain = float(gain_for_crossover(crossover, mirror, 600.0, 50e3, 1.0, 0.0))
    system = System(of, "tip", HELD, Damping((damping,)), disturbances, **parts)
    loop = Loop(mirror, PID(gain, 600.0, 50e3, 1.0))
    base = Design(of.area, of.batten_mass, of.spring_stiffness, 7 / 3 * 108.3, loop)
    variables = (
        areas_by_kind(of, log=log),
        variable("crossover", 20 * HZ, 500 * HZ, crossover, log=log),
        variable("kp", 10, 6000, 600, log=log),
        variable("ki", 100, 5e6, 50e3, log=log),
    )
    return Problem(
        system,
        base,
        variables,
        expressions(*objectives),
        tuple(constraints),
        Definitions(inertia_ratio=percent / 100, crossover=crossover),
    )


def goal(problem: Problem, objective: int = 0, *more: Constraint, free: Sequence[str] | None = None) -> Goal:
    """One objective of a problem under its constraints and more; all variables free unless named."""
    mask = everything_free(problem)
    if free is not None:
        mask[:] = False
        for name in free:
            mask[problem.slices()[name]] = True
    return Goal(problem, problem.objectives[objective], (*problem.constraints, *more), mask)


TIGHT = Options(tolerance=1e-9)
# An objective is flat at its optimum: a scaled KKT residual of 1e-9 leaves its square, and constraints 1e-9.
AT_OPTIMUM = 1e-7
# Points on the way to a flat optimum: the root of that.
POINT = 1e-4
# What the strategies may differ by at the same local optimum.
SAME = 1e-4


def mass_limited(kilograms: float = 20.0, **options: Any) -> Problem:
    """Least jitter of a short truss under a mass limit."""
    constraints = (limit("structural_mass", upper=kilograms), limit("modulus_margin", lower=0.5))
    return truss_problem(("jitter_total",), constraints, **options)


# Of the rod and the mirror on it.
YOUNG, DENSITY, LENGTH, TIP_MASS, MIRROR_MASS = 70e9, 2700.0, 1.0, 2.0, 3.0
MIRROR_INERTIA, MIRROR_FREQUENCY = 0.5, 1.0
TORQUE_INTENSITY, NOISE_INTENSITY = 1e-4, 1e-10  # two-sided [(N m)² s], [rad² s]


def rod_problem(bound: float = 1000.0, log: bool = True, objective: str = "structural_mass") -> Problem:
    """A rod that carries a mirror on a tip too heavy to turn: least mass and least jitter in closed form."""
    # Turns at 5000 rad/s, above the axial mode; ten orders heavier than the mirror.
    inertia = 1e10 * MIRROR_INERTIA
    truss = Truss(
        {"A": (0.0, 0.0), "B": (LENGTH, 0.0)},
        (Bar("rod", ("A", "B"), 1e-4, YOUNG, DENSITY),),
        {"hub": ("H", "rz"), "tip": ("T", "rz")},
        {"H": ("x", "y", "rz"), "T": ("y",)},
        (Batten("H", ("A",), 1.0, 1.0), Batten("T", ("B",), TIP_MASS, inertia)),
        springs=(Spring("T", "rz", inertia * 5000.0**2),),
    )
    of = assemble(truss, "tip")
    disturbances = (
        Disturbance("torque", "mirror_torque", white(sqrt(2 * TORQUE_INTENSITY))),
        Disturbance("noise", "sensor_noise", white(sqrt(2 * NOISE_INTENSITY))),
    )
    loop = Loop(Mirror(MIRROR_INERTIA, MIRROR_FREQUENCY, 0.0), PID(200.0, 10.0, 0.0, 1.0))
    return Problem(
        System(of, "tip", Hub("fixed"), Damping((0.01,)), disturbances),
        Design(of.area, of.batten_mass, of.spring_stiffness, MIRROR_MASS, loop),
        (
            variable("area", 1e-5, 1e-3, 1e-4, groups=((0,),), labels=("rod",), log=log),
            variable("gain", 1, 1e5, 200, log=log),
            variable("kp", 0.1, 1e4, 10, log=log),
        ),
        expressions(objective),
        (limit("first_elastic_frequency", lower=bound),),
    )


def least_rod_area(bound: float) -> float:
    """Area at which ω² (m + ρ a L/3) = E a/L."""
    mass = TIP_MASS + MIRROR_MASS
    return bound**2 * mass / (YOUNG / LENGTH - bound**2 * DENSITY * LENGTH / 3)


def rod_mass_slope(bound: float) -> float:
    """Derivative of the least mass for the bound on the frequency [kg s/rad]."""
    mass = TIP_MASS + MIRROR_MASS
    specific = YOUNG / LENGTH
    return DENSITY * LENGTH * 2 * bound * mass * specific / (specific - bound**2 * DENSITY * LENGTH / 3) ** 2


def least_jitter() -> tuple[float, float, float]:
    """Gain, kp and rms of the mirror loop that best trades torque against sensor noise, both white.

    With k = k_m + gain kp and c = gain the variance is W/(2 c k) + N ((k − k_m)²/(2 c k) + c/(2 J)); it is least
    where k² = W/N + k_m² and c² = 2 J (k − k_m).
    """
    spring = MIRROR_INERTIA * MIRROR_FREQUENCY**2
    k = sqrt(TORQUE_INTENSITY / NOISE_INTENSITY + spring**2)
    c = sqrt(2 * MIRROR_INERTIA * (k - spring))
    return c, (k - spring) / c, sqrt(NOISE_INTENSITY * c / MIRROR_INERTIA)
