"""The dissertation's truss and its jitter as an engineer writes them with NumPy and SciPy alone.

Nothing is shared with fosopt but the numbers of the problem: element matrices, `scipy.linalg.eigh`, one
state-space model of modes, mirror, controller and shaping filters, and one Lyapunov equation. All areas enter by
one tensor product, and the states are scaled to one size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[np.float64]

LOOP_VARIABLES = 4  # mirror inertia, kp, ki, kd: the last entries of a design, after the areas


@dataclass(frozen=True)
class Numbers:
    """The data of the problem, SI units.

    Disturbances are pairs of corner frequency and rms, for the sensor noise corner and one-sided density per √Hz.
    Torques pass low-pass filters of first (mirror) and second order (hub, Butterworth), the line of sight a low
    pass and the noise a high pass of first order.
    """

    bays: int
    bay_length: float
    tube_area: float
    longeron_stiffness: float
    diagonal_stiffness: float
    longeron_mass: float
    diagonal_mass: float
    batten_mass: float
    batten_inertia: float
    mirror_mass: float
    mirror_frequency: float
    mirror_damping_ratio: float
    hub_bandwidth: float
    hub_damping_ratio: float
    damping_ratio: float
    gain: float
    mirror_torque: tuple[float, float]
    hub_torque: tuple[float, float]
    line_of_sight: tuple[float, float]
    sensor_noise: tuple[float, float]


@dataclass(frozen=True)
class PlainModel:
    """Metrics of a design, which is a vector of all areas, mirror inertia, kp, ki and kd.

    Attributes
    ----------
    stiffness, mass
        (b, n, n) element matrices per area.
    mass_constant
        (n, n) battens and the mirror's mass.
    bar_mass
        (b,) per area.
    """

    numbers: Numbers
    stiffness: Array
    mass: Array
    mass_constant: Array
    bar_mass: Array

    def structural_mass(self, design: Array) -> float:
        """Mass of bars and battens [kg]."""
        return float(self.bar_mass @ design[:-LOOP_VARIABLES]) + self.mass_of_battens

    @property
    def mass_of_battens(self) -> float:
        """What no design changes [kg]."""
        return (self.numbers.bays + 1) * self.numbers.batten_mass

    def frequency_and_jitter(self, design: Array) -> tuple[float, float]:
        """First elastic frequency [rad/s] and total jitter [rad], infinite where it is seen to be unstable."""
        frequency, (a, b, c) = self._state_space(design)
        covariance = linalg.solve_continuous_lyapunov(a, -b @ b.T)
        # An unstable loop has no covariance; what the solver returns mostly shows it on the diagonal.
        stable = bool(np.all(np.diag(covariance) > 0))
        return frequency, float(np.sqrt(c @ covariance @ c)) if stable else np.inf

    def spectral_abscissa(self, design: Array) -> float:
        """Largest real part of all poles [rad/s]."""
        _, (a, _, _) = self._state_space(design)
        return float(linalg.eigvals(a).real.max())

    def _state_space(self, design: Array) -> tuple[float, tuple[Array, Array, Array]]:
        p, area = self.numbers, design[:-LOOP_VARIABLES]
        k = np.tensordot(area, self.stiffness, 1)
        m = np.tensordot(area, self.mass, 1) + self.mass_constant
        eigenvalue, shapes = linalg.eigh(k, m)
        frequency = np.sqrt(np.maximum(eigenvalue, 0.0))
        ratio = np.full(frequency.size, p.damping_ratio)
        frequency[0], ratio[0] = p.hub_bandwidth, p.hub_damping_ratio
        inertia, kp, ki, kd = design[-LOOP_VARIABLES:]
        loop = closed_loop_of(p, frequency, ratio, shapes[0], shapes[-1], inertia, kp, ki, kd)
        return float(frequency[1]), loop


def plain_model(p: Numbers) -> PlainModel:
    """Assemble the truss: longerons below and above and a diagonal in each bay, in this order."""
    h, n = p.bay_length / 2, 3 * (p.bays + 1)
    bars = []
    for i in range(p.bays):
        slant = (i, h, i + 1, -h) if i % 2 else (i, -h, i + 1, h)
        bars += [(i, -h, i + 1, -h), (i, h, i + 1, h), slant]
    stiffness, mass, bar_mass = np.zeros((len(bars), n, n)), np.zeros((len(bars), n, n)), np.zeros(len(bars))
    for e, (i, y_i, j, y_j) in enumerate(bars):
        ends = np.zeros((4, n))  # displacements of both ends, carried by rigid battens with (x, y, rotation)
        for row, at, y in ((0, i, y_i), (2, j, y_j)):
            ends[row, 3 * at], ends[row, 3 * at + 2], ends[row + 1, 3 * at + 1] = 1.0, -y, 1.0
        direction = np.array([p.bay_length, y_j - y_i])
        stretch = direction / np.linalg.norm(direction) @ (ends[2:] - ends[:2])
        slanted = y_i != y_j
        axial = (p.diagonal_stiffness if slanted else p.longeron_stiffness) / p.tube_area
        bar_mass[e] = (p.diagonal_mass if slanted else p.longeron_mass) / p.tube_area
        stiffness[e] = axial * np.outer(stretch, stretch)
        mass[e] = bar_mass[e] / 6 * ends.T @ np.kron([[2.0, 1.0], [1.0, 2.0]], np.eye(2)) @ ends
    constant = np.diag(np.tile([p.batten_mass, p.batten_mass, p.batten_inertia], p.bays + 1))
    constant[-3, -3] += p.mirror_mass
    constant[-2, -2] += p.mirror_mass
    # The first two degrees of freedom are pinned at the hub.
    return PlainModel(p, stiffness[:, 2:, 2:].copy(), mass[:, 2:, 2:].copy(), constant[2:, 2:], bar_mass)


def closed_loop_of(
    p: Numbers,
    frequency: Array,
    ratio: Array,
    hub: Array,
    tip: Array,
    inertia: float,
    kp: float,
    ki: float,
    kd: float,
) -> tuple[Array, Array, Array]:
    """ẋ = A x + B w and the line of sight c x, with w four white noises of unit two-sided density.

    States: ω q, q̇, mirror angle and rate, integral of the error, filters of mirror torque, hub torque (two), line
    of sight and sensor noise. Where the ideal derivative would differentiate white noise, q̇ and the mirror's rate
    are the true ones minus that noise, so that nothing is differentiated.
    """
    n = frequency.size
    size = 2 * n + 8
    q, v = slice(0, n), slice(n, 2 * n)
    angle, rate, integral, torque, hub1, hub2, sight, noise = range(2 * n, size)
    spring = inertia * p.mirror_frequency**2
    damper = 2 * p.mirror_damping_ratio * p.mirror_frequency * inertia
    kp, ki, kd = p.gain * kp, p.gain * ki, p.gain * kd
    corner_sight, corner_noise = p.line_of_sight[0], p.sensor_noise[0]
    density = p.sensor_noise[1] / np.sqrt(2)  # two-sided

    # Signals are rows over the states and the four noises, side by side.
    signal = np.eye(size, size + 4)
    white = np.eye(4, size + 4, k=size)
    displaced = p.line_of_sight[1] * signal[sight]
    displaced_rate = p.line_of_sight[1] * (
        np.sqrt(2 * corner_sight) * white[2] - corner_sight * signal[sight]
    )
    noisy = density * (white[3] - signal[noise])
    noisy_rate = -corner_noise * noisy  # without the derivative of white noise
    true_v = signal[v] + kd * density * np.outer(tip, white[3])
    true_rate = signal[rate] - kd * density / inertia * white[3]
    bend = signal[angle] - tip / frequency @ signal[q]
    link = spring * bend + damper * (true_rate - tip @ true_v)  # torque of spring and damper on the port
    error = -(signal[angle] + displaced + noisy)
    command = kp * error + ki * signal[integral] - kd * (true_rate + displaced_rate + noisy_rate)

    system = np.empty((size, size + 4))
    system[q] = frequency[:, None] * true_v
    system[v] = (
        -frequency[:, None] * (signal[q] + 2 * ratio[:, None] * true_v)
        + np.outer(tip, link - command)
        + p.hub_torque[1] * np.outer(hub, signal[hub1])
    )
    system[angle] = true_rate
    system[rate] = (command - link + p.mirror_torque[1] * signal[torque]) / inertia
    system[integral] = error
    corner = p.mirror_torque[0]
    system[torque] = -corner * signal[torque] + np.sqrt(2 * corner) * white[0]
    corner = p.hub_torque[0]
    system[hub1] = corner * signal[hub2]
    system[hub2] = -corner * (signal[hub1] + np.sqrt(2) * signal[hub2]) + np.sqrt(8**0.5 * corner) * white[1]
    system[sight] = -corner_sight * signal[sight] + np.sqrt(2 * corner_sight) * white[2]
    system[noise] = corner_noise * (white[3] - signal[noise])

    pace = np.sqrt(kp / inertia)
    scale = np.ones(size)
    scale[[angle, rate, integral]] = np.sqrt(inertia) * np.array([pace, 1.0, pace**2])
    output = (signal[angle] + displaced)[:size] / scale
    return scale[:, None] * system[:, :size] / scale, scale[:, None] * system[:, size:], output
