"""What became of an entry that was computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fosopt.reproduce.entry import Entry, Reproduction

if TYPE_CHECKING:
    from fosopt.report.figures import Picture


@dataclass(frozen=True)
class Outcome:
    """What became of an entry.

    Attributes
    ----------
    result
        None where it failed.
    error
        Why it failed.
    picture
        Its figure in both formats, if it has one.
    files
        Names of the files beside the page.
    """

    entry: Entry
    result: Reproduction | None
    error: str = ""
    picture: Picture | None = None
    files: tuple[str, ...] = ()
