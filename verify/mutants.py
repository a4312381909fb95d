"""Change one operation of the mathematics at a time and see whether a test notices.

    python verify/mutants.py --map                      # once: which test runs which line (needs pytest-cov)
    python verify/mutants.py control --count 100        # a random sample of a package's mutants

A mutant is a copy of fosopt with one operator, sign, comparison or number changed. The tests that run the changed
line are run on it, quick ones first, until one fails. What survives is printed: either the change makes no difference,
or a test is missing.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).resolve().parents[1]
MAP = ROOT / ".mutants.json"
PACKAGES = ("control", "metrics", "modes", "plant")
PATIENCE = 300.0  # seconds for the tests of one mutant; a loop that does not end is noticed as well
MOST_TESTS = 60

_SWAPPED: dict[type[ast.AST], str] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.Pow: "*",
    ast.Lt: ">=",
    ast.LtE: ">",
    ast.Gt: "<=",
    ast.GtE: "<",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.And: "or",
    ast.Or: "and",
}


@dataclass(frozen=True)
class Mutant:
    """One change of one file: bytes from `start` to `end` become `text`."""

    file: str
    line: int
    start: int
    end: int
    text: str
    was: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.was}  ->  {self.text}"


def mutants_of(path: Path) -> Iterator[Mutant]:
    """All mutants of a file: messages, annotations and docstrings stay."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def span(node: ast.expr) -> tuple[int, int]:
        assert node.end_lineno is not None and node.end_col_offset is not None
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    def text(node: ast.expr) -> str:
        return source[slice(*span(node))].decode()

    def made(node: ast.expr, new: str) -> Mutant:
        return Mutant(str(path.relative_to(ROOT)), node.lineno, *span(node), new, text(node))

    for node in _computing(ast.parse(source)):
        if isinstance(node, ast.BinOp) and type(node.op) in _SWAPPED:
            yield made(node, f"(({text(node.left)}) {_SWAPPED[type(node.op)]} ({text(node.right)}))")
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield made(node, f"({text(node.operand)})")
        elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _SWAPPED:
            other = _SWAPPED[type(node.ops[0])]
            yield made(node, f"(({text(node.left)}) {other} ({text(node.comparators[0])}))")
        elif isinstance(node, ast.BoolOp):
            word = f" {_SWAPPED[type(node.op)]} "
            yield made(node, "(" + word.join(f"({text(value)})" for value in node.values) + ")")
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value != 0:
            yield made(node, repr(node.value + 1 if type(node.value) is int else node.value * 1.5))


def _computing(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes that compute something."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for node in value if isinstance(value, list) else [value]:
            if not isinstance(node, ast.AST) or isinstance(node, ast.Raise | ast.JoinedStr | ast.ImportFrom):
                continue
            yield node
            yield from _computing(node)


def write_map() -> None:
    """Run all tests once and keep which of them run which line, and how long each takes."""
    with tempfile.TemporaryDirectory() as folder:
        data, report = Path(folder) / "coverage", Path(folder) / "report.xml"
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "--cov=fosopt",
            "--cov-context=test",
            "--cov-report=",
        ]
        environment = os.environ | {"COVERAGE_FILE": str(data), "CI": "1"}
        subprocess.run([*command, f"--junitxml={report}"], cwd=ROOT, env=environment, check=True)
        seconds: dict[str, float] = {}
        for case in ElementTree.parse(report).iter("testcase"):
            stem = case.get("classname", "").replace(".", "/")
            seconds[f"{stem}.py::{case.get('name')}"] = float(case.get("time", "0"))
        lines: dict[str, dict[str, list[str]]] = {}
        with sqlite3.connect(data) as database:
            from coverage.numbits import numbits_to_nums

            rows = database.execute(
                "SELECT file.path, context.context, numbits FROM line_bits "
                "JOIN file ON file.id = file_id JOIN context ON context.id = context_id"
            )
            for path, context, bits in rows:
                test = context.partition("|")[0]
                if not test:
                    continue
                of_file = lines.setdefault(str(Path(path).relative_to(ROOT)), {})
                for line in numbits_to_nums(bits):
                    of_file.setdefault(str(line), []).append(test)
    MAP.write_text(json.dumps({"seconds": seconds, "lines": lines}))


def tests_of(mutant: Mutant, known: dict[str, dict[str, dict[str, list[str]]]]) -> list[str]:
    """Tests that run the changed line, quick ones first; of a compiled line, those that run anything of its file."""
    of_file = known["lines"].get(mutant.file, {})
    found = set(of_file.get(str(mutant.line), ())) or {test for each in of_file.values() for test in each}
    seconds = known["seconds"]
    return sorted(found, key=lambda test: seconds.get(test, 0.0))[:MOST_TESTS]


def survives(mutant: Mutant, tests: list[str], place: Path) -> bool:
    """Whether all tests pass on the mutant, in a copy of the project of its own."""
    path = place / mutant.file
    source = path.read_bytes()
    path.write_bytes(source[: mutant.start] + mutant.text.encode() + source[mutant.end :])
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": str(place), "CI": "1"}
    try:
        done = subprocess.run(
            command, cwd=place, env=environment, capture_output=True, timeout=PATIENCE, check=False
        )
        return done.returncode == 0
    except subprocess.TimeoutExpired:
        return False
    finally:
        path.write_bytes(source)


def main() -> int:
    """Run a sample and print what survives; 1 if something does."""
    parser = argparse.ArgumentParser(description="Which changes of the mathematics do the tests not notice?")
    parser.add_argument("package", nargs="*", default=PACKAGES, help=f"of {', '.join(PACKAGES)}; or a file")
    parser.add_argument("--count", type=int, default=100, help="mutants drawn of each package")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--map", action="store_true", help="renew the map of tests and lines first")
    given = parser.parse_args()
    if given.map:
        write_map()
    if not MAP.exists():
        print("no map of tests and lines yet; add --map (it needs: pip install pytest-cov)", file=sys.stderr)
        return 2
    known = json.loads(MAP.read_text())
    places: Queue[Path] = Queue()
    alive = 0
    with tempfile.TemporaryDirectory() as folder:
        for k in range(given.workers):
            place = Path(folder) / str(k)
            for part in ("fosopt", "tests", "studies", "docs", "notebooks"):
                shutil.copytree(ROOT / part, place / part)
            for part in ("pyproject.toml", "README.md", "Makefile", "requirements.lock"):
                shutil.copy(ROOT / part, place / part)
            places.put(place)

        def verdict(mutant: Mutant) -> tuple[Mutant, int, bool]:
            tests = tests_of(mutant, known)
            place = places.get()
            try:
                return mutant, len(tests), bool(not tests or survives(mutant, tests, place))
            finally:
                places.put(place)

        for package in given.package:
            files = (
                [ROOT / package]
                if package.endswith(".py")
                else sorted((ROOT / "fosopt" / package).rglob("*.py"))
            )
            every = [mutant for file in files for mutant in mutants_of(file)]
            drawn = random.Random(given.seed).sample(every, min(given.count, len(every)))
            left = 0
            with ThreadPoolExecutor(given.workers) as pool:
                for mutant, count, lives in pool.map(verdict, drawn):
                    if lives:
                        left += 1
                        print(f"survives {count} tests: {mutant}", flush=True)
            print(
                f"{package}: {len(drawn) - left} of {len(drawn)} mutants noticed ({len(every)} in all)",
                flush=True,
            )
            alive += left
    return 1 if alive else 0


if __name__ == "__main__":
    sys.exit(main())
