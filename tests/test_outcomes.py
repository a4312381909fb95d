"""What studies end in: infeasible, unstable, cases, objectives of all kinds, structures of all kinds."""

from __future__ import annotations

import csv
import json
from math import pi
from pathlib import Path

import pytest
from small_studies import HELD_KEYS, STUDIES, analysis, edited, run_text, section, single

from fosopt.study import TEMPLATE, load_study, parse_study
from fosopt.study.runner import run_study

LOOP_METRICS = ("jitter_total", "jitter_aft_body", "jitter_noise", "modulus_margin", "loop_crossover")


# ---- what cannot be, and what is unstable ----


def test_an_infeasible_study_names_its_conflict_and_prices_nothing(tmp_path):
    constraints = (
        "  - {metric: first_elastic_frequency, lower: 300 Hz}\n  - {metric: structural_mass, upper: 20}\n"
    )
    _, point = run_text(single("jitter_total", constraints), tmp_path)["points"]
    assert (point["status"], point["verified"], point["dominated"]) == ("infeasible", False, False)
    assert "constraints conflict: " in point["reason"]
    assert all(c["name"] in point["reason"] for c in point["constraints"])
    assert all(c["statement"] is None for c in point["constraints"])


def test_an_infeasible_front_is_one_point(tmp_path):
    text = edited(("lower: 4 Hz", "lower: 3 kHz"))
    start, point = run_text(text, tmp_path)["points"]
    assert start["verified"], "a requirement that the start misses is no doubt about its numbers"
    assert "is violated by" in start["reason"]
    assert (point["key"], point["status"]) == ("000", "infeasible")


UNSTABLE = (
    ("inertia_ratio: 0.2 %", "inertia_ratio: 10 %"),
    ("crossover: 100 Hz", "crossover: 230 Hz"),
    ("uniform: 0.2 %", "uniform: 0.1 %"),
)


@pytest.fixture(scope="module")
def unstable(tmp_path_factory):
    out = tmp_path_factory.mktemp("unstable") / "run"
    text = analysis(*UNSTABLE, bays=20) + "\nstep:\n  command: 1 urad\n  window: [50 ms, 100 ms]\n"
    return run_study(parse_study(text), out), out


def test_an_unstable_analysis_says_so(unstable):
    (point,) = unstable[0]["points"]
    assert (point["key"], point["status"], point["verified"]) == ("000", "unstable", False)
    assert point["reason"].startswith("unstable: a pole has the real part 1.02")
    assert point["metrics"]["spectral_abscissa"] > 0
    assert point["metrics"]["structural_mass"] == pytest.approx(108.3)


def test_an_unstable_design_has_no_jitter_anywhere(unstable):
    run, out = unstable
    for point in (run["points"][0], json.loads((out / "front.json").read_text())["points"][0]):
        for name in (*LOOP_METRICS, "step_offset", "step_rms"):
            assert point["metrics"][name] is None
        assert point["jitter_disagreement"] is None
        assert {c["name"] for c in point["constraints"]} == {"first_elastic_frequency"}
    detail = run["points"][0]["detail"]
    assert detail["jitter"] == {}
    assert detail["cumulative"] is None
    assert detail["step"] is None
    with (out / "front.csv").open(encoding="utf-8", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert not any(value for name, value in row.items() if name.startswith(("jitter", "step", "modulus")))
    assert "urad" not in _visible(out / "report.html")


def _visible(path: Path) -> str:
    """What stands in the data of a report, without its code."""
    text = path.read_text(encoding="utf-8")
    first = text.index('type="application/json"')
    return (
        text[text.index(">", first) : text.index("</script>", first)]
        .replace('"unit": "urad"', "")
        .replace('"unit":"urad"', "")
    )


def test_cases_of_the_unstable_mirror_tell_gains_structure_and_both_apart(tmp_path):
    study = load_study(STUDIES / "unstable-mirror.yaml", ("variables.0.group_by=kind", "solve.starts=1"))
    totals = set()
    run = run_study(study, tmp_path / "out", progress=lambda p: totals.add(p.total))
    start, baseline, gains, structure, both = run["points"]
    assert start["status"] == baseline["status"] == "unstable"
    assert baseline["metrics"]["jitter_total"] is None
    assert [p["case"] for p in run["points"]] == [None, "baseline", "gains alone", "structure alone", "both"]
    assert baseline["variables"] == start["variables"]
    assert gains["variables"]["area"] == start["variables"]["area"]
    assert structure["variables"]["kp"] == start["variables"]["kp"]
    for point in (gains, structure, both):
        assert (point["status"], point["verified"]) == ("optimal", True)
    jitter = [p["metrics"]["jitter_total"] for p in (gains, structure, both)]
    assert jitter[2] < jitter[0] < jitter[1]
    mass = next(c for c in gains["constraints"] if c["name"] == "total_mass")
    assert mass["multiplier"] == 0.0, "gains cannot change the mass"
    assert run["comparison"] == []
    assert totals == {5}


# ---- objectives ----


def test_an_expression_of_metrics_can_be_minimized(tmp_path):
    constraints = "  - {metric: first_elastic_frequency, lower: 60 Hz}\n"
    text = "structural_mass + 2*mirror_inertia"
    done = run_text(single(text, constraints), tmp_path)
    start, point = done["points"]
    metrics = point["metrics"]
    assert point["verified"]
    assert metrics[text] == pytest.approx(
        metrics["structural_mass"] + 2 * metrics["mirror_inertia"], rel=1e-14
    )
    assert metrics[text] < start["metrics"][text]
    assert done["objectives"] == [text]
    assert text in done["quantities"]


def test_a_variable_can_be_minimized_and_bounded(tmp_path):
    constraints = "  - {metric: jitter_total, upper: 20 urad}\n  - {metric: ki/kp, upper: 200}\n"
    _, point = run_text(single("crossover", constraints), tmp_path)["points"]
    assert point["verified"], point["reason"]
    bound = {c["name"]: c for c in point["constraints"]}
    assert bound["jitter_total"]["active"]
    # Less jitter needs a faster loop.
    assert bound["jitter_total"]["multiplier"] < 0


def test_many_starts_are_counted(tmp_path):
    constraints = "  - {metric: structural_mass, upper: 20}\n"
    text = single("jitter_total", constraints) + "  starts: 2\n  seed: 5\n"
    _, point = run_text(text, tmp_path)["points"]
    assert point["starts"]["tried"] == 2
    assert 1 <= point["starts"]["agreed"] <= 2


# ---- structures and models ----


def test_a_washed_out_torque_on_a_free_hub_runs(tmp_path):
    text = analysis(
        ("type: held", "type: free"),
        *HELD_KEYS,
        ("{type: low_pass, corner: 10 Hz, order: 2,", "{type: band_pass, lower: 5 Hz, upper: 50 Hz,"),
    )
    (point,) = run_text(text, tmp_path)["points"]
    assert point["verified"], point["reason"]
    assert point["jitter_disagreement"] < 1e-8


def test_the_truss_on_its_root_table_runs_with_the_frequency_of_the_dissertation(tmp_path, dissertation):
    text = analysis(
        ("boundary: pinned ", "boundary: table "),
        ("type: held", "type: fixed"),
        ("mass_fraction: 0.7 ", "mass: 1e-6 kg "),
        *HELD_KEYS,
        bays=20,
    )
    (point,) = run_text(text, tmp_path)["points"]
    assert (point["status"], point["verified"]) == ("evaluated", True)
    # The springs of the table are fitted to within 0.6 %.
    first = point["metrics"]["first_elastic_frequency"] / (2 * pi)
    assert first == pytest.approx(dissertation["table_2_2"]["fem1"][0], rel=6e-3)


def spatial_study() -> str:
    """A square mast of two bays, by hand."""
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    nodes = {f"N{i}{j}": [0.5 * i, 0.2 * y, 0.2 * z] for i in range(3) for j, (y, z) in enumerate(corners)}
    bars = []
    for i in (1, 2):
        for j in range(4):
            k = (j + 1) % 4
            for kind, a, b in (
                ("longeron", f"N{i - 1}{j}", f"N{i}{j}"),
                ("brace", f"N{i - 1}{j}", f"N{i}{k}"),
                ("brace", f"N{i - 1}{k}", f"N{i}{j}"),
            ):
                bars.append(
                    f"    - {{nodes: [{a}, {b}], area: 1 cm^2, young: 70 GPa, density: 2700, kind: {kind}, bay: {i}}}\n"
                )
    battens = "".join(
        f"    - {{name: B{i}, nodes: [N{i}0, N{i}1, N{i}2, N{i}3], mass: 2, inertia: 0.1}}\n"
        for i in range(3)
    )
    structure = (
        "structure:\n  type: truss\n  nodes: "
        + json.dumps(nodes).replace('"', "")
        + "\n  bars:\n"
        + "".join(bars)
        + "  battens:\n"
        + battens
        + "  supports: {B0: [x, y, z, rx, ry, rz]}\n  ports: {hub: [B0, rz], tip: [B2, rz]}\n"
    )
    changes = (
        (section(TEMPLATE, "structure"), structure),
        ("type: held", "type: fixed"),
        *HELD_KEYS,
        ("at: hub_torque", "at: mirror_torque"),
        ("rms: 150 N m", "rms: 0.1 N m"),
        ("points: 5", "points: 2"),
        ("lower: 4 Hz", "lower: 20 Hz"),
    )
    text = TEMPLATE
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def test_a_spatial_truss_is_designed_and_verified(tmp_path):
    start, light, quiet = run_text(spatial_study(), tmp_path)["points"]
    assert start["detail"]["truss"]["nodes"][0] == [0.0, 0.2, 0.2]
    for point in (light, quiet):
        assert (point["status"], point["verified"]) == ("optimal", True), point["reason"]
    assert light["metrics"]["structural_mass"] < quiet["metrics"]["structural_mass"]
    assert light["metrics"]["jitter_total"] > quiet["metrics"]["jitter_total"]


def test_a_design_on_too_few_modes_that_fails_on_all_of_them_is_no_success(tmp_path):
    study = load_study(
        STUDIES / "quickstart.yaml", ("structure.bays=6", "front.points=2", "modes={count: 3}")
    )
    light = run_study(study, tmp_path / "out")["points"][1]
    assert (light["status"], light["verified"]) == ("failed", False)
    assert "constraint 'modulus_margin' is violated" in light["reason"]
    assert "on the truth model" in light["reason"]
    assert light["truncation_error"]["modulus_margin"] > 1e-3
