"""What a sampled loop is judged by: stability, margins, and jitter between samples as well as at them.

The disturbances are stationary, the loop repeats itself with the sampling period; its jitter is the root of the mean
square over time, E ∫ y² dt/T. White noise at the time s before a sample leaves the energy R(s) until that sample and
Φ(s)ᵀ Y Φ(s) after it, with Y the energy that a state at a sample leaves for ever:

    J = bᵀ [∫_0^T (R(s) + Φ(s)ᵀ Y Φ(s)) ds] b/T,    Y = Mᵀ Y M + E.    [Chen1995] Ch. 12

Spectra over a band go by frequency: an input at ω leaves at ω + nω_s all that the hold makes of one sequence of
samples; together with what the input moves by itself it is squared and averaged over a period.    [Araki1996]

A torque on a free hub that is counted from a frequency ω₀ up has no energy of its own over all frequencies. Washed out
by a high pass W below ω₀ it has, and above 32 ω₀ the two are one: J is the energy of the washed-out one, less what it
leaves up to there, plus what the torque itself leaves from ω₀ to there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, pi, sqrt

import numpy as np
from scipy import linalg, optimize

from fosopt.control import Loop
from fosopt.control.filter_states import PASSING
from fosopt.control.phase import resonance_grid
from fosopt.control.sampled import SampledLoop, Source, sampled_loop, solutions
from fosopt.control.spans import energy_for_ever, span
from fosopt.errors import SolverError, UnstableError
from fosopt.metrics.disturbances import Disturbance, ShapingFilter, high_pass, refuse_infinite_variance
from fosopt.metrics.jitter import drift_cuts, gauss, resonance_quadrature
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray

_GRID = 240
_DEEPEST = 3  # local minima of |1 + L| that are looked at closely
# Poles in z this small are over within a sample and shape no spectrum.
_GONE = 1e-6
# Instants in a piece of a period in which the fastest state or input turns by this angle [rad]: good to rounding.
_INSTANTS, _TURN = 10, 2.0
_BLOCK = 1 << 20  # complex numbers in a table of instants and frequencies
# Order of W, and how many times its corner it is one within 1e-12 in power.
_WASH, _WASHED = 4, 32.0


@dataclass(frozen=True)
class SampledModel:
    """A sampled loop on a modal set with its disturbances."""

    loop: Loop
    modes: ModalSet
    mirror_port: str
    disturbances: tuple[Disturbance, ...] = ()

    @cached_property
    def bare(self) -> SampledLoop:
        """The loop without disturbances."""
        return sampled_loop(self.loop, self.modes, self.mirror_port)

    @property
    def spectral_abscissa(self) -> float:
        """ln|z|/T of the outermost pole, negative for a stable loop [rad/s]."""
        return self.bare.spectral_abscissa

    @property
    def stable(self) -> bool:
        """Whether all poles lie within the unit circle."""
        return self.spectral_abscissa < 0

    def refuse_infinite(self) -> None:
        """Refuse disturbances whose jitter is infinite, whether the loop is stable or not.

        Raises
        ------
        ModelError
            If one pushes a free hub at zero frequency, or is sampled or seen with infinite variance.
        """
        for each in self.disturbances if self.free else ():
            refuse_infinite_variance(each, self.loop, drifting=True)
        self._with(self._endless)

    @property
    def _endless(self) -> list[Disturbance]:
        """Disturbances with a rational spectrum that is counted up to any frequency."""
        return [d for d in self.disturbances if d.filter is not None and d.band[1] == inf]

    @cached_property
    def variances(self) -> dict[str, float]:
        """Mean square line-of-sight error by the name of its disturbance, averaged over time [rad²].

        Raises
        ------
        UnstableError
            If the loop is unstable: it has no jitter.
        ModelError
            If a variance is infinite.
        """
        if not self.stable:
            raise UnstableError(
                f"sampled loop is unstable: a pole has ln|z|/T = {self.spectral_abscissa:.6g} rad/s"
            )
        self.refuse_infinite()
        whole = self._endless
        found = dict(zip((d.name for d in whole), self._over_all(whole), strict=True))
        values = {}
        for d in self.disturbances:
            low, high = d.counted
            washing = self._washing(d)
            if d.name not in found:
                values[d.name] = self.over_band(d, low, high)
            elif washing is not None:
                top = _WASHED * low
                left = self.over_band(d, 0.0, top, washing)
                values[d.name] = found[d.name] - left + self.over_band(d, low, top)
            else:
                below = self.over_band(d, 0.0, low) if low > 0 else 0.0
                values[d.name] = found[d.name] - below
        return values

    @property
    def free(self) -> bool:
        """Whether the hub is free."""
        return bool(np.any(self.modes.stiffness == 0))

    def _washing(self, disturbance: Disturbance) -> ShapingFilter | None:
        """W of a disturbance that would push a free hub at zero frequency but is counted from above it."""
        low = disturbance.counted[0]
        return (
            high_pass(low, sqrt(2), _WASH) if self.free and low > 0 and "torque" in disturbance.at else None
        )

    def _over_all(self, disturbances: Sequence[Disturbance]) -> list[float]:
        """Mean squares of rational spectra over all frequencies, washed out or not, all from one energy of the loop."""
        if not disturbances:
            return []
        return averaged_variances(self._with(disturbances))

    def _with(self, disturbances: Sequence[Disturbance]) -> SampledLoop:
        """The loop with rational spectra in front of it, washed out or not."""
        sources = []
        for d in disturbances:
            assert d.filter is not None
            source, washing = Source.shaped(d.at, d.filter.numerator, d.filter.denominator), self._washing(d)
            sources.append(
                source if washing is None else source.washed(washing.numerator, washing.denominator)
            )
        return sampled_loop(self.loop, self.modes, self.mirror_port, sources)

    def over_band(
        self, disturbance: Disturbance, low: float, high: float, washing: ShapingFilter | None = None
    ) -> float:
        """Mean square over a finite band of a disturbance's frequencies, by quadrature [rad²].

        Parameters
        ----------
        low, high
            [rad/s].
        washing
            A filter that the disturbance passes before it is counted.
        """
        sampled = self.bare
        rate = 2 * pi / sampled.period
        z = sampled.poles[np.abs(sampled.poles) > _GONE]
        slow = np.log(z) / sampled.period
        aliases = np.arange(-1, int(np.ceil(high / rate)) + 2)
        images = (slow[:, None] + 1j * rate * aliases).ravel()
        images = images[(images.imag >= 0) & (images.imag <= 1.5 * high + rate)]
        own = [f.poles for f in (disturbance.filter, washing) if f is not None]
        cuts = disturbance.cuts
        poles = np.concatenate([images, images.conj(), linalg.eigvals(sampled.a), *own])
        if self.free and low > 0:
            cuts = np.concatenate([cuts, drift_cuts(low, float(np.abs(poles).min()))])
        nodes, weights = resonance_quadrature(poles, low, high, cuts)
        density = weights / (2 * pi) * disturbance.one_sided_psd(nodes)
        if washing is not None:
            density = density * np.abs(washing.response(1j * nodes)) ** 2
        return float(np.sum(density * self.power(disturbance.at, nodes)))

    def power(self, at: str, frequency: Array) -> Array:
        """(m,) Mean square of the line of sight over time per mean square of an input at one frequency [rad/s].

        Amplitudes are added before they are squared: what the input moves and what the loop takes back differ by a
        hundred-thousandth of either where a loop attenuates as much.    [Araki1996]
        """
        sampled = self.bare
        s = 1j * frequency
        direct, measured = self._open_loop(at, s)
        z = np.exp(s * sampled.period)
        states, first, second = _steady(sampled, z)
        controller = sampled.controller.response(z)
        fed = controller / (1 + sampled.measured @ states[: sampled.torque.size] * controller) * measured
        power = np.zeros(frequency.size)
        top = float(frequency.max(initial=0.0))
        parts = ((0.0, sampled.rest, first), (sampled.rest, sampled.period - sampled.rest, second))
        for begin, time, held in (part for part in parts if part[1] > 0):
            after, weights, rows = _instants(sampled, time, top)
            block = max(1, _BLOCK // after.size)
            for k in range(0, frequency.size, block):
                here = slice(k, k + block)
                passing = direct[here] * np.exp(np.outer(begin + after, s[here]))
                power[here] += weights @ np.abs(passing - fed[here] * (rows @ held[:, here])) ** 2
        return power / sampled.period

    def _open_loop(self, at: str, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Line of sight and measurement per input, without feedback."""
        if at in ("mirror_torque", "hub_torque"):
            sampled = sampled_loop(self.loop, self.modes, self.mirror_port, [Source(at, PASSING)])
            upper, turn = linalg.schur(sampled.a, output="complex")
            rows = np.array([sampled.line_of_sight, sampled.measured]) @ turn
            answers = rows @ solutions(upper, turn.conj().T @ sampled.noise.T, s)
            return answers[:, 0, 0], answers[:, 1, 0]
        seen: ComplexArray = np.ones_like(s)
        for section in self.loop.controller.path.anti_alias:
            seen = seen * section.response(s)
        return np.full_like(s, float(at == "line_of_sight")), seen

    @cached_property
    def grid(self) -> Array:
        """(m,) Frequencies below the Nyquist frequency that resolve every resonance [rad/s]."""
        period = self.bare.period
        z = np.concatenate([self.bare.poles, linalg.eigvals(self.bare.plant[0])])
        roots = np.log(z[np.abs(z) > _GONE]) / period
        top = pi / period
        inside = roots[(roots.imag >= 0) & (roots.imag < top)]
        size = np.abs(inside)
        low = 0.1 * float(size[size > 0].min(initial=top))
        return resonance_grid(inside, min(low, 1e-3 * top), top, _GRID)

    def _distance(self, frequency: Array) -> Array:
        z = np.exp(1j * frequency * self.bare.period)
        return np.abs(1 + self.bare.loop_transfer(z))

    @cached_property
    def modulus_margin(self) -> float:
        """Least |1 + L(e^{jωT})|, the reciprocal of the peak of the sampled sensitivity; at most one.

        [Astrom1997] Ch. 3
        """
        grid = self.grid
        distance = self._distance(grid)
        inner = np.flatnonzero((distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])) + 1
        deepest = inner[np.argsort(distance[inner], kind="stable")[:_DEEPEST]]
        found = [float(distance.min()), 1.0]
        for k in deepest:
            best = optimize.minimize_scalar(
                lambda w: float(self._distance(np.array([w]))[0]),
                bounds=(grid[k - 1], grid[k + 1]),
                method="bounded",
                options={"xatol": 1e-9 * grid[k]},
            )
            found.append(float(best.fun))
        return min(found)

    @cached_property
    def loop_crossover(self) -> float:
        """Highest frequency below Nyquist at which |L| is one [rad/s].

        Raises
        ------
        SolverError
            If there is none.
        """

        def excess(frequency: float) -> float:
            z = np.exp(1j * np.array([frequency]) * self.bare.period)
            return float(np.log(np.abs(self.bare.loop_transfer(z)[0])))

        grid = self.grid
        above = np.abs(self.bare.loop_transfer(np.exp(1j * grid * self.bare.period))) >= 1
        if not above.any() or above[-1]:
            where = "above" if above.any() else "below"
            raise SolverError(f"sampled loop: the loop gain stays {where} one up to the Nyquist frequency")
        last = int(np.flatnonzero(above)[-1])
        return float(optimize.brentq(excess, grid[last], grid[last + 1], rtol=1e-12))


def averaged_variances(sampled: SampledLoop) -> list[float]:
    """Mean square of the line of sight over time by each source of a stable sampled loop [rad²].

    [Chen1995] Ch. 12
    """
    n, period = sampled.torque.size, sampled.period
    beside, back = sampled.settled
    later = (energy_for_ever(beside @ sampled.transition @ back, sampled.energy @ back) @ beside)[:, :n]
    before = span(sampled.a, sampled.line_of_sight[None], period, grown=True).grown
    after = span(sampled.a, later, period).energy
    return [float(np.sum((before @ b) ** 2) + np.sum((after @ b) ** 2)) / period for b in sampled.noise]


def _steady(sampled: SampledLoop, z: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Plant states under torques z^k, and states with held torque as the two parts of a period begin."""
    moved, column, _ = sampled.plant
    upper, turn = linalg.schur(moved, output="complex")
    column = turn.conj().T @ column
    states = turn @ solutions(upper, column[:, None], z)[:, :, 0].T
    n = sampled.torque.size
    torques = [np.ones_like(z), *states[n:]]
    after = torques[sampled.whole]
    before = torques[sampled.whole + 1] if sampled.rest > 0 else after
    first: ComplexArray = np.vstack([states[:n], before])
    second: ComplexArray = np.vstack([(sampled.spans[0].carried @ first)[:n], after])
    return states, first, second


def _instants(sampled: SampledLoop, time: float, top: float) -> tuple[Array, Array, Array]:
    """Instants in a span of time, weights of a quadrature over it, and rows that read the line of sight there.

    Parameters
    ----------
    top
        Highest frequency that is looked at, which the instants resolve like the fastest state [rad/s].

    Returns
    -------
    (k,), (k,), (k, n+1)
        Times from its begin [s], weights [s], rows over continuous states and held torque as it begins.
    """
    fastest = max(float(np.abs(linalg.eigvals(sampled.a)).max()), top)
    count = int(np.ceil(fastest * time / _TURN))
    piece = time / count
    x, w = gauss(_INSTANTS)
    inner = 0.5 * piece * (x + 1)
    carried = np.array([sampled.carried(t) for t in inner])
    one = sampled.carried(piece)
    row, rows = np.append(sampled.line_of_sight, 0.0), []
    for _ in range(count):
        rows.append(row @ carried)
        row = row @ one
    times = (piece * np.arange(count)[:, None] + inner).ravel()
    return times, np.tile(0.5 * piece * w, count), np.concatenate(rows)
