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

from fosopt.control import StateSpace, closed_loop_state_space, pid_response
from fosopt.errors import FosoptError
from fosopt.expressions import Expression
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.jitter import resonance_quadrature
from fosopt.metrics.sampled_check import sampled_disagreement
from fosopt.modes import ModalFrame, ModalSet
from fosopt.ops import Array, ComplexArray
from fosopt.plant import coupled_matrices
from fosopt.problem import Constraint, Evaluation, Problem, Rows
from fosopt.problem.correction import as_model_sees
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
# Rounds of the search for multipliers; few are needed.
_ROUNDS = 100


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
        if report.slack < -FEASIBILITY * _size(constraint):
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
    column = system.inputs.index(disturbance.at)
    row = system.outputs.index("line_of_sight")
    b, c, d = system.b[:, [column]], system.c[[row]], system.d[row, column]
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
    return float((c @ covariance @ c.T)[0, 0])


def _by_dynamic_stiffness(truth: Evaluation, disturbance: Disturbance) -> float:
    """∫ S(f) |H|² df with H from (K + jωC − ω²M) u = f in physical coordinates, structure and mirror together."""
    low, high = disturbance.counted
    cuts = disturbance.cuts
    own = disturbance.filter.poles if disturbance.filter is not None else np.zeros(0, complex)
    nodes, weights = resonance_quadrature(np.concatenate([truth.poles.all, own]), low, high, cuts)
    response = _dense_responses(truth, nodes, disturbance.at)
    return float(np.sum(weights / (2 * np.pi) * disturbance.one_sided_psd(nodes) * np.abs(response) ** 2))


def _dense_responses(truth: Evaluation, frequencies: Array, at: str) -> ComplexArray:
    """(m,) Line-of-sight response to one input, by a dense solve at each frequency."""
    structure, frame, modes, loop = truth.system.structure, truth.frame, truth.all_modes, truth.design.loop
    stiff, heavy = _forces(truth)
    # Of a large structure the motions that its truncated basis spans, of others all.
    span = np.eye(len(structure.dofs)) if frame.outside is None else frame.shapes
    k, m = span.T @ stiff(span), span.T @ heavy(span)
    momentum = span.T @ heavy(frame.shapes)
    k = k + (momentum * np.where(modes.rigid, modes.stiffness, 0.0)) @ momentum.T
    c = (momentum * modes.damping) @ momentum.T
    port = truth.system.mirror_port
    rows = {name: structure.port(name) @ span for name in loop.ports(port)}
    whole = coupled_matrices((m, c, k), rows, port, loop.mirror, loop.placement, loop.actuators)
    size, n = whole.mass.shape[0], m.shape[0]
    loads = {"mirror_torque": np.eye(size)[whole.mirror], "hub_torque": np.zeros(size)}
    loads["hub_torque"][:n] = structure.port("hub") @ span
    response: ComplexArray = np.zeros(frequencies.size, dtype=complex)
    for i, w in enumerate(frequencies):
        s = 1j * w
        feedback = pid_response(loop.controller, s) * whole.control
        total = whole.stiffness + s * whole.damping + s**2 * whole.mass + np.outer(feedback, whole.sensor)
        # Whatever else is measured comes back as torque −K times it.
        response[i] = np.linalg.solve(total, loads.get(at, -feedback))[whole.mirror]
    return response + complex(at == "line_of_sight")


def _size(constraint: Constraint) -> float:
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
    weights, residual = _multipliers(matrix, gradient, at_upper, at_lower)
    multipliers: dict[str, float] = {}
    for i, sign, weight in zip(owner, signs, weights, strict=True):
        name = program.row_names[i]
        physical = float(-sign * weight * program.objective_slope(value) / program.row_scale[i])
        multipliers[name] = multipliers.get(name, 0.0) + physical
    for name in program.row_names:
        multipliers.setdefault(name, 0.0)
    return multipliers, float(np.abs(residual).max())


def _multipliers(
    matrix: Array, gradient: Array, at_upper: NDArray[np.bool_], at_lower: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Weights of active rows that leave least of the gradient, and what they leave, one multiplier per active bound.

    The multiplier of a bound takes what pushes its variable against it. Which bounds do follows from the weights of the
    few rows: a convex problem, solved by repeating the least squares over what no bound takes.
    """
    weights, residual = np.zeros(matrix.shape[1]), gradient

    def left(weights: Array) -> Array:
        rest = gradient + matrix @ weights
        return np.where((at_upper & (rest < 0)) | (at_lower & (rest > 0)), 0.0, rest)

    best = left(weights)
    taken = at_upper | at_lower
    for _ in range(_ROUNDS if matrix.shape[1] else 0):
        if taken.all():
            break
        found, _ = optimize.nnls(matrix[~taken], -gradient[~taken])
        residual = left(found)
        if np.linalg.norm(residual) <= np.linalg.norm(best):
            weights, best = found, residual
        now = (residual == 0) & (at_upper | at_lower)
        if np.array_equal(now, taken):
            break
        taken = now
    return weights, best
