"""Which constraints conflict: the least violation with which a task can be met."""

from __future__ import annotations

import numpy as np

from fosopt.ops import Array
from fosopt.solve.ipopt import Solution
from fosopt.solve.nlp import NonlinearProgram

# Scaled violation and multiplier above which a row counts: well above the solver's tolerance.
_COUNTS = 1e-5


class ElasticProgram:
    """A program whose rows may be violated; the sum of the scaled violations is minimized.

    Every row gets a slack, the last variables of the scaled point.
    """

    def __init__(self, program: NonlinearProgram) -> None:
        self.program = program
        self.start = program.start
        m = program.row_lower.size
        self.lower = np.concatenate([program.lower, np.zeros(m)])
        self.upper = np.concatenate([program.upper, np.full(m, np.inf)])
        # Two rows each: the slack lifts the lower limit and lowers the upper one.
        self.row_lower = np.concatenate([program.row_lower, np.full(m, -np.inf)])
        self.row_upper = np.concatenate([np.full(m, np.inf), program.row_upper])
        self.row_scale = np.concatenate([program.row_scale, program.row_scale])
        self.row_names = program.row_names * 2
        self._rows = m

    def objective(self, value: float) -> float:
        """The sum of violations, as it is."""
        return value

    def objective_slope(self, value: float) -> float:
        """One."""
        return 1.0

    def scaled(self, x: Array) -> Array:
        """Scaled point with slacks that just meet all rows."""
        program = self.program
        z = program.scaled(x)
        answer = program(z)
        rows = answer[2] if answer is not None else np.zeros(self._rows)
        violation = np.maximum(program.row_lower - rows, rows - program.row_upper)
        return np.concatenate([z, np.maximum(violation, 0.0) + 1e-3])

    def unscaled(self, z: Array) -> Array:
        """(n,) values of all variables."""
        return self.program.unscaled(z[: z.size - self._rows])

    def __call__(self, z: Array) -> tuple[float, Array, Array, Array] | None:
        """Sum of slacks, its gradient, softened rows and their Jacobian."""
        m = self._rows
        slack = z[z.size - m :]
        answer = self.program(z[: z.size - m])
        if answer is None:
            return None
        _, gradient, rows, jacobian = answer
        ones = np.eye(m)
        return (
            float(slack.sum()),
            np.concatenate([np.zeros(gradient.size), np.ones(m)]),
            np.concatenate([rows + slack, rows - slack]),
            np.block([[jacobian, ones], [jacobian, -ones]]),
        )

    def conflict(self, solution: Solution) -> str | None:
        """The constraints that conflict, in words, or None where all can be met."""
        answer = self.program(self.program.scaled(solution.x))
        if answer is None:
            return "no design near here has all metrics; start elsewhere or free more variables"
        rows, program = answer[2], self.program
        violation = np.maximum(program.row_lower - rows, rows - program.row_upper)
        if violation.max(initial=0.0) <= _COUNTS:
            return None
        m = self._rows
        pressed = np.abs(solution.multipliers * self.row_scale).reshape(2, m).max(axis=0)
        involved = dict.fromkeys(
            name
            for name, v, p in zip(program.row_names, violation, pressed, strict=True)
            if max(v, p) > _COUNTS
        )
        worst = int(np.argmax(violation))
        return (
            f"constraints conflict: {', '.join(involved)}; every design near here misses the bound on "
            f"{program.row_names[worst]} by {100 * violation[worst]:.3g} % or more; relax one of them or widen bounds"
        )
