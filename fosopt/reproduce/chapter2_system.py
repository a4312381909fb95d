"""Systems of chapter 2: finite-element models, models 1 to 5, and what the dissertation leaves open about them.

Not published, hence chosen here: damping (that of the later chapters is taken), the mirror inertia of figures that
name none, and everything about the reaction-mass actuators.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Literal

import numpy as np

from fosopt.actuators import Mirror, MirrorReactionMass, Placement, ReactionMassActuator
from fosopt.control import PID, Loop, StateSpace, plant_state_space, second_order_state_space
from fosopt.control.state_space import modal_matrices
from fosopt.modes import Damping, Hub, ModalFrame, ModalSet, modal_frame, reduced_matrices
from fosopt.modes.added_mass import with_added_mass
from fosopt.ops import Array, ComplexArray
from fosopt.plant.zeros import plant_zeros
from fosopt.reproduce.bode import Response, resolved_response
from fosopt.reproduce.published import PUBLISHED
from fosopt.structure import (
    Batten,
    Structure,
    Truss,
    assemble,
    barker_truss,
    structural_mass,
    structure_inertia,
)
from fosopt.structure.barker import Boundary
from fosopt.units import HZ

Place = Literal["mirror", "hub", "actuator"]
_SIGNALS: Mapping[Place, tuple[str, str]] = MappingProxyType(
    {
        "mirror": ("control_torque", "mirror_angle"),
        "hub": ("hub_torque", "sensor_angle"),
        "actuator": ("actuator_force_1", "actuator_rate_1"),
    }
)

# The seven degrees of freedom of the reduced model in the order of section 2.5, by the names of its table.
DOFS = {
    "y20": ("B20", "y"),
    "y15": ("B15", "y"),
    "y10": ("B10", "y"),
    "y5": ("B5", "y"),
    "x20": ("B20", "x"),
    "theta20": ("B20", "rz"),
    "theta0": ("B0", "rz"),
}
PORTS = ("hub", "tip", *DOFS)
REDUCED = len(DOFS)
DAMPING = Damping((PUBLISHED["benchmark"]["zeta_structure"],))
MIRROR_SHARE = PUBLISHED["mirror"]["mass_fraction_of_total"]
MIRROR_DAMPING = PUBLISHED["benchmark"]["zeta_actuator"]
ELECTROMAGNETIC, PIEZOELECTRIC = (
    PUBLISHED["mirror"]["natural_frequency_hz"][kind] for kind in ("electromagnetic", "piezoelectric")
)

# Assumed: inertia of the mirror where a figure names none [% of the truss about the hub], within 0.2 to 50 %.
MIRROR_PERCENT = 2.0
# Assumed: a proof mass of a hundredth of the truss, suspended well below the first elastic mode, damped as the mirror.
ACTUATOR_SHARE, ACTUATOR_HZ, ACTUATOR_DAMPING = 0.01, 1.0, MIRROR_DAMPING
# Figure 2.37; that the reaction mass is the lighter one, on a spring as stiff as the mirror's, is assumed.
REACTION_MASS = MirrorReactionMass(
    inertia_ratio=1 - PUBLISHED["mirror"]["reactionless_example"]["inertia_mismatch"],
    torque_ratio=PUBLISHED["mirror"]["reactionless_example"]["torque_ratio"],
)


@dataclass(frozen=True)
class Variation:
    """An experiment on the truss: factors on what a beam leaves out.

    Attributes
    ----------
    rotary
        On the rotary inertia of the battens.
    diagonal
        On the stiffness of the diagonals, which resist shear.
    tip
        On the last batten: half of it is what a uniform beam ends with.
    """

    rotary: float = 1.0
    diagonal: float = 1.0
    tip: float = 1.0

    def of(self, truss: Truss) -> Truss:
        """The truss with these factors."""
        last = truss.battens[-1].name
        return replace(
            truss,
            battens=tuple(self._batten(b, b.name == last) for b in truss.battens),
            bars=tuple(
                replace(b, young=self.diagonal * b.young) if b.kind == "diagonal" else b for b in truss.bars
            ),
        )

    def _batten(self, of: Batten, last: bool) -> Batten:
        share = self.tip if last else 1.0
        return replace(of, mass=share * of.mass, inertia=share * self.rotary * np.asarray(of.inertia).item())


AS_BUILT = Variation()


@cache
def structure(boundary: Boundary = "pinned", varied: Variation = AS_BUILT) -> Structure:
    """FEM1 (``table``), FEM2 (``fixed``) or FEM3 (``pinned``)."""
    truss = varied.of(barker_truss(boundary))
    return assemble(replace(truss, ports={**truss.ports, **DOFS}), "tip")


@cache
def frame(boundary: Boundary = "pinned", varied: Variation = AS_BUILT) -> ModalFrame:
    """All modes of a finite-element model without the mirror."""
    of = structure(boundary, varied)
    return modal_frame(of, of.area, of.batten_mass, 0.0, "tip")


@cache
def support(full: bool = False) -> ModalSet:
    """The flexible support structure: Model#1, or all 61 degrees of freedom."""
    modes = frame().modal_set(Hub("free"), DAMPING, PORTS)
    return modes if full else modes.keep(range(REDUCED))


@cache
def reduced() -> tuple[Array, Array, Array]:
    """Mass, damping and stiffness of Model#1 in its seven degrees of freedom."""
    modes = frame().modal_set(Hub("free"), DAMPING, PORTS)
    return reduced_matrices(frame(), modes, [f"{at}.{c}" for at, c in DOFS.values()], range(REDUCED))


@cache
def model_1() -> StateSpace:
    """Model#1 as a state space with a load and a motion at each of its seven degrees of freedom."""
    return second_order_state_space(*reduced(), dict(zip(DOFS, np.eye(REDUCED), strict=True)))


@cache
def mirror_mass() -> float:
    """Mass of the mirror from its share of the whole [kg]."""
    of = structure()
    return MIRROR_SHARE / (1 - MIRROR_SHARE) * float(structural_mass(of, of.area, of.batten_mass))


@cache
def mirror_structure(full: bool = False) -> ModalSet:
    """The support structure with the mirror's mass on it, added after the reduction as section 2.4.2 does."""
    return with_added_mass(support(full), {"x20": mirror_mass(), "y20": mirror_mass()}, DAMPING)


def mirror(
    hertz: float = ELECTROMAGNETIC,
    percent: float = MIRROR_PERCENT,
    reaction_mass: MirrorReactionMass | None = None,
) -> Mirror:
    """The fast steering mirror, its inertia in percent of the truss's about the hub."""
    of = structure()
    inertia = percent / 100 * float(structure_inertia(of, of.area, of.batten_mass))
    return Mirror(inertia, HZ * hertz, MIRROR_DAMPING, reaction_mass)


def actuator(port: str, times: float = 1.0) -> ReactionMassActuator:
    """A reaction-mass actuator; `times` its assumed mass."""
    of = structure()
    mass = times * ACTUATOR_SHARE * float(structural_mass(of, of.area, of.batten_mass))
    return ReactionMassActuator(port, mass, HZ * ACTUATOR_HZ, ACTUATOR_DAMPING)


@dataclass(frozen=True)
class OpticalSystem:
    """Mirror and actuators on the support structure: models 2 to 5.

    Attributes
    ----------
    full
        Whether the structure keeps all its modes.
    massless
        Whether the mirror's mass is left out, its inertia kept.
    """

    mirror: Mirror
    actuators: tuple[ReactionMassActuator, ...] = ()
    full: bool = False
    massless: bool = False

    @property
    def modes(self) -> ModalSet:
        """Of the structure that carries them."""
        return support(self.full) if self.massless else mirror_structure(self.full)

    @property
    def loop(self) -> Loop:
        """Mirror and actuators with an idle controller that is fed the motion of the hub."""
        return Loop(self.mirror, PID(0.0, 0.0, 0.0, 0.0), Placement(sensor="hub"), self.actuators)

    @property
    def state_space(self) -> StateSpace:
        """Its inputs and outputs are those of `plant_state_space`; the sensor reads the hub."""
        return plant_state_space(self.loop, self.modes, "tip")

    @property
    def degrees_of_freedom(self) -> int:
        """Half the order of the state space."""
        return int(self.state_space.a.shape[0] // 2)

    @property
    def natural_frequencies(self) -> Array:
        """Ascending, those of rigid-body motion left out, with damping [Hz]."""
        poles = self.poles
        return np.sort(np.abs(poles[poles.imag > 0])) / HZ

    @property
    def poles(self) -> ComplexArray:
        """Poles in ascending size, those of rigid-body motion zero exactly [rad/s]."""
        poles = np.linalg.eigvals(self.state_space.a).astype(complex)
        poles = poles[np.argsort(np.abs(poles), kind="stable")]
        poles[: 2 * np.count_nonzero(self.modes.rigid)] = 0.0
        return poles

    def zeros(self, place: Place) -> ComplexArray:
        """Zeros between the load and the motion of a place [rad/s]."""
        coupled = modal_matrices(self.loop, self.modes, "tip")
        match place:
            case "mirror":
                motion = np.eye(coupled.mass.shape[0])[coupled.mirror]
            case "hub":
                motion = coupled.sensor
            case "actuator":
                motion = coupled.relative[0]
        load = coupled.control if place == "mirror" else motion
        found = plant_zeros(replace(coupled, control=load, sensor=motion))
        # A rate has one zero more than its displacement.
        return np.append(found, np.zeros(int(place == "actuator"), complex))

    def response(self, label: str, place: Place, low: float, high: float) -> Response:
        """Mirror angle per control torque, hub angle per hub torque, or an actuator's relative rate per its force."""
        space, (load, motion) = self.state_space, _SIGNALS[place]
        return resolved_response(
            label, lambda s: space.response(s, load, motion), self.zeros(place), self.poles, low, high
        )
