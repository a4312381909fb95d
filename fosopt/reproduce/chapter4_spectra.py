"""Chapter 4, spectra of the step response and inverse modal reaction inertias: figures 4.23 to 4.26."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy import signal, stats

from fosopt.metrics.bandwidth import closed_loop_bandwidth
from fosopt.metrics.transient import mean_exponential
from fosopt.ops import Array, ComplexArray
from fosopt.reproduce import chapter4_system as system
from fosopt.reproduce.chapter4_system import WINDOW, structural_lines
from fosopt.reproduce.entry import Comparison, Curve, Entry, Panel, Reproduction
from fosopt.reproduce.judge import claim, judged
from fosopt.units import HZ

# The record of the periodograms: it begins when the rms window opens, and all modes lie below half its rate.
RECORD_S, RATE_HZ = 1.0, 4096.0
_SPECTRA = (0.02, 2.0)
_MOST = 0.9  # share of the energy, or of the sum of inertias, that counts as most of it
_INSTANT = 1e-5  # of the step: shorter than any period [s]
_HERTZ = (0.0, 1200.0)
_NOT_WIDER = (
    "The resemblance to J̄_k is less reasonable, as the text has it, and J̄_k itself is spread over more modes (figure "
    "4.26). But energy is spread wider in the instant of the step only: at the larger inertia the loop damps the high "
    "modes, and what follows the step holds mostly low ones. The dissertation's record is not known."
)


def periodogram(percent: float) -> tuple[Array, Array]:
    """One-sided density of the residual from one finite record, no window, no average [Hz], [du²/Hz]."""
    time = WINDOW[0] + np.arange(int(RECORD_S * RATE_HZ)) / RATE_HZ
    frequency, density = signal.periodogram(system.residual(percent)(time), RATE_HZ)
    return frequency[1:], density[1:]


def resemblance(percent: float) -> float:
    """Rank correlation of the amplitudes of the structural modes in the step response with their J̄_k."""
    lines, inertia = structural_lines(percent)
    return float(stats.spearmanr(np.abs(system.residual(percent).amplitude[lines]), inertia).statistic)


def central(percent: float, start: float, end: float) -> tuple[float, float]:
    """Frequencies between which most of the energy of the structural modes lies, from one time to another [Hz]."""
    lines, _ = structural_lines(percent)
    of = system.residual(percent)
    growth: ComplexArray = 2 * of.pole[lines].real + 0j
    energy = np.abs(of.amplitude[lines]) ** 2 * mean_exponential(growth, start, end).real
    share = np.cumsum(energy) / np.sum(energy)
    edges = 0.5 * (1 - _MOST), 0.5 * (1 + _MOST)
    low, high = (float(of.pole[lines[np.searchsorted(share, edge)]].imag) / HZ for edge in edges)
    return low, high


def density(percent: float) -> Reproduction:
    """Figures 4.23 and 4.25: a crude power spectral density of the step response."""
    frequency, found = periodogram(percent)
    growing = system.growing(percent, "full")
    shown = (frequency > _HERTZ[0]) & (frequency < _HERTZ[1])
    panel = Panel(
        "Frequency [Hz]",
        "Power spectral density [du^2/Hz]",
        (Curve(frequency[shown], found[shown]),),
        y_scale="log",
        x_range=_HERTZ,
        wide=True,
    )
    unstable = (
        f" The loop is unstable ({system.growth(percent, 'full')}): the record shows the first "
        f"{RECORD_S:g} s of a response that grows without end, and its mean square is no jitter."
        if growing
        else ""
    )
    return judged(
        f"Periodogram of the residual of the 62-dof model, {percent:g} %: one record of {RECORD_S:g} s from the "
        f"opening of the rms window, sampled at {RATE_HZ:g} Hz, mean removed, no window, no average. The "
        f"dissertation's record is not known.{unstable}",
        _density_rows(percent),
        (panel,),
        differs="" if percent == _SPECTRA[0] else _NOT_WIDER,
    )


def _density_rows(percent: float) -> tuple[Comparison, ...]:
    smaller = _SPECTRA[0]
    rank = Comparison("rank correlation of modal amplitudes and J̄_k", None, resemblance(percent))
    if percent == smaller:
        lines, inertia = structural_lines(percent)
        pole = system.residual(percent).pole[lines]
        beyond = pole.imag > closed_loop_bandwidth(*system.closed(percent, "rigid"))
        loud, large = (
            {int(k) for k in np.argsort(-np.where(beyond, size, 0.0))[:2]}
            for size in (np.abs(system.residual(percent).amplitude[lines]), inertia)
        )
        return (
            claim(
                "regions of significant energy beyond the bandwidth",
                "those of J̄_k",
                loud == large,
                "others than those of J̄_k",
                "both largest at " + " and ".join(f"{pole[k].imag / HZ:.1f} Hz" for k in sorted(loud)),
            ),
            rank,
        )
    return (
        claim(
            "resemblance to J̄_k against 0.02 %",
            "less reasonable",
            resemblance(percent) < resemblance(smaller),
            "not less reasonable",
            f"rank correlation {resemblance(percent):.3f} after {resemblance(smaller):.3f}",
        ),
        claim(
            "energy in the rms window against 0.02 %",
            "spread into a wider spectrum",
            _width(percent, *WINDOW) > _width(smaller, *WINDOW),
            "not spread wider",
            _widths(percent, smaller, *WINDOW),
        ),
        Comparison("energy in the instant of the step", None, _widths(percent, smaller, 0.0, _INSTANT)),
        Comparison(
            "energy in the whole record", None, _widths(percent, smaller, WINDOW[0], WINDOW[0] + RECORD_S)
        ),
        rank,
    )


def _width(percent: float, start: float, end: float) -> float:
    low, high = central(percent, start, end)
    return high - low


def _widths(percent: float, smaller: float, start: float, end: float) -> str:
    """Where most of the energy lies, in words."""
    parts = [
        f"{low:.0f} to {high:.0f} Hz at {each:g} %"
        for each in (percent, smaller)
        for low, high in [central(each, start, end)]
    ]
    return f"{100 * _MOST:g} % from {' and '.join(parts)}"


def inverse_inertia(percent: float) -> Reproduction:
    """Figures 4.24 and 4.26: inverse effective modal reaction inertia over frequency."""
    modes = system.coupled(percent)
    inertia = modes.effective_modal_reaction_inertia
    moved = inertia > 0
    frequency = modes.natural_frequency[moved] / HZ
    panels = tuple(
        Panel(
            "Frequency [Hz]",
            label,
            (Curve(frequency, values, style="stems"),),
            y_scale="log",
            x_range=_HERTZ,
            wide=True,
        )
        for label, values in (("1/J̄_k", 1 / inertia[moved]), ("J̄_k", inertia[moved]))
    )
    rank = resemblance(percent)
    return judged(
        f"1/J̄_k of the coupled modes, {percent:g} %, as the caption has it, and J̄_k = J_m/J_k of equation 4.7 "
        "below it. The rigid-body mode, where J̄_k is zero, is left out.",
        (
            *_disturbable(percent),
            claim(
                "shape of 1/J̄_k against the power spectral density",
                "alike",
                rank < 0,
                "opposite",
                f"rank correlation with modal amplitudes {-rank:.3f}, that of J̄_k {rank:.3f}",
            ),
        ),
        panels,
        differs="By equation 4.7 the modes that are disturbed most have the largest J̄_k and the smallest 1/J̄_k: the "
        "captioned quantity has valleys where the spectrum has its peaks. The resemblance the text describes is that "
        f"of J̄_k, which is J_m times the inverse modal reaction inertia 1/J_k: rank correlation {rank:.3f}.",
    )


def _disturbable(percent: float) -> tuple[Comparison, ...]:
    """How many modes the inertia is spread over; the text says so of the larger one."""
    smaller = _SPECTRA[0]
    if percent == smaller:
        return ()
    here, there = holding(percent), holding(smaller)
    return (
        claim(
            "spectrum of disturbable modes against 0.02 %",
            "wider",
            here > there,
            "not wider",
            f"{here} modes hold {100 * _MOST:g} % of the sum of J̄_k, {there} at {smaller:g} %",
        ),
    )


def holding(percent: float) -> int:
    """Number of coupled modes that hold most of the sum of J̄_k."""
    inertia = np.sort(system.coupled(percent).effective_modal_reaction_inertia)[::-1]
    return int(np.searchsorted(np.cumsum(inertia), _MOST)) + 1


ENTRIES: tuple[Entry, ...] = (
    *(
        Entry(
            f"figure-4.{number}",
            f"Power spectral density of the step response, J_m = {percent:g} % J_truss",
            partial(density, percent),
        )
        for number, percent in zip((23, 25), _SPECTRA, strict=True)
    ),
    *(
        Entry(
            f"figure-4.{number}",
            f"Inverse effective modal reaction inertia, J_m = {percent:g} % J_truss",
            partial(inverse_inertia, percent),
        )
        for number, percent in zip((24, 26), _SPECTRA, strict=True)
    ),
)
