"""Co-design problems as data: the system, one design of it, variables, objectives and constraints."""

from fosopt.problem.evaluation import Evaluation
from fosopt.problem.problem import Constraint, Problem, Rows, branched
from fosopt.problem.system import INDEXED, LARGE, Design, ModeSelection, System
from fosopt.problem.two_axes import TwoAxisEvaluation, evaluation_of
from fosopt.problem.variables import Definitions, SecondAxisDefinitions, Variable, design_parameters

__all__ = [
    "INDEXED",
    "LARGE",
    "Constraint",
    "Definitions",
    "Design",
    "Evaluation",
    "ModeSelection",
    "Problem",
    "Rows",
    "SecondAxisDefinitions",
    "System",
    "TwoAxisEvaluation",
    "Variable",
    "branched",
    "design_parameters",
    "evaluation_of",
]
