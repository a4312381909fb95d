"""The notebooks run from top to bottom, print what they tell, and define no formula of their own."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
TOLD = {
    "first_study": (
        "sum 1.0000000000",
        "104.18 kg     6.181 urad  optimal, verified True",
        "124.93 kg     4.310 urad  optimal, verified True",
    ),
    "own_model": (
        "structural mass 108.3 kg",
        "optimal, verified True, jitter below 5 urad: True",
        "modes, 3.1",
    ),
    "inertia_sweep": (
        "loses stability at 1.0770 %",
        "stable False  jitter      nan urad",
        "they sum to one at every inertia, to 1e-12: True",
    ),
    "certified_front": ("least structural_mass", "gap 0.01 %", "  - the control torque is unlimited"),
    "chapter2_structure": ("beam      1.53    9.62", "largest deviation of a kept frequency: "),
    "chapter3_benchmark": ("case 2,    10 Hz: unstable", "rigid support: stable"),
    "chapter4_multimode": ("mirror mode 5", "2.0 % 8-dof  unstable 18.2 Hz grows", "20.0 % of the truss is"),
}


def test_every_notebook_is_run_here():
    assert {path.stem for path in NOTEBOOKS.glob("*.py")} == set(TOLD)


@pytest.mark.parametrize("name", TOLD)
def test_a_notebook_runs(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(NOTEBOOKS / f"{name}.py"))
    printed = capsys.readouterr().out
    for told in TOLD[name]:
        assert told in printed


@pytest.mark.parametrize("name", TOLD)
def test_a_notebook_defines_nothing(name: str) -> None:
    tree = ast.parse((NOTEBOOKS / f"{name}.py").read_text(encoding="utf-8"))
    assert not [
        node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.Lambda, ast.ClassDef))
    ]
