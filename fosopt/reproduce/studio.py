"""Where figures are drawn: in this process, or in others while this one goes on."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, parent_process

from fosopt.report.figures import Picture, picture
from fosopt.reproduce.entry import Reproduction
from fosopt.study.processes import unheard

_MOST_PROCESSES = 4  # each takes some 100 MB


@dataclass(frozen=True)
class Studio:
    """Takes orders for figures.

    Attributes
    ----------
    ahead
        How many orders it may have at hand.
    """

    ahead: int = 0
    executor: Executor | None = None

    def order(self, result: Reproduction) -> Callable[[], Picture]:
        """Order a figure; what is returned waits for it and gives it."""

        def here() -> Picture:
            return picture(result.panels, result.columns)

        if self.executor is None:
            return here
        try:
            with unheard():  # the first orders begin the processes
                drawn = self.executor.submit(picture, result.panels, result.columns)
        except BrokenExecutor:
            return here

        def elsewhere() -> Picture:
            try:
                return drawn.result()
            except BrokenExecutor:
                # A drawing process was killed; this one is still here.
                return here()

        return elsewhere


@contextmanager
def studio(parallel: bool) -> Iterator[Studio]:
    """A studio, in processes of its own if it is `parallel`."""
    if not parallel:
        yield Studio()
        return
    count = min(os.cpu_count() or 1, _MOST_PROCESSES)
    # Not forked: the libraries that compute here may hold threads.
    with ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_attend) as pool:
        yield Studio(2 * count, pool)


def _attend() -> None:
    """Make a drawing process leave interruptions to its parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)
