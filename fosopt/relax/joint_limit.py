"""The least jitter of any structure in a box with any linear controller.

Each bound of `joint_weights` holds for all structures; over a box of them it is linear in the parameters but for small
discs (`joint_family`), and its least value there is known. Boxes are cut where the bound is lowest, and weights are
made anew for boxes in which those at hand cannot do, until cutting raises the bound no more.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance
from fosopt.ops import Array
from fosopt.problem import Constraint, Problem
from fosopt.relax.bound import Bound
from fosopt.relax.joint_family import StructureFamily, structure_family
from fosopt.relax.joint_weights import Weights, best_weights, sources
from fosopt.relax.structural import MISSED

# Half width of a box over its middle up to which weights are made for it, besides for the whole; and the share of its
# value in the middle that a bound may lose over a box if that value is to be the best there.
_COARSE, _SETTLED = 0.3, 0.2
# Logarithms known no better than this are no use.
_VAGUE = 3.0
_ROUNDING = 1e-8


@dataclass(frozen=True)
class JointLimit:
    """How little jitter structure and controller together can leave.

    Attributes
    ----------
    bound
        On the total jitter; infinite if no structure in the box keeps the limits on it [rad].
    attained
        What the bound is at some structure: finer boxes will not raise it above this [rad].
    low, high
        (p,) Corners of the box in which it is lowest.
    left_out
        Constraints that did not enter, which lowers the bound.
    boxes, weights
        How many were bounded, and by how many bounds.
    finished
        Whether the tolerance was reached; otherwise time was up.
    seconds
        It took.
    """

    bound: Bound
    attained: float
    low: Array
    high: Array
    left_out: tuple[str, ...]
    boxes: int
    weights: int
    finished: bool
    seconds: float


def joint_limit(
    problem: Problem,
    x: Array,
    constraints: Sequence[Constraint],
    *,
    tolerance: float = 0.02,
    time_limit: float = 60.0,
) -> JointLimit:
    """Lower bound on the jitter of every structure a problem's variables span, with every linear controller.

    Cutting boxes is for a handful of groups: areas that come member by member are too many.

    Parameters
    ----------
    x
        (n,) values of all variables: a stable design. If it keeps the limits, the bound is held against it.
    constraints
        Limits on the structural mass, on the first elastic frequency and linear ones on the structure enter.
    tolerance, time_limit
        See `family_limit`.

    Raises
    ------
    ModelError
        If nothing of the structure is a variable, or for what the bound is not made for: see `structure_family` and
        `joint_weights.sources`.
    UnstableError
        If the design is unstable.
    RuntimeError
        If the design is below the bound: a defect of fosopt.
    """
    truth = problem.evaluate(x, truth=True)
    family, part = structure_family(problem, x, tuple(constraints), truth)
    if not family.sizing.names:
        raise ModelError("nothing of the structure is a variable; use performance_limit")
    jitter = truth.value("jitter_total")
    found = family_limit(family, problem.system.disturbances, tolerance=tolerance, time_limit=time_limit)
    # What solvers leave of a limit is none of the bound's business, and a design beyond it is no witness.
    nearly = replace(family, most=family.most * (1 + MISSED), slowest=family.slowest * (1 - MISSED))
    if nearly.possible(part.x, part.x):
        found.bound.hold(jitter, "the design")
    return replace(found, left_out=part.left_out)


def family_limit(
    family: StructureFamily,
    disturbances: Sequence[Disturbance],
    *,
    tolerance: float = 0.02,
    time_limit: float = 60.0,
) -> JointLimit:
    """Lower bound on the jitter of every structure of a family with every linear controller.

    Parameters
    ----------
    tolerance
        Stop when the bound is within this share of what it is at some structure [-].
    time_limit
        Stop after about this time, with the bound proved until then [s].

    Raises
    ------
    ModelError
        If no sensor noise is white or a high pass of first order.
    """
    begin = time.perf_counter()
    search = _Search(family, disturbances)
    finished = search.run(tolerance, begin + time_limit)
    worst = search.open[0] if search.open else None
    square = inf if worst is None else worst.bound
    value = sqrt(max(square * (1 - _ROUNDING), 0.0))
    limits = [f"cost at most {family.most:.6g}"] if family.most < inf else []
    limits += [f"first elastic frequency at least {family.slowest:.6g} rad/s"] if family.slowest else []
    where = "".join(f", {limit}" for limit in limits)
    bound = Bound(
        value,
        f"total jitter over all structures in the box{where}, and all stabilizing linear controllers fed with the "
        "measured angle",
        _assumptions(search),
        _ROUNDING * value if value < inf else 0.0,
    )
    none = np.zeros(0)
    return JointLimit(
        bound,
        sqrt(search.attained),
        none if worst is None else worst.low,
        none if worst is None else worst.high,
        (),
        search.count,
        len(search.weights),
        finished,
        time.perf_counter() - begin,
    )


def _assumptions(search: _Search) -> tuple[str, ...]:
    said = [
        "structures, mirror and disturbances are as modeled and the disturbances independent",
        "the control torque is unlimited",
        "halving the distance of the frequencies once more changes no bound by more than the last time",
    ]
    if search.of.left_out:
        said.append(f"left out, which lowers the bound: {', '.join(search.of.left_out)}")
    return tuple(said)


class _Open(NamedTuple):
    """A box in the order in which it is looked at, with log(|H F|²/r) of each torque at each point over it."""

    bound: float
    order: int
    low: Array
    high: Array
    value: Array
    slope: Array
    radius: Array
    own: bool = False

    def under(self, weights: Weights) -> tuple[float, float]:
        """The bound over the box, and in its middle."""
        used = weights.weight > 0
        if not np.all(np.isfinite(self.radius[used])):
            return -inf, -inf
        weight = weights.weight[used]
        middle = weights.constant + weights.factor * float(weight @ self.value[used])
        loss = float(np.abs(weight @ self.slope[used]).sum() + weight @ self.radius[used])
        return middle - weights.factor * loss, middle


class _Search:
    """One run of branch and bound.

    Attributes
    ----------
    open
        Boxes that together hold all structures that keep the limits, the one with the lowest bound first.
    attained
        The least value of a bound that was made for a small box, in its middle.
    """

    def __init__(self, family: StructureFamily, disturbances: Sequence[Disturbance]) -> None:
        self.family, self.of = family, sources(disturbances)
        self.points = self.of.points()
        self.filters = self.of.filters(self.points)
        self.weights: list[Weights] = []
        self.open: list[_Open] = []
        self.attained = inf
        self.count = 0
        self._add(family.sizing.lower, family.sizing.upper, -inf)

    def run(self, tolerance: float, deadline: float) -> bool:
        """Cut boxes until the tolerance is reached; whether that was in time."""
        while self.open:
            target = self.attained * (1 - tolerance) ** 2
            if self.open[0].bound >= target:
                return True
            if time.perf_counter() > deadline:
                return False
            box = heapq.heappop(self.open)
            half, middle = 0.5 * (box.high - box.low), 0.5 * (box.high + box.low)
            wide = float(np.max(half / middle, initial=0.0))
            reached = max((box.under(w)[1] for w in self.weights), default=-inf)
            if (
                not box.own
                and (wide <= _COARSE or not self.weights)
                and (reached < target or self.attained == inf)
            ):
                self._aim(box, middle)
            elif wide > 0:
                self._cut(box)
            else:
                heapq.heappush(self.open, box)
                return True
        return True

    def _aim(self, box: _Open, middle: Array) -> None:
        """Make weights for a box, and where these are low for the structure in its middle; see what they do for all."""
        least, here = self._weigh(box)
        if here - least <= _SETTLED * here and here < self.attained and self.family.possible(middle, middle):
            self.attained = min(self.attained, self._weigh(self._box(middle, middle, -inf))[1])
        every = [*self.open, box._replace(own=True)]
        self.open = [self._bounded(b) for b in every]
        heapq.heapify(self.open)

    def _weigh(self, box: _Open) -> tuple[float, float]:
        known = np.isfinite(box.radius) & (box.radius < _VAGUE)
        logarithms = np.where(known, box.value - np.where(known, box.radius, 0.0), 0.0)
        near = self.weights[-1].touch if self.weights else None
        weights = best_weights(self.of, self.points, logarithms, known, near)
        self.weights.append(weights)
        return box.under(weights)

    def _cut(self, box: _Open) -> None:
        along = int(np.argmax(box.high / box.low))
        at = sqrt(box.low[along] * box.high[along])
        high, low = box.high.copy(), box.low.copy()
        high[along] = low[along] = at
        self._add(box.low, high, box.bound)
        self._add(low, box.high, box.bound)

    def _add(self, low: Array, high: Array, parent: float) -> None:
        if self.family.possible(low, high):
            self.count += 1
            heapq.heappush(self.open, self._bounded(self._box(low, high, parent)))

    def _box(self, low: Array, high: Array, parent: float) -> _Open:
        found = self.family.responses(low, high, self.points)
        each = [found[d.at] for d in self.of.torques]
        shape = len(each), self.points.size
        value = 2 * np.array([a.value for a in each]).reshape(shape) + self.filters
        slope = 2 * np.array([a.slope for a in each]).reshape(*shape, low.size)
        radius = 2 * np.array([a.radius for a in each]).reshape(shape)
        # Where structures at the corners say more, only that is kept.
        corners = self.family.lowest(low, high, self.points)
        least = 2 * np.array([corners[d.at] for d in self.of.torques]).reshape(shape) + self.filters
        better = least > value - np.abs(slope).sum(axis=2) - radius
        value = np.where(better, least, value)
        slope = np.where(better[:, :, None], 0.0, slope)
        radius = np.where(better, 0.0, radius)
        return _Open(parent, self.count, low, high, value, slope, radius)

    def _bounded(self, box: _Open) -> _Open:
        return box._replace(bound=max([box.bound, *(box.under(w)[0] for w in self.weights)]))
