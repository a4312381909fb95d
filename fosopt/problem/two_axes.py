"""A system whose mirror has two axes at one design: both loops closed, each axis seen in its turn."""

from __future__ import annotations

from functools import cached_property, partial

import numpy as np

from fosopt.errors import ModelError
from fosopt.metrics import margins
from fosopt.metrics.axes import (
    AXES,
    Models,
    axis_models,
    axis_variances,
    multivariable_margin,
    rightmost_poles_of_axes,
    summed,
)
from fosopt.metrics.functional import Functional, LoopModel
from fosopt.metrics.jitter import Variance
from fosopt.ops import Array
from fosopt.problem.evaluation import BRANCHES, Evaluation
from fosopt.problem.found import Found
from fosopt.problem.system import Design, System
from fosopt.symbolic import LOOP_PARAMETERS


def evaluation_of(system: System, design: Design, shift: float = 0.0) -> Evaluation:
    """Evaluation of a design, of a mirror with one axis or two."""
    return (TwoAxisEvaluation if system.two_axes else Evaluation)(system, design, shift)


class TwoAxisEvaluation(Evaluation):
    """A system whose mirror has two axes, at one design.

    `model` and what is drawn of it are about the first axis, with the loop of the second closed. Jitter is that of
    both axes, root sum square; margin and crossover are the least of both. Metrics that end in ``_first_axis`` and
    ``_second_axis`` are about one of them.
    """

    @cached_property
    def models(self) -> Models:
        """The loop about each axis, the other one beside it."""
        return axis_models(self.model)

    @property
    def _mirror_ports(self) -> tuple[str, ...]:
        return tuple(model.mirror_port for model in self.models)

    @cached_property
    def shares(self) -> list[tuple[Variance, Variance]]:
        """Mean square jitter of each disturbance about both axes."""
        return axis_variances(self.models, self.poles, self.system.disturbances, self.shift)

    @cached_property
    def variances(self) -> dict[str, Variance]:
        """Mean square jitter of each disturbance about both axes together, and of all about each axis [rad²]."""
        by_axis = zip(AXES, zip(*self.shares, strict=True), strict=True)
        return {
            f"jitter_{d.name}": summed(both)
            for d, both in zip(self.system.disturbances, self.shares, strict=True)
        } | {f"jitter_{axis}_axis": summed(all_of_it) for axis, all_of_it in by_axis}

    def _compute(self, name: str, index: int | None) -> Found:
        if index is None and name in self.system.metric_names:
            if name == "modulus_margin_multivariable":
                margin = multivariable_margin(self.model, self.poles)
                return Found(margin, partial(_no_gradient, name))
            for axis, word in enumerate(AXES):
                if name == f"modulus_margin_{word}_axis":
                    return self._margins_by_axis[axis][0]
                if name == f"loop_crossover_{word}_axis":
                    return self._crossovers[axis]
            if name == "loop_crossover":
                return min(self._crossovers, key=lambda found: found.value)
        return super()._compute(name, index)

    @cached_property
    def _crossovers(self) -> list[Found]:
        return [self._followed(*margins.crossover(model, self.poles)) for model in self.models]

    @cached_property
    def _margins_by_axis(self) -> list[list[Found]]:
        count = BRANCHES["modulus_margin"]
        return [
            [
                self._followed(float(value), functional)
                for value, functional in zip(*margins.modulus_margins(model, self.poles, count), strict=True)
            ]
            for model in self.models
        ]

    def _followed(self, value: float, functional: Functional) -> Found:
        return Found(value, partial(self._loop_gradient, [functional]))

    @cached_property
    def _margins(self) -> list[Found]:
        every = [found for axis in self._margins_by_axis for found in axis]
        return sorted(every, key=lambda found: found.value)[: BRANCHES["modulus_margin"]]

    @cached_property
    def _decays(self) -> list[Found]:
        rightmost = rightmost_poles_of_axes(self.models, self.poles, BRANCHES["spectral_abscissa"])
        return [Found(real, partial(self._decay_gradient, real, f)) for real, f in rightmost]

    def _in_order(self, model: LoopModel, parameters: Array) -> Array:
        # The model of the second axis has its own parameters before those of the first.
        return parameters if model is self.models[0] else np.roll(parameters, len(LOOP_PARAMETERS))


def _no_gradient(name: str) -> Array:
    raise ModelError(
        f"metric '{name}' has no gradient; judge designs by it, and optimize for 'modulus_margin'"
    )
