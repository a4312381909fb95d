"""Retargeting: a sequence of step commands at a fixed period, and what is left of each in its rms window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fosopt.control import ClosedLoopPoles
from fosopt.errors import ModelError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.transient import Transient, step_error
from fosopt.ops import Array


@dataclass(frozen=True)
class Retargeting:
    """A sequence of engagements: each a step, time to settle, and time to dwell.

    [Barker1991] Sec. 3.3.1, Table 3.1

    Attributes
    ----------
    command
        Size of each step [rad].
    settling_time, dwell_time
        t_RMS and t_DWELL; together the period [s].
    count
        Number of engagements.
    pattern
        A square wave goes out and back in turn, a staircase always on.
    """

    command: float
    settling_time: float
    dwell_time: float
    count: int
    pattern: Literal["square wave", "staircase"] = "square wave"

    def __post_init__(self) -> None:
        for name in ("settling_time", "dwell_time"):
            if not 0 < getattr(self, name) < np.inf:
                raise ModelError(
                    f"retargeting: {name} {getattr(self, name)} s is not above zero; give a positive one"
                )
        if self.count < 1:
            raise ModelError(f"retargeting: {self.count} engagements; give one or more")
        if self.pattern not in ("square wave", "staircase"):
            raise ModelError(
                f"retargeting: pattern '{self.pattern}' is neither 'square wave' nor 'staircase'"
            )

    @property
    def period(self) -> float:
        """From one step to the next [s]."""
        return self.settling_time + self.dwell_time

    @property
    def start(self) -> Array:
        """(count,) Time of each step [s]."""
        return self.period * np.arange(self.count, dtype=float)

    @property
    def step(self) -> Array:
        """(count,) Each step with its sign [rad]."""
        step = np.full(self.count, float(self.command))
        if self.pattern == "square wave":
            step[1::2] *= -1
        return step

    def engagement(self, time: Array) -> NDArray[np.intp]:
        """(m,) Index of the engagement at (m,) times, −1 before the first."""
        return np.minimum(np.searchsorted(self.start, time, side="right"), self.count) - 1

    def target(self, time: Array) -> Array:
        """(m,) Commanded angle at (m,) times [rad]."""
        return np.concatenate([[0.0], np.cumsum(self.step)])[self.engagement(time) + 1]


@dataclass(frozen=True)
class Engagements:
    """What a sequence leaves in the rms window of each engagement.    [Barker1991] Table 3.1, Fig. 3.6

    Attributes
    ----------
    offset
        (count,) error y − y_c as the window opens, t_RMS after the step [rad].
    rms
        (count,) rms error about its mean over the window [rad].
    largest
        (count,) largest size of the error in the window [rad].
    """

    offset: Array
    rms: Array
    largest: Array


def transients(model: LoopModel, poles: ClosedLoopPoles, retargeting: Retargeting) -> tuple[Transient, ...]:
    """The error of each engagement, its time counted from its own step.

    The loop is linear, so what an engagement starts with is its own step plus all that earlier ones left.
    """
    return repeated(step_error(model, poles), retargeting)


def repeated(after: Transient, retargeting: Retargeting) -> tuple[Transient, ...]:
    """What each engagement begins with, from what follows a unit step."""
    amplitude = np.zeros_like(after.pole)
    found = []
    levels, since = np.cumsum(retargeting.step), np.diff(retargeting.start, prepend=0.0)
    for step, level, time in zip(retargeting.step, levels, since, strict=True):
        amplitude = np.exp(after.pole * time) * amplitude + step * after.amplitude
        found.append(Transient(level * after.steady, amplitude, after.pole))
    return tuple(found)


def sequence_response(
    model: LoopModel, poles: ClosedLoopPoles, retargeting: Retargeting, time: Array
) -> Array:
    """(m,) Mirror angle at (m,) times of a retargeting sequence, from rest; for an unstable loop too [rad].

    [Barker1991] Eq. (4.28), Fig. 3.16
    """
    response = retargeting.target(time)
    own = retargeting.engagement(time)
    for k, error in enumerate(transients(model, poles, retargeting)):
        response[own == k] += error(time[own == k] - retargeting.start[k])
    return response


def engagements(model: LoopModel, poles: ClosedLoopPoles, retargeting: Retargeting) -> Engagements:
    """Offset error and residual rms of each engagement.    [Barker1991] Table 3.1, Fig. 3.6"""
    opens, closes = retargeting.settling_time, retargeting.period
    found = transients(model, poles, retargeting)
    return Engagements(
        np.array([error(np.array([opens]))[0] for error in found]),
        np.array([error.rms(opens, closes) for error in found]),
        np.array([error.largest(opens, closes) for error in found]),
    )
