"""Jitter of many loops on one structure at once, by the residues of one loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fosopt.control import ClosedLoopPoles, Loop, Receptances, characteristic
from fosopt.control.many import loops_together
from fosopt.metrics.disturbances import Disturbance, refuse_infinite_variance
from fosopt.metrics.jitter import apart, poles_of_filters, residue_terms
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray, Dual
from fosopt.plant.sums import modal_sums


def many_jitter_variances(
    loops: Sequence[Loop],
    poles: Sequence[ClosedLoopPoles],
    modes: ModalSet,
    mirror_port: str,
    disturbances: Sequence[Disturbance],
) -> Array:
    """(l, d) Mean square line-of-sight error of each loop under each disturbance [rad²].

    Not a number for what has to be found alone: an unstable loop, a spectrum without residues, or loops that are no
    bicollocated mirrors without attachments.

    Parameters
    ----------
    poles
        Of each loop, with the same open-loop poles.
    """
    found = np.full((len(loops), len(disturbances)), np.nan)
    alike = [p.open_loop is poles[0].open_loop and p.value.size == poles[0].value.size for p in poles]
    stable = [
        i for i, (p, same) in enumerate(zip(poles, alike, strict=True)) if same and p.spectral_abscissa < 0
    ]
    together = loops_together([loops[i] for i in stable]) if stable else None
    rational = [k for k, d in enumerate(disturbances) if d.by_residues]
    if together is None or not rational:
        return found
    open_loop = poles[0].open_loop
    for k in rational:
        refuse_infinite_variance(disturbances[k], loops[stable[0]], open_loop.drifting)
    chosen = [disturbances[k] for k in rational]
    base, shift = (np.array([getattr(poles[i], name) for i in stable]) for name in ("base", "shift"))
    value = base + shift
    at_poles, slopes = _receptances(open_loop.first, open_loop.second, open_loop.constant, base, shift)
    slope = characteristic(together, Dual(value, 1.0), slopes).slope
    # Away from its poles the structure is the sum of all its modes, those the loop does not move included.
    half = 0.5 * modes.damping
    root = np.sqrt((half**2 - modes.stiffness).astype(complex))
    port = modes.at(mirror_port)
    structure = -half + root, -half - root, np.column_stack([port**2, port * modes.at("hub")])
    filters = poles_of_filters(chosen)
    mirrored = -np.concatenate([value, np.broadcast_to(filters, (len(stable), filters.size))], axis=1)
    at_filters, _ = _receptances(*structure, filters[None], np.zeros((1, filters.size), dtype=complex))
    at_mirrored, _ = _receptances(*structure, mirrored, np.zeros_like(mirrored))
    multiplicity = np.array([poles[i].multiplicity for i in stable])
    places = (value, at_poles), (filters[None], at_filters), (mirrored, at_mirrored)
    terms = residue_terms(together, chosen, multiplicity / slope, *places)
    for k, disturbance, (weight, response) in zip(rational, chosen, terms, strict=True):
        variance = np.sum(weight * response, axis=1).real
        found[stable, k] = np.where(apart(value, disturbance), variance, np.nan)
    return found


def _receptances(
    first: ComplexArray, second: ComplexArray, constant: Array, base: ComplexArray, shift: ComplexArray
) -> tuple[Receptances, Receptances]:
    """Receptances of (l, m) points, bare and with their derivatives."""
    pairs = np.ascontiguousarray(constant[:, :2])
    value, slope, _ = modal_sums(first, second, pairs, base.ravel(), shift.ravel())
    value, slope = value.reshape(-1, *base.shape), slope.reshape(-1, *base.shape)
    duals = [Dual(v, d) for v, d in zip(value, slope, strict=True)]
    return Receptances(value[0], value[1]), Receptances(duals[0], duals[1])
