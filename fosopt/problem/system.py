"""A flexible optical system, and one design of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fosopt.control import Loop
from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.peaks import PEAKS
from fosopt.metrics.requirement import RequirementLine
from fosopt.metrics.sequence import Retargeting
from fosopt.metrics.step import StepCommand
from fosopt.modes import Damping, Hub, ModalFrame, modal_frame, truncated_frame
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
# Of each axis of a mirror with two, and the margin of both loops together.
BY_AXIS = (
    "jitter_first_axis",
    "jitter_second_axis",
    "modulus_margin_first_axis",
    "modulus_margin_second_axis",
    "modulus_margin_multivariable",
    "loop_crossover_first_axis",
    "loop_crossover_second_axis",
)
# From so many degrees of freedom on, modes come from sparse factorizations and those left out leave their flexibility.
LARGE = 500
# A sparse search pays for no more than this share of all modes.
_MOST = 1 / 2
# Solving for all modes of more degrees of freedom than this takes gigabytes.
_WHOLE = 3000
# How many times more modes the truth model of a large structure has.
_TRUTH = 2
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
    """Everything about a flexible optical system that does not change with the design.

    With `as_built`, metrics of a sampled loop are its own, not those of its continuous model. `retargeting` is the
    sequence on which the mirror's stroke, rate and torque are counted, and no optimization knows of `requirement_line`,
    below which the cumulative jitter of a design is to stay. With `two_axes` the mirror turns about two, each
    with a loop of its own: then the loop of every design has the other axis beside it.
    """

    structure: Structure
    mirror_port: str
    hub: Hub
    damping: Damping
    disturbances: tuple[Disturbance, ...] = ()
    step: StepCommand | None = None
    selection: ModeSelection = field(default_factory=ModeSelection)
    as_built: bool = False
    retargeting: Retargeting | None = None
    requirement_line: RequirementLine | None = None
    two_axes: bool = False

    def __post_init__(self) -> None:
        if self.two_axes and (self.step is not None or self.retargeting is not None):
            raise ModelError(
                "two axes: a step command is judged about one axis; remove it, or study one axis at a time"
            )
        names = [d.name for d in self.disturbances]
        if len(set(names)) < len(names):
            raise ModelError(f"disturbances: the names {names} are not unique; rename one")

    @property
    def truncated(self) -> int | None:
        """Number of lowest modes extracted, with residual flexibility beside them; None where all are solved for.

        A truss of more than `LARGE` degrees of freedom of which a number of modes is kept, half of all at most.

        Raises
        ------
        ModelError
            If too large a structure would be solved for all its modes.
        """
        n, count = len(self.structure.dofs), self.selection.count
        if n > LARGE and count is not None and count <= _MOST * n and self.structure.truss.bars:
            return count
        if n > _WHOLE:
            rows = self.structure.stiffness_rows.shape[0] + self.structure.mass_rows.shape[0]
            size = 8 * n * (rows + 4 * n) / 2**30
            raise ModelError(
                f"modes: all modes of {n} degrees of freedom would take about {size:.0f} GiB; "
                f"keep a number of the lowest, {int(_MOST * n)} at most"
            )
        return None

    def frame(self, design: Design) -> ModalFrame:
        """Eigenbasis of the structure at a design."""
        sizes = design.area, design.batten_mass, design.mirror_mass
        count, springs = self.truncated, design.spring_stiffness
        if count is None:
            return modal_frame(self.structure, *sizes, self.mirror_port, springs)
        ports = (self.mirror_port, "hub", *design.loop.other_ports)
        return truncated_frame(self.structure, *sizes, ports, count, springs)

    @property
    def truth(self) -> System:
        """The model a design is judged on: all modes, of a large structure twice as many as the design model has."""
        n, count = len(self.structure.dofs), self.truncated
        if count is None:
            return replace(self, selection=ModeSelection())
        more, most = _TRUTH * count, int(_MOST * n)
        whole = ModeSelection(most) if n > _WHOLE else ModeSelection()
        return replace(self, selection=ModeSelection(more) if more <= most else whole)

    @property
    def model(self) -> str:
        """What design and truth model have of the structure's modes, in words."""
        n = len(self.structure.dofs)
        if self.truncated is None:
            return f"all {n}" if self.selection == ModeSelection() else f"some of {n}, judged on all"
        judged = self.truth.truncated or n
        return f"the first {self.truncated} of {n} with residual flexibility, judged on {judged}"

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the scalar metrics."""
        jitter = (
            ("jitter_total", *(f"jitter_{d.name}" for d in self.disturbances)) if self.disturbances else ()
        )
        if self.two_axes:
            jitter = (*jitter, *(name for name in BY_AXIS if jitter or not name.startswith("jitter_")))
        step = ("step_offset", "step_rms") if self.step else ()
        return (*_SCALARS, *jitter, *step, *(PEAKS if self.retargeting else ()))


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
        """(b + r + s + 8,) areas, batten masses, spring stiffnesses and the `symbolic.LOOP_PARAMETERS`.

        Those of a second axis follow.
        """
        return np.concatenate(
            [self.area, self.batten_mass, self.spring_stiffness, loop_parameters(self.loop)]
        )

    @property
    def loop_start(self) -> int:
        """Where in `parameters` those of the loop begin, the mirror's inertia first."""
        return self.area.size + self.batten_mass.size + self.spring_stiffness.size

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
