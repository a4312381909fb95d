"""Metrics of a mirror with two axes: both loops closed on one structure.

A model of one axis sees the other as an attachment with a loop of its own, so that sensitivity, margin and crossover
are those of one loop at a time with the other closed. Poles are common to both axes. Jitter is found by quadrature:
alike axes have double poles, at which residues do not exist. Where they do, they serve its differential.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from fosopt.control import (
    ClosedLoopPoles,
    about_other_axis,
    characteristic,
    multivariable_distance,
    structure_receptances,
)
from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance, refuse_infinite_variance
from fosopt.metrics.functional import Functional, LoopModel
from fosopt.metrics.jitter import Variance, jitter_quadrature, quadrature_variance, residue_variances
from fosopt.metrics.margins import frequency_grid
from fosopt.ops import Array

AXES = ("first", "second")
# Poles closer than this (relative) are one of each axis.
_DOUBLE = 1e-7
# Residues that give the quadrature's mean square to this share of that about both axes give its differential as well.
_BELIEVED = 1e-9
_GRID, _LOCAL, _ROUNDS, _MINIMA = 400, 41, 5, 4

Models = tuple[LoopModel, LoopModel]


def axis_models(model: LoopModel) -> Models:
    """The model of the first axis, and that of the second, which has the first beside it."""
    loop, port = about_other_axis(model.loop, model.mirror_port)
    return model, LoopModel(loop, model.modes, port)


def responses_of(disturbance: Disturbance, axis: int) -> list[str]:
    """Names of the transfer functions by which a disturbance reaches the line of sight about an axis, 0 or 1."""
    about = {"first": (0,), "second": (1,), "both": (0, 1)}[disturbance.axis]
    return [disturbance.at if source == axis else f"other_{disturbance.at}" for source in about]


def axis_variances(
    models: Models, poles: ClosedLoopPoles, disturbances: Sequence[Disturbance], shift: float = 0.0
) -> list[tuple[Variance, Variance]]:
    """Mean square line-of-sight error about both axes, of each disturbance.

    Parameters
    ----------
    shift
        As in `metrics.jitter.jitter_variances` [rad/s].

    Raises
    ------
    UnstableError
        If a closed-loop pole does not lie left of `shift`: an unstable loop has no jitter.
    ModelError
        If a disturbance turns the hub about a second axis of which no port is known, or has infinite variance.
    """
    poles.refuse_unstable(shift)
    found = []
    for disturbance in disturbances:
        _refuse_unknown_hub(models[0], disturbance)
        for model in models:
            refuse_infinite_variance(disturbance, model.loop, poles.open_loop.drifting)
        nodes, density = jitter_quadrature(poles, disturbance, shift)
        points = models[0].points(1j * nodes + shift)
        first, second = (
            summed(
                quadrature_variance(seen, density, response) for response in responses_of(disturbance, axis)
            )
            for axis, seen in enumerate((points, models[1].seen(points)))
        )
        quick = [
            _on_few_points(axis, model, poles, disturbance, (first, second), shift)
            for axis, model in enumerate(models)
        ]
        found.append((quick[0], quick[1]))
    return found


def _on_few_points(
    axis: int,
    model: LoopModel,
    poles: ClosedLoopPoles,
    disturbance: Disturbance,
    shares: tuple[Variance, Variance],
    shift: float,
) -> Variance:
    """The share of an axis, its differential on the mirror images of the poles: a hundredth of the points.

    A sum of residues is believed where it is what the quadrature gives; of double poles it is nothing like that.
    """
    exact = shares[axis]
    if not disturbance.by_residues:
        return exact
    names = responses_of(disturbance, axis)
    with np.errstate(all="ignore"):
        at = model.points(poles.value)
        strength = poles.multiplicity / characteristic(model.loop, *model.along(at)).slope
        alike = [disturbance] * len(names)
        few = summed(residue_variances(model, (at.s, at.g), strength, alike, names, shift))
    if abs(few.value - exact.value) <= _BELIEVED * sum(share.value for share in shares):
        return Variance(exact.value, few.functionals)
    return exact


def _refuse_unknown_hub(first: LoopModel, disturbance: Disturbance) -> None:
    other = first.loop.beside
    if (
        disturbance.at == "hub_torque"
        and disturbance.axis != "first"
        and (other is None or other.hub is None)
    ):
        raise ModelError(
            f"disturbance '{disturbance.name}': it turns the hub about the second axis, of which no port is known; "
            "give the axis its hub"
        )


def summed(variances: Iterable[Variance]) -> Variance:
    """Mean square of independent errors together."""
    every = list(variances)
    return Variance(sum(v.value for v in every), tuple(f for v in every for f in v.functionals))


def multivariable_margin(model: LoopModel, poles: ClosedLoopPoles) -> float:
    """Least singular value of 1 + L(jω) over frequency, 1/‖S‖ of both axes together [-].

    [Skogestad2005] Sec. 3.3; never above the modulus margin of either axis. It says nothing about an unstable loop.
    """
    grid = frequency_grid(model, poles, _GRID)
    distance = _distance(model, grid)
    inner = distance[1:-1]
    lows = 1 + np.flatnonzero((inner <= distance[:-2]) & (inner <= distance[2:]))
    least = min(1.0, float(distance.min()))
    for k in lows[np.argsort(distance[lows])][:_MINIMA]:
        low, high = grid[k - 1], grid[k + 1]
        for _ in range(_ROUNDS):
            local = np.linspace(low, high, _LOCAL)
            distance = _distance(model, local)
            best = int(np.clip(np.argmin(distance), 1, _LOCAL - 2))
            low, high = local[best - 1], local[best + 1]
            least = min(least, float(distance.min()))
    return least


def _distance(model: LoopModel, frequency: Array) -> Array:
    points = model.points(1j * frequency)
    structure = structure_receptances(model.loop, points.s, points.bare)
    return multivariable_distance(model.loop, points.s, structure)


def rightmost_poles_of_axes(
    models: Models, poles: ClosedLoopPoles, count: int
) -> list[tuple[float, Functional | None]]:
    """As `margins.rightmost_poles`, each pole followed by the axis whose Δ tells it best.

    Of two poles in one place, which alike axes have, each axis follows one.
    """
    hidden = np.unique(poles.open_loop.uncoupled.real)
    real = np.concatenate([poles.value.real, hidden])
    found: list[tuple[float, Functional | None]] = []
    followed: list[tuple[complex, int]] = []
    for k in np.argsort(-real, kind="stable")[:count]:
        if k >= poles.value.size:
            found.append((float(real[k]), None))
            continue
        pole = complex(poles.value[k])
        steps, functionals = [], []
        for model in models:
            points = model.points(np.array([pole]))
            with np.errstate(all="ignore"):
                delta = characteristic(model.loop, *model.along(points))
                steps.append(float(np.abs(delta.value / delta.slope)[0]))
            functionals.append(Functional("characteristic", points, -1 / delta.slope))
        taken = [axis for other, axis in followed if abs(other - pole) <= _DOUBLE * abs(pole)]
        axis = int(np.nanargmin(steps)) if len(taken) != 1 else 1 - taken[0]
        followed.append((pole, axis))
        found.append((float(real[k]), functionals[axis]))
    return found
