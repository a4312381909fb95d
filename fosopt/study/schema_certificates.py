"""Bounds that go with each point of a study: what provably no other design reaches."""

from __future__ import annotations

from typing import Any

from pydantic import SerializerFunctionWrapHandler, model_serializer

from fosopt.study.schema_base import Frequency, Identifier, PositiveFraction, PositiveTime, Section


class PidSearch(Section):
    """Search for the best PID controller of each design, by branch and bound; its limit is of processor time."""

    time_limit: PositiveTime = 10.0
    """Longest processor time per point."""
    gap: PositiveFraction = 0.02
    """Relative distance of design and bound at which the search ends."""


class Receptance(Section):
    """Port and frequency at which no lighter structure may be softer than the design; at zero the static compliance."""

    port: Identifier
    """Port whose receptance the lighter structure must not exceed."""
    frequency: Frequency = 0.0
    """Frequency of the receptance."""


class Certificates(Section):
    """Which bounds to prove: on the mass of the structure, on jitter under any controller and under any PID."""

    structure: bool = True
    """Whether to bound the mass of the structure."""
    receptance: Receptance | None = None
    """Port and frequency of one more bound on the mass; none if left out."""
    any_controller: bool = True
    """Whether to bound jitter under any linear controller."""
    pid: PidSearch | None = PidSearch()
    """Search for the best PID in the box of gains; `null` for none."""

    @model_serializer(mode="wrap")
    def _with_null(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Keep a search that was declined, which would come back as the default if it were left out."""
        return {**handler(self), **({"pid": None} if self.pid is None else {})}
