"""Runs that are killed at random moments, and broken study files by the thousand: nothing lost, nothing crashed.

    python benchmarks/survival.py

Short forms of both are in the tests.
"""

from __future__ import annotations

from common import one_thread, table, write_section

if __name__ == "__main__":
    one_thread()

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from broken_studies import broken_texts, broken_trees, verdict
from hypothesis import HealthCheck, given, settings

from fosopt.errors import FosoptError
from fosopt.study.database import RECORD
from fosopt.study.store import Store

STUDIES = Path(__file__).resolve().parents[1] / "studies"
ROUNDS, CASES = 20, 5_000
SETS = [word for each in ("structure.bays=3", "front.points=24") for word in ("--set", each)]
FOSOPT = [sys.executable, "-m", "fosopt"]


def main() -> None:
    """Kill, break, and write the section."""
    with tempfile.TemporaryDirectory() as folder:
        rows = [
            *killed(Path(folder), "one process", ()),
            *killed(Path(folder), "two workers", ("--workers", "2")),
            *both_at_once(Path(folder)),
            *broken(),
        ]
    write_section(
        "Runs that survive",
        table(["", "", "target"], rows)
        + f"""

A front of 24 points on three bays is begun and then killed by SIGKILL {ROUNDS} times, each time at a random
moment after it was begun or resumed, then resumed to its end. After every kill the record is checked by SQLite
and all points that were there before are there, byte for byte; at the end all points are those of a run in one
go, to the last bit. Broken files are the shipped studies with one to three changes of content or text drawn by
hypothesis; what is accepted is built as far as a run would build it before it makes its directory.""",
    )


def contents(out: Path) -> dict[str, Any]:
    """Points of a record by key, once there is one."""
    if not (out / RECORD).exists():
        return {}
    with Store.open(out / RECORD) as store:
        assert store._connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        return {point["key"]: point for point in store.run()["points"]}


def numbers(points: dict[str, Any]) -> dict[str, Any]:
    """All that points say but how long they took."""
    return {key: {k: v for k, v in point.items() if k != "seconds"} for key, point in points.items()}


def start(*arguments: str) -> subprocess.Popen[bytes]:
    """The command in a process of its own, which takes its workers along when it is killed."""
    return subprocess.Popen(
        [*FOSOPT, *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(STUDIES.parent)},
    )


def killed(place: Path, who: str, workers: tuple[str, ...]) -> list[tuple[str, str, str]]:
    """Kill a run again and again."""
    study, luck = str(STUDIES / "quickstart.yaml"), random.Random(1)
    out, whole = place / f"killed-{len(workers)}", place / "whole"
    begin = time.perf_counter()
    if not whole.exists():
        assert start("run", study, *SETS, "--out", str(whole)).wait() == 0
    expected = contents(whole)
    longest = max(time.perf_counter() - begin, 10.0) / 4
    kept: dict[str, Any] = {}
    lost = damaged = 0
    for _ in range(ROUNDS):
        going = ("resume", str(out)) if (out / RECORD).exists() else ("run", study, *SETS, "--out", str(out))
        if going[0] == "run" and out.exists():
            out.rename(place / f"stub-{luck.random()}")  # killed before there was a record
        process = start(*going, *workers)
        time.sleep(luck.uniform(0, longest))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        try:
            now = contents(out)
        except (FosoptError, AssertionError):
            damaged += 1
            continue
        lost += sum(now.get(key) != point for key, point in kept.items())
        kept = now
    if not (out / RECORD).exists():
        raise AssertionError("killed before a record was made, every time; use a quieter machine")
    assert start("resume", str(out), *workers).wait() == 0
    differs = sum(numbers(contents(out)).get(key) != point for key, point in numbers(expected).items())
    return [
        (f"kills of {who}", str(ROUNDS), "20"),
        ("points there at the last kill", f"{len(kept)} of {len(expected)}", ""),
        ("points lost or changed by a kill", str(lost), "0"),
        ("damaged records", str(damaged), "0"),
        ("points unlike those of a run in one go", str(differs), "0"),
    ]


def both_at_once(place: Path) -> list[tuple[str, str, str]]:
    """Two runs that begin in one directory at the same time."""
    out = place / "both"
    arguments = ("run", str(STUDIES / "quickstart.yaml"), *SETS, "--out", str(out))
    codes = sorted(process.wait() for process in [start(*arguments), start(*arguments)])
    assert codes == [0, 3], codes
    assert len(contents(out)) == 25
    return [("two runs begun in one directory: refused", "1", "1")]


def broken() -> list[tuple[str, str, str]]:
    """Thousands of broken studies."""
    counts = {"refused": 0, "accepted": 0}
    slowest = 0.0

    def judge(study: Any) -> None:
        nonlocal slowest
        begin = time.process_time()
        counts["accepted" if verdict(study) is None else "refused"] += 1
        slowest = max(slowest, time.process_time() - begin)

    for strategy, share in ((broken_trees(), 0.8), (broken_texts(), 0.2)):
        how = settings(
            max_examples=round(share * CASES),
            database=None,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        )
        how(given(strategy)(judge))()
    return [
        ("broken study files", str(sum(counts.values())), "≥ 5000"),
        ("of these refused in one line", str(counts["refused"]), ""),
        ("of these accepted", str(counts["accepted"]), ""),
        ("tracebacks", "0", "0"),
        ("longest time for one [s]", f"{slowest:.2f}", ""),
    ]


if __name__ == "__main__":
    main()
