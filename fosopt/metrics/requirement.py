"""A requirement line: the most that jitter may have accumulated below each frequency, and whether it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fosopt.errors import ModelError
from fosopt.metrics.spectrum import JitterSpectrum
from fosopt.ops import Array

TOLERANCE = 1e-6
"""Jitter may lie above a line by this share of the line's largest value, as a constraint may be violated by."""


@dataclass(frozen=True)
class RequirementLine:
    """Allowed rms over frequency: straight between its corners over the logarithm of frequency, as it is drawn.

    Below its first corner and above its last it allows anything.

    Attributes
    ----------
    frequency
        (n,) ascending and positive [rad/s].
    rms
        (n,) that never falls, because what is accumulated does not either [rad].
    """

    frequency: Array
    rms: Array

    def __post_init__(self) -> None:
        rows = self.frequency.size
        if (
            rows < 2
            or self.rms.size != rows
            or not self.frequency[0] > 0
            or np.any(np.diff(self.frequency) <= 0)
        ):
            raise ModelError(
                f"requirement line: {rows} frequencies and {self.rms.size} values; give two corners or more, "
                "frequencies ascending from above zero"
            )
        if not (np.all(np.isfinite(self.rms)) and self.rms[0] >= 0 and np.all(np.diff(self.rms) >= 0)):
            raise ModelError("requirement line: an allowance is negative, not finite or falls; correct it")
        if not self.rms[-1] > 0:
            raise ModelError("requirement line: it allows nothing at any frequency; give a value above zero")

    def allowed(self, frequency: Array) -> Array:
        """(m,) Allowed rms at frequencies between the first corner and the last [rad]."""
        return np.interp(np.log(frequency), np.log(self.frequency), self.rms)


@dataclass(frozen=True)
class LineVerdict:
    """Whether the cumulative jitter of a design keeps below a line, and where it takes most of what that allows.

    Attributes
    ----------
    frequency
        Where the share of jitter in what is allowed is largest [rad/s].
    reached, allowed
        Rms accumulated below that frequency, and what the line allows there [rad].
    met
        Whether jitter lies nowhere above the line by more than `TOLERANCE` lets it.
    """

    frequency: float
    reached: float
    allowed: float
    met: bool

    @property
    def excess(self) -> float:
        """How far jitter lies above the line there; negative if it lies below everywhere [rad]."""
        return self.reached - self.allowed


def line_verdict(spectrum: JitterSpectrum, line: RequirementLine) -> LineVerdict:
    """Judge the cumulative jitter of all disturbances at every corner of a line and every node between them.

    Neither is thinned: what a figure leaves out of the curve is compared all the same. At corners that are marks of
    the spectrum and at its nodes the integral has the quadrature's accuracy. Between two nodes of a panel the curve is
    smooth, and jitter only grows: it lies above the line by no more than it does at the node that follows, and what the
    line rises between the two.
    """
    inside = (spectrum.frequency >= line.frequency[0]) & (spectrum.frequency <= line.frequency[-1])
    frequency = np.concatenate([line.frequency, spectrum.frequency[inside]])
    squares = np.concatenate([spectrum.below(line.frequency), spectrum.by_source.sum(axis=0)[inside]])
    reached, allowed = np.sqrt(np.maximum(squares, 0.0)), line.allowed(frequency)
    share = reached / (allowed + TOLERANCE * line.rms[-1])
    worst = int(np.argmax(share))
    return LineVerdict(
        float(frequency[worst]),
        float(reached[worst]),
        float(allowed[worst]),
        bool(share[worst] <= 1.0),
    )
