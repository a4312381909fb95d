"""Rules about docstrings and citations, in the manner of ``source_rules``."""

from __future__ import annotations

import ast
import builtins
import inspect
import io
import re
import tokenize
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from source_rules import Module

_FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)
_DOCUMENTED = (ast.Module, ast.ClassDef, *_FUNCTION)
# A docstring of these would repeat the one of what they overload, override or set.
_EXEMPT = {"overload", "override", "setter"}

# In the order numpydoc gives them.
_SECTIONS = (
    "Parameters",
    "Attributes",
    "Methods",
    "Returns",
    "Yields",
    "Other Parameters",
    "Raises",
    "Warns",
    "See Also",
    "Notes",
    "References",
    "Examples",
)
_OTHER_STYLE = re.compile(r"(Args|Arguments|Returns|Yields|Raises|Examples?):$|:(param|returns?|raises)\b")
_CITATION = re.compile(r"\[([A-Z][A-Za-z]+\d{4}[a-z]?(?:, *[A-Z][A-Za-z]+\d{4}[a-z]?)*)\]")
_ENTRY = re.compile(r"^@\w+\{\s*([^\s,]+)\s*,(.*?)^\}", re.DOTALL | re.MULTILINE)
_FIELD = re.compile(r"^\s*(\w+)\s*=\s*\{(.*)\},?$", re.MULTILINE)


def _last_name(node: ast.expr) -> str:
    return ast.unparse(node).split("(")[0].split(".")[-1]


def _public(body: Sequence[ast.stmt], owner: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Public functions and classes of a body, with the public methods of its public classes."""
    for node in body:
        if not isinstance(node, (ast.ClassDef, *_FUNCTION)) or node.name.startswith("_"):
            continue
        if _EXEMPT.isdisjoint(_last_name(decorator) for decorator in node.decorator_list):
            yield owner + node.name, node
        if isinstance(node, ast.ClassDef):
            yield from _public(node.body, f"{owner}{node.name}.")


def missing_docstrings(modules: Iterable[Module]) -> list[str]:
    """Modules, and public functions, classes and methods, that do not say what they are."""
    complaints = []
    for module in modules:
        for name, node in [(module.name, module.tree), *_public(module.tree.body)]:
            if not ast.get_docstring(node):
                line = getattr(node, "lineno", 1)
                complaints.append(f"{module.file}:{line}: {name} has no docstring; say what it is")
    return complaints


@dataclass(frozen=True)
class Docstring:
    """One docstring, with the node that bears it."""

    node: ast.AST
    where: str
    line: int
    lines: list[str]


def _docstrings(module: Module) -> Iterator[Docstring]:
    for node in ast.walk(module.tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node):
            line = node.body[0].lineno
            text = inspect.cleandoc(node.body[0].value.value)
            yield Docstring(node, f"{module.file}:{line}", line, text.splitlines())


def _titles(lines: list[str]) -> list[int]:
    """Indices of lines that a rule of dashes underlines."""
    return [i for i, below in enumerate(lines[1:]) if lines[i] and re.fullmatch("-{3,}", below)]


def _misformed(lines: list[str]) -> Iterator[str]:
    """What is wrong with the sections themselves."""
    starts = _titles(lines)
    titles = [lines[i] for i in starts]
    for i, line in enumerate(lines):
        if line in _SECTIONS and i not in starts:
            yield f"'{line}' is not underlined; underline it"
        elif _OTHER_STYLE.match(line.strip()):
            yield f"'{line.strip()}' is not numpydoc; write a section"
    for start, end in pairwise([*starts, len(lines)]):
        title = lines[start]
        if title not in _SECTIONS:
            yield f"'{title}' is no section of numpydoc; use one of {', '.join(_SECTIONS)}"
        elif len(lines[start + 1]) != len(title):
            yield f"'{title}' and its underline differ in length; make them equal"
        if not any(lines[start + 2 : end]):
            yield f"'{title}' is empty; fill it or drop it"
    if len(set(titles)) < len(titles):
        yield "a section stands twice; merge the two"
    known = [title for title in titles if title in _SECTIONS]
    if known != sorted(known, key=_SECTIONS.index):
        yield f"sections stand as {', '.join(known)}; numpydoc has them as {', '.join(_SECTIONS)}"


def _entries(lines: list[str], title: str) -> Iterator[tuple[str, bool]]:
    """Head of each entry of a section, and whether an indented description follows it."""
    starts = _titles(lines)
    for start, end in pairwise([*starts, len(lines)]):
        body = [line for line in lines[start + 2 : end] if line] if lines[start] == title else []
        for i, line in enumerate(body):
            if not line.startswith(" "):
                yield line, body[i + 1 : i + 2] != [] and body[i + 1].startswith(" ")


def _arguments(node: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    given = node.args
    named = [*given.posonlyargs, *given.args, *given.kwonlyargs]
    return {argument.arg for argument in [*named, given.vararg, given.kwarg] if argument}


def _fields(name: str, classes: dict[str, ast.ClassDef]) -> set[str]:
    """What a class can be built from: its own annotated names and ``__init__``, and those of its bases."""
    if name not in classes:
        return set()
    node = classes[name]
    found = {
        s.target.id for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)
    }
    for statement in node.body:
        if isinstance(statement, _FUNCTION) and statement.name == "__init__":
            found |= _arguments(statement)
    return found.union(*(_fields(_last_name(base), classes) for base in node.bases))


def malformed_docstrings(modules: Iterable[Module]) -> list[str]:
    """Sections that break numpydoc, document a parameter that is not there or raise what does not exist."""
    modules = list(modules)
    classes = {n.name: n for m in modules for n in ast.walk(m.tree) if isinstance(n, ast.ClassDef)}
    complaints = []
    for doc in (doc for module in modules for doc in _docstrings(module)):
        wrong = list(_misformed(doc.lines))
        for head, described in _entries(doc.lines, "Raises"):
            if "." not in head and head not in classes and not hasattr(builtins, head):
                wrong.append(f"'{head}' in Raises is no exception; name one")
            if not described:
                wrong.append(f"'{head}' in Raises is not described; say when it is raised")
        if not isinstance(doc.node, ast.Module):
            is_class = isinstance(doc.node, ast.ClassDef)
            known = _fields(doc.node.name, classes) if is_class else _arguments(doc.node)
            for head, _ in _entries(doc.lines, "Parameters"):
                names = {name.strip().lstrip("*") for name in head.split(" :")[0].split(",")}
                wrong += [f"'{name}' is no parameter; drop it" for name in sorted(names - known)]
        complaints += [f"{doc.where}: {what}" for what in wrong]
    return complaints


def _commentary(module: Module) -> Iterator[tuple[int, str]]:
    """Line and text of every docstring line and comment."""
    for doc in _docstrings(module):
        yield from enumerate(doc.lines, doc.line)
    for token in tokenize.generate_tokens(io.StringIO(module.text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def bibliography(text: str) -> dict[str, dict[str, str]]:
    """Fields by key of a BibTeX file whose every field is one line in braces."""
    return {key: dict(_FIELD.findall(body)) for key, body in _ENTRY.findall(text)}


def malformed_bibliography(text: str) -> list[str]:
    """Entries without author, title or year, with a key of another year, and keys used twice."""
    keys = [key for key, _ in _ENTRY.findall(text)]
    complaints = [f"{key} stands twice; drop one" for key in sorted({k for k in keys if keys.count(k) > 1})]
    if len(keys) != len(re.findall(r"^@", text, re.MULTILINE)):
        complaints.append("an entry does not end with a brace at the start of a line; mend it")
    for key, fields in bibliography(text).items():
        lacking = {"author", "title", "year"} - fields.keys()
        complaints += [f"{key} lacks {field}; add it" for field in sorted(lacking)]
        if "year" in fields and fields["year"] not in key:
            complaints.append(f"{key} is of {fields['year']}; name it so")
    return complaints


def unknown_citations(modules: Iterable[Module], keys: Collection[str]) -> list[str]:
    """Citations in docstrings and comments, written [Name1234], that the bibliography does not have."""
    return [
        f"{module.file}:{line}: [{key}] is not in the bibliography; add it there"
        for module in modules
        for line, text in _commentary(module)
        for found in _CITATION.finditer(text)
        for key in re.split(", *", found[1])
        if key not in keys
    ]
