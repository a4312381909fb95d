"""Systems of chapter 4: the mirror and its controller on the pinned truss, of full and of reduced order.

Not published, hence taken over from chapter 3: damping. The hub is free, as the pinned-free model has it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fosopt.actuators import Mirror
from fosopt.control import PID, ClosedLoopPoles, Loop, closed_loop_poles, gain_for_crossover
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.transient import Transient, step_error
from fosopt.modes import Hub, ModalFrame, ModalSet, modal_frame
from fosopt.ops import Array
from fosopt.plant import CoupledModes, coupled_modes
from fosopt.reproduce import chapter2_system
from fosopt.reproduce.published import PUBLISHED
from fosopt.units import HZ

CHAPTER = PUBLISHED["chapter_4"]
TABLE = PUBLISHED["table_4_1"]
STRUCTURE_DOF: int = PUBLISHED["table_2_4"]["model_5"]["structure_dof"]
REQUIRED = PUBLISHED["table_3_1"]
PERCENTS: tuple[float, ...] = tuple(CHAPTER["inertia_percent_figures_4_1_to_4_8"])
DWELL = REQUIRED["dwell_time_s"]
WINDOW: tuple[float, float] = (REQUIRED["settling_time_s"], REQUIRED["settling_time_s"] + DWELL)
"""The first rms window after a step [s]."""

UDU = 1e-6
"""A millionth of the commanded step, which is one displacement unit."""

_ROWS = {0.02: "jm_percent_0_02", 0.2: "jm_percent_0_20", 2.0: "jm_percent_2", 20.0: "jm_percent_20"}
TABULATED: tuple[float, ...] = tuple(_ROWS)
"""Mirror inertias of table 4.1, figures 4.11 to 4.17 [%]."""

HELD_HZ, HELD_RATIO = 0.1, 0.7
"""A slow attitude loop, for experiments with a hub that is held."""

Model = Literal["full", "reduced", "elastic", "late", "held", "tip", "turning", "held turning", "rigid"]

MODELS: Mapping[Model, str] = MappingProxyType(
    {
        "full": "all 61 modes",
        "reduced": "the first seven modes, the rigid-body mode among them",
        "elastic": "the rigid-body mode and seven elastic modes",
        "late": "seven modes of the bare truss, the mirror's mass added after the reduction",
        "held": f"the first seven modes, the hub held at {HELD_HZ:g} Hz",
        "tip": "the first seven modes, what acts on the hub acting on the tip",
        "turning": "a truss that does not bend",
        "held turning": f"a truss that does not bend, held at {HELD_HZ:g} Hz",
        "rigid": "no mode, a rigid support",
    }
)
"""Support structures. Section 4.4 speaks of seven elastic modes, section 2.5 of seven modes with the rigid body."""


@cache
def frame() -> ModalFrame:
    """All modes of the pinned-free truss with the mirror's mass at its tip."""
    of = chapter2_system.structure()
    return modal_frame(of, of.area, of.batten_mass, chapter2_system.mirror_mass(), "tip")


@cache
def support(model: Model = "full") -> ModalSet:
    """Support structure at hub and tip."""
    if model == "late":
        return chapter2_system.mirror_structure(False)
    held = model.startswith("held")
    hub = Hub("held", HELD_HZ * HZ, HELD_RATIO) if held else Hub("free")
    full = frame().modal_set(hub, chapter2_system.DAMPING, ("hub", "tip"))
    if model == "tip":
        full = replace(full, mode_shape=np.column_stack([full.at("tip"), full.at("tip")]))
    return full.keep(range(_modes(model)))


def _modes(model: Model) -> int:
    """Number of modes, known before they are."""
    reduced: int = CHAPTER["design_model_structure_dof"]
    others = {"full": STRUCTURE_DOF, "elastic": reduced + 1, "turning": 1, "held turning": 1, "rigid": 0}
    return others.get(model, reduced)


def mirror(percent: float) -> Mirror:
    """The mirror, its inertia in percent of the truss's about the hub."""
    return chapter2_system.mirror(CHAPTER["mirror_frequency_hz"], percent)


def loop(percent: float) -> Loop:
    """The loop designed on a rigid support: its gain gives the crossover there."""
    body, terms = mirror(percent), PUBLISHED["benchmark"]["pid"]
    pid: dict[str, Any] = {name: float(terms[name]) for name in ("kp", "ki", "kd")}
    return Loop(
        body, PID(gain_for_crossover(CHAPTER["crossover_hz"] * HZ, body, rolloff_time=0.0, **pid), **pid)
    )


@cache
def coupled(percent: float) -> CoupledModes:
    """The 62 modes of mirror and structure together, without damping."""
    return coupled_modes(support(), mirror(percent), "tip")


@cache
def closed(percent: float, model: Model = "full") -> tuple[LoopModel, ClosedLoopPoles]:
    """The closed loop and its poles."""
    of = LoopModel(loop(percent), support(model), "tip")
    return of, closed_loop_poles(of.loop, of.modes, of.mirror_port)


@cache
def residual(percent: float, model: Model = "full") -> Transient:
    """Error of the mirror angle after a unit step command."""
    return step_error(*closed(percent, model))


def order(model: Model) -> str:
    """Name of the model with the mirror, such as ``62-dof``."""
    return f"{_modes(model) + 1}-dof"


def printed(percent: float) -> dict[str, float] | str:
    """What table 4.1 prints for a mirror inertia: jitter by source, or that the system is unstable."""
    return TABLE[_ROWS[percent]]


def said(percent: float) -> str:
    """``stable`` or ``unstable``, by table 4.1."""
    return "unstable" if isinstance(printed(percent), str) else "stable"


def growing(percent: float, model: Model) -> list[complex]:
    """Poles that grow, the fastest growing first [rad/s]."""
    poles = closed(percent, model)[1].value
    return sorted((complex(p) for p in poles[poles.real >= 0]), key=lambda p: -p.real)


def stability(percent: float, model: Model) -> str:
    """``stable`` or ``unstable``."""
    return "unstable" if growing(percent, model) else "stable"


def growth(percent: float, model: Model) -> str:
    """How each growing pole grows, in words; or how slowly the loop decays."""
    found = growing(percent, model)
    if not found:
        return f"slowest decay {closed(percent, model)[1].spectral_abscissa:.3f} /s"
    return ", ".join(f"{p.imag / HZ:.1f} Hz grows by {p.real:+.2f} /s" for p in found)


@cache
def structural_lines(percent: float) -> tuple[NDArray[np.intp], Array]:
    """Structural modes in the step response of the full model, in the order of their zeros.

    Returns
    -------
    (n,), (n,)
        Index of the closed-loop pole that belongs to each, and J̄_k of the coupled mode that belongs to it: both
        leave the same zero.
    """
    modes = coupled(percent)
    paired = np.flatnonzero(np.isfinite(modes.zero))
    left = np.abs(closed(percent)[1].base) ** 2
    lines = np.array([int(np.argmin(np.abs(left - zero))) for zero in modes.zero[paired]])
    return lines, modes.effective_modal_reaction_inertia[paired]
