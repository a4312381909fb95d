"""What a loop sees of all structures in a box, in the right half plane.

At s = c = |c| e^{jθ}, |θ| < π/2, the dynamic stiffness D = K + c² M + c C of a structure satisfies

    Re e^{-jθ} u* D u ≥ cos θ u* N u,     N = K + |c|² M,

however lightly it is damped: resonances are far. K and M grow with every parameter, and so does C = 2 ζ M # K, the
damping matrix of uniform modal damping, a geometric mean of two matrices [Bhatia2007]. With y = D⁻¹ e in the middle of
the box, D(x) = D + Δ elsewhere and N₀ = N at its lowest corner, a receptance is

    e_pᵀ D(x)⁻¹ e_q = e_pᵀ y_q − y_pᵀ Δ y_q + ε,     |ε| ≤ ‖Δ y_p‖ ‖Δ y_q‖/cos θ     in the norm of N₀⁻¹,

linear in the parameters but for ε and what their change does to C.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, log, sqrt

import numpy as np
from scipy import linalg, sparse

from fosopt.actuators import Mirror
from fosopt.errors import ModelError
from fosopt.expressions import parse_expression
from fosopt.modes import Hub
from fosopt.ops import Array, ComplexArray
from fosopt.problem import Constraint, Evaluation, Problem
from fosopt.relax.joint_arithmetic import Affine
from fosopt.relax.sizing import AffineForm, Requirement, Sizing
from fosopt.relax.structural import StructuralPart, structural_part
from fosopt.structure import Chain, assemble_chain
from fosopt.symbolic import LOOP_PARAMETERS

# A cross receptance is a difference of two of sums and differences of loads, which may be scaled.
_BALANCES = (0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0)
_FREQUENCY, _MASS = "first_elastic_frequency", "structural_mass"


@dataclass(frozen=True)
class StructureFamily:
    """All structures with parameters in a box, and the mirror on them.

    Attributes
    ----------
    sizing
        The box, what a structure costs and the linear limits it keeps.
    stiffness, mass
        K and M, which grow with every parameter.
    loads
        Rows (n,) that read the mirror's port and the hub.
    rigid
        (n,) Rotation as a rigid body about the hub, None where the structure cannot turn.
    hub
        How that rotation is held.
    damping_ratio
        ζ of all elastic modes [-].
    mirror
        At some structure of the family.
    inertia, inertia_slope
        Its inertia is J_m = inertia + slopeᵀ x [kg m²].
    most
        Limit on the cost.
    slowest
        Required of the first elastic frequency [rad/s].
    """

    sizing: Sizing
    stiffness: AffineForm
    mass: AffineForm
    loads: tuple[Array, Array]
    rigid: Array | None
    hub: Hub
    damping_ratio: float
    mirror: Mirror
    inertia: float
    inertia_slope: Array
    most: float = inf
    slowest: float = 0.0

    def __post_init__(self) -> None:
        for name, low, high in zip(self.sizing.names, self.sizing.lower, self.sizing.upper, strict=True):
            if not (low > 0 and isfinite(high)):
                raise ModelError(
                    f"'{name}' from {low:g} to {high:g}: the joint bound needs a box above zero; set both bounds"
                )
        for what, form in (("stiffness", self.stiffness), ("mass", self.mass)):
            if np.any(form.constant < 0) or np.any(form.slope.data < 0):
                raise ModelError(f"the {what} falls with a parameter; the joint bound needs one that grows")

    def possible(self, low: Array, high: Array) -> bool:
        """Whether a structure between two corners may keep the limits; never false where one does."""
        sizing = self.sizing
        cost = sizing.cost_constant + np.minimum(sizing.cost * low, sizing.cost * high).sum()
        rows = np.minimum(sizing.normals * low, sizing.normals * high).sum(axis=1)
        if cost > self.most * (1 + 1e-12) or np.any(rows > sizing.limits + 1e-12 * np.abs(sizing.limits)):
            return False
        if not self.slowest:
            return True
        # Stiffest and lightest corner.
        first = 0 if self.rigid is None else 1
        pencil = self.stiffness.matrix(high), self.mass.matrix(low)
        squares = linalg.eigh(*pencil, eigvals_only=True, subset_by_index=[first, first])
        return bool(squares[0] >= self.slowest**2 * (1 - 1e-9))

    def receptances(self, low: Array, high: Array, c: ComplexArray) -> tuple[Affine, Affine]:
        """Receptances at (m,) points in the right half plane, mirror to itself and hub to mirror, over a box."""
        x, half = 0.5 * (low + high), 0.5 * (high - low)
        share = float(np.max(half / x, initial=0.0))
        squares, shapes = self._modes(x)
        soft, soft_shapes = self._modes(low)
        slant = c.real / np.abs(c)
        inner = 1 / np.sqrt(soft[:, None] + np.abs(c) ** 2)

        def norm(force: ComplexArray) -> Array:
            return np.asarray(np.linalg.norm((soft_shapes.T @ force) * inner, axis=0))

        damping = 2 * self.damping_ratio * np.sqrt(squares)
        modal = [
            (shapes.T @ load)[:, None] / (squares[:, None] + c**2 + damping[:, None] * c)
            for load in self.loads
        ]
        stretch = [self.stiffness.rows @ (shapes @ amplitude) for amplitude in modal]
        speed = [self.mass.rows @ (shapes @ amplitude) for amplitude in modal]
        # √(|c| y* C y), and what it allows the change of c C y to be.
        dissipated = [np.sqrt(np.abs(c) * (damping @ np.abs(amplitude) ** 2)) for amplitude in modal]
        by_damping = share * sqrt(self.damping_ratio / (1 - share))
        changed, wrong = [], []
        for k, load in enumerate(self.loads):
            change = by_damping * dissipated[k]
            for i, h in enumerate(half):
                by_stiffness = self.stiffness.slope[:, [i]].toarray() * stretch[k]
                by_mass = self.mass.slope[:, [i]].toarray() * speed[k] * c**2
                change = change + h * norm(self.stiffness.rows.T @ by_stiffness + self.mass.rows.T @ by_mass)
            changed.append(change)
            balance = self.stiffness.rows.T @ (self.stiffness.weights(x)[:, None] * stretch[k])
            moved = speed[k] * c**2 + self.mass.rows @ (shapes @ (damping[:, None] * modal[k])) * c
            balance = balance + self.mass.rows.T @ (self.mass.weights(x)[:, None] * moved)
            wrong.append(norm(load[:, None] - balance))
        size = norm(self.loads[0][:, None] * np.ones_like(c))
        found = []
        for q in (0, 1):
            slope = self.stiffness.slope.T @ (stretch[0] * stretch[q])
            slope = slope + (self.mass.slope.T @ (speed[0] * speed[q])) * c**2
            radius = (
                share * dissipated[0] * dissipated[q] + (changed[0] * changed[q] + size * wrong[q]) / slant
            )
            value = self.loads[0] @ (shapes @ modal[q])
            found.append(Affine(value, -(slope * half[:, None]).T, radius))
        if self.rigid is not None and self.hub.type == "held":
            change = self._held(x, half, c)
            turns = [float(load @ self.rigid) for load in self.loads]
            found = [g + change * (turns[0] * turn) for g, turn in zip(found, turns, strict=True)]
        return found[0], found[1]

    def responses(self, low: Array, high: Array, c: ComplexArray) -> dict[str, Affine]:
        """log|H| over a box, H from a torque on mirror or hub to the mirror's angle without control."""
        g, cross = self.receptances(low, high, c)
        x, half = 0.5 * (low + high), 0.5 * (high - low)
        inertia = _same(self.inertia + float(self.inertia_slope @ x), self.inertia_slope * half, c)
        rate = float(self.mirror.natural_frequency)
        spring = rate**2 + 2 * float(self.mirror.damping_ratio) * rate * c  # κ/J_m
        scaled = inertia * g
        below = (scaled * c**2 + (1 + c**2 / spring)).log_magnitude() * -1.0
        return {
            "mirror_torque": (scaled + 1 / spring).log_magnitude() + inertia.log_magnitude() * -1.0 + below,
            "hub_torque": cross.log_magnitude() + below,
        }

    def lowest(self, low: Array, high: Array, c: ComplexArray) -> dict[str, Array]:
        """(m,) Lower bounds on log|H| over a box of any size at the real ones of the points, −inf at the others.

        At s = c > 0 dynamic stiffness grows with every parameter. That of a hub that is held is no form of K and M, but
        lies between A/(1 + β/(ω₁² + c²)) and (1 + ζ) A, A = K + (c² + β) M, β being what holds the rigid body.
        """
        real = np.flatnonzero(c.imag == 0)
        found = {name: np.full(c.size, -inf) for name in ("mirror_torque", "hub_torque")}
        held = self.hub.type == "held" and self.rigid is not None
        hub = self.hub if held else Hub("free")
        first = self._slowest(low, high) if held else 0.0
        stiff, soft = self._modes(high), self._modes(low)
        rate = float(self.mirror.natural_frequency)
        heavy = self.inertia + float(self.inertia_slope @ high)
        for k in real:
            a = float(c[k].real)
            beta = hub.bandwidth**2 + 2 * hub.damping_ratio * hub.bandwidth * a
            square = a * a + beta

            def least(load: Array, square: float = square) -> float:
                return _form(stiff, load, square) / (1 + self.damping_ratio)

            def most(load: Array, square: float = square, room: float = 1 + beta / (first + a * a)) -> float:
                return _form(soft, load, square) * room

            spring = 1 / (rate**2 + 2 * float(self.mirror.damping_ratio) * rate * a)
            mirror, turned = self.loads
            through = spring + heavy * least(mirror)
            found["mirror_torque"][k] = log(through / (heavy * (1 + a * a * through)))
            cross = max(
                0.25 * (least(r * mirror + turned / r) - most(r * mirror - turned / r)) for r in _BALANCES
            )
            if cross > 0:
                found["hub_torque"][k] = log(cross / (1 + a * a * (spring + heavy * most(mirror))))
        return found

    def _slowest(self, low: Array, high: Array) -> float:
        """Square of a frequency below the first elastic one of every structure between two corners."""
        pencil = self.stiffness.matrix(low), self.mass.matrix(high)
        return float(linalg.eigh(*pencil, eigvals_only=True, subset_by_index=[1, 1])[0])

    def _modes(self, x: Array) -> tuple[Array, Array]:
        """Squares of all frequencies, a rigid body's exactly zero, and mass-normalized mode shapes."""
        squares, shapes = linalg.eigh(self.stiffness.matrix(x), self.mass.matrix(x))
        squares = np.maximum(squares, 0.0)
        if self.rigid is not None:
            squares[0] = 0.0
        return squares, shapes

    def _held(self, x: Array, half: Array, c: ComplexArray) -> Affine:
        """What holding the hub changes about the receptance of the rigid body, per turns of two ports."""
        assert self.rigid is not None
        arms2 = (self.mass.rows @ self.rigid) ** 2
        inertia = _same(float(arms2 @ self.mass.weights(x)), (self.mass.slope.T @ arms2) * half, c)
        held = c**2 + 2 * self.hub.damping_ratio * self.hub.bandwidth * c + self.hub.bandwidth**2
        return inertia.reciprocal() * (1 / held - 1 / c**2)


def _form(modes: tuple[Array, Array], load: Array, square: float) -> float:
    """Load (K + square M)⁻¹ load of a structure."""
    squares, shapes = modes
    return float(((shapes.T @ load) ** 2 / (squares + square)).sum())


def _same(value: float, slope: Array, c: ComplexArray) -> Affine:
    """A number that is the same at all points."""
    return Affine(
        np.full(c.size, value, complex), np.tile(slope.astype(complex), (c.size, 1)), np.zeros(c.size)
    )


def structure_family(
    problem: Problem, x: Array, constraints: tuple[Constraint, ...], truth: Evaluation
) -> tuple[StructureFamily, StructuralPart]:
    """The structures a problem's variables span, and what was read of the problem.

    Raises
    ------
    ModelError
        If the mirror is a variable, something else is attached to the structure, the sensor is elsewhere than on the
        mirror or the damping is not one ratio for all modes.
    """
    loop = truth.design.loop
    if any(v.quantity.startswith("mirror") for v in problem.variables):
        raise ModelError("the joint bound is for a given mirror; fix the mirror's inertia and frequency")
    if not loop.bare or loop.placement.sensor is not None:
        raise ModelError(
            "the joint bound is for a mirror alone with its sensor on it; remove other actuators"
        )
    if len(problem.system.damping.ratio) != 1:
        raise ModelError("the joint bound needs one damping ratio for all modes; give a uniform one")
    asked = tuple(c for c in constraints if c.name == _FREQUENCY and c.lower > 0)
    others = tuple(c for c in constraints if c not in asked and c.name != _MASS)
    least = asked or (Constraint(parse_expression(_FREQUENCY), lower=truth.value(_FREQUENCY)),)
    part = structural_part(problem, (*others, *least), x, _MASS, evaluation=truth)
    frequency: Requirement = next(r for r in part.sizing.requirements if r.load is None)
    assert frequency.inertial is not None
    row = truth.design.parameters.size - len(LOOP_PARAMETERS)
    slope = sparse.csr_array(problem.parameter_jacobian(x))[[row]][:, part.positions].toarray()[0]
    mass = [c.upper for c in constraints if c.name == _MASS]
    family = StructureFamily(
        part.sizing,
        frequency.elastic,
        frequency.inertial,
        (problem.system.structure.port(problem.system.mirror_port), problem.system.structure.port("hub")),
        frequency.rigid,
        problem.system.hub,
        problem.system.damping.ratio[0],
        loop.mirror,
        float(loop.mirror.inertia - slope @ part.x),
        slope,
        min(mass, default=inf),
        frequency.rate if asked else 0.0,
    )
    return family, part


def chain_family(
    chain: Chain, lower: Array, upper: Array, mirror: Mirror, damping_ratio: float, port: str = "tip"
) -> StructureFamily:
    """All chains whose springs lie between (k,) `lower` and `upper` stiffnesses [N m/rad], with a mirror on a port."""
    of = assemble_chain(chain, port)
    springs, n = of.stiffness_rows.shape
    names = tuple(f"spring[{k + 1}]" for k in range(springs))
    none = np.zeros(springs)
    return StructureFamily(
        Sizing(names, lower, upper, none, 0.0),
        AffineForm(of.stiffness_rows, none, sparse.eye_array(springs, format="csr")),
        AffineForm(of.mass_rows, of.mass_constant, sparse.csr_array((of.mass_constant.size, springs))),
        (of.port(port), of.port("hub")),
        None if chain.held else np.ones(n),
        Hub("fixed" if chain.held else "free"),
        damping_ratio,
        mirror,
        float(mirror.inertia),
        none,
    )
