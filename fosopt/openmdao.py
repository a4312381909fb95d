"""A co-design problem as a component of OpenMDAO, for models that reach beyond structure, mirror and loop.

    import fosopt, openmdao.api as om
    from fosopt.openmdao import CodesignComponent

    problem = fosopt.build_problem(fosopt.load_study("study.yaml"))
    model.add_subsystem("optics", CodesignComponent(problem=problem))

Needs OpenMDAO: pip install 'fosopt[openmdao]'.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from fosopt.errors import ModelError, UnstableError
from fosopt.expressions import parse_expression
from fosopt.ops import Array
from fosopt.problem import Problem, Rows

try:
    import openmdao.api as om
except ImportError as error:
    raise ImportError("fosopt.openmdao needs OpenMDAO; install it: pip install 'fosopt[openmdao]'") from error


class CodesignComponent(om.ExplicitComponent):  # type: ignore[misc]
    """Metrics of a problem as explicit functions of its variables, with exact partial derivatives.

    Every design variable is an input of its name, (g,) for a variable of g groups. Every metric, or expression of
    metrics and variables, is a scalar output whose name is that of the metric, or the words of the expression joined
    by underscores. All are in SI units. A loop without jitter, because it is unstable, raises OpenMDAO's
    ``AnalysisError``, from which its drivers step back.

    Its options are `problem`, the `Problem`, and `metrics`, texts of metrics or expressions; by default those of
    objectives and constraints.
    """

    def initialize(self) -> None:
        """Declare the options."""
        self.options.declare("problem", types=Problem, recordable=False)
        self.options.declare("metrics", types=(list, tuple), default=())

    def setup(self) -> None:
        """Declare inputs, outputs and partial derivatives.

        Raises
        ------
        ModelError
            For an unknown metric, or two expressions of one name.
        """
        problem: Problem = self.options["problem"]
        expressions = tuple(parse_expression(text) for text in self.options["metrics"])
        if not expressions:
            every = (*problem.objectives, *(c.expression for c in problem.constraints))
            expressions = tuple({expression.text: expression for expression in every}.values())
        self._names = [re.sub(r"\W+", "_", expression.text).strip("_") for expression in expressions]
        if len({*self._names, *problem.slices()}) < len(self._names) + len(problem.slices()):
            raise ModelError(
                f"metrics: the names {', '.join(self._names)} are not unique or are those of variables; "
                "name each expression once, and no variable alone"
            )
        self._rows = Rows(problem, expressions)
        self._at: tuple[bytes, Any] = (b"", None)
        for variable in problem.variables:
            self.add_input(variable.name, val=variable.start, desc=f"{variable.quantity}, SI")
        for name, expression in zip(self._names, expressions, strict=True):
            self.add_output(name, desc=f"{expression.text}, SI")
        self.declare_partials("*", "*")

    def compute(self, inputs: Mapping[str, Array], outputs: Any) -> None:
        """Values of all outputs; OpenMDAO's ``AnalysisError`` if one needs the jitter of an unstable loop."""
        x = self._vector(inputs)
        for name, value in zip(self._names, self._answer(x, self._rows.values), strict=True):
            outputs[name] = value

    def compute_partials(self, inputs: Mapping[str, Array], partials: Any) -> None:
        """Exact derivatives of all outputs for all inputs."""
        x = self._vector(inputs)
        _, jacobian = self._answer(x, self._rows)
        for name, row in zip(self._names, jacobian, strict=True):
            for variable, part in self.options["problem"].slices().items():
                partials[name, variable] = row[part]

    def _vector(self, inputs: Mapping[str, Array]) -> Array:
        return np.concatenate([np.ravel(inputs[v.name]) for v in self.options["problem"].variables])

    def _answer(self, x: Array, ask: Any) -> Any:
        """What the rows say at `x`; values and derivatives share one evaluation."""
        if self._at[0] != x.tobytes():
            self._at = (x.tobytes(), self.options["problem"].evaluate(x))
        try:
            return ask(x, self._at[1])
        except UnstableError as error:
            raise om.AnalysisError(str(error)) from error
