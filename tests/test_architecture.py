"""The shape of the house: layers, fences, docstrings, citations and what no file may carry.

Every rule is held against this repository and then against a small tree that breaks it, so that a rule
that has gone blind is noticed.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from docstring_rules import (
    bibliography,
    malformed_bibliography,
    malformed_docstrings,
    missing_docstrings,
    unknown_citations,
)
from source_rules import (
    broken_fences,
    imported_by_help,
    leaks,
    read_modules,
    repository_files,
    too_long,
    wrong_layers,
)

ROOT = Path(__file__).resolve().parents[1]

RANKS = {
    "errors": 0,
    "files": 0,
    "units": 0,
    "ops": 0,
    "expressions": 1,
    "forms": 1,
    "structure": 1,
    "modes": 2,
    "actuators": 3,
    "plant": 4,
    "control": 5,
    "metrics": 6,
    "symbolic": 7,
    "problem": 8,
    "solve": 9,
    "relax": 9,
    "account": 10,
    "certify": 10,
    "report": 11,
    "export": 11,
    "interchange": 11,
    "openmdao": 11,
    "study": 12,
    "reproduce": 13,
    "cli": 14,
    "__main__": 15,
}
# Errors, units and the expressions of a study are words, not layers: everyone speaks them.
OPEN_TO_ALL = {"errors", "units", "expressions"}

ANYWHERE = None
LIBRARIES = {
    "casadi": {"ops", "symbolic", "modes", "solve"},
    "clarabel": {"relax"},
    "control": {"interchange"},
    "cvxpy": {"relax"},
    "dask": {"study"},
    "distributed": {"study"},
    "matplotlib": {"report"},
    "netCDF4": {"export"},
    "numba": {"plant"},
    "numpy": ANYWHERE,
    "openmdao": {"openmdao"},
    "plotly": {"report"},
    "pyarrow": {"export"},
    "pydantic": {"study"},
    "pydantic_core": {"study"},
    "rich": {"cli"},
    "ruamel": {"study"},
    "scipy": ANYWHERE,
    "typer": {"cli"},
}
HEAVY = {"casadi", "clarabel", "cvxpy", "dask", "distributed", "matplotlib", "numba", "plotly", "scipy"}

LINE_LIMIT = 450


def hold(complaints: list[str]) -> None:
    """Fail with every complaint in full."""
    assert not complaints, "\n".join(["", *complaints])


@pytest.fixture(scope="module")
def modules():
    found = read_modules(ROOT)
    assert found, "fosopt/ holds no module: the rules below would hold for nothing"
    return found


@pytest.fixture
def tree(tmp_path: Path) -> Callable[[dict[str, str]], Path]:
    """Write files under a fresh folder and give the folder."""

    def write(files: dict[str, str]) -> Path:
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        return tmp_path

    return write


def test_imports_point_down(modules):
    hold(wrong_layers(modules, RANKS, OPEN_TO_ALL))


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("ops.py", "import fosopt.solve\n"),
        ("metrics/jitter.py", "from fosopt import problem\n"),
        ("metrics/jitter.py", "from fosopt.certify import judge\n"),
        ("metrics/jitter.py", "from ..symbolic import function\n"),
        ("metrics/__init__.py", "from ..symbolic import function\n"),
        ("plant.py", "from . import control\n"),
        ("plant.py", "def late():\n    from fosopt.metrics import mass\n"),
        ("plant.py", "import importlib\nimportlib.import_module('fosopt.cli')\n"),
        ("solve/ipopt.py", "from fosopt.relax import cone\n"),
        ("relax/cone.py", "from fosopt.solve import ipopt\n"),
        ("export.py", "from fosopt.report import page\n"),
        ("cli.py", "from fosopt import solve_everything\n"),
        ("cli.py", "import fosopt\n"),
        ("helpers.py", "import math\n"),
    ],
)
def test_an_import_that_points_up_or_aside_is_refused(tree, file, text):
    root = tree({f"fosopt/{file}": text})
    assert len(wrong_layers(read_modules(root), RANKS, OPEN_TO_ALL)) == 1


def test_imports_that_point_down_pass(tree):
    root = tree(
        {
            "fosopt/__init__.py": "from fosopt.cli import main\n",
            "fosopt/units.py": "from fosopt.errors import StudyError\n",
            "fosopt/metrics/jitter.py": "from . import mass\nfrom .. import plant\nimport fosopt.units\n",
            "fosopt/cli.py": "from fosopt import __version__, study\n",
        }
    )
    assert wrong_layers(read_modules(root), RANKS, OPEN_TO_ALL) == []


def test_a_circle_of_packages_open_to_all_is_refused(tree):
    root = tree(
        {"fosopt/units.py": "from . import expressions\n", "fosopt/expressions.py": "from . import units\n"}
    )
    assert ["circle" in line for line in wrong_layers(read_modules(root), RANKS, OPEN_TO_ALL)] == [True]


def test_libraries_stay_inside_their_fences(modules):
    hold(broken_fences(modules, LIBRARIES))


def test_every_run_time_dependency_has_a_fence():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [
        line for name, lines in project["optional-dependencies"].items() if name != "test" for line in lines
    ]
    declared = {re.split("[<>=~! ]", line)[0] for line in [*project["dependencies"], *extras]}
    provided = packages_distributions()
    fenced = {name.replace("_", "-") for library in LIBRARIES for name in provided[library]}
    assert fenced == declared


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("problem.py", "import casadi as ca\n"),
        ("metrics/mass.py", "from casadi import MX\n"),
        ("certify.py", "def late():\n    import cvxpy\n"),
        ("solve/ipopt.py", "import clarabel\n"),
        ("study/runner.py", "import rich.progress\n"),
        ("cli.py", "from plotly import graph_objects\n"),
        ("export.py", "import matplotlib.pyplot as plt\n"),
        ("control/pid.py", "import control\n"),
        ("plant.py", "__import__('casadi')\n"),
    ],
)
def test_a_library_outside_its_fence_is_refused(tree, file, text):
    root = tree({f"fosopt/{file}": text})
    assert len(broken_fences(read_modules(root), LIBRARIES)) == 1


def test_everything_public_has_a_docstring(modules):
    hold(missing_docstrings(modules))


def test_a_missing_docstring_is_found(tree):
    text = (
        '"""A module."""\n'
        "def area(): ...\n"
        "def _hidden(): ...\n"
        "class Bar:\n"
        '    """A bar."""\n'
        "    def length(self): ...\n"
        "    def __len__(self): ...\n"
        "    @override\n"
        "    def mass(self): ...\n"
    )
    root = tree({"fosopt/__init__.py": "", "fosopt/ops.py": text})
    found = [line.split(": ")[1].split()[0] for line in missing_docstrings(read_modules(root))]
    assert found == ["fosopt", "area", "Bar.length"]


def test_docstrings_are_numpydoc(modules):
    hold(malformed_docstrings(modules))


@pytest.mark.parametrize(
    ("section", "fault"),
    [
        ("Raise\n-----\nValueError\n    When.", "'Raise' is no section"),
        ("Raises\n---\nValueError\n    When.", "differ in length"),
        ("Raises\nValueError\n    When.", "not underlined"),
        ("Raises\n------", "is empty"),
        ("Raises\n------\nValueEror\n    When.", "'ValueEror' in Raises is no exception"),
        ("Raises\n------\nValueError", "is not described"),
        ("Raises\n------\nValueError\n    When.\n\nReturns\n-------\nThat.", "sections stand as"),
        ("Notes\n-----\nOne.\n\nNotes\n-----\nTwo.", "stands twice"),
        ("Parameters\n----------\naera : (n,)\n    Of the bars [m^2].", "'aera' is no parameter"),
        ("Args:\n    area: of the bars", "not numpydoc"),
    ],
)
def test_a_malformed_section_is_refused(tree, section, fault):
    docstring = f"Mass.\n\n{section}\n".replace("\n", "\n    ")
    root = tree({"fosopt/ops.py": f'def mass(area):\n    """{docstring}"""\n'})
    complaints = malformed_docstrings(read_modules(root))
    assert [fault in complaint for complaint in complaints] == [True]


def test_fields_of_a_base_class_are_parameters(tree):
    text = (
        "class Body:\n    mass: float\n"
        "class Mirror(Body):\n"
        '    """A mirror.\n\n    Parameters\n    ----------\n    mass, inertia\n        Of it.\n    """\n'
        "    inertia: float\n"
    )
    root = tree({"fosopt/ops.py": text})
    assert malformed_docstrings(read_modules(root)) == []


def test_every_citation_is_in_the_bibliography(modules):
    keys = bibliography((ROOT / "docs/references.bib").read_text(encoding="utf-8"))
    hold(unknown_citations(modules, keys))


def test_the_bibliography_is_well_formed():
    hold(malformed_bibliography((ROOT / "docs/references.bib").read_text(encoding="utf-8")))


def test_a_citation_of_nothing_is_found(tree):
    text = '"""Known [Golub1973].\n\nUnknown [Nobody1999].\n"""\n# [Golub1973, Noone2001]\nx = "[Text1900]"\n'
    root = tree({"fosopt/ops.py": text})
    found = [line.split(" ")[:2] for line in unknown_citations(read_modules(root), {"Golub1973"})]
    assert found == [["fosopt/ops.py:3:", "[Nobody1999]"], ["fosopt/ops.py:5:", "[Noone2001]"]]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("@book{Golub1973,\n author = {G},\n title = {T},\n}\n", "lacks year"),
        ("@book{Golub1973,\n author = {G},\n title = {T},\n year = {1974},\n}\n", "is of 1974"),
        ("@book{Golub1973,\n author = {G},\n title = {T},\n year = {1973},\n}\n" * 2, "stands twice"),
        ("@book{Golub1973,\n author = {G},\n title = {T},\n year = {1973}}\n", "does not end"),
    ],
)
def test_a_malformed_bibliography_is_refused(text, fault):
    assert [fault in complaint for complaint in malformed_bibliography(text)] == [True]


def test_no_module_outgrows_its_room(modules):
    hold(too_long(modules, LINE_LIMIT))


def test_a_module_that_outgrows_its_room_is_found(tree):
    root = tree({"fosopt/plant.py": "\n" * 451, "fosopt/ops.py": "\n" * 450})
    assert [line.split(":")[0] for line in too_long(read_modules(root), LINE_LIMIT)] == ["fosopt/plant.py"]


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="an unpacked archive has no list of committed files")
def test_no_file_carries_a_path_of_one_machine_or_an_index():
    files = repository_files(ROOT)
    assert "pyproject.toml" in files
    hold(leaks(ROOT, files))


@pytest.mark.parametrize(
    "text",
    [
        "cache = /{}/someone/x".format("home"),
        'open("/{}/notes.txt")'.format("tmp"),
        "see C:\\{}\\someone".format("Users"),
        "https://example.org/pypi/{}/".format("simple"),
        "numpy @ https://example.org/{}/ab/numpy.whl".format("packages"),
        "--extra-{}-url = x".format("index"),
    ],
)
def test_a_leak_is_found(tree, text):
    root = tree({"docs/page.md": f"# Title\n\n{text}\n"})
    assert [line.startswith("docs/page.md:3: ") for line in leaks(root, ["docs/page.md"])] == [True]


@pytest.mark.parametrize(
    "text", ["#!/usr/bin/env bash", "https://example.org/home/page", "tests/tmp/x", "a simple url"]
)
def test_what_every_machine_has_is_no_leak(tree, text):
    root = tree({"docs/page.md": text})
    assert leaks(root, ["docs/page.md"]) == []


def test_help_loads_no_heavy_library():
    hold(imported_by_help(ROOT, HEAVY))


@pytest.mark.parametrize(
    ("cli", "fault"),
    [
        ("def main():\n    import plotly\n", "imports plotly"),
        ("import cvxpy.atoms\ndef main():\n    raise SystemExit(0)\n", "imports cvxpy"),
        ("def main():\n    raise SystemExit(2)\n", "failed"),
        ("def main():\n    raise ValueError\n", "failed"),
        ("", "failed"),
    ],
)
def test_a_heavy_or_failing_help_is_found(tree, cli, fault):
    hollow = {"plotly.py": "", "cvxpy/__init__.py": "", "cvxpy/atoms.py": ""}
    root = tree({"fosopt/__init__.py": "", "fosopt/cli.py": cli, **hollow})
    assert [fault in complaint for complaint in imported_by_help(root, HEAVY)] == [True]
