"""Random systems with the answers of fosopt, and what another program needs to find them by itself.

Another program gets physical data alone: mass and stiffness matrices, rows that read the ports, damping ratios,
properties of mirror, actuators and controller. Modes, plant, loop and norms are its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror, MirrorReactionMass, Placement, ReactionMassActuator
from fosopt.control import (
    PID,
    ClosedLoopPoles,
    Loop,
    Sampling,
    SignalPath,
    closed_loop_poles,
    closed_loop_response,
    gain_for_crossover,
)
from fosopt.metrics.disturbances import Disturbance, high_pass, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances, resonance_quadrature
from fosopt.metrics.margins import modulus_margins
from fosopt.metrics.sampled import SampledModel
from fosopt.modes import Damping, Hub, ModalSet, modal_frame
from fosopt.structure import (
    Bar,
    Batten,
    Structure,
    Truss,
    assemble,
    barker_truss,
    mass_matrix,
    stiffness_matrix,
    structure_inertia,
)

Array = NDArray[np.float64]

HZ = 2 * pi
RESPONSES = ("mirror_torque", "hub_torque", "line_of_sight", "sensor_noise")
MIDDLE = "middle"
_POINTS = 25


@dataclass(frozen=True)
class RandomSystem:
    """A structure with a loop on it.

    Attributes
    ----------
    kind
        What stands in the report.
    sampling
        Of the same loop with a digital controller.
    low_corner, high_corner
        Of the filters that shape the disturbances [rad/s].
    """

    number: int
    kind: str
    structure: Structure
    mirror_mass: float
    hub: Hub
    damping: Damping
    loop: Loop
    low_corner: float
    high_corner: float
    sampling: Sampling

    @property
    def modes(self) -> ModalSet:
        """All modes at the ports of the loop."""
        of = self.structure
        frame = modal_frame(of, of.area, of.batten_mass, self.mirror_mass, "tip")
        return frame.modal_set(self.hub, self.damping, ("hub", "tip", MIDDLE))

    def for_others(self) -> dict[str, Any]:
        """Physical data, for a MATLAB file."""
        of, loop = self.structure, self.loop
        mirror, pid, place = loop.mirror, loop.controller, loop.placement
        shares = mirror.reaction_mass
        ports = {"tip": 1.0, MIDDLE: 2.0, None: 0.0}
        return {
            "K": stiffness_matrix(of, of.area),
            "M": mass_matrix(of, of.area, of.batten_mass, self.mirror_mass),
            "tip": of.port("tip")[:, None],
            "middle": of.port(MIDDLE)[:, None],
            "hub": of.port("hub")[:, None],
            "hub_type": self.hub.type,
            "hub_bandwidth": self.hub.bandwidth or 0.0,
            "hub_damping": self.hub.damping_ratio or 0.0,
            "damping_ratio": self.damping.of(np.ones(1))[0],
            "mirror": [mirror.inertia, mirror.natural_frequency, mirror.damping_ratio],
            "pid": [pid.gain, pid.kp, pid.ki, pid.kd, pid.rolloff_time],
            "reaction": ports[place.reaction],
            "sensor": ports[place.sensor],
            "shares": [shares.inertia_ratio, shares.stiffness_ratio, shares.torque_ratio] if shares else [],
            "actuators": [
                [a.mass, a.natural_frequency, a.damping_ratio, a.rate_gain] for a in loop.actuators
            ],
            "frequency": self.frequency,
            "period": self.sampling.period,
            "delay": self.sampling.delay,
            "backward": float(self.sampling.derivative == "backward"),
            "sampled_frequency": self.sampled_frequency,
            "low_corner": self.low_corner,
            "high_corner": self.high_corner,
        }

    @property
    def frequency(self) -> Array:
        """(m,) Where frequency responses are compared [rad/s]."""
        return np.geomspace(0.5 * HZ, 500 * HZ, _POINTS)

    @property
    def sampled_frequency(self) -> Array:
        """(m,) Where the sampled loop's transfer function is compared, up to the Nyquist frequency [rad/s]."""
        return np.geomspace(0.5 * HZ, 0.99 * pi / self.sampling.period, _POINTS)

    def sampled_answers(self) -> dict[str, Any]:
        """What fosopt says of the same loop with a digital controller."""
        pid = replace(self.loop.controller, path=SignalPath(sampling=self.sampling))
        model = SampledModel(replace(self.loop, controller=pid), self.modes, "tip")
        z = np.exp(1j * self.sampled_frequency * self.sampling.period)
        return {
            "poles": model.bare.poles,
            "loop": model.bare.loop_transfer(z),
            "largest_sensitivity": 1 / model.modulus_margin if model.stable else np.nan,
        }

    def answers(self) -> dict[str, Any]:
        """What fosopt says: frequencies, poles, frequency responses, and norms of a stable loop."""
        modes = self.modes
        poles = closed_loop_poles(self.loop, modes, "tip")
        model = LoopModel(self.loop, modes, "tip")
        points = model.points(1j * self.frequency)
        drift = np.zeros(2 if self.hub.type == "free" else 0)
        found: dict[str, Any] = {
            "frequency": modes.natural_frequency[~modes.rigid],
            "poles": np.concatenate([poles.all, drift]),
            "responses": np.array(
                [closed_loop_response(name, self.loop, points.s, points.g) for name in RESPONSES]
            ),
            "stable": poles.spectral_abscissa < 0,
        }
        if not found["stable"]:
            return found
        disturbances = [
            Disturbance("air", "line_of_sight", low_pass(self.low_corner, 1e-5)),
            Disturbance("noise", "sensor_noise", high_pass(self.high_corner, 1e-8)),
        ]
        if self.hub.type != "free":
            # On a free rigid body a torque has unbounded drift.
            disturbances.append(Disturbance("torque", "mirror_torque", low_pass(self.low_corner, 0.02)))
        variances = jitter_variances(model, poles, disturbances)
        found["rms"] = np.sqrt([variance.value for variance in variances])
        found["rms_by_quadrature"] = [self._by_quadrature(d, model, poles) for d in disturbances]
        found["largest_sensitivity"] = 1 / float(modulus_margins(model, poles, 1)[0][0])
        return found

    def _by_quadrature(self, disturbance: Disturbance, model: LoopModel, poles: ClosedLoopPoles) -> float:
        """Rms line-of-sight error by an integral over frequency instead of residues [rad]."""
        assert disturbance.filter is not None
        every = np.concatenate([poles.all, disturbance.filter.poles])
        frequency, weight = resonance_quadrature(every, 0.0, inf, np.zeros(0))
        points = model.points(1j * frequency)
        response = closed_loop_response(disturbance.at, self.loop, points.s, points.g)
        density = disturbance.one_sided_psd(frequency) * np.abs(response) ** 2
        return float(np.sqrt(np.sum(weight * density) / (2 * pi)))


def random_system(number: int) -> RandomSystem:
    """A system that follows from its number alone."""
    rng = np.random.default_rng([1991, number])
    spatial = number % 3 == 2
    truss = random_mast(rng) if spatial else _barker(rng)
    structure = assemble(truss, "tip")
    inertia = float(structure_inertia(structure, structure.area, structure.batten_mass))
    hub = (
        Hub("fixed")
        if spatial
        else Hub("free")
        if number % 4 == 1
        else Hub("held", rng.uniform(0.02, 0.5) * HZ, rng.uniform(0.3, 0.9))
    )
    layouts = (
        "mirror alone",
        "reaction elsewhere",
        "reactionless mirror",
        "reaction-mass actuator",
        "sensor below",
    )
    layout = layouts[(number // 3) % len(layouts)]
    if layout == "sensor below" and hub.type == "free":
        layout = "mirror alone"
    shares = MirrorReactionMass(*rng.uniform(0.7, 1.3, 3)) if layout == "reactionless mirror" else None
    mirror = Mirror(
        inertia * 10 ** rng.uniform(-5, -1), rng.uniform(5, 40) * HZ, rng.uniform(0.005, 0.1), shares
    )
    placement = {
        "reaction elsewhere": Placement(reaction=MIDDLE),
        "sensor below": Placement(sensor="tip", action="tip", reaction=MIDDLE),
    }.get(layout, Placement())
    actuators = ()
    if layout == "reaction-mass actuator":
        proof, rate = inertia * rng.uniform(1e-3, 1e-2), rng.uniform(5, 60) * HZ
        actuators = (
            ReactionMassActuator(
                MIDDLE, proof, rate, rng.uniform(0.02, 0.5), proof * rate * rng.uniform(0, 1), rotary=True
            ),
        )
    terms = {"kp": rng.uniform(100, 900), "ki": 10 ** rng.uniform(3, 5), "kd": 1.0}
    rolloff = 10 ** rng.uniform(-4.5, -3.3)
    crossover = 10 ** rng.uniform(1, 2.6) * HZ
    gain = gain_for_crossover(crossover, replace(mirror, reaction_mass=None), rolloff_time=rolloff, **terms)
    if layout == "sensor below":
        gain *= 0.01
    return RandomSystem(
        number,
        f"{'spatial' if spatial else 'planar'}, {hub.type} hub, {layout}",
        structure,
        rng.uniform(0.1, 2.0) * float(structure.batten_mass.sum()),
        hub,
        Damping((rng.uniform(0.001, 0.02),)),
        Loop(mirror, PID(gain, rolloff_time=rolloff, **terms), placement, actuators),
        rng.uniform(2, 30) * HZ,
        rng.uniform(20, 200) * HZ,
        _sampling(rng, crossover),
    )


def _sampling(rng: np.random.Generator, crossover: float) -> Sampling:
    period = 2 * pi / (crossover * rng.uniform(15, 60))
    return Sampling(
        period, period * rng.uniform(0.05, 1.7), "backward" if rng.random() < 0.5 else "trapezoidal"
    )


def _barker(rng: np.random.Generator) -> Truss:
    bays = int(rng.integers(2, 8))
    truss = barker_truss("pinned", bays)
    bars = tuple(replace(bar, area=bar.area * rng.uniform(0.3, 3.0)) for bar in truss.bars)
    middle = truss.battens[bays // 2].name
    return replace(truss, bars=bars, ports=truss.ports | {MIDDLE: (middle, "rz")})


def random_mast(rng: np.random.Generator) -> Truss:
    """A mast of rigid square frames and pin-ended bars, clamped, with no symmetry left."""
    bays = int(rng.integers(2, 5))
    nodes, battens, bars = {}, [], []
    for i in range(bays + 1):
        for j, (y, z) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
            nodes[f"N{i}{j}"] = tuple(
                float(x) for x in np.array([0.5 * i, 0.2 * y, 0.2 * z]) + rng.uniform(-0.02, 0.02, 3)
            )
        inertia = tuple(float(x) for x in rng.uniform(0.03, 0.1, 3))
        battens.append(
            Batten(f"B{i}", tuple(f"N{i}{j}" for j in range(4)), float(rng.uniform(1, 3)), inertia)
        )
    for i in range(1, bays + 1):
        for j in range(4):
            k = (j + 1) % 4
            for name, ends in (
                ("L", (f"N{i - 1}{j}", f"N{i}{j}")),
                ("D", (f"N{i - 1}{j}", f"N{i}{k}")),
            ):
                area = float(1e-4 * 10 ** rng.uniform(-0.5, 0.5))
                bars.append(Bar(f"{name}{i}{j}", ends, area, 70e9, 2700.0))
    held = ("x", "y", "z", "rx", "ry", "rz")
    return Truss(
        nodes,
        tuple(bars),
        {"hub": ("B1", "rz"), "tip": (f"B{bays}", "rz"), MIDDLE: (f"B{(bays + 1) // 2}", "ry")},
        {"B0": held},
        tuple(battens),
    )
