"""Rules about the source text itself: each reads a folder and says, line by line, what breaks it.

A rule returns its complaints as lines ``file:line: what is wrong; what to do``; none is a pass. The tables
of ranks and fences stand in ``test_architecture``, the rules of docstrings in ``docstring_rules``.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

FACE = "fosopt"  # the package itself: its __init__ may show anything, so nobody inside may lean on it


@dataclass(frozen=True)
class Module:
    """One parsed file under ``fosopt/``."""

    file: str
    name: str
    text: str
    tree: ast.Module

    @property
    def package(self) -> str:
        """The ranked package it belongs to: the second part of its dotted name."""
        return (*self.name.split("."), FACE)[1]

    @property
    def parent(self) -> list[str]:
        """The parts of the package that a single leading dot means here."""
        parts = self.name.split(".")
        return parts if self.file.endswith("__init__.py") else parts[:-1]


def read_modules(root: Path) -> list[Module]:
    """Every module of ``root/fosopt``, parsed."""
    modules = []
    for path in sorted((root / FACE).rglob("*.py")):
        relative = path.relative_to(root)
        text = path.read_text(encoding="utf-8")
        name = ".".join(relative.with_suffix("").parts).removesuffix(".__init__")
        modules.append(Module(relative.as_posix(), name, text, ast.parse(text, relative.as_posix())))
    return modules


def imports(module: Module) -> Iterator[tuple[int, str]]:
    """Line and dotted name of everything a module imports, also inside functions and by import_module."""
    for node in ast.walk(module.tree):
        match node:
            case ast.Import(names=names):
                yield from ((node.lineno, alias.name) for alias in names)
            case ast.ImportFrom(module=base, names=names, level=level):
                start = module.parent[: len(module.parent) - level + 1] if level else []
                prefix = ".".join([*start, *([base] if base else [])])
                yield from ((node.lineno, f"{prefix}.{alias.name}") for alias in names)
            case ast.Call(
                func=ast.Name(id="import_module" | "__import__") | ast.Attribute(attr="import_module"),
                args=[ast.Constant(value=str(target)), *_],
            ):
                yield (node.lineno, target)


def wrong_layers(
    modules: Iterable[Module], ranks: Mapping[str, int], open_to_all: Collection[str]
) -> list[str]:
    """Imports that do not point to a lower rank, packages without a rank, and circles of packages."""
    complaints, edges = [], {}
    for module in modules:
        source = module.package
        if source == FACE:
            continue
        if source not in ranks:
            complaints.append(f"{module.file}:1: '{source}' has no rank; give it one")
            continue
        for line, target in imports(module):
            head, *rest = target.split(".")
            if head != FACE or (rest and (rest[0] == source or rest[0].startswith("__"))):
                continue
            goal = rest[0] if rest else FACE
            edges.setdefault(source, set()).add(goal)
            if goal not in ranks:
                complaints.append(f"{module.file}:{line}: {target} is no ranked package; name the module")
            elif goal not in open_to_all and ranks[goal] >= ranks[source]:
                complaints.append(
                    f"{module.file}:{line}: {source} (rank {ranks[source]}) imports "
                    f"{goal} (rank {ranks[goal]}); imports point down"
                )
    try:
        TopologicalSorter(edges).prepare()
    except CycleError as error:
        complaints.append(f"circle of packages: {' -> '.join(error.args[1])}; break it")
    return complaints


def broken_fences(modules: Iterable[Module], libraries: Mapping[str, Collection[str] | None]) -> list[str]:
    """Imports of a library outside the packages its fence names (None: anywhere), or of an unlisted one."""
    complaints = []
    for module in modules:
        for line, target in imports(module):
            library = target.split(".")[0]
            if library == FACE or library in sys.stdlib_module_names:
                continue
            if library not in libraries:
                complaints.append(f"{module.file}:{line}: {library} is no run-time dependency; do without it")
                continue
            fence = libraries[library]
            if fence is not None and module.package not in fence:
                complaints.append(
                    f"{module.file}:{line}: {module.package} imports {library}; "
                    f"only {', '.join(sorted(fence))} may"
                )
    return complaints


def too_long(modules: Iterable[Module], limit: int) -> list[str]:
    """Files of more lines than one room should have."""
    counts = ((module.file, len(module.text.splitlines())) for module in modules)
    return [f"{file}:{n}: more than {limit} lines; split it" for file, n in counts if n > limit]


# A letter in brackets keeps these patterns from finding themselves.
_LEAKS = {
    "a path of one machine": re.compile(
        r"(?<![\w.])/(?:far[m]|hom[e]|roo[t]|tm[p]|User[s]|wor[k])/|\b[A-Z]:\\+User[s]\b"
    ),
    "the address of a package index": re.compile(
        r"https?://[^\s\"']*/\+?(?:simple|packages)(?:/|[\s\"')]|$)|\binde[x]-url\b|\bfind-link[s]\b",
        re.MULTILINE,
    ),
}


def leaks(root: Path, files: Iterable[str]) -> list[str]:
    """Lines of text files that only make sense on one machine."""
    complaints = []
    for file in files:
        content = (root / file).read_bytes()
        if b"\0" in content:
            continue
        text = content.decode("utf-8", errors="replace")
        for what, pattern in _LEAKS.items():
            for found in pattern.finditer(text):
                line = text.count("\n", 0, found.start()) + 1
                complaints.append(f"{file}:{line}: {what}, '{found[0].strip()}'; take it out")
    return complaints


def repository_files(root: Path) -> list[str]:
    """Files that are or would be committed: known to git, or new and not ignored."""
    # The ownership check is switched off because continuous integration often checks out as another user.
    command = ["git", "-c", "safe.directory=*", "ls-files", "-z", "-co", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout
    return sorted({name for name in listed.split("\0") if name and (root / name).is_file()})


_HELP = """
import sys
sys.path.insert(0, {root!r})
before = set(sys.modules)
sys.argv = ["fosopt", "--help"]
code = 0
try:
    from fosopt.cli import main
    code = main()
except SystemExit as stop:
    code = stop.code
loaded = {{name.split(".")[0] for name in set(sys.modules) - before}}
print("exit", code or 0, *sorted(loaded & {heavy!r}), file=sys.stderr)
"""


def imported_by_help(root: Path, heavy: set[str]) -> list[str]:
    """Which of the heavy libraries ``fosopt --help`` loads, asked in a process of its own."""
    script = _HELP.format(root=str(root), heavy=heavy)
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    last = (run.stderr.splitlines() or [""])[-1].split()
    if last[:2] != ["exit", "0"]:
        return [f"fosopt --help failed: {run.stderr.strip() or run.returncode}"]
    return [f"fosopt --help imports {name}; import it where it is used" for name in last[2:]]
