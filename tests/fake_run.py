"""A small run with every kind of point, as the runner would return it."""

from __future__ import annotations

import math
from typing import Any

HERTZ = 2 * math.pi


def quantity(label: str, unit: str, factor: float, column: str, column_factor: float = 1.0) -> dict[str, Any]:
    return {
        "label": label,
        "unit": unit,
        "factor": factor,
        "column": column,
        "column_factor": column_factor,
    }


def point(key: str, status: str = "optimal", **changes: Any) -> dict[str, Any]:
    """A point whose numbers follow from its key."""
    number = int(key) if key.isdigit() else 0
    return {
        "key": key,
        "label": f"point {key}",
        "case": None,
        "strategy": None if key == "start" else "simultaneous",
        "status": status,
        "verified": status in ("optimal", "evaluated"),
        "dominated": False,
        "reason": None,
        "parent": None,
        "seconds": 0.1,
        "iterations": 12,
        "starts": None,
        "kkt_residual": 1e-9 / 3,
        "variables": {"area": [1e-5 / 3, 2e-5 + number], "crossover": [230 * HERTZ]},
        "metrics": {
            "structural_mass": 9.1 + number,
            "jitter_total": None if status == "unstable" else 1e-5 / (1 + number),
            "first_elastic_frequency": 6 * HERTZ,
            "crossover": 230 * HERTZ,
            "modulus_margin": 0.5,
        },
        "constraints": [
            {
                "name": name,
                "value": 6.0,
                "lower": lower,
                "upper": None,
                "slack": slack,
                "multiplier": None,
                "active": False,
                "statement": None,
            }
            for name, lower, slack in (
                ("first_elastic_frequency", 5.0, 1.0),
                ("a - b[2]", 5.5, 0.5),
                ("a - b[2]", 5.75, 0.25),
            )
        ],
        "history": [[0, 1.0, 0.1]],
        "detail": {"poles": [[-1.0, 2.0]]},
        **changes,
    }


def fake_run(*points: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """The run data of a front."""
    return {
        "name": "Mass against jitter",
        "description": "µ",
        "kind": "codesign",
        "provenance": {"seed": "1"},
        "quantities": {
            "structural_mass": quantity("structural mass", "kg", 1.0, "structural_mass_kg"),
            "jitter_total": quantity("total jitter", "urad", 1e6, "jitter_total_rad"),
            "first_elastic_frequency": quantity(
                "first elastic frequency", "Hz", 1 / HERTZ, "first_elastic_frequency_hz", 1 / HERTZ
            ),
            "crossover": quantity("crossover", "Hz", 1 / HERTZ, "crossover_hz", 1 / HERTZ),
            "modulus_margin": quantity("modulus margin", "", 1.0, "modulus_margin"),
            "area": quantity("area", "mm^2", 1e6, "area_m2"),
        },
        "labels": {"area": ["L1", "root bars"]},
        "objectives": ["structural_mass", "jitter_total"],
        "requirements": {"jitter_total": 1e-4},
        "points": list(points),
        "comparison": [],
        "comparison_objective": None,
        **changes,
    }
