"""The command that computes the dissertation's tables and figures again, and what it says meanwhile."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fosopt.cli.guard import Code, guarded, interruptible, say
from fosopt.cli.progress import duration

if TYPE_CHECKING:
    from fosopt.reproduce.entry import Comparison, Entry
    from fosopt.reproduce.outcome import Outcome
    from fosopt.reproduce.run import Progress, Stop, Watch

HELP = """Compute the dissertation's tables and figures again, beside what was published.

A NAME is table-4.1 or figure-3.20; chapter-3, tables and figures stand for many. Without one, all are computed.
Results go to a directory: index.html to look at, an image (PNG and SVG) and the curves (CSV) of each figure, the rows
of each table (CSV), comparisons.csv and reproduction.json with all that was compared. Ctrl-C ends after what is at
hand and keeps what is finished; a second Ctrl-C ends at once.
"""
EPILOG = """\b
Exit codes:
  0    every entry was computed, whether it matches or not
  1    a defect of fosopt; FOSOPT_DEBUG=1 shows the traceback
  2    wrong usage
  3    an unknown name, or a directory or file that cannot be written
  4    an entry failed; the others are there
  130  interrupted; what was finished is there
"""
_FEW = 5  # entries whose comparisons are printed


@guarded
def reproduce(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME", help="What to compute.", show_default=False)
    ] = None,
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Directory of the results; files of an earlier run are replaced."),
    ] = Path("runs/reproduction"),
    page: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the comparisons as a page of Markdown to FILE, and draw nothing.",
            show_default=False,
        ),
    ] = None,
    listing: Annotated[
        bool, typer.Option("--list", help="List names and titles, and compute nothing.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print JSON on stdout, and nothing else there.")
    ] = False,
) -> None:
    """Compute the dissertation's tables and figures again."""
    from fosopt.reproduce.catalogue import find

    entries = find(names or ())
    if listing:
        _list(entries, as_json)
        return
    started = time.monotonic()
    with interruptible() as stop, _watching() as watch:
        found = _drawn(entries, out, watch, stop) if page is None else _paged(entries, page, watch, stop)
    complete = len(found) == len(entries)
    if as_json:
        from fosopt.reproduce.run import summary

        say(json.dumps(summary(found, len(entries)), allow_nan=False))
    for line in _closing(found):
        say(line, error=as_json)
    say(f"computed in {duration(time.monotonic() - started)}; {_where(page, out, complete)}", error=as_json)
    if not complete:
        raise typer.Exit(Code.INTERRUPTED)
    raise typer.Exit(Code.UNVERIFIED if any(each.result is None for each in found) else Code.DONE)


def _drawn(entries: Sequence[Entry], out: Path, watch: Watch, stop: Stop) -> list[Outcome]:
    from fosopt.reproduce.run import reproduce as write

    return write(entries, out, progress=watch, stop=stop, parallel=len(entries) > 1)


def _paged(entries: Sequence[Entry], page: Path, watch: Watch, stop: Stop) -> list[Outcome]:
    """Write the page, unless the computation is cut short."""
    from fosopt.files import replacing
    from fosopt.reproduce.markdown import markdown
    from fosopt.reproduce.run import computed, watched

    with suppress(_CutShortError), replacing(page) as temporary:
        # Refuses a file that cannot be written before anything is computed.
        temporary.touch()
        found = list(watched(computed(entries, stop), len(entries), watch))
        if len(found) < len(entries):
            raise _CutShortError
        temporary.write_text(markdown(found), encoding="utf-8", newline="\n")
    return found


class _CutShortError(Exception):
    pass


def _where(page: Path | None, out: Path, complete: bool) -> str:
    if page is not None:
        return f"wrote {page}" if complete else f"left {page} as it was"
    from fosopt.reproduce.run import PAGE

    return f"open {out / PAGE} in a browser"


def _list(entries: Sequence[Entry], as_json: bool) -> None:
    if as_json:
        say(json.dumps([{"name": each.name, "title": each.title} for each in entries]))
        return
    width = max(len(each.name) for each in entries)
    for each in entries:
        say(f"{each.name:<{width}}  {each.title}")


def _closing(found: Sequence[Outcome]) -> Iterator[str]:
    """What does not match, and why; of a few entries, all that was compared; the counts."""
    from fosopt.reproduce.wording import counts, sentence, verdict

    for each in found:
        if len(found) <= _FEW or each.result is None:
            reason = each.error if each.result is None else each.result.reason
            yield f"{each.entry.name} {verdict(each.result)}{': ' if reason else ''}{' '.join(reason.split())}"
        if len(found) <= _FEW and each.result is not None and each.result.comparisons:
            yield from _table(each.result.comparisons)
            yield ""
    yield sentence(counts(each.result for each in found))


def _table(rows: Sequence[Comparison]) -> Iterator[str]:
    """Rows side by side, the notes left to the page."""
    from fosopt.reproduce.wording import columns, numeric

    kept = {
        title: [cell.translate({ord("{"): None, ord("}"): None}) for cell in cells]
        for title, cells in columns(rows).items()
        if title != "Note"
    }
    widths = {title: max(map(len, [title, *cells])) for title, cells in kept.items()}
    for cells in [tuple(kept), *zip(*kept.values(), strict=True)]:
        line = (
            f"{cell:>{width}}" if numeric(title, rows) else f"{cell:<{width}}"
            for cell, (title, width) in zip(cells, widths.items(), strict=True)
        )
        yield f"  {'  '.join(line)}".rstrip()


@contextmanager
def _watching() -> Iterator[Watch]:
    """Show the progress on stderr: a bar on a terminal, elsewhere a line per entry."""
    if not sys.stderr.isatty():
        yield _say_progress
        return
    # rich takes a while to import, and only a terminal needs it.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    if console.is_dumb_terminal:
        yield _say_progress
        return
    text = TextColumn("{task.description}", markup=False)
    columns = (SpinnerColumn(), text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    # Nothing but the result may go to stdout, so it is not passed through the bar on stderr.
    with Bar(*columns, console=console, transient=True, redirect_stdout=False) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda progress: bar.update(
            task,
            description=progress.outcome.entry.name,
            completed=progress.done,
            total=progress.total,
        )


def _say_progress(progress: Progress) -> None:
    from fosopt.reproduce.wording import verdict

    head = f"[{progress.done}/{progress.total}] {progress.outcome.entry.name}"
    say(f"{head}: {verdict(progress.outcome.result)} ({duration(progress.seconds)})", error=True)
