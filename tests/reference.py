"""Systems the numerical tests share, and the plain numerics they are judged by."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror
from fosopt.control import PID, Loop, gain_for_crossover
from fosopt.metrics.disturbances import Disturbance, high_pass, low_pass
from fosopt.metrics.step import StepCommand
from fosopt.modes import Damping, Hub, ModalFrame, ModalSet, modal_frame
from fosopt.problem import Design, Evaluation, System
from fosopt.structure import (
    Bar,
    Batten,
    Structure,
    Truss,
    assemble,
    barker_truss,
    structure_inertia,
)

Array = NDArray[np.float64]

HZ = 2 * pi
DISSERTATION: dict[str, Any] = tomllib.loads(
    (Path(__file__).parent / "data" / "dissertation.toml").read_text(encoding="utf-8")
)
CHAPTER_4 = DISSERTATION["chapter_4"]
# The mirror weighs 70 % of the whole, 7/3 of the truss (section 2.5).
MIRROR_MASS = DISSERTATION["section_2_2"]["total_mass"] * 7 / 3
HELD = Hub("held", 0.1 * HZ, 0.7)
DAMPING = Damping((CHAPTER_4["structure_damping"],))
PORTS = ("hub", "tip")
STATIONS = tuple(f"r{i}" for i in range(21))

DISTURBANCES = (
    Disturbance("cooling", "mirror_torque", low_pass(8.5 * HZ, 0.02)),
    Disturbance("aft_body", "hub_torque", low_pass(5 * HZ, 1.0, 2)),
    Disturbance("air", "line_of_sight", low_pass(8.5 * HZ, 1e-5)),
    Disturbance("sensor", "sensor_noise", high_pass(70 * HZ, 1e-8)),
)


@cache
def structure(boundary: str = "pinned", bays: int = 20) -> Structure:
    """The dissertation's truss with the mirror's port at its tip."""
    return assemble(barker_truss(boundary, bays), "tip")


def frame(of: Structure, mirror_mass: float = MIRROR_MASS, rotation: str = "tip") -> ModalFrame:
    """Modes at the start design."""
    return modal_frame(of, of.area, of.batten_mass, mirror_mass, rotation)


@cache
def stations() -> ModalFrame:
    """The pinned truss with the mirror's port at its tip and one at every batten, r0 to r20."""
    truss = barker_truss("pinned")
    ports = truss.ports | {name: (f"B{i}", "rz") for i, name in enumerate(STATIONS)}
    return frame(assemble(replace(truss, ports=ports), "tip"))


def inertia_of(of: Structure) -> float:
    """Inertia about the hub at the start design."""
    return float(structure_inertia(of, of.area, of.batten_mass))


def mirror_of(of: Structure, percent: float) -> Mirror:
    """The mirror of chapter 4, its inertia in percent of the structure's about the hub."""
    return Mirror(
        percent / 100 * inertia_of(of), CHAPTER_4["mirror_frequency"] * HZ, CHAPTER_4["mirror_damping"]
    )


def loop_of(mirror: Mirror, rolloff_time: float = 0.0, **gains: float) -> Loop:
    """The controller of chapter 4 on a mirror; `gains` overrides kp, ki or kd."""
    terms = {"kp": CHAPTER_4["kp"], "ki": CHAPTER_4["ki"], "kd": CHAPTER_4["kd"]} | gains
    gain = gain_for_crossover(CHAPTER_4["crossover"] * HZ, mirror, rolloff_time=rolloff_time, **terms)
    return Loop(mirror, PID(gain, rolloff_time=rolloff_time, **terms))


def modes_of(of: Structure, hub: Hub = HELD, damping: Damping = DAMPING) -> ModalSet:
    """All modes at hub and tip at the start design."""
    return frame(of).modal_set(hub, damping, PORTS)


def system_and_design(
    *,
    boundary: str = "pinned",
    bays: int = 20,
    percent: float = 0.2,
    rolloff_time: float = 1e-4,
    seed: int | None = None,
    mirror_mass: float = MIRROR_MASS,
    loop: Loop | None = None,
    **parts: Any,
) -> tuple[System, Design]:
    """The reference system with a disturbance at each input; `seed` scatters its members."""
    of = structure(boundary, bays)
    given = {
        "hub": HELD,
        "damping": DAMPING,
        "disturbances": DISTURBANCES,
        "step": StepCommand(1e-6, (0.05, 0.1)),
    }
    system = System(of, "tip", **(given | parts))
    if loop is None:
        loop = loop_of(mirror_of(of, percent), rolloff_time)
    area, batten_mass, spring_stiffness = of.area, of.batten_mass, of.spring_stiffness
    if seed is not None:
        rng = np.random.default_rng(seed)
        area = area * rng.uniform(0.5, 2.0, area.size)
        batten_mass = batten_mass * rng.uniform(0.8, 1.2, batten_mass.size)
        spring_stiffness = spring_stiffness * rng.uniform(0.5, 2.0, spring_stiffness.size)
    return system, Design(area, batten_mass, spring_stiffness, mirror_mass, loop)


def evaluation(**options: Any) -> Evaluation:
    """Evaluation of the reference system."""
    return Evaluation(*system_and_design(**options))


def square_mast(bays: int = 3, stretch: float = 1.0) -> Truss:
    """A spatial mast; at `stretch` one its section is square and it bends alike in two directions."""
    nodes, battens, bars = {}, [], []
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    for i in range(bays + 1):
        for j, (y, z) in enumerate(corners):
            nodes[f"N{i}{j}"] = (0.5 * i, 0.2 * stretch * y, 0.2 * z)
        battens.append(Batten(f"B{i}", tuple(f"N{i}{j}" for j in range(4)), 2.0, (0.1, 0.06, 0.06)))
    for i in range(1, bays + 1):
        for j in range(4):
            k = (j + 1) % 4
            for name, ends in (
                ("L", (f"N{i - 1}{j}", f"N{i}{j}")),
                ("D", (f"N{i - 1}{j}", f"N{i}{k}")),
                ("E", (f"N{i - 1}{k}", f"N{i}{j}")),
            ):
                bars.append(Bar(f"{name}{i}{j}", ends, 1e-4, 70e9, 2700.0))
    held = ("x", "y", "z", "rx", "ry", "rz")
    ports = {"hub": ("B0", "rz"), "tip": (f"B{bays}", "rz"), "skew": (f"B{bays}", "ry")}
    return Truss(nodes, tuple(bars), ports, {"B0": held}, tuple(battens))


def benchmark(case: int | None) -> tuple[Loop, ModalSet]:
    """The modified benchmark problem of chapter 3, case 1 to 4, or rigidly supported for None.

    Two equal masses on a spring; the actuated mass pushes against the second. Masses stand for inertias.
    """
    given = DISSERTATION["chapter_3"]
    mirror = Mirror(given["actuated_mass"], given["actuator_frequency"] * HZ, given["zeta_actuator"])
    loop = Loop(mirror, PID(given["gain"], given["kp"], given["ki"], given["kd"]))
    if case is None:
        # A structure too heavy to move.
        return loop, ModalSet(
            np.array([HZ]), np.array([0.1]), np.full((1, 2), 1e-12), PORTS, np.zeros(1, bool)
        )
    shape = np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2 * given["end_mass"])
    frequency = np.array([0.0, given["structure_frequency"][case - 1] * HZ])
    ratio = np.array([0.0, given["zeta_structure"]])
    return loop, ModalSet(frequency, ratio, shape, PORTS, np.array([True, False]))


def random_loop(rng: np.random.Generator, modes: int = 6, **pid: float) -> tuple[Loop, ModalSet]:
    """A mirror with a controller on a structure of random modes; stable or not."""
    frequency = np.sort(10 ** rng.uniform(0, 3.5, modes))
    shape = rng.normal(size=(modes, 2)) * 10 ** rng.uniform(-3, 0.5, (modes, 1))
    mode_set = ModalSet(
        frequency, 10 ** rng.uniform(-4, -1, modes), shape, PORTS, np.zeros(modes, dtype=bool)
    )
    mirror = Mirror(10 ** rng.uniform(-3, 1), 10 ** rng.uniform(1, 3), 10 ** rng.uniform(-3, -1))
    terms = {
        "kp": 10 ** rng.uniform(1, 3),
        "ki": 10 ** rng.uniform(2, 5),
        "kd": 1.0,
        "rolloff_time": 0.0,
    } | pid
    gain = gain_for_crossover(10 ** rng.uniform(1.5, 3.5), mirror, **terms)
    return Loop(mirror, PID(gain, **terms)), mode_set


def plateau(f: Callable[[float], Array], steps: Sequence[float]) -> tuple[Array, Array]:
    """Derivative of `f` at zero by fourth-order central differences, with the error it admits.

    Truncation falls and rounding grows as the step shrinks. Of two neighboring steps that agree best, the
    first is the estimate and their difference its error.
    """
    estimates = np.array([(8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h) for h in steps])
    change = np.abs(np.diff(estimates, axis=0))
    best = np.argmin(change, axis=0)
    at = np.arange(estimates.shape[1])
    return estimates[best, at], change[best, at]


def worst_match(found: Array, expected: Array) -> float:
    """Largest distance from one of two sets of poles to the nearest of the other, relative to the pole."""
    apart = np.abs(found[:, None] - expected)
    return float(max((apart.min(axis=0) / np.abs(expected)).max(), (apart.min(axis=1) / np.abs(found)).max()))
