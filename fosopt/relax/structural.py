"""What a co-design problem asks of its structure alone: the sizing behind it, at one of its designs.

Constraints that the loop has a part in, that bound a frequency from above or that are arithmetic on several metrics are
left out: the fewer requirements, the lower the least cost, so that a bound without them holds with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fosopt.errors import ModelError, did_you_mean
from fosopt.expressions import parse_expression
from fosopt.ops import Array
from fosopt.problem import Constraint, Evaluation, Problem
from fosopt.relax.arithmetic import Floating
from fosopt.relax.proof import quadratic
from fosopt.relax.sizing import AffineForm, Requirement, Sizing

# Metrics that are linear in areas, batten masses and springs.
LINEAR = ("structural_mass", "total_mass", "structure_inertia")
_UNITS = {
    "structural_mass": " kg",
    "total_mass": " kg",
    "structure_inertia": " kg m^2",
    "reference_inertia": " kg m^2",
    "first_elastic_frequency": " rad/s",
    "structure_frequency": " rad/s",
    "area": " m^2",
    "jitter_total": " rad",
}
# A design meets a requirement that it misses by this share of it: what solvers leave, and what a judge lets pass.
MISSED = 1e-6
# Requirements that are relaxed to what a design attains are relaxed by this more, for the rounding of that value.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Compliance:
    """A static compliance at a port of at most `upper` [rad/(N m)] or [m/N]; the hub is held still."""

    port: str
    upper: float


@dataclass(frozen=True)
class Receptance:
    """An undamped receptance at a port of at most `upper` at a frequency [rad/s] below the first; the hub is held."""

    port: str
    frequency: float
    upper: float


@dataclass(frozen=True)
class StructuralPart:
    """The sizing behind a problem.

    Attributes
    ----------
    sizing
        Over the structure's variables alone.
    positions
        (p,) where these stand among all variables.
    x
        (p,) their values at the design.
    value
        What the design costs.
    misses
        Requirements that the design misses, in words.
    kept, left_out
        Constraints that entered, and those that did not.
    """

    sizing: Sizing
    positions: NDArray[np.intp]
    x: Array
    value: float
    misses: tuple[str, ...]
    kept: tuple[str, ...]
    left_out: tuple[str, ...]


def structural_part(
    problem: Problem,
    constraints: Sequence[Constraint],
    x: Array,
    objective: str = "structural_mass",
    also: Sequence[Compliance | Receptance] = (),
    evaluation: Evaluation | None = None,
) -> StructuralPart:
    """Read what a problem asks of its structure.

    A requirement that the design at `x` misses by no more than solvers do is relaxed to what the design attains, so
    that a bound never passes the design it is compared with.

    Parameters
    ----------
    constraints
        What must be met; lower bounds on ``first_elastic_frequency`` (or the elastic ``structure_frequency`` of the
        lowest number) and on ``reference_inertia``, and any on the metrics in `LINEAR` or on the structure's variables
        enter.
    x
        (n,) values of all variables.
    objective
        One of `LINEAR`.
    also
        Requirements that are no metrics.
    evaluation
        Of the design at `x` on the truth model, where there is one already.

    Raises
    ------
    ModelError
        For an objective that is not linear, or an unknown port.
    """
    if objective not in LINEAR:
        raise ModelError(
            f"objective '{objective}' has no structural floor; {did_you_mean(objective, LINEAR)}"
        )
    reader = _Reader(problem, x, problem.evaluate(x, truth=True) if evaluation is None else evaluation)
    cost, constant, value = reader.linear(objective)
    own = {v.name: problem.slices()[v.name] for v in problem.variables if v.discipline == "structure"}
    frequency: tuple[float, str] | None = None
    for constraint in constraints:
        name, index = constraint.expression.reference or ("", None)
        said = _words(constraint.name, constraint.lower, constraint.upper)
        turned = reader.evaluation.frame.n_rigid
        if (name == "first_elastic_frequency" or (name, index) == ("structure_frequency", turned + 1)) and (
            constraint.lower > 0
        ):
            if frequency is None or constraint.lower > frequency[0]:
                frequency = constraint.lower, f"{constraint.name} >= {constraint.lower:.10g} rad/s"
            reader.kept(constraint, isfinite(constraint.upper))
        elif name == "reference_inertia" and constraint.lower > 0:
            reader.reference_inertia(constraint.lower, f"{constraint.name} >= {constraint.lower:.10g} kg m^2")
            reader.kept(constraint, isfinite(constraint.upper))
        elif name in LINEAR:
            gradient, offset, _ = reader.linear(name)
            # An upper limit on the objective itself would only say that the design must be lighter.
            own_limit = name == objective and isfinite(constraint.upper)
            reader.limit(gradient, offset, constraint.lower, inf if own_limit else constraint.upper, said)
            reader.kept(constraint, own_limit)
        elif name in own:
            position = own[name].start + (index or 1) - 1
            reader.limit(
                (reader.positions == position).astype(float), 0.0, constraint.lower, constraint.upper, said
            )
            reader.kept(constraint)
        else:
            reader.left_out.append(said)
    if frequency is not None:
        reader.frequency(*frequency)
    for requirement in also:
        reader.static(requirement)
    lower, upper = (bound[reader.positions] for bound in problem.bounds)
    if np.any((reader.x < lower) | (reader.x > upper)):
        reader.misses.append("the bounds of the variables")
    sizing = Sizing(
        reader.names,
        lower,
        upper,
        cost,
        constant,
        tuple(reader.requirements),
        np.array(reader.normals).reshape(len(reader.normals), cost.size),
        np.array(reader.limits),
        tuple(reader.limit_names),
    )
    return StructuralPart(
        sizing,
        reader.positions,
        x[reader.positions],
        value,
        tuple(reader.misses),
        (*reader.said, *(r.name for r in reader.requirements[len(reader.requirements) - len(also) :])),
        tuple(reader.left_out),
    )


def _words(name: str, lower: float, upper: float) -> str:
    unit = _UNITS.get(name.split("[")[0], "")
    low = f"{lower:.10g}{unit} <= " if isfinite(lower) else ""
    high = f" <= {upper:.10g}{unit}" if isfinite(upper) else ""
    return f"{low}{name}{high}"


def own_requirements(
    problem: Problem, x: Array, names: Sequence[str], evaluation: Evaluation | None = None
) -> tuple[Constraint, ...]:
    """Constraints that ask of other structures what the design at `x` has of each metric, as lower bounds.

    With these, `structure_floor` says how much lighter a structure that is as stiff as this one could be.
    """
    truth = problem.evaluate(x, truth=True) if evaluation is None else evaluation
    return tuple(Constraint(parse_expression(name), lower=truth.value(name)) for name in names)


def own_receptance(
    problem: Problem, x: Array, port: str, frequency: float, evaluation: Evaluation | None = None
) -> Receptance:
    """The undamped receptance at a port that the design at `x` has, as a requirement on other structures.

    Parameters
    ----------
    frequency
        Zero for the static compliance [rad/s].

    Raises
    ------
    ModelError
        If the frequency is not below the design's first, hub held, the port is unknown or it does not move.
    """
    reader = _Reader(problem, x, problem.evaluate(x, truth=True) if evaluation is None else evaluation)
    requirement = reader.at_port(Receptance(port, frequency, 1.0))
    # One less the share of the limit that is used up.
    attained = 1 - requirement.margin(reader.x)
    if not isfinite(attained):
        lowest = Requirement("", requirement.elastic, requirement.inertial, frequency)
        first = frequency * sqrt(1 + lowest.margin(reader.x))
        raise ModelError(
            f"receptance at {frequency:.6g} rad/s at port '{port}': not below {first:.6g} rad/s, the first frequency "
            "of this design with its hub held; lower it, or give zero for the static compliance"
        )
    return Receptance(port, frequency, attained)


class _Reader:
    """Collects requirements and linear limits over the structure's variables."""

    def __init__(self, problem: Problem, x: Array, evaluation: Evaluation) -> None:
        self.evaluation = evaluation
        own = np.concatenate(
            [np.full(v.size, v.discipline == "structure") for v in problem.variables] or [np.zeros(0, bool)]
        )
        self.positions = np.flatnonzero(own)
        self.x = x[self.positions]
        names = [f"{v.name}[{k + 1}]" for v in problem.variables for k in range(v.size)]
        self.names = tuple(names[i] for i in self.positions)
        self.structure = problem.system.structure
        self.mirror_port = problem.system.mirror_port
        members = self.structure.weight_gradients.shape[0]
        self.by_x = sparse.csr_array(problem.parameter_jacobian(x)[:members, self.positions])
        design = self.evaluation.design
        fixed = design.parameters[:members] - self.by_x @ self.x
        springs = self.structure.stiffness_rows.shape[0]
        constant = self.structure.weight_gradients.T @ fixed
        constant += np.concatenate(
            [
                self.structure.stiffness_constant,
                self.structure.mass_constant + self.structure.mass_by_mirror * design.mirror_mass,
            ]
        )
        slope = sparse.csr_array(self.structure.weight_gradients.T @ self.by_x)
        self.stiffness = AffineForm(self.structure.stiffness_rows, constant[:springs], slope[:springs])
        self.mass = AffineForm(self.structure.mass_rows, constant[springs:], slope[springs:])
        self.requirements: list[Requirement] = []
        self.normals: list[Array] = []
        self.limits: list[float] = []
        self.limit_names: list[str] = []
        self.misses: list[str] = []
        self.said: list[str] = []
        self.left_out: list[str] = []

    def kept(self, constraint: Constraint, half: bool = False) -> None:
        """Note a constraint, whose upper limit may have been left out."""
        if isfinite(constraint.lower) or not half:
            self.said.append(_words(constraint.name, constraint.lower, inf if half else constraint.upper))
        if half:
            self.left_out.append(_words(constraint.name, -inf, constraint.upper))

    def linear(self, name: str) -> tuple[Array, float, float]:
        """Gradient over the structure's variables, what is left where they are zero, and the value."""
        value, gradient = self.evaluation.metric(name)
        slope = self.by_x.T @ gradient[: self.by_x.shape[0]]
        return slope, float(value - slope @ self.x), value

    def limit(self, gradient: Array, offset: float, lower: float, upper: float, said: str) -> None:
        """Lower ≤ offset + gradient x ≤ upper."""
        for sign, bound in ((-1.0, lower), (1.0, upper)):
            if not isfinite(bound):
                continue
            normal, limit = sign * gradient, sign * (bound - offset)
            here = float(normal @ self.x)
            size = abs(bound) or 1.0
            if here - limit > MISSED * size:
                self.misses.append(said)
            self.normals.append(normal)
            self.limits.append(max(limit, here) if here - limit <= MISSED * size else limit)
            self.limit_names.append(said)

    def frequency(self, rate: float, said: str) -> None:
        """The first elastic frequency of at least `rate`."""
        frame, rigid = self.evaluation.frame, None
        if frame.n_rigid:
            rigid = frame.shapes[:, 0] / (self.structure.port("hub") @ frame.shapes[:, 0])
        requirement = Requirement(said, self.stiffness, self.mass, rate, rigid=rigid)
        shape = np.append(frame.shapes[:, frame.n_rigid], 0.0)[:, None]
        stiff = self._at(replace(requirement, rate=0.0), shape)
        weight = (stiff - self._at(requirement, shape)) / rate**2
        attained = sqrt(stiff / weight)
        relaxed = replace(requirement, rate=attained * (1 - _ROUNDING))
        self._add(requirement, relaxed, max(0.0, 1 - attained / rate))

    def reference_inertia(self, inertia: float, said: str) -> None:
        """1/J_ref = eᵀ M⁻¹ e at the mirror's port.    [Barker1991] Eq. (4.5)"""
        port = self.structure.port(self.mirror_port)
        self._loaded(Requirement(said, self.mass, load=port, limit=1 / inertia))

    def static(self, asked: Compliance | Receptance) -> None:
        """Take a compliance or receptance at a port."""
        self._loaded(self.at_port(asked))

    def at_port(self, asked: Compliance | Receptance) -> Requirement:
        """A compliance or receptance at a port, with the hub held still where it may turn."""
        rate = asked.frequency if isinstance(asked, Receptance) else 0.0
        what = f"receptance at {rate:.10g} rad/s" if rate else "compliance"
        load, stiffness, mass = self.structure.port(asked.port), self.stiffness, self.mass
        hub = ""
        if self.evaluation.frame.n_rigid:
            keep = np.flatnonzero(self.structure.port("hub") == 0)
            load, stiffness, mass = load[keep], stiffness.on(keep), mass.on(keep)
            hub = ", hub held"
        if not np.any(load):
            raise ModelError(f"{what} at port '{asked.port}': the port does not move; choose another")
        said = f"{what} at port '{asked.port}'{hub} <= {asked.upper:.10g}"
        return Requirement(said, stiffness, mass if rate else None, rate, load, asked.upper)

    def _loaded(self, requirement: Requirement) -> None:
        assert requirement.load is not None
        missed = max(0.0, -requirement.margin(self.x))
        relaxed = replace(requirement, limit=requirement.limit * (1 + missed) * (1 + _ROUNDING))
        self._add(requirement, relaxed, missed)

    def _add(self, requirement: Requirement, relaxed: Requirement, missed: float) -> None:
        """Take a requirement relaxed to what the design attains where it misses it by rounding only."""
        if missed > MISSED:
            self.misses.append(requirement.name)
        self.requirements.append(relaxed if 0 < missed <= MISSED else requirement)

    def _at(self, requirement: Requirement, vector: Array) -> float:
        constant, gradient = quadratic(requirement, vector, vector, Floating())
        return float(constant + gradient @ self.x)
