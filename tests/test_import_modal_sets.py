"""Structures known by a modal set in a file: what is read, what is refused, and that nothing is lost on the way."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_models import DATA, evaluated, imported, metrics, modes, native, study_text, truss
from scipy import io

from fosopt.errors import FosoptError, ModelError, StudyError
from fosopt.modes import Damping, Hub
from fosopt.modes.frame import modal_frame
from fosopt.structure.imported import ImportedModes, ModelUnits, assemble_modes, modes_in_si
from fosopt.structure.readers.modal_set import ModalFile, read_modal_set
from fosopt.study import dump_study, parse_study
from fosopt.study.build import build_problem
from fosopt.study.runner import run_study

ROUNDING = 1e-8  # modes carry the rounding of an eigenvalue solver through a loop with lightly damped poles
SI = ModelUnits(1.0, 1.0)


def write(folder: Path, kind: str, arrays: dict[str, Any]) -> Path:
    """A modal file of a format."""
    file = folder / f"modes.{kind}"
    if kind == "npz":
        np.savez(file, **arrays)
    elif kind == "mat":
        io.savemat(file, {**arrays, "dofs": np.array(list(arrays["dofs"]), dtype=object)})
    elif kind == "json":
        file.write_text(json.dumps({name: np.asarray(value).tolist() for name, value in arrays.items()}))
    else:
        names = [name for name in ("frequency_hz", "damping_ratio", "modal_mass") if name in arrays]
        rows = [",".join([*names, *arrays["dofs"]])]
        for k, column in enumerate(np.asarray(arrays["mode_shape"]).T):
            rows.append(",".join(repr(float(x)) for x in [*(arrays[name][k] for name in names), *column]))
        for name, line in zip(arrays["dofs"], arrays.get("residual_flexibility", ()), strict=False):
            blanks = [""] * (len(names) - 1)
            rows.append(",".join([str(name), *blanks, *(repr(float(x)) for x in line)]))
        file.write_text("# a comment\n" + "\n".join(rows) + "\n")
    return file


SECTION = "type: modal_set, file: modes."


# ---- what is read ----


@pytest.mark.parametrize("kind", ["npz", "mat", "json", "csv"])
def test_modes_of_a_file_give_the_metrics_of_the_structure_they_came_from(tmp_path, kind):
    write(tmp_path, kind, modes())
    text = study_text(imported(SECTION + kind), ("uniform: 0.2 %", "imported: true"))
    assert metrics(evaluated(text, tmp_path)) == pytest.approx(native(), rel=ROUNDING, abs=0)


@pytest.mark.parametrize("kind", ["npz", "mat", "json"])
def test_degrees_of_freedom_may_be_rows_of_grid_and_component(tmp_path, kind):
    arrays = modes()
    arrays["dofs"] = np.array([[100, 6], [103, 1], [103, 2], [103, 6]])
    file = tmp_path / f"modes.{kind}"
    if kind == "mat":
        io.savemat(file, arrays)
    else:
        write(tmp_path, kind, arrays)
    assert read_modal_set(file).dofs == ("100.rz", "103.x", "103.y", "103.rz")


def test_a_matlab_file_may_hold_names_as_characters_of_equal_length(tmp_path):
    arrays = modes()
    io.savemat(tmp_path / "modes.mat", {**arrays, "dofs": np.array(["B0.rz", "B3.x ", "B3.y ", "B3.rz"])})
    assert read_modal_set(tmp_path / "modes.mat").dofs == ("B0.rz", "B3.x", "B3.y", "B3.rz")


def test_modes_are_sorted_and_scaled_to_unit_modal_mass(tmp_path):
    arrays = modes()
    scale = np.linspace(0.5, 3.0, arrays["frequency_hz"].size)
    order = np.random.default_rng(3).permutation(scale.size)
    shuffled = {
        "frequency_hz": arrays["frequency_hz"][order],
        "mode_shape": (arrays["mode_shape"] * scale)[:, order],
        "dofs": arrays["dofs"],
        "modal_mass": scale[order] ** 2,
    }
    write(tmp_path, "npz", shuffled)
    text = study_text(imported(SECTION + "npz"))
    assert metrics(evaluated(text, tmp_path)) == pytest.approx(native(), rel=ROUNDING, abs=0)


def test_wtmass_scales_modal_masses_in_weight_units():
    """A modal mass of 386.09 lbf under WTMASS = 1/386.09 is one of force/(length/s²)."""
    pounds = ModelUnits(0.0254, 4.4482216152605, 1 / 386.09)
    weights = ModalFile(
        Path("a"), np.array([3.0]), np.array([[2.0]]), ("1.rz",), modal_mass=np.array([386.09])
    )
    masses = ModalFile(Path("a"), np.array([3.0]), np.array([[2.0]]), ("1.rz",))
    by_weight = modes_in_si(weights, pounds).mode_shape
    by_mass = modes_in_si(masses, ModelUnits(0.0254, 4.4482216152605)).mode_shape
    np.testing.assert_allclose(by_weight, by_mass, rtol=1e-14)


def test_units_leave_the_flexibility_of_a_rotation_alone():
    """φ²/ω² of a rotation is in 1/(force length), of a translation in length/force."""
    units = ModelUnits(0.5, 20.0)
    found = modes_in_si(
        ModalFile(Path("a"), np.array([3.0]), np.array([[2.0], [2.0]]), ("1.rz", "1.x")), units
    )
    np.testing.assert_allclose(found.mode_shape[:, 0] ** 2, [4 / (20 * 0.5), 4 * 0.5 / 20], rtol=1e-14)


def test_frequencies_below_a_limit_are_those_of_rigid_body_modes(tmp_path):
    arrays = modes()
    arrays["frequency_hz"] = np.maximum(arrays["frequency_hz"], 3e-3)
    write(tmp_path, "npz", arrays)
    section = imported(SECTION + "npz, rigid_below: 0.01 Hz")
    assert metrics(evaluated(study_text(section), tmp_path)) == pytest.approx(native(), rel=ROUNDING, abs=0)


def test_the_inertia_about_the_hub_is_that_of_the_rigid_body_mode_or_as_stated(tmp_path):
    write(tmp_path, "npz", modes())
    plain, stated = (
        evaluated(study_text(imported(SECTION + "npz" + more)), tmp_path)
        for more in ("", ", structure_inertia: 77 kg m^2")
    )
    assert plain.value("structure_inertia") == pytest.approx(native()["structure_inertia"], rel=1e-9, abs=0)
    assert stated.value("structure_inertia") == pytest.approx(77.0, rel=1e-12, abs=0)


# ---- residual flexibility ----


def receptance(structure: Any, frequency: float) -> float:
    """At the tip, without damping [rad/(N m)]."""
    frame = modal_frame(structure, structure.area, structure.batten_mass, 0.0, "tip")
    found = frame.modal_set(Hub("free"), Damping((0.0,)), ("tip",))
    return float(found.receptance(np.array([1j * frequency]), "tip", "tip")[0].real)


def test_residual_flexibility_is_converted_in_each_of_its_units():
    """1/(N mm) between rotations, mm/N between translations, 1/N between one and the other."""
    found = ModalFile(
        Path("a"),
        np.array([3.0]),
        np.ones((2, 1)),
        ("1.rz", "1.x"),
        residual_flexibility=np.array([[2.0, 1], [1, 2]]),
    )
    converted = modes_in_si(found, ModelUnits(1e-3, 1.0)).residual_flexibility
    np.testing.assert_allclose(converted, [[2e3, 1], [1, 2e-3]], rtol=1e-14)


@pytest.mark.parametrize("kind", ["npz", "csv"])
def test_residual_flexibility_makes_up_for_modes_that_are_left_out(tmp_path, kind):
    arrays = modes()
    kept = 5
    rest = 2 * np.pi * arrays["frequency_hz"][kept:]
    shape = arrays["mode_shape"]
    few = {**arrays, "mode_shape": shape[:, :kept]}
    few |= {name: arrays[name][:kept] for name in ("frequency_hz", "damping_ratio")}
    few["residual_flexibility"] = (shape[:, kept:] / rest**2) @ shape[:, kept:].T
    ports = {"hub": ("B0", "rz"), "tip": ("B3", "rz")}
    units = ModelUnits(1e-3, 1.0)
    whole, cut = (
        assemble_modes(modes_in_si(read_modal_set(write(tmp_path, kind, each)), units), ports, "tip", 1.0)
        for each in (arrays, few)
    )
    without = {name: value for name, value in few.items() if name != "residual_flexibility"}
    bare = assemble_modes(
        modes_in_si(read_modal_set(write(tmp_path, kind, without)), units), ports, "tip", 1.0
    )
    low = 2 * np.pi * 1.0
    lost, left = (abs(receptance(s, low) - receptance(whole, low)) for s in (bare, cut))
    slowest = rest.min()
    assert left < 2 * (low / slowest) ** 2 * lost  # the dynamics of the modes that were left out
    top = 2 * np.pi * few["frequency_hz"][-1] * 0.9
    lost, left = (abs(receptance(s, top) - receptance(whole, top)) for s in (bare, cut))
    assert left < lost


def test_residual_flexibility_is_damped_apart_from_the_modes(tmp_path):
    arrays = modes()
    arrays["residual_flexibility"] = np.diag([1e-12, 0.0, 0.0, 2e-12])
    write(tmp_path, "npz", arrays)
    for damping in ("uniform: 0.2 %", "imported: true"):
        found = evaluated(
            study_text(imported(SECTION + "npz"), ("uniform: 0.2 %", damping)), tmp_path
        ).all_modes
        assert found.damping_ratio[-2:] == pytest.approx([0.5**0.5] * 2, rel=1e-12, abs=0)
        assert found.damping_ratio[1:-2] == pytest.approx(
            [0.002] * (found.damping_ratio.size - 3), rel=1e-12, abs=0
        )


# ---- what is refused ----


def refused(tmp_path: Path, arrays: dict[str, Any], kind: str = "npz") -> str:
    """What is said of a modal file."""
    with pytest.raises(StudyError) as caught:
        modes_in_si(read_modal_set(write(tmp_path, kind, arrays)), SI)
    assert "modes." in str(caught.value)
    return str(caught.value)


def changed(**arrays: Any) -> dict[str, Any]:
    """Modes with arrays replaced, or left out where None."""
    found = {**modes(), **arrays}
    return {name: value for name, value in found.items() if value is not None}


def test_arrays_that_are_not_what_they_should_be_are_refused_by_name(tmp_path):
    good = modes()
    shape, frequency = good["mode_shape"], good["frequency_hz"]
    nan = shape.copy()
    nan[2, 1] = np.nan
    n = frequency.size
    cases = [
        (changed(mode_shape=None), "'mode_shape' is missing"),
        (changed(mode_shapes=shape), "did you mean 'mode_shape'"),
        (changed(mode_shape=nan), "'mode_shape' is not finite at (3, 2)"),
        (changed(mode_shape=shape + 1e-3j), "'mode_shape' is complex"),
        (changed(mode_shape=shape.T), "transpose it"),
        (changed(frequency_hz=-frequency), "is negative"),
        (changed(frequency_hz=0 * frequency), "every mode is a rigid-body mode"),
        (changed(damping_ratio=np.full(n - 1, 0.1)), "'damping_ratio' has the shape"),
        (changed(damping_ratio=np.full(n, -0.1)), "damping_ratio -0.1 is not zero or more"),
        (changed(modal_mass=np.zeros(n)), "mode 1: modal_mass 0 is not above zero"),
        (changed(dofs=np.array(["B0.rz", "B3.x", "B3.x", "B3.rz"])), "'B3.x' stands twice (position 3)"),
        (changed(dofs=np.array(["B0.rz", "B3.x", "B3.q", "B3.rz"])), "'q' is no component of grid 'B3'"),
        (changed(dofs=np.array(["B0rz", "B3.x", "B3.y", "B3.rz"])), "'B0rz' is no degree of freedom"),
        (changed(residual_flexibility=np.eye(3)), "expected (4, 4)"),
        (changed(residual_flexibility=np.diag([1.0, 1, 1, -1])), "negative eigenvalue"),
        (changed(residual_flexibility=np.eye(4) + np.eye(4, k=1) / 2), "not symmetric at (1, 2)"),
    ]
    for arrays, message in cases:
        assert message in refused(tmp_path, arrays)


def test_two_modes_of_one_frequency_need_one_damping_ratio(tmp_path):
    arrays = modes()
    arrays["frequency_hz"][3] = arrays["frequency_hz"][2]
    arrays["damping_ratio"][3] = 0.01
    assert "modes 3 and 4 have one frequency" in refused(tmp_path, arrays)


@pytest.mark.parametrize("kind", ["npz", "mat", "json"])
def test_a_truncated_file_is_named(tmp_path, kind):
    file = write(tmp_path, kind, modes())
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    with pytest.raises(StudyError, match="truncated") as caught:
        read_modal_set(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("frequency_hz", "hz", ":2:1: the first column is 'hz'"),
        ("B3.x", "B3.rz", ":2:6: the column 'B3.rz' stands twice"),
        ("B3.x", "B3x", ":2: 'B3x' is no degree of freedom"),
        ("0.002", "nan", ":3:2: damping_ratio: 'nan' is no finite number"),
        ("0.002", "", ":3:2: damping_ratio: '' is no finite number"),
        ("0.002,", "", ":3: 5 values where the header names 6"),
        ("0.002", "0.002,7", ":3: 7 values where the header names 6"),
    ],
)
def test_a_broken_table_of_modes_is_refused_with_its_line(tmp_path, old, new, message):
    file = write(tmp_path, "csv", modes())
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(StudyError) as caught:
        read_modal_set(file)
    assert message in str(caught.value)


def test_rows_of_residual_flexibility_are_complete_or_refused(tmp_path):
    file = write(tmp_path, "csv", changed(residual_flexibility=np.eye(4) * 1e-9))
    lines = file.read_text().splitlines()
    cases = [
        (lines[:-1], "has no row of 'B3.rz'"),
        ([*lines, lines[-1]], f":{len(lines) + 1}:1: the residual flexibility of 'B3.rz' stands twice"),
        ([*lines, lines[-1].replace("B3.rz", "B3.ry")], "'B3.ry' has no column; did you mean"),
    ]
    for changed_lines, message in cases:
        file.write_text("\n".join(changed_lines) + "\n")
        with pytest.raises(StudyError) as caught:
            read_modal_set(file)
        assert message in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("units: {length: mm, force: N}, ", "", "the key 'units' is required"),
        ("length: mm, ", "", "the key 'length' is required"),
        (", force: N", "", "one of force, mass is required"),
        ("force: N", "force: N, mass: t", "'force' and 'mass' exclude each other"),
        ("length: mm", "length: kg", "wrong dimension"),
        ("length: mm", "length: parsec", "unknown unit 'parsec'"),
        ("tip: [B3, rz]", "tip: [B3, ry]", "no degree of freedom 'B3.ry'; did you mean"),
        ("tip: [B3, rz]", "tip: [B3, x]", "the mirror turns, but its port moves along 'x'"),
        ("modes.npz", "mode.npz", "mode.npz: no such file"),
        ("type: modal_set", "type: modal_sets", "use one of"),
    ],
)
def test_a_section_that_does_not_fit_its_file_is_refused(tmp_path, old, new, message):
    write(tmp_path, "npz", modes())
    text = study_text(imported(SECTION + "npz"))
    assert old in text
    with pytest.raises(StudyError) as caught:
        build_problem(parse_study(text.replace(old, new), tmp_path))
    assert message in str(caught.value)
    assert "study.yaml:" in str(caught.value)


def test_a_mirror_with_mass_needs_a_translation_to_ride_on(tmp_path):
    arrays = modes()
    arrays |= {"mode_shape": arrays["mode_shape"][[0, 3]], "dofs": arrays["dofs"][[0, 3]]}
    write(tmp_path, "npz", arrays)
    text = study_text(imported(SECTION + "npz"))
    with pytest.raises(StudyError, match=r"mirror.mass: the model has no translation at the mirror's grid"):
        evaluated(text, tmp_path)
    without = evaluated(text.replace("mass: 5 kg", "mass: 0 kg"), tmp_path)
    same = evaluated(
        study_text("structure: {type: barker_truss, bays: 3}\n", ("mass: 5 kg", "mass: 0 kg")), tmp_path
    )
    assert metrics(without) == pytest.approx(metrics(same), rel=ROUNDING, abs=0)


def test_damping_of_the_file_must_be_in_the_file(tmp_path):
    write(tmp_path, "npz", changed(damping_ratio=None))
    change = ("uniform: 0.2 %", "imported: true")
    with pytest.raises(StudyError, match="damping: the structure's file has no damping"):
        evaluated(study_text(imported(SECTION + "npz"), change), tmp_path)
    with pytest.raises(StudyError, match=r"damping.imported: no file tells this structure's damping"):
        evaluated(study_text("structure: {type: barker_truss, bays: 3}\n", change), tmp_path)


def test_members_of_an_imported_structure_cannot_be_varied(tmp_path):
    write(tmp_path, "npz", modes())
    text = study_text(imported(SECTION + "npz"), ("kind: analysis", "kind: codesign"))
    text += "objectives: [{minimize: jitter_total}]\nvariables: [{quantity: area, lower: 1 mm^2, upper: 9 mm^2}]\n"
    with pytest.raises(
        StudyError, match=r"variables.0.quantity: an imported structure is known by its modes"
    ):
        parse_study(text, tmp_path)


def test_a_fixed_structure_without_a_hub_needs_its_inertia_stated():
    modes_found = ImportedModes(np.array([10.0]), np.array([[1.0]]), ("1.rz",))
    with pytest.raises(ModelError, match="does not follow from 0 rigid-body modes; add 'structure_inertia'"):
        assemble_modes(modes_found, {"tip": ("1", "rz")}, "tip", 1.0)
    structure = assemble_modes(modes_found, {"tip": ("1", "rz")}, "tip", 1.0, inertia=3.0)
    assert not structure.ports["hub"].any()
    with pytest.raises(FosoptError, match="port 'top' does not exist"):
        assemble_modes(modes_found, {"tip": ("1", "rz")}, "top", 1.0, 3.0)


# ---- studies ----


def test_a_run_keeps_a_copy_of_the_files_and_can_be_run_again(tmp_path):
    write(tmp_path, "csv", modes())
    text = study_text(imported(SECTION + "csv"))
    first = run_study(parse_study(text, tmp_path), tmp_path / "out")
    (tmp_path / "modes.csv").unlink()
    kept = (tmp_path / "out" / "study.yaml").read_text()
    assert "inputs/0-modes.csv" in kept
    again = run_study(parse_study(kept, tmp_path / "out"), tmp_path / "again")
    assert again["points"][0]["metrics"] == first["points"][0]["metrics"]
    assert (tmp_path / "out" / "report.html").stat().st_size > 0


def test_a_file_that_changes_is_read_again(tmp_path):
    arrays = modes()
    found = []
    for scale in (1.0, 2.0):
        write(tmp_path, "npz", arrays | {"frequency_hz": scale * arrays["frequency_hz"]})
        text = study_text(imported(SECTION + "npz"), ("mass: 5 kg", "mass: 0 kg"))
        found.append(evaluated(text, tmp_path).value("first_elastic_frequency"))
    assert found[1] == pytest.approx(2 * found[0], rel=1e-9, abs=0)


def test_a_study_of_an_imported_structure_survives_a_dump(tmp_path):
    write(tmp_path, "npz", modes())
    study = parse_study(study_text(imported(SECTION + "npz, rigid_below: 0.01 Hz")), tmp_path)
    assert parse_study(dump_study(study), tmp_path) == study


def test_mirror_and_loop_of_an_imported_structure_are_designed_like_those_of_its_own(tmp_path):
    write(tmp_path, "npz", modes())
    more = """\
variables:
  - {quantity: crossover, lower: 10 Hz, upper: 200 Hz}
  - {quantity: mirror_inertia, lower: 0.1 kg m^2, upper: 1 kg m^2}
objectives: [{minimize: jitter_total}]
constraints: [{metric: modulus_margin, lower: 0.5}]
"""
    optimum = []
    for section in (imported(SECTION + "npz"), "structure: {type: barker_truss, bays: 3}\n"):
        text = study_text(section, ("kind: analysis", "kind: codesign")) + more
        run = run_study(parse_study(text, tmp_path), tmp_path / f"out{len(optimum)}")
        assert run["points"][1]["verified"]
        optimum.append(run["points"][1]["metrics"]["jitter_total"])
    assert optimum[0] == pytest.approx(optimum[1], rel=1e-5, abs=0)  # the tolerance of the solver is 1e-6


def test_a_sweep_over_an_imported_structure_reads_a_file_once(tmp_path, monkeypatch):
    from fosopt.study import imports

    write(tmp_path, "npz", modes())
    calls = []
    read = imports.read_modal_set
    monkeypatch.setattr(imports, "read_modal_set", lambda file: calls.append(file) or read(file))
    text = study_text(imported(SECTION + "npz"), ("kind: analysis", "kind: sweep"))
    text += """\
sweep:
  axes:
    - {quantity: mirror_mass, list: [0 kg, 5 kg, 9 kg]}
  outputs: [jitter_total]
"""
    run_study(parse_study(text, tmp_path), tmp_path / "out")
    assert len(calls) == len(set(calls)) == 2  # the user's file, and its copy in the run directory


def swept(tmp_path: Path, axis: str, *changes: tuple[str, str]) -> list[float]:
    """Jitter along an axis of an imported structure."""
    text = study_text(imported(SECTION + "npz"), ("kind: analysis", "kind: sweep"), *changes)
    text += f"sweep:\n  axes:\n    - {{{axis}}}\n  outputs: [jitter_total]\n"
    run_study(parse_study(text, tmp_path), tmp_path / "out")
    found: list[float] = np.load(tmp_path / "out" / "arrays" / "jitter_total.npy").ravel().tolist()
    return found


def test_a_sweep_over_damping_takes_the_place_of_that_of_the_file_but_not_of_residual_flexibility(tmp_path):
    write(tmp_path, "npz", changed(residual_flexibility=np.diag([3e-9, 0.0, 0.0, 3e-9])))
    found = swept(
        tmp_path, "quantity: damping_ratio, list: [0.4 %, 2 %]", ("uniform: 0.2 %", "imported: true")
    )
    for ratio, value in zip(("0.4 %", "2 %"), found, strict=True):
        alone = evaluated(study_text(imported(SECTION + "npz"), ("0.2 %", ratio)), tmp_path)
        assert alone.all_modes.damping_ratio[-1] == pytest.approx(0.5**0.5)
        assert value == pytest.approx(alone.value("jitter_total"), rel=1e-9, abs=0)


def test_a_point_of_a_sweep_whose_mirror_cannot_ride_has_no_jitter(tmp_path):
    arrays = modes()
    write(
        tmp_path, "npz", arrays | {"mode_shape": arrays["mode_shape"][[0, 3]], "dofs": arrays["dofs"][[0, 3]]}
    )
    found = swept(tmp_path, "quantity: mirror_mass, list: [0 kg, 5 kg]", ("mass: 5 kg", "mass: 0 kg"))
    assert found[0] > 0 and np.isnan(found[1])


def test_the_truss_behind_these_tests_turns_about_its_hub():
    assert truss().dofs[0] == "B0.rz" and DATA.is_dir()
