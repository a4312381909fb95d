"""Compute entries and write what they are: images, data, one page and one record."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fosopt.files import replacing
from fosopt.report.figures import Format, Picture
from fosopt.reproduce.data import comparisons_csv, curves_csv, record
from fosopt.reproduce.entry import Entry
from fosopt.reproduce.outcome import Outcome
from fosopt.reproduce.page import document
from fosopt.reproduce.studio import Studio, studio
from fosopt.reproduce.wording import counts

RECORD, PAGE, COMPARISONS = "reproduction.json", "index.html", "comparisons.csv"
"""Files of a reproduction as a whole."""

FORMATS: tuple[Format, ...] = ("png", "svg")


@dataclass(frozen=True)
class Progress:
    """How far a reproduction is.

    Attributes
    ----------
    done, total
        Entries.
    outcome
        Of the entry that is done last.
    seconds
        Since the start [s].
    """

    done: int
    total: int
    outcome: Outcome
    seconds: float


Watch = Callable[[Progress], None]
Stop = Callable[[], bool]


def computed(entries: Iterable[Entry], stop: Stop = lambda: False) -> Iterator[Outcome]:
    """Compute entries one by one; an error in one is what became of it.

    Parameters
    ----------
    stop
        Asked before each entry.
    """
    for entry in entries:
        if stop():
            return
        try:
            yield Outcome(entry, entry.compute())
        except Exception as error:
            yield Outcome(entry, None, f"{type(error).__name__}: {error}")


def watched(outcomes: Iterable[Outcome], total: int, progress: Watch) -> Iterator[Outcome]:
    """The same outcomes, each of them reported."""
    started = time.monotonic()
    for done, outcome in enumerate(outcomes, 1):
        progress(Progress(done, total, outcome, time.monotonic() - started))
        yield outcome


def reproduce(
    entries: Sequence[Entry],
    out: Path,
    formats: Sequence[Format] = FORMATS,
    progress: Watch = lambda progress: None,
    stop: Stop = lambda: False,
    *,
    parallel: bool = False,
) -> list[Outcome]:
    """Compute entries and write them to a folder: an image and data of each, the page, the record.

    An interruption keeps what is finished.

    Parameters
    ----------
    formats
        Of the image files; the page holds images of its own.
    progress
        Called with every entry that is written.
    stop
        Asked before each entry.
    parallel
        Whether other processes draw.

    Returns
    -------
    list[Outcome]
        What became of each entry that was computed.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    # Refuses a folder that cannot be written before anything is computed.
    _write_all(out, [], entries)
    finished: list[Outcome] = []
    with studio(parallel) as place:
        try:
            for outcome in watched(_drawn(entries, stop, place, out, formats), len(entries), progress):
                finished.append(outcome)
        finally:
            _write_all(out, finished, entries)
    return finished


def summary(finished: Sequence[Outcome], total: int) -> dict[str, Any]:
    """Counts and comparisons for a program to read."""
    return {
        "source": "Barker1991",
        "complete": len(finished) == total,
        "counts": counts(each.result for each in finished),
        "entries": [
            record(each.entry, each.result) | {"error": each.error, "files": list(each.files)}
            for each in finished
        ],
    }


def _drawn(
    entries: Sequence[Entry], stop: Stop, place: Studio, out: Path, formats: Sequence[Format]
) -> Iterator[Outcome]:
    """Entries that are computed, drawn and written, some of them ordered ahead of the one that is at hand."""
    waiting: deque[tuple[Outcome, Callable[[], Picture] | None]] = deque()
    for outcome in computed(entries, stop):
        result = outcome.result
        waiting.append((outcome, place.order(result) if result is not None and result.panels else None))
        if len(waiting) > place.ahead:
            yield _written(*waiting.popleft(), out, formats)
    while waiting:
        yield _written(*waiting.popleft(), out, formats)


def _written(
    outcome: Outcome, drawing: Callable[[], Picture] | None, out: Path, formats: Sequence[Format]
) -> Outcome:
    """Write the files of an entry once it is drawn."""
    result = outcome.result
    if result is None:
        return outcome
    name, image, files = outcome.entry.name, None, dict[str, str | bytes]()
    if drawing is not None:
        try:
            image = drawing()
        except Exception as error:
            return replace(outcome, result=None, error=f"drawing it: {type(error).__name__}: {error}")
        files = {f"{name}.{kind}": image.files[kind] for kind in formats}
    table = name.startswith("table-")
    if result.panels:
        files[f"{name}-curves.csv" if table else f"{name}.csv"] = curves_csv(result.panels)
    if table:
        files[f"{name}.csv"] = comparisons_csv([(outcome.entry, result)], named=False)
    for file, content in files.items():
        _write(out / file, content)
    return replace(outcome, picture=image, files=tuple(files))


def _write_all(out: Path, finished: Sequence[Outcome], entries: Sequence[Entry]) -> None:
    """The page and the files that hold everything."""
    note = (
        f"Interrupted: {len(finished)} of {len(entries)} are shown." if len(finished) < len(entries) else ""
    )
    found = [(each.entry, each.result) for each in finished if each.result is not None]
    _write(out / COMPARISONS, comparisons_csv(found))
    _write(out / RECORD, json.dumps(summary(finished, len(entries)), indent=1, allow_nan=False))
    _write(out / PAGE, document(finished, note))


def _write(path: Path, content: str | bytes) -> None:
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
