"""Metrics of the loop as built, sampled, which stand in for those of its continuous model on the truth model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

from fosopt.errors import ModelError
from fosopt.metrics.sampled import SampledModel
from fosopt.metrics.sampled_steps import sampled_peaks, sampled_step_metrics
from fosopt.ops import Array
from fosopt.problem.system import System

_MARGINS = ("spectral_abscissa", "modulus_margin", "loop_crossover")


@dataclass(frozen=True)
class AsBuilt:
    """A sampled loop in its system, each metric computed once when first asked for."""

    model: SampledModel
    system: System

    @staticmethod
    def has(name: str) -> bool:
        """Whether a metric has another value on the sampled loop than on its continuous model."""
        return name in _MARGINS or name.startswith(("jitter_", "step_", "peak_"))

    def value(self, name: str) -> float:
        """Value of a metric of the sampled loop, SI units.

        Raises
        ------
        UnstableError
            For jitter, step metrics and peaks of an unstable loop.
        """
        if name in _MARGINS:
            return float(getattr(self.model, name))
        if name.startswith("step_"):
            return self._step[name]
        if name.startswith("peak_"):
            return self._peaks[name]
        squares = self.model.variances
        if name == "jitter_total":
            return sqrt(sum(squares.values()))
        return sqrt(squares[name.removeprefix("jitter_")])

    @cached_property
    def _step(self) -> dict[str, float]:
        assert self.system.step is not None
        return sampled_step_metrics(self.model.bare, self.system.step)

    @cached_property
    def _peaks(self) -> dict[str, float]:
        assert self.system.retargeting is not None
        return sampled_peaks(self.model.bare, self.system.retargeting)


def no_gradient(name: str) -> Array:
    """Stand in for the gradient of a metric of the loop as built.

    Raises
    ------
    ModelError
        Always: it has none.
    """
    raise ModelError(
        f"metric '{name}' of the loop as built has no gradient; judge designs by it, optimize by another one"
    )
