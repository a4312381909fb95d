"""Chapter 4, command responses: figures 4.17, 4.18, 4.20 and 4.22."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
from scipy import optimize

from fosopt.control import closed_loop_poles
from fosopt.metrics.bandwidth import closed_loop_bandwidth
from fosopt.metrics.sequence import Retargeting, engagements, sequence_response
from fosopt.metrics.transient import Transient
from fosopt.reproduce import chapter4_system as system
from fosopt.reproduce.chapter4_system import CHAPTER, DWELL, REQUIRED, UDU, WINDOW, Model, structural_lines
from fosopt.reproduce.entry import Comparison, Curve, Entry, Mark, Panel, Reproduction
from fosopt.reproduce.judge import claim, judged
from fosopt.units import HZ

JITTER, OFFSET = REQUIRED["jitter_total_udu"], REQUIRED["offset_tolerance_udu"]
SEQUENCE = Retargeting(REQUIRED["step_du"], WINDOW[0], DWELL, 5)  # five engagements: section 4.4
_JUST = 0.9  # share of a frequency above which another is just under it


def retargeting(percents: tuple[float, ...]) -> Reproduction:
    """Figure 4.17: five engagements at four mirror inertias."""
    time = np.linspace(0.0, SEQUENCE.period * SEQUENCE.count, 4001)
    panels, rows = [], []
    for percent in percents:
        of = system.closed(percent, "reduced")
        panels.append(
            Panel(
                "Time [s]",
                "θ_m [du]",
                (
                    Curve(time, sequence_response(*of, SEQUENCE, time), "θ_m"),
                    Curve(time, SEQUENCE.target(time), "command", "dashed"),
                ),
                f"J_m = {percent:g} % J_{{truss}}",
                y_range=(-1.0, 2.0),
            )
        )
        found_stable, growth = system.stability(percent, "reduced"), system.growth(percent, "reduced")
        rows.append(Comparison(f"{percent:g} %", system.said(percent), found_stable, note=growth))
        if found_stable == "unstable":
            continue
        found = engagements(*of, SEQUENCE)
        note = (
            f"rms about the mean up to {found.rms.max() / UDU:.1f}, offset up to "
            f"{np.abs(found.offset).max() / UDU:.0f}"
        )
        if percent == percents[0]:
            rows.append(
                claim(
                    f"{percent:g} %, enlarged: vibration stability",
                    "not achieved",
                    found.rms.max() > JITTER * UDU,
                    "achieved",
                    note,
                )
            )
        rows.append(
            Comparison(
                f"{percent:g} %, largest residual jitter", None, float(found.rms.max()) / UDU, "µdu", note
            )
        )
    rows.append(
        Comparison(
            "smallest unstable mirror inertia",
            None,
            least_unstable(),
            "%",
            "of the 8-dof loop; the text calls 2 % small enough",
        )
    )
    return judged(
        f"Five engagements of the 8-dof model, a unit step out and back every {SEQUENCE.period:g} s, half of it to "
        "settle and half to dwell, exact from poles and residues; of unstable loops too, for the time shown.",
        rows,
        panels,
        2,
    )


@cache
def least_unstable() -> float:
    """Mirror inertia at which the 8-dof loop turns unstable [%]."""
    modes = system.support("reduced")

    def abscissa(percent: float) -> float:
        return closed_loop_poles(system.loop(percent), modes, "tip").spectral_abscissa

    return float(optimize.brentq(abscissa, *system.PERCENTS[2:4], xtol=1e-9))


def part(of: Transient, chosen: np.ndarray) -> Transient:
    """Some of the oscillations of a transient."""
    return Transient(of.steady, of.amplitude[chosen], of.pole[chosen])


def step(percent: float, model: Model) -> Reproduction:
    """Figures 4.18, 4.20 and 4.22: step response, and its residual enlarged against the requirements."""
    error, rigid = system.residual(percent, model), system.residual(percent, "rigid")
    time = np.linspace(0.0, 2 * WINDOW[1], 8001)
    late = time >= 0.6 * WINDOW[0]
    reach = 1.15 * max(float(np.abs(error(time[time >= WINDOW[0]])).max()) / UDU, OFFSET)
    panels = (
        Panel("Time [s]", "θ_m [du]", (Curve(time, 1 + error(time)),), wide=True),
        Panel(
            "Time [s]",
            "θ_m − 1 [µdu]",
            (
                Curve(time[late], error(time[late]) / UDU, system.order(model)),
                Curve(time[late], rigid(time[late]) / UDU, "rigid support", "dashed"),
            ),
            x_range=(0.6 * WINDOW[0], 2 * WINDOW[1]),
            y_range=(-reach, reach),
            marks=(
                *_pair("rms required", -JITTER, JITTER),
                *_pair("offset allowed", -OFFSET, OFFSET),
                Mark("rms window", x=WINDOW[0]),
                Mark(x=WINDOW[1]),
            ),
            wide=True,
        ),
    )
    rms = error.rms(*WINDOW)
    rows = (
        claim(
            "residual jitter",
            "within requirement" if model == "reduced" else "outside requirement",
            (rms <= JITTER * UDU) == (model == "reduced"),
            "outside requirement" if model == "reduced" else "within requirement",
            f"{rms / UDU:.1f} rms about its mean from {WINDOW[0]:g} to {WINDOW[1]:g} s, {JITTER:g} required",
        ),
        Comparison(
            "offset as the rms window opens", None, float(error(np.array(WINDOW[:1]))[0]) / UDU, "µdu"
        ),
        Comparison("residual rms about its mean", None, rms / UDU, "µdu", _share(percent, model)),
        *_readings(percent, model),
        *_spectrum_rows(percent, model),
    )
    return judged(
        f"Response of the {system.order(model)} model to a unit step command, {percent:g} %, exact from poles and "
        "residues, and what is left of the step, enlarged. The residual is the rms error about its mean in the window "
        "of table 3.1, the first after the step.",
        rows,
        panels,
    )


def _pair(label: str, low: float, high: float) -> tuple[Mark, Mark]:
    """Two lines that belong together."""
    return Mark(label, y=low), Mark(y=high)


def _share(percent: float, model: Model) -> str:
    """How much of the residual is the controller's own transient, and what is left in the next window."""
    rigid, error = system.residual(percent, "rigid"), system.residual(percent, model)
    later = WINDOW[1], WINDOW[1] + DWELL
    return (
        f"a rigid support alone leaves {rigid.rms(*WINDOW) / UDU:.1f}, the controller's own transient; "
        f"one dwell time later {error.rms(*later) / UDU:.1f} is left, at most {error.largest(*later) / UDU:.0f}"
    )


def _readings(percent: float, model: Model) -> tuple[Comparison, ...]:
    """The residual with other readings of 'seven elastic modes'."""
    if model != "reduced":
        return ()
    return tuple(
        Comparison(
            f"the same with {system.MODELS[other]}",
            None,
            system.residual(percent, other).rms(*WINDOW) / UDU,
            "µdu",
        )
        for other in ("elastic", "late")
    )


def _spectrum_rows(percent: float, model: Model) -> tuple[Comparison, ...]:
    """Where the energy of the full-order residual is; the text says so of the smallest inertia."""
    if model != "full":
        return ()
    lines, modes = structural_lines(percent)
    error = system.residual(percent)
    order = np.argsort(-np.abs(error.amplitude[lines]))[:2]
    top = error.pole[lines][order].imag / HZ
    below = CHAPTER["high_participation_just_below_hz"]
    bandwidth = closed_loop_bandwidth(*system.closed(percent, "rigid"))
    high = error.pole[lines].imag > bandwidth
    inside, beyond = part(error, lines[~high]), part(error, lines[high])
    rolled = part(error, np.setdiff1d(np.arange(error.pole.size), lines[high]))
    strongest = " and ".join(f"{f:.1f} Hz" for f in np.sort(top))
    rows = [
        claim(
            "modes of the largest participation",
            f"just under {below:g} Hz",
            np.all((top < below) & (top > _JUST * below)),
            strongest,
            f"{strongest}, {' and '.join(f'{a / UDU:.0f}' for a in np.abs(error.amplitude[lines][order]))}; "
            f"J̄_k {' and '.join(f'{j:.2g}' for j in modes[order])}",
        ),
        claim(
            "they lie",
            "beyond the closed-loop bandwidth",
            np.all(top * HZ > bandwidth),
            "inside the closed-loop bandwidth",
            f"{bandwidth / HZ:.0f} Hz",
        ),
        Comparison(
            "rms of the structural modes inside the bandwidth",
            None,
            inside.rms(*WINDOW) / UDU,
            "µdu",
            "the text calls it absent" if percent == system.PERCENTS[0] else "",
        ),
        Comparison("rms of those beyond it", None, beyond.rms(*WINDOW) / UDU, "µdu"),
    ]
    if percent == system.PERCENTS[0]:
        rows.append(
            claim(
                "without the modes beyond the bandwidth, as a roll-off leaves it",
                "requirement met",
                rolled.rms(*WINDOW) <= JITTER * UDU,
                "requirement not met",
                f"{rolled.rms(*WINDOW) / UDU:.1f} rms",
            )
        )
    return tuple(rows)


_STEPS: dict[str, tuple[float, Model]] = {
    "figure-4.18": (0.002, "reduced"),
    "figure-4.20": (0.002, "full"),
    "figure-4.22": (0.02, "full"),
}

ENTRIES: tuple[Entry, ...] = (
    Entry(
        "figure-4.17",
        "Mirror angle command response over five engagements, four mirror inertias",
        partial(retargeting, system.TABULATED),
    ),
    *(
        Entry(
            name,
            f"Response to a step command, {system.order(model)}, J_m = {percent:g} % J_truss",
            partial(step, percent, model),
        )
        for name, (percent, model) in _STEPS.items()
    ),
)
