"""Points of the run data: which are dominated, how strategies compare, what a bound costs."""

from __future__ import annotations

from math import pi
from typing import Any

import pytest
from small_studies import STUDIES

from fosopt.study import load_study
from fosopt.study.points import comparison, mark_dominated, state_prices


def point_of(mass: float | None, jitter: float | None, **more: Any) -> dict[str, Any]:
    return {
        "verified": True,
        "dominated": False,
        "strategy": "simultaneous",
        "metrics": {"mass": mass, "jitter": jitter},
    } | more


def test_a_point_that_another_beats_in_both_objectives_is_dominated():
    points = [point_of(1, 5), point_of(2, 4), point_of(2, 6), point_of(3, 4), point_of(4, 1)]
    assert mark_dominated(points, ["mass", "jitter"])
    assert [p["dominated"] for p in points] == [False, False, True, True, False]


def test_equal_points_do_not_dominate_each_other_even_by_a_solver_tolerance():
    points = [point_of(1.0, 5.0), point_of(1.0, 5.0), point_of(1 - 1e-9, 5 * (1 - 1e-8))]
    assert not mark_dominated(points, ["mass", "jitter"])


def test_only_verified_designs_that_were_sought_can_dominate():
    points = [
        point_of(1, 1, verified=False),
        point_of(1, 1, strategy=None),
        point_of(None, 1),
        point_of(5, 5),
    ]
    assert not mark_dominated(points, ["mass", "jitter"])
    assert not mark_dominated([point_of(1, 1), point_of(2, 2)], ["mass"])


def test_a_strategy_that_failed_is_an_empty_cell_of_the_comparison():
    study = load_study(STUDIES / "quickstart.yaml", ("solve.compare=[sequential]",))
    limits = [{"name": "structural_mass", "upper": 20.0}]
    points = [
        {
            "strategy": name,
            "verified": name != "sequential",
            "constraints": limits,
            "metrics": {"jitter_total": 1.0},
        }
        for name in ("simultaneous", "sequential")
    ]
    points.append(points[0] | {"strategy": None})
    points.append(points[0] | {"constraints": [{"name": "jitter_total", "upper": 3.0}]})
    (row,) = comparison(study, points)
    assert row == {"at": {"structural_mass": 20.0}, "simultaneous": 1.0, "sequential": None}


@pytest.mark.parametrize(
    ("multiplier", "statement"),
    [(2e-6, "1 Hz more costs 12.6 urad"), (-2e-6, "1 Hz more saves 12.6 urad"), (0.0, None), (None, None)],
)
def test_a_price_converts_both_units_and_says_whether_it_costs_or_saves(multiplier, statement):
    quantities = {
        "jitter": {"factor": 1e6, "unit": "urad"},
        "frequency": {"factor": 1 / (2 * pi), "unit": "Hz"},
    }
    constraint = {"name": "frequency", "multiplier": multiplier, "active": True, "statement": None}
    idle = constraint | {"active": False}
    composed = constraint | {"name": "frequency/2"}
    point = {"objective": "jitter", "status": "optimal", "constraints": [constraint, idle, composed]}
    state_prices(point, quantities)
    assert constraint["statement"] == statement
    assert idle["statement"] is None
    assert composed["statement"] is None


def test_only_an_optimum_has_prices():
    quantities = {"jitter": {"factor": 1.0, "unit": "rad"}, "mass": {"factor": 1.0, "unit": "kg"}}
    constraint = {"name": "mass", "multiplier": 1.0, "active": True, "statement": None}
    for status in ("failed", "infeasible", "interrupted"):
        state_prices({"objective": "jitter", "status": status, "constraints": [constraint]}, quantities)
        assert constraint["statement"] is None
