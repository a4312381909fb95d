"""IPOPT on a scaled nonlinear program [Wachter2006], through CasADi [Andersson2019]."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np

from fosopt.ops import Array
from fosopt.solve.nlp import Program
from fosopt.symbolic import OracleFunction

Status = Literal["optimal", "infeasible", "failed", "interrupted"]


# With IPOPT's own six updates, or with twenty, some points of a front of the dissertation's truss stalled.
_MEMORY = 50
# From the usual barrier and distance to the bounds IPOPT leaves an optimum it starts at, and may end at another one.
_NEAR: dict[str, Any] = {
    "mu_init": 1e-6,
    "bound_push": 1e-8,
    "bound_frac": 1e-8,
    "bound_mult_init_method": "mu-based",
}


def never() -> bool:
    """Never stop."""
    return False


def never_enough(x: Array) -> bool:
    """No point is good enough before the optimum."""
    return False


@dataclass(frozen=True)
class Options:
    """What a user may set.

    Attributes
    ----------
    tolerance
        Scaled optimality tolerance.
    max_iterations, time_limit
        Per solve; [s].
    near
        Whether the start is close to an optimum, which is to be found again and not another one.
    """

    tolerance: float = 1e-6
    max_iterations: int = 300
    time_limit: float = 120.0
    near: bool = False


@dataclass(frozen=True)
class Solution:
    """Outcome of one optimization, as the solver sees it; `certify` judges it.

    Attributes
    ----------
    x
        (n,) values of all variables.
    status, reason
        Outcome, and what to do where it is not ``optimal``.
    objective
        Value of what was minimized, SI units.
    multipliers
        (m,) per row of the program, in units of the objective per unit of the row.
    row_names
        (m,) constraint of each row.
    iterations, seconds
        Effort.
    history
        Iteration, objective, infeasibility.
    """

    x: Array
    status: Status
    reason: str | None
    objective: float
    multipliers: Array
    row_names: tuple[str, ...]
    iterations: int
    seconds: float
    history: tuple[tuple[int, float, float], ...]


_STATUS: dict[str, tuple[Status, str | None]] = {
    "Solve_Succeeded": ("optimal", None),
    "Solved_To_Acceptable_Level": ("optimal", None),
    "Feasible_Point_Found": ("optimal", None),
    "Infeasible_Problem_Detected": (
        "infeasible",
        "no design meets all constraints near here; relax one of them",
    ),
    "Maximum_Iterations_Exceeded": ("failed", "iteration limit reached; raise solve.max_iterations"),
    "Maximum_WallTime_Exceeded": ("failed", "time limit reached; raise solve.time_limit"),
    "Maximum_CpuTime_Exceeded": ("failed", "time limit reached; raise solve.time_limit"),
    "Restoration_Failed": (
        "infeasible",
        "the solver could not restore feasibility; relax a constraint or start elsewhere",
    ),
    "Search_Direction_Becomes_Too_Small": (
        "failed",
        "the step became too small; the problem may be badly posed here",
    ),
    "Invalid_Number_Detected": ("failed", "the start has no metrics; start from a stable design"),
    "User_Requested_Stop": ("interrupted", "stopped by the user"),
}


def solve(
    program: Program,
    options: Options,
    stop: Callable[[], bool] = never,
    good_enough: Callable[[Array], bool] = never_enough,
) -> Solution:
    """Find a local optimum of a program from its start, at which all its metrics must exist.

    Parameters
    ----------
    options
        Limits and tolerance.
    stop
        Asked at every iteration; true ends the solve with what it has.
    good_enough
        Asked at every iteration with the values of all variables; true ends the solve as converged.
    """
    begin = time.perf_counter()
    bridge = _Bridge(program)
    watch = _Watch(program, stop, good_enough)
    solver = ca.nlpsol(
        "solver",
        "ipopt",
        bridge.nlp,
        {
            "grad_f": bridge.objective_gradient,
            "jac_g": bridge.row_jacobian,
            "iteration_callback": watch,
            "print_time": False,
            "show_eval_warnings": False,
            "calc_lam_p": False,
            "calc_lam_x": False,
            "calc_f": False,
            "calc_g": False,
            "error_on_fail": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "hessian_approximation": "limited-memory",
                "limited_memory_max_history": _MEMORY,
                # One system with the updates as rows of their own: fewer back substitutions than one per update.
                "limited_memory_aug_solver": "extended",
                "tol": options.tolerance,
                "acceptable_iter": 8,
                "acceptable_tol": 20 * options.tolerance,
                "acceptable_constr_viol_tol": options.tolerance,
                "acceptable_obj_change_tol": options.tolerance,
                "max_iter": options.max_iterations,
                "max_wall_time": options.time_limit,
                # A relaxed bound would let the objective fall below the true optimum.
                "bound_relax_factor": 0.0,
                "nlp_scaling_method": "none",
                **(_NEAR if options.near else dict[str, Any]()),
            },
        },
    )
    answer = solver(
        x0=program.scaled(program.start),
        lbx=program.lower,
        ubx=program.upper,
        lbg=program.row_lower,
        ubg=program.row_upper,
    )
    statistics = solver.stats()
    status, reason = _STATUS.get(
        statistics["return_status"], ("failed", f"solver stopped: {statistics['return_status']}")
    )
    if watch.converged:
        status, reason = "optimal", None
    z = answer["x"].full().ravel()
    found = program(z)
    value = program.objective(found[0]) if found is not None else float("nan")
    slope = program.objective_slope(found[0]) if found is not None else float("nan")
    multipliers = answer["lam_g"].full().ravel() * slope / program.row_scale
    return Solution(
        program.unscaled(z),
        status,
        reason,
        value,
        multipliers,
        program.row_names,
        int(statistics["iter_count"]),
        time.perf_counter() - begin,
        tuple(watch.history),
    )


class _Bridge:
    """The program as the functions IPOPT calls, all answered by one cached evaluation."""

    def __init__(self, program: Program) -> None:
        n, m = program.lower.size, program.row_lower.size
        missing = (float("nan"), np.full(n, np.nan), np.full(m, np.nan), np.full((m, n), np.nan))

        def at(z: Array) -> tuple[float, Array, Array, Array]:
            return program(z) or missing

        dense = ca.Sparsity.dense
        shapes = {"f": dense(1), "grad": dense(n), "g": dense(m), "jac": dense(m, n)}

        def stacked(z: Array) -> tuple[Array, Array]:
            value, gradient, rows, jacobian = at(z)
            return np.concatenate([[value], rows]), np.vstack([gradient, jacobian])

        self._all = OracleFunction("rows", stacked, n, m + 1)
        z = ca.MX.sym("z", n)
        everything = self._all(z)
        self.nlp = {"x": z, "f": everything[0], "g": everything[1:]}
        # Without these two IPOPT would go through a product with the full Jacobian for each of them.
        self.objective_gradient = _Answer(
            "nlp_grad_f", n, [shapes["f"], shapes["grad"]], lambda z: list(at(z)[:2])
        )
        self.row_jacobian = _Answer("nlp_jac_g", n, [shapes["g"], shapes["jac"]], lambda z: list(at(z)[2:]))


class _Answer(ca.Callback):
    def __init__(
        self,
        name: str,
        size: int,
        outputs: list[ca.Sparsity],
        answer: Callable[[Array], list[Any]],
    ) -> None:
        ca.Callback.__init__(self)
        self._size, self._outputs, self._answer = size, outputs, answer
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._size) if index == 0 else ca.Sparsity(0, 0)

    def get_sparsity_out(self, index: int) -> ca.Sparsity:
        return self._outputs[index]

    def eval(self, arguments: Sequence[ca.DM]) -> list[Any]:
        return self._answer(arguments[0].full().ravel())


class _Watch(ca.Callback):
    """Records the convergence history and ends the solve when asked."""

    def __init__(
        self,
        program: Program,
        stop: Callable[[], bool],
        good_enough: Callable[[Array], bool],
    ) -> None:
        ca.Callback.__init__(self)
        self._program, self._stop, self._good_enough = program, stop, good_enough
        self.history: list[tuple[int, float, float]] = []
        self.converged = False
        self.construct("watch", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, index: int) -> str:
        return str(ca.nlpsol_out(index))

    def get_name_out(self, index: int) -> str:
        return "ret"

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        n, m = self._program.lower.size, self._program.row_lower.size
        sizes = {"f": 1, "x": n, "lam_x": n, "g": m, "lam_g": m}
        size = sizes.get(ca.nlpsol_out(index), 0)
        return ca.Sparsity.dense(size) if size else ca.Sparsity(0, 0)

    def eval(self, arguments: Sequence[ca.DM]) -> list[int]:
        names = [ca.nlpsol_out(i) for i in range(ca.nlpsol_n_out())]
        given = dict(zip(names, arguments, strict=True))
        rows = given["g"].full().ravel()
        program = self._program
        violation = np.maximum(program.row_lower - rows, rows - program.row_upper)
        objective = program.objective(float(given["f"]))
        self.history.append((len(self.history), objective, float(violation.max(initial=0.0))))
        if self._good_enough(program.unscaled(given["x"].full().ravel())):
            self.converged = True
            return [1]
        return [int(self._stop())]
