"""Systems of chapter 3: the modified benchmark problem, its rigidly supported actuated mass, and what disturbs them.

Masses stand for inertias and displacements for angles: one displacement unit [du] is one radian.

Not published, hence chosen here: the split of the support's mass, which table 3.3 decides (two equal halves), and
the spectra of the disturbances, which were published as pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from fosopt.actuators import Mirror
from fosopt.control import PID, ClosedLoopPoles, Loop, closed_loop_poles, closed_loop_response, loop_transfer
from fosopt.control.locus import RootLocus, root_locus
from fosopt.control.phase import continuous_phase, resonance_grid
from fosopt.metrics.disturbances import Disturbance, ShapingFilter, high_pass, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.sequence import Engagements, Retargeting, engagements
from fosopt.metrics.transient import Transient, step_error
from fosopt.modes import Damping, Hub, ModalFrame, ModalSet, modal_frame
from fosopt.ops import Array, ComplexArray
from fosopt.plant.zeros import modal_poles
from fosopt.reproduce.bode import Response
from fosopt.reproduce.published import PUBLISHED
from fosopt.structure import Chain, assemble_chain, two_body_stiffness
from fosopt.units import HZ

GIVEN = PUBLISHED["benchmark"]
REQUIRED = PUBLISHED["table_3_1"]
UDU = 1e-6
FREQUENCIES: tuple[float, ...] = tuple(GIVEN["structure_frequency_hz"])
SUPPORT_MASS = GIVEN["total_mass"] - GIVEN["actuated_mass"]
MIRROR = Mirror(GIVEN["actuated_mass"], GIVEN["actuator_frequency_hz"] * HZ, GIVEN["zeta_actuator"])
DAMPING = Damping((GIVEN["zeta_structure"],))
PORTS, FREE = ("hub", "tip"), Hub("free")
RETARGETING = Retargeting(
    REQUIRED["step_du"], REQUIRED["settling_time_s"], REQUIRED["dwell_time_s"], REQUIRED["retargets"]
)

# Assumed shapes of spectra: first-order filters whose corners fit the displacement and noise columns of table 3.4.
# The force, which no such filter fits, has the corner of the displacement.
LOW_PASS_HZ, HIGH_PASS_HZ = 8.5, 70.0
SOURCES = {"force": "mirror_torque", "displacement": "line_of_sight", "noise": "sensor_noise"}

_PID = GIVEN["pid"]
WORKING = (
    f"The published plant and controller: m_a = {MIRROR.inertia:g}, {GIVEN['actuator_frequency_hz']:g} Hz and "
    f"{100 * MIRROR.damping_ratio:g} % damping, K = {_PID['gain']:g}, k_d = {_PID['kd']:g}, k_p = {_PID['kp']:g}, "
    f"k_i = {_PID['ki']:g}."
)
SEQUENCE = (
    f"Square wave of {RETARGETING.count} engagements, {RETARGETING.settling_time:g} s to settle and "
    f"{RETARGETING.dwell_time:g} s to dwell each; exact superposition of step responses."
)
FLEXIBLE = (
    f"{WORKING} Support of two equal masses, {SUPPORT_MASS:.2f} together, with "
    f"{100 * GIVEN['zeta_structure']:g} % damping"
)


@dataclass(frozen=True)
class Case:
    """A closed loop of chapter 3, with all that its figures are made of.

    Attributes
    ----------
    name
        ``SMD`` on the rigid support, ``case 1`` to ``case 4`` on the flexible one.
    structure_hz
        Frequency of the support, zero where it is rigid [Hz].
    """

    name: str
    structure_hz: float
    model: LoopModel
    poles: ClosedLoopPoles

    @property
    def stability(self) -> str:
        """``stable`` or ``unstable``."""
        return "stable" if self.poles.spectral_abscissa < 0 else "unstable"

    @cached_property
    def locus(self) -> RootLocus:
        """Branches as the gain grows from zero to the published one."""
        return root_locus(self.model.loop, self.model.modes, self.model.mirror_port)

    @cached_property
    def structural_branch(self) -> ComplexArray:
        """(m,) The branch that ends at the support's own frequency, where the zero of the loop is [rad/s]."""
        ends = self.locus.branches[-1]
        return self.locus.branches[:, int(np.argmin(np.abs(ends - 1j * HZ * self.structure_hz)))]

    @cached_property
    def loop_zeros(self) -> ComplexArray:
        """(z,) Zeros of the loop transfer function: poles of the support, and zeros of the controller [rad/s]."""
        support, pid = modal_poles(self.model.modes), self.model.loop.controller
        # The free rigid body's zeros at the origin cancel its poles.
        return np.concatenate([support[support != 0], np.roots([pid.kd, pid.kp, pid.ki])])

    @cached_property
    def loop_poles(self) -> ComplexArray:
        """(p,) Poles of the loop transfer function, the controller's integrator among them [rad/s]."""
        return self.locus.branches[0]

    def grid(self, low: float, high: float, count: int = 1200) -> Array:
        """Frequencies that resolve every resonance of the open and the closed loop, from and to [Hz], in [rad/s]."""
        roots = np.concatenate([self.loop_zeros, self.loop_poles, self.poles.all])
        return resonance_grid(roots, low * HZ, high * HZ, count, per_root=41)

    def loop_gain(self, frequency: Array) -> ComplexArray:
        """(m,) L(jω)."""
        points = self.model.points(1j * frequency)
        return loop_transfer(self.model.loop, points.s, points.g)

    def closed(self, name: str, frequency: Array) -> ComplexArray:
        """(m,) A closed-loop response by its name in `control.NUMERATORS`."""
        points = self.model.points(1j * frequency)
        return closed_loop_response(name, self.model.loop, points.s, points.g)

    def open_response(self, low: float, high: float, count: int = 1200) -> Response:
        """Forward loop, from and to [Hz]."""
        grid = self.grid(low, high, count)
        phase = continuous_phase(self.loop_zeros, self.loop_poles, 1.0, grid)
        return Response("", grid, self.loop_gain(grid), phase)

    def command_response(self, low: float, high: float) -> Response:
        """Closed loop from command to output, from and to [Hz]."""
        grid = self.grid(low, high)
        phase = continuous_phase(self.loop_zeros, self.poles.all, 1.0, grid)
        return Response(self.name, grid, self.closed("command", grid), phase)

    @cached_property
    def step(self) -> Transient:
        """Error after a unit step command."""
        return step_error(self.model, self.poles)

    @cached_property
    def engagements(self) -> Engagements:
        """What the ten-engagement sequence leaves in its windows."""
        return engagements(self.model, self.poles, RETARGETING)

    def rms(self, disturbances: Sequence[Disturbance]) -> Array:
        """(d,) Rms output of each disturbance [du]."""
        return np.sqrt([v.value for v in jitter_variances(self.model, self.poles, disturbances)])


def _case(name: str, structure_hz: float, modes: ModalSet, mirror: Mirror = MIRROR) -> Case:
    terms: dict[str, Any] = {key: float(GIVEN["pid"][key]) for key in ("gain", "kp", "ki", "kd")}
    model = LoopModel(Loop(mirror, PID(**terms)), modes, "tip")
    return Case(name, structure_hz, model, closed_loop_poles(model.loop, modes, "tip"))


@cache
def smd() -> Case:
    """The spring-mass-damper on a rigid support, which has no modes."""
    none = np.zeros(0)
    return _case("SMD", 0.0, ModalSet(none, none, np.zeros((0, len(PORTS))), PORTS, np.zeros(0, bool)))


@cache
def support(structure_hz: float) -> ModalFrame:
    """Modes of the benchmark problem: two equal bodies on a spring."""
    half = 0.5 * SUPPORT_MASS
    chain = Chain({"m1": half, "m2": half}, (two_body_stiffness(structure_hz * HZ, half, half),))
    structure = assemble_chain(chain)
    return modal_frame(structure, structure.area, structure.batten_mass, 0.0, "tip")


@cache
def case(number: int, hub: Hub = FREE) -> Case:
    """Case 1 to 4 of section 3.4."""
    structure_hz = FREQUENCIES[number - 1]
    return _case(f"case {number}", structure_hz, support(structure_hz).modal_set(hub, DAMPING, PORTS))


@cache
def without_rigid_body(number: int) -> Case:
    """A case with its free rigid-body mode left out."""
    modes = case(number).model.modes
    return _case(f"case {number}", FREQUENCIES[number - 1], modes.keep(np.flatnonzero(~modes.rigid)))


def shape(source: str, corner_hz: float | None = None) -> ShapingFilter:
    """Shaping filter of a disturbance of unit size: rms of a low pass, density of a high pass."""
    if source == "noise":
        return high_pass((corner_hz or HIGH_PASS_HZ) * HZ, 1.0)
    return low_pass((corner_hz or LOW_PASS_HZ) * HZ, 1.0)


@cache
def disturbance(source: str) -> Disturbance:
    """A disturbance of the size that gives the rigidly supported mass its printed jitter."""
    unit = Disturbance(source, SOURCES[source], shape(source))
    printed = PUBLISHED["table_3_4"]["rigid"][source] * UDU
    return scaled(unit, printed / float(smd().rms([unit])[0]))


def scaled(of: Disturbance, factor: float) -> Disturbance:
    """A disturbance whose filter has its gain multiplied."""
    assert of.filter is not None
    numerator = tuple(factor * np.array(of.filter.numerator))
    return replace(of, filter=replace(of.filter, numerator=numerator))


def total(jitter: Array) -> float:
    """Root-sum-square over the sources."""
    return float(np.linalg.norm(jitter))
