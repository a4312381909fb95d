"""A reproduction as one HTML file that needs nothing but a browser.

Style and images stand in the file. It holds no script, and its content security policy forbids every request.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Sequence
from html import escape
from importlib.resources import files
from itertools import groupby
from string import Template

from fosopt.report.typeset import as_html
from fosopt.reproduce.catalogue import drawings_of, order
from fosopt.reproduce.entry import Comparison, Panel
from fosopt.reproduce.outcome import Outcome
from fosopt.reproduce.wording import columns, counts, heading, numeric, prose, sentence, verdict

_PIXELS = 144  # of the screen to an inch of print: letters of 8.5 pt are 17 pixels high
_HEAVY = 300_000  # bytes from which an SVG is embedded as PNG
_TYPES = {"svg": "svg+xml", "png": "png"}


def document(entries: Sequence[Outcome], note: str = "") -> str:
    """The HTML text of a reproduction.

    Parameters
    ----------
    note
        A sentence to stand at the end of the summary.
    """
    style = (files("fosopt.report") / "assets" / "report.css").read_text(encoding="utf-8")
    here = files("fosopt.reproduce")
    style += (here / "page.css").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    chapters = [
        (chapter, list(members))
        for chapter, members in groupby(entries, lambda each: order(each.entry.name)[0])
    ]
    found = counts(each.result for each in entries)
    return Template((here / "page.html").read_text(encoding="utf-8")).substitute(
        policy=f"default-src 'none'; style-src 'sha256-{digest}'; img-src data:; base-uri 'none'; form-action 'none'",
        style=style,
        summary=escape(f"Of {len(entries)} tables and figures, {sentence(found)}. {note}".strip()),
        contents="\n".join(_contents(chapter, members) for chapter, members in chapters),
        chapters="\n".join(_chapter(chapter, members) for chapter, members in chapters),
    )


def _unbroken(text: str) -> str:
    """Text in which neither an equation nor a percentage is broken."""
    return as_html(text).replace(" = ", "\u00a0=\u00a0").replace(" %", "\u00a0%")


def _class(word: str) -> str:
    return "open" if word == "not determinable" else word


def _contents(chapter: int, members: Sequence[Outcome]) -> str:
    lines = []
    for each in members:
        name, word = each.entry.name, verdict(each.result)
        lines.append(
            f'<li><a href="#{escape(name)}">{escape(heading(name))}</a><span>{_unbroken(each.entry.title)}</span>'
            f'<span class="{_class(word)}">{word}</span></li>'
        )
    return f"<h3>Chapter {chapter}</h3>\n<ol>\n{chr(10).join(lines)}\n</ol>"


def _chapter(chapter: int, members: Sequence[Outcome]) -> str:
    articles = "\n".join(map(_article, members))
    drawings = f'<p class="drawings">{escape(drawings_of(chapter))}</p>'
    return (
        f'<section id="chapter-{chapter}" aria-labelledby="chapter-{chapter}-title">\n'
        f'<h2 id="chapter-{chapter}-title">Chapter {chapter}</h2>\n{articles}\n{drawings}\n</section>'
    )


def _article(outcome: Outcome) -> str:
    name, word = escape(outcome.entry.name), verdict(outcome.result)
    broad = outcome.picture is None or outcome.picture.width > 4
    return "\n".join(
        [
            f'<article id="{name}" class="{"broad" if broad else "narrow"}">',
            f'<header><h3><a href="#{name}">{escape(heading(outcome.entry.name))}</a> '
            f"<span>{_unbroken(outcome.entry.title)}</span></h3>"
            f'<p class="verdict {_class(word)}">{word}</p></header>',
            *_image(outcome),
            '<div class="text">',
            *_text(outcome),
            "</div>",
            "</article>",
        ]
    )


def _image(outcome: Outcome) -> Iterator[str]:
    if outcome.picture is None or outcome.result is None:
        return
    kind, data = "svg", outcome.picture.files["svg"]
    if len(data) > _HEAVY:
        kind, data = "png", outcome.picture.files["png"]
    width, height = (round(_PIXELS * size) for size in (outcome.picture.width, outcome.picture.height))
    alt = f"{heading(outcome.entry.name)}: {'; '.join(map(_described, outcome.result.panels))}"
    yield (
        f'<figure><img loading="lazy" decoding="async" width="{width}" height="{height}" alt="{escape(alt)}" '
        f'src="data:image/{_TYPES[kind]};base64,{base64.b64encode(data).decode()}"></figure>'
    )


def _described(panel: Panel) -> str:
    labels = [curve.label for curve in panel.curves if curve.label]
    what = f"{panel.title}: " if panel.title else ""
    of = f" of {', '.join(labels)}" if labels else ""
    return f"{what}{panel.y_label} against {panel.x_label}{of}"


def _text(outcome: Outcome) -> Iterator[str]:
    result = outcome.result
    if result is None:
        yield f'<p class="reason failed">{escape(outcome.error)}</p>'
    else:
        yield f"<p>{_unbroken(prose(result.computed))}</p>"
        if result.reason:
            yield f'<p class="reason {_class(result.verdict)}">{_unbroken(prose(result.reason))}</p>'
        if result.comparisons:
            yield _table(outcome.entry.name, result.comparisons)
    links = [
        f'<a href="{escape(name)}">{escape(name.rpartition(".")[2].upper())}</a>' for name in outcome.files
    ]
    links.append('<a href="#contents">Contents</a>')
    yield f'<p class="files">{" · ".join(links)}</p>'


def _table(name: str, rows: Sequence[Comparison]) -> str:
    kept = columns(rows)

    def style(title: str, among: Sequence[Comparison]) -> str:
        if numeric(title, among):
            return ' class="n"'
        # Words stand as the numbers above and below them do.
        return ' class="n values"' if numeric(title, rows) else ' class="note"' if title == "Note" else ""

    head = "".join(f'<th scope="col"{style(title, rows)}>{title}</th>' for title in kept)
    lines = []
    for row, (what, *others) in zip(rows, zip(*kept.values(), strict=True), strict=True):
        cells = zip(list(kept)[1:], others, strict=True)
        line = "".join(f"<td{style(title, [row])}>{_unbroken(cell)}</td>" for title, cell in cells)
        lines.append(f'<tr><th scope="row">{_unbroken(what)}</th>{line}</tr>')
    return (
        f'<div class="scroll" role="region" aria-label="{escape(heading(name))}, published and computed" tabindex="0">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )
