"""Spans of time of a linear system without input: what they do to its states, and the energy its outputs leave.

Φ = e^{At} and the energy R = ∫ e^{Aᵀs} cᵀc e^{As} ds of a span t come from those of a tiny span, a short power series,
by doubling it,

    Φ(2t) = Φ(t)²,    R(2t) = R(t) + Φ(t)ᵀ R(t) Φ(t).

An energy is kept as a factor F with R = FᵀF, so that a sum of energies is a stack of factors: what a loop attenuates by
10⁵ in amplitude would lose ten digits in R and loses five in F. No eigenvectors are needed: repeated poles and a hub's
slow ones do no harm.    [VanLoan1978]
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import linalg

from fosopt.errors import SolverError
from fosopt.ops import Array

# The span a power series covers: norm of A times it, terms and quadrature nodes that leave less than rounding.
_SHORT = 0.25
_TERMS = 14
_NODES = 6
_DOUBLINGS = 60
_NOTHING = 1e-15  # of an amplitude; the square of it of an energy


class Span(NamedTuple):
    """What a span of time t does to states x of ẋ = A x, y = C x.

    Attributes
    ----------
    carried
        (n, n) Φ = e^{At}.
    energy
        (r, n) F with FᵀF = R(t) = ∫_0^t e^{Aᵀs} CᵀC e^{As} ds.
    grown
        (r, n) the same of ∫_0^t R(s) ds, empty unless asked for.
    """

    carried: Array
    energy: Array
    grown: Array


def span(a: Array, rows: Array, time: float, grown: bool = False) -> Span:
    """Φ and the energy of outputs over a span of time, as factors.    [VanLoan1978]

    Parameters
    ----------
    a, rows
        (n, n) A and (p, n) C.
    time
        t, zero or more [s].
    grown
        Whether the integral of the energy is asked for.
    """
    n = a.shape[0]
    if time == 0:
        return Span(np.eye(n), np.zeros((0, n)), np.zeros((0, n)))
    short = float(np.linalg.norm(a, 1)) * time / _SHORT
    doublings = int(np.ceil(np.log2(max(short, 1.0))))
    step = time / 2**doublings
    carried, power = np.eye(n), np.eye(n)
    for k in range(1, _TERMS):
        power = step / k * (power @ a)
        carried = carried + power
    x, w = np.polynomial.legendre.leggauss(_NODES)
    at, weight = 0.5 * (x + 1), 0.5 * step * w
    term, nodes = rows, np.tile(rows, (_NODES, 1, 1))
    for k in range(1, _TERMS if rows.shape[0] else 0):
        term = step / k * (term @ a)
        nodes = nodes + at[:, None, None] ** k * term
    energy = stacked(*(np.sqrt(weight)[:, None, None] * nodes))
    inner = np.zeros((0, n))
    if grown:
        inner = stacked(*(np.sqrt(weight * step * (1 - at))[:, None, None] * nodes))
    for _ in range(doublings):
        if grown:
            inner = stacked(inner, np.sqrt(step) * energy, inner @ carried)
        energy = stacked(energy, energy @ carried)
        carried = carried @ carried
        step *= 2
    return Span(carried, energy, inner)


def stacked(*factors: Array) -> Array:
    """A factor of a sum of energies, with no more rows than columns."""
    whole = np.vstack(factors)
    if whole.shape[0] <= whole.shape[1]:
        return whole
    triangle: Array = linalg.qr(whole, mode="r", check_finite=False)[0][: whole.shape[1]]
    return triangle


def energy_for_ever(transition: Array, energy: Array) -> Array:
    """(r, n) F with FᵀF = Y = Mᵀ Y M + E, the energy that a state at a sample leaves for ever, by doubling its terms.

    [Smith1968]

    Parameters
    ----------
    transition, energy
        (n, n) M and (p, n) a factor of E.

    Raises
    ------
    SolverError
        If the sum does not end.
    """
    total, step = energy, transition
    for _ in range(_DOUBLINGS):
        added = total @ step
        if np.linalg.norm(added) <= _NOTHING * np.linalg.norm(total):
            return total
        total = stacked(total, added)
        step = step @ step
    raise SolverError("sampled loop: its energy does not end; it is on the verge of instability")
