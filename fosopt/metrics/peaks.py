"""What a retargeting sequence asks of the mirror: largest stroke, rate and torque."""

from __future__ import annotations

from math import inf, prod

import numpy as np

from fosopt.control import PID, ClosedLoopPoles
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import pole_residues
from fosopt.metrics.sequence import Retargeting, repeated
from fosopt.metrics.transient import Transient

PEAKS = ("peak_stroke", "peak_rate", "peak_torque")


def peaks(model: LoopModel, poles: ClosedLoopPoles, retargeting: Retargeting) -> dict[str, float]:
    """Largest size of stroke [rad], its rate [rad/s] and the control torque [N m] over a sequence.

    Stroke is the mirror's angle against the port it is mounted on. The torque of a controller whose derivative does not
    roll off is infinite at a step. Peaks between samples are missed by 0.12 % at most.

    Raises
    ------
    UnstableError
        If the loop is unstable.
    """
    poles.refuse_unstable()
    found = {}
    for name, after in _steps(model, poles).items():
        if after is None:
            found[f"peak_{name}"] = inf
            continue
        parts = repeated(after, retargeting)
        found[f"peak_{name}"] = max(part.largest(0.0, retargeting.period) for part in parts)
    return found


def _steps(model: LoopModel, poles: ClosedLoopPoles) -> dict[str, Transient | None]:
    """What a unit step leaves of each, None where it is infinite."""
    stroke = poles.multiplicity * pole_residues(model, poles, "stroke") / poles.value
    torque = poles.multiplicity * pole_residues(model, poles, "torque") / poles.value
    at_once = torque_at_once(model.loop.controller)
    steady = at_once - float(torque.real.sum())
    return {
        "stroke": Transient(-float(stroke.real.sum()), stroke, poles.value),
        "rate": Transient(0.0, stroke * poles.value, poles.value),
        "torque": Transient(steady, torque, poles.value) if np.isfinite(at_once) else None,
    }


def torque_at_once(pid: PID) -> float:
    """Torque as a unit step begins, the controller's response at infinite frequency [N m/rad]."""
    sections = pid.path.on_error
    degree = sum(section.relative_degree for section in sections)
    lead = float(pid.gain) * prod(section.numerator[0] / section.denominator[0] for section in sections)
    if pid.kd and not pid.lag:
        return inf if degree == 0 else lead * float(pid.kd) if degree == 1 else 0.0
    derivative = float(pid.kd) / float(pid.lag) if pid.kd else 0.0
    return lead * (float(pid.kp) + derivative) if degree == 0 else 0.0
