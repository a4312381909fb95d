"""Sizings and trusses the tests of structural bounds share."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from reference import DAMPING, HELD, MIRROR_MASS, loop_of, mirror_of, structure
from scipy import sparse
from small_problems import expressions, limit, variable

from fosopt.modes import Hub
from fosopt.problem import Design, Problem, System
from fosopt.relax.sizing import AffineForm, Requirement, Sizing
from fosopt.structure import Structure

# What proofs of convex sizings leave after all their rounds, and what issues ask of them.
CLOSED, ASKED = 1e-7, 1e-6
# A closed form against a proof from a conic solver of tolerance 1e-10: boxes span two decades.
FORM = 1e-8
NOTHING = np.zeros((0, 0))


def form(rows: Any, constant: Any, slope: Any) -> AffineForm:
    """A form from plain numbers."""
    return AffineForm(
        sparse.csr_array(np.atleast_2d(rows)), np.array(constant, float), sparse.csr_array(slope)
    )


def sizing(
    cost: Any, *requirements: Requirement, lower: Any = 1e-6, upper: Any = 1e-2, **parts: Any
) -> Sizing:
    """A sizing whose parameters have one box."""
    cost = np.array(cost, float)
    names = tuple(f"a{i + 1}" for i in range(cost.size))
    return Sizing(
        names,
        np.full(cost.size, lower, float),
        np.full(cost.size, upper, float),
        cost,
        0.0,
        requirements,
        **parts,
    )


def bars_of(of: Structure, factor: float = 1.0, mirror_mass: float = MIRROR_MASS, **parts: Any) -> Problem:
    """Least mass of a structure of single bars whose first elastic frequency is `factor` times that of the start."""
    area = of.area
    box = parts.pop("box", (0.2, 5.0))
    hub = parts.pop("hub", Hub("fixed"))
    mirror = mirror_of(structure(), 0.2)
    base = Design(area, of.batten_mass, of.spring_stiffness, mirror_mass, loop_of(mirror))
    one_by_one = tuple((i,) for i in range(area.size))
    variables = (variable("area", box[0] * area, box[1] * area, area, groups=one_by_one),)
    problem = Problem(System(of, "tip", hub, DAMPING), base, variables, expressions("structural_mass"))
    first = problem.evaluate(problem.start).value("first_elastic_frequency")
    return replace(problem, constraints=(limit("first_elastic_frequency", lower=factor * first),))


def truss_of(boundary: str, bays: int, factor: float = 1.0, **parts: Any) -> Problem:
    """`bars_of` the dissertation's truss."""
    hub = Hub("fixed") if boundary == "fixed" else HELD
    return bars_of(structure(boundary, bays), factor, hub=hub, **parts)


def two_inertias(rate: float = 3.0) -> tuple[Sizing, float]:
    """A hub of inertia one on a spring x to an inertia 2 + x/2, both free to turn, and the least spring.

    ω² ≤ x (1/J₁ + 1/J₂) is x (3 + x/2) ≥ ω² (2 + x/2).
    """
    stiffness = form([1, -1], [0], [[1.0]])
    inertia = form(np.eye(2), [1.0, 2.0], [[0.0], [0.5]])
    requirement = Requirement("frequency", stiffness, inertia, rate, rigid=np.ones(2))
    square = rate**2
    least = float(np.roots([0.5, 3 - square / 2, -2 * square]).max())
    return sizing([1.0], requirement, lower=0.1, upper=100.0), least
