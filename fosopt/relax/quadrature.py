"""Frequencies that resolve a spectral density, found by looking at it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import inf, pi

import numpy as np

from fosopt.metrics.jitter import resonance_quadrature
from fosopt.ops import Array, ComplexArray

# Panels narrower than this, relative to the lowest pole, are no longer halved: a density that falls to zero
# like a power of the frequency has a logarithm that no panel at zero resolves, and nothing left to integrate.
_LEAST = 1e-4
_ROUNDS, _MOST = 30, 50_000
_LAST = 4  # coefficients of a Legendre series whose size says how well its panel is resolved

# A single panel tells how many nodes each of them has.
_PER_PANEL = resonance_quadrature(np.array([-1.0 + 0j]), 0.0, 1.0, np.zeros(0))[0].size


@dataclass(frozen=True)
class Nodes:
    """Nodes ω and weights w with (1/2π) ∫ f(jω) dω = Re Σ w f(jω) for f over all frequencies, f(−jω) = f(jω)*.

    Attributes
    ----------
    frequency, weight
        (m,) in panels of equal count [rad/s].
    poles, low, high, cuts
        What they were made from.
    """

    frequency: Array
    weight: Array
    poles: ComplexArray
    low: float
    high: float
    cuts: Array

    @property
    def halved(self) -> Nodes:
        """The same with every panel cut in two, to see how much a sum still changes."""
        panels = self.frequency.reshape(-1, _PER_PANEL)
        middle = _PER_PANEL // 2
        more = np.union1d(self.cuts, 0.5 * (panels[:, middle - 1] + panels[:, middle]))
        return nodes(self.poles, self.low, self.high, more)


def nodes(poles: ComplexArray, low: float, high: float, cuts: Array) -> Nodes:
    """Nodes adapted to resonances at `poles`, with further panel edges at `cuts` [rad/s]."""
    frequency, weight = resonance_quadrature(poles, low, high, cuts)
    return Nodes(frequency, weight / pi, poles, low, high, cuts)


def resolving_nodes(
    density: Callable[[Array], Array],
    poles: ComplexArray,
    low: float,
    high: float,
    cuts: Array,
    tolerance: float,
) -> Nodes:
    """Nodes on whose panels the logarithm of a density is a polynomial to `tolerance`.

    The density's own zeros, which nobody knows beforehand, are found in this way.

    Parameters
    ----------
    density
        Values at (m,) frequencies; where it is zero nothing is to be resolved.
    poles
        Resonances known beforehand [rad/s].
    """
    size = np.abs(poles[poles != 0])
    # A decade each where nothing resonates.
    bottom, top = _LEAST * size.min(), 10 * size.max()
    decades = np.geomspace(bottom, top, int(np.log10(top / bottom)) + 2)
    found = nodes(poles, low, high, np.union1d(cuts, decades))
    for _ in range(_ROUNDS):
        value = density(found.frequency)
        logarithm = np.log(value, out=np.zeros_like(value), where=value > 0)
        tail = np.abs(logarithm.reshape(-1, _PER_PANEL) @ _legendre().T)[:, -_LAST:].max(axis=1)
        panels = found.frequency.reshape(-1, _PER_PANEL)
        rough = (tail > tolerance) & (panels[:, -1] > bottom)
        # Rounding sets the end of halving, and the tail towards infinite frequency runs the other way.
        rough &= panels[:, -1] - panels[:, 0] > 1e-12 * panels[:, -1]
        rough[-1] &= high < inf
        # A density that its own rounding keeps rough is left so; sums that still change say by how much.
        if not rough.any() or value.size > _MOST:
            break
        middle = _PER_PANEL // 2
        halves = 0.5 * (panels[rough, middle - 1] + panels[rough, middle])
        found = nodes(poles, low, high, np.union1d(found.cuts, halves))
    return found


@cache
def _legendre() -> Array:
    """(n, n) From values at the nodes of a panel to coefficients of Legendre polynomials."""
    x, _ = np.polynomial.legendre.leggauss(_PER_PANEL)
    values = np.polynomial.legendre.legvander(x, _PER_PANEL - 1)
    return np.linalg.solve(values, np.eye(_PER_PANEL)).astype(float)
