"""Random mirrors with two axes, with the answers of fosopt and what Octave needs to find them by itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray
from systems import random_mast

from fosopt.actuators import Mirror
from fosopt.control import PID, Loop, SteeredAxis, closed_loop_poles, closed_loop_response, gain_for_crossover
from fosopt.metrics.axes import axis_models, axis_variances, multivariable_margin
from fosopt.metrics.disturbances import Disturbance, high_pass, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.modes import Damping, Hub, ModalSet, modal_frame
from fosopt.structure import Structure, assemble, mass_matrix, stiffness_matrix

Array = NDArray[np.float64]

HZ = 2 * pi
INPUTS = ("mirror_torque", "hub_torque", "line_of_sight", "sensor_noise")
"""In the order of the columns of the answers, each about the first and the second axis."""
_POINTS = 25
_MIRROR_MASS = 2.0


@dataclass(frozen=True)
class TwoAxisSystem:
    """A spatial mast that bends in two directions, with a mirror and a loop about each.

    Attributes
    ----------
    low_corner, high_corner
        Of the filters that shape the disturbances [rad/s].
    """

    number: int
    structure: Structure
    damping: Damping
    loop: Loop
    low_corner: float
    high_corner: float

    @property
    def modes(self) -> ModalSet:
        """All modes at the ports of both loops."""
        of = self.structure
        frame = modal_frame(of, of.area, of.batten_mass, _MIRROR_MASS, "tip")
        return frame.modal_set(Hub("fixed"), self.damping, ("hub", "tip", "hub_y", "tip_y"))

    @property
    def frequency(self) -> Array:
        """(m,) Where frequency responses are compared [rad/s]."""
        return np.geomspace(0.5 * HZ, 500 * HZ, _POINTS)

    def for_others(self) -> dict[str, Any]:
        """Physical data, for a MATLAB file."""
        of, loop = self.structure, self.loop
        assert loop.beside is not None
        mirrors, pids = (loop.mirror, loop.beside.mirror), (loop.controller, loop.beside.controller)
        return {
            "K": stiffness_matrix(of, of.area),
            "M": mass_matrix(of, of.area, of.batten_mass, _MIRROR_MASS),
            "ports": np.array([of.port("tip"), of.port("tip_y")]).T,
            "hubs": np.array([of.port("hub"), of.port("hub_y")]).T,
            "damping_ratio": self.damping.of(np.ones(1))[0],
            "mirrors": [[m.inertia, m.natural_frequency, m.damping_ratio] for m in mirrors],
            "pids": [[c.gain, c.kp, c.ki, c.kd, c.rolloff_time] for c in pids],
            "frequency": self.frequency,
            "low_corner": self.low_corner,
            "high_corner": self.high_corner,
        }

    def answers(self) -> dict[str, Any]:
        """What fosopt says: poles, all frequency responses, and norms of stable loops."""
        modes = self.modes
        model = LoopModel(self.loop, modes, "tip")
        models, poles = axis_models(model), closed_loop_poles(self.loop, modes, "tip")
        responses = np.empty((2, 2 * len(INPUTS), _POINTS), dtype=complex)
        for axis, each in enumerate(models):
            points = each.points(1j * self.frequency)
            for k, name in enumerate(INPUTS):
                for source in (0, 1):
                    own = name if source == axis else f"other_{name}"
                    responses[axis, 2 * k + source] = closed_loop_response(own, each.loop, points.s, points.g)
        found = {"poles": poles.all, "responses": responses, "stable": poles.spectral_abscissa < 0}
        if not found["stable"]:
            return found
        disturbances = [
            Disturbance("air", "line_of_sight", low_pass(self.low_corner, 1e-5), axis="both"),
            Disturbance("noise", "sensor_noise", high_pass(self.high_corner, 1e-8), axis="both"),
            Disturbance("hub", "hub_torque", low_pass(self.low_corner, 0.02), axis="both"),
        ]
        squares = axis_variances(models, poles, disturbances)
        found["rms"] = np.sqrt([first.value + second.value for first, second in squares])
        found["largest_sensitivity"] = 1 / multivariable_margin(model, poles)
        return found


def two_axis_system(number: int) -> TwoAxisSystem:
    """A system that follows from its number alone."""
    rng = np.random.default_rng([1991, 2, number])
    truss = random_mast(rng)
    top = truss.ports["tip"][0]
    ports = {"hub": ("B1", "rz"), "tip": (top, "rz"), "hub_y": ("B1", "ry"), "tip_y": (top, "ry")}
    structure = assemble(replace(truss, ports=ports), "tip")
    axes = []
    for _ in range(2):
        mirror = Mirror(
            10 ** rng.uniform(-3, -1.5), 10 ** rng.uniform(0.5, 1.5) * HZ, 10 ** rng.uniform(-2, -1)
        )
        terms = {
            "kp": 10 ** rng.uniform(1.5, 2.7),
            "ki": 10 ** rng.uniform(2, 4),
            "kd": 1.0,
            "rolloff_time": 10 ** rng.uniform(-4.5, -3),
        }
        axes.append((mirror, PID(gain_for_crossover(10 ** rng.uniform(1, 2) * HZ, mirror, **terms), **terms)))
    loop = replace(Loop(*axes[0]), beside=SteeredAxis("tip_y", *axes[1], "hub_y"))
    damping = Damping((10 ** rng.uniform(-3, -1.7),))
    return TwoAxisSystem(
        number, structure, damping, loop, 10 ** rng.uniform(0, 1.5) * HZ, 10 ** rng.uniform(1.5, 2.5) * HZ
    )
