"""The comparison of all tables and figures as one Markdown page, for the documentation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from fosopt.report.typeset import as_html
from fosopt.reproduce.catalogue import drawings_of, order
from fosopt.reproduce.outcome import Outcome
from fosopt.reproduce.wording import VERDICTS, columns, counts, heading, numeric, prose, sentence, verdict

_INTRODUCTION = """\
# The dissertation, computed again

Every numbered table and every plotted figure of [Barker1991] from 2.1 to 4.26, and how what fosopt computes compares
with what was published. `fosopt reproduce` draws them and writes their data; this page is what
`fosopt reproduce --page docs/reproduction.md` writes.

An entry *matches* if every number printed about it is met to its last digit, and every statement holds. It *differs*
otherwise, and says why. It is *not determinable* if nothing is printed that it could be held against, or if what it
depends on was not published. The figures were published as pictures that are not available: they are compared with
what the text says about them.
"""


def markdown(entries: Sequence[Outcome]) -> str:
    """The text of the page: a summary, then every entry in order."""
    return "\n".join(_lines(entries))


def _lines(entries: Sequence[Outcome]) -> Iterator[str]:
    found = counts(each.result for each in entries)
    chapters = [
        (chapter, list(members))
        for chapter, members in groupby(entries, lambda each: order(each.entry.name)[0])
    ]
    yield _INTRODUCTION
    yield f"Of {len(entries)} tables and figures, {sentence(found)}.\n"
    kinds = [each for each in VERDICTS if found[each]]
    yield _row(["chapter", *kinds])
    yield _row(["---", *["--:"] * len(kinds)])
    for chapter, members in chapters:
        by_verdict = counts(each.result for each in members)
        yield _row([f"[{chapter}](#chapter-{chapter})", *(str(by_verdict[kind]) for kind in kinds)])
    for chapter, members in chapters:
        yield f"\n## Chapter {chapter}\n"
        yield from _contents(members)
        for each in members:
            yield from _entry(each)
        yield f"\n{drawings_of(chapter)}"
    yield ""


def _contents(members: Sequence[Outcome]) -> Iterator[str]:
    yield _row(["entry", "", "verdict"])
    yield _row(["---"] * 3)
    for each in members:
        name = each.entry.name
        yield _row([f"[{heading(name)}](#{name})", _safe(each.entry.title), verdict(each.result)])


def _entry(outcome: Outcome) -> Iterator[str]:
    name, result = outcome.entry.name, outcome.result
    yield f'\n<a id="{name}"></a>\n'
    yield f"### {heading(name)}: {_safe(outcome.entry.title)}\n"
    if result is None:
        yield f"Verdict: **failed**. {_safe(outcome.error)}"
        return
    yield f"{_safe(prose(result.computed))}\n"
    yield f"Verdict: **{result.verdict}**. {_safe(prose(result.reason))}".rstrip()
    if result.comparisons:
        kept = columns(result.comparisons)
        yield ""
        yield _row(list(kept))
        yield _row(["--:" if numeric(title, result.comparisons) else "---" for title in kept])
        for cells in zip(*kept.values(), strict=True):
            yield _row([_safe(cell) for cell in cells])


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _safe(text: str) -> str:
    """Text in a line or a cell in which nothing is markup but scripts."""
    plain = as_html(" ".join(text.split()), slant=False)
    for sign in ("\\", "*", "_", "`", "|"):
        plain = plain.replace(sign, f"\\{sign}")
    return plain
