"""What the run of a sweep says: rate and remaining time while it works, counts and files at the end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fosopt.cli.guard import Code, say
from fosopt.units import HZ

if TYPE_CHECKING:
    from fosopt.study.runner import Progress

_HEARTBEAT = 5.0  # seconds between two lines where there is no terminal
_MOST_ROWS = 20


def pace(progress: Progress) -> str:
    """Points per second so far, and how long the rest takes at that pace."""
    from fosopt.cli.progress import duration

    fresh = progress.done - progress.known
    if fresh < 1 or progress.seconds <= 0:
        return ""
    rate = fresh / progress.seconds
    left = (progress.total - progress.done) / rate
    return f"{rate:.3g} points/s" + (
        f", about {duration(left)} left" if progress.done < progress.total else ""
    )


@contextmanager
def watching_sweep() -> Iterator[Callable[[Progress], None]]:
    """Show the progress of a sweep on stderr: a bar on a terminal, elsewhere a line every few seconds.

    Yields
    ------
    Callable[[Progress], None]
        What the run calls.
    """
    if not sys.stderr.isatty():
        yield _lines()
        return
    # rich takes a while to import, and only a terminal needs it.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, TextColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    if console.is_dumb_terminal:
        yield _lines()
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[pace]}", markup=False),
    )
    with Bar(*columns, console=console, transient=True, redirect_stdout=False) as bar:
        task = bar.add_task("starting", total=None, pace="")
        yield lambda progress: bar.update(
            task,
            description=progress.stage,
            completed=progress.done,
            total=progress.total,
            pace=pace(progress),
        )


def _lines() -> Callable[[Progress], None]:
    said, stage = -_HEARTBEAT, ""

    def watch(progress: Progress) -> None:
        nonlocal said, stage
        if (
            progress.stage == stage
            and progress.seconds - said < _HEARTBEAT
            and progress.done < progress.total
        ):
            return
        said, stage = progress.seconds, progress.stage
        parts = [progress.stage, pace(progress)]
        say(f"[{progress.done}/{progress.total}] {', '.join(p for p in parts if p)}", error=True)

    return watch


def sweep_code(run: Mapping[str, Any]) -> Code:
    """What the process says with its exit code."""
    if run["interrupted"]:
        return Code.INTERRUPTED
    return Code.UNVERIFIED if run["failed"] else Code.DONE


def sweep_summary(run: Mapping[str, Any], out: Path, code: Code, seconds: float) -> dict[str, Any]:
    """The outcome for a program to read, in SI."""
    kept = ("name", "kind", "interrupted", "count", "finished", "unstable", "failed", "reason", "boundaries")
    return {name: run[name] for name in kept} | {
        "exit_code": int(code),
        "seconds": seconds,
        "directory": str(out),
        "files": {"report": str(out / "report.html"), "table": str(out / "points.csv")},
    }


def sweep_closing(run: Mapping[str, Any], out: Path, seconds: float) -> Iterator[str]:
    """Lines that end a sweep: boundaries, counts, and which file to open."""
    for found in (run["boundaries"] or [])[:_MOST_ROWS]:
        where = ", ".join(_at(run, name, value) for name, value in found["at"].items())
        change = "loses" if found["loses"] else "regains"
        yield (
            f"{change} stability at {where}: {found['frequency'] / HZ:.5g} Hz, "
            f"structural mode {found['structural_mode']}"
        )
    if len(run["boundaries"] or ()) > _MOST_ROWS:
        yield f"and {len(run['boundaries']) - _MOST_ROWS} more boundaries in {out / 'boundary.csv'}"
    parts = [f"{run['finished']} of {run['count']} points"]
    parts += [f"{run['unstable']} unstable"] if run["unstable"] is not None else []
    parts += [f"{run['failed']} without all values ({run['reason']})"] if run["failed"] else []
    yield f"{', '.join(parts)} in {seconds:.1f} s"
    yield f"open {out / 'report.html'} in a browser; numbers are in {out / 'points.csv'} and {out / 'arrays'}"


def _at(run: Mapping[str, Any], name: str, value: Any) -> str:
    quantity = run["quantities"][name]
    if not isinstance(value, float):
        return f"{quantity['label']} {value}"
    return f"{quantity['label']} {value * quantity['factor']:.7g} {quantity['unit']}".rstrip()
