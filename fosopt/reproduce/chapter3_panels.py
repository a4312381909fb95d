"""Panels that the figures of chapter 3 share: loci, Nyquist plots, sensitivities and retargeting sequences."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fosopt.metrics.sequence import sequence_response, transients
from fosopt.ops import Array, ComplexArray
from fosopt.reproduce.chapter3_system import REQUIRED, RETARGETING, UDU, Case
from fosopt.reproduce.entry import Curve, Mark, Panel, Style
from fosopt.units import HZ

Range = tuple[float, float]

TOLERANCE = REQUIRED["offset_tolerance_udu"]
_TURN = np.linspace(-np.pi, np.pi, 361)
_RESIDUAL_MS = 25.0  # before it the response is still far outside the tolerance


def locus_panel(case: Case, x_range: Range | None, y_range: Range | None, *, equal: bool = False) -> Panel:
    """Branches from open-loop poles to the closed-loop ones, in the part of the plane that is seen."""
    branches, end = case.locus.branches, case.locus.branches[-1]

    def points(of: ComplexArray, label: str, style: Style) -> Curve:
        inside = of[_inside(np.real(of), x_range) & _inside(np.imag(of), y_range)]
        return Curve(np.real(inside), np.imag(inside), label, style)

    return Panel(
        "Real part [rad/s]",
        "Imaginary part [rad/s]",
        (
            *(Curve(np.real(b), np.imag(b), "" if k else "locus") for k, b in enumerate(branches.T)),
            points(branches[0], "poles of the loop", "crosses"),
            points(case.loop_zeros, "zeros of the loop", "points"),
            points(end, f"closed loop, K = {case.locus.gain[-1]:.0f}", "squares"),
        ),
        x_range=x_range,
        y_range=y_range,
        marks=(Mark(x=0.0),),
        equal=equal,
    )


def magnified_locus(case: Case, margin: float = 0.12) -> Panel:
    """The locus about the branch of the structural mode."""
    seen = np.append(case.structural_branch, 1j * HZ * case.structure_hz)
    x, y = seen.real, seen.imag
    low, high = min(x.min(), 0.0), max(x.max(), 0.0)
    return locus_panel(case, _wider(low, high, margin), _wider(y.min(), y.max(), margin))


def _inside(values: Array, of: Range | None) -> NDArray[np.bool_]:
    return np.full(values.shape, True) if of is None else (values >= of[0]) & (values <= of[1])


def _wider(low: float, high: float, margin: float) -> Range:
    room = margin * (high - low)
    return low - room, high + room


def nyquist_panel(case: Case, low: float, high: float, reach: float) -> Panel:
    """L(jω) from and to [Hz] with the unit circle, in a window of half width `reach` about zero."""
    value = case.loop_gain(case.grid(low, high, 6000))
    return Panel(
        "Real part of L [-]",
        "Imaginary part of L [-]",
        (
            Curve(np.real(value), np.imag(value), f"L(jω), {low:g} to {high:g} Hz"),
            Curve(np.cos(_TURN), np.sin(_TURN), "unit circle", "dashed"),
            Curve(np.array([-1.0]), np.array([0.0]), "−1", "crosses"),
        ),
        x_range=(-reach, reach),
        y_range=(-reach, reach),
        equal=True,
    )


def magnitude_panel(
    cases: Sequence[Case], name: str, unit: str, low: float, high: float, title: str, *, wide: bool = False
) -> Panel:
    """Magnitude of a closed-loop response of several systems, the first one dashed where there are more."""
    grids = [case.grid(low, high) for case in cases]
    return Panel(
        "Frequency [Hz]",
        f"Magnitude [dB re {unit}]",
        tuple(
            Curve(
                grid / HZ,
                20 * np.log10(np.abs(case.closed(name, grid))),
                case.name if len(cases) > 1 else "",
                "dashed" if case.name == "SMD" and len(cases) > 1 else "line",
            )
            for case, grid in zip(cases, grids, strict=True)
        ),
        title,
        x_scale="log",
        x_range=(low, high),
        wide=wide,
    )


def time_grid(case: Case, start: float, end: float) -> Array:
    """Times that resolve the fastest oscillation [s]."""
    fastest = np.abs(case.poles.value.imag).max()
    return np.linspace(start, end, max(800, int(16 * fastest * (end - start) / (2 * np.pi))))


def sequence_panel(case: Case) -> Panel:
    """Command and output of the ten engagements."""
    period = RETARGETING.period
    # Both sides of each step.
    edges = np.repeat(RETARGETING.start, 2) + np.tile([-1e-9, 0.0], RETARGETING.count)
    time = np.union1d(time_grid(case, -0.2 * period, RETARGETING.count * period * (1 - 1e-9)), edges)
    response = sequence_response(case.model, case.poles, RETARGETING, time)
    return Panel(
        "Time [s]",
        "Output [du]",
        (
            Curve(time, RETARGETING.target(time), "command x_c", "dashed"),
            Curve(time, response, "output x_a"),
        ),
        "Ten engagements",
        x_range=(0.0, RETARGETING.count * period),
        wide=True,
    )


def window_panel(case: Case, number: int, y_range: Range | None = None) -> Panel:
    """Error of one engagement against the tolerance, from when it comes near it to the next step."""
    of = transients(case.model, case.poles, RETARGETING)[number - 1]
    time = time_grid(case, 1e-3 * _RESIDUAL_MS, RETARGETING.period)
    error = of(time)
    return Panel(
        "Time after the step [ms]",
        "Error x_a − x_c [µdu]",
        (Curve(1e3 * time, error / UDU),),
        f"Engagement {number}",
        x_range=(_RESIDUAL_MS, 1e3 * RETARGETING.period),
        y_range=y_range or _settled_range(case, of),
        marks=(
            Mark("tolerance", y=TOLERANCE),
            Mark(y=-TOLERANCE),
            Mark("t_RMS", x=1e3 * RETARGETING.settling_time),
        ),
    )


def _settled_range(case: Case, of: Callable[[Array], Array]) -> Range:
    """What the window shows, and no less than two and a half times the tolerance."""
    time = time_grid(case, RETARGETING.settling_time, RETARGETING.period)
    reach = max(2.5 * TOLERANCE, 1.15 * float(np.abs(of(time)).max()) / UDU)
    return -reach, reach


def command_panels(case: Case) -> tuple[Panel, ...]:
    """The whole sequence over its first and its ninth engagement, in one range."""
    first = window_panel(case, 1)
    ninth = window_panel(case, 9)
    reach = max(first.y_range or (0.0, 0.0), ninth.y_range or (0.0, 0.0), key=lambda r: r[1])
    return (sequence_panel(case), *(window_panel(case, number, reach) for number in (1, 9)))
