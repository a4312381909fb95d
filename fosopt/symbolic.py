"""Formulas as CasADi functions: values, exact derivatives and affine data, all derived from the one text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse

from fosopt.actuators import BICOLLOCATED, Mirror, MirrorReactionMass, Placement, ReactionMassActuator
from fosopt.control import (
    DIRECT,
    NUMERATORS,
    OTHER_AXIS,
    PID,
    Loop,
    Receptances,
    SignalPath,
    SteeredAxis,
    characteristic,
    closed_loop_response,
    loop_transfer,
    with_attachments,
)
from fosopt.errors import ModelError, did_you_mean
from fosopt.ops import Array, ComplexArray, ComplexPair
from fosopt.structure import Structure, mass_matrix, stiffness_matrix, structural_mass, structure_inertia

# Order of the parameters of a loop in every vector below; units in `actuators.Mirror` and `control.PID`.
LOOP_PARAMETERS = (
    "mirror_inertia",
    "mirror_frequency",
    "mirror_damping_ratio",
    "gain",
    "kp",
    "ki",
    "kd",
    "rolloff_time",
)


# Of so many variables a Jacobian is mostly zeros.
LARGE_JACOBIAN = 500


@dataclass(frozen=True)
class Layout:
    """What of a loop is no parameter: where it acts, what else is on the structure, filters and sampling."""

    placement: Placement = BICOLLOCATED
    actuators: tuple[ReactionMassActuator, ...] = ()
    reaction_mass: MirrorReactionMass | None = None
    path: SignalPath = DIRECT
    hub: str = "hub"
    beside: BesideLayout | None = None

    @property
    def size(self) -> int:
        """Number of parameters, those of `LOOP_PARAMETERS` for each axis."""
        return len(LOOP_PARAMETERS) * (1 if self.beside is None else 2)


@dataclass(frozen=True)
class BesideLayout:
    """The same of a mirror's other axis."""

    port: str
    hub: str | None
    path: SignalPath


def layout_of(loop: Loop) -> Layout:
    """The layout of a loop."""
    other = loop.beside
    beside = None if other is None else BesideLayout(other.port, other.hub, other.controller.path)
    counter, path = loop.mirror.reaction_mass, loop.controller.path
    return Layout(loop.placement, loop.actuators, counter, path, loop.hub, beside)


_MIRROR_ALONE = Layout()


def loop_of(parameters: Any, layout: Layout = _MIRROR_ALONE) -> Loop:
    """A loop from its parameters, `LOOP_PARAMETERS` of the first and then of a second axis, and its layout."""
    mirror, controller = _axis_of(parameters, 0, layout.path, layout.reaction_mass)
    beside = None
    if layout.beside is not None:
        other = _axis_of(parameters, len(LOOP_PARAMETERS), layout.beside.path)
        beside = SteeredAxis(layout.beside.port, *other, layout.beside.hub)
    return Loop(mirror, controller, layout.placement, layout.actuators, beside, layout.hub)


def _axis_of(
    parameters: Any, first: int, path: SignalPath, counter: MirrorReactionMass | None = None
) -> tuple[Mirror, PID]:
    j, w, z, gain, kp, ki, kd, time = (parameters[first + i] for i in range(len(LOOP_PARAMETERS)))
    return Mirror(j, w, z, counter), PID(gain, kp, ki, kd, time, path)


def loop_parameters(loop: Loop) -> Array:
    """(8,) Parameters of a numerical loop in the order of `LOOP_PARAMETERS`, of one with a second axis (16,)."""
    axes = [(loop.mirror, loop.controller)]
    if loop.beside is not None:
        axes.append((loop.beside.mirror, loop.beside.controller))
    return np.array(
        [
            value
            for m, c in axes
            for value in (
                m.inertia,
                m.natural_frequency,
                m.damping_ratio,
                c.gain,
                c.kp,
                c.ki,
                c.kd,
                c.rolloff_time,
            )
        ],
        dtype=float,
    )


def _formula(response: str) -> Callable[[Loop, Any, Receptances], Any]:
    if response in NUMERATORS or response in OTHER_AXIS:
        return lambda loop, s, g: closed_loop_response(response, loop, s, g)
    others = {"characteristic": characteristic, "loop_transfer": loop_transfer}
    if response not in others:
        known = [*NUMERATORS, *OTHER_AXIS, *others]
        raise ModelError(f"transfer function '{response}' does not exist; {did_you_mean(response, known)}")
    return others[response]


@cache
def response_function(response: str, layout: Layout = _MIRROR_ALONE) -> ca.Function:
    """A transfer function of the loop as a CasADi function.

    Inputs are the (8,) `LOOP_PARAMETERS`, of two axes (16,), and the real and imaginary parts of s and of the
    receptances of the structure alone, one after another in the order of `control.Loop.pairs`: (6,) with g_rr and
    g_ro for a bicollocated mirror alone. The output is (2,), real and imaginary part. `response` is a name in
    `control.NUMERATORS` or `control.OTHER_AXIS`, ``characteristic`` or ``loop_transfer``.

    Raises
    ------
    ModelError
        For an unknown name.
    """
    p = ca.SX.sym("p", layout.size)
    loop = loop_of(p, layout)
    z = ca.SX.sym("z", 2 + 2 * len(loop.pairs))
    s, *pairs = (ComplexPair(z[i], z[i + 1]) for i in range(0, z.numel(), 2))
    g = with_attachments(loop, s, Receptances.of(pairs))
    value = _formula(response)(loop, s, g)
    return ca.Function(
        response,
        [p, z],
        [ca.vertcat(value.re, value.im)],
        ["parameters", "point"],
        ["value"],
    )


@lru_cache(maxsize=64)
def _differential(responses: tuple[str, ...], layout: Layout, count: int) -> ca.Function:
    first = response_function(responses[0], layout)
    p, z = ca.SX.sym("p", first.size1_in(0)), ca.SX.sym("z", first.size1_in(1))
    w = ca.SX.sym("w", 2 * len(responses))
    values = [response_function(name, layout)(p, z) for name in responses]
    total = sum(w[2 * k] * v[0] - w[2 * k + 1] * v[1] for k, v in enumerate(values))
    gradient = ca.cse(ca.densify(ca.gradient(total, ca.vertcat(z[2:], p))))
    single = ca.Function("differential", [p, z, w], [gradient])
    return single.map(f"differential_{count}", "serial", count, [0], [])


@dataclass(frozen=True)
class LoopDifferential:
    """The differential of Re Σ_ri w_ri R_r(s_i) over transfer functions R_r of a loop and (m,) points.

    Attributes
    ----------
    receptances
        (q, m) complex c, for Re Σ_i c_i dg(s_i), for those of the structure alone, in the order of
        `control.Loop.pairs`.
    parameters
        (8,) derivatives for the `LOOP_PARAMETERS`, of a loop with a second axis (16,).
    """

    receptances: ComplexArray
    parameters: Array


def loop_differential(
    weights: Mapping[str, ComplexArray], loop: Loop, s: ComplexArray, bare: Receptances
) -> LoopDifferential:
    """How Re Σ_ri w_ri R_r(s_i) follows the structure and the parameters of the loop, exact.

    Parameters
    ----------
    weights
        (m,) w of each transfer function, by the names `response_function` takes.
    bare
        Receptances of the structure alone, (m,) each.
    """
    count, q = s.size, len(bare.values)
    point = np.stack([s, *bare.values], axis=1).astype(complex, copy=False).view(float)
    weight = np.stack(list(weights.values()), axis=1).astype(complex, copy=False).view(float)
    function = _differential(tuple(weights), layout_of(loop), count)
    (flat,) = _call(function, loop_parameters(loop), point, weight)
    rows = flat.reshape(count, -1)
    # Analytic in g, so the derivatives for the two parts of g are those of one complex number.
    by_g = rows[:, 0 : 2 * q : 2] - 1j * rows[:, 1 : 2 * q : 2]
    return LoopDifferential(by_g.T, rows[:, 2 * q :].sum(axis=0))


def _call(function: ca.Function, *arguments: Array) -> list[Array]:
    """Dense outputs of a function, each flat and column by column, as its arguments are expected.

    Goes through memory both sides share: converting matrices takes several times longer than evaluating them.
    """
    buffer: Any
    buffer, run = function.buffer()
    shared = [np.ascontiguousarray(argument).reshape(-1) for argument in arguments]
    results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    for i, memory in enumerate(shared):
        buffer.set_arg(i, memory.data)
    for i, memory in enumerate(results):
        buffer.set_res(i, memory.data)
    run()
    return results


class Differentiable:
    """A vector formula of one vector with its exact Jacobian, for numbers.

    Parameters
    ----------
    formula
        Takes an (n,) vector, numbers or symbols, and gives an (m,) vector.
    size
        n; from `LARGE_JACOBIAN` on the Jacobian is sparse.
    """

    def __init__(self, formula: Callable[[Any], Any], size: int) -> None:
        x = ca.SX.sym("x", size)
        value = ca.densify(ca.SX(formula(x)))
        jacobian = ca.jacobian(value, x)
        if size < LARGE_JACOBIAN:
            jacobian = ca.densify(jacobian)
        self._pattern = jacobian.sparsity()
        self._places = (np.array(self._pattern.row()), np.array(self._pattern.colind()))
        self._function = ca.Function("f", [x], [value, jacobian])

    def __call__(self, x: Array) -> tuple[Array, Array | sparse.csc_array]:
        """(m,) values and (m, n) Jacobian at (n,) `x`."""
        value, jacobian = _call(self._function, x)
        if self._pattern.is_dense():
            return value, jacobian.reshape(x.size, value.size).T
        return value, sparse.csc_array((jacobian, *self._places), shape=self._pattern.shape)


class OracleFunction(ca.Callback):
    """A vector function computed outside CasADi, with its exact Jacobian, as a CasADi function.

    Keep a reference to it for as long as a function made from it is in use.

    Parameters
    ----------
    name
        Name of the function.
    evaluate
        Takes an (n,) vector and gives (m,) values and the (m, n) Jacobian.
    size, count
        n and m.
    """

    def __init__(
        self, name: str, evaluate: Callable[[Array], tuple[Array, Array]], size: int, count: int
    ) -> None:
        ca.Callback.__init__(self)
        self._evaluate, self._size, self._count = evaluate, size, count
        self._parts: list[ca.Callback] = []
        self.construct(name, {})

    def get_n_in(self) -> int:
        """One input, the vector of variables."""
        return 1

    def get_n_out(self) -> int:
        """One output, the vector of values."""
        return 1

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        """Dense (n,)."""
        return ca.Sparsity.dense(self._size)

    def get_sparsity_out(self, index: int) -> ca.Sparsity:
        """Dense (m,)."""
        return ca.Sparsity.dense(self._count)

    def eval(self, arguments: Sequence[ca.DM]) -> list[Array]:
        """Values at one point."""
        return [self._evaluate(arguments[0].full().ravel())[0]]

    def has_jacobian(self) -> bool:
        """The Jacobian is exact."""
        return True

    def get_jacobian(
        self, name: str, inames: Sequence[str], onames: Sequence[str], opts: Mapping[str, Any]
    ) -> ca.Function:
        """The Jacobian, asked from the same oracle."""
        jacobian = _OracleJacobian(name, self._evaluate, self._size, self._count)
        self._parts.append(jacobian)
        return jacobian


class _OracleJacobian(ca.Callback):
    def __init__(
        self, name: str, evaluate: Callable[[Array], tuple[Array, Array]], size: int, count: int
    ) -> None:
        ca.Callback.__init__(self)
        self._evaluate, self._size, self._count = evaluate, size, count
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._size if index == 0 else self._count)

    def get_sparsity_out(self, index: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._count, self._size)

    def eval(self, arguments: Sequence[ca.DM]) -> list[Array]:
        return [self._evaluate(arguments[0].full().ravel())[1]]


@dataclass(frozen=True)
class StructureFunctions:
    """Mass, stiffness and inertia of a structure as CasADi functions of its parameters and the mirror's mass.

    These are (area, batten_mass, spring_stiffness, mirror_mass), in this order.
    """

    stiffness_matrix: ca.Function
    mass_matrix: ca.Function
    structural_mass: ca.Function
    structure_inertia: ca.Function


def structure_functions(structure: Structure) -> StructureFunctions:
    """CasADi functions of a structure; K and M are affine, so their Jacobians are constant."""
    area = ca.SX.sym("area", len(structure.truss.bars))
    batten_mass = ca.SX.sym("batten_mass", len(structure.truss.battens))
    spring_stiffness = ca.SX.sym("spring_stiffness", len(structure.truss.springs))
    mirror_mass = ca.SX.sym("mirror_mass")
    inputs = [area, batten_mass, spring_stiffness, mirror_mass]
    names = ["area", "batten_mass", "spring_stiffness", "mirror_mass"]

    def function(name: str, expression: Any) -> ca.Function:
        return ca.Function(name, inputs, [expression], names, [name])

    return StructureFunctions(
        function("stiffness_matrix", stiffness_matrix(structure, area, spring_stiffness)),
        function("mass_matrix", mass_matrix(structure, area, batten_mass, mirror_mass)),
        function("structural_mass", structural_mass(structure, area, batten_mass)),
        function("structure_inertia", structure_inertia(structure, area, batten_mass)),
    )
