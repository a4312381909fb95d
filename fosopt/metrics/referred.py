"""Disturbances referred to another place of the loop."""

from __future__ import annotations

import numpy as np

from fosopt.control import PID
from fosopt.errors import ModelError
from fosopt.metrics.disturbances import ShapingFilter


def referred_to_sensor(torque: ShapingFilter, controller: PID) -> ShapingFilter:
    """Measurement noise with the effect of a control torque noise: its filter over K(s).    [Barker1991] Fig. 3.10

    A control torque acts on the mirror and reacts on the structure, so that it moves no rigid body; a torque from
    outside acts on one of them.

    Assumes the sensor is on the mirror, where the sign of the noise does not matter.

    Raises
    ------
    ModelError
        If the controller has no integral action: its inverse would not be proper, or no filter at all.
    """
    if controller.rolloff_time or not controller.ki or not controller.kd or controller.path.sections:
        raise ModelError(
            "torque noise referred to the sensor: needs a controller with integral and unfiltered derivative action"
        )
    gains = controller.gain * np.array([controller.kd, controller.kp, controller.ki])
    return ShapingFilter(
        tuple(np.polymul(torque.numerator, [1.0, 0.0])), tuple(np.polymul(torque.denominator, gains))
    )
