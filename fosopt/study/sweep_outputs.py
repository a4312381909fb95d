"""Outputs of a sweep at its points: closed-loop metrics one by one, coupled modes all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, nan
from typing import Any

import numpy as np

from fosopt.errors import FosoptError, ModelError, UnstableError
from fosopt.expressions import Expression
from fosopt.metrics.inertias import modal_inertia
from fosopt.ops import Array
from fosopt.plant import CoupledModes
from fosopt.problem import Design, Evaluation
from fosopt.study.schema_sweep import STABLE, Sweep, array_of
from fosopt.study.sweep_points import Bench, Row

OF_STRUCTURE = ("structure_frequency", "modal_inertia")
"""Outputs of the modes of the structure alone; the others are of the coupled modes."""
_NEEDS_LOOP = ("spectral_abscissa", "modulus_margin", "loop_crossover")
_NEEDS_STABILITY = ("jitter_", "step_", "modulus_margin")


@dataclass
class Tally:
    """What became of the points so far."""

    unstable: int = 0
    failed: int = 0
    reason: str | None = None

    def fail(self, error: Exception) -> None:
        """Count a point without all its values."""
        self.failed += 1
        self.reason = self.reason or str(error)


@dataclass(frozen=True)
class Chunk:
    """Results at m consecutive points: (m, s) scalars and (m, n) arrays by name, NaN for what has no value."""

    scalars: Array
    arrays: dict[str, Array]


@dataclass(frozen=True)
class Outputs:
    """What a sweep computes.

    Attributes
    ----------
    scalars
        Expressions of metrics; `stable` is one of them by name only.
    arrays
        Metrics of every mode.
    """

    scalars: tuple[Expression, ...]
    arrays: tuple[str, ...]
    tally: Tally = field(default_factory=Tally)

    @classmethod
    def of(cls, sweep: Sweep) -> Outputs:
        """The outputs of a sweep in the order of its file."""
        arrays = tuple(o.text for o in sweep.outputs if array_of(o.text) is not None)
        return cls(tuple(o for o in sweep.outputs if array_of(o.text) is None), arrays)

    @property
    def needs_loop(self) -> bool:
        """Whether closed-loop poles are needed."""
        return any(_asks(e, (STABLE, *_NEEDS_LOOP, *_NEEDS_STABILITY)) for e in self.scalars)

    def widths(self, modes: int, coupled: int) -> dict[str, int]:
        """Columns of each array where the structure has a number of modes, and all bodies together another."""
        return {name: modes if name in OF_STRUCTURE else coupled for name in self.arrays}

    def chunk(self, bench: Bench, rows: Sequence[Row], widths: dict[str, int]) -> Chunk:
        """All outputs at points on one structure."""
        found = Chunk(
            np.full((len(rows), len(self.scalars)), nan),
            {name: np.full((len(rows), width), nan) for name, width in widths.items()},
        )
        made = [(k, self._design(bench, row)) for k, row in enumerate(rows)]
        places = [k for k, design in made if design is not None]
        designs = [design for _, design in made if design is not None]
        if not designs:
            return found
        evaluations = self._evaluations(bench, designs)
        for k, evaluation in zip(places, evaluations if self.scalars else (), strict=False):
            self._scalars(evaluation, found.scalars[k])
        self._arrays(bench, places, evaluations, found.arrays)
        return found

    def _evaluations(self, bench: Bench, designs: Sequence[Design]) -> list[Evaluation]:
        if self.needs_loop:
            try:
                return bench.first.neighbors(designs)
            except FosoptError:
                pass  # each of them says what is wrong with it
        return [bench.first.neighbor(design) for design in designs]

    def _design(self, bench: Bench, row: Row) -> Design | None:
        try:
            return bench.design(row)
        except FosoptError as error:
            self.tally.fail(error)
            return None

    def _scalars(self, evaluation: Evaluation, into: Array) -> None:
        try:
            stable = not self.needs_loop or evaluation.stable
        except FosoptError as error:
            self.tally.fail(error)
            return
        self.tally.unstable += not stable
        failure: FosoptError | None = None
        for k, expression in enumerate(self.scalars):
            if expression.text == STABLE:
                into[k] = float(stable)
            elif stable or not _asks(expression, _NEEDS_STABILITY):
                try:
                    into[k] = expression.evaluate(evaluation.value)
                except (UnstableError, ModelError):
                    pass  # it has no value here: a mirror mode has no zero, an unstable loop no jitter
                except FosoptError as error:
                    failure = failure or error
        if failure is not None:
            self.tally.fail(failure)

    def _arrays(
        self, bench: Bench, places: Sequence[int], evaluations: Sequence[Evaluation], into: dict[str, Array]
    ) -> None:
        first = bench.first
        for name in set(into) & set(OF_STRUCTURE):
            own = first.modes.natural_frequency if name == "structure_frequency" else _modal(first)
            into[name][:, : own.size] = own
        names = [name for name in into if name not in OF_STRUCTURE]
        if not names:
            return
        mirrors = [each.design.loop.mirror for each in evaluations]
        if evaluations[0].design.loop.plain:
            # numba takes a while to import, and only this needs it.
            from fosopt.plant.sweep import coupled_sweep

            inertia = np.array([mirror.inertia for mirror in mirrors])
            frequency = np.array([mirror.natural_frequency for mirror in mirrors])
            swept = coupled_sweep(first.modes, bench.system.mirror_port, inertia, frequency)
            for name in names:
                values = _mode_values(swept, name, inertia[:, None])
                into[name][places, : values.shape[1]] = values
            return
        for k, evaluation, mirror in zip(places, evaluations, mirrors, strict=True):
            for name in names:
                values = _mode_values(evaluation.coupled, name, mirror.inertia)
                into[name][k, : values.size] = values


def _modal(evaluation: Evaluation) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(modal_inertia(evaluation.modes, evaluation.system.mirror_port))


def _mode_values(modes: CoupledModes | Any, name: str, inertia: Any) -> Array:
    """A metric of every coupled mode; NaN where the mirror mode has none."""
    if name == "modal_reaction_inertia":
        reaction = modes.effective_modal_reaction_inertia
        return np.divide(inertia, reaction, out=np.full(reaction.shape, inf), where=reaction != 0)
    if name == "participation":
        return 1 + np.asarray(modes.separation)
    return np.asarray(getattr(modes, name))


def _asks(expression: Expression, starts: Sequence[str]) -> bool:
    return any(name.startswith(tuple(starts)) for name, _ in expression.references)
