"""The tool that changes the mathematics finds every change, and tells those that tests notice from the others."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

VERIFY = Path(__file__).resolve().parents[1] / "verify"

SOURCE = '''\
"""Not 1 of these: a docstring."""

_SCALE = 2.0


def area(width: float, count: int = 1) -> float:
    """Not these 2 either."""
    if width < 0:
        raise ValueError(f"{width + 1} is not above 0; give 3")
    return _SCALE * width + count - count * 0


def spare(x: float) -> float:
    return x - 4
'''

TESTS = """\
from fosopt.control.area import area


def test_area():
    assert area(3.0) == 7.0 and area(5.0, 2) == 12.0
"""

# What the recorder would have written; it needs a package that the tests do not.
RUN = """\
import sys
from pathlib import Path

sys.path.insert(0, sys.argv[1])
import mutant_tests
import mutants

mutant_tests.LIBRARIES = ""
mutants.ROOT = mutants.KEPT = root = Path(sys.argv[2])
name = "tests/test_area.py::test_area"
lines = {6: [name], 8: [name], 10: [name]}
file = "fosopt/control/area.py"
executed = mutant_tests.Executed({name: 0.01}, {file: lines}, {file: {3, 6, 13}})
found = list(mutants.mutants_of(root / file))
mutants.judge(found, mutants.Tests(executed, 10.0), root / "results.jsonl")
sys.exit(mutants.show({"control": found}, mutants.read(root / "results.jsonl")))
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("project")
    for path, text in (("fosopt/control/area.py", SOURCE), ("tests/test_area.py", TESTS), ("run.py", RUN)):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text, encoding="utf-8")
    return root


def test_mutants_are_noticed_whether_they_act_when_called_or_when_imported(project: Path) -> None:
    done = subprocess.run(
        [sys.executable, "run.py", str(VERIFY), str(project)],
        cwd=project,
        capture_output=True,
        text=True,
        timeout=120,
    )
    results = [
        json.loads(line) for line in (project / "results.jsonl").read_text(encoding="utf-8").splitlines()
    ]
    verdicts = {result["mutant"].partition(" ")[2]: result["verdict"].partition(" ")[0] for result in results}
    assert verdicts == {
        "2.0  ->  3.0": "noticed",
        "1  ->  2": "noticed",
        "width < 0  ->  ((width) >= (0))": "noticed",
        "_SCALE * width + count - count * 0  ->  ((_SCALE * width + count) + (count * 0))": "survives",
        "_SCALE * width + count  ->  ((_SCALE * width) - (count))": "noticed",
        "_SCALE * width  ->  ((_SCALE) / (width))": "noticed",
        "count * 0  ->  ((count) / (0))": "noticed",
        "x - 4  ->  ((x) + (4))": "survives",
        "4  ->  5": "survives",
    }
    by = {result["mutant"].partition(" ")[2]: result["tests"] for result in results}
    assert by["x - 4  ->  ((x) + (4))"] == 0
    assert "control: 9 mutants drawn, 6 noticed, 3 survives" in done.stdout
    assert done.returncode == 1
