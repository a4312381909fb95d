"""Proof that a box of PID gains holds no stabilizing controller.

A circle in the closed right half plane that holds a zero of Δ for the gains in the middle holds one for all gains of
the box if these change Δ on the circle by less than its size there: Rouché's theorem. Other modes may cross the
imaginary axis meanwhile; one that stays unstable is enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fosopt.control import PID, characteristic, closed_loop_poles
from fosopt.control.loop import sensor_gain
from fosopt.errors import SolverError
from fosopt.metrics.functional import LoopModel
from fosopt.ops import Array, ComplexArray, Dual

_POINTS = 32
_CIRCLE = np.exp(2j * np.pi * np.arange(_POINTS) / _POINTS)
# Circles are tangent to the imaginary axis; their radius over the real part of the pole.
_RADII = (1.0, 3.0, 10.0, 30.0)
_POLES = 2  # how many unstable poles are tried
# Δ departs from its chord by an eighth of the second difference, and this many times that is allowed for.
_SAFETY = 2.0


@dataclass(frozen=True)
class Verdict:
    """What is known of a box of gains.

    Attributes
    ----------
    hopeless
        Whether every controller in it is proved to be unstable.
    stable
        Whether the one in the middle is stable.
    """

    hopeless: bool
    stable: bool


def judge(model: LoopModel, low: Array, high: Array, rolloff_time: float) -> Verdict:
    """Look for an unstable pole that all controllers between (3,) absolute gains share."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    kp, ki, kd = (float(gain) for gain in middle)
    loop = replace(model.loop, controller=PID(1.0, kp, ki, kd, rolloff_time))
    here = LoopModel(loop, model.modes, model.mirror_port)
    try:
        poles = closed_loop_poles(loop, model.modes, model.mirror_port)
    except SolverError:
        return Verdict(False, False)
    value = poles.value
    unstable = np.flatnonzero(value.real > 0)
    if not unstable.size:
        return Verdict(False, poles.spectral_abscissa < 0)
    g = poles.receptances()
    delta = characteristic(loop, Dual(value, 1.0), g)
    sensor = sensor_gain(loop, Dual(value, 1.0), g)
    reach = np.abs(sensor.value if isinstance(sensor, Dual) else sensor)
    # How far the box can push each pole, in first order.
    push = reach * _controller_change(value, half, rolloff_time) / np.abs(delta.slope)
    with np.errstate(divide="ignore"):
        firmness = (value.real / push)[unstable]
    for k in np.argsort(-firmness)[:_POLES]:
        pole = value[unstable[k]]
        nearest = poles.open_loop.first[np.argmin(np.abs(poles.open_loop.first - pole))]
        if firmness[k] > 1 and _shared(here, pole, nearest, half, rolloff_time):
            return Verdict(True, False)
    return Verdict(False, False)


def _controller_change(s: ComplexArray, half: Array, rolloff_time: float) -> Array:
    """(m,) Largest change of K within the box."""
    return half[0] + half[1] / np.abs(s) + half[2] * np.abs(s / (1 + rolloff_time * s))


def _shared(model: LoopModel, pole: complex, nearest: complex, half: Array, rolloff_time: float) -> bool:
    """Whether a circle about an unstable pole of the middle holds one for all gains.

    Δ has poles where the open loop has some, just left of the axis. Without the nearest one it is smoother.
    """
    for radius in _RADII:
        size = radius * pole.real
        s = size + 1j * pole.imag + size * _CIRCLE * (1 - 1e-12)
        g = model.points(s).g
        value = characteristic(model.loop, s, g)
        change = np.abs(sensor_gain(model.loop, s, g)) * _controller_change(s, half, rolloff_time)
        if encircles(value, change) or encircles(value * (s - nearest), change * np.abs(s - nearest)):
            return True
    return False


def encircles(value: ComplexArray, change: Array) -> bool:
    """Whether a closed curve goes around zero counterclockwise, and so does every other within `change` of it.

    Parameters
    ----------
    value, change
        (m,) points along the curve, and how far another one may be from each.
    """
    following = np.roll(value, -1)
    chord = following - value
    bend = np.abs(np.roll(value, 1) - 2 * value + following)
    # Points that coincide leave no direction, and no answer.
    with np.errstate(divide="ignore", invalid="ignore"):
        foot = np.clip(-(chord.conj() * value).real / np.abs(chord) ** 2, 0.0, 1.0)
    distance = np.abs(value + foot * chord)
    needed = np.maximum(change, np.roll(change, -1)) + _SAFETY / 8 * np.maximum(bend, np.roll(bend, -1))
    return bool(np.all(distance > needed) and np.angle(following / value).sum() > np.pi)
