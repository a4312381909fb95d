"""The points of a sweep from its record, for those who write files of them."""

from __future__ import annotations

from collections.abc import Iterator

from fosopt.export.sweep import Piece, SweepData
from fosopt.study.resume import recorded_study
from fosopt.study.store import Store
from fosopt.study.sweep_job import SweepPlan

_GAP = 1024  # rows without values that are given at a time


def recorded_sweep(store: Store) -> SweepData:
    """The sweep of a record.

    Raises
    ------
    StudyError
        If the record keeps no study, or its side files are gone.
    """
    plan = SweepPlan.of(recorded_study(store))
    return SweepData(store.header(), lambda: stored_pieces(store, plan))


def stored_pieces(store: Store, plan: SweepPlan) -> Iterator[Piece]:
    """All points up to the last finished one, in their order; what is not finished between others has no values."""
    at = 0
    for block in store.blocks():
        # A row stands for its point.
        for first in range(at, block.first, _GAP):
            yield plan.nothing(first, min(first + _GAP, block.first))
        scalars, *arrays = (values for _, values in sorted(store.block_arrays(block.first).items()))
        yield scalars, dict(zip(plan.widths, arrays, strict=True))
        at = block.last
