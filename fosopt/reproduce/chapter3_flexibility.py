"""Chapter 3, structural flexibility: table 3.3, figures 3.1, 3.3 and 3.11."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fosopt.control import PID, Loop, closed_loop_poles, modal_matrices
from fosopt.metrics.flexibility import (
    FlexibilityType,
    SingleModeExpansions,
    reaction_flexibility,
    rigid_body_flexibility,
)
from fosopt.ops import Array
from fosopt.plant import ModalExpansion, coupled_expansion, modal_expansion
from fosopt.reproduce import chapter3_system as system
from fosopt.reproduce.chapter3_system import FREQUENCIES, GIVEN, MIRROR, SUPPORT_MASS, case
from fosopt.reproduce.entry import Comparison, Curve, Entry, Mark, Panel, Reproduction
from fosopt.reproduce.judge import agrees, claim, judged
from fosopt.reproduce.published import PUBLISHED
from fosopt.units import HZ

_RATIOS = np.geomspace(1e-2, 10, 121)
_SOFT, _STIFF = FREQUENCIES[0], FREQUENCIES[2]  # supports of figure 3.11 [Hz]


@dataclass(frozen=True)
class Divergence:
    """Modes of the actuated mass on its support as its mass grows, frequencies apart fixed.

    Attributes
    ----------
    ratio
        (m,) actuated mass over that of the support.
    frequency, damping
        (m, 2) of the structure's mode and of the actuated mass's [Hz], [-].
    """

    ratio: Array
    frequency: Array
    damping: Array


def divergence(structure_hz: float, ratios: Array) -> Divergence:
    """Frequencies and damping ratios of both elastic modes at each mass ratio.    [Barker1991] Eq. (3.24)"""
    modes = system.support(structure_hz).modal_set(system.FREE, system.DAMPING, system.PORTS)
    poles = []
    for ratio in ratios:
        mirror = replace(MIRROR, inertia=float(ratio) * SUPPORT_MASS)
        found = closed_loop_poles(Loop(mirror, PID(0.0, 0.0, 0.0, 0.0)), modes, "tip").value
        found = found[np.argsort(np.abs(found))]
        # The lower mode is the actuated mass's where its spring is the softer one.
        poles.append(found if structure_hz <= GIVEN["actuator_frequency_hz"] else found[::-1])
    every = np.array(poles)
    return Divergence(ratios, np.abs(every) / HZ, -every.real / np.abs(every))


def _factor(structure_hz: float, ratio: float) -> float:
    """Frequency of the mode that the actuated mass dominates over its own on a rigid support."""
    return float(divergence(structure_hz, np.array([ratio])).frequency[0, 1]) / GIVEN["actuator_frequency_hz"]


def tip_mass() -> Reproduction:
    """Figure 3.11: effect of the actuated mass on frequencies and damping."""
    said = PUBLISHED["section_3_3"]
    share = said["actuated_share"]
    ratio = share / (1 - share)
    found = {f"support at {hz:g} Hz": divergence(hz, _RATIOS) for hz in (_SOFT, _STIFF)}
    soft = next(iter(found.values()))
    factors = {hz: _factor(hz, ratio) for hz in FREQUENCIES}
    nearest = min(FREQUENCIES, key=lambda hz: abs(factors[hz] - said["frequency_factor"]))

    def parts(of: Array) -> bool:
        return bool(np.all(np.diff(np.log(of[:, 1] / of[:, 0])) > 0))

    rows = (
        claim(
            "mode frequencies, as the actuated mass grows",
            "diverge",
            parts(soft.frequency),
            "do not diverge",
            f"support at {_SOFT:g} Hz",
        ),
        claim("damping ratios", "diverge", parts(soft.damping), "do not diverge", f"support at {_SOFT:g} Hz"),
        Comparison("mass ratio at 70 % of the total mass", GIVEN["mass_ratio_stated"], ratio, "", "0.7/0.3"),
        Comparison(
            f"factor on the frequency of the actuated mass at {100 * share:g} %",
            said["frequency_factor"],
            factors[nearest],
            "",
            f"the nearest, support at {nearest:g} Hz; the text says 'nearly' and not at which support",
        ),
        *(
            Comparison(f"the same, support at {hz:g} Hz", None, factors[hz])
            for hz in FREQUENCIES
            if hz != nearest
        ),
        Comparison(
            f"the same, support at {_SOFT:g} Hz, masses of section 3.4",
            None,
            _factor(_SOFT, GIVEN["actuated_mass"] / SUPPORT_MASS),
            "",
            f"mass ratio {GIVEN['actuated_mass'] / SUPPORT_MASS:.3f}",
        ),
    )

    def panel(label: str, values: str, unit: Array) -> Panel:
        curves = tuple(
            Curve(of.ratio, getattr(of, values)[:, k] / unit[k, n], f"{mode}, {name}")
            for n, (name, of) in enumerate(found.items())
            for k, mode in ((1, "actuated mass"), (0, "structure"))
        )
        return Panel(
            "Mass ratio µ [-]",
            label,
            curves,
            x_scale="log",
            y_scale="log",
            marks=(Mark(f"µ = {GIVEN['mass_ratio_stated']}", x=ratio),),
            wide=True,
        )

    own = GIVEN["actuator_frequency_hz"]
    apart = np.array([[_SOFT, _STIFF], [own, own]])
    return judged(
        f"Support of two equal masses, {SUPPORT_MASS:.2f} together; the actuated mass grows, frequencies apart stay "
        f"({GIVEN['actuator_frequency_hz']:g} Hz and that of the support). No controller.",
        rows,
        (
            panel("Frequency ratio [-]", "frequency", apart),
            panel("Damping ratio [%]", "damping", np.full((2, 2), 1e-2)),
        ),
        differs="the text does not say at which support frequency the factor holds. It is "
        f"{factors[_SOFT]:.2f} on a soft support, more when both frequencies meet, and {factors[FREQUENCIES[3]]:.2f} "
        f"on a stiff one; none gives {said['frequency_factor']}.",
    )


def table_3_3() -> Reproduction:
    """Flexibility parameters and types of the four cases."""
    printed = PUBLISHED["table_3_3"]
    rows = []
    for k in range(len(FREQUENCIES)):
        of = case(k + 1).model
        found = reaction_flexibility(coupled_expansion(modal_matrices(of.loop, of.modes, of.mirror_port)))
        rows += [
            Comparison(f"case {k + 1}, φ_a/(φ_a + φ_k)", printed["participation"][k], float(found.ratio[0])),
            Comparison(f"case {k + 1}, α_k", printed["alpha"][k], float(found.participation[0])),
            Comparison(f"case {k + 1}, type", printed["type"][k], str(found.types[0])),
        ]
    apart = [row for row in rows if not agrees(row)]
    return judged(
        f"{system.FLEXIBLE}, without damping. φ_a and φ_k are the residues of the mode of the actuated mass and of the "
        "structure's; mode a is the one with the larger residue.",
        rows,
        differs=f"{len(rows) - len(apart)} of {len(rows)} rows agree to the printed digits. "
        + "; ".join(f"{row.what} is {row.computed:.5f}, printed {row.published:.4f}" for row in apart)
        + ". A last digit cut off instead of rounded explains the latter, nothing the former; α_k of both agrees.",
    )


# --- pole-zero patterns


def _rigid_body_pattern(participation: float) -> SingleModeExpansions:
    """Unit inertia and one mode at unit frequency with the given α."""
    residue = np.array([1.0, participation - 1])
    return rigid_body_flexibility(
        ModalExpansion(np.array([0.0, 1.0]), np.zeros(2), residue, np.array([True, False]))
    )


def _reaction_pattern(mode: float, ratio: float) -> SingleModeExpansions:
    """Actuator at unit frequency and one mode, with the given φ_a/(φ_a + φ_k)."""
    residue = np.array([1.0, 1 / ratio - 1])
    return reaction_flexibility(
        ModalExpansion(np.array([1.0, mode]), np.zeros(2), residue, np.zeros(2, bool)), 0
    )


def _pattern_panel(of: SingleModeExpansions, title: str, reach: float) -> Panel:
    """Poles and zeros of a single-mode expansion."""

    def pair(frequency: float, label: str) -> Curve:
        return Curve(np.zeros(2), np.array([frequency, -frequency]), label, "crosses")

    zeros = of.zeros[0]
    return Panel(
        "Real part [-]",
        "Imaginary part [-]",
        (
            pair(of.actuator_frequency, "rigid body" if of.actuator is None else "actuator"),
            pair(float(of.natural_frequency[0]), "flexible mode"),
            Curve(np.real(zeros), np.imag(zeros), "zeros", "points"),
        ),
        title,
        x_range=(-reach, reach),
        y_range=(-reach, reach),
        marks=(Mark(x=0.0), Mark(y=0.0)),
        equal=True,
    )


def rigid_body_patterns() -> Reproduction:
    """Figure 3.1: flexibility types of rigid-body control."""
    chosen = {2.0: "α > 1", 0.5: "0 < α < 1", -0.5: "α < 0"}
    says = {
        FlexibilityType.APPENDAGE: "zero on the imaginary axis, below its pole",
        FlexibilityType.IN_THE_LOOP_MINIMUM_PHASE: "zero on the imaginary axis, above its pole",
        FlexibilityType.IN_THE_LOOP_NONMINIMUM_PHASE: "zero in the right half plane",
    }
    rows, panels = [], []
    for (alpha, where), (kind, said) in zip(chosen.items(), says.items(), strict=True):
        of = _rigid_body_pattern(alpha)
        zero = of.zeros[0][np.argmax(of.zeros[0].real)]
        found = says[FlexibilityType.IN_THE_LOOP_NONMINIMUM_PHASE]
        if zero.real == 0:
            below = abs(zero) < of.natural_frequency[0]
            found = f"zero on the imaginary axis, {'below' if below else 'above'} its pole"
        rows += [
            Comparison(f"{where}, type", kind.value, str(of.types[0])),
            Comparison(f"{where}, zero", said, found),
        ]
        panels.append(_pattern_panel(of, f"{str(of.types[0]).capitalize()}, {where}", 2.2))
    support = case(1).model.modes
    for sensor, what, kind in (
        ("tip", "collocated benchmark problem (Eq. 3.19)", FlexibilityType.APPENDAGE),
        ("hub", "non-collocated benchmark problem (Eq. 3.18)", FlexibilityType.DEGENERATE),
    ):
        of = rigid_body_flexibility(modal_expansion(support, sensor, "tip"))
        rows.append(Comparison(what, kind.value, str(of.types[0]), note=f"α_2 = {of.participation[0]:.3g}"))
    return judged(
        "Single-mode models of unit inertia and unit frequency without damping, one of each type; the values of α are "
        "chosen here.",
        rows,
        panels,
        3,
    )


def reaction_patterns() -> Reproduction:
    """Figure 3.3: flexibility types of reaction-actuator control."""
    kinds = (
        FlexibilityType.APPENDAGE,
        FlexibilityType.IN_THE_LOOP_MINIMUM_PHASE,
        FlexibilityType.IN_THE_LOOP_NONMINIMUM_PHASE,
    )
    # The mode above and below the actuator; ratios that give the three types.
    chosen = {2.0: (0.5, 1.5, -0.6), 0.5: (1.15, 0.5, 1.6)}
    panels = []
    for mode, drawn in chosen.items():
        for ratio in drawn:
            of = _reaction_pattern(mode, ratio)
            title = f"{str(of.types[0]).capitalize()}, case {of.patterns[0].case}"
            panels.append(_pattern_panel(of, title, 2.8))
    ratios = np.concatenate(
        [np.linspace(-3, -0.01, 300), np.linspace(0.01, 0.99, 99), np.linspace(1.01, 3, 300)]
    )
    every = [(mode, ratio, _reaction_pattern(mode, ratio)) for mode in chosen for ratio in ratios]
    kinds_found = {(mode, str(of.types[0])) for mode, _, of in every}
    patterns = {of.patterns[0] for _, _, of in every}
    inside = [(mode, of) for mode, ratio, of in every if 0 < ratio < 1]
    rows = (
        claim(
            "variations of the three types, with the actuator below and above the mode",
            "six",
            len(kinds_found) == 6,
            str(len(kinds_found)),
        ),
        Comparison(
            "patterns told apart by case, type and order",
            None,
            len(patterns),
            note="cases II and III each hold an appendage mode beside the nonminimum phase one",
        ),
        claim(
            "ratio between zero and one (Eq. 3.14)",
            "strictly minimum phase",
            all(of.types[0] != kinds[2] for _, of in inside),
            "not always minimum phase",
        ),
        *(
            claim(
                f"and the mode {side} the actuator (Eq. {equation})",
                kind.value,
                all(
                    of.types[0] == kind and of.patterns[0].order == order for mode, of in inside if mode == at
                ),
                "another type",
                f"order: {', '.join(order)}",
            )
            for side, at, equation, kind, order in (
                ("above", 2.0, "3.16", kinds[0], ("actuator", "zero", "mode")),
                ("below", 0.5, "3.15", kinds[1], ("mode", "zero", "actuator")),
            )
        ),
    )
    return judged(
        "Single-mode models of an actuator at unit frequency and a mode at twice and at half of it, without damping; "
        "residues of all ratios were tried, those drawn are chosen here.",
        rows,
        panels,
        3,
    )


ENTRIES = (
    Entry("table-3.3", "Structural flexibility of cases 1 to 4", table_3_3),
    Entry("figure-3.1", "Pole-zero patterns of rigid-body control", rigid_body_patterns),
    Entry("figure-3.3", "Pole-zero patterns of reaction-actuator control", reaction_patterns),
    Entry("figure-3.11", "Effect of the actuated mass on frequencies and damping", tip_mass),
)
