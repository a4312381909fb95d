"""Chapter 3, ten engagements of cases 1 to 4: figures 3.25, 3.33, 3.37 and 3.40 to 3.43."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fosopt.metrics.sequence import Retargeting, transients
from fosopt.ops import Array
from fosopt.reproduce.chapter3_panels import TOLERANCE, command_panels, window_panel
from fosopt.reproduce.chapter3_system import (
    FLEXIBLE,
    FREQUENCIES,
    REQUIRED,
    RETARGETING,
    SEQUENCE,
    UDU,
    Case,
    case,
    smd,
)
from fosopt.reproduce.entry import Comparison, Entry, Reproduction
from fosopt.reproduce.judge import claim, judged
from fosopt.reproduce.published import PUBLISHED

_LEAST = PUBLISHED["section_3_4"]["least_vibration_engagement"]
_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
_PERIODS_MS = (90.0, 110.0)  # periods among which one with the printed pattern is looked for


def _performance_loss(of: Case) -> tuple[Comparison, ...]:
    largest, rigid = float(of.engagements.largest.max()) / UDU, float(smd().engagements.largest.max()) / UDU
    return (
        claim(
            "command response",
            "performance loss",
            largest > TOLERANCE >= rigid,
            "no performance loss",
            f"largest error in a window {largest:.0f} µdu, {rigid:.0f} on the rigid support; ±{TOLERANCE:.0f} allowed",
        ),
    )


def _far_outside(of: Case) -> tuple[Comparison, ...]:
    largest = float(of.engagements.largest[0]) / UDU
    allowed = REQUIRED["jitter_total_udu"]
    times = float(of.engagements.rms[0]) / UDU / allowed
    return (
        claim(
            f"oscillation and the band of ±{TOLERANCE:.0f} µdu",
            "clearly outside",
            largest > 2 * TOLERANCE,
            "not clearly outside",
            f"up to {largest:.0f} µdu in the first window",
        ),
        claim(
            "oscillation over the required rms jitter",
            "nearly two orders of magnitude",
            1.5 <= np.log10(times) < 2,
            f"a factor of {times:.3g}",
            f"{times:.0f} times in the first window, in rms",
        ),
    )


def vibration(of: Case, retargeting: Retargeting = RETARGETING) -> Array:
    """(count,) Amplitude of the structural vibration as each window opens [µdu]."""
    mode = int(np.argmax(of.poles.value.imag))
    decay = np.exp(of.poles.value[mode].real * retargeting.settling_time)
    found = transients(of.model, of.poles, retargeting)
    return np.array([abs(error.amplitude[mode]) for error in found]) * decay / UDU


def _least(amplitude: Array) -> str:
    return _ORDINALS[int(amplitude.argmin())]


def _attenuation(of: Case) -> tuple[Comparison, ...]:
    amplitude = vibration(of)
    return (
        claim(
            "vibration between the first and the ninth engagement",
            "attenuated",
            bool(amplitude[8] < amplitude[0]),
            "not attenuated",
            f"{amplitude[0]:.0f} and {amplitude[8]:.0f} µdu at 500 Hz",
        ),
        *_performance_loss(of),
    )


_COMMAND = {1: _performance_loss, 2: _performance_loss, 3: _far_outside, 4: _attenuation}


def command(number: int) -> Reproduction:
    """Figures 3.25, 3.33, 3.37 and 3.40: ten engagements, the first and the ninth in detail."""
    of = case(number)
    return judged(
        f"{FLEXIBLE}, {FREQUENCIES[number - 1]:g} Hz (case {number}). {SEQUENCE}",
        _COMMAND[number](of),
        command_panels(of),
        2,
    )


def _growth_rows(of: Case) -> list[Comparison]:
    amplitude = vibration(of)
    return [
        Comparison(
            "engagement with the least vibration",
            _ORDINALS[_LEAST - 1],
            _least(amplitude),
            note="amplitudes as the windows open: "
            + ", ".join(f"{a:.0f}" for a in amplitude)
            + " µdu, first to tenth",
        ),
        claim(
            "vibration after the seventh engagement",
            "grows through the tenth",
            bool(np.all(np.diff(amplitude[_LEAST - 1 :]) > 0)),
            "goes up and down",
        ),
    ]


def _never(of: Case) -> Comparison:
    """Whether any period makes the printed engagement the calmest, both patterns tried."""
    tried = [
        replace(RETARGETING, dwell_time=1e-3 * period - RETARGETING.settling_time, pattern=pattern)
        for period in np.linspace(*_PERIODS_MS, 401)
        for pattern in ("square wave", "staircase")
    ]
    found = [int(vibration(of, each).argmin()) for each in tried]
    return Comparison(
        f"periods from {_PERIODS_MS[0]:g} to {_PERIODS_MS[1]:g} ms, out and back or always on, whose "
        f"{_ORDINALS[_LEAST - 1]} engagement is the calmest",
        None,
        found.count(_LEAST - 1),
        f"of {len(tried)}",
    )


def _why(of: Case) -> str:
    left = float(np.exp(of.poles.value[int(np.argmax(of.poles.value.imag))].real * RETARGETING.period))
    return (
        f"each engagement leaves {left:.2f} of the vibration to the next, so that with equal periods it settles within "
        "a few engagements, the second being the least, and no period nearby makes the "
        f"{_ORDINALS[_LEAST - 1]} the calmest. What the dissertation's simulation did with steps that fall between its "
        "samples is not known"
    )


def engagement_windows(numbers: Sequence[int]) -> Reproduction:
    """Figures 3.41 to 3.43: engagements of case 4 one by one, clockwise from the top left."""
    of = case(4)
    reach = 1.1 * float(of.engagements.largest.max()) / UDU
    reach = max(reach, 2.5 * TOLERANCE)
    judging = _LEAST in numbers or numbers[-1] > _LEAST
    amplitude = vibration(of)
    own = [
        Comparison(f"vibration, engagement {n}", None, float(amplitude[n - 1]), "µdu", "as its window opens")
        for n in numbers
    ]
    rows = [*own, *(_growth_rows(of) if judging else [])]
    if _LEAST in numbers:
        rows.append(_never(of))
    return judged(
        f"{FLEXIBLE}, {FREQUENCIES[3]:g} Hz (case 4). {SEQUENCE}",
        rows,
        [window_panel(of, n, (-reach, reach)) for n in _clockwise(numbers)],
        2,
        differs=_why(of),
    )


def _clockwise(numbers: Sequence[int]) -> list[int]:
    """Four panels row by row, so that they read clockwise."""
    return [*numbers[:2], *reversed(numbers[2:])]


ENTRIES = (
    *(
        Entry(f"figure-3.{n}", f"Ten engagements, case {k}", partial(command, k))
        for n, k in ((25, 1), (33, 2), (37, 3), (40, 4))
    ),
    *(
        Entry(
            f"figure-3.{n}",
            f"Engagements {numbers[0]} to {numbers[-1]}, case 4",
            partial(engagement_windows, numbers),
        )
        for n, numbers in ((41, (1, 2, 3, 4)), (42, (5, 6, 7, 8)), (43, (9, 10)))
    ),
)
