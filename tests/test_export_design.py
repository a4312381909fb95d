"""One design for other programs: matrices with the run's poles, the truss with its sizes, a deck that reads back."""

from __future__ import annotations

import csv
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import loadmat
from small_studies import analysis, run_text
from test_sweep_study import over, sweep_text
from typer.testing import CliRunner

from fosopt.cli.commands import app
from fosopt.control import StateSpace
from fosopt.control.sampled import sampled_loop
from fosopt.control.sampled_closed import sampled_closed_loop_state_space
from fosopt.errors import ModelError
from fosopt.export.systems import signal_unit
from fosopt.problem import Evaluation
from fosopt.study import parse_study
from fosopt.study.build import build_problem, start_vector
from fosopt.study.chosen import design_of_file, design_of_run

LOOP = ("  ki: 50000\n", "  ki: 50000\n  rolloff: 2 kHz\n")
SAMPLED = (
    LOOP[0],
    LOOP[1] + "  anti_alias: {corner: 3 kHz}\n  sampling: {rate: 5 kHz, delay: 0.1 ms}\n",
)
EIGEN = 1e-9  # of a pole, relative to the largest: two eigenvalue problems of a matrix and of its copy
SYSTEMS = {"plant", "controller", "closed_loop"}
DIGITAL = {"sampled_plant", "sampled_controller", "sampled_closed_loop"}


def invoke(*arguments):
    """The command as a shell would call it."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def exported(source: Path, *arguments: object, out: Path) -> dict:
    result = invoke("export", source, *arguments, "--out", out)
    assert (result.exit_code, result.stdout) == (0, f"wrote {out}\n"), result.output
    return loadmat(out, simplify_cells=True)


def run_of(text: str, folder: Path) -> SimpleNamespace:
    return SimpleNamespace(data=run_text(text, folder), out=folder / "out", key="start")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    found = run_of(analysis(LOOP), tmp_path_factory.mktemp("run"))
    found.key = found.data["points"][0]["key"]
    return found


@pytest.fixture(scope="module")
def digital(tmp_path_factory):
    found = run_of(analysis(SAMPLED), tmp_path_factory.mktemp("digital"))
    found.key = found.data["points"][0]["key"]
    return found


@pytest.fixture(scope="module")
def matrices(run, tmp_path_factory):
    """Systems of the run, as another program sees them, discretized as well."""
    arguments = ("--point", run.key, "--format", "plant", "--rate", "2kHz", "--delay", "0.7ms")
    return exported(run.out, *arguments, out=tmp_path_factory.mktemp("matrices") / "plant.mat")


def system_of(found: dict) -> StateSpace:
    inputs, outputs = (tuple(np.atleast_1d(found[part]).tolist()) for part in ("inputs", "outputs"))
    n, m, p = np.atleast_2d(found["A"]).shape[0], len(inputs), len(outputs)
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    parts = [np.reshape(found[name], shape) for name, shape in shapes.items()]
    return StateSpace(*parts, inputs, outputs, found["dt"] or None)


def same_poles(found, expected):
    assert found.size == expected.size
    apart = np.abs(found[:, None] - expected).min(axis=1)
    assert apart.max() < EIGEN * np.abs(expected).max()


# ---- plant and controller ----


def test_the_closed_loop_has_the_poles_of_the_run(run, matrices):
    poles = np.linalg.eigvals(matrices["closed_loop"]["A"])
    point = run.data["points"][0]
    assert poles.real.max() == pytest.approx(point["spectral_abscissa"], rel=1e-6)
    upper = np.array([complex(*pair) for pair in point["detail"]["poles"]])
    shown = 1e-4  # digits of a report
    for pole in upper:
        assert np.abs(poles - pole).min() < shown * abs(pole)
    assert 2 * np.sum(upper.imag > 0) + np.sum(upper.imag == 0) == poles.size


def test_plant_and_controller_closed_by_hand_are_the_closed_loop(matrices):
    plant, controller, whole = (system_of(matrices[name]) for name in ("plant", "controller", "closed_loop"))
    s = 1j * np.array([3.0, 200.0, 900.0, 5000.0])
    g = plant.response(s, "control_torque", "sensor_angle")
    k = controller.response(s, "command", "control_torque")
    by_angle = controller.response(s, "sensor_angle", "control_torque")
    np.testing.assert_allclose(by_angle, -k, rtol=1e-12)
    mirror = plant.response(s, "control_torque", "mirror_angle")
    found = whole.response(s, "command", "mirror_angle")
    np.testing.assert_allclose(found, mirror * k / (1 + g * k), rtol=1e-8)
    pushed = plant.response(s, "hub_torque", "mirror_angle")
    seen = plant.response(s, "hub_torque", "sensor_angle")
    found = whole.response(s, "hub_torque", "mirror_angle")
    np.testing.assert_allclose(found, pushed - mirror * k / (1 + g * k) * seen, rtol=1e-7)


def test_signals_have_names_and_units(matrices):
    units = {}
    for name in SYSTEMS | DIGITAL:
        found = matrices[name]
        for part in ("input", "output"):
            names, kinds = (np.atleast_1d(found[f"{part}{end}"]) for end in ("s", "_units"))
            units |= dict(zip(names, kinds, strict=True))
    assert units == {
        "control_torque": "N m",
        "mirror_torque": "N m",
        "hub_torque": "N m",
        "command": "rad",
        "sensor_angle": "rad",
        "sensor_rate": "rad/s",
        "mirror_angle": "rad",
        "mirror_rate": "rad/s",
        "line_of_sight": "rad",
        "sensor_noise": "rad",
    }
    known = {"actuator_force_2": "N", "actuator_rate_1": "m/s", "reaction_mass_angle": "rad"}
    assert {name: signal_unit(name) for name in known} == known


def test_a_rate_and_a_delay_discretize_the_loop(run, matrices):
    assert {matrices[name]["dt"] for name in DIGITAL} == {0.0005}
    assert {matrices[name]["dt"] for name in SYSTEMS} == {0.0}
    plant = system_of(matrices["sampled_plant"])
    # A hold and a delay of 1.4 periods in closed form: 0.4 of one sample, 0.6 of the sample before it.
    continuous = system_of(matrices["plant"])
    z = np.exp(1j * np.array([20.0, 400.0, 3000.0]) * 0.0005)
    n = continuous.a.shape[0]
    eigenvalue, vectors = np.linalg.eig(continuous.a)
    column = np.linalg.solve(vectors, continuous.b[:, continuous.inputs.index("control_torque")])
    row = continuous.c[continuous.outputs.index("sensor_angle")] @ vectors

    def grown(time):
        return np.expm1(eigenvalue * time) / eigenvalue

    carried = np.exp(eigenvalue * 0.0005)
    late, early = grown(0.0003), (carried - np.exp(eigenvalue * 0.0003)) / eigenvalue
    expected = [np.sum(row * column * (late / point + early / point**2) / (point - carried)) for point in z]
    assert n == 22
    np.testing.assert_allclose(plant.response(z, "control_torque", "sensor_angle"), expected, rtol=1e-7)


def test_the_sampled_closed_loop_is_plant_and_controller_in_a_loop(matrices):
    plant, controller, whole = (
        system_of(matrices[f"sampled_{name}"]) for name in ("plant", "controller", "closed_loop")
    )
    z = np.exp(1j * np.array([20.0, 400.0, 3000.0]) * 0.0005)
    g = plant.response(z, "control_torque", "sensor_angle")
    mirror = plant.response(z, "control_torque", "mirror_angle")
    k = controller.response(z, "command", "control_torque")
    for output, expected in (("sensor_angle", g), ("mirror_angle", mirror), ("control_torque", 1.0)):
        found = whole.response(z, "command", output)
        np.testing.assert_allclose(found, expected * k / (1 + g * k), rtol=1e-7)


def test_a_study_that_samples_gets_its_sampled_loop(digital, tmp_path):
    found = exported(digital.out, "--point", digital.key, "--format", "plant", out=tmp_path / "a.mat")
    assert found["sampled_plant"]["dt"] == pytest.approx(2e-4, rel=1e-15)
    chosen = design_of_run(digital.out / "run.sqlite", digital.key)
    loop, modes = chosen.evaluation.design.loop, chosen.evaluation.modes
    poles = np.linalg.eigvals(found["sampled_closed_loop"]["A"])
    same_poles(poles, sampled_loop(loop, modes, chosen.evaluation.system.mirror_port).poles)
    abscissa = np.log(np.abs(poles).max()) / 2e-4
    assert abscissa == pytest.approx(digital.data["points"][0]["spectral_abscissa"], rel=1e-6)
    assert found["about"]["sampled_closed_loop_stable"] == 1
    assert "Pade" in found["about"]["notes"]
    slower = exported(
        *(digital.out, "--point", digital.key, "--format", "plant", "--delay", "0.3ms"),
        out=tmp_path / "b.mat",
    )
    rated = exported(
        *(digital.out, "--point", digital.key, "--format", "plant", "--rate", "2.5kHz"),
        out=tmp_path / "c.mat",
    )
    assert [rated[name]["dt"] for name in DIGITAL] == pytest.approx([4e-4] * 3, rel=1e-15)
    # A delay of 0.3 ms at 0.2 ms per sample keeps one more torque than one of 0.1 ms.
    assert slower["sampled_plant"]["A"].shape[0] == found["sampled_plant"]["A"].shape[0] + 1
    np.testing.assert_array_equal(slower["sampled_controller"]["A"], found["sampled_controller"]["A"])


def test_the_model_is_the_one_the_design_is_judged_on(run, tmp_path):
    found = run_of(analysis(LOOP) + "\nmodes: {count: 4}\n", tmp_path)
    exports = [
        exported(source, "--format", "plant", *point, out=tmp_path / "a.mat")
        for source, point in (
            (found.out, ("--point", run.key)),
            (found.out / "designs" / f"{run.key}.yaml", ()),
        )
    ]
    for each in exports:
        poles = np.linalg.eigvals(each["closed_loop"]["A"])
        assert poles.size == 24  # all ten modes and the mirror twice, integral and roll-off
        assert poles.real.max() == pytest.approx(found.data["points"][0]["spectral_abscissa"], rel=1e-6)


def test_a_loop_that_is_not_sampled_has_no_sampled_systems(run, tmp_path):
    found = exported(run.out, "--point", run.key, "--format", "plant", out=tmp_path / "a.mat")
    assert {name for name in found if not name.startswith("__")} == SYSTEMS | {"about", "provenance"}


def test_the_study_of_a_design_gives_what_its_point_gives(run, tmp_path):
    of_run = exported(run.out, "--point", run.key, "--format", "plant", out=tmp_path / "a.mat")
    file = run.out / "designs" / f"{run.key}.yaml"
    of_file = exported(file, "--format", "plant", out=tmp_path / "b.mat")
    for name in SYSTEMS:
        for part in "ABCD":
            np.testing.assert_array_equal(of_run[name][part], of_file[name][part])
    assert of_file["about"]["point"] == run.key
    assert of_run["provenance"]["study"] == run.data["provenance"]["study"]
    assert of_run["provenance"]["seed"] == of_file["provenance"]["seed"] == "1"


def test_an_ideal_derivative_leaves_the_controller_out_and_says_so(tmp_path):
    study = tmp_path / "study.yaml"
    study.write_text(analysis(), encoding="utf-8")
    result = invoke("export", study, "--format", "plant")
    assert result.exit_code == 0
    assert "the controller is left out: an ideal derivative" in result.stderr
    found = loadmat(tmp_path / "study-plant.mat", simplify_cells=True)
    assert "controller" not in found and "closed_loop" in found
    assert "ideal derivative" in found["about"]["notes"]


def test_an_unstable_design_is_handed_over_and_called_so(tmp_path):
    text = analysis(
        LOOP,
        ("crossover: 100 Hz", "crossover: 230 Hz"),
        ("inertia_ratio: 0.2 %", "inertia_ratio: 20 %"),
        bays=20,
    )
    study = parse_study(text)
    problem = build_problem(study)
    assert not problem.evaluate(start_vector(study, problem)).stable
    found = run_of(text, tmp_path)
    result = invoke("export", found.out, "--point", found.data["points"][0]["key"], "--format", "plant")
    assert result.exit_code == 0
    assert "is not verified: unstable" in result.stderr
    assert "the closed loop is unstable" in result.stderr
    (written,) = found.out.glob("*-plant.mat")
    about = loadmat(written, simplify_cells=True)["about"]
    assert about["closed_loop_stable"] == 0
    assert not any("jitter" in name for name in about)


def test_a_point_of_a_sweep_is_a_design_as_well(tmp_path):
    text = sweep_text(over("{quantity: area_scale, list: [0.5, 2]}", "stable"), LOOP)
    run_text(text, tmp_path)
    record = tmp_path / "out" / "run.sqlite"
    sizes = [design_of_run(record, key).evaluation for key in ("0", "1")]
    base = sizes[0].system.structure.area
    for scale, evaluation in zip((0.5, 2), sizes, strict=True):
        np.testing.assert_allclose(evaluation.design.area, scale * base, rtol=1e-15)
    found = exported(tmp_path / "out", "--point", "1", "--format", "plant", out=tmp_path / "a.mat")
    expected = Evaluation(sizes[1].system, sizes[1].design).poles.all
    same_poles(np.linalg.eigvals(found["closed_loop"]["A"]), expected)
    result = invoke("export", tmp_path / "out", "--point", "2", "--format", "plant")
    assert (result.exit_code, "choose a point with --point, a number from 0 to 1" in result.stderr) == (
        3,
        True,
    )


# ---- truss ----


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_members_and_deck_of_a_run_are_of_its_design(run, tmp_path):
    result = invoke("export", run.out, "--point", run.key, "--format", "members")
    written = [run.out / f"{run.key}-{part}.csv" for part in ("members", "nodes", "battens")]
    assert result.stdout == "".join(f"wrote {path}\n" for path in written)
    mass = sum(float(row["mass_kg"]) for path in (written[0], written[2]) for row in rows_of(path))
    assert mass == pytest.approx(run.data["points"][0]["metrics"]["structural_mass"], rel=1e-12)
    row = rows_of(written[0])[0]
    assert row["provenance"].startswith(f"study {run.data['provenance']['study']}; ")
    assert row["provenance"].endswith(f"; point {run.key}")
    deck = tmp_path / "a.bdf"
    assert invoke("export", run.out, "--point", run.key, "--format", "nastran", "--out", deck).exit_code == 0
    assert f"$ study: {run.data['provenance']['study']}" in deck.read_text(encoding="ascii")


# ---- what cannot be ----


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("RUN", "--format", "plant"), 3, "choose one with --point, one of "),
        (("RUN", "--format", "plant", "--point", "999"), 3, "the run has no point '999'"),
        (("RUN", "--format", "csv", "--point", "KEY"), 2, "holds all points; remove --point"),
        (("RUN", "--format", "members", "--point", "KEY", "--rate", "2kHz"), 2, "discretize a plant"),
        (("RUN", "--format", "plant", "--point", "KEY", "--rate", "2 kg"), 2, "--rate: "),
        (("RUN", "--format", "plant", "--point", "KEY", "--rate", "0 Hz"), 2, "samples nothing"),
        (("RUN", "--format", "plant", "--point", "KEY", "--delay", "1 ms"), 3, "give a rate as well"),
        (("RUN", "--format", "plant", "--point", "KEY", "--rate", "2kHz", "--delay", "-1ms"), 3, "negative"),
        (("RUN", "--format", "plant", "--point", "KEY", "--out", "RUN/run.sqlite"), 2, "is what is exported"),
        (("RUN/run.sqlite", "--format", "csv", "--out", "RUN/run.sqlite"), 2, "is what is exported"),
        (("RUN/designs/KEY.yaml", "--format", "plant", "--point", "KEY"), 2, "has one design"),
        (("RUN/absent.yaml", "--format", "plant"), 3, "absent.yaml: no such file"),
        (("RUN/report.html", "--format", "plant"), 3, "report.html"),
        (
            ("RUN", "--format", "members", "--point", "KEY", "--out", "RUN/absent/m.csv"),
            3,
            "cannot be written",
        ),
    ],
)
def test_what_cannot_be_exported_is_said_and_nothing_is_written(run, arguments, code, said):
    before = {path: path.stat().st_mtime_ns for path in run.out.rglob("*")}
    filled = [each.replace("RUN", str(run.out)).replace("KEY", run.key) for each in arguments]
    result = invoke("export", *filled)
    assert (result.exit_code, said in result.stderr.replace("\n", " ")) == (code, True), result.output
    assert "Traceback" not in result.output
    assert {path: path.stat().st_mtime_ns for path in run.out.rglob("*")} == before


def test_a_study_of_many_designs_is_refused(tmp_path):
    from fosopt.study import TEMPLATE

    (tmp_path / "study.yaml").write_text(TEMPLATE, encoding="utf-8")
    result = invoke("export", tmp_path / "study.yaml", "--format", "plant")
    assert result.exit_code == 3
    assert "a codesign is of many designs; run it" in result.stderr


def test_python_reaches_the_design_without_a_file(run):
    of_file = design_of_file(run.out / "designs" / f"{run.key}.yaml").evaluation
    of_run = design_of_run(run.out / "run.sqlite", run.key).evaluation
    np.testing.assert_array_equal(of_file.design.parameters, of_run.design.parameters)
    with pytest.raises(ModelError, match="sampled"):
        sampled_closed_loop_state_space(of_run.design.loop, of_run.modes, of_run.system.mirror_port)
