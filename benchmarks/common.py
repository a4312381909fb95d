"""What all benchmarks share: one thread, medians, the machine, and one section of results.md each.

Times are processor seconds of the one thread that works, because other jobs on the machine lengthen those least.
"""

from __future__ import annotations

import cProfile
import importlib.metadata
import os
import platform
import pstats
import re
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path

RESULTS = Path(__file__).with_name("results.md")
LIBRARIES = ("numpy", "scipy", "casadi", "numba")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_HEAD = (
    "# Benchmarks\n\nRatios against what a user would do instead, measured in one run. "
    "`make bench` renews this page; each section comes from one file.\n"
)


def one_thread() -> None:
    """Start over with one thread per library, which has to be set before NumPy loads."""
    if any(os.environ.get(name) != "1" for name in _THREADS):
        os.environ.update(dict.fromkeys(_THREADS, "1"))
        os.execv(sys.executable, [sys.executable, *sys.argv])


def seconds(work: Callable[[], object]) -> float:
    """Processor time of one call [s]."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Median processor time of a call after one that is not counted [s]."""
    work()
    return statistics.median(seconds(work) for _ in range(repeats))


def profile_by_module(work: Callable[[], object]) -> list[tuple[str, str]]:
    """Rows of a table: share of a call spent in each module of fosopt, with the libraries it calls.

    The own time of a library function goes to its callers in proportion to the time it spent for each.
    """
    profile = cProfile.Profile()
    profile.runcall(work)
    functions = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    spent: defaultdict[str, float] = defaultdict(float)

    def charge(function: tuple[str, int, str], time_spent: float, depth: int) -> None:
        parts = Path(function[0]).with_suffix("").parts
        callers = {f: counts[3] for f, counts in functions[function][4].items()}
        whole = sum(callers.values())
        if "fosopt" in parts:
            last = len(parts) - 1 - parts[::-1].index("fosopt")
            spent[".".join(parts[last:])] += time_spent
        elif depth == 0 or whole == 0.0:
            spent["other"] += time_spent
        else:
            for caller, share in callers.items():
                charge(caller, time_spent * share / whole, depth - 1)

    for function, (_, _, own, _, _) in functions.items():
        charge(function, own, 12)
    total = sum(spent.values())
    largest = sorted(spent.items(), key=lambda item: -item[1])[:10]
    return [(name, f"{100 * part / total:.0f} %") for name, part in largest]


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *([str(cell) for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write_section(title: str, body: str) -> None:
    """Put a section into results.md, renew the description of the machine and leave the other sections alone."""
    now = datetime.now(UTC).strftime("%Y-%m-%d")
    body = f"Measured on {now} at a load of {os.getloadavg()[0]:.1f}.\n\n{body.strip()}"
    found = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else ""
    parts = re.split(r"^## (.+)\n", found, flags=re.MULTILINE)[1:]
    sections = dict(zip(parts[::2], (text.strip() for text in parts[1::2]), strict=True))
    sections["Machine"] = table(["", ""], _machine())
    sections[title] = body
    text = "\n".join(f"## {name}\n\n{content}\n" for name, content in sections.items())
    temporary = RESULTS.with_suffix(".tmp")
    temporary.write_text(f"{_HEAD}\n{text}", encoding="utf-8")
    os.replace(temporary, RESULTS)


def _machine() -> list[tuple[str, str]]:
    gigabytes = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return [
        ("Processor", f"{_processor()}, {os.cpu_count()} cores"),
        ("Memory", f"{gigabytes:.0f} GiB"),
        ("System", f"{platform.freedesktop_os_release()['PRETTY_NAME']}, {platform.machine()}"),
        ("Python", platform.python_version()),
        ("Libraries", ", ".join(f"{name} {importlib.metadata.version(name)}" for name in LIBRARIES)),
        ("Threads", "one"),
    ]


def _processor() -> str:
    fields = dict.fromkeys(("model name", "cpu family", "model"), "?")
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition(":")
        fields[key.strip()] = value.strip()
    return f"{fields['model name']} (family {fields['cpu family']}, model {fields['model']})"
