"""What a sampled loop does on command: step metrics and what a retargeting sequence asks of the mirror.

The command reaches the controller at its next sample. Between two changes of the held torque the response is carried
exactly, with its integral and the integral of its square.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import pairwise

import numpy as np

from fosopt.control.sampled import SampledLoop
from fosopt.control.spans import Span, span
from fosopt.errors import UnstableError
from fosopt.metrics.sequence import Retargeting
from fosopt.metrics.step import StepCommand
from fosopt.ops import Array

# Steps between samples per radian of the fastest mode, at least and at most this many in a period.
_PER_RADIAN, _LEAST, _MOST = 2.5, 8, 64
# Two times this close, in periods, are one.
_SAME = 1e-9


def sampled_step_metrics(sampled: SampledLoop, step: StepCommand) -> dict[str, float]:
    """Offset and residual rms of a step in its window, see `metrics.step.step_metrics`; the step is at a sample [rad].

    Raises
    ------
    UnstableError
        If the loop is unstable.
    """
    _refuse_unstable(sampled)
    n = sampled.torque.size
    # States, held torque, integral of the line of sight, and the one that the error is counted from.
    a = np.zeros((n + 3, n + 3))
    a[:n, :n], a[:n, n] = sampled.a, sampled.torque
    error = np.concatenate([sampled.line_of_sight, [0.0, 0.0, -1.0]])
    a[n + 1] = error

    @cache
    def over(time: float) -> Span:
        return span(a, error[None], time)

    start, end = step.window
    mean = square = 0.0
    for first, last, states, torque in _pieces(sampled, lambda k: 1.0, end, (start, end)):
        if first < start - _SAME * sampled.period:
            continue
        here = np.concatenate([states, [torque, 0.0, 1.0]])
        part = over(last - first)
        mean += float((part.carried @ here)[n + 1])
        square += float(np.sum((part.energy @ here) ** 2))
    mean, square = mean / (end - start), square / (end - start)
    return {
        "step_offset": step.command * abs(mean),
        "step_rms": step.command * max(square - mean**2, 0.0) ** 0.5,
    }


def sampled_peaks(sampled: SampledLoop, retargeting: Retargeting) -> dict[str, float]:
    """Largest stroke [rad], rate [rad/s] and torque [N m] over a sequence, see `metrics.peaks.peaks`.

    The torque is exact; stroke and rate miss a peak of the fastest mode by 2 % at most, slower ones by far less.

    Raises
    ------
    UnstableError
        If the loop is unstable.
    """
    _refuse_unstable(sampled)
    fastest = float(np.abs(np.linalg.eigvals(sampled.a).imag).max()) * sampled.period
    count = int(np.clip(np.ceil(_PER_RADIAN * fastest), _LEAST, _MOST))

    @cache
    def rows(time: float) -> Array:
        """(count, 2, n+1) Stroke and rate at equal steps over a span of time, from the states it begins with."""
        one = sampled.carried(time / count)
        row, found = np.column_stack([sampled.stroke, np.zeros(2)]), []
        for _ in range(count):
            row = row @ one
            found.append(row)
        return np.array(found)

    end = retargeting.period * retargeting.count
    peak = np.zeros(2)
    torques = 0.0

    def command(k: int) -> float:
        return float(retargeting.target(np.array([(k + _SAME) * sampled.period]))[0])

    for first, last, states, torque in _pieces(sampled, command, end, ()):
        moved = rows(round(last - first, 15)) @ np.append(states, torque)
        peak = np.maximum(peak, np.abs(moved).max(axis=0))
        torques = max(torques, abs(torque))
    return {"peak_stroke": float(peak[0]), "peak_rate": float(peak[1]), "peak_torque": torques}


def sampled_response(sampled: SampledLoop, time: Array) -> Array:
    """(m,) Mirror angle after a unit step at a sample, at (m,) ascending times, for an unstable loop too [rad]."""
    found = np.zeros(time.size)
    row = np.append(sampled.line_of_sight, 0.0)

    @cache
    def seen(after: float) -> Array:
        return row @ sampled.carried(after)

    for first, last, states, torque in _pieces(sampled, lambda k: 1.0, float(time[-1]) + sampled.period, ()):
        for k in range(*np.searchsorted(time, (first, last))):
            found[k] = seen(round(time[k] - first, 15)) @ np.append(states, torque)
    return found


def _pieces(
    sampled: SampledLoop, command: object, end: float, cuts: tuple[float, ...]
) -> Iterator[tuple[float, float, Array, float]]:
    """Spans of constant torque from rest until `end`, also cut at some times: start, end, states, held torque."""
    period, own = sampled.period, sampled.states
    n = sampled.torque.size

    @cache
    def carried(time: float) -> Array:
        return sampled.carried(time)[:n]

    states, inner = np.zeros(n), np.zeros(own.order)
    past = [0.0] * (sampled.whole + 1)
    assert callable(command)
    for k in range(int(np.ceil(end / period - _SAME))):
        error = command(k) - float(sampled.measured @ states)
        new = float(own.c @ inner) + own.d * error
        inner = own.a @ inner + own.b * error
        torques = [new, *past]
        begin = k * period
        edges = {
            begin,
            begin + sampled.rest,
            begin + period,
            *(c for c in cuts if begin < c < begin + period),
        }
        if end < begin + period - _SAME * period:
            edges = {edge for edge in edges if edge < end} | {end}
        ordered = sorted(edges)
        times = [t for i, t in enumerate(ordered) if i == 0 or t - ordered[i - 1] > _SAME * period]
        for first, last in pairwise(times):
            late = sampled.rest > 0 and first < begin + sampled.rest - _SAME * period
            torque = torques[sampled.whole + 1] if late else torques[sampled.whole]
            yield first, last, states, torque
            states = carried(round(last - first, 15)) @ np.append(states, torque)
        past = torques[: sampled.whole + 1]


def _refuse_unstable(sampled: SampledLoop) -> None:
    if not sampled.spectral_abscissa < 0:
        raise UnstableError(
            f"sampled loop is unstable: a pole has ln|z|/T = {sampled.spectral_abscissa:.6g} rad/s"
        )
