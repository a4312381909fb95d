"""The report is one file that asks nothing of any network, shows a run, and hides its false numbers."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import re
from base64 import b64encode
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fosopt.report import write_report

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
    return {
        "truss": truss(mass, seed),
        "modes": [
            {
                "index": k + 1,
                "frequency_hz": float(poles[k]),
                "damping_ratio": float(damping[k]),
                "effective_modal_reaction_inertia": float(inertia[k]),
                "pole_zero_separation": float(poles[k] / zeros[k]),
                "modal_inertia": float(0.4 / (abs(inertia[k]) + 0.01)) if k else None,
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
        "provenance": {"fosopt": "0.1.0", "study": "mass_jitter.yaml", "seed": "1", "sha256": "9f2c" * 16},
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


class Page(HTMLParser):
    """What a browser would find in a report: tags with their attributes, and the text of each script."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self._within = False
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._within = tag == "script"
        if self._within:
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._within = False

    def handle_data(self, data: str) -> None:
        if self._within:
            self.scripts[-1] += data

    @property
    def data(self) -> dict[str, Any]:
        parsed = json.loads(self.scripts[0])
        assert isinstance(parsed, dict)
        return parsed

    @property
    def policy(self) -> str:
        (content,) = [tag[1]["content"] for tag in self.tags if "http-equiv" in tag[1]]
        assert content is not None
        return content


def written(run: dict[str, object], folder: Path) -> Page:
    path = folder / "report.html"
    write_report(run, path)
    return Page(path)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    return written(fake_run(), tmp_path_factory.mktemp("report"))


def test_the_page_has_one_data_block_the_library_and_one_script(page: Page) -> None:
    kinds = [attributes.get("type") for tag, attributes in page.tags if tag == "script"]
    assert kinds == ["application/json", None, None]
    assert "plotly.js" in page.scripts[1][:200]


def test_hostile_text_never_becomes_markup(page: Page, tmp_path: Path) -> None:
    hostile = [
        "</script><script>alert(2)</script>",
        "<!--<script>",
        "\u2028\u2029 & ]]>",
        "\ud800 ${a} $data",
    ]
    run = fake_run() | {"description": "".join(hostile), "provenance": dict.fromkeys(hostile, HOSTILE)}
    other = written(run, tmp_path)
    assert len(other.scripts) == 3
    assert [tag for tag, _ in other.tags] == [tag for tag, _ in page.tags]
    assert other.data["description"] == run["description"]
    assert page.data["name"] == HOSTILE
    assert not re.search(r"[<>&\u2028]|[^\x00-\x7f]", other.scripts[0])


def test_the_policy_allows_the_two_scripts_by_hash_and_no_request(page: Page) -> None:
    directives = dict(part.strip().split(" ", 1) for part in page.policy.split(";"))
    hashes = [b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in page.scripts[1:]]
    assert directives["script-src"].split() == [f"'sha256-{digest}'" for digest in hashes]
    assert directives["default-src"] == "'none'"
    assert set(directives["img-src"].split()) == {"data:", "blob:"}


def test_only_a_front_drawn_by_webgl_may_evaluate_code(tmp_path: Path) -> None:
    assert "unsafe-eval" not in written(large_run(10_000), tmp_path).policy
    assert "'unsafe-eval'" in written(large_run(10_001), tmp_path).policy


def test_nothing_outside_the_library_names_another_address(page: Page) -> None:
    for tag, attributes in page.tags:
        assert not {"src", "srcset", "action", "ping"} & attributes.keys(), tag
        assert (attributes.get("href") or "#").startswith("#")
    for asset in (files("fosopt.report") / "assets").iterdir():
        assert not re.search(r"https?:|@import|url\(|//\w+\.", asset.read_text(encoding="utf-8")), asset.name


def test_the_script_inserts_text_as_text_only(page: Page) -> None:
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|DOMParser", page.scripts[2])


def test_every_element_the_script_looks_up_exists_or_is_made_by_it(page: Page) -> None:
    made = re.findall(r'\[\s*"(\w+)",\s*"(?:full|half)"', page.scripts[2])
    known = {attributes.get("id") for _, attributes in page.tags} | set(made)
    assert len(made) == 13
    assert set(re.findall(r'\bat\("([\w-]+)"\)', page.scripts[2])) <= known


def test_a_stable_run_is_embedded_unchanged(tmp_path: Path) -> None:
    run = single_run()
    assert written(run, tmp_path).data == json.loads(json.dumps(run))


FALSE = [
    {"status": "unstable"},
    {"status": "failed"},
    {"metrics": {"spectral_abscissa": 0.1, "jitter_total": 1e-5}},
]


@pytest.mark.parametrize("change", FALSE)
def test_an_unstable_or_failed_point_brings_no_jitter_and_no_step_into_the_file(
    change: dict[str, object], tmp_path: Path
) -> None:
    false = point(0, 8.0)
    false["constraints"] = [
        {"name": "2*jitter_total", "value": 3e-5, "upper": 1e-5, "slack": -2e-5, "statement": None},
        {"name": "structural_mass", "value": 8.0, "upper": 8.0, "slack": 0.0, "statement": "1 kg is 3 µrad"},
    ]
    false |= copy.deepcopy(change)
    (shown,) = written({"points": [false]}, tmp_path).data["points"]
    gone = re.compile("jitter|step|margin")
    assert {value for name, value in shown["metrics"].items() if gone.search(name)} == {None}
    assert all(value is not None for name, value in shown["metrics"].items() if not gone.search(name))
    assert shown["detail"]["jitter"] is shown["detail"]["cumulative"] is shown["detail"]["step"] is None
    assert shown["constraints"][0]["value"] is shown["constraints"][0]["slack"] is None
    assert shown["constraints"][1]["value"] == 8.0 and shown["constraints"][1]["statement"] is None
    assert {objective for _, objective, _ in shown["history"]} == {None}
    assert shown["detail"]["bode"] and shown["detail"]["truss"]
    assert false["detail"]["jitter"]


def test_a_point_without_optional_parts_is_written(tmp_path: Path) -> None:
    assert written({"points": [{"key": "0", "status": "failed", "detail": None}]}, tmp_path).data["points"]
    assert written({}, tmp_path).data == {"points": []}
    assert written(spatial_run(), tmp_path).data["name"] == "Spatial mast"


def test_a_report_that_cannot_be_made_leaves_the_old_one_and_no_rest(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old", encoding="utf-8")
    with pytest.raises(ValueError, match="JSON compliant"):
        write_report({"points": [{"metrics": {"structural_mass": math.nan}}]}, path)
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_report_that_cannot_take_its_place_leaves_the_old_one_and_no_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(source: Path, target: Path) -> None:
        assert source.parent == target.parent and source.stat().st_size > 1e6
        raise PermissionError

    path = tmp_path / "report.html"
    path.write_text("old", encoding="utf-8")
    monkeypatch.setattr("os.replace", refuse)
    with pytest.raises(PermissionError):
        write_report({}, path)
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_report_replaces_an_older_one(tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("old", encoding="utf-8")
    assert written({}, tmp_path).scripts
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]
