"""Chapter 4, loop transfer functions and root loci: figures 4.11 to 4.16, 4.19 and 4.21."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np

from fosopt.control import PID, closed_loop_poles, loop_transfer
from fosopt.control.locus import RootLocus, root_locus
from fosopt.control.phase import continuous_phase, resonance_grid
from fosopt.metrics.bandwidth import closed_loop_bandwidth
from fosopt.metrics.margins import crossover
from fosopt.metrics.nyquist import encirclements
from fosopt.ops import Array, ComplexArray
from fosopt.reproduce import chapter4_system as system
from fosopt.reproduce.bode import Response, bode_panels
from fosopt.reproduce.chapter4_system import CHAPTER, Model
from fosopt.reproduce.entry import Comparison, Curve, Entry, Mark, Panel, Reproduction
from fosopt.reproduce.judge import claim, judged
from fosopt.units import HZ

_HERTZ = (0.5, 2000.0)
_BROAD, _PER_ROOT = 400, 25
_EVEN = 1000  # evenly spaced frequencies, as a plot without regard to poles has them
# Windows of the root loci: real parts [1/s], and frequencies of all poles and of the flexible modes [Hz].
_PLANE, _FLEXIBLE = ((-800.0, 100.0), (0.0, 150.0)), (0.0, 75.0)


@cache
def roots(percent: float, model: Model) -> tuple[ComplexArray, ComplexArray]:
    """Zeros and poles of the forward loop: structure and controller, coupled plant and integrator [rad/s]."""
    of, poles = system.closed(percent, model)
    pid = of.loop.controller
    structure = np.concatenate([poles.open_loop.first, poles.open_loop.second])
    open_loop = replace(of.loop, controller=PID(0.0, 0.0, 0.0, 0.0))
    plant = closed_loop_poles(open_loop, of.modes, of.mirror_port).all
    # The free rigid body, which the mirror's torque cannot move, cancels.
    zeros = np.concatenate([structure[structure != 0], np.roots([pid.kd, pid.kp, pid.ki])])
    return zeros, np.append(plant, 0.0)


def forward_loop(percent: float, model: Model) -> Response:
    """L(jω), with its phase by poles and zeros."""
    of = system.closed(percent, model)[0]
    zeros, poles = roots(percent, model)
    low, high = _HERTZ
    frequency = resonance_grid(np.concatenate([zeros, poles]), low * HZ, high * HZ, _BROAD, _PER_ROOT)
    points = of.points(1j * frequency)
    value = loop_transfer(of.loop, points.s, points.g)
    return Response("", frequency, value, continuous_phase(zeros, poles, 1.0, frequency))


def unresolved(percent: float, model: Model) -> tuple[int, int]:
    """Pole-zero pairs between which no evenly spaced frequency falls, and the number of all pairs."""
    zeros, poles = (np.sort(r.imag[r.imag > 0]) for r in roots(percent, model))
    pairs = np.array([(zero, poles[np.argmin(np.abs(poles - zero))]) for zero in zeros])
    even = np.geomspace(*_HERTZ, _EVEN) * HZ
    inside = np.searchsorted(even, pairs.max(axis=1)) > np.searchsorted(even, pairs.min(axis=1))
    return int(np.count_nonzero(~inside)), len(pairs)


def frequency_response(percent: float, model: Model) -> Reproduction:
    """Figures 4.11 to 4.14, 4.19 and 4.21: magnitude and phase of the forward loop."""
    of, poles = system.closed(percent, model)
    missed, pairs = unresolved(percent, model)
    turns = encirclements(of, poles)
    rows = [
        *_design(percent, model),
        _ordered(percent, model),
        Comparison("crossover of this loop", None, crossover(of, poles)[0] / HZ, "Hz"),
        Comparison(
            "turns of the Nyquist plot around −1",
            None,
            turns,
            note=f"as many as poles in the right half plane, conjugates counted: {system.growth(percent, model)}",
        ),
        Comparison(
            f"pole-zero pairs that {_EVEN} evenly spaced frequencies miss",
            None,
            missed,
            note=f"of {pairs}; what the phase does between pole and zero is lost there",
        ),
        *_ambiguity(percent, model),
    ]
    return judged(
        f"L(jω) of the {system.order(model)} model ({system.MODELS[model]}), {percent:g} %. Frequencies lie closest at "
        "the poles and zeros of the loop; the phase is counted root by root and needs no unwrapping.",
        rows,
        bode_panels([forward_loop(percent, model)], "1"),
    )


def _design(percent: float, model: Model) -> tuple[Comparison, ...]:
    """What the controller was designed for; the text gives it with the first of these figures."""
    if (percent, model) != _RESPONSES["figure-4.11"]:
        return ()
    rigid = system.closed(percent, "rigid")
    wanted = CHAPTER["closed_loop_bandwidth_hz"]
    bandwidth = closed_loop_bandwidth(*rigid) / HZ
    return (
        Comparison(
            "open-loop crossover on a rigid support", CHAPTER["crossover_hz"], crossover(*rigid)[0] / HZ, "Hz"
        ),
        claim(
            f"closed-loop bandwidth of {wanted:g} Hz",
            "achieved",
            bandwidth >= wanted,
            "not achieved",
            f"{bandwidth:.1f} Hz at −3 dB on a rigid support, {100 * (bandwidth / wanted - 1):+.1f} %",
        ),
    )


def _ordered(percent: float, model: Model) -> Comparison:
    """Pole-zero separations of the damped loop against those of the undamped system of full order."""
    zeros, poles = (np.sort(np.abs(r[r.imag > 0])) for r in roots(percent, model))
    coupled = system.coupled(percent)
    below = int(np.count_nonzero(zeros < system.mirror(percent).natural_frequency))
    found = np.delete(poles, below) / zeros
    expected = coupled.pole_zero_separation[np.isfinite(coupled.zero)][: found.size]
    number = 1 + system.PERCENTS.index(percent)
    worst = int(np.argmax(np.abs(found - expected)))
    mode = np.flatnonzero(np.isfinite(coupled.zero))[worst] + 1
    return claim(
        "pole-zero separations",
        f"as in figure 4.{number}",
        np.array_equal(found > 1, expected > 1),
        f"not as in figure 4.{number}",
        f"the same poles lie below and above their zeros; mode {mode} differs most, β_k {found[worst]:.5g} here and "
        f"{expected[worst]:.5g} there",
    )


def _ambiguity(percent: float, model: Model) -> tuple[Comparison, ...]:
    """Footnote 4: the phase plots of the dissertation become ambiguous as pole-zero separation decreases."""
    order = [p for p, m in _RESPONSES.values() if m == model]
    larger = [p for p in order if p > percent]
    if not larger:
        return ()
    here, there = unresolved(percent, model)[0], unresolved(max(larger), model)[0]
    return (
        claim(
            "ambiguities of an evenly sampled phase as separation decreases",
            "more",
            here > there,
            "not more",
            f"{here} pairs missed here, {there} at {max(larger):g} %; here every pair is resolved",
        ),
    )


@cache
def locus(percent: float, model: Model = "reduced") -> RootLocus:
    """Root locus from zero gain to that of the design."""
    of = system.closed(percent, model)[0]
    return root_locus(of.loop, of.modes, of.mirror_port)


def _upper(values: ComplexArray) -> tuple[Array, Array]:
    """Real parts [1/s] and frequencies [Hz] in the upper half plane, a gap elsewhere."""
    upper = np.where(values.imag >= 0, values, np.nan)
    return upper.real, upper.imag / HZ


def _map(percent: float, window: tuple[tuple[float, float], tuple[float, float]]) -> Panel:
    """Map of the locus within a window of the complex plane."""
    found = locus(percent)
    zeros, _ = roots(percent, "reduced")
    branches = [_upper(branch) for branch in found.branches.T if np.any(branch.imag >= 0)]
    return Panel(
        "Real part [rad/s]",
        "Imaginary part/2π [Hz]",
        (
            *(Curve(*branch, "" if k else "locus", "line") for k, branch in enumerate(branches)),
            Curve(*_upper(found.branches[0]), "poles of the loop", "crosses"),
            Curve(*_upper(zeros), "zeros of the loop", "points"),
            Curve(*_upper(found.branches[-1]), "closed loop", "squares"),
        ),
        f"J_m = {percent:g} % J_{{truss}}",
        x_range=window[0],
        y_range=window[1],
        marks=(Mark(x=0.0),),
    )


def loci(left: float, right: float, strip: float) -> Reproduction:
    """Figures 4.15 and 4.16: loci of the closed-loop poles, the region of the flexible modes enlarged below."""
    windows = _PLANE, ((-strip, strip), _FLEXIBLE)
    rows = []
    for percent in (left, right):
        rigid, found = locus(percent, "rigid"), locus(percent)
        rows += [
            Comparison(
                f"{percent:g} %, at the gain of the design",
                system.said(percent),
                system.stability(percent, "reduced"),
                note=system.growth(percent, "reduced"),
            ),
            Comparison(
                f"{percent:g} %, largest unstable gain over that of the design",
                None,
                _unstable_share(found),
                note=f"{_unstable_share(rigid):.3f} on a rigid support, where the integrator drives the mirror mode",
            ),
        ]
    return judged(
        "Poles of the 8-dof loop for gains from zero to that of the design, where the loci end; upper half plane. "
        "Below, the strip along the imaginary axis that the flexible modes are in.",
        rows,
        [_map(percent, window) for window in windows for percent in (left, right)],
        2,
    )


def _unstable_share(found: RootLocus) -> float:
    """Largest gain with a growing pole as a share of the largest gain."""
    return float(found.gain[found.spectral_abscissa > 0].max(initial=0.0) / found.gain[-1])


_RESPONSES: dict[str, tuple[float, Model]] = {
    "figure-4.11": (0.02, "reduced"),
    "figure-4.12": (0.2, "reduced"),
    "figure-4.13": (2.0, "reduced"),
    "figure-4.14": (20.0, "reduced"),
    "figure-4.19": (0.002, "full"),
    "figure-4.21": (0.02, "full"),
}

ENTRIES: tuple[Entry, ...] = (
    *(
        Entry(
            name,
            f"Forward loop frequency response, {system.order(model)}, J_m = {percent:g} % J_truss",
            partial(frequency_response, percent, model),
        )
        for name, (percent, model) in _RESPONSES.items()
    ),
    *(
        Entry(
            f"figure-4.{number}",
            f"Loci of closed-loop roots, J_m = {left:g} % and {right:g} % J_truss",
            partial(loci, left, right, strip),
        )
        for number, left, right, strip in ((15, *system.TABULATED[:2], 1.5), (16, *system.TABULATED[2:], 3.0))
    ),
)
