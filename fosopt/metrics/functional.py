"""How a loop metric changes with the loop: weights on transfer functions at points of the complex plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fosopt.control import Loop, Receptances
from fosopt.modes import ModalSet

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Functional:
    """The differential of a loop metric, d(metric) = Re Σ_i w_i dR(s_i).

    Attributes
    ----------
    response
        Name of R: one of `control.NUMERATORS`, or ``characteristic``, ``loop_transfer``.
    s
        (m,) points where no closed-loop pole lies [rad/s].
    weight
        (m,) w.
    """

    response: str
    s: ComplexArray
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

    def receptance_slopes(self, s: ComplexArray) -> Receptances:
        """Derivatives of the receptances in `s`."""
        modes = self.modes
        linear = 2 * s[:, None] + modes.damping
        inverse = 1.0 / (s[:, None] ** 2 + modes.damping * s[:, None] + modes.stiffness)
        h = modes.at(self.mirror_port)
        both = -(linear * inverse**2) @ np.column_stack([h * h, h * modes.at("hub")])
        return Receptances(both[:, 0], both[:, 1])
