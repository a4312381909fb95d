"""The limit of performance as an integral of a logarithm: the spectrum's own, and nothing else.

Let M be the spectral factor of Φ, without poles or zeros in the right half plane, Φ = |M|². Wiener's causal filter
is F = 1 − [R/M*]₊/M with R the spectrum of the noise and [·]₊ its causal part. For noise of density r at high
frequency and poles −a_j,

    [R/M*]₊ = √r + Σ c_j/(s + a_j),     c_j = Res R(−a_j)/M(a_j),
    J = r μ − √r Σ c_j + Σ c_j (M(a_j) − √r − Σ_k c_k/(a_k + a_j)),     μ = (1/2π) ∫ log(Φ/r) dω,

and Poisson's integral gives M(a_j) from log Φ on the imaginary axis. For white noise J = r μ, the bound
of [Yovits1955] and [Seron1997]; noise with a high-pass filter has less at low frequency, and the sum corrects it.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np

from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance
from fosopt.metrics.functional import LoopModel
from fosopt.relax.open_loop import open_loop


def logarithmic_limit(
    model: LoopModel, disturbances: Sequence[Disturbance], tolerance: float = 1e-6
) -> float:
    """Least total jitter of any stabilizing linear controller, from the spectrum's logarithm [rad].

    Only the noise needs a rational spectrum; whatever else disturbs may have tables and bands.

    Parameters
    ----------
    tolerance
        To which the nodes resolve the logarithm.

    Raises
    ------
    ModelError
        If a noise spectrum is not rational over all frequencies with simple poles, none is white at high frequency,
        the sensor is not on the mirror or the plant has zeros in the right half plane: `performance_limit` serves
        these.
    """
    loop = open_loop(model, disturbances)
    noises = [d for d in disturbances if d.at == "sensor_noise"]
    for noise in noises:
        if not noise.by_residues:
            raise ModelError(
                f"disturbance '{noise.name}': the logarithmic form takes noise of a rational spectrum over all "
                "frequencies with simple poles; use performance_limit"
            )
    shapes = [d.filter for d in noises if d.filter is not None]
    density = sum((f.numerator[0] / f.denominator[0]) ** 2 for f in shapes if f.relative_degree == 0)
    if density == 0:
        raise ModelError("no sensor noise is white at high frequency; use performance_limit")
    if model.loop.placement.sensor is not None or loop.zeros.size:
        raise ModelError(
            "the logarithmic form holds only for a minimum-phase plant with its sensor on the mirror; "
            "use performance_limit"
        )
    spectra = loop.spectra(loop.nodes(tolerance))
    s, weight = 1j * spectra.nodes.frequency, spectra.nodes.weight
    logarithm = np.log(spectra.measured / density)
    mean = float(np.sum(weight * logarithm))
    poles = -np.concatenate([f.poles for f in shapes])
    mirrored = np.concatenate([f.residues * f.response(-f.poles) for f in shapes])
    root = sqrt(density)
    kernel = 0.5 / (poles[:, None] - s) + 0.5 / (poles[:, None] + s)
    factor = root * np.exp(kernel @ (weight * logarithm))
    causal = mirrored / factor
    at_poles = root + np.sum(causal / (poles[:, None] + poles), axis=1)
    value = density * mean - root * np.sum(causal) + np.sum(causal * (factor - at_poles))
    return sqrt(float(value.real))
