"""Sweeps of loops that are no bicollocated mirrors: stability and jitter against Schur-based Lyapunov solves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, pi

import common
import numpy as np
import sweep
from numpy.typing import NDArray
from scipy import signal

from fosopt.actuators import MirrorReactionMass, Placement, ReactionMassActuator
from fosopt.control import Loop, closed_loop_response, closed_loop_state_space
from fosopt.metrics.jitter import resonance_quadrature
from fosopt.problem import Design, Evaluation, System
from fosopt.structure import assemble, barker_truss, structure_inertia

Array = NDArray[np.float64]
StateSpace = tuple[Array, Array, Array]

TITLE = "Sweeps of loops of any placement"
REPEATS = 3
ALONE = 20  # points taken one by one, whose time stands for all
MID_SPAN = Placement(reaction="middle")
MISMATCH = MirrorReactionMass(0.9, 0.95, 1.1)
ABSORBERS = (
    ReactionMassActuator("third.y", 2.0, 30 * sweep.HZ, 0.02),
    ReactionMassActuator("sixth.y", 1.0, 10 * sweep.HZ, 0.05),
)
CASES: dict[str, Callable[[Loop], Loop]] = {
    "reaction at mid-span": lambda loop: replace(loop, placement=MID_SPAN),
    "reactionless mirror": lambda loop: _reactionless(loop),
    "both, two reaction-mass actuators": lambda loop: replace(
        _reactionless(loop), placement=MID_SPAN, actuators=ABSORBERS
    ),
}

NOTES = """\
The system of the section above with other loops: the control torque reacts at the tenth bay instead of at the mirror's
port; the mirror has a reaction mass whose inertia, stiffness and torque are 90, 95 and 110 % of its own; two
reaction-mass actuators sit on the truss as well. Times are processor seconds for {count} inertia ratios, medians of
{repeats}; *one by one* is fosopt's route for a single design, warm from the point before, at {alone} points. Of the
state spaces, with {states} states, only their Schur forms (LAPACK dgees) and triangular Lyapunov solves are counted.
fosopt takes {chunk} loops at a time. Where the two differ most, an integral over frequency, in which nothing cancels,
says which of them is off."""


@dataclass(frozen=True)
class Case:
    """Loops over the mirror's inertia on one structure."""

    first: Evaluation
    designs: list[Design]


def _reactionless(loop: Loop) -> Loop:
    return replace(loop, mirror=replace(loop.mirror, reaction_mass=MISMATCH))


def case(form: Callable[[Loop], Loop], count: int) -> Case:
    """The dissertation's truss and mirror with loops of another form."""
    truss = barker_truss()
    ports = {"middle": ("B10", "rz"), "third.y": ("B3", "y"), "sixth.y": ("B6", "y")}
    structure = assemble(replace(truss, ports=truss.ports | ports), "tip")
    plain, design = sweep.system_and_design()
    system: System = replace(plain, structure=structure)
    about_hub = float(structure_inertia(structure, design.area, design.batten_mass))
    ratios = np.geomspace(*sweep.RANGE, count)
    designs = [replace(design, loop=form(sweep.loop_of(float(r * about_hub)))) for r in ratios]
    return Case(Evaluation(system, designs[count // 2]), designs)


def together(of: Case) -> Array:
    """(m,) Total jitter, NaN where unstable."""
    jitter = np.full(len(of.designs), np.nan)
    for begin in range(0, len(of.designs), sweep.CHUNK):
        points = of.first.neighbors(of.designs[begin : begin + sweep.CHUNK])
        for k, point in enumerate(points, begin):
            if point.stable:
                jitter[k] = point.value("jitter_total")
    return jitter


def one_by_one(of: Case, designs: Sequence[Design]) -> Array:
    """The same, each point from the one before."""
    jitter, point = np.full(len(designs), np.nan), of.first
    for k, design in enumerate(designs):
        point = point.neighbor(design)
        if point.stable:
            jitter[k] = point.value("jitter_total")
    return jitter


def state_space(of: Case, design: Design) -> StateSpace:
    """Loop and shaping filters as ẋ = A x + B w, c x with white noises w, in states of like size."""
    modes, disturbances = of.first.modes, of.first.system.disturbances
    loop = closed_loop_state_space(design.loop, modes, "tip")
    mirror, controller = design.loop.mirror, design.loop.controller
    n, pace = loop.a.shape[0], np.sqrt(controller.gain * controller.kp / mirror.inertia)
    bodies = [body for _, body in design.loop.attachments]
    # Every coordinate as a velocity, times the root of its inertia; modal ones are so already.
    mass = np.sqrt([mirror.inertia, *(body.inertia for body in bodies)])
    rate = np.array([pace, *(np.sqrt(body.stiffness / body.inertia) for body in bodies)])
    turning = np.append(np.ones(modes.natural_frequency.size), mass)
    moving = np.append(modes.natural_frequency, mass * rate)
    scale = np.concatenate([moving, turning, [mass[0] * pace**2]])
    a, b = scale[:, None] * loop.a / scale, scale[:, None] * loop.b
    c = loop.c[loop.outputs.index("line_of_sight")] / scale
    d = loop.d[loop.outputs.index("line_of_sight")]
    white = np.zeros((n, 0))
    for disturbance in disturbances:
        shape = disturbance.filter
        assert shape is not None
        inner, into, out, direct = signal.tf2ss(shape.numerator, shape.denominator)
        column = loop.inputs.index(disturbance.at)
        size, order = a.shape[0], inner.shape[0]
        through = np.zeros(size)
        through[:n] = b[:, column]
        a = np.block([[a, np.outer(through, out)], [np.zeros((order, size)), inner]])
        noise = np.vstack([through[:, None] * direct, into])
        white = np.hstack([np.vstack([white, np.zeros((order, white.shape[1]))]), noise])
        c = np.append(c, d[column] * out)
    return a, white, c


def by_schur(spaces: Sequence[StateSpace]) -> Array:
    """(m,) Total jitter from one Schur form each, NaN where unstable."""
    return np.array([sweep.schur_jitter(*space) for space in spaces])


def by_quadrature(of: Case, design: Design) -> float:
    """Total jitter by integrals over frequency, in which nothing cancels."""
    point = of.first.neighbor(design)
    total = 0.0
    for disturbance in point.system.disturbances:
        assert disturbance.filter is not None
        every = np.concatenate([point.poles.all, disturbance.filter.poles])
        nodes, weights = resonance_quadrature(every, 0.0, inf, np.geomspace(1e-2, 1e6, 400))
        at = point.model.points(1j * nodes)
        response = closed_loop_response(disturbance.at, design.loop, at.s, at.g)
        density = disturbance.one_sided_psd(nodes) * np.abs(response) ** 2
        total += float(np.sum(weights * density)) / (2 * pi)
    return float(np.sqrt(total))


def measure(name: str, form: Callable[[Loop], Loop]) -> tuple[tuple[str, ...], tuple[str, ...], int]:
    """Rows of times and of agreement, and the number of states."""
    of = case(form, sweep.CLOSED)
    few = of.designs[:: len(of.designs) // ALONE]
    ours = common.median_seconds(lambda: together(of), REPEATS)
    alone = common.median_seconds(lambda: one_by_one(of, few), 1) / len(few) * len(of.designs)
    spaces = [state_space(of, design) for design in of.designs]
    schur = common.median_seconds(lambda: by_schur(spaces), 1)
    jitter, expected = together(of), by_schur(spaces)
    if not np.array_equal(np.isnan(jitter), np.isnan(expected)):
        raise SystemExit(f"not comparable: stability differs ({name})")
    stable = ~np.isnan(expected)
    different = np.where(stable, np.abs(jitter / expected - 1), 0.0)
    worst = int(np.argmax(different))
    judge = by_quadrature(of, of.designs[worst])
    ours_off, schur_off = (abs(float(value) / judge - 1) for value in (jitter[worst], expected[worst]))
    times = (f"{ours:.2f}", f"{alone:.1f}", f"{alone / ours:.1f}", f"{schur:.2f}", f"{schur / ours:.1f}")
    unstable = str(int((~stable).sum()))
    return (
        (name, *times, "≥ 15"),
        (name, unstable, unstable, f"{different[worst]:.1e}", f"{ours_off:.0e}", f"{schur_off:.0e}"),
        spaces[0][0].shape[0],
    )


def main() -> None:
    """Measure and write the section."""
    rows = [measure(name, form) for name, form in CASES.items()]
    last = case(CASES["both, two reaction-mass actuators"], sweep.CLOSED)
    text = "\n\n".join(
        [
            common.table(
                ["", "fosopt [s]", "one by one [s]", "ratio", "Schur form each [s]", "ratio", "target"],
                [times for times, _, _ in rows],
            ),
            common.table(
                [
                    "",
                    "unstable",
                    "by Schur",
                    "largest relative difference of the jitter (≤ 1e-9 wanted)",
                    "there, fosopt off a quadrature",
                    "Schur off it",
                ],
                [agreement for _, agreement, _ in rows],
            ),
            NOTES.format(
                count=sweep.CLOSED,
                repeats=REPEATS,
                alone=ALONE,
                chunk=sweep.CHUNK,
                states=" to ".join(str(n) for n in sorted({rows[0][2], rows[-1][2]})),
            ),
            common.table(
                ["the last case by module", "share"], common.profile_by_module(lambda: together(last))
            ),
        ]
    )
    print(text)
    common.write_section(TITLE, text)


if __name__ == "__main__":
    common.one_thread()
    main()
