"""Curves of the loop as built, sampled, for a report: loop transfer at the samples, step response between them too."""

from __future__ import annotations

from math import pi

import numpy as np

from fosopt.control.sampled import SampledLoop
from fosopt.metrics.sampled import SampledModel
from fosopt.metrics.sampled_steps import sampled_response
from fosopt.ops import Array, ComplexArray

_PER_PERIOD = 8  # points of a step between two samples, fewer of a long one


def resolved(model: SampledModel, frequency: Array) -> Array:
    """(k,) Frequencies below Nyquist: those given, and those that resolve every resonance of a sampled loop [rad/s]."""
    top = pi / model.bare.period
    return np.union1d(frequency[frequency < top], model.grid)


def as_sampled(
    model: SampledModel, frequency: Array, transfer: ComplexArray, phase: Array | None
) -> tuple[ComplexArray, Array | None]:
    """Loop transfer at the samples, and its phase counted on from that of the continuous model.

    Parameters
    ----------
    frequency, transfer, phase
        (m,) below Nyquist [rad/s], loop transfer of the continuous model [-] and its phase [deg].

    Returns
    -------
    (m,), (m,) or None
        Loop transfer [-] and phase [deg].
    """
    sampled = model.bare.loop_transfer(np.exp(1j * frequency * model.bare.period))
    return sampled, None if phase is None else phase + np.angle(sampled / transfer, deg=True)


def step_between_samples(sampled: SampledLoop, window: tuple[float, float], most: int) -> tuple[Array, Array]:
    """(m,), (m,) Times up to the end of a window [s], its edges among them, and the error after a unit step then.

    Parameters
    ----------
    most
        About how many there are to be, unless there are more samples.
    """
    periods = int(np.ceil(window[1] / sampled.period))
    each = int(np.clip(most // periods, 1, _PER_PERIOD))
    grid = sampled.period / each * np.arange(periods * each)
    time = np.union1d(grid[grid < window[1]], window)
    return time, sampled_response(sampled, time) - 1
