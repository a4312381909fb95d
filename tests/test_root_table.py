"""The calibration that ships: its targets, its optimum, what is left over, and what fosopt took from it."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from reference import DISSERTATION, HZ, Array
from scipy import linalg
from small_studies import STUDIES

from fosopt.structure import assemble, barker_truss, mass_matrix, stiffness_matrix
from fosopt.structure.barker import BATTEN_MASS, TABLE_MASS
from fosopt.study import load_study
from fosopt.study.runner import run_study

STUDY = load_study(STUDIES / "root-table.yaml")
PRINTED = np.array(DISSERTATION["table_2_2"]["fem1"])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return run_study(STUDY, tmp_path_factory.mktemp("root") / "out")


@pytest.fixture(scope="module")
def optimum(run: dict[str, Any]) -> Array:
    """Stiffnesses in x, y and rotation, and the mass at the root."""
    values = run["points"][-1]["variables"]
    return np.array([*values["table_translation"], *values["table_rotation"], *values["root_mass"]])


def deviations(design: Array) -> Array:
    """Relative deviations of FEM1's frequencies from the printed ones, by an eigensolver of their own [-]."""
    truss = barker_truss("table")
    springs = tuple(
        replace(spring, stiffness=float(k)) for spring, k in zip(truss.springs, design, strict=False)
    )
    root = truss.battens[0]
    mass = float(design[-1])
    root = replace(root, mass=mass, inertia=root.inertia * mass / root.mass)
    of = assemble(replace(truss, springs=springs, battens=(root, *truss.battens[1:])), "tip")
    k, m = stiffness_matrix(of, of.area), mass_matrix(of, of.area, of.batten_mass, 0.0)
    eigenvalue = linalg.eigh(k, m, eigvals_only=True, subset_by_index=(0, PRINTED.size - 1))
    found: Array = np.sqrt(eigenvalue) / HZ / PRINTED - 1
    return found


def test_the_targets_of_the_study_are_the_printed_frequencies() -> None:
    texts = [STUDY.objectives[0].minimize.text, *(c.metric.text for c in STUDY.constraints)]
    found = [
        (int(mode), float(hertz))
        for text in texts
        for mode, hertz in re.findall(r"structure_frequency\[(\d)\] / \(6\.283185307 \* ([\d.]+)\)", text)
    ]
    assert found == 2 * [(k + 1, f) for k, f in enumerate(PRINTED)]
    labels = [str(c.label) for c in STUDY.constraints]
    assert [float(re.findall(r"against ([\d.]+) Hz", label)[0]) for label in labels] == PRINTED.tolist()


def test_the_calibration_is_verified_and_most_starts_agree(run: dict[str, Any]) -> None:
    point = run["points"][-1]
    assert (point["status"], point["verified"]) == ("optimal", True)
    assert point["starts"]["tried"] == 5
    assert point["starts"]["agreed"] >= 3
    assert not any(constraint["active"] for constraint in point["constraints"])


def test_the_residuals_are_the_deviations_of_the_calibrated_truss(
    run: dict[str, Any], optimum: Array
) -> None:
    point = run["points"][-1]
    percent = [constraint["value"] for constraint in point["constraints"]]
    expected = deviations(optimum)
    # 6.283185307 has ten digits; the residuals are differences of numbers of order one hundred.
    assert percent == pytest.approx(100 * expected, rel=0, abs=1e-7)
    total = point["metrics"][STUDY.objectives[0].minimize.text]
    assert total == pytest.approx(np.sum(expected**2), rel=1e-6)
    assert np.abs(expected).max() < 0.004


def test_no_table_nearby_fits_better(optimum: Array) -> None:
    least = np.sum(deviations(optimum) ** 2)
    for k in range(optimum.size):
        for factor in (0.98, 1.02):
            other = optimum.copy()
            other[k] *= factor
            assert np.sum(deviations(other) ** 2) > least


def test_the_optimum_is_what_fosopt_ships(optimum: Array) -> None:
    truss = barker_truss("table")
    shipped = [*(spring.stiffness for spring in truss.springs), truss.battens[0].mass]
    # Five digits ship, of which the first is three at least.
    assert optimum == pytest.approx(shipped, rel=2e-5, abs=0)
    assert truss.battens[0].mass == BATTEN_MASS + TABLE_MASS
    assert truss.battens[1].mass == BATTEN_MASS


def test_the_table_and_its_mass_belong_to_fem1_alone() -> None:
    for boundary in ("fixed", "pinned"):
        truss = barker_truss(boundary)
        assert not truss.springs
        assert {batten.mass for batten in truss.battens} == {BATTEN_MASS}
    heavy = barker_truss("table", batten_mass=2 * BATTEN_MASS).battens
    assert heavy[0].mass == 2 * BATTEN_MASS + TABLE_MASS
    # One radius of gyration for all.
    assert heavy[0].inertia / heavy[0].mass == pytest.approx(heavy[1].inertia / heavy[1].mass, rel=1e-14)


def test_the_run_names_the_springs_and_their_units(run: dict[str, Any]) -> None:
    quantities = run["quantities"]
    assert [quantities[name]["unit"] for name in ("table_translation", "table_rotation", "root_mass")] == [
        "N/m",
        "N m/rad",
        "kg",
    ]
    assert run["labels"] == {
        "table_translation": ["B0.x", "B0.y"],
        "table_rotation": ["B0.rz"],
        "root_mass": ["B0"],
    }
