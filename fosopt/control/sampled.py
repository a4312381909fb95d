"""The loop as built: a continuous plant under a controller that samples, computes for a while and holds.

Between two changes of the held torque everything is linear with constant input, so that states, energies and
covariances follow exactly from one sample to the next, see `control.spans`.    [Chen1995] Ch. 10-12

A free hub drifts, which no torque from within can change: the loop is that of what moves within, and what pushes the
hub from outside shakes that and turns the line of sight with the whole, by the second integral of the disturbance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from fosopt.control.discrete import DiscreteController, discrete_controller
from fosopt.control.filter_states import FilterStates, filter_state_space, rational_states
from fosopt.control.free_body import split
from fosopt.control.loop import Loop
from fosopt.control.pid import Sampling
from fosopt.control.spans import Span, span, stacked
from fosopt.control.state_space import StateSpace, plant_state_space
from fosopt.errors import ModelError
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray

# A computation delay this close to whole periods, as a share of one, is taken as whole.
_WHOLE = 1e-9
_INTEGRATOR = FilterStates(np.zeros((1, 1)), np.ones(1), np.ones(1), 0.0)


@dataclass(frozen=True)
class Source:
    """A random input in front of the sampled loop: white noise through a filter.

    Attributes
    ----------
    at
        One of ``mirror_torque``, ``hub_torque``, ``line_of_sight``, ``sensor_noise``.
    states
        Of its shaping filter.
    integrals
        (n,) rows that read the integral and the second integral of the noise from these states, of a filter that
        differentiates once or twice; fewer of another.
    """

    at: str
    states: FilterStates
    integrals: tuple[Array, ...] = ()

    @classmethod
    def shaped(cls, at: str, numerator: Sequence[float], denominator: Sequence[float]) -> Source:
        """White noise through a rational filter, coefficients highest power first."""
        rows = []
        for lower in (list(numerator[:-1]), list(numerator[:-2])):
            if any(numerator[len(lower) :]):
                break
            rows.append(rational_states(lower, denominator).c)
        return cls(at, rational_states(numerator, denominator), tuple(rows))

    def washed(self, numerator: Sequence[float], denominator: Sequence[float]) -> Source:
        """The same through one more rational filter, which differentiates at least twice."""
        after = Source.shaped(self.at, numerator, denominator)
        none = np.zeros(self.states.order)
        rows = tuple(np.concatenate([none, row]) for row in after.integrals)
        return Source(self.at, self.states.then(after.states), rows)

    @property
    def turning(self) -> FilterStates:
        """The second integral of the noise, by which a free body turns; more states where `states` lack it."""
        states = self.states
        if self.integrals:
            states = FilterStates(states.a, states.b, self.integrals[-1], 0.0)
        for _ in range(2 - len(self.integrals)):
            states = states.then(_INTEGRATOR)
        return states


@dataclass(frozen=True)
class SampledLoop:
    """Matrices of a sampled loop.

    The continuous states are [structure and mirror, anti-alias filters, shaping filters of the sources], those kept
    from sample to sample [continuous states, controller, past torques u[k−1], u[k−2], ...]. A free hub's drift is none.

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
    drift
        Which continuous states only integrate: angles by which sources turn a free body without bound.
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
    drift: tuple[int, ...] = ()

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
    def settled(self) -> tuple[Array, Array]:
        """(size−d, size), (size, size−d) States at a sample beside those a drift leaves behind, and back without drift.

        A loop with integral action follows d drifts: one that stands still leaves states at which nothing moves and
        the line of sight has no error. What is beside these decays, whatever the drift does.
        """
        kept = np.delete(np.arange(self.size), self.drift)
        beside, back = np.eye(self.size)[kept], np.eye(self.size)[:, kept]
        if self.drift:
            moved = self.transition[kept]
            left = np.linalg.solve(np.eye(kept.size) - moved[:, kept], moved[:, list(self.drift)])
            beside[:, list(self.drift)] = -left
        return beside, back

    @cached_property
    def energy(self) -> Array:
        """(r, size) F with FᵀF = ∫ y² dt of the line of sight over the period that follows a sample."""
        first, second = self.phases
        return stacked(self.spans[0].energy @ first, self.spans[1].energy @ second)

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
    """(m, n, c) (s I − U)⁻¹ B at (m,) points, U upper triangular: back substitution at all points together."""
    found: ComplexArray = np.empty((*columns.shape, points.size), dtype=complex)
    for k in reversed(range(columns.shape[0])):
        below = np.tensordot(upper[k, k + 1 :], found[k + 1 :], 1)
        found[k] = (columns[k][:, None] + below) / (points - upper[k, k])
    return np.moveaxis(found, 2, 0)


def sampled_loop(
    loop: Loop, modes: ModalSet, mirror_port: str, sources: Sequence[Source] = ()
) -> SampledLoop:
    """The sampled loop of a loop whose controller has a `Sampling`.

    Raises
    ------
    ModelError
        If the controller is not sampled, the control torque turns a free hub, or a source would be sampled or seen with
        infinite variance.
    """
    controller = discrete_controller(loop.controller)
    sampling = loop.controller.path.sampling
    assert sampling is not None
    plant = _with_stroke(plant_state_space(loop, modes, mirror_port), modes.at(mirror_port))
    plant, turned = split(plant, loop, modes, mirror_port)
    plant, free = _scaled(plant), bool(np.any(modes.stiffness == 0))
    anti_alias = filter_state_space(loop.controller.path.anti_alias)
    shapes = [source.turning if free and source.at in plant.inputs else source.states for source in sources]
    n, aliased = plant.a.shape[0], anti_alias.order
    size = n + aliased + sum(shape.order for shape in shapes)
    a = np.zeros((size, size))
    noise = np.zeros((len(sources), size))
    torque, line_of_sight, measured = np.zeros(size), np.zeros(size), np.zeros(size)
    part = slice(n, n + aliased)
    aimed, sensed = plant.outputs.index("mirror_angle"), plant.outputs.index("sensor_angle")
    a[:n, :n] = plant.a
    torque[:n] = plant.b[:, plant.inputs.index("control_torque")]
    line_of_sight[:n] = plant.c[aimed]
    angle = plant.c[sensed]
    stroke = np.zeros((2, size))
    stroke[:, :n] = plant.c[-2:]
    a[part, :n], a[part, part] = np.outer(anti_alias.b, angle), anti_alias.a
    measured[:n], measured[part] = anti_alias.d * angle, anti_alias.c
    first = n + aliased
    drift: list[int] = []
    for k, (source, shape) in enumerate(zip(sources, shapes, strict=True)):
        own, known = slice(first, first + shape.order), source.states.order
        drift += range(first + known, first + shape.order)
        a[own, own], noise[k, own] = shape.a, shape.b
        seen, read = shape.c, shape.c
        if source.at in plant.inputs:
            load = plant.inputs.index(source.at)
            push = plant.b[:, load]
            a[:n, first : first + known] = np.outer(push, source.states.c)
            noise[k, :n] = source.states.d * push
            seen, read = turned[aimed, load] * shape.c, turned[sensed, load] * shape.c
        else:
            _refuse_infinite(source, anti_alias)
            noise[k, part] = shape.d * anti_alias.b
            seen = float(source.at == "line_of_sight") * shape.c
        line_of_sight[own] = seen
        a[part, own] = np.outer(anti_alias.b, read)
        measured[own] = anti_alias.d * read
        first += shape.order
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
        tuple(drift),
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
