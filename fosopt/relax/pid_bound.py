"""The best PID controller in a box of gains, certified by branch and bound.

Boxes are cut where it matters most, the one with the lowest bound first, until the lowest bound is within the gap of
the best controller found. Cut off are boxes whose bound is above it, and boxes proved to hold no stabilizing
controller. The bounds of all that was cut off or left are then computed again on nodes twice as dense and lowered by
what that changed; boxes that no longer hold are searched further on the denser nodes.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from scipy import optimize

from fosopt.control import PID, closed_loop_poles
from fosopt.errors import ModelError, SolverError
from fosopt.metrics.disturbances import Disturbance, refuse_infinite_variance
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.metrics.margins import modulus_margins
from fosopt.ops import Array
from fosopt.relax.bound import Bound
from fosopt.relax.open_loop import OpenLoop
from fosopt.relax.performance_limit import PerformanceLimit, performance_limit
from fosopt.relax.pid_box import GAINS, Boxes, PidBox, joined
from fosopt.relax.pid_relaxation import relaxation
from fosopt.relax.pid_stability import judge
from fosopt.relax.quadrature import Nodes

_TOLERANCE = 1e-3  # to which the first nodes resolve the spectrum
_HALVINGS = 4
_BATCH = 150_000  # nodes times boxes at a time
_SAMPLES, _STARTS = 400, 3
_LOCAL_EVALUATIONS = 150
_SEARCH_SHARE = 0.5  # of the time that may go into good controllers to begin with
_UNSTABLE = 1e3  # stands for the logarithm of an infinite jitter
_AGAIN = 2.5  # time of the second bound of a box over that of the first, with room
# Boxes are cut off at this share of the gap, which leaves room for what denser nodes change.
_TIGHTER = 0.97
_ROUNDING = 1e-8
_EDGE = 1e-9
# A design whose margin is at its limit has it to the tolerance of a solver only.
_MARGIN_SLACK = 2e-6
_ASSUMED = (
    "halving the distance of the frequencies once more changes no bound by more than the last time",
    "boxes are unstable where 32 points of a circle say so, with twice their bend as allowance",
)


@dataclass(frozen=True)
class PidBound:
    """How far the best PID controller in a box can be from the best one found.

    Attributes
    ----------
    bound
        On the total jitter of any stabilizing controller in the box, infinite if there is proved to be none [rad].
    controller, jitter
        The best one found and its jitter, None and infinite without one [rad].
    limit
        On the total jitter of any linear controller.
    boxes
        How many were bounded.
    finished
        Whether the gap was reached; otherwise time was up.
    hurried
        Whether time cut anything short, so that another machine finds other numbers.
    seconds
        Processor time it took.
    """

    bound: Bound
    controller: PID | None
    jitter: float
    limit: PerformanceLimit
    boxes: int
    finished: bool
    hurried: bool
    seconds: float

    @property
    def gap(self) -> float:
        """Share of the jitter found by which a controller in the box might be better [-]."""
        return 1 - self.bound.value / self.jitter if self.jitter < inf else inf


def best_pid(
    model: LoopModel,
    disturbances: Sequence[Disturbance],
    box: PidBox,
    *,
    gap: float = 0.01,
    modulus_margin: float = 0.0,
    time_limit: float = 60.0,
    start: PID | None = None,
) -> PidBound:
    """The PID controller of least total jitter in a box of gains, with a bound no controller in the box passes.

    The loop's own controller does not matter.

    Parameters
    ----------
    gap
        Stop when the best controller found is within this share of the bound [-].
    modulus_margin
        Least distance of the loop transfer from −1 of the controllers that count; zero admits all stable ones [-].
    time_limit
        Stop after about this processor time, which other work on the machine does not shorten [s].
    start
        A controller in the box to begin with, such as one an optimizer found.

    Raises
    ------
    UnstableError
        If structure and mirror do not come to rest by themselves.
    ModelError
        If there is no disturbance, one has infinite variance with every controller in the box, or `start` is not in it.
    """
    begin = time.process_time()
    if not 0 < gap < 1:
        raise ModelError(f"gap {gap} must be above zero and below one")
    if model.loop.beside is not None:
        raise ModelError(
            "bounds over controllers are those of one loop, the mirror has two; bound each axis alone"
        )
    if start is not None and not box.contains(start):
        raise ModelError(f"start {start} is not in {box}; widen the box or leave the start out")
    search = _Search(model, disturbances, box, gap, modulus_margin * (1 - _MARGIN_SLACK))
    search.find_controllers(start, begin + _SEARCH_SHARE * time_limit)
    search.run(begin + time_limit)
    jitter, value = sqrt(search.variance), sqrt(search.certified)
    at_least = f" and a modulus margin of {modulus_margin:.4g}" if modulus_margin > 0 else ""
    bound = Bound(
        value,
        f"total jitter over all stabilizing PID controllers with {box.description}{at_least}",
        (*search.limit.bound.assumptions, *_ASSUMED),
        sqrt(search.found) - value if search.found < inf else 0.0,
    )
    for each in (bound, search.limit.bound):
        each.hold(jitter, f"the PID controller {search.gains}")
    finished = value >= (1 - gap) * jitter
    controller = None if search.gains is None else box.controller(search.gains)
    seconds = time.process_time() - begin
    return PidBound(bound, controller, jitter, search.limit, search.count, finished, search.hurried, seconds)


def _drifts_without_integral(loop: OpenLoop, box: PidBox) -> bool:
    """Whether jitter is infinite without integral action, as a free rigid body's may be; never for the whole box."""
    for integral in (box.ki[1], 0.0):
        some = replace(loop.model.loop, controller=PID(1.0, 1.0, integral, box.kd[1], box.rolloff_time))
        try:
            for disturbance in loop.disturbances:
                refuse_infinite_variance(disturbance, some, loop.poles.open_loop.drifting)
        except ModelError:
            if integral == box.ki[1]:
                raise
            return True
    return False


class _Open(NamedTuple):
    """A box that may hold a better controller, in the order in which it is looked at.

    `bound` includes what is known of the boxes around it, `own` does not; `along` is the gain to cut it by.
    """

    bound: float
    order: int
    box: Boxes
    own: float
    along: int


class _Search:
    """One run of branch and bound.

    Attributes
    ----------
    gains, variance
        Of the best controller found.
    certified, found
        Least bound of all boxes that are settled, with and without the allowance for the nodes.
    hurried
        Whether a deadline has passed.
    """

    def __init__(
        self, model: LoopModel, disturbances: Sequence[Disturbance], box: PidBox, gap: float, margin: float
    ) -> None:
        self.model, self.disturbances, self.box, self.gap, self.margin = model, disturbances, box, gap, margin
        self.limit = performance_limit(model, disturbances)
        self.needs_integral = _drifts_without_integral(self.limit.open_loop, box)
        self.gains: Array | None = None
        self.variance = self.certified = self.found = inf
        self.open: list[_Open] = []
        self.leaves: list[tuple[Boxes, Array]] = []
        self.count = self.order = 0
        self.bounding = 0.0
        self.hurried = False
        self._use(self.limit.open_loop.nodes(_TOLERANCE))

    def _use(self, nodes: Nodes) -> None:
        self.nodes = nodes
        spectra = self.limit.open_loop.spectra(nodes)
        self.relaxation = relaxation(self.limit, spectra, self.box.rolloff_time)
        self.batch = max(_BATCH // nodes.frequency.size, 1)

    def _late(self, deadline: float, ahead: float = 0.0) -> bool:
        """Whether a deadline passes within so many seconds from now."""
        late = time.process_time() + ahead > deadline
        self.hurried |= late
        return late

    def consider(self, gains: Array) -> float:
        """Mean square of a controller, infinite if it does not count; kept if it is the best so far."""
        if self.needs_integral and gains[2] == 0:
            return inf
        loop = replace(self.model.loop, controller=self.box.controller(gains))
        try:
            poles = closed_loop_poles(loop, self.model.modes, self.model.mirror_port)
        except SolverError:
            return inf
        # On the edge of stability rounding decides, and a sum of residues means nothing.
        value = poles.value
        if not (poles.spectral_abscissa < 0 and np.all(value.real < -_EDGE * np.abs(value))):
            return inf
        here = LoopModel(loop, self.model.modes, self.model.mirror_port)
        if self.margin > 0 and modulus_margins(here, poles, 1)[0][0] < self.margin:
            return inf
        variance = sum(v.value for v in jitter_variances(here, poles, self.disturbances))
        if variance < self.variance:
            self.gains, self.variance = gains, variance
        return variance

    def find_controllers(self, start: PID | None, deadline: float) -> None:
        """Good controllers to begin with: the best of random ones, improved without derivatives until time is up.

        The first is improved in any case.
        """
        found = []
        if start is not None:
            known = np.array([getattr(start, name) for name in GAINS])
            gains = np.clip(known, self.box.whole.low[0], self.box.whole.high[0])
            found += [gains] if self.consider(gains) < inf else []
        samples = self.box.at(np.random.default_rng(0).random((_SAMPLES, len(GAINS))))
        samples = samples[~self.relaxation.too_close(Boxes(samples, samples), self.margin)]
        # Unstable controllers may look better than all stable ones.
        best_first = np.argsort(self.relaxation.variance(samples), kind="stable")
        for gains in samples[best_first]:
            if len(found) == _STARTS or (found and self._late(deadline)):
                break
            if self.consider(gains) < inf:
                found.append(gains)
        for k, gains in enumerate(found):
            self._improve(gains, deadline if k else inf)
        if self.gains is not None:
            self._improve(self.gains, deadline)  # a simplex that has shrunk too early

    def _improve(self, gains: Array, deadline: float) -> None:
        whole = self.box.whole
        free = whole.high[0] > whole.low[0]
        share = self.box.share(gains)

        def jitter(part: Array) -> float:
            share[free] = part
            value = self.consider(self.box.at(share))
            return float(np.log(value)) if value < inf else _UNSTABLE

        def stop_in_time(_: Array) -> None:
            if self._late(deadline):
                raise StopIteration

        if free.any() and not self._late(deadline):
            options = {"maxfev": _LOCAL_EVALUATIONS, "fatol": 1e-6, "xatol": 1e-4}
            bounds = [(0.0, 1.0)] * int(free.sum())
            optimize.minimize(
                jitter,
                share[free].copy(),
                method="Nelder-Mead",
                bounds=bounds,
                options=options,
                callback=stop_in_time,
            )

    def run(self, deadline: float) -> None:
        """Branch, bound and certify until all boxes are settled or time is up."""
        self._add(self.box.whole, np.zeros(1))
        for _ in range(_HALVINGS):
            in_time = self._branch(deadline)
            boxes = joined([*(boxes for boxes, _ in self.leaves), *(entry.box for entry in self.open)])
            before = np.concatenate([*(b for _, b in self.leaves), [entry.own for entry in self.open]])
            self.leaves, self.open = [], []
            self._use(self.nodes.halved)
            again = self._bounds(boxes)
            allowance = np.abs(again - before) + _ROUNDING * again
            value = np.maximum(np.minimum(before, again) - allowance, 0.0)
            short = value < self.variance * (1 - self.gap) ** 2
            settled = ~short if in_time else np.ones_like(short)
            self.certified = min(self.certified, value[settled].min(initial=inf))
            self.found = min(self.found, again[settled].min(initial=inf))
            if not in_time or not short.any():
                return
            kept = value[short]
            self._add(boxes.take(short), kept)
        self.certified = min(self.certified, kept.min())
        self.found = min(self.found, kept.min())

    def _branch(self, deadline: float) -> bool:
        """Cut boxes until the gap is reached; whether that left time to compute the bounds again."""
        while self.open and self.open[0].bound < self._target:
            worst = [heapq.heappop(self.open) for _ in range(min(self.batch, len(self.open)))]
            halves = joined([entry.box for entry in worst]).split(np.array([entry.along for entry in worst]))
            self._add(halves, np.tile([entry.bound for entry in worst], 2))
            pending = len(self.open) + sum(bounds.size for _, bounds in self.leaves)
            if self._late(deadline, _AGAIN * pending * self.bounding / self.count):
                return False
        return True

    @property
    def _target(self) -> float:
        """Mean square from which on a box is cut off."""
        return self.variance * (1 - _TIGHTER * self.gap) ** 2

    def _add(self, boxes: Boxes, parents: Array) -> None:
        """Bound boxes; cut off those that hold nothing better, and keep the others open."""
        for first in range(0, parents.size, self.batch):
            chosen = np.arange(first, min(first + self.batch, parents.size))
            self._add_batch(boxes.take(chosen), parents[chosen])

    def _add_batch(self, boxes: Boxes, parents: Array) -> None:
        self.count += parents.size
        if self.margin > 0:
            near = self.relaxation.too_close(boxes, self.margin)
            boxes, parents = boxes.take(~near), parents[~near]
        begin = time.process_time()
        bounds, influence = self.relaxation.bounds(boxes)
        self.bounding += time.process_time() - begin
        middle = boxes.middle
        promise = self.relaxation.variance(middle)
        low, high = boxes.absolute
        cut = bounds >= self._target
        for k in np.flatnonzero(~cut):
            verdict = judge(self.model, low[k], high[k], self.box.rolloff_time)
            if verdict.stable and promise[k] < self.variance:
                self.consider(middle[k])
            along = int(np.argmax(influence[k]))
            # A single controller cannot be cut in two.
            cut[k] = not (verdict.hopeless or influence[k, along] > 0)
            if not (verdict.hopeless or cut[k]):
                self.order += 1
                own, bound = float(bounds[k]), max(float(bounds[k]), float(parents[k]))
                heapq.heappush(self.open, _Open(bound, self.order, boxes.take([int(k)]), own, along))
        self.leaves.append((boxes.take(cut), bounds[cut]))

    def _bounds(self, boxes: Boxes) -> Array:
        size = boxes.low.shape[0]
        parts = [np.arange(i, min(i + self.batch, size)) for i in range(0, size, self.batch)]
        return np.concatenate([np.zeros(0), *(self.relaxation.bounds(boxes.take(part))[0] for part in parts)])
