"""All closed-loop poles from one scalar function.

The closed loop of a mirror on n modes has 2n + 3 poles or so, most of them shifted from an open-loop pole by
very little. They are found together by Aberth's method [Aberth1973] on Δ(s) Π_k D_k(s), and kept as open-loop
pole plus shift: the shift, which carries all that matters of a nearly cancelled mode, keeps full relative
accuracy however small it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from fosopt.control.loop import Loop, Receptances, characteristic, plant_impedance
from fosopt.control.open_loop import OpenLoopPoles, open_loop_poles
from fosopt.control.pid import pid_response
from fosopt.control.state_space import closed_loop_state_space
from fosopt.errors import SolverError
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray, Dual

MAX_ITERATIONS = 60
_CONVERGED = 1e-9  # relative step of a shift; convergence is at least quadratic, so it leaves nothing
_TRACE = 1e-8


@dataclass(frozen=True)
class ClosedLoopPoles:
    """Closed-loop poles of the loop, one representative per conjugate pair.

    Attributes
    ----------
    base, shift
        (m,) each pole is base + shift [rad/s].
    multiplicity
        (m,) 2 for a conjugate pair (the upper one is kept), 1 for a real pole.
    open_loop
        What they were shifted from.
    """

    base: ComplexArray
    shift: ComplexArray
    multiplicity: NDArray[np.intp]
    open_loop: OpenLoopPoles

    @property
    def value(self) -> ComplexArray:
        """(m,) Poles that the loop moves [rad/s]."""
        return self.base + self.shift

    @property
    def all(self) -> ComplexArray:
        """Every pole but a free rigid body's double zero, conjugates and uncoupled modes included [rad/s]."""
        value = self.value
        return np.concatenate([value, value[self.multiplicity == 2].conj(), self.open_loop.uncoupled])

    @property
    def spectral_abscissa(self) -> float:
        """Largest real part [rad/s]; the loop is stable when it is negative.

        A free rigid body's drift is not counted: it is no matter of the loop.
        """
        uncoupled = self.open_loop.uncoupled
        return float(max(self.value.real.max(), uncoupled.real.max() if uncoupled.size else -np.inf))

    def receptances(self) -> Receptances:
        """Receptances of the structure with its attachments at the poles, with their derivatives in `s`."""
        return self.open_loop.receptances(self.base, self.shift)


def closed_loop_poles(
    loop: Loop, modes: ModalSet, mirror_port: str, near: ClosedLoopPoles | None = None
) -> ClosedLoopPoles:
    """All closed-loop poles.    [Barker1991] Eq. (4.30)

    Parameters
    ----------
    near
        Poles of a loop that differs little, to start from.

    Raises
    ------
    SolverError
        If neither Aberth's method nor the dense eigenvalue solver gives a complete set of poles.
    """
    open_loop = open_loop_poles(loop, modes, mirror_port)
    if near is not None and np.array_equal(near.open_loop.first, open_loop.first):
        followed = _aberth(loop, open_loop, near.base, near.shift, near.multiplicity)
        if followed is not None and complete(loop, open_loop, followed):
            return followed
    base, shift, multiplicity = _start(loop, open_loop)
    found = _aberth(loop, open_loop, base, shift, multiplicity)
    if found is None or not complete(loop, open_loop, found):
        found = _dense(loop, modes, mirror_port, open_loop)
        if not complete(loop, open_loop, found):
            raise SolverError(
                "closed-loop poles: the set found violates the sum of poles (trace); rescale gains or inertia"
            )
    return found


def _controller_poles(loop: Loop) -> ComplexArray:
    """Poles of the loop on a rigid support, the guess for those that belong to mirror and controller."""
    mirror, pid = loop.mirror, loop.controller
    lag = pid.rolloff_time if pid.kd else 0.0
    # (J s² + c s + k) s (1 + T s) + gain [(k_p s + k_i)(1 + T s) + k_d s²]
    coefficients = np.array(
        [
            mirror.inertia * lag,
            mirror.inertia + mirror.damping * lag,
            mirror.damping + mirror.stiffness * lag + pid.gain * (pid.kd + pid.kp * lag),
            mirror.stiffness + pid.gain * (pid.kp + pid.ki * lag),
            pid.gain * pid.ki,
        ]
    )
    return np.roots(coefficients[int(lag == 0) : 4 + int(pid.ki != 0)]).astype(complex)


def _start(loop: Loop, open_loop: OpenLoopPoles) -> tuple[ComplexArray, ComplexArray, NDArray[np.intp]]:
    controller = _controller_poles(loop)
    moving = open_loop.first != 0
    pair = open_loop.first.imag > 0
    real = moving & ~pair
    upper = controller[controller.imag > 0]
    single = controller[controller.imag == 0]
    structural = np.concatenate([open_loop.first[pair], open_loop.first[real], open_loop.second[real]])
    base = np.concatenate([structural, upper, single])
    multiplicity = np.concatenate(
        [
            np.full(pair.sum(), 2),
            np.ones(2 * real.sum(), int),
            np.full(upper.size, 2),
            np.ones(single.size, int),
        ]
    )
    # First-order shift of a structural pole: Δ without its own mode, which is singular there, over the rest.
    own = np.concatenate([np.flatnonzero(pair), np.flatnonzero(real), np.flatnonzero(real)])
    shift = np.zeros_like(base)
    factors = open_loop.factors(structural, np.zeros_like(structural), without=own)
    rest = open_loop.summed(*factors, structural, _needed(loop))
    numerator = open_loop.numerators(structural, own)
    pairs = [Dual(pair.value, numerator[:, k]) for k, pair in enumerate(rest)]
    delta = characteristic(loop, Dual(structural, 0.0), _of(pairs))
    push, delta = delta.slope, delta.value
    other = np.where(structural == open_loop.first[own], open_loop.second[own], open_loop.first[own])
    gap = structural - other
    # Two poles in one place (critical damping) part as the square root of the push.
    apart = np.where(gap == 0, np.sqrt((-push / delta).astype(complex)), gap)
    first_order = -push / (delta * apart)
    limit = 0.2 * np.abs(structural)
    first_order *= np.minimum(1.0, limit / np.maximum(np.abs(first_order), 1e-300))
    shift[: own.size] = np.where(multiplicity[: own.size] == 1, first_order.real, first_order)
    return base, shift, multiplicity


def _needed(loop: Loop) -> int | None:
    """How many pairs of receptances the characteristic function uses: of a mirror alone, the first."""
    return 1 if loop.plain else None


def _of(pairs: list[Dual]) -> Receptances:
    return Receptances.of(pairs) if len(pairs) > 1 else Receptances(pairs[0], 0.0)


def _aberth(
    loop: Loop,
    open_loop: OpenLoopPoles,
    base: ComplexArray,
    shift: ComplexArray,
    multiplicity: NDArray[np.intp],
) -> ClosedLoopPoles | None:
    moving = (open_loop.first != 0).astype(float)
    needed = _needed(loop)
    pair = multiplicity == 2
    mirrored, shift = base[pair].conj(), shift.copy()
    rows = np.arange(base.size)  # poles that still move
    with np.errstate(all="ignore"):
        for _ in range(MAX_ITERATIONS):
            b, d = base[rows], shift[rows]
            s = b + d
            inverse, logarithmic = open_loop.factors(b, d)
            pairs = open_loop.summed(inverse, logarithmic, s, needed)
            apart = (b[:, None] - base) + (d[:, None] - shift)
            apart[np.arange(rows.size), rows] = np.inf
            repulsion = (1 / apart).sum(axis=1)
            repulsion += (1 / ((b[:, None] - mirrored) + (d[:, None] - shift[pair].conj()))).sum(axis=1)
            step = aberth_step(loop, s, _of(pairs), logarithmic @ moving, repulsion)
            step = np.where(pair[rows], step, step.real)
            if not np.isfinite(step).all():
                return None
            shift[rows] = d = d - step
            rows = rows[moves(step, d, s)]
            if rows.size == 0:
                return ClosedLoopPoles(base, shift, multiplicity, open_loop)
    return None


def aberth_step(
    loop: Loop, s: ComplexArray, g: Receptances, known: ComplexArray, repulsion: ComplexArray
) -> ComplexArray:
    """Step from (m,) poles towards the zeros of Δ(s) Π_k D_k(s).    [Aberth1973]

    Parameters
    ----------
    g
        Receptances at `s` with their derivatives.
    known
        Σ_k D_k′/D_k.
    repulsion
        Σ 1/(s − p) over all other poles p.
    """
    pid = loop.controller
    delta = characteristic(loop, Dual(s, 1.0), g)
    if _present(pid.ki):
        known = known + 1 / s
    if _present(pid.rolloff_time) and _present(pid.kd):
        known = known + pid.rolloff_time / (1 + pid.rolloff_time * s)
    # Multiplied through by Δ, so that a shift that is already exact gives a step of zero.
    return delta.value / (delta.slope + delta.value * (known - repulsion))


def _present(gain: Any) -> bool:
    """Whether a gain, or one of many, is not zero; spelled out because it is asked four times a pole search."""
    return bool(gain.any()) if isinstance(gain, np.ndarray) else gain != 0


def moves(step: ComplexArray, shift: ComplexArray, s: ComplexArray) -> NDArray[np.bool_]:
    """Which poles a step still moves by more than rounding."""
    size = np.abs(step)
    return (size > _CONVERGED * np.abs(shift)) & (size > 1e-15 * np.abs(s))


def complete(loop: Loop, open_loop: OpenLoopPoles, poles: ClosedLoopPoles) -> bool:
    """Whether the poles add up to the trace of the closed loop, which a missing or doubled pole would break."""
    pid = loop.controller
    value, weight = poles.value, poles.multiplicity
    if np.any(value[weight == 2].imag <= 0):
        return False
    low_pass = pid.rolloff_time > 0 and pid.kd != 0
    trace = _plant_trace(loop, open_loop)
    trace += 1 / pid.rolloff_time if low_pass else pid.gain * pid.kd * _mobility(loop, open_loop)
    found = -(weight * value.real).sum()
    count = 2 * int((open_loop.first != 0).sum()) + 2 + (pid.ki != 0) + low_pass
    return int(weight.sum()) == count and abs(found - trace) <= _TRACE * np.abs(value).sum()


def _plant_trace(loop: Loop, open_loop: OpenLoopPoles) -> float:
    """Sum of the plant's poles, negative: what its dampers make of it."""
    free = open_loop.mobility.direct + 1 / loop.mirror.inertia
    return float(-(open_loop.first + open_loop.second).real.sum() + loop.mirror.damping * free)


def _mobility(loop: Loop, open_loop: OpenLoopPoles) -> float:
    """Acceleration of what is sensed per control torque, at once: lim s² G(s) [1/(kg m²)]."""
    place, shares = loop.placement, loop.mirror.reaction_mass
    if place.sensor is None:
        return 1 / loop.mirror.inertia if place.action is None else 0.0
    free, j = open_loop.mobility, loop.index(place.sensor)
    reacting = free.between(j, loop.index(place.reaction)) * (1 - (shares.torque_ratio if shares else 0.0))
    return float((free.between(j, loop.index(place.action)) if place.action else 0.0) - reacting)


def _dense(loop: Loop, modes: ModalSet, mirror_port: str, open_loop: OpenLoopPoles) -> ClosedLoopPoles:
    """Poles from the dense state matrix, polished one by one; for loops on which Aberth's method stalls."""
    seen = modes.keep(np.flatnonzero(open_loop.seen))
    eigenvalue = linalg.eigvals(closed_loop_state_space(loop, seen, mirror_port).a)
    if open_loop.drifting:
        eigenvalue = eigenvalue[np.argsort(np.abs(eigenvalue))[2:]]
    real = eigenvalue.imag == 0
    kept = eigenvalue[real | (eigenvalue.imag > 0)]
    multiplicity = np.where(kept.imag == 0, 1, 2)
    known = np.concatenate([open_loop.first, open_loop.second])
    base = kept.copy()
    if known.size:
        nearest = known[np.argmin(np.abs(kept[:, None] - known), axis=1)]
        close = (np.abs(nearest - kept) < 1e-3 * np.abs(kept)) & ((nearest.imag == 0) == (kept.imag == 0))
        base = np.where(close, nearest, kept)
    shift = kept - base
    polished = _aberth(loop, open_loop, base, np.where(shift == 0, 1e-14 * np.abs(base), shift), multiplicity)
    if polished is not None and complete(loop, open_loop, polished):
        return polished
    return ClosedLoopPoles(base, shift, multiplicity, open_loop)


def pole_condition(loop: Loop, s: ComplexArray, g: Receptances) -> Array:
    """|Δ(s)| over the sum of the sizes of its two parts: the residual of a closed-loop pole [-]."""
    return np.abs(characteristic(loop, s, g)) / (
        np.abs(plant_impedance(loop, s, g)) + np.abs(pid_response(loop.controller, s))
    )
