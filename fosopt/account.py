"""The two-sided account of a design: what it reaches, and what provably no other could.

Each number says what it is a bound of and under which assumptions. A bound on the structure is computed once more from
its proof before anyone is shown it, and every bound is held against the design: one above a verified design is a defect
of fosopt, and stops the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, isfinite

import numpy as np

from fosopt.control import PID
from fosopt.errors import FosoptError, SolverError
from fosopt.expressions import parse_expression
from fosopt.ops import Array
from fosopt.problem import Constraint, Evaluation, Problem
from fosopt.relax.bound import Bound
from fosopt.relax.performance_limit import performance_limit
from fosopt.relax.pid_bound import best_pid
from fosopt.relax.pid_box import PidBox
from fosopt.relax.structure_floor import structure_floor

_STRUCTURE = ("area", "batten_mass", "spring_stiffness")
_CONTROLLER = ("gain", "crossover", "kp", "ki", "kd")
# The proof computed again may differ from the first time by its rounding.
_AGAIN = 1e-9
# What a design's own frequency is relaxed by, so that the design itself meets it.
_OWN = 1e-9


@dataclass(frozen=True)
class PidSearch:
    """How long to look for the best PID controller of each design.

    Attributes
    ----------
    time_limit
        Of each design [s].
    gap
        To stop at [-].
    """

    time_limit: float = 10.0
    gap: float = 0.02


@dataclass(frozen=True)
class Entry:
    """One line of an account.

    Attributes
    ----------
    name
        ``mass_lower_bound``, ``mass_lower_bound_same_frequency``, ``jitter_bound_pid`` or ``jitter_bound_any``.
    value
        The bound [kg] or [rad], None where there is none.
    reached
        What the design has.
    of, assumptions, allowance
        As in `relax.bound.Bound`.
    remark
        Why there is no bound, or what was found on the way.
    """

    name: str
    value: float | None
    reached: float
    of: str = ""
    assumptions: tuple[str, ...] = ()
    allowance: float = 0.0
    remark: str = ""

    @property
    def gap(self) -> float | None:
        """Share of what the design has by which another could be better [-]."""
        return None if self.value is None or self.reached == 0 else 1 - self.value / self.reached


def account(
    problem: Problem,
    x: Array,
    constraints: Sequence[Constraint],
    *,
    structure: bool = True,
    any_controller: bool = True,
    pid: PidSearch | None = None,
) -> tuple[Entry, ...]:
    """What could be better about a verified, stable design, on the truth model.

    Parameters
    ----------
    x
        (n,) values of all variables.
    constraints
        What the design meets; those on the structure alone bind the structures it is compared with.
    structure, any_controller, pid
        Which bounds to compute.

    Raises
    ------
    RuntimeError
        If a bound is above what the design has reached: a defect of fosopt.
    """
    truth = problem.evaluate(x, truth=True)
    entries: list[Entry] = []
    if structure:
        mass = truth.value("structural_mass")
        entries.append(_line("mass_lower_bound", mass, lambda: _floor(problem, constraints, x, mass)))
        own = truth.value("first_elastic_frequency") * (1 - _OWN)
        alike = Constraint(parse_expression("first_elastic_frequency"), own, inf)
        entries.append(
            _line("mass_lower_bound_same_frequency", mass, lambda: _floor(problem, (alike,), x, mass))
        )
    if truth.system.disturbances and (any_controller or pid is not None):
        jitter = truth.value("jitter_total")
        if pid is not None:
            entries.append(
                _line("jitter_bound_pid", jitter, lambda: _pid(problem, x, constraints, truth, pid, jitter))
            )
        if any_controller:
            entries.append(_line("jitter_bound_any", jitter, lambda: _any(truth, jitter)))
    return tuple(entries)


def _line(name: str, reached: float, find: Callable[[], tuple[Bound, str]]) -> Entry:
    """A line of the account; what cannot be bounded says why."""
    try:
        bound, remark = find()
    except FosoptError as error:
        return Entry(name, None, reached, remark=str(error))
    bound.hold(reached, "the design")
    return Entry(name, bound.value, reached, bound.of, bound.assumptions, bound.allowance, remark)


def _floor(problem: Problem, constraints: Sequence[Constraint], x: Array, mass: float) -> tuple[Bound, str]:
    if not any(v.quantity in _STRUCTURE for v in problem.variables):
        raise SolverError(
            "nothing of the structure is a design variable; make areas, battens or springs free"
        )
    floor = structure_floor(problem, constraints, x)
    again = floor.recomputed()
    if not again >= floor.bound.value - _AGAIN * abs(mass):
        raise SolverError(
            f"the proof gives {again:.12g} kg when computed again, not {floor.bound.value:.12g} kg"
        )
    left_out = f"left out, which lowers the bound: {', '.join(floor.left_out)}" if floor.left_out else ""
    lighter = f"a structure of {floor.upper:.6g} kg meets the same" if floor.upper < mass * (1 - 1e-6) else ""
    return floor.bound, "; ".join(filter(None, (lighter, left_out)))


def _any(truth: Evaluation, jitter: float) -> tuple[Bound, str]:
    return performance_limit(truth.model, truth.system.disturbances).bound, ""


def _pid(
    problem: Problem,
    x: Array,
    constraints: Sequence[Constraint],
    truth: Evaluation,
    search: PidSearch,
    jitter: float,
) -> tuple[Bound, str]:
    margin = next((c.lower for c in constraints if c.name == "modulus_margin" and isfinite(c.lower)), 0.0)
    found = best_pid(
        truth.model,
        truth.system.disturbances,
        pid_box(problem, x),
        gap=search.gap,
        modulus_margin=margin,
        time_limit=search.time_limit,
        start=_absolute(truth.design.loop.controller),
    )
    remark = f"a PID in the box reaches {found.jitter:.6g} rad" if found.jitter < jitter * (1 - 1e-6) else ""
    stopped = "" if found.finished else f"stopped after {search.time_limit:g} s"
    return found.bound, "; ".join(filter(None, (remark, stopped)))


def pid_box(problem: Problem, x: Array) -> PidBox:
    """Absolute PID gains between the least and the largest that corners of the controller's variables give at a design.

    Raises
    ------
    SolverError
        If no controller gain is a variable.
    """
    slices = problem.slices()
    free = [slices[v.name].start for v in problem.variables if v.quantity in _CONTROLLER]
    if not free:
        raise SolverError("no controller gain is a design variable; make one free")
    low, high = problem.bounds
    gains = [_absolute(problem.design(corner).loop.controller) for corner in _corners(x, free, low, high)]

    def ends(name: str) -> tuple[float, float]:
        values = [float(getattr(gain, name)) for gain in gains]
        return min(values), max(values)

    return PidBox((1.0, 1.0), ends("kp"), ends("ki"), ends("kd"), float(gains[0].rolloff_time))


def _corners(x: Array, free: Sequence[int], low: Array, high: Array) -> Iterator[Array]:
    yield x
    for corner in product(*((low[i], high[i]) for i in free)):
        moved = x.copy()
        moved[list(free)] = np.array(corner)
        yield moved


def _absolute(pid: PID) -> PID:
    """The same controller with a gain of one."""
    return PID(1.0, pid.gain * pid.kp, pid.gain * pid.ki, pid.gain * pid.kd, pid.rolloff_time)
