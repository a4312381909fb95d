"""What a report shows of one design: structure, modes, loop, jitter by source and by mode, step, poles.

Curves are computed finely enough for every resonance and then kept at what can be seen of them, see `curves`.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fosopt.control import closed_loop_response, loop_transfer
from fosopt.control.loop_phase import loop_phase, loop_transfer_roots
from fosopt.control.phase import resonance_grid
from fosopt.errors import SolverError
from fosopt.metrics import inertias
from fosopt.metrics.axes import AXES
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.margins import frequency_grid
from fosopt.metrics.requirement import line_verdict
from fosopt.metrics.spectrum import JitterSpectrum, axis_spectrum, jitter_spectrum
from fosopt.metrics.transient import Transient, step_error
from fosopt.ops import Array, ComplexArray
from fosopt.problem import Evaluation, TwoAxisEvaluation
from fosopt.structure import Structure, Truss
from fosopt.study.curves import visible
from fosopt.study.sampled_curves import as_sampled, resolved, step_between_samples
from fosopt.study.shapes import kind_of, mode_shapes

_MODES = 40  # rows of the mode table: the lowest ones
_GRID = 240  # frequencies of a curve beside those at its resonances
_FLOOR = 80.0  # [dB] below which a sensitivity is not drawn
_DECADES = 6.0  # of a spectrum below its peak
_DRAWN_MODES = 5  # with a curve of their own; the others share one
_LISTED_MODES = 12
_SAME_MODE = 1e-9  # of two squared frequencies
# Of a step: samples per period of the fastest oscillation that can be seen, and at most in all.
_PER_PERIOD, _MOST, _VISIBLE = 12, 20_000, 1e-3


def detail_of(evaluation: Evaluation) -> dict[str, Any]:
    """The ``detail`` of a point of the run data; curves that an unstable loop does not have are left out.

    Its ``requirement_line``, a `LineVerdict`, is no curve: it goes elsewhere.
    """
    structure = evaluation.system.structure
    found: dict[str, Any] = {
        "truss": _truss(structure.truss, evaluation.design.area),
        "structure": _plain_structure(structure),
        "places": _places(evaluation),
        "modes": _modes(evaluation),
        "bode": _bode(evaluation),
        "poles": [
            _short(np.array([p.real, p.imag])) for p in np.sort_complex(evaluation.poles.all) if p.imag >= 0
        ],
        "jitter": {},
        "spectrum": None,
        "cumulative": None,
        "by_mode": None,
        "step": None,
        "sampling_rate_hz": None,
        "requirement_line": None,
    }
    found["shapes"] = mode_shapes(evaluation, _MODES, [place["at"] for place in found["places"]])
    if evaluation.sampled is not None:
        found["sampling_rate_hz"] = 1 / evaluation.sampled.model.bare.period
    if evaluation.stable:
        if evaluation.sampled is None:
            found["jitter"] = {name: sqrt(square) for name, square in _squares(evaluation).items()}
        else:
            names = [d.name for d in evaluation.system.disturbances]
            found["jitter"] = {name: evaluation.value(f"jitter_{name}") for name in names}
        found["step"] = _step(evaluation)
    # Spectra are those of the continuous model, which of a sampled loop may be unstable by itself.
    if evaluation.stable and evaluation.poles.spectral_abscissa < 0:
        found |= _jitter(evaluation, found["modes"])
    return found


# ---- structure ----


def _truss(truss: Truss, area: Array) -> dict[str, Any] | None:
    if not (truss.bars or truss.battens):
        return None
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


def _plain_structure(structure: Structure) -> dict[str, Any] | None:
    """A beam or a chain, which have no bars; None of a truss, and of an imported model, which has no picture."""
    truss, kind = structure.truss, kind_of(structure)
    if kind == "beam":
        stations = {name: float(xyz[0]) for name, xyz in truss.nodes.items()}
        return {
            "kind": "beam",
            "length": stations["tip"],
            "stations": stations,
            "held": not np.any(structure.stiffness_constant == 0),
        }
    if kind != "chain":
        return None
    return {
        "kind": "chain",
        "bodies": list(truss.nodes),
        "inertias": structure.mass_constant.tolist(),
        "springs": structure.stiffness_constant.tolist(),
        "held": len(structure.dofs) < len(truss.nodes),
    }


def _places(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Where things are attached: name, port and place of hub, mirror, actuators and supports."""
    system, loop = evaluation.system, evaluation.design.loop
    truss = system.structure.truss
    named = {"hub": "hub", system.mirror_port: "mirror"}
    named |= {actuator.port: "actuator" for actuator in loop.actuators}
    found = []
    for port, kind in named.items():
        at = truss.ports.get(port, (port.rpartition(".")[0], ""))[0]
        where = _where(truss, at)
        if where is not None:
            found.append({"kind": kind, "port": port, "at": at, "xyz": where})
    for at in truss.supports:
        where = _where(truss, at)
        if where is not None:
            found.append(
                {"kind": "support", "port": ".".join([at, *truss.supports[at]]), "at": at, "xyz": where}
            )
    return found


def _where(truss: Truss, at: str) -> list[float] | None:
    """Coordinates of a node or of the middle of a batten [m]."""
    if at in truss.nodes:
        return [float(x) for x in truss.nodes[at]]
    for batten in truss.battens:
        if batten.name == at:
            middle = np.mean([truss.nodes[node] for node in batten.nodes], axis=0)
            return [float(x) for x in (middle if batten.center is None else batten.center)]
    return None


# ---- modes and loop ----


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
                "jitter_share": None,
            }
        )
    return rows


def _with_shares(rows: list[dict[str, Any]], evaluation: Evaluation, found: JitterSpectrum) -> None:
    """Write the share in the mean square jitter into the rows of structural modes that have one."""
    total = float(found.by_source[:, -1].sum())
    for row, zero in zip(rows, evaluation.coupled.zero, strict=False):
        # Coupled mode and closed-loop pole are both shifted from one mode of the structure.
        here = np.isclose(np.abs(found.origin) ** 2, zero, rtol=_SAME_MODE, atol=0)
        if np.count_nonzero(here) == 1 and total > 0:
            row["jitter_share"] = float(found.by_mode[here, -1][0]) / total


def _bode(evaluation: Evaluation) -> dict[str, list[float] | None]:
    """Loop transfer and sensitivities, about each axis where there are two.

    No phase where a zero of the loop cannot be found.
    """
    models = evaluation.models if isinstance(evaluation, TwoAxisEvaluation) else (evaluation.model,)
    grid = frequency_grid(models[0], evaluation.poles, _GRID)
    ends, every = (grid[0], grid[-1]), [_roots(model) for model in models]
    for roots in every:
        if roots is not None:
            grid = np.union1d(grid, resonance_grid(np.concatenate(roots), *ends, 2))
    if evaluation.sampled is not None:
        grid = resolved(evaluation.sampled.model, grid)
    loops = [_loop_curves(evaluation, *each, grid) for each in zip(models, every, strict=True)]
    transfers, phases = [loop[0] for loop in loops], [loop[-1] for loop in loops if loop[-1] is not None]
    levels = [20 * np.log10(np.maximum(curve, 1e-300)) for loop in loops for curve in loop[1:3]]
    both = np.maximum(levels, -_FLOOR)
    levels_of_loops = 20 * np.log10(np.maximum(transfers, 1e-300))
    kept = visible(np.log10(grid), levels_of_loops, both, *([np.array(phases)] if phases else []))
    names = "loop_magnitude", "sensitivity", "complementary_sensitivity", "loop_phase_deg"
    found: dict[str, list[float] | None] = {"frequency_hz": _short(grid[kept] / (2 * pi))}
    for axis, loop in zip(("", "second_axis_"), loops, strict=False):
        for name, curve in zip(names, loop, strict=True):
            found[f"{axis}{name}"] = None if curve is None else _short(curve[kept])
    return found


def _roots(model: LoopModel) -> tuple[ComplexArray, ComplexArray] | None:
    """Zeros and poles of the loop transfer, if they can be found."""
    try:
        return loop_transfer_roots(model.loop, model.modes, model.mirror_port)
    except SolverError:
        return None


def _loop_curves(
    evaluation: Evaluation, model: LoopModel, roots: tuple[ComplexArray, ComplexArray] | None, grid: Array
) -> tuple[Array, Array, Array, Array | None]:
    """|L|, |S|, |T| and the phase of L [deg]."""
    s = 1j * grid
    g = model.points(s).g
    transfer = loop_transfer(model.loop, s, g)
    phase = None
    if roots is not None:
        try:
            phase = loop_phase(*roots, transfer, grid)
        except SolverError:
            phase = None
    if evaluation.sampled is None:
        responses = (
            closed_loop_response("line_of_sight", model.loop, s, g),
            closed_loop_response("command", model.loop, s, g),
        )
    else:
        transfer, phase = as_sampled(evaluation.sampled.model, grid, transfer, phase)
        responses = 1 / (1 + transfer), transfer / (1 + transfer)
    return np.abs(transfer), np.abs(responses[0]), np.abs(responses[1]), phase


# ---- jitter ----


def _jitter(evaluation: Evaluation, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Spectra of the line of sight: by source, below each frequency, and by mode, which `rows` learn of too."""
    disturbances = evaluation.system.disturbances
    if not disturbances:
        return {}
    line = evaluation.system.requirement_line
    marks = np.zeros(0) if line is None else line.frequency
    if isinstance(evaluation, TwoAxisEvaluation):
        found = axis_spectrum(evaluation.models, evaluation.poles, disturbances, marks)
    else:
        found = jitter_spectrum(evaluation.model, evaluation.poles, disturbances, marks)
        _with_shares(rows, evaluation, found)
    total = found.by_source.sum(axis=0)
    slow = np.abs(evaluation.poles.all).min()
    shown = (found.frequency >= 0.1 * slow) & (found.frequency <= 20 * np.abs(evaluation.poles.all).max())
    shown &= total > 0
    exact = _squares(evaluation)
    return {
        "spectrum": _spectrum(found, list(exact), shown),
        "cumulative": _cumulative(exact, found, shown),
        "by_mode": _by_mode(found, shown) if found.pole.size else None,
        "requirement_line": None if line is None else line_verdict(found, line),
    }


def _squares(evaluation: Evaluation) -> dict[str, float]:
    """Mean square jitter of each disturbance, about each axis where there are two [rad²]."""
    disturbances = evaluation.system.disturbances
    if isinstance(evaluation, TwoAxisEvaluation):
        return {
            f"{d.name}, {axis} axis": share.value
            for d, shares in zip(disturbances, evaluation.shares, strict=True)
            for axis, share in zip(AXES, shares, strict=True)
        }
    return {d.name: evaluation.variances[f"jitter_{d.name}"].value for d in disturbances}


def _spectrum(found: JitterSpectrum, names: list[str], shown: NDArray[np.bool_]) -> dict[str, list[float]]:
    """Amplitude spectral density of the line of sight by source [rad/√Hz]."""
    grid = found.frequency[shown]
    curves = np.sqrt(np.vstack([found.density, found.density.sum(axis=0)])[:, shown])
    # What lies more than six decades below the peak is as good as nothing.
    curves = np.maximum(curves, curves.max() * 10**-_DECADES)
    kept = visible(np.log10(grid), np.log10(curves))
    return _table(grid[kept], [*names, "total"], curves[:, kept])


def _cumulative(
    sources: dict[str, float], found: JitterSpectrum, shown: NDArray[np.bool_]
) -> dict[str, list[float]]:
    """Root of the mean square jitter below each frequency, by source and in total [rad].

    Parameters
    ----------
    sources
        Mean square of each [rad²].
    """
    exact = np.array(list(sources.values()))
    # The quadrature agrees to many digits; the last point is the number that stands in the tables.
    share = exact / np.maximum(found.by_source[:, -1], 1e-300)
    squares = found.by_source[:, shown] * share[:, None]
    squares[:, -1] = exact
    curves = np.sqrt(np.maximum(np.vstack([squares, squares.sum(axis=0)]), 0.0))
    grid = found.frequency[shown]
    kept = visible(np.log10(grid), curves)
    return _table(grid[kept], [*sources, "total"], curves[:, kept])


def _by_mode(found: JitterSpectrum, shown: NDArray[np.bool_]) -> dict[str, Any]:
    """Shares of the structure's modes in the mean square, in all and below each frequency [-]."""
    total = float(found.by_source[:, -1].sum())
    shares = found.by_mode / total
    order = np.argsort(-np.abs(shares[:, -1]), kind="stable")
    drawn, rest = order[:_DRAWN_MODES], order[_DRAWN_MODES:]
    curves = np.vstack([shares[drawn], shares[rest].sum(axis=0), found.by_loop / total])
    ends = curves[:, -1].copy()
    curves, grid = curves[:, shown], found.frequency[shown]
    curves[:, -1] = ends
    kept = visible(np.log10(grid), curves)
    names = [f"mode {k + 1}" for k in range(drawn.size)]
    return {
        "modes": [
            {
                "frequency_hz": float(np.abs(found.pole[k])) / (2 * pi),
                "damping_ratio": float(-found.pole[k].real / np.abs(found.pole[k])),
                "structure_frequency_hz": float(np.abs(found.origin[k])) / (2 * pi),
                "share": float(shares[k, -1]),
            }
            for k in order[:_LISTED_MODES]
        ],
        "other_modes": float(shares[order[_LISTED_MODES:], -1].sum()),
        "count": int(order.size),
        "loop": float(found.by_loop[-1] / total),
        "cumulative": _table(grid[kept], [*names, "other modes", "loop"], curves[:, kept]),
    }


def _table(frequency: Array, names: list[str], curves: Array) -> dict[str, list[float]]:
    rows = {name: _short(curve) for name, curve in zip(names, curves, strict=True)}
    return {"frequency_hz": _short(frequency / (2 * pi)), **rows}


# ---- step ----


def _step(evaluation: Evaluation) -> dict[str, Any] | None:
    """Response to the step command, and its error in the window closely."""
    step = evaluation.system.step
    if step is None:
        return None
    start, end = step.window
    if evaluation.sampled is None:
        error = step_error(evaluation.model, evaluation.poles)
        mean, rms = error.mean(start, end), error.rms(start, end)
        time, response = _seen(error, 0.0, end)
        within, closely = _seen(error, start, end)
    else:
        time, response = step_between_samples(evaluation.sampled.model.bare, step.window, _MOST)
        inside = (time >= start) & (time <= end)
        within, closely = time[inside], response[inside]
        mean = np.copysign(evaluation.sampled.value("step_offset") / step.command, closely.mean())
        rms = evaluation.sampled.value("step_rms") / step.command
        kept = visible(time, response)
        time, response = time[kept], response[kept]
        kept = visible(within, closely)
        within, closely = within[kept], closely[kept]
    response[0] = -1.0  # what is commanded takes time
    return {
        "time_s": _short(time),
        "response": _short(step.command * (1 + response)),
        "window": list(step.window),
        "command": step.command,
        "window_time_s": _short(within),
        "window_error": _short(step.command * closely),
        "mean": float(step.command * mean),
        "rms": float(step.command * rms),
    }


def _seen(error: Transient, start: float, end: float) -> tuple[Array, Array]:
    """The error between two times, with every oscillation that can be seen."""
    size = np.abs(error.amplitude) * np.exp(error.pole.real * start)
    shown = error.pole[size > _VISIBLE * size.max(initial=0.0)]
    fastest = np.abs(shown).max(initial=0.0) / (2 * pi)
    count = int(np.clip(_PER_PERIOD * fastest * (end - start), 400, _MOST))
    time = np.linspace(start, end, count)
    values = error(time)
    kept = visible(time, values)
    return time[kept], values[kept]


def _short(values: Array) -> list[float]:
    """A curve for the eye: six digits."""
    return [float(f"{value:.6g}") for value in values]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
