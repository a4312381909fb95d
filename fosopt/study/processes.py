"""The process that workers of this machine are copies of: it imports everything once, while the run begins."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}

# Dask makes workers give memory back at once, for which glibc asks the system anew for every array of some size: points
# took a third longer.
SURROUNDINGS = {**_ONE_THREAD, "MALLOC_TRIM_THRESHOLD_": str(2**28), "MALLOC_MMAP_THRESHOLD_": str(2**25)}
"""Environment of workers."""

METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
"""How workers come to be."""


def prepare() -> None:
    """Start it where the system can copy processes; returns before it is ready."""
    if METHOD != "forkserver":
        return
    from multiprocessing import forkserver

    kept = {name: os.environ.get(name) for name in SURROUNDINGS}
    multiprocessing.get_context(METHOD).set_forkserver_preload(["fosopt.study.cluster"])
    os.environ.update(SURROUNDINGS)
    try:
        with unheard():
            forkserver.ensure_running()
    finally:
        for name, value in kept.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def unheard() -> Iterator[None]:
    """Block Ctrl-C for processes that begin inside, from their first moment on.

    A terminal sends it to all processes, but it is for the one that began the run, which hears of it afterwards.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    # It would lift the block as it starts, so that it is started before.
    resource_tracker.ensure_running()
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
