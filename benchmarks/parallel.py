"""What workers gain on a front, what a sweep's record costs, and how soon a long run goes on.

    python benchmarks/parallel.py

The speed-up is a ratio of wall-clock times and means something on a quiet machine only.
"""

from __future__ import annotations

from common import one_thread, table, write_section

if __name__ == "__main__":
    one_thread()

import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.solve.ipopt import never
from fosopt.study import load_study, parse_study
from fosopt.study.build import build_problem, start_vector
from fosopt.study.cluster import Cluster
from fosopt.study.database import RECORD
from fosopt.study.directory import study_hash
from fosopt.study.plan import identity, plan_of, request_identity
from fosopt.study.processes import prepare
from fosopt.study.resume import inputs_of
from fosopt.study.runner import Workers, resume_run, run_study, settle
from fosopt.study.store import Answered, Block, Store
from fosopt.study.sweep_job import SweepPlan
from fosopt.study.sweep_store import SweepFiles
from fosopt.study.template import TEMPLATE
from fosopt.study.work import Parcel

STUDIES = Path(__file__).resolve().parents[1] / "studies"
ROUNDS, FRONT_POINTS, SWEEP_POINTS, RESUME_POINTS, LONG_FRONT = 3, 40, 1_000_000, 100_000, 10_000
TARGET_SPEEDUP, TARGET_STORED, TARGET_RESUME, TARGET_OVERHEAD = 1.8, 60.0, 3.0, 5.0

SWEEP = """
sweep:
  axes:
    - quantity: mirror_inertia_ratio
      log: {from: 0.02 %, to: 20 %, points: 1000}
    - quantity: mirror_frequency
      linear: {from: 10 Hz, to: 60 Hz, points: COUNT}
  outputs: [one_minus_separation]
"""


def main() -> None:
    """Measure everything and write the section."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        rows = [*speedup(place), *stored(place), *resumed(place)]
    write_section(
        "Runs with workers, and their records",
        table(["", "", "target"], rows)
        + f"""

The front is `studies/mass-jitter.yaml` with {FRONT_POINTS} points, compared with the sequential habit:
{2 * FRONT_POINTS} optimizations of 85 variables, by one process and by two workers in turn, {ROUNDS} rounds, of
which medians are given. Times are wall-clock times from reading the study to the last point, start of the workers
included; reports are left out. The answers agree to the last bit. What
workers do not gain is the search for the two ends of the front, which nothing else can do meanwhile, and what
dask takes for its messages. The overhead is that of errands that sleep for a second.

A sweep of {SWEEP_POINTS} points with 16 numbers each is written to a record in blocks of 1024 points, on the
disk one after the other, as a run does. Resuming is timed until the first missing point is begun: a sweep of
{RESUME_POINTS} points of which the last block is missing, and the longest front a study may ask for, of which
all points but one are known.""",
    )


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Wall-clock seconds of a call, and what it returns."""
    begin = time.perf_counter()
    found = work()
    return time.perf_counter() - begin, found


def forget_workers() -> None:
    """End the process that workers are copies of, so that the next ones start from nothing."""
    forkserver._forkserver._stop()


def last_point(heard: list[Any]) -> float:
    """When the last point of a run was finished [s]."""
    return max(each.seconds for each in heard if each.point is not None)


def speedup(place: Path) -> list[tuple[str, str, str]]:
    """One process against two workers on one front."""
    study = load_study(STUDIES / "mass-jitter.yaml", (f"front.points={FRONT_POINTS}",))
    times: list[list[float]] = []
    for k in range(ROUNDS):
        times.append([])
        fronts = []
        for workers in (Workers(), Workers(2)):
            heard: list[Any] = []
            forget_workers()
            out = place / f"front-{k}-{workers.count}"
            run = run_study(study, out, progress=heard.append, workers=workers)
            times[-1].append(last_point(heard))
            fronts.append([{k: v for k, v in p.items() if k != "seconds"} for p in run["points"]])
        assert fronts[0] == fronts[1], "workers change the answer"
    one, two = np.median(times, axis=0)
    ratios = sorted(alone / together for alone, together in times)
    start, share = overhead()
    return [
        (f"front of {FRONT_POINTS} points, one process [s]", f"{one:.1f}", ""),
        ("the same, two workers [s]", f"{two:.1f}", ""),
        ("speed-up, median of the rounds", f"{np.median(ratios):.2f}", f"≥ {TARGET_SPEEDUP}"),
        ("speed-up, least and largest", f"{ratios[0]:.2f} to {ratios[-1]:.2f}", ""),
        ("start of two workers [s]", f"{start:.1f}", ""),
        ("start and overhead of 200 errands of a second [%]", f"{share:.1f}", f"< {TARGET_OVERHEAD:.0f}"),
    ]


@dataclass(frozen=True)
class Errand:
    """A second of work."""

    name: str
    position: int
    followers: int = 0


class Errands:
    """What is done with errands."""

    limit = 60.0

    def respond(self, request: Errand, stop: Callable[[], bool] = never) -> None:
        """Take a second."""
        time.sleep(1)

    def unanswered(self, request: Errand, reason: str) -> None:
        """Take no time."""


def errand(name: str, request: Errand) -> None:
    """Take a second, on a worker."""
    time.sleep(1)


def overhead() -> tuple[float, float]:
    """Start of the workers [s], and what all takes beside the work itself [%], for 200 errands of a second."""
    count, work = 200, 2
    forget_workers()
    begin = time.perf_counter()
    prepare()
    with Cluster(Errands(), Parcel({}, {}), perform=errand, workers=work) as pool:
        for k in range(count):
            pool.submit(Errand(str(k), k))
        started = 0.0
        while pool.busy:
            if pool.next(lambda: False) is not None and not started:
                started = time.perf_counter() - begin - 1
        spent = time.perf_counter() - begin
    return started, 100 * (spent * work / count - 1)


def stored(place: Path) -> list[tuple[str, str, str]]:
    """A record of a million points."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    random = np.random.default_rng(1)
    values = random.normal(size=(1024, 16))
    (place / "stored").mkdir()

    def write() -> None:
        with Store.create(place / "stored" / RECORD, {"kind": "sweep"}) as store:
            for first in range(0, SWEEP_POINTS, 1024):
                last = min(first + 1024, SWEEP_POINTS)
                name = identity("benchmark", {"first": first})
                block = Block(first, last, 0, 0, None)
                store.write_block(block, name, {0: values[: last - first]}, {"number": 1, "done": last})

    def files() -> None:
        names = [f"x{k}" for k in range(16)]
        with (
            Store.open(place / "stored" / RECORD) as store,
            SweepFiles(place / "stored", names, names, [1.0] * 16, {}, {}, "") as sweep_files,
        ):
            for block in store.blocks():
                sweep_files.append(store.block_arrays(block.first)[0], {})

    seconds, _ = timed(write)
    written, _ = timed(files)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    return [
        (f"{SWEEP_POINTS} points of a sweep stored [s]", f"{seconds:.1f}", f"< {TARGET_STORED:.0f}"),
        ("table and arrays written from the record [s]", f"{written:.1f}", ""),
        ("memory both add [MiB]", f"{grown:.0f}", "bounded"),
    ]


def sweep_text(count: int) -> str:
    """A sweep of a thousand times as many points, on three bays."""
    text = TEMPLATE.replace("bays: 20", "bays: 3").replace("kind: codesign", "kind: sweep")
    for name, following in (("variables", "objectives"), ("objectives", "front"), ("front", "solve")):
        first, last = text.index(f"\n{name}:"), text.index(f"\n{following}:")
        text = text[:first] + text[last:]
    return text + SWEEP.replace("COUNT", str(count))


class FirstNewError(Exception):
    """Raised to end a run when it begins with what is missing."""


def resumed(place: Path) -> list[tuple[str, str, str]]:
    """How long a run of many points takes to go on."""
    out, heard = place / "resumed", []
    study = parse_study(sweep_text(RESUME_POINTS // 1000))
    run_study(study, out, progress=heard.append, stop=lambda: heard[-1].done > 0)
    with Store.resume(out / RECORD) as store:
        store._execute("PRAGMA synchronous = OFF")  # making the record is not what is measured
        (done,) = store.blocks()
        arrays = store.block_arrays(done.first)
        spans = list(SweepPlan.of(study).missing([done], 1))
        for span in spans[:-1]:
            first, last = span.blocks[0]
            values = {place: rows[: last - first] for place, rows in arrays.items()}
            store.write_block(Block(first, last, 0, 0, None), span.name, values, store.sessions()[-1])

    def begun() -> bool:
        raise FirstNewError

    def go_on(run: Path) -> None:
        try:
            resume_run(run, stop=begun)
        except FirstNewError:
            return
        raise AssertionError("nothing was missing")

    of_sweep, _ = timed(lambda: go_on(out))
    long_front(place / "long")
    of_front, _ = timed(lambda: go_on(place / "long"))
    return [
        (f"resume of a sweep of {RESUME_POINTS} points [s]", f"{of_sweep:.2f}", f"< {TARGET_RESUME:.0f}"),
        (f"resume of a front of {LONG_FRONT} points [s]", f"{of_front:.2f}", f"< {TARGET_RESUME:.0f}"),
    ]


def front_study(count: int) -> Any:
    """The quickstart on three bays with a number of points."""
    return load_study(STUDIES / "quickstart.yaml", ("structure.bays=3", f"front.points={count}"))


def long_front(out: Path) -> None:
    """The record of a front of many points, of which the last one is missing."""
    short = run_study(front_study(2), out.with_name("short"))
    study = front_study(LONG_FRONT)
    out.mkdir()
    header = {name: value for name, value in short.items() if name != "points"}
    header["provenance"] = header["provenance"] | {"study": (study_id := study_hash(study))}
    plan = plan_of(study, problem := build_problem(study), start := start_vector(study, problem))
    _, files = settle(study, out)
    point = short["points"][1]
    with Store.create(out / RECORD, header, inputs_of(study, files, None)) as store:
        store.write_point(0, short["points"][0])
        store._execute("PRAGMA synchronous = OFF")  # making the record is not what is measured
        while requests := plan.ready():
            for request in requests:
                name = request_identity(study_id, request)
                known = Answered(start, "optimal", 1.0)
                if request.position is None:
                    store.write_answer(name, known)
                elif request.position < plan.total - 1:
                    bare = point | {"key": request.name, "detail": {}, "history": []}
                    store.write_point(1 + request.position, bare, name, known)
                plan.take(request, start, "optimal", 1.0 + (request.name == "end"))


if __name__ == "__main__":
    main()
