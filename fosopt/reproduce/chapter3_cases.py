"""Chapter 3, cases 1 to 4 in frequency and in the s-plane: figures 3.19 to 3.39 but for the ten engagements."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from fosopt.control import modal_matrices
from fosopt.metrics.margins import crossover
from fosopt.metrics.nyquist import encirclements
from fosopt.plant import coupled_modes
from fosopt.plant.zeros import modal_poles, plant_zeros
from fosopt.reproduce import chapter3_system as system
from fosopt.reproduce.bode import bode_panels
from fosopt.reproduce.chapter3_panels import locus_panel, magnified_locus, magnitude_panel, nyquist_panel
from fosopt.reproduce.chapter3_rigid import crossover_row
from fosopt.reproduce.chapter3_system import FLEXIBLE, REQUIRED, RETARGETING, UDU, Case, case, smd
from fosopt.reproduce.entry import Comparison, Entry, Reproduction
from fosopt.reproduce.judge import claim, judged
from fosopt.units import HZ

_BAND_HZ = (0.1, 1e3)
_COARSE = 200  # points of a plot made by the custom of the time
_NEAR_DB, _ALIKE = 1.0, 0.05  # what counts as near a maximum, and as no significant difference
_MASS_RATIOS = (0.5, 1.0, 2.0, 4.0)
_RATIOS = ", ".join(f"{ratio:g}" for ratio in _MASS_RATIOS)
_EQUAL = 1e-10
_ABOUT = {1: (0.7, 1.1), 2: (9.0, 11.0)}  # where cases 1 and 2 may become unstable [Hz]


def _said(number: int) -> str:
    return f"{FLEXIBLE}, {system.FREQUENCIES[number - 1]:g} Hz (case {number})."


def _decibels(values: np.ndarray) -> np.ndarray:
    return 20 * np.log10(np.abs(values))


# --- forward loops


def _zeros_stay(of: Case) -> Comparison:
    """Whether the zeros of the plant are the poles of the support, at every actuated mass."""
    support = modal_poles(of.model.modes)
    gaps = []
    for ratio in _MASS_RATIOS:
        mirror = replace(of.model.loop.mirror, inertia=ratio * system.SUPPORT_MASS)
        zeros = plant_zeros(modal_matrices(replace(of.model.loop, mirror=mirror), of.model.modes, "tip"))
        gaps.append(float(np.abs(zeros[-2:] / support[-2:] - 1).max()))
    return claim(
        "zeros of the plant",
        "the poles of the support",
        max(gaps) < _EQUAL,
        "not the poles of the support",
        f"{max(gaps):.0e} apart at most (relative), at mass ratios {_RATIOS}",
    )


def _separation_grows(of: Case) -> Comparison:
    """Whether pole and zero part as the actuated mass grows."""
    found = []
    for ratio in _MASS_RATIOS:
        mirror = replace(of.model.loop.mirror, inertia=ratio * system.SUPPORT_MASS)
        coupled = coupled_modes(of.model.modes, mirror, "tip")
        found.append(abs(float(np.delete(coupled.separation, coupled.mirror_mode)[-1])))
    return claim(
        "a larger mass ratio",
        "wider pole-zero separation",
        bool(np.all(np.diff(found) > 0)),
        "no wider pole-zero separation",
        "|α − 1| = " + ", ".join(f"{x:.3f}" for x in found) + f" at mass ratios {_RATIOS}",
    )


def _coarse_plot(of: Case) -> Comparison:
    """What the magnitude plot shows at the customary spacing of points."""
    coarse = np.geomspace(*_BAND_HZ, _COARSE) * HZ
    about = (coarse > 0.5 * HZ * of.structure_hz) & (coarse < 2 * HZ * of.structure_hz)
    least = float(_decibels(of.loop_gain(coarse[about])).min())
    return claim(
        "magnitude plot",
        "suggests a gain-stabilized mode",
        least > 0,
        "shows the loop gain below 0 dB",
        f"{_COARSE} points from {_BAND_HZ[0]:g} to {_BAND_HZ[1]:g} Hz miss the dip: {least:.0f} dB at least within "
        "an octave of it, where the plot of figure 3.30 goes below zero",
    )


def _appendage(of: Case) -> Comparison:
    coupled = coupled_modes(of.model.modes, of.model.loop.mirror, "tip")
    mode = coupled.mirror_mode + 1
    return claim(
        "flexibility",
        "appendage mode",
        bool(coupled.participation[mode] > 1),
        "in-the-loop mode",
        f"α = {coupled.participation[mode]:.4f}",
    )


def _below_crossover(of: Case) -> Comparison:
    top = crossover(of.model, of.poles)[0]
    modes = coupled_modes(of.model.modes, of.model.loop.mirror, "tip").natural_frequency
    return claim(
        "both elastic modes",
        "below the crossover",
        bool(modes.max() < top),
        "not below the crossover",
        f"{modes[1] / HZ:.1f} and {modes[2] / HZ:.1f} Hz, crossover {top / HZ:.1f} Hz",
    )


def _barely_seen(of: Case) -> Comparison:
    """How much of the forward loop the structure changes beyond the crossover of the rigid one."""
    grid = of.grid(2e2, 1e3, 4000)
    apart = np.abs(_decibels(of.loop_gain(grid) / smd().loop_gain(grid)))
    changed = grid[apart > 3.0]
    width = (changed.max() - changed.min()) / HZ if changed.size else 0.0
    return claim(
        "forward loop",
        "barely reveals the structural flexibility",
        width < 0.01 * of.structure_hz,
        "reveals the structural flexibility",
        f"more than 3 dB from the rigidly supported loop over {width:.2f} Hz only, {apart.max():.0f} dB at most",
    )


_FORWARD = {
    1: (_zeros_stay, _separation_grows),
    2: (_coarse_plot,),
    3: (_appendage, _below_crossover, crossover_row),
    4: (_barely_seen,),
}


def forward_loop(number: int) -> Reproduction:
    """Figures 3.19, 3.27, 3.34 and 3.38: forward loop."""
    of = case(number)
    return judged(
        f"{_said(number)} Phase by counting poles and zeros.",
        [row(of) for row in _FORWARD[number]],
        bode_panels([of.open_response(*_BAND_HZ)], "1", wide=False),
    )


def _at_dip(of: Case) -> float:
    """Least loop gain about the zero of the structure [dB]."""
    low, high = _ABOUT[int(of.name[-1])]
    return float(_decibels(of.loop_gain(of.grid(low, high, 4000))).min())


def magnified_loop(number: int) -> Reproduction:
    """Figures 3.22 and 3.30: forward loop about the potential instability."""
    of, least = case(number), _at_dip(case(number))
    row = (
        claim(
            "the flexible mode",
            "gain stabilized",
            least > 0 and of.stability == "stable",
            "not gain stabilized",
            f"the loop gain does not fall below {least:+.1f} dB where the phase goes through −180 degrees",
        )
        if number == 1
        else claim(
            "magnitude", "clear drop below 0 dB", least < -3, "no clear drop below 0 dB", f"{least:+.1f} dB"
        )
    )
    panels = bode_panels([of.open_response(*_ABOUT[number], 2000)], "1", wide=False)
    return judged(
        f"{_said(number)} Frequencies placed about pole and zero.",
        (row,),
        [replace(panel, x_scale="linear", x_range=_ABOUT[number]) for panel in panels],
    )


def nyquist(number: int) -> Reproduction:
    """Figures 3.23 and 3.31: Nyquist plot about the potential instability."""
    of = case(number)
    turns, least = encirclements(of.model, of.poles), _at_dip(of)
    counted = f"{turns} turns around −1"
    rows = (
        claim("closed loop", "stable", turns == 0, "unstable", counted)
        if number == 1
        else claim(
            "plot",
            "an unstable excursion through the unit circle",
            turns > 0 and least < 0,
            "no unstable excursion",
            f"{counted}, loop gain down to {least:+.1f} dB",
        ),
        claim("poles agree", of.stability, (turns == 0) == (of.stability == "stable"), "they do not"),
    )
    return judged(
        f"{_said(number)} Turns are counted on the whole plot; the part shown is that about the zero of the structure.",
        rows,
        (nyquist_panel(of, *_ABOUT[number], 4.0),),
    )


# --- root loci


def _crossings(of: Case) -> str:
    """Gains for which the structural branch is unstable, in words."""
    found = [f"{low:.3g} to {high:.3g}" for low, high in of.locus.unstable_gains(of.structural_branch)]
    return f"unstable from K = {' and '.join(found)}" if found else "stable at every gain"


def _may_be_unstable(of: Case) -> tuple[Comparison, ...]:
    branch = of.structural_branch.real
    return (
        claim(
            "flexible mode", "potentially unstable", branch.max() > 0, "stable at every gain", _crossings(of)
        ),
        claim(
            "at the published gain",
            "stable",
            branch[-1] < 0,
            "unstable",
            f"decays by {-branch[-1]:.4f} /s",
        ),
    )


def _slowly_unstable(of: Case) -> tuple[Comparison, ...]:
    growth = float(of.structural_branch[-1].real)
    sequence, doubling = RETARGETING.count * RETARGETING.period, np.log(2) / growth
    return (
        claim("flexible mode", "unstable", growth > 0, "stable", f"grows by {growth:+.3f} /s"),
        claim(
            "instability",
            "slow",
            doubling > sequence,
            "fast",
            f"doubles in {doubling:.1f} s, where ten engagements take {sequence:g} s",
        ),
    )


def _always_stable(of: Case) -> tuple[Comparison, ...]:
    branch = of.structural_branch.real
    return (
        claim(
            "flexible mode",
            "stable at every gain",
            bool(branch.max() < 0),
            _crossings(of),
            f"decays by {-branch[-1]:.2f} /s at the published gain",
        ),
    )


def _vibrates(of: Case) -> tuple[Comparison, ...]:
    """Residual vibration in the first window against the jitter that is allowed."""
    rms, allowed = float(of.engagements.rms[0]) / UDU, REQUIRED["jitter_total_udu"]
    return (
        *_always_stable(of),
        claim(
            "it induces",
            "significant output vibration",
            rms > allowed,
            "no significant output vibration",
            f"{rms:.0f} µdu rms in the first window, where {allowed:.0f} are allowed",
        ),
    )


def _gain_stabilized(of: Case) -> tuple[Comparison, ...]:
    """Beyond the crossover: stable by gain and by phase (section 3.5)."""
    grid = of.grid(0.8 * of.structure_hz, 1.2 * of.structure_hz, 400)
    most = float(_decibels(of.loop_gain(grid)).max())
    return (
        *_always_stable(of),
        claim(
            "mode beyond the crossover",
            "gain stabilized",
            most < 0,
            "not gain stabilized",
            f"loop gain {most:.1f} dB at most within 20 % of its frequency",
        ),
    )


_LOCUS = {1: _may_be_unstable, 2: _slowly_unstable, 3: _vibrates, 4: _gain_stabilized}


def root_loci(number: int, magnified: bool) -> Reproduction:
    """Figures 3.20, 3.21, 3.28, 3.29, 3.35 and 3.39: root locus, whole or about the structural mode."""
    of = case(number)
    return judged(
        f"{_said(number)} Closed-loop poles at gains from zero to K, joined branch by branch.",
        _LOCUS[number](of),
        (magnified_locus(of) if magnified else locus_panel(of, None, None),),
    )


# --- closed loops


def _resonance(of: Case) -> tuple[Comparison, ...]:
    grid = of.grid(0.8 * of.structure_hz, 1.2 * of.structure_hz, 400)
    size, rigid = np.abs(of.closed("command", grid)), np.abs(smd().closed("command", grid))
    return (
        Comparison(
            "command response at the structural resonance",
            None,
            float(size.max()),
            "",
            f"{rigid.max():.3f} on the rigid support",
        ),
    )


def _near_maximum(of: Case) -> tuple[Comparison, ...]:
    rigid = np.abs(smd().closed("command", smd().grid(*_BAND_HZ)))
    at = float(np.abs(smd().closed("command", np.array([of.structure_hz * HZ])))[0])
    below = 20 * np.log10(rigid.max() / at)
    return (
        claim(
            "structural resonance on the magnitude of the command response",
            "at a point of near maximum amplification",
            below < _NEAR_DB,
            "away from the maximum",
            f"{at:.3f} there, {rigid.max():.3f} at most: {below:.2f} dB below",
        ),
        *_resonance(of),
    )


def closed_loop(number: int) -> Reproduction:
    """Figures 3.24, 3.32 and 3.36: command response against that of the rigid support."""
    of = case(number)
    return judged(
        f"{_said(number)} Output per command, and the same on the rigid support. "
        "An unstable pair of poles and the zeros beside it lift the phase by a full turn."
        if of.stability == "unstable"
        else f"{_said(number)} Output per command, and the same on the rigid support.",
        _near_maximum(of) if number == 3 else _resonance(of),
        bode_panels([of.command_response(*_BAND_HZ), smd().command_response(*_BAND_HZ)], "1", wide=False),
    )


def sensitivities() -> Reproduction:
    """Figure 3.26: three sensitivities of case 1 against those of the rigid support."""
    of, low = case(1), np.array([system.FREQUENCIES[0] * HZ])
    more = float(_decibels(of.closed("mirror_torque", low) / smd().closed("mirror_torque", low))[0])
    rows = [
        claim(
            "low-frequency flexible mode",
            "amplifies the force disturbance",
            more > 0,
            "does not amplify it",
            f"{more:+.0f} dB at {system.FREQUENCIES[0]:g} Hz against the rigid support",
        )
    ]
    for source in ("displacement", "noise"):
        given = [system.disturbance(source)]
        ratio = float(of.rms(given)[0] / smd().rms(given)[0])
        rows.append(
            claim(
                f"jitter from {source}",
                "not significantly different from the rigid support's",
                abs(ratio - 1) < _ALIKE,
                "significantly different",
                f"{100 * (ratio - 1):+.1f} %",
            )
        )
    names = (
        ("mirror_torque", "1 du/force", "Input sensitivity"),
        ("line_of_sight", "1", "Output sensitivity"),
        ("command", "1", "Complementary sensitivity"),
    )
    return judged(
        f"{_said(1)} Output per force on the mass, per displacement and per measurement noise.",
        rows,
        [magnitude_panel([of, smd()], name, unit, *_BAND_HZ, title) for name, unit, title in names],
    )


ENTRIES = (
    *(
        Entry(f"figure-3.{n}", f"Forward loop, case {k}", partial(forward_loop, k))
        for n, k in ((19, 1), (27, 2), (34, 3), (38, 4))
    ),
    *(
        Entry(f"figure-3.{n}", f"Root locus, case {k}", partial(root_loci, k, False))
        for n, k in ((20, 1), (28, 2))
    ),
    *(
        Entry(
            f"figure-3.{n}",
            f"Root locus about the structural mode, case {k}",
            partial(root_loci, k, True),
        )
        for n, k in ((21, 1), (29, 2), (35, 3), (39, 4))
    ),
    *(
        Entry(
            f"figure-3.{n}",
            f"Forward loop about the possible instability, case {k}",
            partial(magnified_loop, k),
        )
        for n, k in ((22, 1), (30, 2))
    ),
    *(
        Entry(f"figure-3.{n}", f"Nyquist plot about the possible instability, case {k}", partial(nyquist, k))
        for n, k in ((23, 1), (31, 2))
    ),
    *(
        Entry(f"figure-3.{n}", f"Closed loop against the rigid support's, case {k}", partial(closed_loop, k))
        for n, k in ((24, 1), (32, 2), (36, 3))
    ),
    Entry("figure-3.26", "Sensitivities against the rigid support's, case 1", sensitivities),
)
