"""Change one operation of the mathematics at a time and see whether a test notices.

    python verify/mutants.py control --count 100        # a random sample of a package's mutants
    python verify/mutants.py fosopt/control/pid.py      # or of one file's

A mutant is a copy of fosopt with one operator, sign, comparison or number changed. The files of tests that name
something of the changed file are run on it, those that do so most often first, until a test fails. What survives is
printed: either the change makes no difference, or a test is missing, or it stands elsewhere.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("control", "metrics", "modes", "plant")
PATIENCE = 300.0  # seconds for the tests of one mutant; a loop that does not end is noticed as well
MOST_FILES = 6
SLOW = ("_browser", "_resume", "_cluster", "_frame", "_page")  # and of little use here

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


def tests_of(file: str) -> list[str]:
    """Files of tests that name something public of a file, or something of a package that hands it on."""
    tree = ast.parse((ROOT / file).read_bytes())
    kinds = ast.FunctionDef | ast.ClassDef
    names = {node.name for node in tree.body if isinstance(node, kinds) and not node.name.startswith("_")}
    stem = Path(file).stem
    pattern = re.compile(rf"\b({'|'.join(sorted(names) or ['$'])})\b|\.{stem}\b|\bimport .*\b{stem}\b")
    quick = [path for path in (ROOT / "tests").glob("test_*.py") if not path.stem.endswith(SLOW)]
    found = {path: len(pattern.findall(path.read_text())) for path in quick}
    if not any(found.values()):
        # Handed on by others of its package: whoever uses that.
        package = Path(file).parent.name
        found = {path: path.read_text().count(f"fosopt.{package}") for path in quick}
    best = sorted((path for path in found if found[path]), key=lambda path: -found[path])
    return [str(path.relative_to(ROOT)) for path in best[:MOST_FILES]]


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
    given = parser.parse_args()
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
            tests = tests_of(mutant.file)
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
                        print(f"survives {count} files of tests: {mutant}", flush=True)
            print(
                f"{package}: {len(drawn) - left} of {len(drawn)} mutants noticed ({len(every)} in all)",
                flush=True,
            )
            alive += left
    return 1 if alive else 0


if __name__ == "__main__":
    sys.exit(main())
