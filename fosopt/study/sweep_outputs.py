"""Outputs of a sweep at its points: closed-loop metrics one by one, coupled modes all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, nan
from typing import Any

import numpy as np

from fosopt.control import Loop
from fosopt.errors import FosoptError, ModelError, UnstableError
from fosopt.expressions import Expression
from fosopt.metrics.inertias import modal_inertia
from fosopt.ops import Array
from fosopt.plant import CoupledModes
from fosopt.problem import Design, Evaluation
from fosopt.study.schema_sweep import STABLE, Sweep, array_of
from fosopt.study.sweep_points import Bench, Row

_OF_STRUCTURE = ("structure_frequency", "modal_inertia")
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

    def widths(self, modes: int) -> dict[str, int]:
        """Columns of each array where the design model keeps a number of modes."""
        return {name: modes + (name not in _OF_STRUCTURE) for name in self.arrays}

    def chunk(self, bench: Bench, rows: Sequence[Row], widths: dict[str, int]) -> Chunk:
        """All outputs at points on one structure."""
        found = Chunk(
            np.full((len(rows), len(self.scalars)), nan),
            {name: np.full((len(rows), width), nan) for name, width in widths.items()},
        )
        designs: list[Design | None] = [self._design(bench, row) for row in rows]
        last = bench.first
        for k, design in enumerate(designs):
            if design is not None and (self.scalars or not design.loop.plain):
                last = last.neighbor(design)
                self._scalars(last, found.scalars[k])
        self._arrays(bench, designs, found.arrays)
        return found

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

    def _arrays(self, bench: Bench, designs: Sequence[Design | None], into: dict[str, Array]) -> None:
        if not into:
            return
        evaluation = bench.first
        for name in set(into) & set(_OF_STRUCTURE):
            modes = evaluation.modes
            own = modes.natural_frequency if name == "structure_frequency" else _modal(evaluation)
            into[name][:, : own.size] = own
        names = [name for name in into if name not in _OF_STRUCTURE]
        good = [k for k, design in enumerate(designs) if design is not None]
        loops: list[Loop] = [designs[k].loop for k in good]  # type: ignore[union-attr]
        if not names or not good:
            return
        if loops[0].plain:
            # numba takes a while to import, and only this needs it.
            from fosopt.plant.sweep import coupled_sweep

            inertia = np.array([loop.mirror.inertia for loop in loops])
            frequency = np.array([loop.mirror.natural_frequency for loop in loops])
            swept = coupled_sweep(evaluation.modes, bench.system.mirror_port, inertia, frequency)
            for name in names:
                values = _mode_values(swept, name, inertia[:, None])
                into[name][good, : values.shape[1]] = values
            return
        for k in good:
            design = designs[k]
            assert design is not None
            coupled = evaluation.neighbor(design).coupled
            for name in names:
                values = _mode_values(coupled, name, design.loop.mirror.inertia)
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
