"""Plain labels such as ``J̄_k``, ``10^{-3}`` or ``rad^2/Hz`` set as HTML or as matplotlib's mathematics."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

_ACCENTS = {"\u0302": "hat", "\u0303": "tilde", "\u0304": "bar", "\u0307": "dot", "\u0308": "ddot"}
_SUPERSCRIPT = r"\^(?:\{([^{}]*)\}|([+\-−]?[^\W_]+))"
# A letter, a number or jω that stands alone, with an accent, a subscript, a superscript or none; or the power of
# a word or of a bracket.
_SYMBOL = re.compile(
    r"(?<![^\W_])(?<!['’])(?<![^\W_]\.)(jω|[^\W\d_][\u0302-\u0308]?|\d+)"
    rf"(?:_(?:\{{([^{{}}]*)\}}|([^\W_]+)))?(?:{_SUPERSCRIPT})?(?!\.?[^\W_])"
    rf"|(?<=[^\W_]|[)\]|]){_SUPERSCRIPT}"
)
# What stands alone and is no variable: words, and units, also where a number or another unit is before them.
_WORDS = {"a", "A", "I", "m", "N"}
_UNIT = re.compile(r"(\d[ \u00a0\u202f]|rad/)$")


@dataclass(frozen=True)
class _Symbol:
    base: str
    below: str
    above: str
    slanted: bool


def as_html(text: str, *, slant: bool = True) -> str:
    """A label as HTML: markup in it is text, scripts are set as such and variables, if so wished, slanted."""
    return "".join(
        escape(part, quote=False)
        if isinstance(part, str)
        else (f"<i>{escape(part.base)}</i>" if slant and part.slanted else escape(part.base))
        + (f"<sub>{escape(part.below)}</sub>" if part.below else "")
        + (f"<sup>{escape(part.above.replace('-', '−'))}</sup>" if part.above else "")
        for part in _parts(text)
    )


def as_mathtext(text: str) -> str:
    """A label for matplotlib; a dollar sign in it is a dollar sign."""
    return "".join(
        part.replace("$", r"\$") if isinstance(part, str) else f"${_mathematics(part)}$"
        for part in _parts(text)
    )


def _parts(text: str) -> Iterator[str | _Symbol]:
    """The symbols of a text, and what stands between them."""
    end = 0
    for match in _SYMBOL.finditer(text):
        base, *scripts = match.groups(default="")
        below, above = "".join(scripts[:2]), "".join(scripts[2:])
        before = text[: match.start()]
        bare = not (below or above)
        slanted = base[:1].isalpha() and "[" not in before.rpartition("]")[2]
        if bare and (base in _WORDS or _UNIT.search(before)):
            slanted = False
        if slanted or below or above:
            yield text[end : match.start()]
            yield _Symbol(base, below, above, slanted)
            end = match.end()
    yield text[end:]


def _mathematics(symbol: _Symbol) -> str:
    plain = unicodedata.normalize("NFD", symbol.base)
    body = "".join(each for each in plain if each not in _ACCENTS)
    if not symbol.slanted:
        body = rf"\mathrm{{{body}}}" if body else ""
    for accent in plain:
        if accent in _ACCENTS:
            body = rf"\{_ACCENTS[accent]}{{{body}}}"
    below = f"_{{{_script(symbol.below)}}}" if symbol.below else ""
    above = f"^{{{_script(symbol.above)}}}" if symbol.above else ""
    return f"{body}{below}{above}"


def _script(text: str) -> str:
    """A word upright, an index slanted."""
    safe = re.sub(r"([$%#&_{}])", r"\\\1", text.replace("\\", "/")).replace(" ", r"\ ")
    return rf"\mathrm{{{safe}}}" if re.search(r"[^\W\d_]{2}", text) else safe
