"""A small truss as other tools would hand it over: in millimeters and newtons, as modes, matrices and decks."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fosopt.modes import modal_frame
from fosopt.problem import Evaluation
from fosopt.structure import Structure, assemble, barker_truss, mass_matrix, stiffness_matrix
from fosopt.study import parse_study
from fosopt.study.build import build_problem, start_vector

DATA = Path(__file__).parent / "data" / "imports"
MM = 1e-3
REST = """\
hub: {type: held, bandwidth: 0.1 Hz, damping_ratio: 0.7}
damping: {uniform: 0.2 %}
mirror: {mass: 5 kg, inertia: 0.2 kg m^2, frequency: 20 Hz, damping_ratio: 0.01}
controller: {type: pid, kp: 600, ki: 50000, crossover: 60 Hz}
disturbances:
  - {name: aft, at: hub_torque, filter: {type: low_pass, corner: 10 Hz, order: 2, rms: 150 N m}}
"""
NATIVE = "structure: {type: barker_truss, boundary: pinned, bays: 3}\n"
UNITS = "units: {length: mm, force: N}"


@cache
def truss() -> Structure:
    """The truss in SI units."""
    return assemble(barker_truss("pinned", 3), "tip")


@cache
def matrices() -> tuple[Any, Any]:
    """Its stiffness and mass in millimeters and newtons, so that mass is in tonnes."""
    s = truss()
    unit = np.array([MM if name[-1] in "xy" else 1.0 for name in s.dofs])
    k, m = np.asarray(stiffness_matrix(s, s.area)), np.asarray(mass_matrix(s, s.area, s.batten_mass, 0.0))
    # One unit of energy is a newton millimeter.
    return tuple((each + each.T) / 2 * np.outer(unit, unit) / MM for each in (k, m))


def modes(dofs: tuple[str, ...] = ("B0.rz", "B3.x", "B3.y", "B3.rz")) -> dict[str, Any]:
    """Arrays of a modal file in millimeters and newtons."""
    s = truss()
    frame = modal_frame(s, s.area, s.batten_mass, 0.0, "tip")
    unit = np.array([MM if name[-1] in "xy" else 1.0 for name in dofs])
    shape = np.array([s.port(name) for name in dofs]) @ frame.shapes
    return {
        "frequency_hz": np.sqrt(frame.eigenvalue) / (2 * np.pi),
        "mode_shape": shape * np.sqrt(MM) / unit[:, None],
        "dofs": np.array(dofs),
        "damping_ratio": np.full(frame.eigenvalue.size, 0.002),
    }


def study_text(structure: str, *changes: tuple[str, str]) -> str:
    """An analysis of a structure given as a section."""
    text = f"fosopt: 1\nname: Own\nkind: analysis\n{structure}{REST}"
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def evaluated(text: str, folder: Path) -> Evaluation:
    """The start design of a study."""
    study = parse_study(text, folder)
    problem = build_problem(study)
    return problem.evaluate(start_vector(study, problem))


@cache
def native() -> dict[str, float]:
    """Metrics of the truss as fosopt builds it."""
    return metrics(evaluated(study_text(NATIVE), Path()))


def metrics(evaluation: Evaluation) -> dict[str, float]:
    """What an importer must not change."""
    names = (
        "structural_mass",
        "structure_inertia",
        "first_elastic_frequency",
        "modulus_margin",
        "jitter_total",
    )
    return {name: evaluation.value(name) for name in names}


def structural_mass() -> float:
    """Mass of the truss [kg]."""
    return native()["structural_mass"]


def imported(keys: str, ports: str = "{hub: [B0, rz], tip: [B3, rz]}") -> str:
    """The section of an imported structure."""
    return f"structure: {{{keys}, {UNITS}, structural_mass: {structural_mass()!r} kg, ports: {ports}}}\n"
