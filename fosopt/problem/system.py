"""A flexible optical system, and one design of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fosopt.control import Loop
from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.step import StepCommand
from fosopt.modes import Damping, Hub
from fosopt.ops import Array
from fosopt.structure import Structure
from fosopt.symbolic import layout_of, loop_of, loop_parameters

_SCALARS = (
    "structural_mass",
    "total_mass",
    "structure_inertia",
    "mirror_inertia",
    "inertia_ratio",
    "reference_inertia",
    "first_elastic_frequency",
    "spectral_abscissa",
    "modulus_margin",
    "loop_crossover",
)
INDEXED = (
    "structure_frequency",
    "natural_frequency",
    "modal_inertia",
    "modal_reaction_inertia",
    "effective_modal_reaction_inertia",
    "pole_zero_separation",
    "participation",
)


@dataclass(frozen=True)
class ModeSelection:
    """Which modes the design model keeps: all, the first `count`, those `below` [rad/s], or those listed.

    `keep` counts from zero.
    """

    count: int | None = None
    below: float | None = None
    keep: tuple[int, ...] | None = None

    def of(self, frequency: Array) -> NDArray[np.intp]:
        """Indices of the kept modes.

        Raises
        ------
        ModelError
            If it keeps none, or one that does not exist.
        """
        n = frequency.size
        if self.count is not None:
            chosen = np.arange(self.count)
        elif self.below is not None:
            chosen = np.flatnonzero(frequency < self.below)
        elif self.keep is not None:
            chosen = np.array(sorted(set(self.keep)))
        else:
            chosen = np.arange(n)
        if chosen.size == 0 or chosen[0] < 0 or chosen[-1] >= n:
            raise ModelError(
                f"modes: the selection keeps {chosen.size} modes of {n}; choose between 1 and {n}"
            )
        return chosen


@dataclass(frozen=True)
class System:
    """Everything about a flexible optical system that does not change with the design."""

    structure: Structure
    mirror_port: str
    hub: Hub
    damping: Damping
    disturbances: tuple[Disturbance, ...] = ()
    step: StepCommand | None = None
    selection: ModeSelection = field(default_factory=ModeSelection)

    def __post_init__(self) -> None:
        names = [d.name for d in self.disturbances]
        if len(set(names)) < len(names):
            raise ModelError(f"disturbances: the names {names} are not unique; rename one")

    @property
    def truth(self) -> System:
        """The same system with all its modes: the model a design is judged on."""
        return replace(self, selection=ModeSelection())

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the scalar metrics."""
        jitter = (
            ("jitter_total", *(f"jitter_{d.name}" for d in self.disturbances)) if self.disturbances else ()
        )
        return (*_SCALARS, *jitter, *(("step_offset", "step_rms") if self.step else ()))


@dataclass(frozen=True)
class Design:
    """One design: what the optimizer chooses, and what it leaves alone.

    Attributes
    ----------
    area, batten_mass, spring_stiffness
        (b,) [m²], (r,) [kg], (s,) of the springs to ground [N/m], [N m/rad].
    mirror_mass
        [kg].
    loop
        Mirror and controller.
    """

    area: Array
    batten_mass: Array
    spring_stiffness: Array
    mirror_mass: float
    loop: Loop

    @property
    def parameters(self) -> Array:
        """(b + r + s + 8,) areas, batten masses, spring stiffnesses and the `symbolic.LOOP_PARAMETERS`."""
        return np.concatenate(
            [self.area, self.batten_mass, self.spring_stiffness, loop_parameters(self.loop)]
        )

    def with_parameters(self, parameters: Array) -> Design:
        """The design with other parameters, in the order of `parameters`."""
        ends = np.cumsum([self.area.size, self.batten_mass.size, self.spring_stiffness.size])
        area, batten_mass, spring_stiffness, loop = np.split(parameters, ends)
        return Design(
            area,
            batten_mass,
            spring_stiffness,
            self.mirror_mass,
            loop_of([float(x) for x in loop], layout_of(self.loop)),
        )
