"""The highest first elastic frequency a structure can have for what it may cost.

The least cost grows with the frequency asked for. Where its proven bound passes a limit, no structure within the limit
reaches that frequency: the same proof, read the other way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite

from fosopt.errors import SolverError
from fosopt.expressions import parse_expression
from fosopt.ops import Array
from fosopt.problem import Constraint, Evaluation, Problem
from fosopt.relax.proof import Proof
from fosopt.relax.sizing import Sizing
from fosopt.relax.structural import structural_part
from fosopt.relax.structure_floor import FREE_HUB_TOLERANCE, TOLERANCE, assumptions, search

_FREQUENCY = "first_elastic_frequency"
_STEPS = 60
# A secant step lands this share of the bracket inside it at least.
_INSIDE = 0.01


@dataclass(frozen=True)
class FrequencyCeiling:
    """A frequency that no structure within a limit of cost reaches.

    Attributes
    ----------
    value
        The frequency [rad/s].
    of, assumptions
        What it bounds, and under which assumptions.
    sizing, proof
        Asking for that frequency, with a proven cost above the limit.
    limit
        Of the cost.
    reached
        What a structure within the limit is known to reach [rad/s].
    design
        (n,) that structure, values of all variables; None if none is known.
    """

    value: float
    of: str
    assumptions: tuple[str, ...]
    sizing: Sizing
    proof: Proof
    limit: float
    reached: float
    design: Array | None

    def recomputed(self, exact: bool = False) -> bool:
        """Whether sizing and proof alone say that the frequency costs more than the limit.

        Raises
        ------
        SolverError
            If the proof is none.
        """
        value = self.proof.exact_value(self.sizing) if exact else self.proof.value(self.sizing)[0]
        return value > self.limit


def frequency_ceiling(
    problem: Problem,
    x: Array,
    limit: float | None = None,
    constraints: Sequence[Constraint] = (),
    objective: str = "structural_mass",
    *,
    tolerance: float | None = None,
    pieces: int = 8,
    evaluation: Evaluation | None = None,
) -> FrequencyCeiling:
    """Prove how high the first elastic frequency of every structure in the box can be.

    Parameters
    ----------
    x
        (n,) values of all variables: a start, and the design the bound is compared with.
    limit
        On the objective; by default what the design at `x` costs.
    constraints, objective, evaluation
        What structures must meet besides, see `structural.structural_part`.
    tolerance
        Of the frequency, relative; by default as for `structure_floor`.
    pieces
        See `structure_floor`.

    Raises
    ------
    SolverError
        If no frequency was found whose cost passes the limit.
    """
    if evaluation is None:
        evaluation = problem.evaluate(x, truth=True)
    own = evaluation.value(_FREQUENCY)
    asked = Constraint(parse_expression(_FREQUENCY), lower=own)
    others = [c for c in constraints if c.expression.reference != (_FREQUENCY, None)]
    part = structural_part(problem, (*others, asked), x, objective, evaluation=evaluation)
    limit = part.value if limit is None else limit
    close = tolerance or (TOLERANCE if part.sizing.turning is None else FREE_HUB_TOLERANCE)

    def at(rate: float) -> tuple[Sizing, Proof, float, Array | None]:
        requirements = tuple(replace(r, rate=rate) if r.load is None else r for r in part.sizing.requirements)
        sizing = replace(part.sizing, requirements=requirements)
        # The design itself has another frequency: it is a start, not an answer.
        found, proof = search(replace(part, sizing=sizing, misses=(_FREQUENCY,)), close / 10, pieces)
        return sizing, proof, proof.value(sizing)[0], found

    low, reached, design = 0.0, 0.0, None
    if not part.misses and part.value <= limit:
        reached, design = own, x
    high, above, below, rate, best = inf, inf, 0.0, own, None
    for _ in range(_STEPS):
        sizing, proof, value, found = at(rate)
        if value > limit:
            high, best, above = rate, (sizing, proof), value
        else:
            low, below = rate, value
        if found is not None and sizing.value(found) <= limit and rate > reached:
            reached = rate
            design = x.copy()
            design[part.positions] = found
        if high - low <= close * low:
            break
        if best is None:
            rate *= 1.1
        elif low == 0:
            rate /= 1.1
        else:
            share = (limit - below) / (above - below) if isfinite(above) else 0.5
            share = min(max(share, _INSIDE), 1 - _INSIDE)
            rate = low + share * (high - low)
    if best is None:
        raise SolverError(f"no frequency was found that costs more than {limit:g}; lower the limit")
    of = f"{_FREQUENCY} of every structure in the box whose {objective} is {limit:.10g} at most"
    if part.kept[1:]:
        of += f" and that meets: {', '.join(said for said in part.kept if _FREQUENCY not in said)}"
    return FrequencyCeiling(high, of, assumptions(part, best[1]), *best, limit, reached, design)
