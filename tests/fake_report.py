"""Run data for reports: a front with every state, cases, a spatial truss, and more points than anyone has."""

from __future__ import annotations

import math
from base64 import b64encode
from typing import Any

import numpy as np

HOSTILE = "<script>alert(1)</script>"
BAYS, BAY = 20, 0.354
HERTZ = 2 * math.pi


def quantities() -> dict[str, dict[str, object]]:
    """Labels and display units of what the fake run holds."""
    rows = [
        ("structural_mass", "structural mass", "kg", "structural_mass_kg", 1.0),
        ("total_mass", "total mass", "kg", "total_mass_kg", 1.0),
        ("jitter_total", "total jitter", "urad", "jitter_total_urad", 1e6),
        ("jitter_cooling", "jitter by cooling", "urad", "jitter_cooling_urad", 1e6),
        ("jitter_hub", "jitter by hub", "urad", "jitter_hub_urad", 1e6),
        ("jitter_sensor", "jitter by sensor", "urad", "jitter_sensor_urad", 1e6),
        ("first_elastic_frequency", "first elastic frequency", "Hz", "first_elastic_frequency_hz", 1 / HERTZ),
        ("crossover", "crossover", "Hz", "crossover_hz", 1 / HERTZ),
        ("spectral_abscissa", "spectral abscissa", "rad/s", "spectral_abscissa", 1.0),
        ("modulus_margin", "modulus margin", "-", "modulus_margin", 1.0),
        ("step_offset", "step offset", "urad", "step_offset_urad", 1e6),
        ("mirror_inertia", "mirror inertia", "kg m^2", "mirror_inertia_kg_m2", 1.0),
        ("area", "area", "mm^2", "area_mm2", 1e6),
        ("kp", "proportional gain", "1/s", "kp", 1.0),
        ("ki", "integral gain", "1/s^2", "ki", 1.0),
        ("mass_lower_bound", "least mass for the requirements", "kg", "mass_lower_bound_kg", 1.0),
        ("jitter_bound_any", "least jitter with any controller", "urad", "jitter_bound_any_urad", 1e6),
    ]
    return {
        name: {"label": label, "unit": unit, "column": column, "factor": factor}
        for name, label, unit, column, factor in rows
    }


def truss(mass: float, seed: int) -> dict[str, object]:
    """The planar truss of the dissertation, with areas that taper from the hub to the tip."""
    nodes = [[BAY * station, side * BAY / 2] for station in range(BAYS + 1) for side in (-1, 1)]
    bars, kinds, names = [], [], []
    for bay in range(BAYS):
        low, high = 2 * bay, 2 * bay + 1
        corners = (low, high + 2) if bay % 2 == 0 else (high, low + 2)
        bars += [[low, low + 2], [high, high + 2], list(corners)]
        kinds += ["longeron", "longeron", "diagonal"]
        names += [f"L{2 * bay + 1}", f"L{2 * bay + 2}", f"D{bay + 1}"]
    spread = np.random.default_rng(seed).normal(0, 0.03, len(bars))
    station = np.repeat(np.arange(BAYS) / BAYS, 3)
    taper = np.where(np.array(kinds) == "longeron", 0.15 + (1 - station) ** 1.6, 0.2 + 0.25 * station)
    areas = 22e-6 * mass * taper * (1 + spread)
    return {
        "nodes": nodes,
        "bars": bars,
        "areas": np.clip(areas, 20e-6, 500e-6).tolist(),
        "kinds": kinds,
        "names": names,
        "battens": [[2 * station, 2 * station + 1] for station in range(BAYS + 1)],
    }


def shapes(made: dict[str, object], count: int) -> dict[str, object]:
    """Half waves of a truss and of the mirror at its end; the last mode moves nothing that can be drawn."""
    nodes: Any = made["nodes"]
    x = np.array([*(node[0] for node in nodes), BAY * BAYS]) / (BAY * BAYS)
    values: list[str | None] = []
    for k in range(count - 1):
        across = np.sin((k + 0.5) * np.pi * x)
        moved = np.column_stack([np.zeros(x.size), across / np.abs(across).max()])
        values.append(b64encode(np.rint(127 * moved).astype(np.int8).tobytes()).decode())
    angles: list[float | None] = [0.25 * (k + 1) for k in range(count - 1)]
    return {"values": [*values, None], "mirror": [*angles, None], "port": [*angles, None]}


def detail(mass: float, jitter: dict[str, float], seed: int) -> dict[str, object]:
    """Curves of the shape a flexible loop has: poles beside zeros above a rigid-body slope."""
    poles = 5.2 * np.sqrt(mass / 9) * np.array([1.0, 2.7, 3.9, 5.1, 8.3, 12.4, 17.0, 24.0, 38.0, 55.0])
    inertia = np.array([0.004, 0.011, 0.871, 0.052, -0.008, 0.021, 0.009, 0.017, 0.014, 0.009])
    zeros = poles * np.sqrt(1 - 0.25 * inertia)
    damping = np.array([0.001, 0.001, 0.0099, *[0.0012] * 7])
    frequency = np.geomspace(0.1, 2000, 500)
    ratio = np.ones(frequency.size, dtype=complex)
    for pole, zero, zeta in zip(poles, zeros, damping, strict=True):
        ratio *= (zero**2 - frequency**2 + 2j * zeta * zero * frequency) / (
            pole**2 - frequency**2 + 2j * zeta * pole * frequency
        )
    s, crossover = 1j * HERTZ * frequency, 230 * HERTZ
    loop = crossover**3 / abs((1j * crossover) ** 2 + 600 * 1j * crossover + 5e4)
    loop = loop * (s**2 + 600 * s + 5e4) / s**3 * ratio / (1 + s / (HERTZ * 2000))
    sensitivity = 1 / (1 + loop)
    rise = [1 / (1 + (corner / frequency) ** 1.5) for corner in (9, 30, 260)]
    cumulative = {name: value * part for (name, value), part in zip(jitter.items(), rise, strict=True)}
    upper = HERTZ * poles * (-damping + 1j)
    time = np.linspace(0, 0.12, 400)
    ring = 0.04 * np.exp(-6 * time) * np.sin(HERTZ * poles[3] * time)
    ring += np.exp(-90 * time) * np.cos(400 * time)
    made = truss(mass, seed)
    return {
        "truss": made,
        "shapes": shapes(made, len(poles)),
        "places": [{"kind": "mirror", "port": "tip", "at": "B20", "xyz": [BAY * BAYS, 0.0]}],
        "modes": [
            {
                "index": k + 1,
                "frequency_hz": float(poles[k]),
                "damping_ratio": float(damping[k]),
                "effective_modal_reaction_inertia": float(inertia[k]),
                "pole_zero_separation": float(poles[k] / zeros[k]),
                "modal_inertia": float(0.4 / (abs(inertia[k]) + 0.01)) if k else None,
                "jitter_share": float(inertia[k]),
            }
            for k in range(len(poles))
        ],
        "bode": {
            "frequency_hz": frequency.tolist(),
            "loop_magnitude": abs(loop).tolist(),
            "loop_phase_deg": (np.degrees(np.unwrap(np.angle(loop))) - 360).tolist(),
            "sensitivity": abs(sensitivity).tolist(),
            "complementary_sensitivity": abs(1 - sensitivity).tolist(),
        },
        "jitter": jitter,
        "spectrum": {
            "frequency_hz": frequency.tolist(),
            **{name: (value / (1 + frequency)).tolist() for name, value in jitter.items()},
            "total": (math.hypot(*jitter.values()) / (1 + frequency)).tolist(),
        },
        "by_mode": {
            "modes": [
                {
                    "frequency_hz": float(poles[k]),
                    "damping_ratio": 0.002,
                    "structure_frequency_hz": float(zeros[k]),
                    "share": share,
                }
                for k, share in enumerate((0.5, 0.2, -0.05))
            ],
            "other_modes": 0.05,
            "count": 10,
            "loop": 0.3,
            "cumulative": {
                "frequency_hz": frequency.tolist(),
                **{
                    name: (share * mass / (9 + frequency**-1)).tolist()
                    for name, share in (
                        ("mode 1", 0.5),
                        ("mode 2", 0.2),
                        ("mode 3", -0.05),
                        ("other modes", 0.05),
                        ("loop", 0.3),
                    )
                },
            },
        },
        "cumulative": {
            "frequency_hz": frequency.tolist(),
            **{name: values.tolist() for name, values in cumulative.items()},
            "total": np.sqrt(sum(values**2 for values in cumulative.values())).tolist(),
        },
        "step": {
            "time_s": time.tolist(),
            "response": (1e-6 * (1 - ring)).tolist(),
            "window": [0.05, 0.1],
            "command": 1e-6,
            "window_time_s": time[170:330].tolist(),
            "window_error": (-1e-6 * ring[170:330]).tolist(),
            "mean": 1e-9,
            "rms": 2e-8,
        },
        "poles": [*[[float(p.real), float(p.imag)] for p in (*upper, *upper.conj())], [-95.0, 0.0]],
    }


def point(number: int, mass: float, strategy: str = "simultaneous", penalty: float = 1.0) -> dict[str, Any]:
    """One verified point of a front on which jitter falls as mass grows."""
    level = penalty * (18e-6 + 2.6e-3 / mass**1.9)
    jitter = {"cooling": 0.85 * level, "hub": 0.45 * level, "sensor": 0.27 * level}
    total = math.hypot(*jitter.values())
    first = HERTZ * 5.2 * math.sqrt(mass / 9)
    return {
        "key": f"{number:03d}",
        "label": "anchor: least structural_mass" if number == 0 else f"structural_mass {mass:.1f} kg",
        "case": None,
        "strategy": strategy,
        "status": "optimal",
        "verified": True,
        "dominated": False,
        "reason": None,
        "parent": f"{number - 1:03d}" if 0 < number < 100 else None,
        "seconds": 0.31 + 0.02 * number,
        "iterations": 24 + number,
        "starts": {"tried": 3, "agreed": 3},
        "kkt_residual": 3.2e-9,
        "objective": "jitter_total",
        "bounds": bounds(mass, total),
        "variables": {"area": truss(mass, number)["areas"], "kp": [600.0 + 8 * number], "ki": [5e4]},
        "metrics": {
            "structural_mass": mass,
            "total_mass": mass + 352.1,
            "mirror_inertia": 0.408,
            "first_elastic_frequency": first,
            "crossover": 230 * HERTZ,
            "spectral_abscissa": -0.021,
            "modulus_margin": 0.52,
            "jitter_total": total,
            **{f"jitter_{name}": value for name, value in jitter.items()},
            "step_offset": 3.1e-9,
        },
        "constraints": [
            {
                "name": "first_elastic_frequency",
                "value": first,
                "lower": 4 * HERTZ,
                "upper": None,
                "slack": first - 4 * HERTZ,
                "multiplier": 0.0,
                "active": False,
                "statement": None,
            },
            {
                "name": "modulus_margin",
                "value": 0.52,
                "lower": 0.5,
                "upper": None,
                "slack": 0.02,
                "multiplier": 1.4e-6,
                "active": False,
                "statement": None,
            },
            {
                "name": "structural_mass",
                "value": mass,
                "lower": None,
                "upper": mass,
                "slack": 0.0,
                "multiplier": 6.1e-6,
                "active": True,
                "statement": "1 kg more saves 6.1 µrad of total jitter",
            },
        ],
        "history": [[k, total * (1 + 3 * math.exp(-k / 3)), 10 ** (-0.4 * k)] for k in range(24 + number)],
        "detail": detail(mass, jitter, number),
    }


def bounds(mass: float, total: float) -> list[dict[str, object]]:
    """An account: a floor on the mass that is one for all, and one on the jitter of each structure."""
    return [
        {
            "name": name,
            "value": value,
            "reached": reached,
            "gap": 1 - value / reached,
            "of": f"{name} of every structure",
            "assumptions": [HOSTILE],
            "allowance": 0.0,
            "remark": "",
        }
        for name, value, reached in (
            ("mass_lower_bound", 5.1, mass),
            ("jitter_bound_any", 0.7 * total, total),
        )
    ]


def fake_run() -> dict[str, object]:
    """A front of twelve points with every state, a baseline strategy, and a hostile name."""
    points = [point(number, 5.6 + 0.9 * number + 0.06 * number**2) for number in range(12)]
    points[7] |= {"dominated": True}
    points[7]["metrics"] |= {"jitter_total": 62e-6}
    points[10] |= {
        "status": "infeasible",
        "verified": False,
        "reason": "modulus margin 0.46 is below 0.5 and no step improves it; allow a lower one",
    }
    points[11] |= {
        "status": "unstable",
        "verified": False,
        "reason": "closed-loop pole at 18.2 Hz grows by 0.10 /s; lower the crossover or the inertia ratio",
    }
    points[11]["metrics"] |= {"spectral_abscissa": 0.1}
    points[11]["detail"]["poles"] += [[0.1, 18.2 * HERTZ], [0.1, -18.2 * HERTZ]]
    points += [point(100 + k, 5.6 + 3.1 * k, "sequential", 1.22 + 0.05 * k) for k in range(4)]
    for late in points[12:]:
        late |= {"dominated": True, "parent": None}
    return {
        "name": HOSTILE,
        "description": "Twenty-bay truss of 7.07 m under a fast steering mirror; areas and gains together.",
        "kind": "codesign",
        "provenance": {
            "fosopt": "0.1.0",
            "study": "mass_jitter.yaml",
            "seed": "1",
            "sha256": "9f2c" * 16,
            "git_dirty": True,
            "options": {"tolerance": 1e-8, "threads": [1, 2]},
        },
        "quantities": quantities(),
        "objectives": ["structural_mass", "jitter_total"],
        "requirements": {"jitter_total": 75e-6, "jitter_hub": 40e-6},
        "points": points,
        "comparison": [
            {"at": {"structural_mass": 5.6}, "simultaneous": 90e-6, "sequential": 113e-6},
            {"at": {"structural_mass": 8.7}, "simultaneous": 70e-6, "sequential": 90e-6},
            {"at": {"structural_mass": 14.9}, "simultaneous": 33e-6, "sequential": None},
        ],
        "comparison_objective": "jitter_total",
    }


def single_run() -> dict[str, object]:
    """One objective and three cases, none of which has a detail of loop or step."""
    points = []
    for number, (case, mass) in enumerate(
        [("gains alone", 9.0), ("structure alone", 7.4), ("both <b>free</b>", 6.1)]
    ):
        made = point(number, mass)
        made |= {"case": case, "label": "", "parent": None}
        made["detail"] = {"truss": truss(mass, number)}
        points.append(made)
    run = fake_run() | {"name": "Mass by cases", "objectives": ["structural_mass"], "points": points}
    return run | {"comparison": []}


def spatial_run() -> dict[str, object]:
    """One analyzed design on a spatial truss; most optional parts are absent."""
    corners = [(0.0, 0.0), (0.354, 0.0), (0.177, 0.307)]
    nodes = [[0.4 * station, *corner] for station in range(9) for corner in corners]
    bars = [[3 * k + i, 3 * k + 3 + j] for k in range(8) for i in range(3) for j in (i, (i + 1) % 3)]
    battens = [[3 * k + i, 3 * k + (i + 1) % 3] for k in range(9) for i in range(3)]
    made = point(0, 8.0) | {"status": "evaluated", "parent": None, "starts": None, "history": []}
    made["detail"] = {
        "truss": {
            "nodes": nodes,
            "bars": bars,
            "areas": [(120 - 2 * k) * 1e-6 for k in range(len(bars))],
            "kinds": ["longeron", "diagonal"] * (len(bars) // 2),
            "names": [f"B{k}" for k in range(len(bars))],
            "battens": battens,
        }
    }
    return {"name": "Spatial mast", "kind": "analysis", "objectives": ["jitter_total"], "points": [made]}


def large_run(count: int) -> dict[str, object]:
    """Points that know their two objectives and nothing else."""
    points = [
        {
            "key": f"{k:05d}",
            "status": "optimal",
            "verified": True,
            "metrics": {"structural_mass": 5 + 1e-3 * k, "jitter_total": 1e-4 / (1 + 1e-3 * k)},
        }
        for k in range(count)
    ]
    return {"objectives": ["structural_mass", "jitter_total"], "points": points}
