"""Jitter of many loops on one structure at once, by the residues of one loop."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fosopt.control import ClosedLoopPoles, Loop, Receptances, characteristic
from fosopt.control.loop import attach
from fosopt.control.many import hung, loops_together, sums
from fosopt.control.open_loop import OpenLoopPoles, moving_pairs
from fosopt.metrics.disturbances import Disturbance, refuse_infinite_variance
from fosopt.metrics.jitter import apart, poles_of_filters, residue_terms
from fosopt.ops import Array, ComplexArray, Dual


def many_jitter_variances(
    loops: Sequence[Loop], poles: Sequence[ClosedLoopPoles], disturbances: Sequence[Disturbance]
) -> Array:
    """(l, d) Mean square line-of-sight error of each loop under each disturbance [rad²].

    Not a number for what has to be found alone: an unstable loop, a spectrum without residues, or loops of different
    forms.

    Parameters
    ----------
    poles
        Of each loop, as `control.many.many_closed_loop_poles` gives them.
    """
    found = np.full((len(loops), len(disturbances)), np.nan)
    rational = [k for k, d in enumerate(disturbances) if d.by_residues]
    if loops_together(loops) is None or not rational:
        return found
    chosen = [disturbances[k] for k in rational]
    for group in _alike(poles):
        for disturbance in chosen:
            refuse_infinite_variance(disturbance, loops[group[0]], poles[group[0]].open_loop.drifting)
        found[np.ix_(group, np.array(rational))] = _variances(
            [loops[i] for i in group], [poles[i] for i in group], chosen
        )
    return found


def _alike(poles: Sequence[ClosedLoopPoles]) -> Iterator[NDArray[np.intp]]:
    """Stable loops with equally many pairs and real poles of one and the same structure."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for i, each in enumerate(poles):
        if each.spectral_abscissa < 0:
            kind = id(each.open_loop.first), each.value.size, len(each.open_loop.hung)
            groups.setdefault(kind, []).append(i)
    for members in groups.values():
        yield np.array(members)


def _variances(
    loops: Sequence[Loop], poles: Sequence[ClosedLoopPoles], disturbances: Sequence[Disturbance]
) -> Array:
    """(l, d) The same for stable loops of one form and rational spectra."""
    together = loops_together(loops)
    assert together is not None
    open_loop = poles[0].open_loop
    base, shift = (np.array([getattr(each, name) for each in poles]) for name in ("base", "shift"))
    value = base + shift
    at_poles, slopes = _receptances(together, open_loop, base, shift)
    slope = characteristic(together, Dual(value, 1.0), slopes).slope
    filters = np.broadcast_to(
        poles_of_filters(disturbances), (len(loops), poles_of_filters(disturbances).size)
    )
    mirrored = -np.concatenate([value, filters], axis=1)
    at_filters, _ = _receptances(together, open_loop, filters, np.zeros_like(filters))
    at_mirrored, _ = _receptances(together, open_loop, mirrored, np.zeros_like(mirrored))
    multiplicity = np.array([each.multiplicity for each in poles])
    places = (value, at_poles), (filters, at_filters), (mirrored, at_mirrored)
    found = np.full((len(loops), len(disturbances)), np.nan)
    terms = residue_terms(together, disturbances, multiplicity / slope, *places)
    for k, (disturbance, (weight, response)) in enumerate(zip(disturbances, terms, strict=True)):
        variance = np.sum(weight * response, axis=1).real
        found[:, k] = np.where(apart(value, disturbance), variance, np.nan)
    return found


def _receptances(
    loops: Loop, open_loop: OpenLoopPoles, base: ComplexArray, shift: ComplexArray
) -> tuple[Receptances, Receptances]:
    """Receptances of (l, m) points, bare and with their derivatives; those no formula asks for are zero."""
    pairs = moving_pairs(loops, hub=True)
    g, _ = sums(open_loop, base, shift, pairs, len(loops.pairs))
    for port, body in hung(loops, open_loop):
        g = attach(Dual(base + shift, 1.0), g, port, body, [loops.pairs[k] for k in pairs])
    values = [each.value if isinstance(each, Dual) else each for each in g.values]
    return Receptances.of(values), g
