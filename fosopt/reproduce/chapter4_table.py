"""Chapter 4, jitter stabilization: table 4.1, and what its two torque columns depend on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import inf

import numpy as np
from scipy import optimize

from fosopt.control import closed_loop_poles
from fosopt.metrics.disturbances import Disturbance, ShapingFilter, high_pass, low_pass, white
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.referred import referred_to_sensor
from fosopt.modes import Damping, Hub
from fosopt.reproduce import chapter4_system as system
from fosopt.reproduce.chapter3_system import HIGH_PASS_HZ, LOW_PASS_HZ
from fosopt.reproduce.chapter4_system import TABLE, TABULATED, Model
from fosopt.reproduce.entry import Comparison, Entry, Reproduction
from fosopt.reproduce.judge import claim, judged
from fosopt.units import HZ

STABLE = TABULATED[:2]
RIGID = TABLE["jm_percent_0"]
LOWEST_HZ = 0.01
"""Lowest frequency counted of a torque from outside, which a free hub cannot hold at rest [Hz]."""
_NAMES = {
    "force": "mirror cooling torque f_d",
    "noise": "measurement noise m",
    "los": "line-of-sight disturbance θ_d",
    "aft_body": "aft-to-fore body torque f_h",
}


@dataclass(frozen=True)
class Source:
    """A disturbance and how its size is set.

    Attributes
    ----------
    at
        Where it enters: a key of `control.NUMERATORS`, or ``control_torque`` for a torque between mirror and structure.
    shape
        Its spectrum, of any size.
    lowest
        Lowest frequency counted [Hz].
    rigid
        The support on which it gives the printed jitter of the rigid case.
    held
        Mirror inertia for which it is set so; None for the inertia at hand, so that it grows with the mirror [%].
    """

    at: str
    shape: ShapingFilter
    lowest: float = 0.0
    rigid: Model = "rigid"
    held: float | None = None

    def rms(self, percent: float, model: Model) -> float:
        """Rms of the mirror angle for the shape as it is [rad]."""
        of, poles = system.closed(percent, model)
        inside = self.at == "control_torque"
        shape = referred_to_sensor(self.shape, of.loop.controller) if inside else self.shape
        at = "sensor_noise" if inside else self.at
        disturbance = Disturbance("source", at, shape, band=(self.lowest * HZ, inf))
        return float(np.sqrt(jitter_variances(of, poles, [disturbance])[0].value))

    def jitter(self, percent: float, model: Model = "reduced", printed: float = RIGID["force"]) -> float:
        """Jitter when the rigid case has the printed one [µdu]."""
        return printed * self.rms(percent, model) / self.rms(self.held or percent, self.rigid)


SOURCES = {
    "force": Source("mirror_torque", white(1.0), LOWEST_HZ),
    "noise": Source("sensor_noise", high_pass(HIGH_PASS_HZ * HZ, 1.0)),
    "los": Source("line_of_sight", low_pass(LOW_PASS_HZ * HZ, 1.0)),
    "aft_body": Source("hub_torque", low_pass(LOW_PASS_HZ * HZ, 1.0), LOWEST_HZ, "turning"),
}


def jitter(percent: float, model: Model) -> dict[str, float]:
    """Jitter by source, and their root-sum-square [µdu]."""
    found = {name: source.jitter(percent, model, RIGID[name]) for name, source in SOURCES.items()}
    return found | {"total": float(np.linalg.norm(list(found.values())))}


def table_4_1() -> Reproduction:
    """Jitter stabilization performance at four mirror inertias."""
    rows = [*_verdicts(), *_jitter_rows(), *_statements()]
    experiments = [*_cooling(), *_aft_body(), *_others()]
    near = max(
        abs(row.relative_error or 0.0) for row in rows if row.what.endswith((_NAMES["noise"], _NAMES["los"]))
    )
    wide, again = (SOURCES["force"].jitter(percent) for percent in STABLE)
    force = system.printed(STABLE[1])
    assert not isinstance(force, str)
    found = judged(
        f"Rms of the mirror angle for four disturbances on the 8-dof model ({system.MODELS['reduced']}; hub free), "
        "each set so that the rigid case gives what is printed for it. Spectra were published for chapter 3 only, as "
        f"pictures. Line of sight: first-order low pass at {LOW_PASS_HZ:g} Hz. Noise: first-order high pass at "
        f"{HIGH_PASS_HZ:g} Hz. Cooling torque: wide band, as a low pass that stresses the resonances near 20 Hz gives "
        f"far more than is printed at {STABLE[0]:g} %. Body torque, on the hub: first-order low pass at "
        f"{LOW_PASS_HZ:g} Hz. Torques are counted from {LOWEST_HZ:g} Hz.",
        rows,
        differs=f"All verdicts of stability are as printed; noise and line of sight are within {100 * near:.1f} %. "
        f"Cooling torque: {wide:.2f} at {STABLE[0]:g} % is near the printed number, but at {STABLE[1]:g} % it is "
        f"{again:.1f} for a torque that grows with the mirror and a tenth of that for one that does not, while "
        f"{force['force']} is printed; the digits are those of {1000 * force['force']:.1f}, so a slip by a thousand is "
        "possible, though the printed total contains the small number. Body torque: the printed ratio of the two "
        "inertias follows from the corner of its spectrum, the size from what is called rigid and from the lowest "
        "frequency counted, neither of which is published.",
    )
    return replace(found, comparisons=(*found.comparisons, *experiments))


def _verdicts() -> Iterator[Comparison]:
    models: tuple[Model, ...] = ("reduced", "elastic", "late", "full")
    for percent in TABULATED:
        found = {system.stability(percent, model) for model in models}
        yield Comparison(
            f"{percent:g} %, stability with {', '.join(system.order(m) for m in models[:2])} and 62-dof models",
            system.said(percent),
            found.pop() if len(found) == 1 else "not the same for all models",
            note="; ".join(f"{system.MODELS[model]}: {system.growth(percent, model)}" for model in models),
        )


def _jitter_rows() -> Iterator[Comparison]:
    rigid = {name: RIGID[name] for name in SOURCES}
    yield Comparison(
        "0.00 %, total",
        RIGID["total"],
        float(np.linalg.norm(list(rigid.values()))),
        "µdu",
        "the rigid case, which sets each source to its printed jitter",
    )
    for percent in STABLE:
        printed, found, full = system.printed(percent), jitter(percent, "reduced"), jitter(percent, "full")
        assert not isinstance(printed, str)
        for name, value in found.items():
            yield Comparison(
                f"{percent:g} %, {_NAMES.get(name, name)}",
                printed[name],
                value,
                "µdu",
                f"62-dof: {full[name]:.4g}",
            )


def _statements() -> Iterator[Comparison]:
    """What section 4.4 says of the table."""
    small, large = (jitter(percent, "reduced") for percent in STABLE)
    for name in ("noise", "los"):
        budget = RIGID[name]
        yield claim(
            f"{_NAMES[name]} against inertia",
            "relatively unaffected",
            round(small[name]) == round(large[name]) == round(budget),
            "affected",
            f"{small[name]:.3f} and {large[name]:.3f}",
        )
    held = replace(SOURCES["force"], held=STABLE[0])
    low, high = (held.jitter(percent) for percent in STABLE)
    yield claim(
        f"{_NAMES['force']} of one size as the inertia grows",
        "falls",
        high < low,
        "rises",
        f"{low:.2f} to {high:.2f}: the heavier mirror on its stiffer spring yields less. Over the rigid case "
        f"of the same inertia it rises, {small['force']:.2f} to {large['force']:.2f}",
    )
    yield claim(
        f"{_NAMES['aft_body']} as the inertia grows",
        "rises",
        large["aft_body"] > small["aft_body"],
        "falls",
        f"{small['aft_body']:.0f} to {large['aft_body']:.0f}",
    )


def _pair(what: str, source: Source, model: Model = "reduced", note: str = "") -> Comparison:
    """Jitter at both stable inertias under some assumption."""
    found = [source.jitter(percent, model) for percent in STABLE]
    return Comparison(what, None, " / ".join(f"{value:.5g}" for value in found), "µdu", note)


def _printed_pair(name: str) -> Comparison:
    numbers = " / ".join(TABLE[key][name].text for key in ("jm_percent_0_02", "jm_percent_0_20"))
    return Comparison(f"{_NAMES[name]}, {STABLE[0]:g} / {STABLE[1]:g} %, as printed", None, numbers, "µdu")


def _cooling() -> Sequence[Comparison]:
    """What moves the column of the mirror cooling torque."""
    base = SOURCES["force"]
    slow = replace(base, shape=low_pass(LOW_PASS_HZ * HZ, 1.0))
    return (
        _printed_pair("force"),
        _pair("f_d wide band, size set for each inertia", base),
        _pair(f"f_d of one size, set at {STABLE[0]:g} %", replace(base, held=STABLE[0])),
        _pair(f"f_d low pass at {LOW_PASS_HZ:g} Hz", slow, note="resonances below 20 Hz weigh more"),
        _pair("f_d wide band, counted from 1 Hz", replace(base, lowest=1.0)),
        _pair(f"f_d wide band, hub held at {system.HELD_HZ:g} Hz", base, "held"),
        _pair("f_d wide band, between mirror and structure", replace(base, at="control_torque", lowest=0.0)),
        _pair("f_d wide band, 62-dof", base, "full"),
    )


def _aft_body() -> Sequence[Comparison]:
    """What moves the column of the aft-to-fore body torque."""
    base = SOURCES["aft_body"]
    corner, lowest = needed()
    fitted = replace(base, shape=low_pass(corner * HZ, 1.0), lowest=lowest)
    return (
        _printed_pair("aft_body"),
        _pair(f"f_h low pass at {LOW_PASS_HZ:g} Hz, rigid case a truss that does not bend", base),
        _pair(
            "f_h counted from 0.1 Hz",
            replace(base, lowest=0.1),
            note="less of the slow turning of the rigid truss",
        ),
        _pair("f_h counted from 1 Hz", replace(base, lowest=1.0)),
        _pair(
            f"f_h, hub held at {system.HELD_HZ:g} Hz, all frequencies",
            replace(base, lowest=0.0, rigid="held turning"),
            "held",
        ),
        _pair("f_h low pass at 1 Hz", replace(base, shape=low_pass(HZ, 1.0))),
        _pair("f_h on the tip instead of the hub", base, "tip"),
        _pair("f_h, 62-dof", base, "full"),
        _pair(
            f"f_h of one size, set on the flexible truss at {system.PERCENTS[0]:g} %",
            replace(base, rigid="reduced", held=system.PERCENTS[0]),
            note="the large number is the flexibility of the truss, not the inertia of the mirror",
        ),
        _pair(
            f"f_h low pass at {corner:.2g} Hz, counted from {lowest:.2g} Hz",
            fitted,
            note="two unknowns fitted to two numbers: possible values, no evidence",
        ),
    )


@cache
def needed() -> tuple[float, float]:
    """Corner and lowest frequency with which the body torque gives its printed ratio and size [Hz]."""
    small, large = (TABLE[key]["aft_body"] for key in ("jm_percent_0_02", "jm_percent_0_20"))
    base = SOURCES["aft_body"]

    def ratio(corner: float) -> float:
        source = replace(base, shape=low_pass(corner * HZ, 1.0))
        return source.rms(STABLE[1], "reduced") / source.rms(STABLE[0], "reduced") - large / small

    corner = float(optimize.brentq(ratio, 1.0, 20.0, xtol=1e-6))

    def size(log: float) -> float:
        source = replace(base, shape=low_pass(corner * HZ, 1.0), lowest=float(np.exp(log)))
        return source.jitter(STABLE[0]) / small - 1

    return corner, float(np.exp(optimize.brentq(size, np.log(1e-3), np.log(1.0), xtol=1e-6)))


def _others() -> Sequence[Comparison]:
    """What moves the remaining columns, and the damping on which stability at 2 % rests."""
    los, noise = SOURCES["los"], SOURCES["noise"]
    return (
        _pair("θ_d low pass at 50 Hz", replace(los, shape=low_pass(50 * HZ, 1.0))),
        _pair("m high pass at 200 Hz", replace(noise, shape=high_pass(200 * HZ, 1.0))),
        Comparison(
            f"structural damping that would stabilize {TABULATED[2]:g} %",
            None,
            100 * stabilizing_damping(TABULATED[2]),
            "%",
            "of the 8-dof model; that of chapter 3, 0.1 %, does not",
        ),
    )


@cache
def stabilizing_damping(percent: float) -> float:
    """Damping ratio of the structure above which the 8-dof loop is stable."""
    kept = range(system.CHAPTER["design_model_structure_dof"])

    def abscissa(ratio: float) -> float:
        modes = system.frame().modal_set(Hub("free"), Damping((ratio,)), ("hub", "tip")).keep(kept)
        return closed_loop_poles(system.loop(percent), modes, "tip").spectral_abscissa

    return float(optimize.brentq(abscissa, 1e-4, 1e-1, xtol=1e-9))


ENTRIES: tuple[Entry, ...] = (
    Entry("table-4.1", "Jitter stabilization performance of the flexible optical system", table_4_1),
)
