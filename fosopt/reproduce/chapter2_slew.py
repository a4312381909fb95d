"""Chapter 2, rigid-body slew of the support structure under a shaped torque: figures 2.27 and 2.28."""

from __future__ import annotations

from functools import cache

import numpy as np

from fosopt.control import structure_state_space
from fosopt.control.time_response import time_response
from fosopt.ops import Array
from fosopt.reproduce import chapter2_system as system
from fosopt.reproduce.entry import Comparison, Curve, Entry, Panel, Reproduction
from fosopt.reproduce.judge import judged

STATIONS = ("y20", "y15", "y10", "y5")

# Assumed: the profile and its size. Two trapezoids of opposite sign turn the truss from rest to rest, and are short
# enough to leave it ringing in its first bending mode.
TORQUE, RISE, DURATION = 100.0, 0.05, 0.5  # [N m], [s], [s]
SHOWN, STEP = 1.0, 1e-3  # [s]; the corners of the profile fall on samples, so that the response is exact
_PROFILE = (
    f"two trapezoids of ±{TORQUE:g} N m, {DURATION:g} s together with rises of {RISE:g} s (profile and size were "
    "published as a picture only)"
)


@cache
def slew() -> tuple[Array, Array, Array]:
    """Time [s], hub torque [N m] and lateral motion [m] at the four stations of Model#1 with a free hub."""
    time = np.linspace(0.0, SHOWN, round(SHOWN / STEP) + 1)
    half = DURATION / 2
    corners = (0.0, RISE, half - RISE, half + RISE, DURATION - RISE, DURATION)
    torque: Array = TORQUE * np.interp(time, corners, (0.0, 1.0, 1.0, -1.0, -1.0, 0.0))
    alone = structure_state_space(system.support(), ("hub", *STATIONS))
    return time, torque, time_response(alone, "hub", torque, STEP, STATIONS)


def figure_2_27() -> Reproduction:
    """Lateral motion during a slew."""
    time, _, motion = slew()
    swing = np.ptp(motion[time >= DURATION], axis=0)
    modes = system.support()
    first_bending = np.array([modes.at(station)[1] for station in STATIONS])
    stillest = [STATIONS[int(np.argmin(np.abs(values)))] for values in (swing, first_bending)]
    shares = [f"{name} {of / swing[0]:.3f}" for name, of in zip(STATIONS, swing, strict=True)]
    shape = first_bending[1] / first_bending[0]
    return judged(
        f"Lateral motion of Model#1 with a free hub under {_PROFILE}, exact for this piecewise linear torque.",
        (
            Comparison(
                "station of least oscillation after the slew",
                "y15",
                stillest[0],
                "",
                f"swing over that of the tip: {', '.join(shares)}",
            ),
            Comparison(
                "station that hardly senses the first bending mode",
                "y15",
                stillest[1],
                "",
                f"its shape there over that at the tip: {shape:.4f}; the text calls this node an anti-node",
            ),
        ),
        (
            Panel(
                "Time [s]",
                "Lateral motion [mm]",
                tuple(
                    Curve(time, 1e3 * y, f"y_{{{name[1:]}}}")
                    for name, y in zip(STATIONS, motion.T, strict=True)
                ),
                wide=True,
            ),
        ),
    )


def figure_2_28() -> Reproduction:
    """The torque of the slew."""
    time, torque, _ = slew()
    return judged(
        f"The hub torque behind figure 2.27: {_PROFILE}.",
        (),
        (Panel("Time [s]", "Hub torque [N m]", (Curve(time, torque),), wide=True),),
        open_because="the profile was published as a picture only and is assumed here",
    )


ENTRIES = (
    Entry("figure-2.27", "Slew response of the support structure, Model#1", figure_2_27),
    Entry("figure-2.28", "Shaped torque command", figure_2_28),
)
