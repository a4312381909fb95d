"""All closed-loop poles from one scalar function.

The closed loop of a mirror on n modes has 2n + 3 poles or so, most of them shifted from an open-loop pole by
very little. They are found together by Aberth's method [Aberth1973] on Δ(s) Π_k D_k(s), and kept as open-loop
pole plus shift: the shift, which carries all that matters of a nearly cancelled mode, keeps full relative
accuracy however small it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from fosopt.actuators import Suspended
from fosopt.control.axes import determinant
from fosopt.control.loop import Loop, Receptances, attach, characteristic, impedance, plant_impedance
from fosopt.control.open_loop import BLOCK, OpenLoopPoles, moving_pairs, open_loop_poles
from fosopt.control.pid import pid_response
from fosopt.control.state_space import closed_loop_state_space
from fosopt.errors import SolverError, UnstableError
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray, Dual

_MAX_ITERATIONS = 60
_CONVERGED = 1e-9  # relative step of a shift; convergence is at least quadratic, so it leaves nothing
_ROUNDING = 1e-11  # relative step of a pole below which it may be rounding
_TRACE = 1e-8
# What eigenvalues of a state matrix may be off by, of the largest, and how often they are mended where two axes couple.
_NEAR, _POLISHED = 1e-9, 3


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

    def refuse_unstable(self, shift: float = 0.0) -> None:
        """Let pass what decays faster than e^{shift t} alone, `shift` in rad/s.

        Raises
        ------
        UnstableError
            If a pole does not lie left of `shift`.
        """
        if not self.spectral_abscissa < shift:
            raise UnstableError(
                f"closed loop is unstable: a pole has the real part {self.spectral_abscissa:.6g} rad/s"
            )

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
    if loop.beside is not None:
        return _of_both_axes(loop, modes, mirror_port, open_loop)
    if near is not None and np.array_equal(near.open_loop.first, open_loop.first):
        followed = _aberth(loop, open_loop, near.base, near.shift, near.multiplicity)
        if followed is not None and complete(loop, followed):
            return followed
    base, shift, multiplicity = _start(loop, open_loop)
    found = _aberth(loop, open_loop, base, shift, multiplicity)
    if found is None or not complete(loop, found):
        found = _dense(loop, modes, mirror_port, open_loop)
        if not complete(loop, found):
            raise SolverError(
                "closed-loop poles: the set found violates the sum of poles (trace); rescale gains or inertia"
            )
    return found


def _controller_poles(loop: Loop) -> ComplexArray:
    """Poles of the loop on a rigid support, the guess for those that belong to mirror and controller."""
    mirror, pid = loop.mirror, loop.controller
    lag = pid.lag if pid.kd else 0.0
    if pid.path.sections:
        return _filtered_poles(loop)
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


def _filtered_poles(loop: Loop) -> ComplexArray:
    """The same with filters, whose poles are among them: zeros of (J s² + c s + k) D + N with K = N/D."""
    mirror, pid = loop.mirror, loop.controller
    low_pass = [pid.lag, 1.0] if pid.kd else [1.0]
    numerator = np.polyadd(np.polymul([pid.kp, pid.ki], low_pass), [pid.kd, 0.0, 0.0])
    denominator = np.polymul([1.0, 0.0], low_pass)
    if not pid.ki:
        numerator, denominator = numerator[:-1], denominator[:-1]
    for section in pid.path.sections:
        numerator = np.polymul(numerator, section.numerator)
        denominator = np.polymul(denominator, section.denominator)
    plant = [mirror.inertia, mirror.damping, mirror.stiffness]
    return np.roots(np.polyadd(np.polymul(plant, denominator), pid.gain * numerator)).astype(complex)


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
    with np.errstate(divide="ignore", invalid="ignore"):
        # A reaction mass on a port that does not move keeps its own pole, where its transmission has no value.
        delta = characteristic(loop, Dual(structural, 0.0), _of(pairs))
    still = ~np.isfinite(delta.value)
    push, delta = np.where(still, 0.0, delta.slope), np.where(still, 1.0, delta.value)
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
    needed, pair, shift = _needed(loop), multiplicity == 2, shift.copy()
    rows, before = np.arange(base.size), np.full(base.size, np.inf)  # poles that still move, and by how much
    with np.errstate(all="ignore"):
        for _ in range(_MAX_ITERATIONS):
            b, d = base[rows], shift[rows]
            s = b + d
            pairs, known = open_loop.sums(b, d, needed)
            step = aberth_step(loop, s, _of(pairs), known, _repulsion(base, shift, pair, rows))
            step = np.where(pair[rows], step, step.real)
            if not np.isfinite(step).all():
                return None
            shift[rows] = d = d - step
            still = moves(step, before[rows], d, s)
            before[rows] = np.abs(step)
            rows = rows[still]
            if rows.size == 0:
                return ClosedLoopPoles(base, shift, multiplicity, open_loop)
    return None


def _repulsion(
    base: ComplexArray, shift: ComplexArray, pair: NDArray[np.bool_], rows: NDArray[np.intp]
) -> ComplexArray:
    """Σ 1/(p − p_j) over all other poles and the conjugates of pairs, for the poles p of `rows`."""
    mirrored, by = base[pair].conj(), shift[pair].conj()
    total = np.empty(rows.size, dtype=complex)
    size = max(BLOCK // base.size, 1)
    for start in range(0, rows.size, size):
        part = rows[start : start + size]
        b, d = base[part, None], shift[part, None]
        apart = (b - base) + (d - shift)
        apart[np.arange(part.size), part] = np.inf
        total[start : start + size] = (1 / apart).sum(axis=1) + (1 / ((b - mirrored) + (d - by))).sum(axis=1)
    return total


def aberth_step(
    loop: Loop,
    s: ComplexArray,
    g: Receptances,
    known: ComplexArray,
    repulsion: ComplexArray,
    hung: Sequence[tuple[int, Suspended]] = (),
) -> ComplexArray:
    """Step from (m,) poles towards the zeros of Δ(s) Π_k D_k(s) Π_a E_a(s).    [Aberth1973]

    E_a is the impedance of what hangs on the structure beyond its poles D_k, each body on what the one before has
    made of it: it takes the poles away that a body gives to the receptances.

    Parameters
    ----------
    g
        Receptances at `s` with their derivatives, those of the structure without `hung`.
    known
        Σ_k D_k′/D_k.
    repulsion
        Σ 1/(s − p) over all other poles p.
    """
    at = Dual(s, 1.0)
    wanted = [loop.pairs[k] for k in moving_pairs(loop)] if loop.beside is None and hung else loop.pairs
    for port, body in hung:
        own = impedance(at, body.inertia, body.coupling(at), g.between(port, port))
        known = known + own.slope / own.value
        g = attach(at, g, port, body, wanted)
    beside = loop.beside
    delta = characteristic(loop, at, g) if beside is None else determinant(loop, at, g)
    for pid in (loop.controller,) if beside is None else (loop.controller, beside.controller):
        if _present(pid.ki):
            known = known + 1 / s
        if _present(pid.lag) and _present(pid.kd):
            known = known + pid.lag / (1 + pid.lag * s)
        for section in pid.path.sections:
            known = known + (1 / (s[..., None] - section.poles)).sum(axis=-1)
    # Multiplied through by Δ, so that a shift that is already exact gives a step of zero.
    return delta.value / (delta.slope + delta.value * (known - repulsion))


def _present(gain: Any) -> bool:
    """Whether a gain, or one of many, is not zero; spelled out because it is asked four times a pole search."""
    return bool(gain.any()) if isinstance(gain, np.ndarray) else gain != 0


def moves(step: ComplexArray, before: Array, shift: ComplexArray, s: ComplexArray) -> NDArray[np.bool_]:
    """Which poles a step still moves by more than rounding.

    Parameters
    ----------
    before
        Sizes of the steps before: small ones that do not shrink any more are the rounding of Δ.
    """
    size = np.abs(step)
    stuck = (size < _ROUNDING * np.abs(s)) & (size > 0.5 * before)
    return (size > _CONVERGED * np.abs(shift)) & (size > 1e-15 * np.abs(s)) & ~stuck


def complete(loop: Loop, poles: ClosedLoopPoles) -> bool:
    """Whether the poles add up to the trace of the closed loop, which a missing or doubled pole would break."""
    return bool(adds_up(loop, poles.open_loop, poles.value, poles.multiplicity))


def adds_up(
    loop: Loop, open_loop: OpenLoopPoles, value: ComplexArray, multiplicity: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """(...,) The same for (..., m) poles of loops whose numbers are (..., 1) arrays."""
    pid = loop.controller
    low_pass = _present(pid.lag) and _present(pid.kd)
    trace = _plant_trace(loop, open_loop)
    sections = pid.path.sections
    direct = prod(section.direct for section in sections)
    lead = pid.gain * pid.kd * direct * _mobility(loop, open_loop)
    trace = trace + (1 / pid.lag if low_pass else lead)
    trace = trace - sum(float(section.poles.real.sum()) for section in sections)
    found = -(multiplicity * value.real).sum(axis=-1, keepdims=True)
    size = np.abs(value).sum(axis=-1, keepdims=True)
    bodies = 1 + len(open_loop.hung)
    count = 2 * int((open_loop.first != 0).sum()) + 2 * bodies + _present(pid.ki) + low_pass
    count += sum(section.order for section in sections)
    upper = np.all((multiplicity == 1) | (value.imag > 0), axis=-1)
    right: NDArray[np.bool_] = np.abs(found - trace) <= _TRACE * size
    return right[..., 0] & upper & (int(multiplicity.sum()) == count)


def _plant_trace(loop: Loop, open_loop: OpenLoopPoles) -> Any:
    """Sum of the plant's poles, negative: what its dampers make of it."""
    free = open_loop.mobility
    total = -(open_loop.first + open_loop.second).real.sum()
    total = total + loop.mirror.damping * (free.direct + 1 / loop.mirror.inertia)
    for port, body in open_loop.hung:
        assert isinstance(body, Suspended)
        total = total + body.damping * (free.between(port, port) + 1 / body.inertia)
    return total


def _mobility(loop: Loop, open_loop: OpenLoopPoles) -> Any:
    """Acceleration of what is sensed per control torque, at once: lim s² G(s) [1/(kg m²)]."""
    place, shares = loop.placement, loop.mirror.reaction_mass
    if place.sensor is None:
        return 1 / loop.mirror.inertia if place.action is None else 0.0
    free, j = open_loop.mobility, loop.index(place.sensor)
    reacting = free.between(j, loop.index(place.reaction)) * (1 - (shares.torque_ratio if shares else 0.0))
    return (free.between(j, loop.index(place.action)) if place.action else 0.0) - reacting


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
    if polished is not None and complete(loop, polished):
        return polished
    return ClosedLoopPoles(base, shift, multiplicity, open_loop)


def _of_both_axes(loop: Loop, modes: ModalSet, mirror_port: str, open_loop: OpenLoopPoles) -> ClosedLoopPoles:
    """Poles of two loops on one structure: eigenvalues of the state matrix, polished on the determinant.

    Alike axes have double poles, where Aberth's method from afar would creep; a step from an eigenvalue that is good
    already is taken only as far as such an eigenvalue may err.
    """
    seen = modes.keep(np.flatnonzero(open_loop.seen))
    eigenvalue = linalg.eigvals(closed_loop_state_space(loop, seen, mirror_port).a)
    if open_loop.drifting:
        eigenvalue = eigenvalue[np.argsort(np.abs(eigenvalue))[2:]]
    value = eigenvalue[eigenvalue.imag >= 0]
    pair = value.imag > 0
    reach = _NEAR * np.abs(value).max()
    for _ in range(_POLISHED):
        shift = np.zeros_like(value)
        with np.errstate(all="ignore"):
            pairs, known = open_loop.sums(value, shift)
            repulsion = _repulsion(value, shift, pair, np.arange(value.size))
            step = aberth_step(loop, value, _of(pairs), known, repulsion, tuple(loop.suspended))
        step = np.where(pair, step, step.real)
        good = np.isfinite(step) & (np.abs(step) <= reach)
        value = value - np.where(good, step, 0.0)
    return ClosedLoopPoles(value, np.zeros_like(value), np.where(pair, 2, 1), open_loop)


def pole_condition(loop: Loop, s: ComplexArray, g: Receptances) -> Array:
    """|Δ(s)| over the sum of the sizes of its two parts: the residual of a closed-loop pole [-]."""
    return np.abs(characteristic(loop, s, g)) / (
        np.abs(plant_impedance(loop, s, g)) + np.abs(pid_response(loop.controller, s))
    )
