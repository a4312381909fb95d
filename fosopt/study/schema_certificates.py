"""Bounds that go with each point of a study: what provably no other design reaches."""

from __future__ import annotations

from fosopt.study.schema_base import PositiveFraction, PositiveTime, Section


class PidSearch(Section):
    """Search for the best PID controller of each design, by branch and bound."""

    time_limit: PositiveTime = 10.0
    gap: PositiveFraction = 0.02


class Certificates(Section):
    """Which bounds to prove: on the mass of the structure, on jitter under any controller and under any PID."""

    structure: bool = True
    any_controller: bool = True
    pid: PidSearch | None = PidSearch()
