"""Response of a linear system to a sampled input history."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from fosopt.control.state_space import StateSpace
from fosopt.errors import ModelError, did_you_mean
from fosopt.ops import Array


def time_response(
    system: StateSpace, input_name: str, history: Array, step: float, outputs: Sequence[str]
) -> Array:
    """Outputs after an input history, from rest, free of truncation error where the input is linear between samples.

    One matrix exponential carries the state over a step exactly, a rigid body's drift included; a system need not
    be stable. An input that does not start at zero jumps there.    [VanLoan1978]

    Parameters
    ----------
    history
        (m,) input at t = 0, step, 2 step, ...
    step
        [s].

    Returns
    -------
    (m, p)
        One column per named output.

    Raises
    ------
    ModelError
        For an unknown signal or a step that is not positive.
    """
    if not 0 < step < np.inf:
        raise ModelError(f"time response: step {step} s is not above zero; give a positive, finite one")
    for name, known in ((input_name, system.inputs), *((output, system.outputs) for output in outputs)):
        if name not in known:
            raise ModelError(f"signal '{name}' does not exist; {did_you_mean(name, known)}")
    column = system.inputs.index(input_name)
    rows = [system.outputs.index(output) for output in outputs]
    n = system.a.shape[0]
    # States, the input, and its rise over one step, which stays.
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[:n, n] = step * system.a, step * system.b[:, column]
    whole[n, n + 1] = 1.0
    carried = linalg.expm(whole)
    free, held, rising = carried[:n, :n], carried[:n, n], carried[:n, n + 1]
    driven = history[:-1, None] * held + np.diff(history)[:, None] * rising
    state = np.zeros((history.size, n))
    for k, push in enumerate(driven):
        state[k + 1] = free @ state[k] + push
    return state @ system.c[rows].T + history[:, None] * system.d[rows, column]
