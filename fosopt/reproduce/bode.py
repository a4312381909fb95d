"""Frequency responses as panels: magnitude over a phase that is continuous because poles and zeros are counted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fosopt.control.phase import continuous_phase, resonance_grid
from fosopt.ops import Array, ComplexArray
from fosopt.reproduce.entry import Curve, Panel
from fosopt.units import HZ


@dataclass(frozen=True)
class Response:
    """A frequency response.

    Attributes
    ----------
    frequency, value, phase
        (m,) [rad/s], complex, and continuous [deg].
    """

    label: str
    frequency: Array
    value: ComplexArray
    phase: Array


def resolved_response(
    label: str,
    transfer: Callable[[ComplexArray], ComplexArray],
    zeros: ComplexArray,
    poles: ComplexArray,
    low: float,
    high: float,
    count: int = 400,
) -> Response:
    """A transfer function from `low` to `high` [Hz], sampled closest at its poles and zeros [rad/s].

    The phase follows from poles and zeros; the value at the lowest frequency says where it starts: a quarter turn up
    for each zero at the origin and one down for each pole there, and half a turn down for a negative gain.
    """
    frequency = resonance_grid(np.concatenate([zeros, poles]), HZ * low, HZ * high, count)
    value = transfer(1j * frequency)
    phase = continuous_phase(zeros, poles, 1.0, frequency)
    start = float(np.degrees(np.angle(value[0])))
    phase = phase + 180.0 * round((start - phase[0]) / 180.0)
    usual = 90.0 * (np.count_nonzero(zeros == 0) - np.count_nonzero(poles == 0))
    return Response(label, frequency, value, phase - 360.0 * np.ceil((phase[0] - usual - 90.0) / 360.0))


def bode_panels(
    responses: Sequence[Response], unit: str, title: str = "", *, wide: bool = True
) -> tuple[Panel, Panel]:
    """Magnitude over phase."""
    return (
        Panel(
            "Frequency [Hz]",
            f"Magnitude [dB re {unit}]",
            tuple(Curve(r.frequency / HZ, 20 * np.log10(np.abs(r.value)), r.label) for r in responses),
            title,
            x_scale="log",
            wide=wide,
        ),
        Panel(
            "Frequency [Hz]",
            "Phase [deg]",
            tuple(Curve(r.frequency / HZ, r.phase, r.label) for r in responses),
            x_scale="log",
            wide=wide,
        ),
    )
