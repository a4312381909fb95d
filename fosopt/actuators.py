"""Actuators attached to the ports of a structure."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any

from fosopt.errors import ModelError
from fosopt.ops import is_symbolic


@dataclass(frozen=True)
class Mirror:
    """A fast steering mirror on a spring and damper, reacting against the port it is mounted on.

    Bicollocated: its torque acts on the mirror and reacts on the port its spring refers to, and the sensor
    reads the inertial mirror angle.    [Barker1991] Eqs. (2.41), (4.12)

    Attributes
    ----------
    inertia
        J_m [kg m²].
    natural_frequency
        Of the mirror on a rigid support [rad/s].
    damping_ratio
        Of the mirror on a rigid support [-].
    """

    inertia: Any
    natural_frequency: Any
    damping_ratio: Any

    def __post_init__(self) -> None:
        for name in ("inertia", "natural_frequency", "damping_ratio"):
            value = getattr(self, name)
            if is_symbolic(value):
                continue
            if not value >= 0:
                raise ModelError(
                    f"mirror: {name} {value} is negative or not a number; give a value above zero"
                )
            if value == inf or (name == "inertia" and value == 0):
                raise ModelError(f"mirror: {name} {value} is no physical value; give a finite one above zero")

    @property
    def stiffness(self) -> Any:
        """k_m = J_m ω_m² [N m/rad]."""
        return self.inertia * self.natural_frequency**2

    @property
    def damping(self) -> Any:
        """c_m = 2 ζ_m ω_m J_m [N m s/rad]."""
        return 2 * self.damping_ratio * self.natural_frequency * self.inertia
