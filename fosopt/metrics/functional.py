"""How a loop metric changes with the loop: weights on transfer functions at points of the complex plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fosopt.control import Loop, Receptances, with_attachments
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray, Dual


@dataclass(frozen=True)
class Points:
    """Points of the complex plane with what the structure does there, so that nobody computes it twice.

    Attributes
    ----------
    s
        (m,) [rad/s].
    modal
        (m, n) modal receptances 1/(s² + 2ζ_k ω_k s + ω_k²).
    bare
        Receptances of the structure alone at `s`.
    g
        Receptances of the structure with what is attached to it.
    model
        Whose points they are.
    """

    s: ComplexArray
    modal: ComplexArray
    bare: Receptances
    g: Receptances
    model: LoopModel


@dataclass(frozen=True)
class Functional:
    """The differential of a loop metric, d(metric) = Re Σ_i w_i dR(s_i).

    Attributes
    ----------
    response
        Name of R: one of `control.NUMERATORS` or `control.OTHER_AXIS`, or ``characteristic``, ``loop_transfer``.
    points
        Where, away from closed-loop poles.
    weight
        (m,) w.
    """

    response: str
    points: Points
    weight: ComplexArray


@dataclass(frozen=True)
class LoopModel:
    """A loop on a modal set: all that loop metrics need to know."""

    loop: Loop
    modes: ModalSet
    mirror_port: str

    def points(self, s: ComplexArray) -> Points:
        """(m,) points away from open-loop poles, with what the structure does there."""
        modes = self.modes
        return self._points(s, 1.0 / (s[:, None] ** 2 + modes.damping * s[:, None] + modes.stiffness))

    def seen(self, points: Points) -> Points:
        """Points of another model on the same modes, as this one sees them."""
        return self._points(points.s, points.modal)

    def points_near_pole(self, base: complex, shift: complex) -> Points:
        """The point base + shift, exact however close it is to the open-loop pole `base`."""
        half = 0.5 * self.modes.damping
        root = np.sqrt((half**2 - self.modes.stiffness).astype(complex))
        first, second = (base - (root - half)) + shift, (base - (-root - half)) + shift
        return self._points(np.array([base + shift]), 1.0 / (first * second)[None, :])

    def _points(self, s: ComplexArray, modal: ComplexArray) -> Points:
        bare = Receptances.of((modal @ self._pairs).T)
        return Points(s, modal, bare, with_attachments(self.loop, s, bare), self)

    def along(self, points: Points) -> tuple[Dual, Receptances]:
        """The points and receptances there with their derivatives in `s`, as formulas take them."""
        linear = 2 * points.s[:, None] + self.modes.damping
        slopes = Receptances.of((-(linear * points.modal**2) @ self._pairs).T)
        both = [Dual(v, d) for v, d in zip(points.bare.values, slopes.values, strict=True)]
        s = Dual(points.s, 1.0)
        return s, with_attachments(self.loop, s, Receptances.of(both))

    @cached_property
    def port_names(self) -> tuple[tuple[str, str], ...]:
        """The ports of each pair of receptances."""
        ports = self.loop.ports(self.mirror_port)
        return tuple((ports[a], ports[b]) for a, b in self.loop.pairs)

    @cached_property
    def _pairs(self) -> Array:
        return np.array([self.modes.at(p) * self.modes.at(q) for p, q in self.port_names]).T
