"""Chapter 2, actuators alone and on the reduced structure: figures 2.11, 2.12 and 2.33 to 2.37."""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from fosopt.actuators import proof_mass_force
from fosopt.control import PID, Loop, Receptances, plant_impedance
from fosopt.control.leakage import LEAKAGE, with_torque_leakage
from fosopt.control.time_response import time_response
from fosopt.ops import Array
from fosopt.reproduce import chapter2_system as system
from fosopt.reproduce.bode import bode_panels, resolved_response
from fosopt.reproduce.entry import Comparison, Curve, Entry, Panel, Reproduction
from fosopt.reproduce.judge import claim, judged
from fosopt.units import HZ

_RANGE = (0.2, 200.0)  # drawn [Hz]
_ENDS = {"y10": "mid-span", "y20": "tip"}
_ASSUMED = (
    f"Assumed: a proof mass of {100 * system.ACTUATOR_SHARE:g} % of the truss at {system.ACTUATOR_HZ:g} Hz with "
    f"{100 * system.ACTUATOR_DAMPING:g} % damping, and a mirror inertia of {system.MIRROR_PERCENT:g} %."
)
_STEP, _LENGTH = 5e-4, 1.0  # of the mirror's step responses [s]


def figure_2_11() -> Reproduction:
    """A reaction-mass actuator on a rigid support."""
    of = system.actuator("y20")
    body = of.suspended
    poles = np.roots([body.inertia, body.damping, body.stiffness]).astype(complex)
    force = resolved_response("", partial(proof_mass_force, of), np.zeros(2, complex), poles, *_RANGE)
    return judged(
        f"Total force per interaction force, that is Eq. (2.37) over its gain. {_ASSUMED}",
        (),
        bode_panels([force], "N/N"),
        open_because="gain, frequency and damping of the actuator were published as a picture only",
    )


def figure_2_12() -> Reproduction:
    """The mirror on a rigid support."""
    of = system.mirror()
    loop = Loop(of, PID(0.0, 0.0, 0.0, 0.0))
    rigid = Receptances(0.0, 0.0)
    poles = np.roots([of.inertia, of.damping, of.stiffness]).astype(complex)
    angle = resolved_response(
        "", lambda s: 1 / plant_impedance(loop, s, rigid), np.zeros(0, complex), poles, 0.5, 1000.0
    )
    return judged(
        f"Angle per torque of the electromagnetic mirror, Eq. (2.41), at {system.ELECTROMAGNETIC:g} Hz, with "
        f"{system.MIRROR_PERCENT:g} % of the truss's inertia and {100 * system.MIRROR_DAMPING:g} % damping.",
        (),
        bode_panels([angle], "rad/(N m)"),
        open_because="inertia and damping of the mirror were published as a picture only",
    )


def figure_2_33() -> Reproduction:
    """Mirror transfer function with an actuator at the tip."""
    ways = {"no actuator": (), "at the tip": (system.actuator("y20"),)}
    built = {name: system.OpticalSystem(system.mirror(), each) for name, each in ways.items()}
    before, after = (np.sort(of.poles.imag[of.poles.imag > 0]) for of in built.values())
    # The actuator's own resonance is the lowest.
    shift = float(np.abs(after[1:] / before - 1).max())
    return judged(
        f"Model#3 with a 20 Hz mirror, beside Model#2. {_ASSUMED}",
        (Comparison("largest relative shift of a pole by the actuator", None, shift),),
        bode_panels([of.response(name, "mirror", *_RANGE) for name, of in built.items()], "rad/(N m)"),
    )


def separation(port: str, times: float, *, massless: bool = False) -> Array:
    """|ω_k/Ω_k − 1| of the system's flexible modes in an actuator's rate per force.

    The actuator's own resonance, the lowest, has no zero of its own.
    """
    of = system.OpticalSystem(system.mirror(), (system.actuator(port, times),), massless=massless)
    poles, zeros = (np.sort(r.imag[r.imag > 0]) for r in (of.poles, of.zeros("actuator")))
    apart: Array = np.abs(poles[poles.size - zeros.size :] / zeros - 1)
    return apart


def actuator_responses(times: float) -> Reproduction:
    """Relative rate per force of an actuator at mid-span and at the tip."""
    largest, light = (
        {port: float(separation(port, times, massless=m).max()) for port in _ENDS} for m in (False, True)
    )
    mirror = system.mirror()
    columns = [
        bode_panels(
            [system.OpticalSystem(mirror, (system.actuator(port, times),)).response("", "actuator", *_RANGE)],
            "(m/s)/N",
            f"Actuator at {'the ' if name == 'tip' else ''}{name}",
            wide=False,
        )
        for port, name in _ENDS.items()
    ]
    return judged(
        f"Model#3 with a 20 Hz mirror and an actuator of {times:g} times the assumed mass. {_ASSUMED}",
        (
            claim(
                "which actuator interacts more with the flexible modes",
                "mid-span, the tip one hardly",
                largest["y10"] > largest["y20"],
                "the tip one",
                f"largest pole-zero separation |β − 1|: {_named(largest)}",
            ),
            claim(
                "why the tip one hardly does",
                "the heavy mirror at the tip",
                light["y20"] > light["y10"],
                "not the mirror's mass",
                f"the same without the mirror's mass: {_named(light)}",
            ),
        ),
        [panel for row in zip(*columns, strict=True) for panel in row],
        2,
    )


def _named(values: dict[str, float]) -> str:
    return ", ".join(f"{values[port]:.2g} ({name})" for port, name in _ENDS.items())


@cache
def step_response(reactionless: bool) -> tuple[Array, Array]:
    """Time [s], and angles [rad] and torque leakage [N m] after a control torque of 1 N m on Model#4."""
    mirror = system.mirror(reaction_mass=system.REACTION_MASS if reactionless else None)
    of = system.OpticalSystem(mirror, (system.actuator("y20"), system.actuator("y10")))
    names = ("mirror_angle", *(("reaction_mass_angle",) if reactionless else ()), LEAKAGE)
    time = np.linspace(0.0, _LENGTH, round(_LENGTH / _STEP) + 1)
    plant = with_torque_leakage(of.state_space, mirror)
    return time, time_response(plant, "control_torque", np.ones(time.size), _STEP, names)


def figure_2_36() -> Reproduction:
    """Step response of the mirror."""
    time, response = step_response(False)
    return judged(
        f"Inertial mirror angle of Model#4 after a step of 1 N m in mirror torque, exact at the samples. {_ASSUMED}",
        (),
        (Panel("Time [s]", "Mirror angle [µrad]", (Curve(time, 1e6 * response[:, 0]),), wide=True),),
    )


def figure_2_37() -> Reproduction:
    """Step response of a reactionless mirror and its reaction mass."""
    time, response = step_response(True)
    alone = step_response(False)[1][:, -1]
    shares = system.REACTION_MASS
    mirror = system.mirror(reaction_mass=shares)
    frequencies = [
        mirror.natural_frequency / HZ * r
        for r in (1.0, (shares.stiffness_ratio / shares.inertia_ratio) ** 0.5)
    ]
    leaks = response[:, -1]
    return judged(
        f"Model#4 with a reaction mass behind the mirror, after a step of 1 N m in mirror torque: torque ratio "
        f"{shares.torque_ratio:.2f}, inertia ratio {shares.inertia_ratio:.2f} (that the reaction mass is the "
        f"lighter one is assumed), springs alike (assumed). {_ASSUMED}",
        (
            Comparison(
                "frequencies of mirror and reaction mass on a rigid support",
                None,
                ", ".join(f"{f:.2f}" for f in frequencies),
                "Hz",
                "closely spaced, apart by the mismatch as section 2.4.2 says",
            ),
            Comparison(
                "torque leakage as the step begins",
                None,
                float(leaks[0]),
                "N m",
                "without a reaction mass 1 N m",
            ),
            Comparison(
                "largest torque leakage over that without a reaction mass",
                None,
                float(np.abs(leaks).max() / np.abs(alone).max()),
            ),
        ),
        (
            Panel(
                "Time [s]",
                "Angle [µrad]",
                (
                    Curve(time, 1e6 * response[:, 0], "mirror"),
                    Curve(time, 1e6 * response[:, 1], "reaction mass", "dashed"),
                ),
                wide=True,
            ),
            Panel(
                "Time [s]",
                "Torque leakage [N m]",
                (Curve(time, leaks, "reactionless"), Curve(time, alone, "without reaction mass", "dotted")),
                wide=True,
            ),
        ),
    )


ENTRIES = (
    Entry("figure-2.11", "Force of a reaction-mass actuator on a rigid support", figure_2_11),
    Entry("figure-2.12", "Angle of the fast steering mirror on a rigid support", figure_2_12),
    Entry("figure-2.33", "Mirror angle per mirror torque, actuator at the tip, Model#3", figure_2_33),
    Entry(
        "figure-2.34",
        "Relative rate per force of an actuator at mid-span and at the tip, Model#3",
        partial(actuator_responses, 1.0),
    ),
    Entry(
        "figure-2.35",
        "Relative rate per force of an actuator of ten times the mass, Model#3",
        partial(actuator_responses, 10.0),
    ),
    Entry("figure-2.36", "Mirror angle after a step in mirror torque, Model#4", figure_2_36),
    Entry("figure-2.37", "Mirror and reaction mass after a step in mirror torque, Model#4", figure_2_37),
)
