"""Requests on their way to whoever answers them: this process, or workers."""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

from fosopt.solve import Plan, Request
from fosopt.study.store import Answered
from fosopt.study.work import Response


class Asked(Protocol):
    """A request: its name, unique within a run, and its position, None for what comes before all points."""

    @property
    def name(self) -> str:
        """Unique within a run."""
        ...

    @property
    def position(self) -> int | None:
        """Among the points of a run."""
        ...

    @property
    def followers(self) -> int:
        """How many wait for it, one after the other."""
        ...


class Job(Protocol):
    """What is done with a request.

    Attributes
    ----------
    limit
        How long one may take [s].
    """

    limit: float

    def respond(self, request: Any, stop: Callable[[], bool] = ...) -> Any:
        """Answer a request."""
        ...

    def unanswered(self, request: Any, reason: str) -> Any:
        """The answer to a request that was given up from outside."""
        ...


class Pool(Protocol):
    """Whoever answers requests."""

    def submit(self, request: Asked) -> None:
        """Take a request."""
        ...

    @property
    def busy(self) -> bool:
        """Whether a request is unanswered."""
        ...

    def next(self, stop: Callable[[], bool]) -> tuple[Any, Any] | None:
        """A request with its answer, or None if there was none for a moment.

        Raises
        ------
        StoppedError
            If there will be no more answers.
        """
        ...


class Serial:
    """Requests answered one after the other in this process, in the order of their positions."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._waiting: list[Asked] = []

    def submit(self, request: Asked) -> None:
        """As `Pool`."""
        insort(self._waiting, request, key=lambda each: -1 if each.position is None else each.position)

    @property
    def busy(self) -> bool:
        """As `Pool`."""
        return bool(self._waiting)

    def next(self, stop: Callable[[], bool]) -> tuple[Any, Any] | None:
        """As `Pool`."""
        request = self._waiting.pop(0)
        return request, self._job.respond(request, stop)


def drive(
    plan: Plan,
    pool: Pool,
    known: Mapping[str, Answered],
    identity: Callable[[Request], str],
    stop: Callable[[], bool],
) -> Iterator[tuple[Request, Response]]:
    """Follow a plan to its end, but for what is known already.

    Parameters
    ----------
    known
        Answers by identity.
    identity
        Of a request.
    stop
        Asked often; true ends the iteration.
    """
    _hand_out(plan, pool, known, identity)
    while pool.busy and not stop():
        found = pool.next(stop)
        if found is None:
            continue
        yield found
        request, response = found
        answer = response.answer
        if answer.status != "interrupted":
            plan.take(request, answer.x, answer.status, answer.objective)
            _hand_out(plan, pool, known, identity)


def _hand_out(
    plan: Plan,
    pool: Pool,
    known: Mapping[str, Answered],
    identity: Callable[[Request], str],
) -> None:
    while requests := plan.ready():
        for request in requests:
            answer = known.get(identity(request))
            if answer is None:
                pool.submit(request)
            else:
                plan.take(request, answer.x, answer.status, answer.objective)
