"""A bound, and what it is a bound of."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Bound:
    """A number that no design within the assumptions goes below.

    Attributes
    ----------
    value
        In SI units; `allowance` has been taken off already.
    of
        What it bounds, over which choices.
    assumptions
        Under which it holds, one sentence each.
    allowance
        What was taken off for rounding and quadrature, in the unit of `value`.
    """

    value: float
    of: str
    assumptions: tuple[str, ...]
    allowance: float

    def hold(self, value: float, design: str) -> None:
        """Compare the bound with what a verified design within the assumptions has reached.

        Raises
        ------
        RuntimeError
            If the design is below the bound: a defect of fosopt, never of a design.
        """
        if value < self.value:
            raise RuntimeError(
                f"internal error: {design} reaches {value:.12g}, below the bound {self.value:.12g} of {self.of}; "
                "please report it with the study"
            )
