"""The independent judge of a design: feasibility, stability, jitter and optimality, on the truth model.

Nothing here trusts the optimizer or the fast path it used. Modes are judged by their residuals in physical
coordinates, poles by a dense eigenvalue solver, jitter by a Lyapunov equation or a quadrature of the physical
dynamic stiffness, optimality by multipliers that are computed afresh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, signal

from fosopt.control import OTHER, StateSpace, closed_loop_state_space, loop_matrices, pid_response
from fosopt.errors import FosoptError
from fosopt.expressions import Expression
from fosopt.metrics.disturbances import Disturbance, ShapingFilter
from fosopt.metrics.jitter import resonance_quadrature
from fosopt.metrics.sampled_check import sampled_disagreement
from fosopt.modes import ModalFrame, ModalSet
from fosopt.ops import Array, ComplexArray
from fosopt.problem import Constraint, Evaluation, Problem, Rows
from fosopt.problem.correction import as_model_sees
from fosopt.solve.kkt import active_multipliers
from fosopt.solve.nlp import NonlinearProgram, Task
from fosopt.structure import mass_weights, stiffness_weights

# A constraint may be violated by this share of its bound: ten times the solver's tolerance.
FEASIBILITY = 1e-6
# Two routes to the same jitter must agree to this; the Lyapunov route itself is good to about 1e-8.
AGREEMENT = 1e-6
# Dense eigenvalues of a state matrix of norm |A| are good to about n eps |A|; this is that with some room.
POLE_AGREEMENT = 1e-9
MODE_RESIDUAL = 1e-9
# Scaled KKT residual of a local optimum: what a quasi-Newton solver reaches at its acceptable level.
OPTIMALITY = 1e-3
# Metrics that an unstable loop does not have.
_LOOP_ONLY = ("jitter_", "step_", "peak_", "modulus_margin", "loop_crossover")
# A bound or constraint within this of its limit (relative) counts as active.
_ACTIVE = 1e-5


@dataclass(frozen=True)
class ConstraintReport:
    """One constraint at a design, in SI units.

    Attributes
    ----------
    value, lower, upper
        On the truth model.
    slack
        Distance to the nearest bound, negative where violated.
    multiplier
        Change of the objective per unit of the bound; None where the design was not optimized.
    """

    name: str
    value: float
    lower: float
    upper: float
    slack: float
    multiplier: float | None
    active: bool

    @property
    def violated(self) -> bool:
        """Whether it is off by more than the share of its bound that `FEASIBILITY` allows."""
        return self.slack < -FEASIBILITY * _size(self)


@dataclass(frozen=True)
class Certificate:
    """What an independent look at a design found.

    Attributes
    ----------
    verified
        Whether every check passed.
    reasons
        Those that did not, in words.
    stable
        By both the scalar function and the dense eigenvalue solver.
    spectral_abscissa
        By the dense eigenvalue solver [rad/s].
    mode_residual
        Largest |K φ − ω² M φ| and |Φᵀ M Φ − I|, relative.
    pole_disagreement, jitter_disagreement
        Between the two routes, relative.
    kkt_residual
        Norm of what remains of the scaled gradient; None where the design was not optimized.
    metrics
        Values on the truth model, None where the design has none.
    truncation_error
        Relative difference of each metric between the design model and the truth model; empty where the design
        model keeps all modes and the loop is not sampled.
    constraints
        With slack and multiplier.
    """

    verified: bool
    reasons: tuple[str, ...]
    stable: bool
    spectral_abscissa: float
    mode_residual: float
    pole_disagreement: float
    jitter_disagreement: float | None
    kkt_residual: float | None
    metrics: dict[str, float | None]
    truncation_error: dict[str, float]
    constraints: tuple[ConstraintReport, ...]


def certify(
    problem: Problem,
    x: Array,
    constraints: Sequence[Constraint],
    objective: Expression | None = None,
    free: NDArray[np.bool_] | None = None,
) -> Certificate:
    """Judge a design on the truth model.

    Parameters
    ----------
    x
        (n,) values of all variables.
    constraints
        What it must meet, limits on other objectives included.
    objective, free
        What was minimized over which variables; without them optimality is not judged.
    """
    truth = problem.evaluate(x, truth=True)
    reasons: list[str] = []
    mode_residual = _mode_residual(truth.frame, truth)
    if not mode_residual <= MODE_RESIDUAL:
        reasons.append(f"modes: residual {mode_residual:.1e} exceeds {MODE_RESIDUAL:.0e}")
    system = _scaled(
        closed_loop_state_space(truth.design.loop, truth.modes, problem.system.mirror_port), truth.modes
    )
    dense, disagreement = _poles(system, truth)
    abscissa = float(dense.real.max())
    sampled = truth.sampled
    stable = bool(truth.stable and (sampled is not None or abscissa < 0))
    jitter_disagreement = None
    if not stable:
        known = truth.poles.spectral_abscissa
        worst = max(abscissa, known) if sampled is None else sampled.model.spectral_abscissa
        reasons.append(f"unstable: a pole has the real part {worst:.4g} rad/s")
    elif sampled is not None:
        apart, jitter_disagreement = sampled_disagreement(sampled.model)
        disagreement = max(disagreement, apart)
    elif truth.system.disturbances:
        jitter_disagreement = max(
            _disagreement(independent_variance(truth, system, d), truth.variances[f"jitter_{d.name}"].value)
            for d in truth.system.disturbances
        )
    if not disagreement <= POLE_AGREEMENT:
        reasons.append(f"poles: two routes differ by {disagreement:.1e}, more than {POLE_AGREEMENT:.0e}")
    if jitter_disagreement is not None and not jitter_disagreement <= AGREEMENT:
        reasons.append(f"jitter: two routes differ by {jitter_disagreement:.1e}, more than {AGREEMENT:.0e}")
    if sampled is not None:
        abscissa = sampled.model.spectral_abscissa
    metrics = metrics_of(truth, stable)
    multipliers, kkt = _optimality(problem, x, constraints, objective, free) if stable else ({}, None)
    if kkt is not None and not kkt <= OPTIMALITY:
        reasons.append(f"optimality: KKT residual {kkt:.1e} exceeds {OPTIMALITY:.0e}")
    reports = []
    for constraint in (*constraints, *problem.checks):
        report = _constraint(problem, x, truth, stable, constraint, multipliers.get(constraint.name))
        if report is None:
            reasons.append(f"constraint '{constraint.name}' has no value: the loop is unstable")
            continue
        reports.append(report)
        if report.violated:
            reasons.append(
                f"constraint '{constraint.name}' is violated by {-report.slack:.3g} on the truth model"
            )
    return Certificate(
        not reasons,
        tuple(reasons),
        stable,
        abscissa,
        mode_residual,
        disagreement,
        jitter_disagreement,
        kkt,
        metrics,
        _truncation_error(problem.evaluate(x), truth, metrics) if stable else {},
        tuple(reports),
    )


def metrics_of(evaluation: Evaluation, stable: bool) -> dict[str, float | None]:
    """All scalar metrics of a design; None where it has none, as an unstable loop has no jitter or margin."""
    values: dict[str, float | None] = {}
    for name in evaluation.system.metric_names:
        if name.startswith(_LOOP_ONLY) and not stable:
            values[name] = None
            continue
        try:
            values[name] = evaluation.value(name)
        except FosoptError:
            values[name] = None
    return values


def _disagreement(variance: float, other: float) -> float:
    """Relative difference of two rms values from their squares; none where both are zero."""
    return 0.0 if variance == other else abs(variance - other) / (2 * max(abs(variance), abs(other)))


def _truncation_error(
    model: Evaluation, truth: Evaluation, metrics: dict[str, float | None]
) -> dict[str, float]:
    if model.kept.size == truth.kept.size and truth.sampled is None:
        return {}
    reduced = metrics_of(model, model.stable)
    return {
        name: abs(mine / true - 1)
        for name, true in metrics.items()
        if true and (mine := reduced[name]) is not None and mine != true
    }


def _mode_residual(frame: ModalFrame, truth: Evaluation) -> float:
    """By the rows of K = Bᵀ diag(w) B and M, which a large structure has instead of full matrices."""
    stiff, heavy = _forces(truth)
    shapes, n = frame.shapes, frame.n_exact
    momentum = heavy(shapes)
    residual = stiff(shapes[:, :n]) - momentum[:, :n] * frame.eigenvalue[:n]
    size = frame.eigenvalue[n - 1] * np.linalg.norm(momentum[:, :n], axis=0)
    gram = shapes.T @ momentum - np.eye(frame.eigenvalue.size)
    return float(max((np.linalg.norm(residual, axis=0) / size).max(), np.abs(gram).max()))


def _forces(truth: Evaluation) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Elastic forces K u and momenta M u of (n, c) displacements."""
    design, structure = truth.design, truth.system.structure
    stiffness = stiffness_weights(structure, design.area, design.spring_stiffness)
    mass = mass_weights(structure, design.area, design.batten_mass, design.mirror_mass)
    b, d = structure.stiffness_rows, structure.mass_rows
    return (lambda u: b.T @ (stiffness[:, None] * (b @ u))), (lambda u: d.T @ (mass[:, None] * (d @ u)))


def _scaled(system: StateSpace, modes: ModalSet) -> StateSpace:
    """The same system in states of like size: modal displacements times their frequency, then balanced."""
    n = modes.natural_frequency.size
    size = np.ones(system.a.shape[0])
    size[:n] = np.maximum(modes.natural_frequency, 1.0)
    a = size[:, None] * system.a / size
    _, (scale, _) = linalg.matrix_balance(a, permute=False, separate=True)
    size = size / scale
    return StateSpace(
        size[:, None] * system.a / size,
        size[:, None] * system.b,
        system.c / size,
        system.d,
        system.inputs,
        system.outputs,
    )


def _poles(system: StateSpace, truth: Evaluation) -> tuple[ComplexArray, float]:
    """Dense eigenvalues without a free rigid body's double zero, and their distance from the scalar route."""
    dense = linalg.eigvals(system.a)
    if truth.poles.open_loop.drifting:
        dense = dense[np.argsort(np.abs(dense))[2:]]
    known = truth.poles.all
    if known.size != dense.size:
        return dense, inf
    cost = np.abs(dense[:, None] - known)
    rows, columns = optimize.linear_sum_assignment(cost)
    return dense, float(cost[rows, columns].max() / np.abs(known).max())


def independent_variance(truth: Evaluation, system: StateSpace, disturbance: Disturbance) -> float:
    """Mean square line-of-sight error by a route that shares nothing with residues.

    A rational spectrum over all frequencies goes through the Lyapunov equation A P + P Aᵀ + B Bᵀ = 0 of loop and
    filter in series; everything else through a quadrature of the physical dynamic stiffness.
    """
    if disturbance.by_residues and not truth.poles.open_loop.drifting:
        return _by_lyapunov(system, disturbance)
    return _by_dynamic_stiffness(truth, disturbance)


def _by_lyapunov(system: StateSpace, disturbance: Disturbance) -> float:
    shape = disturbance.filter
    assert shape is not None
    rows = [k for k, name in enumerate(system.outputs) if name.endswith("line_of_sight")]
    # Disturbances about two axes are independent, each with a filter of its own.
    return sum(
        _filtered_variance(system, system.inputs.index(f"{axis}{disturbance.at}"), rows, shape)
        for axis in _sources(disturbance)
    )


def _sources(disturbance: Disturbance) -> list[str]:
    """What stands before the names of the inputs by which a disturbance enters."""
    return {"first": [""], "second": [OTHER], "both": ["", OTHER]}[disturbance.axis]


def _filtered_variance(system: StateSpace, column: int, rows: list[int], shape: ShapingFilter) -> float:
    b, c, d = system.b[:, [column]], system.c[rows], system.d[rows, column][:, None]
    if len(shape.denominator) == 1:
        gain = shape.numerator[0] / shape.denominator[0]
        a, b = system.a, gain * b
    else:
        fa, fb, fc, fd = signal.tf2ss(shape.numerator, shape.denominator)
        _, (scale, _) = linalg.matrix_balance(fa, permute=False, separate=True)
        fa, fb, fc = fa / scale[:, None] * scale, fb / scale[:, None], fc * scale
        a = np.block([[system.a, b @ fc], [np.zeros((fa.shape[0], system.a.shape[0])), fa]])
        b, c = np.vstack([b @ fd, fb]), np.hstack([c, d * fc])
    covariance = linalg.solve_continuous_lyapunov(a, -b @ b.T)
    return float(np.trace(c @ covariance @ c.T))


def _by_dynamic_stiffness(truth: Evaluation, disturbance: Disturbance) -> float:
    """∫ S(f) |H|² df with H from (K + jωC − ω²M) u = f in physical coordinates, structure and mirror together."""
    low, high = disturbance.counted
    cuts = disturbance.cuts
    own = disturbance.filter.poles if disturbance.filter is not None else np.zeros(0, complex)
    nodes, weights = resonance_quadrature(np.concatenate([truth.poles.all, own]), low, high, cuts)
    responses = _dense_responses(truth, nodes, *(f"{axis}{disturbance.at}" for axis in _sources(disturbance)))
    density = weights / (2 * np.pi) * disturbance.one_sided_psd(nodes)
    return float(density @ np.sum(np.abs(responses) ** 2, axis=1))


def _dense_responses(truth: Evaluation, frequencies: Array, *inputs: str) -> ComplexArray:
    """(m, k) Line-of-sight responses about all axes to all inputs, by a dense solve at each frequency."""
    structure, frame, modes, loop = truth.system.structure, truth.frame, truth.all_modes, truth.design.loop
    stiff, heavy = _forces(truth)
    # Of a large structure the motions that its truncated basis spans, of others all.
    span = np.eye(len(structure.dofs)) if frame.outside is None else frame.shapes
    k, m = span.T @ stiff(span), span.T @ heavy(span)
    momentum = span.T @ heavy(frame.shapes)
    k = k + (momentum * np.where(modes.rigid, modes.stiffness, 0.0)) @ momentum.T
    c = (momentum * modes.damping) @ momentum.T
    whole = loop_matrices(loop, (m, c, k), lambda port: structure.port(port) @ span, truth.system.mirror_port)
    size = whole.mass.shape[0]
    axes = [("", loop.controller, whole.control, whole.sensor, np.eye(size)[whole.mirror], loop.hub)]
    if whole.other is not None and loop.beside is not None:
        turned, beside = np.eye(size)[-1], loop.beside
        axes.append((OTHER, beside.controller, whole.other, turned, turned, beside.hub or loop.hub))
    response: ComplexArray = np.zeros((frequencies.size, len(axes) * len(inputs)), dtype=complex)
    for i, w in enumerate(frequencies):
        s = 1j * w
        total = whole.stiffness + s * whole.damping + s**2 * whole.mass
        loads: dict[str, ComplexArray] = {}
        for axis, pid, control, sensor, mirror, hub in axes:
            feedback = pid_response(pid, s) * control
            total = total + np.outer(feedback, sensor)
            on_hub = np.append(structure.port(hub) @ span, np.zeros(size - m.shape[0]))
            # Whatever else is measured comes back as torque −K times it.
            loads |= {f"{axis}mirror_torque": mirror, f"{axis}hub_torque": on_hub}
            loads |= {f"{axis}line_of_sight": -feedback, f"{axis}sensor_noise": -feedback}
        moved = np.linalg.solve(total, np.array([loads[name] for name in inputs]).T)
        response[i] = (np.array([mirror for *_, mirror, _ in axes]) @ moved).ravel()
    seen = [name == f"{axis}line_of_sight" for axis, *_ in axes for name in inputs]
    return response + np.array(seen, dtype=complex)


def _size(constraint: Constraint | ConstraintReport) -> float:
    finite = [abs(b) for b in (constraint.lower, constraint.upper) if np.isfinite(b) and b != 0]
    return max(finite, default=1.0)


def _constraint(
    problem: Problem,
    x: Array,
    truth: Evaluation,
    stable: bool,
    constraint: Constraint,
    multiplier: float | None,
) -> ConstraintReport | None:
    if not stable and any(name.startswith(_LOOP_ONLY) for name, _ in constraint.expression.references):
        return None
    try:
        value = float(Rows(problem, (constraint.expression,)).values(x, truth)[0])
    except FosoptError:
        return None
    slack = min(value - constraint.lower, constraint.upper - value)
    return ConstraintReport(
        constraint.name,
        value,
        constraint.lower,
        constraint.upper,
        slack,
        multiplier,
        bool(slack <= 10 * _ACTIVE * _size(constraint)),
    )


def _optimality(
    problem: Problem,
    x: Array,
    constraints: Sequence[Constraint],
    objective: Expression | None,
    free: NDArray[np.bool_] | None,
) -> tuple[dict[str, float], float | None]:
    """Multipliers by nonnegative least squares on the active set, and the residual of ∇f + Σ μ ∇g = 0.

    In the scaled variables and rows of the program; the residual is relative to the scaled objective, whose
    value is near one.
    """
    if objective is None or free is None or not free.any():
        return {}, None
    program = NonlinearProgram(Task(problem, objective, as_model_sees(problem, constraints, x), free), x)
    z = program.scaled(x)
    answer = program(z)
    if answer is None:
        return {}, inf
    value, gradient, rows, jacobian = answer
    columns, owner, signs = [], [], []
    for i, row in enumerate(rows):
        for limit, sign in ((program.row_upper[i], 1.0), (program.row_lower[i], -1.0)):
            if np.isfinite(limit) and sign * (row - limit) >= -_ACTIVE:
                columns.append(sign * jacobian[i])
                owner.append(i)
                signs.append(sign)
    span = program.upper - program.lower
    at_upper, at_lower = program.upper - z <= _ACTIVE * span, z - program.lower <= _ACTIVE * span
    matrix = np.array(columns).reshape(-1, z.size).T
    weights, residual = active_multipliers(matrix, gradient, at_upper, at_lower)
    multipliers: dict[str, float] = {}
    for i, sign, weight in zip(owner, signs, weights, strict=True):
        name = program.row_names[i]
        physical = float(-sign * weight * program.objective_slope(value) / program.row_scale[i])
        multipliers[name] = multipliers.get(name, 0.0) + physical
    for name in program.row_names:
        multipliers.setdefault(name, 0.0)
    return multipliers, float(np.abs(residual).max())
