"""Sessions of a run: when each began, how long it worked, and how far it came."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any


@dataclass(frozen=True)
class Session:
    """One process at work on a run.

    Spans are taken from a clock that never goes back; the time of day is for people alone.

    Attributes
    ----------
    number
        From one.
    known
        Points that were finished before.
    options, environment
        How it was started, and versions.
    """

    number: int
    known: int
    options: str
    environment: Mapping[str, str]
    began: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    _start: float = field(default_factory=time.perf_counter)

    @classmethod
    def after(
        cls, sessions: Sequence[Mapping[str, Any]], known: int, options: str, environment: Mapping[str, str]
    ) -> Session:
        """The session that follows others."""
        return cls(len(sessions) + 1, known, options, environment)

    @property
    def seconds(self) -> float:
        """Since it began."""
        return time.perf_counter() - self._start

    def record(self, done: int, total: int, end: str | None = None) -> dict[str, Any]:
        """What is kept of it: `done` of `total` points, and how it ended, None while it goes on or if it was killed."""
        return {
            "number": self.number,
            "began": self.began,
            "seconds": self.seconds,
            "known": self.known,
            "done": done,
            "total": total,
            "end": end,
            "options": self.options,
            "environment": dict(self.environment),
        }
