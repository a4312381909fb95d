"""Chapter 4, modes of mirror and structure: figures 4.1 to 4.9."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fosopt.metrics.inertias import modal_inertia, reference_inertia
from fosopt.ops import Array
from fosopt.plant import CoupledModes
from fosopt.plant.expansion import ModalExpansion
from fosopt.plant.zeros import expansion_zeros
from fosopt.reproduce import chapter4_system as system
from fosopt.reproduce.chapter4_system import CHAPTER, PERCENTS
from fosopt.reproduce.entry import Comparison, Curve, Entry, Panel, Reproduction, Style
from fosopt.reproduce.judge import claim, judged
from fosopt.units import HZ

_SMALL = (
    1.0  # mirror inertia below which the text calls coupling small: where it speaks of the fifth mode [%]
)
_SEPARATED = 0.01  # a pole this far from its zero (relative) counts as separated
_SUM, _SAME = 1e-12, 1e-10
_LARGE = 1e6  # a mirror inertia for the limit [%]
# What the text says about the ratio of mirror and reference inertia, and one unit of the last digit it gives.
_ABOUT = {
    PERCENTS[0]: (CHAPTER["mirror_inertia_0_002_percent_over_reference_inertia"], 0.01),
    PERCENTS[-1]: (CHAPTER["mirror_inertia_20_percent_over_reference_inertia"], 100.0),
}


def separation_and_inertia(percent: float) -> Reproduction:
    """Figures 4.1 to 4.8: pole-zero separation and effective modal reaction inertia, mode by mode."""
    modes = system.coupled(percent)
    share = modes.effective_modal_reaction_inertia
    number = np.arange(1.0, share.size + 1)
    paired = np.isfinite(modes.zero)
    rises = paired & (modes.separation > 0)
    x_range = (0.0, share.size + 1.0)
    sides: tuple[tuple[str, Style, NDArray[np.bool_]], ...] = (
        ("pole above its zero", "points", rises),
        ("pole below its zero", "crosses", paired & ~rises),
    )
    top = Panel(
        "Mode number",
        "|1 − β_k|",
        tuple(
            Curve(number[side], np.abs(modes.one_minus_separation[side]), label, style)
            for label, style, side in sides
        ),
        y_scale="log",
        x_range=x_range,
        y_range=(1e-12, 1.0),
        wide=True,
    )
    bottom = Panel(
        "Mode number",
        "J̄_k",
        (
            Curve(number[share > 0], share[share > 0], style="stems"),
            Curve(number[[modes.mirror_mode]], share[[modes.mirror_mode]], "mirror mode", "squares"),
        ),
        y_scale="log",
        x_range=x_range,
        y_range=(1e-11, 3.0),
        wide=True,
    )
    return judged(
        f"All {share.size} modes of the undamped system by its secular equation, the mirror's inertia "
        f"{percent:g} % of the truss's about the hub. The dissertation's form is not known: separation |1 − β_k| and "
        "inertia J̄_k stand above each other on logarithmic axes, as the smallest are nine decades below the largest. "
        "The rigid-body mode has neither, the mirror mode no zero of its own.",
        _statements(percent, modes),
        (top, bottom),
    )


def _statements(percent: float, modes: CoupledModes) -> tuple[Comparison, ...]:
    share, largest = (
        modes.effective_modal_reaction_inertia,
        int(np.argmax(modes.effective_modal_reaction_inertia)),
    )
    rows = [
        _reference_inertia(percent),
        claim(
            "Σ J̄_k", "one", abs(share.sum() - 1) <= _SUM, f"{share.sum()}", f"off by {share.sum() - 1:.1g}"
        ),
        claim("J̄_k of the first, rigid-body mode", "zero", share[0] == 0, f"{share[0]:.3g}"),
        Comparison(
            "mode with the largest J̄_k",
            CHAPTER["mirror_mode_number"] if percent < _SMALL else None,
            largest + 1,
            note=f"J̄_k = {share[largest]:.4f} at {modes.natural_frequency[largest] / HZ:.2f} Hz",
        ),
        _zeros(modes),
        *_directions(modes),
        *_against_smaller(percent, modes),
        _relation(modes),
    ]
    if percent == PERCENTS[0]:
        rows.append(
            claim(
                "J̄_k of the mirror mode",
                "nearly unity",
                round(share[largest], 1) == 1,
                f"{share[largest]:.3f}",
                f"{share[largest]:.4f}",
            )
        )
    if percent == PERCENTS[-1]:
        limit = system.coupled(_LARGE).effective_modal_reaction_inertia[-1]
        rows.append(
            claim(
                "J̄_k of the last mode as the inertia grows",
                "goes to unity",
                share[-1] > system.coupled(PERCENTS[-2]).effective_modal_reaction_inertia[-1]
                and round(limit, 3) == 1,
                f"goes to {limit:.4f}",
                f"{share[-1]:.3f} here, {limit:.6f} at {_LARGE:g} %",
            )
        )
    if system.growing(percent, "full") and not system.growing(PERCENTS[PERCENTS.index(percent) - 1], "full"):
        rows.append(
            claim(
                "instability before the last J̄_k reaches unity",
                "occurs",
                share[-1] < 1,
                "does not occur",
                f"here J̄_k of the last mode is {share[-1]:.1g}; {system.growth(percent, 'full')}",
            )
        )
    return tuple(rows)


def _reference_inertia(percent: float) -> Comparison:
    """Mirror inertia over reference inertia, and whether it is what the text calls it."""
    ratio = float(system.mirror(percent).inertia / reference_inertia(system.support(), "tip"))
    if percent not in _ABOUT:
        return Comparison("J_m/J_ref", None, ratio)
    said, unit = _ABOUT[percent]
    return claim(
        "J_m/J_ref",
        f"about {said:g}",
        abs(ratio - said) <= unit,
        f"{ratio:.4g}",
        f"{ratio:.4g}, {100 * (ratio / said - 1):+.1f} %; 'about' is read as one unit of the last digit given",
    )


def _zeros(modes: CoupledModes) -> Comparison:
    """Zeros of the sum over coupled modes, equation 4.10, against the poles of the uncoupled structure."""
    residue = modes.effective_modal_reaction_inertia
    still = residue == 0
    expansion = ModalExpansion(modes.natural_frequency, np.zeros(residue.size), residue, still)
    zeros = expansion_zeros(expansion)
    elastic = system.support().natural_frequency[1:]
    worst = np.abs(np.sort(zeros.imag[zeros.imag > 0]) / elastic - 1).max()
    return claim(
        "zeros of the mirror's transfer function",
        "poles of the uncoupled structure",
        worst <= _SAME,
        "not the poles of the uncoupled structure",
        f"the same to {worst:.1g} of each",
    )


def _directions(modes: CoupledModes) -> tuple[Comparison, ...]:
    """Whether poles below the mirror's frequency fall and those above it rise."""
    paired = np.isfinite(modes.zero)
    below = paired & (modes.zero < system.mirror(PERCENTS[0]).natural_frequency ** 2)
    rows = []
    for side, word, way, chosen in (("below", "fall", -1, below), ("above", "rise", 1, paired & ~below)):
        right = int(np.count_nonzero(way * modes.separation[chosen] > 0))
        count = int(np.count_nonzero(chosen))
        rows.append(
            claim(
                f"poles {side} the mirror's frequency",
                word,
                right == count,
                f"{count - right} do not",
                f"{right} of {count} modes",
            )
        )
    return tuple(rows)


def _against_smaller(percent: float, modes: CoupledModes) -> tuple[Comparison, ...]:
    """What has grown since the figure before."""
    if percent == PERCENTS[0]:
        return ()
    before = system.coupled(PERCENTS[PERCENTS.index(percent) - 1])
    grown = np.abs(modes.separation) > np.abs(before.separation)
    paired = np.isfinite(modes.zero)
    counts = [
        int(np.count_nonzero(np.abs(each.one_minus_separation) > _SEPARATED)) for each in (before, modes)
    ]
    return (
        claim(
            "pole-zero separation against the figure before",
            "larger",
            grown[paired].all(),
            f"smaller in {np.count_nonzero(paired & ~grown)} modes",
            f"in {np.count_nonzero(grown & paired)} of {np.count_nonzero(paired)} modes",
        ),
        claim(
            "number of separated modes against the figure before",
            "larger",
            counts[1] > counts[0],
            "not larger",
            f"{counts[1]} after {counts[0]} modes with |1 − β_k| above {_SEPARATED:g}",
        ),
    )


def _relation(modes: CoupledModes) -> Comparison:
    paired = np.isfinite(modes.zero)
    rank = stats.spearmanr(
        np.abs(modes.one_minus_separation[paired]), modes.effective_modal_reaction_inertia[paired]
    )
    return Comparison("rank correlation of |1 − β_k| and J̄_k", None, float(rank.statistic))


def susceptibility() -> Reproduction:
    """Figure 4.9: the reciprocal of the modal inertia of the uncoupled structure."""
    modes, smallest = system.support(), system.coupled(PERCENTS[0])
    reciprocal: Array = 1 / modal_inertia(modes, "tip")
    number = np.arange(1.0, reciprocal.size + 1)
    paired = np.isfinite(smallest.zero)
    reach = np.abs(smallest.separation * smallest.zero)[paired]
    elastic = reciprocal[~modes.rigid]
    low = np.argsort(elastic)[: elastic.size // 4]
    largest = int(np.argmax(reciprocal))
    return judged(
        "1/J̃_k of the 61 modes of the structure with the mirror's mass at its tip; they add up to 1/J_ref. The text "
        "has the mirror supported rigidly as J̃_k goes to zero; by equation 4.18, where J̃_k divides, it must go to "
        "infinity.",
        (
            Comparison("number of modes", system.STRUCTURE_DOF, reciprocal.size),
            claim(
                "modes with low 1/J̃_k",
                "not likely to be disturbed",
                reach[low].max() < np.median(reach),
                "disturbed",
                f"separation in ω² of the {low.size} lowest at most {reach[low].max() / np.median(reach):.2f} of the "
                f"median, at {PERCENTS[0]:g} %",
            ),
            Comparison(
                "rank correlation of 1/J̃_k and the separation in ω²",
                None,
                float(stats.spearmanr(elastic, reach).statistic),
                note=f"at {PERCENTS[0]:g} %",
            ),
            Comparison(
                "most susceptible mode",
                None,
                largest + 1,
                note=f"{modes.natural_frequency[largest] / HZ:.1f} Hz, just below 400 Hz as in figure 4.20",
            ),
        ),
        (
            Panel(
                "Mode number",
                "1/J̃_k [1/(kg m^2)]",
                (Curve(number, reciprocal, style="stems"),),
                x_range=(0.0, reciprocal.size + 1.0),
                wide=True,
            ),
        ),
    )


ENTRIES: tuple[Entry, ...] = (
    *(
        Entry(
            f"figure-4.{k + 1}",
            f"Pole-zero separation and effective modal reaction inertia, J_m = {percent:g} % J_truss",
            partial(separation_and_inertia, percent),
        )
        for k, percent in enumerate(PERCENTS)
    ),
    Entry(
        "figure-4.9",
        "Susceptibility of the uncoupled structure's modes to pole-zero separation",
        susceptibility,
    ),
)
