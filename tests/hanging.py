"""Work for a worker that answers at once, or never."""

from __future__ import annotations

import time
from dataclasses import dataclass

from distributed import get_worker


@dataclass(frozen=True)
class Errand:
    """A request that is answered by its name."""

    name: str
    position: int
    followers: int = 0


class Job:
    """What answers where no worker does."""

    limit = 0.2

    def respond(self, request: Errand, stop=None) -> str:
        return request.name

    def unanswered(self, request: Errand, reason: str) -> str:
        return reason


def perform(name: str, request: Errand) -> str:
    """Answer, or hang where the name says so; or end the worker."""
    worker = get_worker()
    worker.log_event(name, {"request": request.name, "worker": worker.address})
    if request.name == "stuck":
        time.sleep(3600)
    if request.name == "deadly":
        import os

        os._exit(1)
    return request.name
