"""Sweeps of the mirror's inertia: coupled modes against `eigh`, closed loops against Schur-based Lyapunov solves."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal, localcontext
from math import pi

import common
import numpy as np
from numpy.typing import NDArray
from plain_model import Numbers, closed_loop_of
from scipy import linalg
from scipy.linalg import lapack

from fosopt.actuators import Mirror
from fosopt.control import PID, Loop, gain_for_crossover
from fosopt.metrics.disturbances import Disturbance, high_pass, low_pass
from fosopt.modes import Damping, Hub, ModalSet
from fosopt.plant.sweep import CoupledSweep, coupled_sweep
from fosopt.problem import Design, Evaluation, System
from fosopt.structure import assemble, barker, barker_truss, structure_inertia

Array = NDArray[np.float64]

HZ = 2 * pi
TITLE = "Sweeps of the mirror's inertia"
REPEATS = 5
COUPLED, CLOSED, CHUNK = 10_000, 1_000, 256  # points, and how many loops a sweep takes at a time
RANGE = (2e-5, 0.2)  # inertia ratios, the dissertation's
MIRROR_FREQUENCY, MIRROR_DAMPING = 20 * HZ, 0.01
HUB_BANDWIDTH, HUB_DAMPING, DAMPING = 0.1 * HZ, 0.7, 0.001
KP, KI, KD, CROSSOVER = 600.0, 5e4, 1.0, 230 * HZ
MIRROR_MASS = 7 / 3 * barker.TOTAL_MASS
COOLING, AFT_BODY = (10 * HZ, 5.0), (10 * HZ, 150.0)  # corner and rms torque [N m]
TURBULENCE, NOISE = (8.5 * HZ, 20e-6), (70 * HZ, 0.2e-6)
CHECKED = 40  # separations compared with arithmetic of fifty digits, besides the least
DIGITS = 50

NOTES = """\
Times are processor seconds, medians of {repeats}. Coupled modes: frequencies, zeros, β_k, 1 − β_k and J̄_k of {modes}
modes at {coupled} inertia ratios; `eigh` of the symmetric matrix in modal coordinates, with eigenvectors, which J̄_k
needs. Errors of 1 − β_k are relative to arithmetic of fifty digits, at the least one and {checked} at random.

Closed loops: stability and total jitter under four disturbances at {closed} inertia ratios of the full-order system,
the modes of the truss known to both. fosopt takes {chunk} loops at a time. SciPy: the balanced state space of mirror,
loop and shaping filters with {states} states, one real Schur form (LAPACK dgees) for poles and covariance. With
`eigvals` and `solve_continuous_lyapunov` most of that work is done twice.

Where the time goes: coupled modes are one compiled loop, {term} ns for each pair of a root and a pole, two or three
steps of one division each; the divider of the processor bounds it. Closed loops take two steps per pole on average;
sums over modes and poles are compiled, the characteristic function in between is NumPy on a few thousand points at a
time, which memory bounds. The profile is cProfile's, libraries counted to the module that called them."""


def system_and_design() -> tuple[System, Design]:
    """The dissertation's truss, mirror and loop."""
    structure = assemble(barker_truss(), "tip")
    system = System(
        structure,
        "tip",
        Hub("held", HUB_BANDWIDTH, HUB_DAMPING),
        Damping((DAMPING,)),
        (
            Disturbance("cooling", "mirror_torque", low_pass(*COOLING)),
            Disturbance("aft_body", "hub_torque", low_pass(*AFT_BODY, order=2)),
            Disturbance("turbulence", "line_of_sight", low_pass(*TURBULENCE)),
            Disturbance("noise", "sensor_noise", high_pass(*NOISE)),
        ),
    )
    sizes = structure.area, structure.batten_mass, structure.spring_stiffness
    return system, Design(*sizes, MIRROR_MASS, loop_of(1.0))


def loop_of(inertia: float) -> Loop:
    """Mirror and controller, which crosses over at the same frequency on a rigid support."""
    mirror = Mirror(inertia, MIRROR_FREQUENCY, MIRROR_DAMPING)
    return Loop(mirror, PID(gain_for_crossover(CROSSOVER, mirror, KP, KI, KD, 0.0), KP, KI, KD))


def coupled_matrix(modes: ModalSet, inertia: float) -> Array:
    """Stiffness in modal coordinates and the mirror's angle times √J_m, where the mass is the identity."""
    n, shape = modes.stiffness.size, modes.at("tip")
    k = inertia * MIRROR_FREQUENCY**2
    matrix = np.zeros((n + 1, n + 1))
    matrix[:n, :n] = np.diag(modes.stiffness) + k * np.outer(shape, shape)
    matrix[:n, n] = matrix[n, :n] = -k * shape / np.sqrt(inertia)
    matrix[n, n] = k / inertia
    return matrix


def reaction_inertias(shape: Array, inertia: float, vectors: Array) -> Array:
    """J̄_k = J_m φ_jk (φ_jk − φ_hk) from eigenvectors."""
    mirror, port = vectors[..., -1, :] / np.sqrt(inertia), shape @ vectors[..., :-1, :]
    return inertia * mirror * (mirror - port)


def by_eigh(modes: ModalSet, inertia: Array) -> tuple[Array, Array]:
    """Eigenvalues and J̄_k, one point after another."""
    shape = modes.at("tip")
    found = []
    for j in inertia:
        values, vectors = linalg.eigh(coupled_matrix(modes, j), check_finite=False)
        found.append((values, reaction_inertias(shape, j, vectors)))
    values, reaction = zip(*found, strict=True)
    return np.array(values), np.array(reaction)


def by_batched_eigh(modes: ModalSet, inertia: Array) -> tuple[Array, Array]:
    """The same from NumPy's stacked `eigh`."""
    n, shape = modes.stiffness.size, modes.at("tip")
    matrix = np.zeros((inertia.size, n + 1, n + 1))
    k = inertia * MIRROR_FREQUENCY**2
    matrix[:, :n, :n] = np.diag(modes.stiffness) + k[:, None, None] * np.outer(shape, shape)
    matrix[:, n, :n] = -(k / np.sqrt(inertia))[:, None] * shape
    matrix[:, :n, n] = matrix[:, n, :n]
    matrix[:, n, n] = k / inertia
    values, vectors = np.linalg.eigh(matrix)
    mirror = vectors[:, -1] / np.sqrt(inertia)[:, None]
    return values, inertia[:, None] * mirror * (mirror - shape @ vectors[:, :n])


def everything(modes: ModalSet, inertia: Array) -> tuple[CoupledSweep, Array, Array, Array]:
    """All that is compared, from the secular equation."""
    swept = coupled_sweep(modes, "tip", inertia, MIRROR_FREQUENCY)
    return swept, swept.natural_frequency, swept.pole_zero_separation, swept.one_minus_separation


def exact_one_minus(modes: ModalSet, inertia: float, zero: float, distance: float) -> Decimal:
    """1 − β_k by Newton's method on the secular equation with fifty digits, from a distance that is nearly right."""
    with localcontext() as context:
        context.prec = DIGITS
        poles = [Decimal(float(p)) for p in modes.stiffness]
        weights = [Decimal(float(w)) for w in modes.at("tip") ** 2]
        square, z = Decimal(MIRROR_FREQUENCY**2), Decimal(zero)
        k, x = Decimal(float(inertia * MIRROR_FREQUENCY**2)), Decimal(distance)
        own = min(range(len(poles)), key=lambda i: abs(poles[i] - z))
        for _ in range(8):
            # F times the own pole's distance, which is smooth there.
            rest = sum(
                w / (p - z - x) for i, (p, w) in enumerate(zip(poles, weights, strict=True)) if i != own
            )
            slope = sum(
                w / (p - z - x) ** 2 for i, (p, w) in enumerate(zip(poles, weights, strict=True)) if i != own
            )
            f = square - (z + x) * (1 + k * rest)
            f_slope = -(1 + k * rest) - (z + x) * k * slope
            value = x * f + (z + x) * k * weights[own]
            x -= value / (f + x * f_slope + k * weights[own])
        return 1 - (1 + x / z).sqrt() if abs(x / z) > Decimal("1e-20") else -x / z / (1 + (1 + x / z).sqrt())


def separation_errors(
    modes: ModalSet, inertia: Array, swept: CoupledSweep, eigenvalues: Array
) -> list[tuple[str, ...]]:
    """Worst relative errors of 1 − β_k."""
    one_minus = swept.one_minus_separation
    size = np.abs(np.where(one_minus == 0, np.nan, one_minus))
    rng = np.random.default_rng(1)
    picked = [np.unravel_index(np.nanargmin(size), size.shape)]
    while len(picked) < CHECKED + 1:
        q, k = int(rng.integers(inertia.size)), int(rng.integers(size.shape[1]))
        if np.isfinite(size[q, k]):
            picked.append((q, k))
    ours, theirs = [], []
    for q, k in picked:
        zero = float(swept.zero[q, k])
        exact = exact_one_minus(modes, inertia[q], zero, float(swept.separation[q, k]) * zero)
        ours.append(abs(float((Decimal(float(one_minus[q, k])) - exact) / exact)))
        plain = 1 - np.sqrt(eigenvalues[q, k] / zero)
        theirs.append(abs(float((Decimal(float(plain)) - exact) / exact)))
    return [
        ("least \\|1 − β_k\\|", f"{np.nanmin(size):.1e}", "", ""),
        ("largest relative error of 1 − β_k", f"{max(ours):.1e}", f"{max(theirs):.1e}", "≤ 1e-10"),
    ]


def by_poles(first: Evaluation, inertia: Array) -> Array:
    """(m,) Total jitter, NaN where unstable."""
    jitter = np.full(inertia.size, np.nan)
    for begin in range(0, inertia.size, CHUNK):
        designs = [replace(first.design, loop=loop_of(float(j))) for j in inertia[begin : begin + CHUNK]]
        for k, point in enumerate(first.neighbors(designs), begin):
            if point.stable:
                jitter[k] = point.value("jitter_total")
    return jitter


def closed_loop(modes: ModalSet, inertia: float) -> tuple[Array, Array, Array]:
    """State space of loop and filters as plain NumPy has it."""
    numbers = Numbers(
        *(0,) * 10,
        MIRROR_FREQUENCY,
        MIRROR_DAMPING,
        HUB_BANDWIDTH,
        HUB_DAMPING,
        DAMPING,
        loop_of(inertia).controller.gain,
        COOLING,
        AFT_BODY,
        TURBULENCE,
        NOISE,
    )
    frequency, ratio = modes.natural_frequency, modes.damping_ratio
    return closed_loop_of(numbers, frequency, ratio, modes.at("hub"), modes.at("tip"), inertia, KP, KI, KD)


def by_schur(modes: ModalSet, inertia: Array) -> Array:
    """The same from one Schur form per point."""
    return np.array([schur_jitter(*closed_loop(modes, float(j))) for j in inertia])


def schur_jitter(a: Array, b: Array, c: Array) -> float:
    """Rms of c x with ẋ = a x + b w and white noises w of unit density, NaN where unstable."""
    t, _, real, _, u, _, info = lapack.dgees(lambda x, y: None, a)
    assert info == 0
    if real.max() >= 0:
        return np.nan
    right = u.T @ b
    x, scale, info = lapack.dtrsyl(t, t, -right @ right.T, tranb="T")
    assert info == 0
    row = c @ u
    return float(np.sqrt(row @ x @ row * scale))


def by_lyapunov(modes: ModalSet, inertia: Array) -> Array:
    """The same from SciPy's own solver."""
    jitter = np.full(inertia.size, np.nan)
    for k, j in enumerate(inertia):
        a, b, c = closed_loop(modes, float(j))
        if linalg.eigvals(a).real.max() < 0:
            jitter[k] = np.sqrt(c @ linalg.solve_continuous_lyapunov(a, -b @ b.T) @ c)
    return jitter


def main() -> None:
    """Measure and write the section."""
    system, design = system_and_design()
    first = Evaluation(system, design)
    modes = first.modes
    about_hub = float(structure_inertia(system.structure, design.area, design.batten_mass))
    inertia = about_hub * np.geomspace(*RANGE, COUPLED)
    ours = common.median_seconds(lambda: everything(modes, inertia), REPEATS)
    loop = common.median_seconds(lambda: by_eigh(modes, inertia), REPEATS)
    batched = common.median_seconds(lambda: by_batched_eigh(modes, inertia), REPEATS)
    swept = everything(modes, inertia)[0]
    eigenvalues, reaction = by_eigh(modes, inertia)
    apart = np.abs(swept.effective_modal_reaction_inertia - reaction).max()

    few = about_hub * np.geomspace(*RANGE, CLOSED)
    warm = common.median_seconds(lambda: by_poles(first, few), REPEATS)
    schur = common.median_seconds(lambda: by_schur(modes, few), REPEATS)
    lyapunov = common.median_seconds(lambda: by_lyapunov(modes, few), 1)
    jitter, expected = by_poles(first, few), by_schur(modes, few)
    both = np.isfinite(expected)
    different = np.abs(jitter[both] / expected[both] - 1).max()

    body = [
        common.table(
            ["", "fosopt", "other", "ratio", "target"],
            [
                (
                    f"{COUPLED} × {modes.stiffness.size + 1} modes, loop of scipy.linalg.eigh [s]",
                    f"{ours:.3f}",
                    f"{loop:.2f}",
                    f"{loop / ours:.1f}",
                    "≥ 25",
                ),
                (
                    "the same, numpy.linalg.eigh of the stack [s]",
                    f"{ours:.3f}",
                    f"{batched:.2f}",
                    f"{batched / ours:.1f}",
                    "≥ 15",
                ),
                (
                    f"stability and jitter at {CLOSED} points, one Schur form each [s]",
                    f"{warm:.2f}",
                    f"{schur:.2f}",
                    f"{schur / warm:.1f}",
                    "≥ 15",
                ),
                (
                    "the same, eigvals and solve_continuous_lyapunov [s]",
                    f"{warm:.2f}",
                    f"{lyapunov:.2f}",
                    f"{lyapunov / warm:.1f}",
                    "",
                ),
            ],
        ),
        common.table(
            ["", "fosopt", "eigh", "target"],
            [
                *separation_errors(modes, inertia, swept, eigenvalues),
                ("largest difference of J̄_k", f"{apart:.1e}", "", ""),
                ("largest relative difference of the jitter", f"{different:.1e}", "", "≤ 1e-9"),
                ("unstable points", str(int(np.isnan(jitter).sum())), str(int((~both).sum())), "the same"),
            ],
        ),
        NOTES.format(
            repeats=REPEATS,
            modes=modes.stiffness.size + 1,
            coupled=COUPLED,
            closed=CLOSED,
            chunk=CHUNK,
            checked=CHECKED,
            states=closed_loop(modes, 1.0)[0].shape[0],
            term=f"{1e9 * ours / (COUPLED * modes.stiffness.size * (modes.stiffness.size + 1)):.1f}",
        ),
        common.table(
            ["closed loops by module", "share"], common.profile_by_module(lambda: by_poles(first, few))
        ),
    ]
    if not np.array_equal(np.isnan(jitter), ~both):
        raise SystemExit("not comparable: stability differs")
    text = "\n\n".join(body)
    print(text)
    common.write_section(TITLE, text)


if __name__ == "__main__":
    common.one_thread()
    main()
