"""A look at the machine before a long run: versions, solvers, threads, workers, file system."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from fosopt.account import account
from fosopt.errors import FosoptError
from fosopt.solve import Options, Search, answer
from fosopt.study.build import build_problem, start_vector
from fosopt.study.load import parse_study
from fosopt.study.lock import only_writer
from fosopt.study.plan import plan_of
from fosopt.study.provenance import LIBRARIES, environment, machine, revision, threads
from fosopt.study.store import RECORD, Store
from fosopt.study.sweep_store import size
from fosopt.study.template import TEMPLATE

_SMALL = TEMPLATE.replace("bays: 20", "bays: 2")
_SCARCE = 2**30  # bytes of free space below which a run is likely to end early


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    what
        Its name.
    good
        Whether a run can rely on it.
    found
        What there is, and what to do where it is not good.
    """

    what: str
    good: bool
    found: str


def examine(directory: Path) -> list[Finding]:
    """Look at everything a run depends on; runs would be written to `directory`."""
    versions = environment()
    return [
        Finding("fosopt", True, f"{versions['fosopt']}, git revision {revision()}"),
        Finding("Python", True, f"{versions['python']} on {machine()}"),
        Finding("libraries", True, ", ".join(f"{name} {versions[name]}" for name in LIBRARIES[1:])),
        _threads(),
        _tried("IPOPT", _ipopt),
        _tried("Clarabel", _clarabel),
        _tried("workers", _workers),
        *_file_system(directory),
    ]


def _tried(what: str, look: Callable[[], str]) -> Finding:
    begin = time.perf_counter()
    try:
        found = look()
    except Exception as error:
        # Whatever is wrong with a library is a finding.
        return Finding(
            what, False, f"{type(error).__name__}: {error}; install the versions of requirements.lock"
        )
    return Finding(what, True, f"{found} ({time.perf_counter() - begin:.1f} s)")


def _threads() -> Finding:
    used = threads()
    if used == "1":
        return Finding("threads", True, "1 for linear algebra")
    advice = "set OMP_NUM_THREADS=1 and OPENBLAS_NUM_THREADS=1, or the last bits of results change"
    return Finding("threads", False, f"{used} for linear algebra; {advice}")


def _ipopt() -> str:
    study = parse_study(_SMALL)
    problem = build_problem(study)
    (light,) = plan_of(study, problem, start_vector(study, problem)).ready()
    solution = answer(problem, light, Search(options=Options())).solution
    if solution.status != "optimal":
        raise FosoptError(f"a small problem is not solved: {solution.reason}")
    return f"solves a small problem in {solution.iterations} iterations"


def _clarabel() -> str:
    study = parse_study(_SMALL)
    problem = build_problem(study)
    entries = account(problem, start_vector(study, problem), problem.constraints)
    if all(entry.value is None for entry in entries):
        raise FosoptError("no bound is found for a small problem")
    return f"proves {sum(entry.value is not None for entry in entries)} bounds on a small problem"


def _workers() -> str:
    import distributed  # noqa: F401  (what workers need, and nothing else)

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"dask.distributed {metadata.version('distributed')}, {cores} processors for --workers"


def _file_system(directory: Path) -> list[Finding]:
    """Whether a run can be written to a directory, and how safely."""
    place = next(path for path in (directory.absolute(), *directory.absolute().parents) if path.exists())
    free = shutil.disk_usage(place).free
    room = Finding(
        "free space",
        free >= _SCARCE,
        f"{size(free)} at {place}" + ("" if free >= _SCARCE else "; make room or choose another directory"),
    )
    try:
        with (
            tempfile.TemporaryDirectory(prefix=".fosopt-", dir=place) as folder,
            only_writer(Path(folder)),
            Store.create(Path(folder) / RECORD, {}) as store,
        ):
            journal = store.journal
    except (OSError, FosoptError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        return [room, Finding("file system", False, f"{place} cannot be written: {reason}; choose another")]
    slow = "" if journal == "wal" else ": a network file system? it is safe, and status may have to wait"
    return [
        room,
        Finding("file system", True, f"{place} takes locks and a record with journal '{journal}'{slow}"),
    ]
