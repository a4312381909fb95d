"""Systems, controllers and an LQG design the tests of control certificates share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np
import reference
from numpy.typing import NDArray
from reference import HZ
from scipy import linalg

from fosopt.control import PID, closed_loop_poles, plant_state_space
from fosopt.errors import SolverError
from fosopt.metrics.disturbances import Disturbance, band_pass, high_pass, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.relax.open_loop import OpenLoop
from fosopt.relax.pid_box import PidBox
from fosopt.relax.quadrature import nodes

Array = NDArray[np.float64]

CASES = (None, 1, 2, 3, 4)
FORCE = Disturbance("force", "mirror_torque", band_pass(5 * HZ, 100 * HZ, 59.0))
DISPLACEMENT = Disturbance("displacement", "line_of_sight", low_pass(8.5 * HZ, 288e-6))
NOISE = Disturbance("noise", "sensor_noise", high_pass(70 * HZ, 3.14e-6))
BENCHMARK = (FORCE, DISPLACEMENT, NOISE)
TRUSS = (
    Disturbance("cooling", "mirror_torque", low_pass(10 * HZ, 5.0)),
    Disturbance("aft_body", "hub_torque", low_pass(10 * HZ, 150.0, 2)),
    Disturbance("turbulence", "line_of_sight", low_pass(8.5 * HZ, 20e-6)),
    Disturbance("noise", "sensor_noise", high_pass(70 * HZ, 0.2e-6)),
)
# Absolute gains over four to seven decades.
WIDE = PidBox((1.0, 1.0), (1e4, 1e8), (1e4, 1e11), (1e2, 1e5))


def benchmark(case: int | None) -> LoopModel:
    """The modified benchmark problem of chapter 3, on a rigid support for None."""
    loop, modes = reference.benchmark(case)
    return LoopModel(loop, modes, "tip")


def truss(percent: float, bays: int = 20) -> LoopModel:
    """The pinned truss of chapter 4."""
    return reference.evaluation(percent=percent, bays=bays, rolloff_time=0.0).model


def jitter(model: LoopModel, disturbances: Sequence[Disturbance], pid: PID) -> float:
    """Total jitter with another controller, infinite if it is unstable or its poles are not found."""
    here = replace(model, loop=replace(model.loop, controller=pid))
    try:
        poles = closed_loop_poles(here.loop, here.modes, here.mirror_port)
    except SolverError:
        return np.inf
    if poles.spectral_abscissa >= 0:
        return np.inf
    return sqrt(sum(v.value for v in jitter_variances(here, poles, disturbances)))


def controllers(box: PidBox, count: int, seed: int = 0) -> Iterator[PID]:
    """Random controllers of a box."""
    for share in np.random.default_rng(seed).random((count, 4)):
        yield box.controller(box.at(share))


class Lqg:
    """An LQG controller of a loop's plant, its control torque weighted lightly.

    It is designed in balanced modal coordinates, as Riccati equations at a weight near zero need, and judged by the
    poles of the closed loop and its frequency response.
    """

    def __init__(self, model: LoopModel, disturbances: Sequence[Disturbance], weight: float) -> None:
        a, b, error, measured, direct = _with_filters(model, disturbances)
        torque, b = b[:, 0], b[:, 1:]
        cost = linalg.solve_continuous_are(a, torque[:, None], np.outer(error, error), np.array([[weight]]))
        spread = linalg.solve_continuous_are(
            a.T, measured[:, None], b @ b.T, np.array([[direct @ direct]]), s=(b @ direct)[:, None]
        )
        feedback = torque @ cost / weight
        injection = (spread @ measured + b @ direct) / (direct @ direct)
        inner = a - np.outer(torque, feedback) - np.outer(injection, measured)
        self.closed = linalg.eigvals(
            np.block([[a, -np.outer(torque, feedback)], [np.outer(injection, measured), inner]])
        )
        self.poles, shapes = linalg.eig(inner)
        self.residues = linalg.solve(shapes, injection.astype(complex)) * (feedback @ shapes)

    @property
    def stable(self) -> bool:
        """Whether all poles of the closed loop decay."""
        return bool(self.closed.real.max() < 0)

    def jitter(self, loop: OpenLoop) -> float:
        """Total jitter, from the frequency response."""
        known = loop.nodes(1e-4)
        poles = np.concatenate([known.poles, self.closed[self.closed.imag >= 0]])
        spectra = loop.spectra(nodes(poles, 0.0, np.inf, known.cuts))
        s = 1j * spectra.nodes.frequency
        response = (1 / (s[:, None] - self.poles)) @ self.residues
        followed = spectra.share * response / (spectra.impedance + response)
        error = 1 - followed - spectra.lack
        density = spectra.measured * np.abs(error) ** 2 + spectra.unavoidable
        return sqrt(float(spectra.nodes.weight @ density))


def _with_filters(
    model: LoopModel, disturbances: Sequence[Disturbance]
) -> tuple[Array, Array, Array, Array, Array]:
    """A, inputs (torque, then one white input per disturbance), rows of error and measurement, direct terms."""
    plant = plant_state_space(model.loop, model.modes, model.mirror_port)
    columns = [plant.inputs.index("control_torque"), plant.outputs.index("mirror_angle")]
    a, b, c = _balanced(plant.a, plant.b, plant.c[[columns[1], plant.outputs.index("sensor_angle")]])
    n = a.shape[0]
    filters = [linalg.block_diag(*(_real(p) for p in d.filter.poles if p.imag >= 0)) for d in disturbances]
    size = n + sum(f.shape[0] for f in filters)
    whole, inputs = np.zeros((size, size)), np.zeros((size, 1 + len(disturbances)))
    whole[:n, :n], inputs[:n, 0] = a, b[:, columns[0]]
    error, measured = np.append(c[0], np.zeros(size - n)), np.append(c[1], np.zeros(size - n))
    direct = np.zeros(len(disturbances))
    first = n
    for k, (disturbance, block) in enumerate(zip(disturbances, filters, strict=True)):
        here = slice(first, first + block.shape[0])
        first += block.shape[0]
        whole[here, here] = block
        row = np.zeros(size)
        inputs[here, 1 + k], row[here] = _ends(disturbance)
        if "torque" in disturbance.at:
            whole[:n] += np.outer(b[:, plant.inputs.index(disturbance.at)], row)
            continue
        measured = measured + row
        if disturbance.at == "line_of_sight":
            error = error + row
        elif disturbance.filter.relative_degree == 0:
            direct[k] = disturbance.filter.numerator[0] / disturbance.filter.denominator[0]
    return whole, inputs, error, measured, direct


def _real(pole: complex) -> Array:
    if pole.imag == 0:
        return np.array([[pole.real]])
    return np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])


def _ends(disturbance: Disturbance) -> tuple[Array, Array]:
    """Input column and output row of a filter in blocks of `_real`."""
    column, row = [], []
    for pole, residue in zip(disturbance.filter.poles, disturbance.filter.residues, strict=True):
        if pole.imag >= 0:
            size = sqrt(abs(residue))
            column += [size] if pole.imag == 0 else [size, 0.0]
            row += (
                [residue.real / size]
                if pole.imag == 0
                else [2 * residue.real / size, 2 * residue.imag / size]
            )
    return np.array(column), np.array(row)


def _balanced(a: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
    """Real modal coordinates in which inputs and outputs are of like size."""
    value, vectors = linalg.eig(a)
    upper, real = value.imag > 0, value.imag == 0
    turn = np.column_stack([vectors[:, upper].real, vectors[:, upper].imag, vectors[:, real].real])
    a, b, c = linalg.solve(turn, a @ turn), linalg.solve(turn, b), c @ turn
    pairs = int(upper.sum())

    def joint(sizes: Array) -> Array:
        both = np.hypot(sizes[:pairs], sizes[pairs : 2 * pairs])
        return np.concatenate([both, both, sizes[2 * pairs :]])

    scale = np.sqrt(joint(np.abs(b).max(axis=1)) / joint(np.abs(c).max(axis=0)))
    return a / scale[:, None] * scale, b / scale[:, None], c * scale
