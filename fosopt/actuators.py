"""Actuators attached to the ports of a structure, and the places they act, react, refer to and are sensed at."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt
from typing import Any

from fosopt.errors import ModelError
from fosopt.ops import is_symbolic


@dataclass(frozen=True)
class MirrorReactionMass:
    """The counter-rotating inertia behind a reactionless mirror, each property as a share of the mirror's own.

    All ones cancel the mirror's reaction completely; what differs from one leaks torque into the structure. It
    pivots where the mirror does and is driven the other way.    [Barker1991] Eqs. (2.42)-(2.50)

    Attributes
    ----------
    inertia_ratio, stiffness_ratio, torque_ratio
        J_rm/J_m, k_rm/k_m and −t_rm/t_m [-]. The damping ratio is the mirror's.
    """

    inertia_ratio: float = 1.0
    stiffness_ratio: float = 1.0
    torque_ratio: float = 1.0

    def __post_init__(self) -> None:
        for name in ("inertia_ratio", "stiffness_ratio"):
            value = getattr(self, name)
            if not 0 < value < inf:
                raise ModelError(
                    f"mirror reaction mass: {name} {value} is no physical value; give a finite one above zero"
                )
        if not 0 <= self.torque_ratio < inf:
            raise ModelError(
                f"mirror reaction mass: torque_ratio {self.torque_ratio} is negative or not finite; give one near one"
            )


@dataclass(frozen=True)
class Mirror:
    """A fast steering mirror on a spring and damper, reacting against its structure.

    [Barker1991] Eqs. (2.41), (4.12)

    Attributes
    ----------
    inertia
        J_m [kg m²].
    natural_frequency
        Of the mirror on a rigid support [rad/s].
    damping_ratio
        Of the mirror on a rigid support [-].
    reaction_mass
        Of a reactionless mirror.
    """

    inertia: Any
    natural_frequency: Any
    damping_ratio: Any
    reaction_mass: MirrorReactionMass | None = None

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

    @property
    def counter(self) -> Suspended | None:
        """The reaction mass of a reactionless mirror as an inertia on its own spring and damper."""
        shares = self.reaction_mass
        if shares is None:
            return None
        return Suspended(
            shares.inertia_ratio * self.inertia,
            shares.stiffness_ratio * self.stiffness,
            # 2 ζ √(k J) with the mirror's ζ.
            sqrt(shares.stiffness_ratio * shares.inertia_ratio) * self.damping,
        )


@dataclass(frozen=True)
class ReactionMassActuator:
    """A proof mass on a spring at one port, as passive absorber or with relative rate feedback f = −Δ q̇.

    Assumes the proof mass moves along its port alone; its weight in other directions belongs to the structure.
    [Barker1991] Eqs. (2.37)-(2.40)

    Attributes
    ----------
    port
        Where it is mounted.
    mass
        m_a [kg], or [kg m²].
    natural_frequency, damping_ratio
        On a rigid support, without feedback [rad/s], [-].
    rate_gain
        Δ [N s/m], or [N m s/rad]; zero or more, as only then it can do no harm.
    rotary
        Whether the port turns: then `mass` is an inertia and no part of any mass.
    """

    port: str
    mass: float
    natural_frequency: float
    damping_ratio: float
    rate_gain: float = 0.0
    rotary: bool = False

    def __post_init__(self) -> None:
        where = f"reaction-mass actuator at '{self.port}'"
        for name in ("mass", "natural_frequency", "damping_ratio", "rate_gain"):
            value = getattr(self, name)
            if not 0 <= value < inf or (value == 0 and name == "mass"):
                raise ModelError(
                    f"{where}: {name} {value} is no physical value; give a finite one above zero"
                )

    @property
    def suspended(self) -> Suspended:
        """The proof mass on its spring, its damper with the rate feedback in it.    [Barker1991] Eq. (2.40)"""
        passive = 2 * self.damping_ratio * self.natural_frequency * self.mass
        return Suspended(self.mass, self.mass * self.natural_frequency**2, passive + self.rate_gain)


@dataclass(frozen=True)
class Suspended:
    """An inertia on a spring and damper.

    Attributes
    ----------
    inertia, stiffness, damping
        [kg], [N/m], [N s/m], or [kg m²], [N m/rad], [N m s/rad].
    """

    inertia: Any
    stiffness: Any
    damping: Any

    def coupling(self, s: Any) -> Any:
        """Spring and damper, κ(s) = c s + k [N/m] or [N m/rad]."""
        return self.damping * s + self.stiffness

    def restoring(self, s: Any) -> Any:
        """Load on it per own motion while its mount rests [N/m] or [N m/rad]."""
        return self.coupling(s)

    def transmission(self, s: Any) -> Any:
        """Its motion per motion of its mount, κ/(J s² + κ) [-]."""
        kappa = self.coupling(s)
        return kappa / (self.inertia * s**2 + kappa)

    def slip(self, s: Any) -> Any:
        """What its transmission lacks to one, J s²/(J s² + κ), without a difference [-]."""
        inertial = self.inertia * s**2
        return inertial / (inertial + self.coupling(s))

    def dynamic_stiffness(self, s: Any) -> Any:
        """Load on its mount per motion of the mount, J s² κ/(J s² + κ) [N/m] or [N m/rad]."""
        return self.inertia * s**2 * self.transmission(s)


def proof_mass_force(actuator: ReactionMassActuator, s: Any) -> Any:
    """Force on a rigid mount per interaction force, m s²/(m s² + c s + k): Eq. (2.37) over its gain [-].

    [Barker1991] Eq. (2.37)
    """
    return actuator.suspended.slip(s)


@dataclass(frozen=True)
class Placement:
    """Where the loop acts, reacts and senses; the mirror's spring always refers to the port it is mounted on.

    None stands for the usual place: reaction on the port of the spring, sensor and action on the mirror. With
    all of them so, the loop is bicollocated.    [Barker1991] Sec. 3.2, Fig. 3.2

    Attributes
    ----------
    reaction
        Port the control torque reacts on.
    sensor
        Port whose motion the controller is fed instead of the mirror's inertial angle.
    action
        Port the control torque acts on instead of the mirror.
    """

    reaction: str | None = None
    sensor: str | None = None
    action: str | None = None

    def __post_init__(self) -> None:
        if self.action is not None and self.action == self.reaction:
            raise ModelError(
                f"placement: the torque acts and reacts at '{self.action}' and moves nothing; choose two places"
            )

    @property
    def bicollocated(self) -> bool:
        """Whether sensor = action degree of freedom and reaction = reference degree of freedom.

        With both on the mirror, zeros are those of the structure alone and never nonminimum phase; with both on the
        structure there is no such guarantee.
        """
        return self.sensor == self.action and self.reaction is None

    @property
    def collocated(self) -> bool:
        """Whether sensor and action share a degree of freedom, the classical sense."""
        return self.sensor == self.action


BICOLLOCATED = Placement()
"""Sensor and action on the mirror, reaction at its spring."""
