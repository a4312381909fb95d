"""Every error a caller of fosopt can cause.

A message names the value, the rule it breaks and the way out, in one line.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path


class FosoptError(Exception):
    """Base of all errors fosopt raises on purpose; anything else is a defect of fosopt."""


class ModelError(FosoptError):
    """A structure, actuator or controller that physics or its definition does not allow."""


class StudyError(FosoptError):
    """A study file, or a file it names, that breaks a rule.

    Parameters
    ----------
    message
        Value, rule and way out in one line.
    file, line, column
        Where it stands; line and column count from one.
    path
        The keys that lead to it, joined by dots, such as ``variables.0.lower``.
    """

    def __init__(
        self,
        message: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        column: int | None = None,
        path: str | None = None,
    ) -> None:
        self.message, self.file, self.line, self.column, self.path = message, file, line, column, path
        where = ":".join(str(part) for part in (file, line, column) if part is not None)
        super().__init__(printable(": ".join(part for part in (where, path, message) if part)))


class UnstableError(FosoptError):
    """A closed loop with a pole that does not decay: it has no jitter."""


class SolverError(FosoptError):
    """A numerical method that could not deliver what it was asked for."""


class StoppedError(FosoptError):
    """A run that the machine stopped before its end; what is finished is in its record, and it can be resumed."""


def printable(text: str) -> str:
    """Text for a message in a terminal, a question mark for each character that would command it."""
    return "".join(c if c.isprintable() else "?" for c in text)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of a sentence that refuses an unknown name: its nearest known neighbor, or all of them."""
    names = sorted(known)
    near = get_close_matches(name, names, n=1, cutoff=0.6)
    return f"did you mean '{near[0]}'?" if near else f"known: {', '.join(names)}"
