"""Mirrors with two axes that the tests share: on random modes, and on a mast that bends in two directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import reference

from fosopt.actuators import Mirror, ReactionMassActuator
from fosopt.control import DIRECT, PID, Loop, SignalPath, SteeredAxis, gain_for_crossover, low_pass_filter
from fosopt.metrics.disturbances import Disturbance, high_pass, low_pass
from fosopt.modes import Damping, Hub, ModalSet
from fosopt.problem import Design, System
from fosopt.structure import Structure, assemble

HZ = 2 * np.pi
PORTS = ("hub", "tip", "hub_y", "tip_y", "mid")
OFF = PID(0.0, 0.0, 0.0, 0.0)

DISTURBANCES = (
    Disturbance("push", "mirror_torque", low_pass(30 * HZ, 1e-3, 2), axis="second"),
    Disturbance("mount", "hub_torque", low_pass(20 * HZ, 1.0, 2), axis="both"),
    Disturbance("air", "line_of_sight", low_pass(8 * HZ, 1e-6), axis="first"),
    Disturbance("noise", "sensor_noise", high_pass(70 * HZ, 1e-8), axis="both"),
)


def on_random_modes(seed: int, actuators: bool = False, modes: int = 6) -> tuple[Loop, ModalSet]:
    """Two loops that a structure of random modes couples; stable."""
    rng = np.random.default_rng(seed)
    frequency, ratio = np.sort(rng.uniform(20, 400, modes)), rng.uniform(0.002, 0.02, modes)
    shapes = 0.8 * rng.normal(size=(modes, len(PORTS)))
    mode_set = ModalSet(frequency, ratio, shapes, PORTS, np.zeros(modes, dtype=bool))
    first, second = (
        Mirror(0.02 * rng.uniform(0.5, 2), 60.0, 0.02),
        Mirror(0.02 * rng.uniform(0.5, 2), 80.0, 0.03),
    )
    path = SignalPath((low_pass_filter(900.0, 2),) if seed % 3 == 0 else ())
    own = PID(2.0, rng.uniform(30, 80), rng.uniform(100, 900), 1.0, 0.0 if seed % 2 else 1e-3, path)
    other = PID(2.4, rng.uniform(30, 80), rng.uniform(100, 900), 1.0, 5e-4)
    hung = (ReactionMassActuator("mid", 0.3, 100.0, 0.1, 2.0),) if actuators else ()
    return Loop(first, own, actuators=hung, beside=SteeredAxis("tip_y", second, other, "hub_y")), mode_set


def set_free(modes: ModalSet) -> ModalSet:
    """The structure with a rigid-body mode that turns all its ports."""
    return ModalSet(
        np.append(0.0, modes.natural_frequency),
        np.append(0.0, modes.damping_ratio),
        np.vstack([np.full((1, len(modes.ports)), 0.1), modes.mode_shape]),
        modes.ports,
        np.append(True, modes.rigid),
    )


def apart(modes: int = 5) -> ModalSet:
    """A structure whose modes move either axis alone, and both alike: every mode twice."""
    rng = np.random.default_rng(11)
    frequency, ratio = np.sort(rng.uniform(20, 400, modes)), rng.uniform(0.002, 0.02, modes)
    shape, still = rng.normal(size=(modes, 2)), np.zeros((modes, 2))
    shapes = np.vstack([np.hstack([shape, still]), np.hstack([still, shape])])
    order = np.argsort(np.tile(frequency, 2), kind="stable")
    return ModalSet(
        np.tile(frequency, 2)[order],
        np.tile(ratio, 2)[order],
        shapes[order],
        PORTS[:4],
        np.zeros(2 * modes, dtype=bool),
    )


def mast(stretch: float = 1.3, bays: int = 2) -> Structure:
    """A mast held at its foot; `stretch` one makes it bend alike in two directions."""
    truss, top = reference.square_mast(bays, stretch), f"B{bays}"
    ports = {"hub": ("B1", "rz"), "tip": (top, "rz"), "hub_y": ("B1", "ry"), "tip_y": (top, "ry")}
    return assemble(replace(truss, ports=ports), "tip")


def on_mast(
    seed: int | None = 1,
    stretch: float = 1.3,
    bays: int = 2,
    path: SignalPath = DIRECT,
    **parts: object,
) -> tuple[System, Design]:
    """Mirror and two loops on the mast; `seed` scatters its bars, which couples the axes.

    Then the second axis has a mirror and a controller of its own, and what `path` adds to it.
    """
    of = mast(stretch, bays)
    given = {"hub": Hub("free"), "damping": Damping((0.01,)), "disturbances": DISTURBANCES} | parts
    system = System(of, "tip", **given, two_axes=True)  # type: ignore[arg-type]
    area = of.area
    if seed is not None:
        area = area * np.random.default_rng(seed).uniform(0.4, 2.0, area.size)
    mirror = Mirror(0.01, 15 * HZ, 0.02)
    terms = {"kp": 600.0, "ki": 5e4, "kd": 1.0, "rolloff_time": 1e-4}
    controller = PID(gain_for_crossover(60 * HZ, mirror, **terms), **terms)
    second = SteeredAxis("tip_y", mirror, controller, "hub_y")
    if seed is not None:
        other = Mirror(0.013, 20 * HZ, 0.03)
        terms |= {"kp": 500.0, "rolloff_time": 2e-4}
        gain = gain_for_crossover(80 * HZ, other, **terms, path=path)
        second = SteeredAxis("tip_y", other, PID(gain, **terms, path=path), "hub_y")
    loop = Loop(mirror, controller, beside=second)
    return system, Design(area, of.batten_mass, of.spring_stiffness, 1.0, loop)


def alone(system: System, design: Design) -> tuple[System, Design]:
    """The first axis of it without the second, as if the mirror had one."""
    first = tuple(replace(d, axis="first") for d in system.disturbances)
    return (
        replace(system, two_axes=False, disturbances=first),
        replace(design, loop=replace(design.loop, beside=None)),
    )
