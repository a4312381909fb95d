"""The limit of performance from a Riccati equation: the error of a Kalman filter.

With free actuation and a minimum-phase plant nothing keeps the line of sight from following the best estimate of its
open-loop error v, so that the limit is the variance with which v is estimated from the past of the measured signal
v + n. Rational spectra have a state-space model, here one block per pole of each spectrum, and its filter's Riccati
equation gives this variance. It shares the residues with nothing in `performance_limit`.    [Kailath2000]
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from scipy import linalg

from fosopt.errors import ModelError, SolverError
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import pole_residues
from fosopt.ops import Array, ComplexArray
from fosopt.relax.open_loop import OpenLoop, open_loop

_NEAR_ZERO = 1e-4  # distance from zero, relative to the lowest pole, at which the residue of a drift is read


def riccati_limit(model: LoopModel, disturbances: Sequence[Disturbance]) -> float:
    """Least total jitter of any stabilizing linear controller, by the Kalman filter's Riccati equation [rad].

    Raises
    ------
    ModelError
        If a spectrum is not rational over all frequencies with simple poles, no noise is white at high frequency, the
        sensor is not on the mirror or the plant has zeros in the right half plane: `performance_limit` serves these.
    SolverError
        If the Riccati equation has no stabilizing solution, as without noise and disturbance at zero frequency.
    """
    loop = open_loop(model, disturbances)
    _refuse(loop)
    a, b, error, noise, direct = _state_space(loop)
    # Columns of b are independent white inputs; `direct` is what they add to the measurement at once.
    covariance = np.array([[direct @ direct]])
    cross = (b @ direct)[:, None]
    try:
        spread = linalg.solve_continuous_are(a.T, (error + noise)[:, None], b @ b.T, covariance, s=cross)
    except (linalg.LinAlgError, ValueError) as failure:
        raise SolverError(f"Riccati equation of the limit: {failure}; use performance_limit") from failure
    return sqrt(error @ spread @ error)


def _refuse(loop: OpenLoop) -> None:
    for disturbance in loop.disturbances:
        if not disturbance.by_residues:
            raise ModelError(
                f"disturbance '{disturbance.name}': a Riccati equation takes a rational spectrum over all frequencies "
                "with simple poles; use performance_limit"
            )
    white = any(
        d.at == "sensor_noise" and d.filter is not None and d.filter.relative_degree == 0
        for d in loop.disturbances
    )
    if not white:
        raise ModelError(
            "no sensor noise is white at high frequency, and the Riccati equation singular; use performance_limit"
        )
    if loop.model.loop.placement.sensor is not None or loop.zeros.size:
        raise ModelError(
            "the Kalman filter's error is the limit only of a minimum-phase plant with its sensor on the mirror; "
            "use performance_limit"
        )


def _state_space(loop: OpenLoop) -> tuple[Array, Array, Array, Array, Array]:
    """A, B, rows of line-of-sight error and noise, and the noise's direct term."""
    blocks: list[Array] = []
    inputs: list[tuple[int, Array]] = []
    rows: list[tuple[Array, bool]] = []
    direct = np.zeros(len(loop.disturbances))
    for k, disturbance in enumerate(loop.disturbances):
        shape = disturbance.filter
        assert shape is not None
        own = shape.poles.imag >= 0
        if disturbance.at == "sensor_noise":
            poles, residues = shape.poles[own], shape.residues[own]
            if shape.relative_degree == 0:
                direct[k] = shape.numerator[0] / shape.denominator[0]
        else:
            through = loop.responses(shape.poles, disturbance.at)[0]
            moved = (
                pole_residues(loop.model, loop.poles, disturbance.at) if "torque" in disturbance.at else 0.0
            )
            moved = moved * np.ones_like(loop.poles.value)
            poles = np.concatenate([shape.poles[own], loop.poles.value])
            residues = np.concatenate(
                [(through * shape.residues)[own], moved * shape.response(loop.poles.value)]
            )
            if loop.drifting and "torque" in disturbance.at:
                poles, residues = np.append(poles, 0.0), np.append(residues, _drift(loop, disturbance))
        for pole, residue in zip(poles, residues, strict=True):
            if residue == 0:
                continue
            block, column, row = _block(pole, residue)
            blocks.append(block)
            inputs.append((k, column))
            rows.append((row, disturbance.at == "sensor_noise"))
    a = linalg.block_diag(*blocks)
    b = np.zeros((a.shape[0], len(loop.disturbances)))
    error, noise = np.zeros(a.shape[0]), np.zeros(a.shape[0])
    first = 0
    for (k, column), (row, of_noise) in zip(inputs, rows, strict=True):
        here = slice(first, first + column.size)
        b[here, k] = column
        (noise if of_noise else error)[here] = row
        first += column.size
    return a, b, error, noise, direct


def _block(pole: complex, residue: complex) -> tuple[Array, Array, Array]:
    """A real realization of residue/(s − pole), with its conjugate if complex, inputs and outputs of like size."""
    size = sqrt(abs(residue))
    if pole.imag == 0:
        return np.array([[pole.real]]), np.array([size]), np.array([np.sign(residue.real) * size])
    turned = residue / size
    block = np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])
    return block, np.array([size, 0.0]), np.array([2 * turned.real, 2 * turned.imag])


def _drift(loop: OpenLoop, disturbance: Disturbance) -> complex:
    """Residue at zero of a torque that drives the free rigid body through a filter with one zero there."""
    shape = disturbance.filter
    assert shape is not None
    s: ComplexArray = 1j * _NEAR_ZERO * np.abs(loop.spectral_poles).min() * np.array([1.0, 2.0])
    seen = (s * loop.responses(s, disturbance.at)[0] * shape.response(s)).real
    # The real part is even in frequency: one step of extrapolation leaves the fourth power.
    return complex((4 * seen[0] - seen[1]) / 3)
