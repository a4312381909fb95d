"""Every numbered table and figure of [Barker1991], in the order of their numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from types import MappingProxyType

from fosopt.errors import FosoptError
from fosopt.reproduce import (
    chapter2_actuators,
    chapter2_mirror,
    chapter2_slew,
    chapter2_structure,
    chapter2_validation,
    chapter3_cases,
    chapter3_flexibility,
    chapter3_jitter,
    chapter3_retargeting,
    chapter3_rigid,
    chapter4_inertias,
    chapter4_loops,
    chapter4_spectra,
    chapter4_steps,
    chapter4_table,
)
from fosopt.reproduce.entry import Entry

_CHAPTERS = (
    chapter2_actuators,
    chapter2_mirror,
    chapter2_slew,
    chapter2_structure,
    chapter2_validation,
    chapter3_cases,
    chapter3_flexibility,
    chapter3_jitter,
    chapter3_retargeting,
    chapter3_rigid,
    chapter4_inertias,
    chapter4_loops,
    chapter4_spectra,
    chapter4_steps,
    chapter4_table,
)

FIGURES: Mapping[int, int] = MappingProxyType({2: 37, 3: 43, 4: 26})
"""Number of figures of a chapter."""

TABLES: Mapping[int, int] = MappingProxyType({2: 4, 3: 4, 4: 1})
"""Number of tables of a chapter."""

DRAWINGS: Mapping[str, str] = MappingProxyType(
    {
        "figure-2.1": "Planar flexible optical system",
        "figure-2.2": "The planar truss",
        "figure-2.3": "The planar truss and its degrees of freedom",
        "figure-2.5": "Fixed-free Euler-Bernoulli beam",
        "figure-2.7": "Pinned-free Euler-Bernoulli beam",
        "figure-2.8": "The reaction-mass actuator",
        "figure-2.9": "A reaction-mass actuator on the tip of the structure",
        "figure-2.10": "The reactionless fast steering mirror",
        "figure-3.2": "Degrees of freedom of a reaction actuator: bicollocated and not",
        "figure-3.4": "Two masses, a spring and a damper",
        "figure-3.5": "The modified benchmark problem",
        "figure-3.10": "Block diagram of the controlled benchmark problem",
        "figure-3.12": "Architecture of the benchmark problem's controller",
        "figure-4.10": "Block diagram of the mirror's command response",
    }
)
"""Figures that are drawings or block diagrams: nothing is plotted in them."""


def drawings_of(chapter: int) -> str:
    """A sentence that names the drawings of a chapter."""
    drawn = (
        f"{name.removeprefix('figure-')} ({title})"
        for name, title in DRAWINGS.items()
        if order(name)[0] == chapter
    )
    return f"Drawings, with nothing plotted: figures {'; '.join(drawn)}."


def order(name: str) -> tuple[int, int, str]:
    """Sort key of a name such as ``figure-3.20``: chapter, number, kind."""
    kind, chapter, number = re.split("[-.]", name)
    return int(chapter), int(number), kind


@cache
def catalogue() -> dict[str, Entry]:
    """All entries by name, in the order of their numbers, tables beside figures."""
    return joined(entry for chapter in _CHAPTERS for entry in chapter.ENTRIES)


def joined(entries: Iterable[Entry]) -> dict[str, Entry]:
    """Entries by name, in order.

    Raises
    ------
    ValueError
        If two have the same name.
    """
    found: dict[str, Entry] = {}
    for entry in sorted(entries, key=lambda each: order(each.name)):
        if entry.name in found:
            raise ValueError(f"'{entry.name}' stands in the catalogue twice; drop one")
        found[entry.name] = entry
    return found


def find(names: Sequence[str], known: Mapping[str, Entry] | None = None) -> tuple[Entry, ...]:
    """The entries of these names, each once, in the order of the catalogue; all of them for no name.

    Parameters
    ----------
    names
        ``figure-3.20`` or ``table-4.1``; ``chapter-3``, ``tables`` and ``figures`` stand for many.

    Raises
    ------
    FosoptError
        If nothing has such a name.
    """
    entries = catalogue() if known is None else known
    wanted = {name for asked in names for name in _meant(asked, entries)}
    return tuple(entry for name, entry in entries.items() if name in wanted or not names)


def _meant(asked: str, entries: Mapping[str, Entry]) -> list[str]:
    name = "-".join(asked.lower().split())
    groups = {
        **{each: [each] for each in entries},
        **{
            f"chapter-{chapter}": [each for each in entries if order(each)[0] == chapter]
            for chapter in FIGURES
        },
        **{f"{kind}s": [each for each in entries if each.startswith(kind)] for kind in ("table", "figure")},
    }
    if name in groups:
        return groups[name]
    rest = "'fosopt reproduce --list' names all that can be computed"
    if name in DRAWINGS:
        raise FosoptError(f"{name} is a drawing, nothing is plotted in it; {rest}")
    near = [f"'{each}'" for each in get_close_matches(name, groups, n=3)]
    way = f"did you mean {' or '.join([', '.join(near[:-1]), near[-1]][len(near) < 2 :])}?" if near else rest
    raise FosoptError(f"'{asked}' is no table or figure of the dissertation; {way}")
