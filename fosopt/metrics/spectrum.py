"""Spectrum of the line of sight: how much of the jitter lies below each frequency, by source and by mode.

A closed-loop transfer function is the sum of what its poles contribute, H = Σ_k H_k + H_rest, and the spectrum of the
line of sight the sum of what each contributes to it,

    S |H|² = Σ_k S Re(H_k H̄) + S Re(H_rest H̄).

Integrated, this is the covariance of a mode's part of the line of sight with the whole: the shares of all modes add to
the mean square, and one is negative where a mode counteracts what the others do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from math import pi

import numpy as np

from fosopt.control import ClosedLoopPoles, closed_loop_response
from fosopt.metrics.axes import Models, responses_of
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import PANEL, gauss, pole_residues, poles_of_filters, resonance_quadrature
from fosopt.ops import Array, ComplexArray

# Rows of a spectrum table that bound a panel of the quadrature; a longer table is taken at this many of them.
_MOST_CUTS = 400
_BLOCK = 1 << 20  # complex numbers in a table of modes and frequencies
_NONE = np.zeros(0)


@dataclass(frozen=True)
class JitterSpectrum:
    """Mean square line-of-sight error below each frequency.

    Attributes
    ----------
    frequency
        (m,) ascending [rad/s].
    density
        (d, m) one-sided power spectral density of the line of sight by disturbance [rad²/Hz].
    by_source
        (d, m) mean square below each frequency by disturbance; its last column is the whole [rad²].
    panel
        (d, m/20) the same at the upper edges of the panels that the frequencies are the nodes of [rad²].
    pole
        (k,) closed-loop poles of the structure's modes, the upper one of each pair [rad/s].
    origin
        (k,) the open-loop poles they were shifted from [rad/s].
    by_mode
        (k, m) share of each of them in the mean square of all disturbances [rad²].
    by_loop
        (m,) share of all else: mirror, controller, and what passes without any pole [rad²].
    """

    frequency: Array
    density: Array
    by_source: Array
    panel: Array
    pole: ComplexArray
    origin: ComplexArray
    by_mode: Array
    by_loop: Array

    def below(self, frequency: Array) -> Array:
        """(c,) Mean square of all disturbances below each frequency [rad²].

        To the quadrature's accuracy where a panel ends, and by a straight line between nodes elsewhere.
        """
        place = np.searchsorted(self.frequency, frequency)
        ends = np.append(0.0, self.panel.sum(axis=0))[place // PANEL]
        total = self.by_source.sum(axis=0)
        return np.where(place % PANEL == 0, ends, np.interp(frequency, self.frequency, total))


def jitter_spectrum(
    model: LoopModel,
    poles: ClosedLoopPoles,
    disturbances: tuple[Disturbance, ...],
    marks: Array = _NONE,
) -> JitterSpectrum:
    """Where in frequency the jitter comes from, by source and by mode.

    A mode is the closed-loop pole that the loop has shifted from a pole of the structure and what is attached to it.

    Parameters
    ----------
    marks
        (c,) Frequencies at which a panel of the quadrature is to end, see `JitterSpectrum.below` [rad/s].

    Raises
    ------
    UnstableError
        If the loop is unstable.
    """
    poles.refuse_unstable()
    nodes, weights = _quadrature(poles, disturbances, marks)
    points = model.points(1j * nodes)
    open_loop = poles.open_loop
    structural = np.isin(poles.base, np.concatenate([open_loop.first, open_loop.second]))
    structural &= poles.multiplicity == 2
    pole = poles.value[structural]
    residues, weighted, density = [], [], []
    for each in disturbances:
        response = closed_loop_response(each.at, model.loop, points.s, points.g)
        low, high = each.counted
        psd = np.where((nodes >= low) & (nodes <= high), each.one_sided_psd(nodes), 0.0)
        density.append(psd * np.abs(response) ** 2)
        weighted.append(psd * response.conj())
        residues.append(pole_residues(model, poles, each.at)[structural])
    shares = _of_modes(pole, np.array(residues).T, points.s, np.array(weighted))
    step = weights / (2 * pi)
    steps = np.array(density) * step
    by_source, by_mode = _below(steps), _below(shares * step)
    return JitterSpectrum(
        nodes,
        np.array(density),
        by_source,
        _panels(steps),
        pole,
        poles.base[structural],
        by_mode,
        by_source.sum(axis=0) - by_mode.sum(axis=0),
    )


def axis_spectrum(
    models: Models, poles: ClosedLoopPoles, disturbances: tuple[Disturbance, ...], marks: Array = _NONE
) -> JitterSpectrum:
    """The same of a mirror with two axes, by source and by axis: two rows for each disturbance. Modes are not told.

    Raises
    ------
    UnstableError
        If a loop is unstable.
    """
    poles.refuse_unstable()
    nodes, weights = _quadrature(poles, disturbances, marks)
    points = models[0].points(1j * nodes)
    density = np.zeros((2 * len(disturbances), nodes.size))
    for row, (each, axis) in enumerate(product(disturbances, (0, 1))):
        seen = models[1].seen(points) if axis else points
        low, high = each.counted
        psd = np.where((nodes >= low) & (nodes <= high), each.one_sided_psd(nodes), 0.0)
        for name in responses_of(each, axis):
            density[row] += psd * np.abs(closed_loop_response(name, seen.model.loop, seen.s, seen.g)) ** 2
    steps = density * weights / (2 * pi)
    by_source = _below(steps)
    none: ComplexArray = np.zeros(0, dtype=complex)
    return JitterSpectrum(
        nodes,
        density,
        by_source,
        _panels(steps),
        none,
        none,
        np.zeros((0, nodes.size)),
        by_source.sum(axis=0),
    )


def _quadrature(
    poles: ClosedLoopPoles, disturbances: tuple[Disturbance, ...], marks: Array
) -> tuple[Array, Array]:
    """Ascending nodes [rad/s] and weights over all that the disturbances count, panels ending at their edges."""
    bands = np.array([each.counted for each in disturbances])
    tables = [each.frequency for each in disturbances if each.frequency is not None]
    cuts: list[Array] = [table[:: -(-table.size // _MOST_CUTS)] for table in (*tables, marks) if table.size]
    low, high = float(bands[:, 0].min()), float(bands[:, 1].max())
    if low > 0:
        # Up to the slowest pole a spectrum may fall as a power of the frequency: panels of a decade each.
        slowest = float(np.abs(poles.all).min())
        decades = int(max(np.ceil(np.log10(slowest / low)), 0)) + 1
        cuts.append(np.asarray(low * 10.0 ** np.arange(decades)))
    every = np.concatenate([poles.all, poles_of_filters(disturbances)])
    nodes, weights = resonance_quadrature(
        every, low, high, np.concatenate([*cuts, bands[np.isfinite(bands)]])
    )
    order = np.argsort(nodes, kind="stable")
    return nodes[order], weights[order]


def _of_modes(pole: ComplexArray, residue: ComplexArray, s: ComplexArray, weighted: ComplexArray) -> Array:
    """(k, m) Σ_d S_d Re(H_kd H̄_d) of each mode, H_kd(s) = r/(s − p) + r̄/(s − p̄), from (k, d) r and (d, m) S H̄."""
    found = np.empty((pole.size, s.size))
    count = max(1, _BLOCK // s.size)
    for first in range(0, pole.size, count):
        block = slice(first, first + count)
        p, r = pole[block, None], residue[block]
        found[block] = np.real((r @ weighted) / (s - p) + (r.conj() @ weighted) / (s - p.conj()))
    return found


def _below(steps: Array) -> Array:
    """Integral up to each node, from its (…, m) weighted values; the last one is the whole.

    Within a panel the polynomial through its nodes is integrated, at the quadrature's accuracy.
    """
    panels = steps.reshape(*steps.shape[:-1], -1, PANEL)
    ends = _panels(steps)
    before = ends - panels.sum(axis=-1)
    found: Array = (before[..., None] + panels @ _partial_integrals().T).reshape(steps.shape)
    found[..., -1] = ends[..., -1]
    return found


def _panels(steps: Array) -> Array:
    """Integral up to the end of each panel, from its (…, m) weighted values."""
    found: Array = np.cumsum(steps.reshape(*steps.shape[:-1], -1, PANEL).sum(axis=-1), axis=-1)
    return found


@lru_cache(maxsize=1)
def _partial_integrals() -> Array:
    """(PANEL, PANEL) B with ∫ from −1 to x_i of the polynomial through f_j = Σ_j B_ij w_j f_j at Gauss nodes x.

    The polynomial is Σ_n P_n (2n + 1)/2 Σ_j w_j P_n(x_j) f_j, exactly, as PANEL nodes integrate products of its terms;
    and (2n + 1) ∫ P_n = P_n+1 − P_n−1.
    """
    x, _ = gauss(PANEL)
    values = np.polynomial.legendre.legvander(x, PANEL)
    rises = np.column_stack([values[:, 0] + values[:, 1], values[:, 2:] - values[:, :-2]])
    return 0.5 * rises @ values[:, :PANEL].T
