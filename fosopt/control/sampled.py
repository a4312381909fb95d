"""The loop as built: a continuous plant under a controller that samples, computes for a while and holds.

Between two changes of the held torque everything is linear with constant input, so that states, energies and
covariances follow exactly from one sample to the next. Φ = e^{At} and the energy R = ∫ e^{Aᵀs} cᵀc e^{As} ds of a
span t come from those of a tiny span, a short power series, by doubling it,

    Φ(2t) = Φ(t)²,    R(2t) = R(t) + Φ(t)ᵀ R(t) Φ(t).

An energy is kept as a factor F with R = FᵀF, so that a sum of energies is a stack of factors: what a loop attenuates by
10⁵ in amplitude would lose ten digits in R and loses five in F. No eigenvectors are needed: repeated poles and a hub's
slow ones do no harm.    [VanLoan1978], [Chen1995] Ch. 10-12
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import linalg

from fosopt.control.discrete import DiscreteController, discrete_controller
from fosopt.control.filter_states import FilterStates, filter_state_space
from fosopt.control.loop import Loop
from fosopt.control.pid import Sampling
from fosopt.control.state_space import StateSpace, plant_state_space
from fosopt.errors import ModelError, SolverError
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray

# The span a power series covers: norm of A times it, terms and quadrature nodes that leave less than rounding.
_SHORT = 0.25
_TERMS = 14
_NODES = 6
# A computation delay this close to whole periods, as a share of one, is taken as whole.
_WHOLE = 1e-9
_DOUBLINGS = 60
_NOTHING = 1e-15  # of an amplitude; the square of it of an energy


class Span(NamedTuple):
    """What a span of time t does to states x of ẋ = A x, y = C x.

    Attributes
    ----------
    carried
        (n, n) Φ = e^{At}.
    energy
        (r, n) F with FᵀF = R(t) = ∫_0^t e^{Aᵀs} CᵀC e^{As} ds.
    grown
        (r, n) the same of ∫_0^t R(s) ds, empty unless asked for.
    """

    carried: Array
    energy: Array
    grown: Array


def span(a: Array, rows: Array, time: float, grown: bool = False) -> Span:
    """Φ and the energy of outputs over a span of time, as factors.    [VanLoan1978]

    Parameters
    ----------
    a, rows
        (n, n) A and (p, n) C.
    time
        t, zero or more [s].
    grown
        Whether the integral of the energy is asked for.
    """
    n = a.shape[0]
    if time == 0:
        return Span(np.eye(n), np.zeros((0, n)), np.zeros((0, n)))
    short = float(np.linalg.norm(a, 1)) * time / _SHORT
    doublings = int(np.ceil(np.log2(max(short, 1.0))))
    step = time / 2**doublings
    carried, power = np.eye(n), np.eye(n)
    for k in range(1, _TERMS):
        power = step / k * (power @ a)
        carried = carried + power
    x, w = np.polynomial.legendre.leggauss(_NODES)
    at, weight = 0.5 * (x + 1), 0.5 * step * w
    term, nodes = rows, np.tile(rows, (_NODES, 1, 1))
    for k in range(1, _TERMS if rows.shape[0] else 0):
        term = step / k * (term @ a)
        nodes = nodes + at[:, None, None] ** k * term
    energy = _stacked(*(np.sqrt(weight)[:, None, None] * nodes))
    inner = np.zeros((0, n))
    if grown:
        inner = _stacked(*(np.sqrt(weight * step * (1 - at))[:, None, None] * nodes))
    for _ in range(doublings):
        if grown:
            inner = _stacked(inner, np.sqrt(step) * energy, inner @ carried)
        energy = _stacked(energy, energy @ carried)
        carried = carried @ carried
        step *= 2
    return Span(carried, energy, inner)


def _stacked(*factors: Array) -> Array:
    """A factor of a sum of energies, with no more rows than columns."""
    whole = np.vstack(factors)
    if whole.shape[0] <= whole.shape[1]:
        return whole
    triangle: Array = linalg.qr(whole, mode="r", check_finite=False)[0][: whole.shape[1]]
    return triangle


def energy_for_ever(transition: Array, energy: Array) -> Array:
    """(r, n) F with FᵀF = Y = Mᵀ Y M + E, the energy that a state at a sample leaves for ever, by doubling its terms.

    [Smith1968]

    Parameters
    ----------
    transition, energy
        (n, n) M and (p, n) a factor of E.

    Raises
    ------
    SolverError
        If the sum does not end.
    """
    total, step = energy, transition
    for _ in range(_DOUBLINGS):
        added = total @ step
        if np.linalg.norm(added) <= _NOTHING * np.linalg.norm(total):
            return total
        total = _stacked(total, added)
        step = step @ step
    raise SolverError("sampled loop: its energy does not end; it is on the verge of instability")


@dataclass(frozen=True)
class Source:
    """A random input in front of the sampled loop: white noise through a filter.

    Attributes
    ----------
    at
        One of ``mirror_torque``, ``hub_torque``, ``line_of_sight``, ``sensor_noise``.
    states
        Of its shaping filter.
    """

    at: str
    states: FilterStates


@dataclass(frozen=True)
class SampledLoop:
    """Matrices of a sampled loop.

    The continuous states are [structure and mirror, anti-alias filters, shaping filters of the sources], those kept
    from sample to sample [continuous states, controller, past torques u[k−1], u[k−2], ...].

    Attributes
    ----------
    a, torque, line_of_sight, measured
        (n, n), (n,), (n,), (n,) of the continuous states: ẋ = a x + torque·u.
    stroke
        (2, n) the mirror's angle against its port, and the rate of that.
    noise
        (s, n) what the white noise of each source drives.
    controller, states
        In z, and as states from error to torque.
    period, whole, rest
        T [s]; the delay in whole periods and what is left of it [s].
    """

    a: Array
    torque: Array
    line_of_sight: Array
    measured: Array
    stroke: Array
    noise: Array
    controller: DiscreteController
    states: FilterStates
    period: float
    whole: int
    rest: float

    @cached_property
    def _held(self) -> Array:
        """(n+1, n+1) Continuous states with the held torque behind them."""
        n = self.torque.size
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n] = self.a, self.torque
        return whole

    @cached_property
    def spans(self) -> tuple[Span, Span]:
        """Of continuous states and held torque, before and after the held torque changes within a period."""
        row = np.append(self.line_of_sight, 0.0)[None]
        return span(self._held, row, self.rest), span(self._held, row, self.period - self.rest)

    def carried(self, time: float) -> Array:
        """(n+1, n+1) What a span of time does to continuous states and the held torque behind them."""
        return span(self._held, self._held[:0], time).carried

    @property
    def past(self) -> int:
        """How many past torques matter."""
        return self.whole + (self.rest > 0)

    @property
    def size(self) -> int:
        """Number of states kept from sample to sample."""
        return self.torque.size + self.states.order + self.past

    @cached_property
    def rows(self) -> tuple[Array, Array, Array]:
        """(size,) Rows that read the new torque u[k], the torque held before and after the change in the period."""
        n, order = self.torque.size, self.states.order
        new = np.zeros(self.size)
        new[:n] = -self.states.d * self.measured
        new[n : n + order] = self.states.c
        torques = [new, *np.eye(self.size)[n + order :]]
        after = torques[self.whole]
        return new, torques[self.whole + 1] if self.rest > 0 else after, after

    @cached_property
    def phases(self) -> tuple[Array, Array]:
        """(n+1, size) Continuous states and held torque as the two parts of a period begin."""
        n = self.torque.size
        _, before, after = self.rows
        first = np.vstack([np.eye(self.size)[:n], before])
        second = np.vstack([(self.spans[0].carried @ first)[:n], after])
        return first, second

    @cached_property
    def transition(self) -> Array:
        """(size, size) From one sample to the next."""
        n, order = self.torque.size, self.states.order
        new, _, _ = self.rows
        moved = np.zeros((self.size, self.size))
        moved[:n] = (self.spans[1].carried @ self.phases[1])[:n]
        moved[n : n + order, n : n + order] = self.states.a
        moved[n : n + order, :n] = -np.outer(self.states.b, self.measured)
        if self.past:
            moved[n + order] = new
            moved[n + order + 1 :, n + order : -1] = np.eye(self.past - 1)
        return moved

    @cached_property
    def energy(self) -> Array:
        """(r, size) F with FᵀF = ∫ y² dt of the line of sight over the period that follows a sample."""
        first, second = self.phases
        return _stacked(self.spans[0].energy @ first, self.spans[1].energy @ second)

    @cached_property
    def poles(self) -> ComplexArray:
        """(size,) Closed-loop poles in z; those of the shaping filters are among them."""
        return linalg.eigvals(self.transition)

    @property
    def spectral_abscissa(self) -> float:
        """ln|z|/T of the outermost pole, negative for a stable loop [rad/s]."""
        return float(np.log(max(np.abs(self.poles).max(), 1e-300)) / self.period)

    @cached_property
    def plant(self) -> tuple[Array, Array, Array]:
        """(m, m), (m,), (m,) The plant from computed torque u[k] to sample y[k], with delays, in z."""
        n = self.torque.size
        size = n + self.past
        torques = np.eye(size)[n:]
        moved = np.zeros((size, size))
        column = np.zeros(size)
        before, after = self.spans[0].carried, self.spans[1].carried
        first, second = after[:n, :n] @ before[:n, n], after[:n, n]
        moved[:n, :n] = after[:n, :n] @ before[:n, :n]
        # The torque held in the first part of a period is one sample older than that of the second.
        if self.rest > 0:
            moved[:n] += np.outer(first, torques[self.whole])
        if self.whole:
            moved[:n] += np.outer(second, torques[self.whole - 1])
        else:
            column[:n] = second
        if self.past:
            column[n] = 1.0
            moved[n + 1 :, n:-1] = np.eye(self.past - 1)
        return moved, column, np.append(self.measured, np.zeros(self.past))

    @cached_property
    def _triangular(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        moved, column, row = self.plant
        upper, turn = linalg.schur(moved, output="complex")
        return upper, turn.conj().T @ column, row @ turn

    def plant_response(self, z: ComplexArray) -> ComplexArray:
        """(m,) G(z) from computed torque to sample, with delay, hold and anti-alias filters [rad/(N m)].

        [Astrom1997] Sec. 2.3; the modified z-transform of [Jury1958] for every delay.
        """
        upper, column, row = self._triangular
        return row @ solutions(upper, column[:, None], z)[:, :, 0].T

    def loop_transfer(self, z: ComplexArray) -> ComplexArray:
        """(m,) L(z) = G(z) C(z) [-]."""
        return self.plant_response(z) * self.controller.response(z)


def solutions(upper: ComplexArray, columns: ComplexArray, points: ComplexArray) -> ComplexArray:
    """(m, n, c) (s I − U)⁻¹ B at (m,) points, U upper triangular."""
    found: ComplexArray = np.empty((points.size, *columns.shape), dtype=complex)
    for k, point in enumerate(points):
        shifted = -upper
        shifted[np.diag_indices_from(shifted)] += point
        found[k] = linalg.solve_triangular(shifted, columns, check_finite=False)
    return found


def sampled_loop(
    loop: Loop, modes: ModalSet, mirror_port: str, sources: Sequence[Source] = ()
) -> SampledLoop:
    """The sampled loop of a loop whose controller has a `Sampling`.

    Raises
    ------
    ModelError
        If the controller is not sampled, the hub is free, or a source would be sampled or seen with infinite variance.
    """
    controller = discrete_controller(loop.controller)
    sampling = loop.controller.path.sampling
    assert sampling is not None
    if np.any(modes.stiffness == 0):
        raise ModelError("sampled loop: a free hub drifts between samples; hold or fix the hub")
    plant = _scaled(_with_stroke(plant_state_space(loop, modes, mirror_port), modes.at(mirror_port)))
    anti_alias = filter_state_space(loop.controller.path.anti_alias)
    n, aliased = plant.a.shape[0], anti_alias.order
    size = n + aliased + sum(source.states.order for source in sources)
    a = np.zeros((size, size))
    noise = np.zeros((len(sources), size))
    torque, line_of_sight, measured = np.zeros(size), np.zeros(size), np.zeros(size)
    part = slice(n, n + aliased)
    a[:n, :n] = plant.a
    torque[:n] = plant.b[:, plant.inputs.index("control_torque")]
    line_of_sight[:n] = plant.c[plant.outputs.index("mirror_angle")]
    angle = plant.c[plant.outputs.index("sensor_angle")]
    stroke = np.zeros((2, size))
    stroke[:, :n] = plant.c[-2:]
    a[part, :n], a[part, part] = np.outer(anti_alias.b, angle), anti_alias.a
    measured[:n], measured[part] = anti_alias.d * angle, anti_alias.c
    first = n + aliased
    for k, source in enumerate(sources):
        shape = source.states
        own = slice(first, first + shape.order)
        first += shape.order
        a[own, own], noise[k, own] = shape.a, shape.b
        if source.at in plant.inputs:
            push = plant.b[:, plant.inputs.index(source.at)]
            a[:n, own], noise[k, :n] = np.outer(push, shape.c), shape.d * push
            continue
        _refuse_infinite(source, anti_alias)
        a[part, own], noise[k, part] = np.outer(anti_alias.b, shape.c), shape.d * anti_alias.b
        measured[own] = anti_alias.d * shape.c
        if source.at == "line_of_sight":
            line_of_sight[own] = shape.c
    whole, rest = _delay(sampling)
    return SampledLoop(
        a,
        torque,
        line_of_sight,
        measured,
        stroke,
        noise,
        controller,
        controller.states,
        sampling.period,
        whole,
        rest,
    )


def _refuse_infinite(source: Source, anti_alias: FilterStates) -> None:
    if source.states.d and anti_alias.d:
        raise ModelError(
            f"sampled loop: a '{source.at}' disturbance that does not roll off is sampled with infinite variance; "
            "add an anti-alias filter, or a band to the disturbance"
        )
    if source.states.d and source.at == "line_of_sight":
        raise ModelError(
            "sampled loop: this line-of-sight disturbance has infinite power; use a filter that rolls off"
        )


def _delay(sampling: Sampling) -> tuple[int, float]:
    """The delay in whole periods and what is left [s]."""
    share = sampling.delay / sampling.period
    whole = round(share) if abs(share - round(share)) <= _WHOLE else int(share)
    rest = (share - whole) * sampling.period
    return whole, rest if rest > _WHOLE * sampling.period else 0.0


def _with_stroke(plant: StateSpace, port: Array) -> StateSpace:
    """The plant with two more outputs, the mirror's angle against its port and the rate of that."""
    half, n = plant.a.shape[0] // 2, port.size
    rows = plant.c[[plant.outputs.index(name) for name in ("mirror_angle", "mirror_rate")]].copy()
    rows[0, :n] -= port
    rows[1, half : half + n] -= port
    return replace(
        plant,
        c=np.vstack([plant.c, rows]),
        d=np.vstack([plant.d, np.zeros((2, plant.d.shape[1]))]),
        outputs=(*plant.outputs, "stroke", "stroke_rate"),
    )


def _scaled(plant: StateSpace) -> StateSpace:
    """The same plant in states of like size: displacements times a frequency, then balanced."""
    count = plant.a.shape[0] // 2
    size = np.ones(2 * count)
    diagonal = np.abs(np.diag(plant.a[count:, :count]))
    size[:count] = np.sqrt(np.maximum(diagonal, 1.0))
    a = size[:, None] * plant.a / size
    _, (scale, _) = linalg.matrix_balance(a, permute=False, separate=True)
    size = size / scale
    return StateSpace(
        size[:, None] * plant.a / size,
        size[:, None] * plant.b,
        plant.c / size,
        plant.d,
        plant.inputs,
        plant.outputs,
    )
