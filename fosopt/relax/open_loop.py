"""The loop before a controller closes it: what disturbs the line of sight, and what of it is measured.

With the controller switched off, disturbances give the line of sight the error v and the controller the measured
signal m, noise included. A torque u moves them by G_e u and G_y u. Every stabilizing linear controller u = −K m of a
stable plant can be written u = −Q m₀ with a stable Q, m₀ being m without what u adds to it [Youla1976]. With
F = G_e Q the line of sight is left with v − F m₀, and its mean square is

    J = (1/2π) ∫ Φ |F − W|² dω + J₀,     W = S_vm/Φ,     J₀ = (1/2π) ∫ (S_vv − |S_vm|²/Φ) dω,

where Φ is the spectrum of m₀. W is Wiener's filter without causality, J₀ what even that leaves over [Kailath2000].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import inf

import numpy as np
from scipy import linalg

from fosopt.control import (
    NUMERATORS,
    PID,
    ClosedLoopPoles,
    Loop,
    Receptances,
    closed_loop_poles,
    coupling,
    plant_impedance,
    plant_state_space,
)
from fosopt.control.loop import mirror_gain, sensor_gain
from fosopt.errors import ModelError, UnstableError
from fosopt.metrics.disturbances import Disturbance, refuse_infinite_variance
from fosopt.metrics.functional import LoopModel
from fosopt.ops import Array, ComplexArray
from fosopt.relax.quadrature import Nodes, resolving_nodes

_POLISHED = 1e-12
_POLISHING = 8
_LOWEST = 1e-3


@dataclass(frozen=True)
class Spectra:
    """What the open loop does at quadrature nodes, two-sided spectra in [rad² s].

    Attributes
    ----------
    nodes
        (m,) frequencies and weights.
    impedance
        (m,) Inverse 1/G_y of the plant from torque to sensor [N m/rad].
    share
        (m,) G_e/G_y, line of sight per sensed angle as the torque moves them; one for a sensor on the mirror.
    measured
        (m,) Φ, spectrum of what is measured. Zero where no disturbance counts.
    lack
        (m,) 1 − W, computed without subtraction where the noise is small.
    unavoidable
        (m,) Integrand of J₀.
    """

    nodes: Nodes
    impedance: ComplexArray
    share: ComplexArray
    measured: Array
    lack: ComplexArray
    unavoidable: Array


@dataclass(frozen=True)
class OpenLoop:
    """Plant and disturbances without a controller.

    Attributes
    ----------
    model
        The loop with its controller switched off.
    poles
        Of the plant; the control torque may or may not reach them.
    drifting
        Whether a disturbance drives a free rigid body so that the spectra grow as 1/ω² towards zero frequency.
    zeros
        Zeros of G_e in the right half plane, upper ones of pairs: none for a minimum-phase plant [rad/s].
    """

    model: LoopModel
    disturbances: tuple[Disturbance, ...]
    poles: ClosedLoopPoles
    drifting: bool
    zeros: ComplexArray

    @property
    def spectral_poles(self) -> ComplexArray:
        """(n,) Poles of all spectra in the left half plane, upper ones of pairs, without that of a drift."""
        shapes = [d.filter.poles for d in self.disturbances if d.filter is not None]
        return np.concatenate([self.poles.value, *(p[p.imag >= 0] for p in shapes)])

    @property
    def counted_everywhere(self) -> bool:
        """Whether at each frequency some disturbance counts; elsewhere an error costs nothing."""
        reach = 0.0
        for low, high in sorted(d.counted for d in self.disturbances):
            if low > reach:
                return False
            reach = max(reach, high)
        return reach == inf

    def nodes(self, tolerance: float) -> Nodes:
        """Frequencies that resolve the measured spectrum to a relative `tolerance`."""
        bands = [d.counted for d in self.disturbances]
        low, high = min(band[0] for band in bands), max(band[1] for band in bands)
        tables = [d.frequency for d in self.disturbances if d.frequency is not None]
        edges = np.array([edge for band in bands for edge in band if 0 < edge < inf])
        first = self.poles.open_loop.first
        return resolving_nodes(
            self._measured,
            np.concatenate([self.spectral_poles, first[first.real < 0], -self.zeros.conj()]),
            low,
            high,
            np.concatenate([edges, *tables]),
            tolerance,
        )

    def spectra(self, nodes: Nodes) -> Spectra:
        """Spectra and plant at quadrature nodes."""
        frequency = nodes.frequency
        impedance, sensor, mirror, _ = self._plant(1j * frequency)
        parts = self._parts(frequency)
        measured = np.sum([psd * np.abs(seen) ** 2 for psd, _, seen in parts], axis=0)
        correlation = np.sum([psd * (seen - error) * seen.conj() for psd, error, seen in parts], axis=0)
        counts = measured > 0
        lack = np.divide(correlation, measured, out=np.ones_like(correlation), where=counts)
        # Lagrange's identity: the determinant of a Gram matrix without its cancellation.
        lost = np.zeros_like(measured)
        for (psd, error, seen), (other_psd, other_error, other_seen) in combinations(parts, 2):
            lost += psd * other_psd * np.abs(error * other_seen - other_error * seen) ** 2
        unavoidable = np.divide(lost, measured, out=np.zeros_like(lost), where=counts)
        return Spectra(nodes, impedance / sensor, mirror / sensor, measured, lack, unavoidable)

    def impedance(self, s: ComplexArray) -> ComplexArray:
        """(m,) Inverse 1/G_y of the plant from torque to sensor [N m/rad]."""
        impedance, sensor, _, _ = self._plant(s)
        return impedance / sensor

    def responses(self, s: ComplexArray, at: str) -> tuple[ComplexArray, ComplexArray]:
        """(m,), (m,) Line-of-sight error and measured signal per disturbance that enters at `at`."""
        impedance, _, _, g = self._plant(s)
        loop = self.model.loop
        if loop.placement.sensor is None:
            if at == "sensor_noise":
                return np.zeros_like(s), np.ones_like(s)
            error = NUMERATORS[at](loop, s, g) / impedance
            return error, error
        error = NUMERATORS[at](loop, s, g) / impedance if at != "sensor_noise" else np.zeros_like(s)
        return error, _sensed(loop, s, g, at) / impedance if "torque" in at else np.ones_like(s)

    def _plant(self, s: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray, Receptances]:
        g = self.model.points(s).g
        loop = self.model.loop
        ones = np.ones_like(s)
        return plant_impedance(loop, s, g), sensor_gain(loop, s, g) * ones, mirror_gain(loop, s, g) * ones, g

    def _parts(self, frequency: Array) -> list[tuple[Array, ComplexArray, ComplexArray]]:
        """Two-sided density of each disturbance, and what it does to line of sight and measured signal."""
        parts = []
        for disturbance in self.disturbances:
            low, high = disturbance.counted
            counts = (frequency >= low) & (frequency <= high)
            psd = np.where(counts, 0.5 * disturbance.one_sided_psd(frequency), 0.0)
            parts.append((psd, *self.responses(1j * frequency, disturbance.at)))
        return parts

    def _measured(self, frequency: Array) -> Array:
        parts = self._parts(frequency)
        return np.sum([psd * np.abs(seen) ** 2 for psd, _, seen in parts], axis=0)


_OFF = PID(0.0, 1.0, 0.0, 0.0)


def _sensed(loop: Loop, s: ComplexArray, g: Receptances, at: str) -> ComplexArray:
    """Motion of a sensor on the structure per torque on mirror or hub, times Z; the controller is switched off.

    The structure moves under the hub's torque and under what the mirror's spring hands on to it.
    """
    j, kappa = loop.index(loop.placement.sensor), coupling(loop, s)
    handed_on = kappa * g.between(j, 0)
    if at == "mirror_torque":
        return handed_on
    inertial = loop.mirror.inertia * s**2
    return g.between(j, 1) * plant_impedance(loop, s, g) - handed_on * inertial * g.cross


def open_loop(model: LoopModel, disturbances: Sequence[Disturbance]) -> OpenLoop:
    """The loop of a model without its controller.

    Raises
    ------
    UnstableError
        If structure and mirror do not come to rest by themselves.
    ModelError
        If there is no disturbance, one has infinite variance under any controller, or the control torque moves a
        free rigid body.
    """
    if not disturbances:
        raise ModelError("no disturbance: jitter needs at least one; add it to the system")
    if model.loop.beside is not None:
        raise ModelError(
            "bounds over controllers are those of one loop, the mirror has two; bound each axis alone"
        )
    loop = replace(model.loop, controller=_OFF)
    off = LoopModel(loop, model.modes, model.mirror_port)
    poles = closed_loop_poles(loop, model.modes, model.mirror_port)
    if not poles.spectral_abscissa < 0:
        raise UnstableError(
            f"structure and mirror without control: a pole has the real part {poles.spectral_abscissa:.6g} rad/s; "
            "bounds over all controllers need a plant that comes to rest, so give every mode and the mirror damping"
        )
    free = poles.open_loop.drifting
    # An integrator is the least any controller may have; a derivative passes noise that need not be passed.
    some = replace(loop, controller=PID(1.0, 1.0, 1.0, 0.0))
    for disturbance in disturbances:
        refuse_infinite_variance(disturbance, some, free)
    if free:
        _refuse_moved_body(off, poles)
    drifts = [
        d
        for d in disturbances
        if "torque" in d.at and d.filter is not None and d.counted[0] == 0 and d.filter.zeros_at_origin == 1
    ]
    if free and drifts and loop.placement.action is not None:
        raise ModelError(
            f"disturbance '{drifts[0].name}' drives a free rigid body at zero frequency, where a torque between two "
            "places of the structure does nothing but for rounding; hold the hub, or state a lower band edge"
        )
    return OpenLoop(off, tuple(disturbances), poles, free and bool(drifts), _right_zeros(off, poles))


def _refuse_moved_body(model: LoopModel, poles: ClosedLoopPoles) -> None:
    """Refuse a control torque that moves a free rigid body, whose double pole at zero is no stable plant."""
    s = 1j * np.abs(poles.value).min() * np.array([1e-3, 1e-4])
    g = model.points(s).g
    gain = np.abs(sensor_gain(model.loop, s, g) / plant_impedance(model.loop, s, g))
    if gain[1] > 10 * gain[0]:
        raise ModelError(
            "the control torque moves the free rigid body: bounds over all controllers need a plant that comes to "
            "rest; let action and reaction turn about the same axis, or hold the hub"
        )


def _right_zeros(model: LoopModel, poles: ClosedLoopPoles) -> ComplexArray:
    """Zeros of the plant from torque to line of sight in the right half plane, upper ones of pairs.

    A zero that is missed makes a bound lower, never wrong; those found are polished, because a wrong one would.
    """
    loop, place = model.loop, model.loop.placement
    if place.action is None and place.reaction is None and loop.mirror.reaction_mass is None:
        return np.zeros(0, dtype=complex)
    plant = plant_state_space(loop, model.modes, model.mirror_port)
    n = plant.a.shape[0]
    column, row = plant.inputs.index("control_torque"), plant.outputs.index("mirror_angle")
    pencil = np.zeros((n + 1, n + 1))
    pencil[:n, :n], pencil[:n, n], pencil[n, :n] = plant.a, plant.b[:, column], plant.c[row]
    found = linalg.eigvals(pencil, np.diag(np.append(np.ones(n), 0.0)))
    found = found[np.isfinite(found)]
    zeros = found[(found.real > 0) & (found.imag >= 0)]
    settled = np.zeros(zeros.size, dtype=bool)
    for _ in range(_POLISHING):
        gain = mirror_gain(loop, *model.along(model.points(zeros)))
        step = gain.value / gain.slope
        settled = np.abs(step) <= _POLISHED * np.abs(zeros)
        # What runs away from where it was found is no zero but one at infinity.
        near = np.abs(step) <= 0.5 * np.abs(zeros)
        zeros = np.where(zeros.imag == 0, (zeros - step).real, zeros - step)[near]
        settled = settled[near]
    # Far below all poles lies what rounding makes of a rigid body that the torque should not move.
    settled &= np.abs(zeros) > _LOWEST * np.abs(poles.value).min()
    zeros = zeros[settled & (zeros.real > 0) & (zeros.imag >= 0)]
    apart = np.abs(zeros[:, None] - zeros) <= 1e-8 * np.abs(zeros)
    return zeros[~np.any(np.tril(apart, -1), axis=1)]
