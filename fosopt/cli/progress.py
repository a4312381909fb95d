"""What a run says while it works: a bar on a terminal, elsewhere a line per finished point."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fosopt.cli.guard import say
from fosopt.cli.outcome import has_failed, is_answer
from fosopt.units import dimension_name, show

if TYPE_CHECKING:
    from fosopt.study.runner import Progress
    from fosopt.study.schema import Study

Watch = Callable[["Progress"], None]
_BEAT = 30.0  # seconds of silence after which a line says that the run goes on


@dataclass(frozen=True)
class Goal:
    """An objective: its text, what people call it, and the name of its dimension where it has one."""

    name: str
    label: str
    dimension: str | None

    def shown(self, value: float) -> str:
        """The objective with a value in the unit people read."""
        amount = f"{value:.6g}" if self.dimension is None else show(value, self.dimension)
        return f"{self.label} {amount}"


def goals(study: Study) -> tuple[Goal, ...]:
    """The objectives of a study."""
    from fosopt.study.schema_rules import expression_dimension

    found = []
    for objective in study.objectives:
        text, vector = objective.minimize.text, expression_dimension(study, objective.minimize)
        dimension = None if vector is None else dimension_name(vector)
        found.append(Goal(text, objective.label or text, dimension))
    return tuple(found)


class Tally:
    """The best verified value of each objective so far, and how many points failed."""

    def __init__(self, goals: Iterable[Goal]) -> None:
        self.goals = tuple(goals)
        self.best: dict[str, float] = {}
        self.failed = 0

    def count(self, point: Mapping[str, Any]) -> None:
        """Take a finished point into account."""
        self.failed += has_failed(point)
        for goal in self.goals if is_answer(point) else ():
            value = point["metrics"].get(goal.name)
            if value is not None:
                self.best[goal.name] = min(value, self.best.get(goal.name, value))

    def values(self, point: Mapping[str, Any]) -> str:
        """The objectives of a point in one line."""
        metrics = point["metrics"]
        known = (goal.shown(metrics[goal.name]) for goal in self.goals if metrics.get(goal.name) is not None)
        return ", ".join(known)

    def summary(self) -> str:
        """The best values and the failures in one line."""
        known = (goal.shown(self.best[goal.name]) for goal in self.goals if goal.name in self.best)
        best = ", ".join(known)
        parts = [f"best: {best}"] if best else []
        return ", ".join([*parts, *([f"{self.failed} failed"] if self.failed else [])])


def duration(seconds: float) -> str:
    """A time span for people, such as ``3 min 20 s``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def remaining(progress: Progress) -> str:
    """How long the rest takes at the pace so far, and that pace; empty before a point is solved."""
    # What was known before takes no time, and neither does the start design, which is the first point.
    fresh = progress.done - max(progress.known, 1)
    if fresh < 1 or progress.done >= progress.total or progress.seconds <= 0:
        return ""
    pace = progress.seconds / fresh
    rate = f"{60 / pace:.3g} points/min"
    return f"{rate}, about {duration(pace * (progress.total - progress.done))} left"


def finished(point: Mapping[str, Any], values: str) -> str:
    """One line on a finished point."""
    verdict = "verified" if point["verified"] else "not verified"
    name = point["label"] if point["label"].startswith(point["key"]) else f"{point['key']} {point['label']}"
    head = f"{name}: {point['status']}, {verdict}"
    return "; ".join(part for part in (head, values, point["reason"]) if part)


@contextmanager
def watching(study: Study) -> Iterator[Watch]:
    """Show the progress of a run on stderr.

    Yields
    ------
    Callable[[Progress], None]
        What the run calls.
    """
    tally = Tally(goals(study))
    if sys.stderr.isatty():
        # rich takes a while to import, and only a terminal needs it.
        from rich.console import Console

        console = Console(stderr=True)
        if not console.is_dumb_terminal:
            with _bar(tally, console) as watch:
                yield watch
            return
    with _lines(tally) as watch:
        yield watch


@contextmanager
def _lines(tally: Tally) -> Iterator[Watch]:
    stage = head = ""
    began = said = time.monotonic()
    over = threading.Event()

    def watch(progress: Progress) -> None:
        nonlocal stage, head, said
        head = f"[{progress.done}/{progress.total}]"
        if progress.point is not None:
            tally.count(progress.point)
            line = finished(progress.point, tally.values(progress.point))
            times = ", ".join(part for part in (duration(progress.seconds), remaining(progress)) if part)
            say(f"{head} {line} ({times})", error=True)
        elif progress.stage != stage:
            say(f"{head} {progress.stage}", error=True)
        stage, said = progress.stage, time.monotonic()

    def beat() -> None:
        """Say now and then that the run goes on, where no point has said so."""
        while not over.wait(_BEAT / 10):
            nonlocal said
            if time.monotonic() - said >= _BEAT:
                said = time.monotonic()
                parts = [f"{head} at work for {duration(said - began)}", tally.summary()]
                say("; ".join(part for part in parts if part).strip(), error=True)

    heart = threading.Thread(target=beat, name="fosopt-heartbeat", daemon=True)
    heart.start()
    try:
        yield watch
    finally:
        over.set()
        heart.join()


@contextmanager
def _bar(tally: Tally, console: Any) -> Iterator[Watch]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn
    from rich.progress import TimeElapsedColumn as Elapsed
    from rich.text import Text

    class Bar(Progress):
        """A progress bar with the best values in a line below it."""

        def get_renderables(self) -> Iterator[Any]:
            yield from super().get_renderables()
            if tally.summary():
                yield Text(f"  {tally.summary()}", no_wrap=True, overflow="ellipsis")

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        Elapsed(),
        TextColumn("{task.fields[left]}", markup=False),
    )
    # Nothing but the result may go to stdout, so it is not passed through the bar on stderr.
    with Bar(*columns, console=console, transient=True, redirect_stdout=False) as bar:
        task = bar.add_task("starting", total=None, left="")

        def watch(progress: Any) -> None:
            if progress.point is not None:
                tally.count(progress.point)
                if has_failed(progress.point):
                    bar.console.print(Text(finished(progress.point, "")), soft_wrap=True)
            bar.update(
                task,
                description=progress.stage,
                completed=progress.done,
                total=progress.total,
                left=remaining(progress),
            )

        yield watch
