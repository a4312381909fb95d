"""One design for other programs: matrices with the run's poles, the truss with its sizes, a deck that reads back."""

from __future__ import annotations

import csv
import os
from dataclasses import replace
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
from fosopt.export.truss import DesignedTruss, ExportError, write_deck, write_members
from fosopt.problem import Evaluation
from fosopt.structure import (
    Bar,
    Batten,
    Chain,
    Truss,
    assemble,
    assemble_chain,
    barker_truss,
    mass_matrix,
    stiffness_matrix,
    structural_mass,
)
from fosopt.structure.imported import ModelUnits
from fosopt.structure.readers.bulk_data import read_bulk_data
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
    # A delay of 0.3 ms at 0.2 ms per sample keeps one more torque than one of 0.1 ms.
    assert slower["sampled_plant"]["A"].shape[0] == found["sampled_plant"]["A"].shape[0] + 1
    np.testing.assert_array_equal(slower["sampled_controller"]["A"], found["sampled_controller"]["A"])


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


def designed(structure=None, **changes) -> DesignedTruss:
    """The dissertation's truss on three bays with sizes of its own."""
    structure = structure or assemble(barker_truss("fixed", 3), "tip")
    truss = structure.truss
    area = 1e-5 * (1 + np.arange(len(truss.bars)))
    batten_mass = 1.0 + np.arange(len(truss.battens))
    return replace(
        DesignedTruss(structure, area, batten_mass, structure.spring_stiffness, "tip", 2.5), **changes
    )


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_members_have_the_sizes_of_the_design(tmp_path):
    design = designed()
    paths = write_members(design, "seed 1", tmp_path / "a-members.csv")
    assert [path.name for path in paths] == ["a-members.csv", "a-nodes.csv", "a-battens.csv"]
    bars, nodes, battens = map(rows_of, paths)
    places = {row["name"]: [float(row[f"{axis}_m"]) for axis in "xyz"] for row in nodes}
    assert len(bars) == len(design.structure.truss.bars)
    for row, area in zip(bars, design.area, strict=True):
        length = float(row["length_m"])
        assert [float(row[f"start_{axis}_m"]) for axis in "xyz"] == places[row["start"]]
        assert [float(row[f"end_{axis}_m"]) for axis in "xyz"] == places[row["end"]]
        assert length == pytest.approx(np.linalg.norm(np.subtract(places[row["end"]], places[row["start"]])))
        assert float(row["area_m2"]) == area
        mass = float(row["density_kg_per_m3"]) * area * length
        assert float(row["mass_kg"]) == pytest.approx(mass, rel=1e-14)
        stiffness = float(row["young_pa"]) * area / length
        assert float(row["axial_stiffness_n_per_m"]) == pytest.approx(stiffness, rel=1e-14)
    whole = sum(float(row["mass_kg"]) for row in (*bars, *battens))
    assert whole == pytest.approx(
        structural_mass(design.structure, design.area, design.batten_mass), rel=1e-14
    )
    for row, batten, mass in zip(battens, design.structure.truss.battens, design.batten_mass, strict=True):
        assert float(row["inertia_z_kg_m2"]) == pytest.approx(batten.inertia * mass / batten.mass, rel=1e-15)
        assert row["inertia_x_kg_m2"] == row["inertia_y_kg_m2"] == ""
        assert row["nodes"].split() == list(batten.nodes)
        assert {row["batten"] for row in nodes if row["name"] in batten.nodes} == {batten.name}
        middle = np.mean([places[node] for node in batten.nodes], axis=0)
        assert [float(row[f"{axis}_m"]) for axis in "xyz"] == pytest.approx(middle.tolist())
    assert [row["held"] for row in battens] == ["x y rz", "", "", ""]
    assert [row["ports"] for row in battens] == ["hub", "", "", "tip"]
    assert {row["provenance"] for row in (*bars, *nodes, *battens)} == {"seed 1"}


def spatial(*names: str) -> Truss:
    """A mast on three legs; its nodes, bars and a batten have these names."""
    a, b, c, top, bar, body = names
    nodes = {a: (1.0, 0.0, 0.0), b: (0.0, 1.0, 0.0), c: (0.0, 0.0, 0.0), top: (0.3, 0.3, 1.0)}
    bars = tuple(Bar(f"{bar}{k}", (node, top), 1e-4, 70e9, 2700.0) for k, node in enumerate((a, b, c)))
    held = ("x", "y", "z", "rx", "ry", "rz")
    center = (0.1, 0.2, 0.3)
    batten = Batten(body, (a, b, c), 2.0, (0.1, 0.2, 0.3), center)
    return Truss(nodes, bars, {"hub": (body, "rz"), "tip": (top, "x")}, {body: held}, (batten,))


def test_a_batten_in_space_has_three_inertias_and_its_own_center(tmp_path):
    design = designed(assemble(spatial("a", "b", "c", "d", "L", "base"), "tip"), batten_mass=np.array([4.0]))
    (row,) = rows_of(write_members(design, "", tmp_path / "m.csv")[2])
    assert [float(row[f"inertia_{axis}_kg_m2"]) for axis in "xyz"] == [0.2, 0.4, 0.6]
    assert [float(row[f"{axis}_m"]) for axis in "xyz"] == [0.1, 0.2, 0.3]


def test_hostile_names_are_inert_in_tables_and_comments(tmp_path):
    hostile = ("=1+1", "@SUM(A1)", "-2", "+3\nENDDATA", "=bar", '=cmd|"/c calc"!A1')
    design = designed(assemble(spatial(*hostile), "tip"), batten_mass=np.array([4.0]))
    for path in write_members(design, "=origin", tmp_path / "m.csv"):
        for row in rows_of(path):
            assert not any(
                cell.startswith(("=", "@", "+")) or (cell.startswith("-") and not _number(cell))
                for cell in row.values()
            )
    title = "=evil\nENDDATA\nINCLUDE 'x'\r\u2028µ" + "x" * 41 + ", more"
    write_deck(design, title, {"note": "a\nGRID,1\nb " + "long " * 40}, tmp_path / "m.bdf")
    lines = (tmp_path / "m.bdf").read_bytes().decode("ascii").splitlines()
    assert lines.count("ENDDATA") == 1 and lines[-1] == "ENDDATA"
    assert not any(line.startswith(("INCLUDE", "GRID,")) for line in lines)
    assert max(map(len, lines)) <= 80
    (title_line,) = (line for line in lines if line.startswith("TITLE"))
    assert title_line.startswith("TITLE = =evil ENDDATA INCLUDE 'x' ?xx")
    assert not title_line.endswith(",")


def _number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def test_the_deck_reads_back_as_the_design(tmp_path):
    design = designed()
    write_deck(design, "three bays", {"study": "abc"}, tmp_path / "m.bdf")
    text = (tmp_path / "m.bdf").read_text(encoding="ascii")
    assert (
        "$ design: three bays" in text and "$ study: abc" in text and "$ units: lengths m, masses kg" in text
    )
    numbers = {
        name: number
        for _, kind, number, _, name in (
            line.split() for line in text.splitlines() if " = " in line and "$ " in line
        )
        if kind == "grid"
    }
    bodies = [batten.name for batten in design.structure.truss.battens]
    ports = {"hub": (numbers[bodies[0]], "rz"), "tip": (numbers[bodies[-1]], "rz")}
    again = assemble(read_bulk_data(tmp_path / "m.bdf", ModelUnits(1.0, 1.0), ports), "tip")
    own = design.structure
    digits = 1e-9  # large fields hold ten digits or more
    stiffness = stiffness_matrix(own, design.area)
    np.testing.assert_allclose(
        stiffness_matrix(again, again.area), stiffness, atol=digits * np.abs(stiffness).max()
    )
    # The deck has the mirror's mass on a body already.
    mass = mass_matrix(own, design.area, design.batten_mass, design.mirror_mass)
    found = mass_matrix(again, again.area, again.batten_mass, 0.0)
    np.testing.assert_allclose(found, mass, atol=digits * np.abs(mass).max())


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


def test_a_structure_without_members_is_refused():
    chain = assemble_chain(Chain({"hub": 50.0, "tip": 20.0}, (1e6,), False), "tip")
    with pytest.raises(ExportError, match=r"no members: .* export its plant"):
        designed(chain)


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


def test_all_tables_of_a_truss_are_new_or_none_is(tmp_path):
    (tmp_path / "m.csv").write_text("old")
    (tmp_path / "m-battens.csv").mkdir()
    with pytest.raises(ExportError, match=r"m-battens\.csv: cannot be written"):
        write_members(designed(), "", tmp_path / "m.csv")
    assert (tmp_path / "m.csv").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["m-battens.csv", "m.csv"]


def test_a_link_is_followed_and_a_pipe_is_left_alone(tmp_path):
    os.symlink("target.bdf", tmp_path / "link.bdf")
    write_deck(designed(), "", {}, tmp_path / "link.bdf")
    assert (tmp_path / "link.bdf").is_symlink() and (tmp_path / "target.bdf").is_file()
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ExportError, match="is a device or a pipe"):
        write_deck(designed(), "", {}, tmp_path / "pipe")
    assert (tmp_path / "pipe").is_fifo()


def test_python_reaches_the_design_without_a_file(run):
    of_file = design_of_file(run.out / "designs" / f"{run.key}.yaml").evaluation
    of_run = design_of_run(run.out / "run.sqlite", run.key).evaluation
    np.testing.assert_array_equal(of_file.design.parameters, of_run.design.parameters)
    with pytest.raises(ModelError, match="sampled"):
        sampled_closed_loop_state_space(of_run.design.loop, of_run.modes, of_run.system.mirror_port)
