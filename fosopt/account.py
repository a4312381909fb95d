"""The two-sided account of a design: what it reaches, and what provably no other could.

Each number says what it is a bound of and under which assumptions. A bound on the structure is computed once more from
its proof before anyone is shown it, and every bound is held against the design: one above a verified design is a defect
of fosopt, and stops the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, isfinite, isinf

import numpy as np

from fosopt.control import PID
from fosopt.errors import FosoptError, SolverError
from fosopt.ops import Array
from fosopt.problem import Constraint, Evaluation, Problem
from fosopt.relax.bound import Bound
from fosopt.relax.performance_limit import performance_limit
from fosopt.relax.pid_bound import best_pid
from fosopt.relax.pid_box import PidBox
from fosopt.relax.structural import own_receptance, own_requirements
from fosopt.relax.structure_floor import structure_floor

_STRUCTURE = ("area", "batten_mass", "spring_stiffness")
_CONTROLLER = ("gain", "crossover", "kp", "ki", "kd")
# Degrees of freedom up to which a bound on the structure takes seconds to minutes.
_PROVABLE = 1000
# The proof computed again may differ from the first time by its rounding.
_AGAIN = 1e-9


_Found = tuple[Bound, str, bool]
"""A bound, a remark, and whether time cut the search for it short."""


@dataclass(frozen=True)
class PidSearch:
    """How long to look for the best PID controller of each design.

    Attributes
    ----------
    time_limit
        Processor time for each design [s].
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
        ``mass_lower_bound``, ``mass_lower_bound_same_frequency``, ``mass_lower_bound_same_receptance``,
        ``jitter_bound_pid`` or ``jitter_bound_any``.
    value
        The bound [kg] or [rad], None where there is none, infinite where nothing meets what it is a bound under.
    reached
        What the design has.
    of, assumptions, allowance
        As in `relax.bound.Bound`.
    remark
        Why there is no bound, or what was found on the way.
    hurried
        Whether a time limit cut the search short, so that another machine finds another bound.
    """

    name: str
    value: float | None
    reached: float
    of: str = ""
    assumptions: tuple[str, ...] = ()
    allowance: float = 0.0
    remark: str = ""
    hurried: bool = False

    @property
    def gap(self) -> float | None:
        """Share of what the design has by which another could be better [-]."""
        if self.value is None or not isfinite(self.value) or self.reached == 0:
            return None
        return 1 - self.value / self.reached


def account(
    problem: Problem,
    x: Array,
    constraints: Sequence[Constraint],
    *,
    structure: bool = True,
    receptance: tuple[str, float] | None = None,
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
    receptance
        Port and frequency [rad/s], zero for the static compliance, at which no structure is to be softer than the
        design; none for no such bound.

    Raises
    ------
    RuntimeError
        If a bound is above what the design has reached: a defect of fosopt.
    """
    truth = problem.evaluate(x, truth=True)
    entries: list[Entry] = []
    mass = truth.value("structural_mass")

    def floor(name: str, asked: Sequence[Constraint], at: tuple[str, float] | None = None) -> Entry:
        return _line(name, mass, lambda: _floor(problem, asked, x, truth, at))

    if structure:
        entries.append(floor("mass_lower_bound", constraints))
        alike = own_requirements(problem, x, ("first_elastic_frequency",), truth)
        entries.append(floor("mass_lower_bound_same_frequency", alike))
    if receptance is not None:
        entries.append(floor("mass_lower_bound_same_receptance", (), receptance))
    if truth.system.disturbances and (any_controller or pid is not None):
        jitter = truth.value("jitter_total")
        if pid is not None:
            entries.append(
                _line("jitter_bound_pid", jitter, lambda: _pid(problem, x, constraints, truth, pid, jitter))
            )
        if any_controller:
            entries.append(_line("jitter_bound_any", jitter, lambda: _any(truth, jitter)))
    return tuple(entries)


def refutation(problem: Problem, x: Array, constraints: Sequence[Constraint]) -> Entry | None:
    """The proof that no structure in the box meets what constraints ask of it, or None where there is none.

    Parameters
    ----------
    x
        (n,) values of all variables: where a search gave up.
    """
    if not _has_structure(problem):
        return None
    truth = problem.evaluate(x, truth=True)
    try:
        _refuse_large(problem)
        floor = structure_floor(problem, constraints, x, evaluation=truth)
        proven = isinf(floor.bound.value) and isinf(floor.recomputed())
    except FosoptError:
        return None
    if not proven:
        return None
    return Entry(
        "mass_lower_bound",
        inf,
        truth.value("structural_mass"),
        floor.bound.of,
        floor.bound.assumptions,
        remark=f"proven: no structure in the box meets {', '.join(floor.kept)}",
    )


def _refuse_large(problem: Problem) -> None:
    size = len(problem.system.structure.dofs)
    if size > _PROVABLE:
        raise SolverError(
            f"the proof takes full matrices of {size} degrees of freedom; it is made up to {_PROVABLE} of them"
        )


def _has_structure(problem: Problem) -> bool:
    return any(v.quantity in _STRUCTURE for v in problem.variables)


def _line(name: str, reached: float, find: Callable[[], _Found]) -> Entry:
    """A line of the account; what cannot be bounded says why."""
    try:
        bound, remark, hurried = find()
    except FosoptError as error:
        return Entry(name, None, reached, remark=str(error))
    bound.hold(reached, "the design")
    return Entry(name, bound.value, reached, bound.of, bound.assumptions, bound.allowance, remark, hurried)


def _floor(
    problem: Problem,
    constraints: Sequence[Constraint],
    x: Array,
    truth: Evaluation,
    receptance: tuple[str, float] | None,
) -> _Found:
    if not _has_structure(problem):
        raise SolverError(
            "nothing of the structure is a design variable; make areas, battens or springs free"
        )
    _refuse_large(problem)
    also = () if receptance is None else (own_receptance(problem, x, *receptance, truth),)
    mass = truth.value("structural_mass")
    floor = structure_floor(problem, constraints, x, also=also, evaluation=truth)
    again = floor.recomputed()
    if not again >= floor.bound.value - _AGAIN * abs(mass):
        raise SolverError(
            f"the proof gives {again:.12g} kg when computed again, not {floor.bound.value:.12g} kg"
        )
    left_out = f"left out, which lowers the bound: {', '.join(floor.left_out)}" if floor.left_out else ""
    lighter = f"a structure of {floor.upper:.6g} kg meets the same" if floor.upper < mass * (1 - 1e-6) else ""
    return floor.bound, "; ".join(filter(None, (lighter, left_out))), False


def _any(truth: Evaluation, jitter: float) -> _Found:
    return performance_limit(truth.model, truth.system.disturbances).bound, "", False


def _pid(
    problem: Problem,
    x: Array,
    constraints: Sequence[Constraint],
    truth: Evaluation,
    search: PidSearch,
    jitter: float,
) -> _Found:
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
    stopped = "" if found.finished else f"stopped after {found.seconds:.3g} s"
    return found.bound, "; ".join(filter(None, (remark, stopped))), found.hurried


def pid_box(problem: Problem, x: Array) -> PidBox:
    """Absolute PID gains between the least and the largest that corners of the controller's variables give at a design.

    Raises
    ------
    SolverError
        If no controller gain is a variable.
    """
    slices = problem.slices()
    if problem.base.loop.controller.path.sections:
        raise SolverError("the search knows no filters and no sampling; remove them, or leave this bound out")
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
