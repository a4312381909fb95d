"""How a loop metric changes with the loop: weights on transfer functions at points of the complex plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fosopt.control import Loop, Receptances
from fosopt.modes import ModalSet
from fosopt.ops import ComplexArray


@dataclass(frozen=True)
class Points:
    """Points of the complex plane with the receptances there, so that nobody computes those twice.

    Attributes
    ----------
    s
        (m,) [rad/s].
    g
        Receptances at `s`.
    """

    s: ComplexArray
    g: Receptances


@dataclass(frozen=True)
class Functional:
    """The differential of a loop metric, d(metric) = Re Σ_i w_i dR(s_i).

    Attributes
    ----------
    response
        Name of R: one of `control.NUMERATORS`, or ``characteristic``, ``loop_transfer``.
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

    def receptances(self, s: ComplexArray) -> Receptances:
        """Receptances the mirror sees at (m,) points away from open-loop poles."""
        modes = self.modes
        inverse = 1.0 / (s[:, None] ** 2 + modes.damping * s[:, None] + modes.stiffness)
        h = modes.at(self.mirror_port)
        both = inverse @ np.column_stack([h * h, h * modes.at("hub")])
        return Receptances(both[:, 0], both[:, 1])

    def points(self, s: ComplexArray) -> Points:
        """Points with their receptances."""
        return Points(s, self.receptances(s))

    def receptance_slopes(self, s: ComplexArray) -> Receptances:
        """Derivatives of the receptances in `s`."""
        modes = self.modes
        linear = 2 * s[:, None] + modes.damping
        inverse = 1.0 / (s[:, None] ** 2 + modes.damping * s[:, None] + modes.stiffness)
        h = modes.at(self.mirror_port)
        both = -(linear * inverse**2) @ np.column_stack([h * h, h * modes.at("hub")])
        return Receptances(both[:, 0], both[:, 1])
