"""Points of a sweep in pieces: what is computed together, by whom ever, and what becomes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import Any, ClassVar

import numpy as np

from fosopt.errors import FosoptError, StudyError
from fosopt.ops import Array
from fosopt.solve.ipopt import never
from fosopt.study.schema import Study
from fosopt.study.schema_sweep import STRUCTURAL, Sweep
from fosopt.study.store import Block, Store
from fosopt.study.sweep_outputs import OF_STRUCTURE, Outputs, Tally
from fosopt.study.sweep_points import Bench, Points, Row, bench

_LOOPS, _MODES = 64, 1024  # points at hand: of closed loops, and of coupled modes alone
_LIMIT = 3600.0  # seconds that a span may take before it counts as hanging


@dataclass(frozen=True)
class SweepPlan:
    """A sweep that can be run: points, outputs, and the columns of each array."""

    points: Points
    outputs: Outputs
    widths: dict[str, int]

    @classmethod
    def of(cls, study: Study) -> SweepPlan:
        """The plan of a study.

        Raises
        ------
        StudyError
            If the sweep cannot be run.
        """
        sweep = study.sweep
        assert sweep is not None
        points, outputs = Points(sweep), Outputs.of(sweep)
        first = bench(study, points.row(points.rows(0, 1)[0]))
        modes = first.first.modes.natural_frequency.size
        bays = next((axis.list for axis in sweep.axes if axis.quantity == "bays"), None)
        if bays is not None:
            row = {**points.row(points.rows(0, 1)[0]), "bays": max(bays)}
            modes = bench(study, row).first.modes.natural_frequency.size
        _check_modes(study, sweep, first, modes)
        bodies = 1 + sum(1 for _ in first.base.loop.attachments)
        return cls(points, outputs, outputs.widths(modes, modes + bodies))

    @property
    def scalars(self) -> tuple[str, ...]:
        """Names of what has one value per point, axes first."""
        return (*(a.name for a in self.points.axes), *(e.text for e in self.outputs.scalars))

    def blocks(self) -> Iterator[tuple[int, int]]:
        """Points that are computed together, on which their last bits depend."""
        return self.points.blocks(_LOOPS if self.outputs.needs_loop else _MODES)

    def missing(self, done: Sequence[Block], together: int) -> Iterator[Span]:
        """Blocks that are not stored yet, so many at a time."""
        stored = iter([*((block.first, block.last) for block in done), (self.points.count,) * 2])
        begin, end = next(stored)
        gathered: list[tuple[int, int]] = []
        for first, last in self.blocks():
            while first >= end and begin < self.points.count:
                begin, end = next(stored)
            inside = begin <= first < end
            if gathered and (inside or len(gathered) == together):
                yield Span(tuple(gathered))
                gathered = []
            if not inside:
                gathered.append((first, last))
        if gathered:
            yield Span(tuple(gathered))

    def nothing(self, first: int, last: int) -> tuple[Array, dict[str, Array]]:
        """Points without values: the numbers of their axes, and NaN."""
        numbers = self.points.rows(first, last)
        empty = np.full((last - first, len(self.outputs.scalars)), nan)
        arrays = {name: np.full((last - first, n), nan) for name, n in self.widths.items()}
        return np.hstack([numbers, empty]), arrays


def _check_modes(study: Study, sweep: Sweep, first: Bench, modes: int) -> None:
    """Refuse outputs of modes that no point has."""
    for k, output in enumerate(sweep.outputs):
        for name, index in output.references:
            if index is None:
                continue
            if name not in OF_STRUCTURE and not first.base.loop.plain:
                raise study.error(
                    f"{name}[{index}] is a metric of a bicollocated mirror without reaction masses only; write "
                    f"'{name}', which gives it for every mode",
                    *("sweep", "outputs", k),
                )
            most = modes + (name not in OF_STRUCTURE)
            if index > most:
                raise study.error(f"{name}[{index}]: the model has modes 1 to {most}", "sweep", "outputs", k)


@dataclass(frozen=True)
class Span:
    """Blocks of points that are computed and stored together, each as first and one past the last point."""

    blocks: tuple[tuple[int, int], ...]
    followers: ClassVar[int] = 0

    @property
    def position(self) -> int:
        """Of its first point."""
        return self.blocks[0][0]

    @property
    def name(self) -> str:
        """Unique within a run."""
        return f"points {self.position} to {self.blocks[-1][1]}"


@dataclass(frozen=True)
class Finding:
    """What became of a span, as it is stored: scalars of all points, axes first, and the arrays of its outputs."""

    block: Block
    arrays: dict[int, Array]


class SweepJob:
    """Points of a sweep, block by block.

    Attributes
    ----------
    limit
        How long a span may take [s].
    """

    def __init__(self, study: Study, plan: SweepPlan | None = None) -> None:
        self._study = study
        self._plan = plan or SweepPlan.of(study)
        self._at: tuple[tuple[Any, ...], Bench | None] | None = None
        self.limit = _LIMIT

    def respond(self, request: Span, stop: Callable[[], bool] = never) -> Finding | None:
        """Compute a span, or as much of it as there was time for; None for nothing."""
        tally, pieces, last = Tally(), [], request.position
        for first, end in request.blocks:
            if stop():
                break
            pieces.append(self._block(first, end, tally))
            last = end
        if not pieces:
            return None
        names = self._plan.widths
        arrays = [np.vstack([scalars for scalars, _ in pieces])]
        arrays += [np.vstack([values[name] for _, values in pieces]) for name in names]
        block = Block(request.position, last, tally.unstable, tally.failed, tally.reason)
        return Finding(block, dict(enumerate(arrays)))

    def unanswered(self, request: Span, reason: str) -> Finding:
        """A span without values, and why."""
        first, last = request.position, request.blocks[-1][1]
        scalars, arrays = self._plan.nothing(first, last)
        block = Block(first, last, 0, last - first, reason)
        return Finding(block, dict(enumerate([scalars, *arrays.values()])))

    def _block(self, first: int, last: int, tally: Tally) -> tuple[Array, dict[str, Array]]:
        plan, outputs = self._plan, replace(self._plan.outputs, tally=tally)
        numbers = plan.points.rows(first, last)
        rows = [plan.points.row(each) for each in numbers]
        structure = _structural(plan.points, rows[0])
        if self._at is None or self._at[0] != structure:
            self._at = structure, _bench(self._study, rows[0], outputs)
        elif self._at[1] is None:
            tally.failed += 1
        bench_ = self._at[1]
        if bench_ is None:
            tally.failed += len(rows) - 1
            return plan.nothing(first, last)
        chunk = outputs.chunk(bench_, rows, plan.widths)
        return np.hstack([numbers, chunk.scalars]), chunk.arrays


def _bench(study: Study, row: Row, outputs: Outputs) -> Bench | None:
    """The system at a point; None, and counted, where physics does not allow it."""
    try:
        return bench(study, row)
    except FosoptError as error:
        outputs.tally.fail(error)
        return None


def rerun_sweep_point(store: Store, study: Study, key: str) -> dict[str, Any]:
    """Compute the block of a point of a sweep again and compare the point; see `rerun_point`.

    Raises
    ------
    StudyError
        If the sweep has no such point, or it is not finished.
    """
    plan = SweepPlan.of(study)
    count = plan.points.count
    number = int(key) if key.isdecimal() and len(key) < 10 else count
    if number >= count:
        raise StudyError(f"the sweep has no point '{key}'; give a number from 0 to {count - 1}")
    stored = next((b for b in store.blocks() if b.first <= number < b.last), None)
    if stored is None:
        raise StudyError(f"point {number} is not finished; continue the run first")
    within = next(b for b in plan.blocks() if b[0] <= number < b[1])
    found = SweepJob(study, plan).respond(Span((within,)))
    assert found is not None
    names = (*plan.scalars, *plan.widths)
    before = _values(names, store.block_arrays(stored.first), number - stored.first)
    now = _values(names, found.arrays, number - within[0])
    return {
        "request": ", ".join(f"{name} = {now[name]!r}" for name in plan.scalars[: len(plan.points.axes)]),
        "point": {"metrics": {name: value for name, value in now.items() if value == value}},
        "hurried": {},
        "differs": {n: [before[n], now[n]] for n in now if not _same(before[n], now[n])},
        "environment": {},
        "interrupted": False,
    }


def _values(names: tuple[str, ...], arrays: dict[int, Array], row: int) -> dict[str, float]:
    """All numbers of a point by name."""
    scalars = arrays[0][row].tolist()
    values = dict(zip(names, scalars, strict=False))
    for name, place in zip(names[len(scalars) :], range(1, len(arrays)), strict=True):
        values |= {f"{name}[{k}]": x for k, x in enumerate(arrays[place][row].tolist(), 1)}
    return values


def _same(before: float, now: float) -> bool:
    return before == now or (before != before and now != now)


def _structural(points: Points, row: Row) -> tuple[Any, ...]:
    return tuple(row[a.quantity] for a in points.axes if a.quantity in STRUCTURAL)
