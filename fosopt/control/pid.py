"""The line-of-sight controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fosopt.actuators import Mirror
from fosopt.ops import sqrt


@dataclass(frozen=True)
class PID:
    """PID controller K(s) = gain (k_d s² + k_p s + k_i)/s.    [Barker1991] Eq. (3.25)

    Attributes
    ----------
    gain, kp, ki, kd
        The product gain k_p is in [N m/rad], gain k_i in [N m/(rad s)], gain k_d in [N m s/rad].
    rolloff_time
        Time constant of a first-order low pass on the derivative term, zero for none [s].
    """

    gain: Any
    kp: Any
    ki: Any
    kd: Any
    rolloff_time: Any = 0.0


def pid_response(controller: PID, s: Any) -> Any:
    """K(s), torque per line-of-sight error [N m/rad].    [Barker1991] Eq. (3.25)"""
    derivative = controller.kd * s / (1 + controller.rolloff_time * s)
    return controller.gain * (controller.kp + controller.ki / s + derivative)


def gain_for_crossover(crossover: Any, mirror: Mirror, kp: Any, ki: Any, kd: Any, rolloff_time: Any) -> Any:
    """Gain at which the loop of the rigidly supported mirror crosses unity.    [Barker1991] Sec. 4.4

    Solves |G(jω) K(jω)| = 1 with G of Eq. (2.41), in real arithmetic so that one text serves numbers and symbols.

    Parameters
    ----------
    crossover
        ω [rad/s].
    """
    w, wm = crossover, mirror.natural_frequency
    spring = mirror.inertia * (wm**2 - w**2)
    damper = mirror.damping * w
    # j w / (1 + j w T) = (w² T + j w) / (1 + w² T²)
    low_pass = 1 + (w * rolloff_time) ** 2
    real = kp + kd * w**2 * rolloff_time / low_pass
    imag = kd * w / low_pass - ki / w
    return sqrt(spring**2 + damper**2) / sqrt(real**2 + imag**2)
