"""What a report shows of one design: geometry, modes, loop, jitter by source, step, poles."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.control import closed_loop_response, loop_transfer
from fosopt.metrics import inertias
from fosopt.metrics.margins import frequency_grid
from fosopt.metrics.step import step_response
from fosopt.ops import Array
from fosopt.problem import Evaluation
from fosopt.structure import Truss

_MODES = 40  # rows of the mode table: the lowest ones
_CURVE = 600  # points of a curve, after those that resolve nothing are dropped
_STEP = 400


def detail_of(evaluation: Evaluation) -> dict[str, Any]:
    """The ``detail`` of a point of the run data; curves that an unstable loop does not have are left out."""
    found: dict[str, Any] = {
        "truss": _truss(evaluation.system.structure.truss, evaluation.design.area),
        "modes": _modes(evaluation),
        "bode": _bode(evaluation),
        "poles": [_short(np.array([p.real, p.imag])) for p in np.sort_complex(evaluation.poles.all)],
        "jitter": {},
        "cumulative": None,
        "step": None,
    }
    if evaluation.stable:
        names = [f"jitter_{d.name}" for d in evaluation.system.disturbances]
        found["jitter"] = {name.removeprefix("jitter_"): evaluation.value(name) for name in names}
        found["cumulative"] = _cumulative(evaluation)
        found["step"] = _step(evaluation)
    return found


def _truss(truss: Truss, area: Array) -> dict[str, Any] | None:
    if not truss.bars:
        return None  # a beam or a chain: there is nothing to draw
    index = {name: i for i, name in enumerate(truss.nodes)}
    return {
        "nodes": [[float(x) for x in xyz] for xyz in truss.nodes.values()],
        "bars": [[index[bar.nodes[0]], index[bar.nodes[1]]] for bar in truss.bars],
        "areas": area.tolist(),
        "kinds": [bar.kind for bar in truss.bars],
        "names": [bar.name for bar in truss.bars],
        "battens": [
            [index[a], index[b]]
            for batten in truss.battens
            for a, b in zip(batten.nodes[:-1], batten.nodes[1:], strict=True)
        ],
    }


def _modes(evaluation: Evaluation) -> list[dict[str, Any]]:
    """The lowest coupled modes; each structural one carries the data of the uncoupled mode it is paired with."""
    coupled, modes = evaluation.coupled, evaluation.modes
    inertia = inertias.modal_inertia(modes, evaluation.system.mirror_port)
    rows = []
    for k in range(min(_MODES, coupled.base.size)):
        mirror = k == coupled.mirror_mode
        zero = coupled.zero[k]
        paired = None if np.isnan(zero) else int(np.argmin(np.abs(modes.stiffness - zero)))
        ratio = evaluation.design.loop.mirror.damping_ratio if mirror else None
        if paired is not None:
            ratio = modes.damping_ratio[paired]
        rows.append(
            {
                "index": k + 1,
                "frequency_hz": float(coupled.natural_frequency[k]) / (2 * pi),
                "damping_ratio": None if ratio is None else float(ratio),
                "effective_modal_reaction_inertia": float(coupled.effective_modal_reaction_inertia[k]),
                "pole_zero_separation": None if mirror else _finite(coupled.pole_zero_separation[k]),
                "modal_inertia": None if paired is None else _finite(inertia[paired]),
            }
        )
    return rows


def _short(values: Array) -> list[float]:
    """A curve for the eye: six digits."""
    return [float(f"{value:.6g}") for value in values]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _bode(evaluation: Evaluation) -> dict[str, list[float]]:
    grid = _thinned(frequency_grid(evaluation.model, evaluation.poles, count=240), _CURVE)
    s = 1j * grid
    g = evaluation.model.points(s).g
    loop = evaluation.design.loop
    transfer = loop_transfer(loop, s, g)
    return {
        "frequency_hz": _short(grid / (2 * pi)),
        "loop_magnitude": _short(np.abs(transfer)),
        "loop_phase_deg": _short(_continuous_phase(transfer)),
        "sensitivity": _short(np.abs(closed_loop_response("line_of_sight", loop, s, g))),
        "complementary_sensitivity": _short(np.abs(closed_loop_response("command", loop, s, g))),
    }


def _continuous_phase(transfer: NDArray[np.complex128]) -> Array:
    """Phase [deg] without jumps of a turn; the grid resolves every resonance."""
    return np.asarray(np.degrees(np.unwrap(np.angle(transfer))))


def _thinned(grid: Array, count: int) -> Array:
    """At most about `count` of the frequencies, none from about a resonance that is worth seeing."""
    if grid.size <= count:
        return grid
    keep = np.unique(np.linspace(0, grid.size - 1, count).astype(int))
    return grid[keep]


def _cumulative(evaluation: Evaluation) -> dict[str, list[float]] | None:
    """Root of the cumulative mean square jitter below each frequency, by source and in total [rad]."""
    system = evaluation.system
    if not system.disturbances:
        return None
    grid = _thinned(frequency_grid(evaluation.model, evaluation.poles, count=400), 3 * _CURVE)
    s = 1j * grid
    g = evaluation.model.points(s).g
    loop = evaluation.design.loop
    total = np.zeros(grid.size)
    curves = {}
    for d in system.disturbances:
        response = np.abs(closed_loop_response(d.at, loop, s, g)) ** 2
        low, high = d.counted
        density = np.where((grid >= low) & (grid <= high), d.one_sided_psd(grid) * response, 0.0) / (2 * pi)
        grown = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(grid))])
        # The curve ends at the exact variance: trapezoids on this grid are good for a picture only.
        exact = evaluation.variances[f"jitter_{d.name}"].value
        curves[d.name] = grown * (exact / grown[-1] if grown[-1] > 0 else 0.0)
        total += curves[d.name]
    curves["total"] = total
    chosen = np.unique(np.linspace(0, grid.size - 1, _CURVE).astype(int))
    found = {"frequency_hz": _short(grid[chosen] / (2 * pi))}
    return found | {name: _short(np.sqrt(curve[chosen])) for name, curve in curves.items()}


def _step(evaluation: Evaluation) -> dict[str, Any] | None:
    step = evaluation.system.step
    if step is None:
        return None
    time = np.concatenate([[0.0], np.linspace(0, step.window[1], _STEP)[1:]])
    response = np.concatenate(
        [[0.0], step.command * step_response(evaluation.model, evaluation.poles, time[1:])]
    )
    return {
        "time_s": _short(time),
        "response": _short(response),
        "window": list(step.window),
        "command": step.command,
    }
