"""The line-of-sight loop in closed form.

A mirror on a spring sees its structure through a few receptances: g_rr at the port its spring refers to, g_ro from
the hub, and those of the ports where the loop reacts, acts or senses when these differ. With the coupling
κ = c_m s + k_m and Z = J_m s² (1 + κ g_rr) + κ, all transfer functions of the closed loop share one denominator

    Δ(s) = Z + P K,

P/Z being the plant from control torque to sensor. For a bicollocated mirror P is one: the cross terms cancel.

Every formula is a rational function of `s`, the receptances and the parameters: it runs on NumPy arrays, on
`ops.ComplexPair` and on `ops.Dual`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from math import isqrt
from typing import Any

from fosopt.actuators import BICOLLOCATED, Mirror, Placement, ReactionMassActuator, Suspended
from fosopt.control.pid import PID, command_response, pid_response
from fosopt.control.steered import SteeredAxis
from fosopt.errors import ModelError

_REFERENCE, _HUB = 0, 1


@dataclass(frozen=True)
class Loop:
    """A mirror, its controller, where they act, the reaction-mass actuators and the other axis beside them.

    Attributes
    ----------
    beside
        The mirror's other axis, whose loop is closed as well. Whatever is said of this loop holds with that one closed.
    hub
        Port of the hub about this axis.

    Raises
    ------
    ModelError
        If there is another axis beside a loop that is not bicollocated, is sampled or has a reaction mass.
    """

    mirror: Mirror
    controller: PID
    placement: Placement = BICOLLOCATED
    actuators: tuple[ReactionMassActuator, ...] = ()
    beside: SteeredAxis | None = None
    hub: str = "hub"

    def __post_init__(self) -> None:
        if self.beside is None:
            return
        mirrors, controllers = (self.mirror, self.beside.mirror), (self.controller, self.beside.controller)
        refused = "two axes: {} not known of a mirror with two; study one axis, or both without it"
        if self.placement != BICOLLOCATED:
            raise ModelError(refused.format("sensor, action or reaction elsewhere than at the mirror are"))
        if any(mirror.reaction_mass is not None for mirror in mirrors):
            raise ModelError(refused.format("reaction masses are"))
        if any(controller.path.sampling is not None for controller in controllers):
            raise ModelError(refused.format("controllers that sample are"))

    @cached_property
    def other_ports(self) -> tuple[str, ...]:
        """Ports beside the mirror's own and the hub."""
        place, beside = self.placement, self.beside
        named = [place.reaction, place.sensor, place.action, *(a.port for a in self.actuators)]
        if beside is not None:
            named += [beside.port, beside.hub]
        return tuple(dict.fromkeys(p for p in named if p is not None and p != self.hub))

    def ports(self, mirror_port: str) -> tuple[str, ...]:
        """Ports in the order in which `Receptances` counts them: the mirror's, the hub, the others."""
        return (mirror_port, self.hub, *self.other_ports)

    def index(self, port: str | None) -> int:
        """Place of a port in that order; None is the mirror's."""
        if port is None:
            return _REFERENCE
        return _HUB if port == self.hub else 2 + self.other_ports.index(port)

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of ports whose receptances the formulas use."""
        place = self.placement
        simple = not self.other_ports and self.hub not in (place.sensor, place.action)
        return ((0, 0), (0, 1)) if simple else port_pairs(2 + len(self.other_ports))

    @property
    def attachments(self) -> Iterator[tuple[int, Suspended | SteeredAxis]]:
        """What hangs on the structure beside the mirror, with the index of its port."""
        yield from self.suspended
        if self.beside is not None:
            yield self.index(self.beside.port), self.beside

    @property
    def suspended(self) -> Iterator[tuple[int, Suspended]]:
        """What of it has no loop of its own."""
        if self.mirror.counter is not None:
            yield _REFERENCE, self.mirror.counter
        for actuator in self.actuators:
            yield self.index(actuator.port), actuator.suspended

    @property
    def bare(self) -> bool:
        """Whether nothing but the mirror is attached to the structure."""
        return self.mirror.reaction_mass is None and not self.actuators and self.beside is None

    @property
    def plain(self) -> bool:
        """Whether it is a bicollocated mirror and nothing else."""
        return self.bare and self.placement == BICOLLOCATED


@cache
def port_pairs(count: int) -> tuple[tuple[int, int], ...]:
    """Every pair of `count` ports, those of mirror and hub first."""
    every = [(a, b) for a in range(count) for b in range(a, count)]
    return ((0, 0), (0, 1), *(pair for pair in every if pair not in ((0, 0), (0, 1))))


@cache
def _places(count: int) -> dict[tuple[int, int], int]:
    return {pair: k for k, pair in enumerate(port_pairs(count))}


@dataclass(frozen=True)
class Receptances:
    """What the loop sees of its structure at one Laplace variable, [rad/(N m)].

    Attributes
    ----------
    direct
        g_rr, mirror port to itself.
    cross
        g_ro, hub to mirror port.
    others
        The remaining pairs in the order of `port_pairs`; empty for a bicollocated mirror alone.
    """

    direct: Any
    cross: Any
    others: tuple[Any, ...] = ()

    @classmethod
    def of(cls, values: Any) -> Receptances:
        """From all of them, in the order of `port_pairs`."""
        return cls(values[0], values[1], tuple(values[2:]))

    @property
    def values(self) -> tuple[Any, ...]:
        """All of them, in the order of `port_pairs`."""
        return (self.direct, self.cross, *self.others)

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """The pair of ports of each of `values`."""
        return port_pairs(self._count) if self.others else ((0, 0), (0, 1))

    def between(self, port: int, other: int) -> Any:
        """Receptance between two ports by their index."""
        if not self.others:
            return self.direct if port == other else self.cross
        return self.values[_places(self._count)[min(port, other), max(port, other)]]

    @property
    def _count(self) -> int:
        return (isqrt(8 * (2 + len(self.others)) + 1) - 1) // 2


def with_attachments(loop: Loop, s: Any, g: Receptances) -> Receptances:
    """Receptances of the structure with everything on it but the mirror.

    [Barker1991] Eqs. (2.38), (2.47); [Sherman1950]
    """
    for port, body in loop.attachments:
        g = attach(s, g, port, body, loop.pairs)
    return g


def attach(
    s: Any,
    g: Receptances,
    port: int,
    body: Suspended | SteeredAxis,
    wanted: Collection[tuple[int, int]],
) -> Receptances:
    """Receptances with a body of dynamic stiffness D at port a: the rank-one update g_pq − g_pa g_aq D/(1 + D g_aa).

    [Sherman1950]

    Parameters
    ----------
    wanted
        Pairs that are asked for, with all that their updates need; the others stay as they are.
    """
    kappa, restoring = body.coupling(s), body.restoring(s)
    inertial = body.inertia * s**2
    # D and 1 + D g_aa times J s² + κ (+ K of a loop), which is zero at the body's own resonance.
    stiffness, free = inertial * kappa, inertial + restoring
    held = inertial * (1 + kappa * g.between(port, port)) + restoring
    values = []
    for p, q in g.pairs:
        known = g.between(p, q)
        if (p, q) not in wanted:
            values.append(known)
        elif port in (p, q):  # the same quotient without its cancellation
            values.append(known * free / held)
        else:
            values.append(known - g.between(p, port) * g.between(port, q) * stiffness / held)
    return Receptances.of(values)


def coupling(loop: Loop, s: Any) -> Any:
    """Spring and damper between mirror and port, κ(s) = c_m s + k_m [N m/rad]."""
    return loop.mirror.damping * s + loop.mirror.stiffness


def plant_impedance(loop: Loop, s: Any, g: Receptances) -> Any:
    """Z(s) = J_m s² (1 + κ g_rr) + κ: torque per angle of the mirror, times 1 + κ g_rr [N m/rad].

    Its zeros are the poles of the coupled plant.    [Barker1991] Eq. (4.18)
    """
    return impedance(s, loop.mirror.inertia, coupling(loop, s), g.direct)


def impedance(s: Any, inertia: Any, kappa: Any, receptance: Any) -> Any:
    """J s² (1 + κ g) + κ of a body on a spring and damper κ where the receptance is g.

    Its zeros are the poles of structure and body together.    [Barker1991] Eq. (4.18)
    """
    return inertia * s**2 * (1 + kappa * receptance) + kappa


def _leakage(loop: Loop, s: Any, g: Receptances, port: int) -> Any:
    """Motion of a port per control torque through the reaction mass of a reactionless mirror and its drive."""
    shares, counter = loop.mirror.reaction_mass, loop.mirror.counter
    if shares is None or counter is None:
        return 0.0
    reacting, mounted = loop.index(loop.placement.reaction), g.between(port, _REFERENCE)
    if reacting == _REFERENCE:
        return shares.torque_ratio * (mounted * counter.slip(s))
    return shares.torque_ratio * (g.between(port, reacting) - counter.transmission(s) * mounted)


def _reach(loop: Loop, s: Any, g: Receptances, port: int) -> Any:
    """Motion of a port per control torque, as if a torque on the mirror acted on the mirror's port."""
    acting, reacting = loop.index(loop.placement.action), loop.index(loop.placement.reaction)
    leakage = _leakage(loop, s, g, port)
    if acting == reacting:
        return leakage
    return g.between(port, acting) - g.between(port, reacting) + leakage


def _structure_reach(loop: Loop, s: Any, g: Receptances, port: int) -> Any:
    """Motion of a port of the structure without mirror per control torque on it."""
    place = loop.placement
    reach = _leakage(loop, s, g, port) - g.between(port, loop.index(place.reaction))
    return reach if place.action is None else reach + g.between(port, loop.index(place.action))


def mirror_gain(loop: Loop, s: Any, g: Receptances) -> Any:
    """Mirror angle per control torque times Z; one for a bicollocated mirror.    [Barker1991] Eq. (4.22)"""
    if loop.plain:
        return 1.0
    acting = 0.0 if loop.placement.action else 1.0
    return acting + coupling(loop, s) * _reach(loop, s, g, _REFERENCE)


def sensor_gain(loop: Loop, s: Any, g: Receptances) -> Any:
    """P: sensed angle per control torque times Z.    [Barker1991] Eqs. (3.6), (4.22)"""
    if loop.placement.sensor is None:
        return mirror_gain(loop, s, g)
    kappa, inertial = coupling(loop, s), loop.mirror.inertia * s**2
    j = loop.index(loop.placement.sensor)
    g_j = g.between(j, _REFERENCE)
    here, there = _structure_reach(loop, s, g, _REFERENCE), _structure_reach(loop, s, g, j)
    gain = (inertial + kappa) * there + kappa * inertial * (g.direct * there - g_j * here)
    return gain if loop.placement.action else gain + kappa * g_j


def characteristic(loop: Loop, s: Any, g: Receptances) -> Any:
    """Δ(s), whose zeros are the closed-loop poles [N m/rad].    [Barker1991] Eq. (4.29)"""
    return plant_impedance(loop, s, g) + sensor_gain(loop, s, g) * pid_response(loop.controller, s)


def loop_transfer(loop: Loop, s: Any, g: Receptances) -> Any:
    """L(s) = G(s) K(s) [-]."""
    return sensor_gain(loop, s, g) * pid_response(loop.controller, s) / plant_impedance(loop, s, g)


def command_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Mirror angle per commanded angle times Δ.    [Barker1991] Eq. (4.28)"""
    return mirror_gain(loop, s, g) * command_response(loop.controller, s)


def torque_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Control torque per commanded angle times Δ, Z K."""
    return plant_impedance(loop, s, g) * command_response(loop.controller, s)


def stroke_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Angle of the mirror against its port per commanded angle times Δ; (1 + J_m s² g_rr) K for a bicollocated one."""
    acting = 0.0 if loop.placement.action else 1.0
    own = acting - loop.mirror.inertia * s**2 * _structure_reach(loop, s, g, _REFERENCE)
    return own * command_response(loop.controller, s)


def line_of_sight_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Line-of-sight error per line-of-sight displacement times Δ."""
    impedance = plant_impedance(loop, s, g)
    if loop.placement.sensor is None:
        return impedance
    unseen = sensor_gain(loop, s, g) - mirror_gain(loop, s, g)
    return impedance + unseen * pid_response(loop.controller, s)


def sensor_noise_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Mirror angle per measurement noise times Δ."""
    return -mirror_gain(loop, s, g) * pid_response(loop.controller, s)


def mirror_torque_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Mirror angle per external torque on the mirror times Δ; 1 + κ g_rr where the sensor is on the mirror."""
    kappa = coupling(loop, s)
    numerator = 1 + kappa * g.direct
    if loop.placement.sensor is None:
        return numerator
    j = loop.index(loop.placement.sensor)
    here, there = _structure_reach(loop, s, g, _REFERENCE), _structure_reach(loop, s, g, j)
    unsensed = there + kappa * (g.direct * there - g.between(j, _REFERENCE) * here)
    return numerator + unsensed * pid_response(loop.controller, s)


def hub_torque_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Mirror angle per torque on the hub (aft-to-fore body) times Δ; κ g_ro where the sensor is on the mirror."""
    kappa = coupling(loop, s)
    numerator = kappa * g.cross
    if loop.placement.sensor is None:
        return numerator
    j = loop.index(loop.placement.sensor)
    g_j, g_jo = g.between(j, _REFERENCE), g.between(j, _HUB)
    here, there = _structure_reach(loop, s, g, _REFERENCE), _structure_reach(loop, s, g, j)
    unsensed = kappa * (g.cross * there - g_jo * here)
    if loop.placement.action is None:
        unsensed = unsensed - g_jo - kappa * (g.direct * g_jo - g_j * g.cross)
    return numerator + unsensed * pid_response(loop.controller, s)


def _other(loop: Loop) -> SteeredAxis:
    if loop.beside is None:
        raise ModelError("this input acts about a second axis, which the mirror has not")
    return loop.beside


def _pushed(loop: Loop, s: Any, g: Receptances) -> Any:
    """Mirror angle per load at the other axis' port times Δ, over the J s² + κ + K that its receptance holds."""
    other = _other(loop)
    received = coupling(loop, s) * g.between(_REFERENCE, loop.index(other.port))
    return received / (other.inertia * s**2 + other.restoring(s))


def other_noise_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Mirror angle per measurement noise, or line-of-sight displacement, about the other axis times Δ.

    The noise n turns the other axis, which pushes the structure with J s² K/(J s² + κ + K) n.
    """
    other = _other(loop)
    return other.inertia * s**2 * pid_response(other.controller, s) * _pushed(loop, s, g)


def other_mirror_torque_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Mirror angle per torque t on the mirror about the other axis times Δ; (κ + K)/(J s² + κ + K) t load its port."""
    return _other(loop).restoring(s) * _pushed(loop, s, g)


def other_hub_torque_numerator(loop: Loop, s: Any, g: Receptances) -> Any:
    """Mirror angle per torque on the hub about the other axis times Δ, κ g."""
    return coupling(loop, s) * g.between(_REFERENCE, loop.index(_other(loop).hub or loop.hub))


Formula = Callable[[Loop, Any, Receptances], Any]

# Numerators over the common denominator Δ(s). The first four say where a disturbance enters the loop and how
# the line of sight answers; S = line_of_sight and T = command are the sensitivity functions.
NUMERATORS: dict[str, Formula] = {
    "mirror_torque": mirror_torque_numerator,
    "hub_torque": hub_torque_numerator,
    "line_of_sight": line_of_sight_numerator,
    "sensor_noise": sensor_noise_numerator,
    "command": command_numerator,
}

# The same for disturbances about the mirror's other axis.
OTHER_AXIS: dict[str, Formula] = {
    "other_mirror_torque": other_mirror_torque_numerator,
    "other_hub_torque": other_hub_torque_numerator,
    "other_line_of_sight": other_noise_numerator,
    "other_sensor_noise": other_noise_numerator,
}

# Numerators of what the mirror does when it is commanded.
COMMANDED: dict[str, Formula] = {
    "command": command_numerator,
    "stroke": stroke_numerator,
    "torque": torque_numerator,
}


def closed_loop_response(name: str, loop: Loop, s: Any, g: Receptances) -> Any:
    """Closed-loop transfer function from an input to the line of sight, by its name in `NUMERATORS` or `OTHER_AXIS`."""
    return numerator_of(name)(loop, s, g) / characteristic(loop, s, g)


def numerator_of(name: str) -> Formula:
    """The numerator of a closed-loop transfer function over Δ(s), by its name in `NUMERATORS` or `OTHER_AXIS`."""
    return NUMERATORS[name] if name in NUMERATORS else OTHER_AXIS[name]
