"""Response to a step command: offset and residual rms in the window the requirement names.

The error of the mirror angle after a step is e(t) = Σ_i q_i e^{p_i t}. Its differential is an integral of
dT(s)/s along a path around the poles that matter in the window, on which e^{st} is small or smooth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fosopt.control import ClosedLoopPoles
from fosopt.errors import ModelError
from fosopt.metrics.functional import Functional, LoopModel
from fosopt.metrics.jitter import gauss
from fosopt.metrics.transient import Transient, mean_exponential, step_error
from fosopt.ops import Array, ComplexArray


@dataclass(frozen=True)
class StepCommand:
    """A step command and the window it must have settled for.    [Barker1991] Table 3.1, Fig. 3.6

    Attributes
    ----------
    command
        Size of the step [rad].
    window
        Start (t_RMS) and end (t_RMS + t_DWELL) of the window [s].
    """

    command: float
    window: tuple[float, float]

    def __post_init__(self) -> None:
        if not 0 < self.window[0] < self.window[1]:
            raise ModelError(f"step: window {self.window} s must start after zero and end after it starts")


def step_response(model: LoopModel, poles: ClosedLoopPoles, time: Array) -> Array:
    """(m,) Mirror angle after a unit step command at (m,) times [s].    [Barker1991] Eq. (4.28)

    Raises
    ------
    UnstableError
        If the loop is unstable.
    """
    return 1 + _settling(model, poles)(time)


def _settling(model: LoopModel, poles: ClosedLoopPoles) -> Transient:
    poles.refuse_unstable()
    return step_error(model, poles)


def step_metrics(
    model: LoopModel, poles: ClosedLoopPoles, step: StepCommand
) -> dict[str, tuple[float, Functional]]:
    """Offset and residual rms of a step command in its window, with their differentials, in closed form.

    Returns
    -------
    dict
        ``step_offset``: size of the mean error over the window; ``step_rms``: rms about that mean [rad].
    """
    start, end = step.window
    error = _settling(model, poles)
    p, q = error.pole, error.amplitude
    mean, rms = error.mean(start, end), error.rms(start, end)

    def mean_of(z: ComplexArray) -> ComplexArray:
        return mean_exponential(z, start, end)

    fastest = p[p.real > -40 / start]
    s, along = _path(np.abs(fastest.imag).max(initial=1 / start), start, end)
    # The error's mean weighted with e^{st}, by which a change of T(s)/s reaches the mean square.
    flat = mean_of(s)
    lifted = 0.5 * (mean_of(s[:, None] + p) @ q + mean_of(s[:, None] + p.conj()) @ q.conj())
    share = step.command * along / s
    points = model.points(s)
    offset = Functional("command", points, share * flat * np.sign(mean))
    residual = Functional(
        "command", points, share * (lifted - (mean - error.steady) * flat) / max(rms, 1e-300)
    )
    return {
        "step_offset": (step.command * abs(mean), offset),
        "step_rms": (step.command * rms, residual),
    }


def _path(fastest: float, start: float, end: float) -> tuple[ComplexArray, ComplexArray]:
    """Nodes and weights of (1/2πj)∮ ds, upper half counted twice, around all poles that matter after `start`.

    Up along Re s = σ, past the fastest frequency, and left until e^{s·start} has died out.
    """
    sigma = 5.0 / end
    top = 1.25 * fastest + 40 / start
    left = -45.0 / start
    x, w = gauss(12)

    def panels(first: complex, last: complex, count: int) -> tuple[ComplexArray, ComplexArray]:
        edges: ComplexArray = np.linspace(first, last, count + 1, dtype=complex)
        half = 0.5 * np.diff(edges)
        nodes = (0.5 * (edges[1:] + edges[:-1]))[:, None] + half[:, None] * x
        return nodes.ravel(), (half[:, None] * w).ravel()

    up = panels(sigma, sigma + 1j * top, int(np.ceil(top / (2 * sigma))))
    across = panels(sigma + 1j * top, left + 1j * top, 40)
    s = np.concatenate([up[0], across[0]])
    # The lower half is the conjugate: Im of the upper integral over π.
    along = np.concatenate([up[1], across[1]]) / (1j * np.pi)
    return s, along
