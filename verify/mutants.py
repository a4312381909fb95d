"""Change one operation of the mathematics at a time and see whether a test notices.

    python verify/mutants.py                            # every mutant of the four packages, in random order
    python verify/mutants.py control --count 100        # a random sample of one package's
    python verify/mutants.py fosopt/control/pid.py      # or one file's

A mutant is fosopt with one operator, sign, comparison or number changed. The tests that execute the changed line are
run on it, the quickest and then the most thorough ones, until one fails or the time box is spent;
verify/mutant_tests.py says how. What survives is
printed: the change makes no difference, a test is missing, or one that takes longer than the time box notices it.

Which test executes what is found once, in some ten minutes, and kept in build/mutants with the results: a run that is
interrupted goes on, and mutants of files that have changed since are judged anew. Needs Linux and
`pip install coverage`. Tests that start other processes or a browser are left out.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import random
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from mutant_tests import OTHERWISE, SURVIVES, Executed, Loaded, record, run_imported, warm_up

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("control", "metrics", "modes", "plant")
KEPT = ROOT / "build" / "mutants"
QUICK = 0.5  # share of the time box for the quickest tests
Result = dict[str, str | float | None]

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
_FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


@dataclass(frozen=True)
class Mutant:
    """One change of one file: bytes from `start` to `end` become `text`.

    Attributes
    ----------
    lines
        What executes one of these may notice.
    imported
        Whether it acts while modules are imported.
    """

    file: str
    line: int
    start: int
    end: int
    text: str
    was: str
    lines: frozenset[int]
    imported: bool

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.was}  ->  {self.text}"

    @property
    def path(self) -> Path:
        return ROOT / self.file

    @property
    def source(self) -> bytes:
        """The changed file."""
        was = self.path.read_bytes()
        return was[: self.start] + self.text.encode() + was[self.end :]

    @property
    def key(self) -> str:
        """What a result is stored under: the change, and the file it was made in."""
        digest = hashlib.sha256(self.path.read_bytes()).hexdigest()[:12]
        return f"{self.file}:{digest}:{self.start}:{self.end}:{self.text}"


def mutants_of(path: Path) -> Iterator[Mutant]:
    """All mutants of a file: messages, annotations and docstrings stay."""
    source = path.read_bytes()
    tree = ast.parse(source)
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def span(node: ast.expr) -> tuple[int, int]:
        assert node.end_lineno is not None and node.end_col_offset is not None
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    def text(node: ast.expr) -> str:
        return source[slice(*span(node))].decode()

    for node, around in _computing(tree, ()):
        new = _changed(node, text)
        if new is not None:
            assert isinstance(node, ast.expr)
            lines, imported = _reach(tree, node, around)
            file = str(path.relative_to(ROOT))
            yield Mutant(file, node.lineno, *span(node), new, text(node), lines, imported)


def _changed(node: ast.AST, text: Callable[[ast.expr], str]) -> str | None:
    """What replaces a node, if anything does."""
    match node:
        case ast.BinOp() if type(node.op) in _SWAPPED:
            return f"(({text(node.left)}) {_SWAPPED[type(node.op)]} ({text(node.right)}))"
        case ast.UnaryOp(op=ast.USub()):
            return f"({text(node.operand)})"
        case ast.Compare(ops=[op], comparators=[right]) if type(op) in _SWAPPED:
            return f"(({text(node.left)}) {_SWAPPED[type(op)]} ({text(right)}))"
        case ast.BoolOp():
            values = (f"({text(value)})" for value in node.values)
            return f"({f' {_SWAPPED[type(node.op)]} '.join(values)})"
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool) and value != 0:
            return repr(value + 1 if isinstance(value, int) else value * 1.5)
    return None


def _computing(tree: ast.AST, around: tuple[ast.AST, ...]) -> Iterator[tuple[ast.AST, tuple[ast.AST, ...]]]:
    """Nodes that compute something, each with those it is in."""
    around = (*around, tree)
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for node in value if isinstance(value, list) else [value]:
            if not isinstance(node, ast.AST) or isinstance(node, ast.Raise | ast.JoinedStr | ast.ImportFrom):
                continue
            yield node, around
            yield from _computing(node, around)


def _reach(tree: ast.AST, node: ast.expr, around: tuple[ast.AST, ...]) -> tuple[frozenset[int], bool]:
    """Lines whose execution shows a change of a node, and whether it acts on import."""
    statement = next(each for each in reversed(around) if isinstance(each, ast.stmt))
    if any(isinstance(each, _FUNCTION) for each in around if each is not statement):
        return frozenset({node.lineno, statement.lineno}), False
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
        # A default: in none of the body's statements.
        return frozenset(range(statement.lineno, (statement.end_lineno or 0) + 1)), True
    names = {
        each.id for each in ast.walk(statement) if isinstance(each, ast.Name) and type(each.ctx) is ast.Store
    }
    if not all(name.startswith("_") for name in names) or any(
        isinstance(each, ast.ClassDef) for each in around
    ):
        return frozenset(), True
    uses = {
        each.lineno
        for each in ast.walk(tree)
        if isinstance(each, ast.Name | ast.Attribute)
        and (each.id if isinstance(each, ast.Name) else each.attr) in names
        and type(each.ctx) is ast.Load
    }
    return frozenset(uses), True


class Tests:
    """Which tests to run on a mutant."""

    def __init__(self, executed: Executed, seconds: float) -> None:
        self.executed, self.seconds = executed, seconds
        self.found: dict[str, Counter[str]] = defaultdict(Counter)

    def of(self, mutant: Mutant) -> tuple[dict[str, float], bool]:
        """Tests within the time box with what each takes, and whether these are all.

        First the quickest, those that have noticed much of the file, and one of each function's before its others; for
        the rest of the time those that execute most of the file.
        """
        lines = self.executed.tests.get(mutant.file, {})
        anywhere = not mutant.lines or is_compiled(mutant.path)
        names = {name for line, found in lines.items() if anywhere or line in mutant.lines for name in found}
        if is_compiled(mutant.path):
            names |= self._calling(mutant.path)
        found, seconds = self.found[mutant.file], self.executed.seconds
        variant: Counter[str] = Counter()
        cost: dict[str, float] = {}
        for name in sorted(names, key=lambda name: (seconds[name] / (1 + found[name]), name)):
            function = name.partition("[")[0]
            variant[function] += 1
            cost[name] = seconds[name] * variant[function] / (1 + found[name])
        share = Counter(name for tests in lines.values() for name in tests)
        thorough = sorted(names, key=lambda name: (-share[name], seconds[name], name))
        chosen: dict[str, float] = {}
        for order, box in (
            (sorted(cost, key=cost.__getitem__), QUICK * self.seconds),
            (thorough, self.seconds),
        ):
            left = box - sum(chosen.values())
            for name in order:
                if name not in chosen and (spent := seconds[name]) <= left:
                    chosen[name] = spent
                    left -= spent
        return chosen, len(chosen) == len(names)

    def _calling(self, path: Path) -> set[str]:
        """Tests that call a file's functions, whose own lines no recorder sees, or are in a file that names them."""
        own = {node.name for node in ast.parse(path.read_bytes()).body if isinstance(node, ast.FunctionDef)}
        through = {
            test
            for file, lines in self.executed.tests.items()
            for line in _calls(ROOT / file, frozenset(own))
            for test in lines.get(line, ())
        }
        files = {name.partition("::")[0] for name in self.executed.seconds}
        naming = {
            file for file in files if own & set(re.findall(r"\w+", (ROOT / file).read_text(encoding="utf-8")))
        }
        return through | {name for name in self.executed.seconds if name.partition("::")[0] in naming}

    def learn(self, known: dict[str, Result]) -> None:
        """Count what has noticed which file's mutants."""
        for key, result in known.items():
            self.found[key.partition(":")[0]][str(result["verdict"]).partition(" ")[2]] += 1

    def is_imported(self, mutant: Mutant) -> bool:
        """Whether replacing a function is not enough."""
        lines = self.executed.imported.get(mutant.file, set())
        return mutant.imported or mutant.line in lines or is_compiled(mutant.path)


@cache
def is_compiled(path: Path) -> bool:
    """Whether numba compiles functions of a file."""
    return b"import numba" in path.read_bytes()


@cache
def _calls(path: Path, names: frozenset[str]) -> list[int]:
    calls = (node for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, ast.Call))
    return [node.lineno for node in calls if isinstance(node.func, ast.Name) and node.func.id in names]


def judge(mutants: list[Mutant], tests: Tests, results: Path) -> None:
    """Try mutants and append a line of JSON for each."""

    def keep(mutant: Mutant, verdict: str, count: int, every: bool) -> None:
        tests.learn({mutant.key: {"verdict": verdict}})
        line = {"key": mutant.key, "mutant": str(mutant), "verdict": verdict, "tests": count}
        line |= {"seconds": None if every else tests.seconds}
        with results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line, ensure_ascii=False) + "\n")

    def replaced(loaded: Loaded) -> None:
        for mutant in mutants:
            if not tests.is_imported(mutant):
                chosen, every = tests.of(mutant)
                verdict = loaded.run(mutant.path, mutant.source, list(chosen)) if chosen else SURVIVES
                if verdict != OTHERWISE:
                    keep(mutant, verdict, len(chosen), every)

    warm_up(ROOT)
    tests.learn(read(results))
    if not (child := os.fork()):
        Loaded(ROOT, tests.executed.seconds, replaced).start()
        os._exit(0)
    os.waitpid(child, 0)
    known = read(results)
    tests.found.clear()
    tests.learn(known)
    for mutant in mutants:
        if not done(mutant, known, tests.seconds):
            chosen, every = tests.of(mutant)
            verdict = run_imported(mutant.path, mutant.source, chosen) if chosen else SURVIVES
            keep(mutant, verdict, len(chosen), every)


def read(results: Path) -> dict[str, Result]:
    """The last result of each mutant."""
    lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
    return {result["key"]: result for result in map(json.loads, lines)}


def done(mutant: Mutant, known: dict[str, Result], seconds: float) -> bool:
    """Whether a longer time box could not say more than is known."""
    result = known.get(mutant.key)
    if result is None:
        return False
    spent = result["seconds"]
    return result["verdict"] != SURVIVES or not isinstance(spent, float) or spent >= seconds


def main() -> int:
    """Try mutants, print what survives and a table; 1 if something survives."""
    parser = argparse.ArgumentParser(description="Which changes of the mathematics do the tests not notice?")
    parser.add_argument("package", nargs="*", default=PACKAGES, help=f"of {', '.join(PACKAGES)}; or a file")
    parser.add_argument("--count", type=int, help="mutants drawn of each package; all unless told")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=60.0, help="time box of one mutant's tests")
    parser.add_argument("--known", action="store_true", help="only show what earlier runs have found")
    given = parser.parse_args()
    executed, results = KEPT / "executed.json.gz", KEPT / "results.jsonl"
    drawn: dict[str, list[Mutant]] = {}
    for package in given.package:
        is_file = package.endswith(".py")
        files = [ROOT / package] if is_file else sorted((ROOT / "fosopt" / package).rglob("*.py"))
        every = [mutant for file in files for mutant in mutants_of(file)]
        count = len(every) if given.count is None else min(given.count, len(every))
        drawn[package] = random.Random(given.seed).sample(every, count)
    if not given.known:
        if not executed.exists():
            if find_spec("coverage") is None:
                raise SystemExit(
                    "coverage is missing, which finds out which test executes what: pip install coverage"
                )
            print("Finding out which test executes what; this takes a while.", flush=True)
            if not (child := os.fork()):
                record(ROOT, PACKAGES, executed)
                os._exit(0)
            os.waitpid(child, 0)
        if not executed.exists():
            raise SystemExit("no test could be recorded; the lines above say why")
        known = read(results)
        left = [
            mutant for each in drawn.values() for mutant in each if not done(mutant, known, given.seconds)
        ]
        random.Random(given.seed).shuffle(left)
        judge(left, Tests(Executed.read(executed), given.seconds), results)
    return show(drawn, read(results))


def show(drawn: dict[str, list[Mutant]], known: dict[str, Result]) -> int:
    """Print the survivors of each package, and how many mutants ended how."""
    alive = 0
    for package, mutants in drawn.items():
        verdicts = {mutant: known[mutant.key] for mutant in mutants if mutant.key in known}
        living = [mutant for mutant, result in verdicts.items() if result["verdict"] == SURVIVES]
        for mutant in sorted(living, key=lambda mutant: (mutant.file, mutant.start)):
            print(f"survives {verdicts[mutant]['tests']} tests: {mutant}")
        ways = Counter(str(result["verdict"]).partition(" ")[0] for result in verdicts.values())
        print(
            f"{package}: {len(mutants)} mutants drawn, "
            + ", ".join(f"{count} {way}" for way, count in sorted(ways.items()))
        )
        alive += len(living)
    return 1 if alive else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("stopped; the same command goes on where this one was")
