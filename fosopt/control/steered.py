"""The second axis of a mirror as the first one sees it: a body on a spring that a loop of its own holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fosopt.actuators import Mirror
from fosopt.control.pid import PID, pid_response


@dataclass(frozen=True)
class SteeredAxis:
    """A mirror's other axis with its loop closed, bicollocated.

    J s² θ = κ (u − θ) − K (θ + n): at its port the structure feels the dynamic stiffness J s² κ/(J s² + κ + K), that
    of a body on a spring with the loop's K(s) beside the spring.    [Barker1991] Eq. (4.12)

    Attributes
    ----------
    port
        Where the mirror is mounted about this axis.
    mirror, controller
        About this axis.
    hub
        Port of the hub about this axis; None where the hub does not turn about it.
    """

    port: str
    mirror: Mirror
    controller: PID
    hub: str | None = None

    @property
    def inertia(self) -> Any:
        """J [kg m²]."""
        return self.mirror.inertia

    def coupling(self, s: Any) -> Any:
        """Spring and damper between mirror and port, κ(s) = c s + k [N m/rad]."""
        return self.mirror.damping * s + self.mirror.stiffness

    def restoring(self, s: Any) -> Any:
        """What holds it against inertial space and its resting port together, κ + K [N m/rad]."""
        return self.coupling(s) + pid_response(self.controller, s)
