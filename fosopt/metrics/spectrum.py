"""Spectrum of the line of sight: how much of the jitter lies below each frequency, by source and by mode.

A closed-loop transfer function is the sum of what its poles contribute, H = Σ_k H_k + H_rest, and the spectrum of the
line of sight the sum of what each contributes to it,

    S |H|² = Σ_k S Re(H_k H̄) + S Re(H_rest H̄).

Integrated, this is the covariance of a mode's part of the line of sight with the whole: the shares of all modes add to
the mean square, and one is negative where a mode counteracts what the others do.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from fosopt.control import ClosedLoopPoles, closed_loop_response
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import pole_residues, poles_of_filters, resonance_quadrature
from fosopt.ops import Array, ComplexArray

# Rows of a spectrum table that bound a panel of the quadrature; a longer table is taken at this many of them.
_MOST_CUTS = 400
_BLOCK = 1 << 20  # complex numbers in a table of modes and frequencies


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
    pole: ComplexArray
    origin: ComplexArray
    by_mode: Array
    by_loop: Array


def jitter_spectrum(
    model: LoopModel, poles: ClosedLoopPoles, disturbances: tuple[Disturbance, ...]
) -> JitterSpectrum:
    """Where in frequency the jitter comes from, by source and by mode.

    A mode is the closed-loop pole that the loop has shifted from a pole of the structure and what is attached to it.
    Within a panel of the quadrature the integral is good for a picture, at its edges to the quadrature's accuracy.

    Raises
    ------
    UnstableError
        If the loop is unstable.
    """
    poles.refuse_unstable()
    nodes, weights = _quadrature(poles, disturbances)
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
    by_source, by_mode = _below(np.array(density) * step), _below(shares * step)
    return JitterSpectrum(
        nodes,
        np.array(density),
        by_source,
        pole,
        poles.base[structural],
        by_mode,
        by_source.sum(axis=0) - by_mode.sum(axis=0),
    )


def _quadrature(poles: ClosedLoopPoles, disturbances: tuple[Disturbance, ...]) -> tuple[Array, Array]:
    """Ascending nodes [rad/s] and weights over all that the disturbances count, panels ending at their edges."""
    bands = np.array([each.counted for each in disturbances])
    tables = [each.frequency for each in disturbances if each.frequency is not None]
    cuts: list[Array] = [table[:: -(-table.size // _MOST_CUTS)] for table in tables]
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
    """Sum up to each node, half of its own included; the last one is the whole."""
    total = np.cumsum(steps, axis=-1)
    found = total - 0.5 * steps
    found[..., -1] = total[..., -1]
    return found
