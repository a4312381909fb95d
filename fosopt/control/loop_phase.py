"""Zeros and poles of the loop transfer function, and its phase counted by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fosopt.control.loop import Loop
from fosopt.control.phase import continuous_phase
from fosopt.control.pid import PID
from fosopt.control.poles import closed_loop_poles
from fosopt.control.state_space import modal_matrices
from fosopt.errors import SolverError
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray
from fosopt.plant.zeros import modal_poles, plant_zeros

_RIGHT = 2.0  # degrees between counted and sampled phase that rounding of zeros and poles may leave
_HALF = 180.0


def loop_transfer_roots(loop: Loop, modes: ModalSet, mirror_port: str) -> tuple[ComplexArray, ComplexArray]:
    """Zeros and poles of L(s) = G(s) K(s).

    The plant's zeros are the poles of the structure without its mirror where loop and mirror share a port. A free rigid
    body's double pole, which an internal torque cannot move, stands in neither.    [Barker1991] Eqs. (4.18)-(4.22)
    The other axis of a mirror with two is part of the plant, its loop closed.

    Returns
    -------
    (n,), (m,)
        [rad/s].

    Raises
    ------
    SolverError
        If a root cannot be found.
    """
    zeros = _plant_zeros(loop, modes, mirror_port)
    still = replace(loop, controller=PID(0.0, 0.0, 0.0, 0.0))
    poles = closed_loop_poles(still, modes, mirror_port).all
    own_zeros, own_poles = _controller_roots(loop.controller)
    # Poles of a loop are told without the free rigid body's, zeros of a plant with them.
    drift = 2 * int(np.any(modes.stiffness == 0)) if loop.beside is None else 0
    zeros = zeros[np.argsort(np.abs(zeros), kind="stable")][drift:]
    return np.concatenate([zeros, own_zeros]), np.concatenate([poles, own_poles])


def _plant_zeros(loop: Loop, modes: ModalSet, mirror_port: str) -> ComplexArray:
    """Zeros of what a controller sees; beside another axis, the poles of the structure with that loop closed."""
    other = loop.beside
    if other is not None:
        alone = Loop(other.mirror, other.controller, actuators=loop.actuators, hub=other.hub or loop.hub)
        return closed_loop_poles(alone, modes, other.port).all
    return modal_poles(modes) if loop.plain else plant_zeros(modal_matrices(loop, modes, mirror_port))


def _controller_roots(pid: PID) -> tuple[ComplexArray, ComplexArray]:
    """Zeros and poles of K(s)."""
    lag = pid.lag if pid.kd else 0.0
    # (k_p s + k_i)(1 + T s) + k_d s² over s (1 + T s); without an integral an s cancels.
    zeros = [np.roots([pid.kd + pid.kp * lag, pid.kp + pid.ki * lag, pid.ki])]
    poles = [np.roots([lag, 1.0, 0.0])]
    for section in pid.path.sections:
        zeros.append(np.roots(section.numerator))
        poles.append(section.poles)
    return np.concatenate(zeros).astype(complex), np.concatenate(poles).astype(complex)


def loop_phase(zeros: ComplexArray, poles: ComplexArray, transfer: ComplexArray, frequency: Array) -> Array:
    """Phase of L(jω) [deg], continuous in frequency however light the damping.

    Starts where L itself starts, within half a turn about the quarter turns its integrators give.

    Parameters
    ----------
    zeros, poles
        Of L, as `loop_transfer_roots` gives them.
    transfer
        (f,) L at the frequencies, which the phase is held against.
    frequency
        (f,) above zero [rad/s].

    Raises
    ------
    SolverError
        If the roots are not those of the transfer function.
    """
    phase = continuous_phase(zeros, poles, 1.0, frequency)
    off = np.degrees(np.angle(transfer * np.exp(-1j * np.radians(phase))))
    # The roots leave the sign of the gain open; in between are only errors.
    turn = _HALF * float(round(float(np.median(np.abs(off))) / _HALF))
    wrong = np.abs(np.remainder(off - turn + _HALF, 2 * _HALF) - _HALF)
    if not wrong.max() <= _RIGHT:
        raise SolverError(
            f"phase of the loop: counted by zeros and poles it is off by {wrong.max():.3g}°; one of them is not found"
        )
    phase = phase + turn
    usual = 0.5 * _HALF * (np.count_nonzero(zeros == 0) - np.count_nonzero(poles == 0))
    return phase - 2 * _HALF * np.ceil((phase[0] - usual - 0.5 * _HALF) / (2 * _HALF))
