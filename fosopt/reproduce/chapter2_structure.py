"""Chapter 2, the support structure alone, full and reduced: figures 2.13 to 2.26."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from fosopt.metrics.flexibility import FlexibilityType, rigid_body_flexibility
from fosopt.ops import Array, ComplexArray
from fosopt.plant import ModalExpansion, expansion_zeros, modal_expansion, modal_poles
from fosopt.plant.separation import collocated_separation
from fosopt.reproduce import chapter2_system as system
from fosopt.reproduce.bode import Response, bode_panels, resolved_response
from fosopt.reproduce.entry import Comparison, Curve, Entry, Mark, Panel, Reproduction, Style
from fosopt.reproduce.judge import claim, judged
from fosopt.units import HZ

_MODELS = {True: "the 61-dof structure", False: "Model#1"}
_DRAWN = {True: (0.5, 1100.0), False: (0.5, 200.0)}  # [Hz]
_LOW = 100.0  # magnified part of a map [Hz]
_FIRST = 3  # "the first few" elastic modes
_EXACT = 1e-8  # two routes agree to this: matrices of condition 1e3 beside resonances of 500
_THREE = (
    FlexibilityType.APPENDAGE,
    FlexibilityType.IN_THE_LOOP_MINIMUM_PHASE,
    FlexibilityType.IN_THE_LOOP_NONMINIMUM_PHASE,
)


@dataclass(frozen=True)
class Transfer:
    """Rotation of one end of the support structure per torque on one end.

    Attributes
    ----------
    sensor, action
        Ports.
    text
        As the dissertation writes it.
    """

    sensor: str
    action: str
    text: str

    def expansion(self, full: bool, *, damped: bool = True) -> ModalExpansion:
        """Its modal expansion, of all 61 modes or of Model#1."""
        modes = system.support(full)
        if not damped:
            modes = replace(modes, damping_ratio=np.zeros_like(modes.damping_ratio))
        return modal_expansion(modes, self.sensor, self.action)

    def response(self, full: bool) -> Response:
        """Its frequency response."""
        of = self.expansion(full)
        return resolved_response("", of.response, expansion_zeros(of), modal_poles(of), *_DRAWN[full])


HUB = Transfer("hub", "hub", "θ_0/t_0")
TIP = Transfer("tip", "tip", "θ_{20}/t_{20}")
ACROSS = Transfer("tip", "hub", "θ_{20}/t_0")


@cache
def roots(of: Transfer, full: bool) -> tuple[ComplexArray, Array]:
    """All zeros without damping, and the ascending natural frequencies [Hz]."""
    expansion = of.expansion(full, damped=False)
    frequencies: Array = expansion.natural_frequency / HZ
    return expansion_zeros(expansion) / HZ, frequencies


def interlaced(of: Transfer, full: bool) -> bool:
    """Whether exactly one zero, on the imaginary axis, stands between any two poles that follow each other."""
    zeros, poles = roots(of, full)
    upper = zeros.imag[zeros.imag > 0]
    if np.any(zeros.real) or upper.size != poles.size - 1:
        return False
    return bool(np.all((poles[:-1] < upper) & (upper < poles[1:])))


def right_half(of: Transfer, full: bool, low: float = 0.0, high: float = np.inf) -> tuple[int, int]:
    """Zeros in the open right half plane, and pairs of zeros, of a size above `low` and up to `high` [Hz].

    Without damping zeros come in pairs ±z: one on the imaginary axis has none in the right half plane, any other one.
    """
    zeros, _ = roots(of, full)
    inside = zeros[(np.abs(zeros) > low) & (np.abs(zeros) <= high)]
    return int(np.count_nonzero(inside.real > 0)), inside.size // 2


def _types(of: Transfer, full: bool) -> list[str]:
    return [str(kind) for kind in rigid_body_flexibility(of.expansion(full)).types]


def _type_row(of: Transfer) -> Comparison:
    """What section 3.2 says about the flexibility of the full structure."""
    kinds = _types(of, True)
    if of.sensor == of.action:
        others = len(kinds) - kinds.count(FlexibilityType.APPENDAGE)
        return claim(
            "structural flexibility (section 3.2)",
            "appendage modes exclusively",
            others == 0,
            f"{others} of {len(kinds)} modes are of another type",
            f"of {len(kinds)} elastic modes",
        )
    band = float(roots(of, True)[1][system.REDUCED - 1])
    low, high = right_half(of, True, high=band), right_half(of, True, low=band)
    elastic = system.REDUCED - 1
    alone = kinds[:elastic].count(FlexibilityType.IN_THE_LOOP_NONMINIMUM_PHASE)
    found = {kind: kinds[elastic:].count(kind) for kind in _THREE}
    mixture = ", ".join(f"{number} {kind}" for kind, number in found.items())
    return claim(
        "structural flexibility (section 3.2)",
        "mostly nonminimum phase at low frequency, a mixture of all three types above",
        2 * low[0] > low[1] and all(found.values()),
        "another order of types",
        f"pairs of zeros with one in the right half plane: {low[0]} of {low[1]} up to {band:.0f} Hz, the band of "
        f"Model#1, {high[0]} of {high[1]} above; each mode alone with the rigid body: {alone} of {elastic} "
        f"nonminimum phase in that band, above it "
        f"{mixture}",
    )


def frequency_response(of: Transfer, full: bool) -> Reproduction:
    """Figures 2.13 to 2.15 and 2.21 to 2.23."""
    row = _type_row(of) if full else _preserved(of)
    return judged(
        f"Frequency response {of.text} of {_MODELS[full]}, with modal damping of {100 * system.DAMPING.ratio[0]:g} % "
        "(that of chapter 3; none is published here).",
        (row,),
        bode_panels([of.response(full)], "rad/(N m)"),
    )


def preserved(of: Transfer) -> float:
    """Largest relative distance of the response of the reduced matrices from that of the modes they keep."""
    names = {"hub": "theta0", "tip": "theta20"}
    response = of.response(False)
    reduced = system.model_1().response(1j * response.frequency, names[of.action], names[of.sensor])
    return float(np.abs(reduced / response.value - 1).max())


def _preserved(of: Transfer) -> Comparison:
    apart = preserved(of)
    return claim(
        "response of the kept modes in the kept degrees of freedom (section 2.3)",
        "exactly preserved",
        apart < _EXACT,
        "not preserved",
        f"largest relative difference {apart:.1e}",
    )


def pole_zero_map(of: Transfer, full: bool) -> Reproduction:
    """Figures 2.16 to 2.18 and 2.24."""
    right = right_half(of, full)
    if of.sensor == of.action:
        note = f"{right[1]} pairs of zeros; the text says so of figures 2.16 and 2.18 and means 2.16 and 2.17"
        row = claim("poles and zeros", "interlaced", interlaced(of, full), "not interlaced", note)
    elif full:
        row = claim(
            "zeros",
            "nonminimum phase zeros",
            right[0] > 0,
            "none",
            f"{right[0]} of {right[1]} in the right half plane",
        )
    else:
        moved = {each.text: moved_zeros(each) for each in (HUB, TIP, ACROSS)}
        row = claim(
            "zeros changed most by the reduction",
            of.text,
            max(moved, key=lambda text: moved[text]) == of.text,
            max(moved, key=lambda text: moved[text]),
            "largest distance from a zero of the full structure, relative: "
            + ", ".join(f"{100 * value:.0f} % ({text})" for text, value in moved.items()),
        )
    return judged(
        f"Poles and zeros of {of.text} for {_MODELS[full]} without damping, upper half plane."
        + _far(of, full),
        (row,),
        _maps(of, full),
        2,
    )


def _far(of: Transfer, full: bool) -> str:
    """What stands beyond the edge of a map."""
    missing = roots(of, full)[1].size - 1 - right_half(of, full)[1]
    if not missing:
        return ""
    return (
        f" {missing} more pairs of zeros lie so far beyond all poles that they are at infinity to the last digit; "
        "modal damping brings them in and moves the zeros off the axis above some 100 Hz."
    )


def moved_zeros(of: Transfer) -> float:
    """Largest relative distance of a zero of Model#1 from the nearest one of the full structure."""
    full, reduced = (roots(of, which)[0] for which in (True, False))
    return float(max(np.abs(full - zero).min() / np.abs(zero) for zero in reduced))


def _maps(of: Transfer, full: bool) -> tuple[Panel, ...]:
    """Everything, and the low frequencies magnified."""
    zeros, frequencies = roots(of, full)
    reach, top = (
        1.1 * float(values.max()) for values in (np.abs(zeros.real), np.append(zeros.imag, frequencies))
    )
    reach = max(reach, 0.02 * top)
    windows = ((reach, top), (min(reach, _LOW), _LOW)) if full else ((reach, top),)

    def curve(points: ComplexArray, label: str, style: Style, window: tuple[float, float]) -> Curve:
        seen = points[(np.abs(points.real) <= window[0]) & (points.imag >= 0) & (points.imag <= window[1])]
        return Curve(np.real(seen), np.imag(seen), label, style)

    return tuple(
        Panel(
            "Real part [Hz]",
            "Imaginary part [Hz]",
            (curve(1j * frequencies, "poles", "crosses", window), curve(zeros, "zeros", "points", window)),
            x_range=(-window[0], window[0]),
            y_range=(-0.02 * window[1], window[1]),
            marks=(Mark(x=0.0),),
            wide=len(windows) == 1,
        )
        for window in windows
    )


def separation(of: Transfer, full: bool) -> Array:
    """β_k of each elastic mode [-]."""
    return collocated_separation(of.expansion(full))


def separations(of: Transfer) -> Reproduction:
    """Figures 2.19 and 2.20."""
    beta = separation(of, True)
    return judged(
        f"β_k = ω_k/Ω_k of {of.text} for the {beta.size} elastic modes of the 61-dof structure; at one, pole and zero "
        "cancel.",
        (
            claim(
                "β_k (section 3.2: appendage modes exclusively)",
                "above one for every mode",
                bool(np.all(beta > 1)),
                f"{np.count_nonzero(beta <= 1)} modes at one or below",
                f"β_k − 1 from {np.min(beta - 1):.1e} to {np.max(beta - 1):.2f}",
            ),
        ),
        (
            _separation_panel({"": (beta, "points")}),
            Panel(
                "Elastic mode",
                "β_k − 1 [-]",
                (Curve(np.arange(1.0, beta.size + 1), beta - 1, "", "points"),),
                y_scale="log",
                wide=True,
            ),
        ),
    )


def compared_separations(of: Transfer) -> Reproduction:
    """Figures 2.25 and 2.26."""
    full, reduced = separation(of, True), separation(of, False)
    count = reduced.size
    first = min(_FIRST, count)
    return judged(
        f"β_k = ω_k/Ω_k of {of.text} for the elastic modes of Model#1, beside those of the 61-dof structure.",
        (
            claim(
                "pole-zero separation of the first few elastic modes in the reduced model",
                "underestimated",
                bool(np.all(reduced[:first] < full[:first])),
                "not underestimated",
                f"β_k of six modes {_list(reduced)}; of sixty {_list(full[:count])}",
            ),
        ),
        (
            _separation_panel(
                {"60 elastic modes": (full[:count], "crosses"), "6 elastic modes": (reduced, "points")}
            ),
        ),
    )


def _separation_panel(curves: dict[str, tuple[Array, Style]]) -> Panel:
    return Panel(
        "Elastic mode",
        "Pole-zero separation β_k [-]",
        tuple(Curve(np.arange(1.0, b.size + 1), b, name, style) for name, (b, style) in curves.items()),
        marks=(Mark(y=1.0),),
        wide=True,
    )


def _list(values: Array) -> str:
    return ", ".join(f"{v:.3f}" for v in values)


def _entries(of: Transfer, name: str, number: int) -> Iterator[Entry]:
    """Figures of one transfer function; `number` tells it from the other two."""
    for first, full in ((13, True), (21, False)):
        title = f"Frequency response, {name}, {_MODELS[full]}"
        yield Entry(f"figure-2.{first + number}", title, partial(frequency_response, of, full))
    yield Entry(
        f"figure-2.{16 + number}", f"Poles and zeros, {name}, 61 dof", partial(pole_zero_map, of, True)
    )
    if of is ACROSS:
        yield Entry("figure-2.24", f"Poles and zeros, {name}, Model#1", partial(pole_zero_map, of, False))
    else:
        title = f"Pole-zero separation, {name}, "
        yield Entry(f"figure-2.{19 + number}", title + "61 dof", partial(separations, of))
        yield Entry(
            f"figure-2.{25 + number}", title + "Model#1 and 61 dof", partial(compared_separations, of)
        )


ENTRIES = (
    *_entries(HUB, "hub rotation per hub torque", 0),
    *_entries(TIP, "tip rotation per tip torque", 1),
    *_entries(ACROSS, "tip rotation per hub torque", 2),
)
