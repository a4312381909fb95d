"""Arithmetic on named values: the objectives and constraints of a study file.

The text is read with the standard library's grammar and a short list of what is allowed; nothing of it is
ever run as Python. One expression serves numbers, arrays and symbols.
"""

from __future__ import annotations

import ast
import operator
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from functools import reduce
from typing import Any

from fosopt.errors import FosoptError, did_you_mean
from fosopt.units import DIMENSIONLESS, Vector, quote, times

_LONGEST = 500
_DEEPEST = 30
_LARGEST_EXPONENT = 16
_LARGEST_INDEX = 100_000

_BINARY: dict[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}
_ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "**": operator.pow,
}
FUNCTIONS = {"sqrt": "sqrt", "log": "log", "exp": "exp", "abs": "fabs", "min": "fmin", "max": "fmax"}
"""What an expression may call, and the name of it in `fosopt.ops`."""

Reference = tuple[str, int | None]
"""A name and its index, counted from one, or None."""
Namespace = Callable[[str, int | None], Any]
"""Gives the value of a name and an index."""


class ExpressionError(FosoptError, ValueError):
    """An expression that cannot be read or evaluated."""


@dataclass(frozen=True)
class _Node:
    """A number, a reference or an operation on other nodes."""

    kind: str
    inner: tuple[_Node, ...] = ()
    number: float = 0.0
    reference: Reference = ("", None)


@dataclass(frozen=True)
class Expression:
    """Arithmetic on named values; make one with `parse_expression`.

    Parameters
    ----------
    text
        As it was written.
    references
        The names it needs, each with its index or None.
    """

    text: str
    references: frozenset[Reference]
    _tree: _Node = field(repr=False)

    def __str__(self) -> str:
        """Text as it was written."""
        return self.text

    @property
    def reference(self) -> Reference | None:
        """The name and index where the expression is nothing else."""
        return self._tree.reference if self._tree.kind == "name" else None

    def evaluate(self, namespace: Namespace) -> Any:
        """Value of the expression for the values the namespace gives.

        Raises
        ------
        ExpressionError
            Where plain numbers divide by zero, overflow or leave the real numbers.
        """
        try:
            value = _evaluate(self._tree, namespace)
        except ArithmeticError as error:
            raise ExpressionError(
                f"{quote(self.text)} has no value: {error}; change the expression"
            ) from error
        if isinstance(value, complex):
            raise ExpressionError(f"{quote(self.text)} is a root of a negative number; change the expression")
        return value

    def dimension(self, lookup: Callable[[str], Vector]) -> Vector | None:
        """Exponents of the value's unit; None where a plain number may carry any unit.

        Raises
        ------
        ExpressionError
            Where values of different dimensions are added or compared.
        """
        return _dimension(self._tree, lookup)


def parse_expression(text: str) -> Expression:
    """Read an expression such as ``structural_mass + 2 * natural_frequency[1] ** 2``.

    Raises
    ------
    ExpressionError
        For text that is too long, nested too deeply, or uses anything but numbers, names, ``name[k]``,
        ``+ - * / **``, parentheses and the functions in `FUNCTIONS`.
    """
    if not isinstance(text, str):
        raise ExpressionError(f"{quote(text)} is no expression; give text such as structural_mass")
    if len(text) > _LONGEST:
        raise ExpressionError(f"the expression has {len(text)} characters; at most {_LONGEST} are read")
    if not text.isascii() or not text.isprintable():
        column = next(k for k, c in enumerate(text, 1) if not (c.isascii() and c.isprintable()))
        raise ExpressionError(f"column {column}: {text[column - 1]!r} is not allowed; use ASCII on one line")
    stripped = text.strip()
    if not stripped:
        raise ExpressionError("the expression is empty; give the name of a metric such as structural_mass")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the parser warns of text that is refused below
            body = ast.parse(stripped, mode="eval").body
    except SyntaxError as error:
        column = error.offset or len(stripped) + 1
        message = f"column {column}: {quote(text)} is no arithmetic; check operators and parentheses"
        raise ExpressionError(message) from None
    except (ValueError, MemoryError, RecursionError):
        raise ExpressionError(f"{quote(text)} is nested too deeply; simplify it") from None
    tree = _Reader(stripped).node(body, 0)
    return Expression(stripped, frozenset(_references(tree)), tree)


class _Reader:
    """Turns Python's syntax tree into nodes and refuses all that is not listed."""

    def __init__(self, text: str) -> None:
        self.text = text

    def refuse(self, node: ast.expr, rule: str) -> ExpressionError:
        piece = ast.get_source_segment(self.text, node) or self.text
        return ExpressionError(f"column {node.col_offset + 1}: {quote(piece)} {rule}")

    def node(self, node: ast.expr, depth: int) -> _Node:
        if depth > _DEEPEST:
            raise self.refuse(node, f"is nested more than {_DEEPEST} deep; simplify the expression")
        match node:
            case ast.Constant(value=value):
                return _Node("number", number=self.number(node, value))
            case ast.Name(id=name):
                return _Node("name", reference=(name, None))
            case ast.Subscript(value=ast.Name(id=name), slice=index):
                return _Node("name", reference=(name, self.index(index)))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return _Node("neg", (self.node(operand, depth + 1),))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                inner = (self.node(left, depth + 1), self.node(right, depth + 1))
                if isinstance(op, ast.Pow):
                    self.exponent(right, inner[1])
                return _Node(_BINARY[type(op)], inner)
            case ast.BinOp(op=ast.BitXor()):
                raise self.refuse(node, "uses '^'; write a power as **")
            case ast.Call(func=ast.Name(id=name)):
                return self.call(node, name, depth)
        known = ", ".join(FUNCTIONS)
        raise self.refuse(node, f"is not allowed; use numbers, names, name[k], + - * / ** and {known}")

    def call(self, node: ast.Call, name: str, depth: int) -> _Node:
        if name not in FUNCTIONS:
            raise self.refuse(node, f"calls an unknown function; {did_you_mean(name, FUNCTIONS)}")
        several = name in ("min", "max")
        if node.keywords or (len(node.args) < 2 if several else len(node.args) != 1):
            raise self.refuse(
                node, f"is no proper call; {name} takes {'two or more values' if several else 'one value'}"
            )
        return _Node(name, tuple(self.node(argument, depth + 1) for argument in node.args))

    def number(self, node: ast.expr, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refuse(node, "is no number; use numbers and names")
        try:
            number = float(value)
        except OverflowError:
            number = float("inf")
        if number == float("inf"):
            raise self.refuse(node, "is too large; use a number below 1e308")
        return number

    def index(self, node: ast.expr) -> int:
        value = node.value if isinstance(node, ast.Constant) else None
        if type(value) is not int or not 1 <= value <= _LARGEST_INDEX:
            raise self.refuse(node, "is no index; use a whole number counted from 1")
        return value

    def exponent(self, node: ast.expr, exponent: _Node) -> None:
        inner = exponent.inner[0] if exponent.kind == "neg" else exponent
        if inner.kind != "number":
            raise self.refuse(node, "is no number; an exponent is a plain number")
        if inner.number > _LARGEST_EXPONENT:
            raise self.refuse(node, f"is too large an exponent; use at most {_LARGEST_EXPONENT}")


def _references(node: _Node) -> set[Reference]:
    found = {node.reference} if node.kind == "name" else set()
    return found.union(*(_references(inner) for inner in node.inner))


def _evaluate(node: _Node, namespace: Namespace) -> Any:
    if node.kind == "number":
        return node.number
    if node.kind == "name":
        return namespace(*node.reference)
    values = [_evaluate(inner, namespace) for inner in node.inner]
    if node.kind == "neg":
        return -values[0]
    if node.kind in _ARITHMETIC:
        return _ARITHMETIC[node.kind](*values)
    from fosopt import ops  # CasADi takes a quarter of a second to load, and reading a file does not need it

    function = getattr(ops, FUNCTIONS[node.kind])
    return reduce(function, values) if len(values) > 1 else function(values[0])


def _dimension(node: _Node, lookup: Callable[[str], Vector]) -> Vector | None:
    if node.kind == "number":
        return None
    if node.kind == "name":
        return lookup(node.reference[0])
    inner = [_dimension(each, lookup) for each in node.inner]
    first = inner[0]
    if node.kind in ("log", "exp"):
        return DIMENSIONLESS
    if node.kind == "sqrt":
        return None if first is None else times(DIMENSIONLESS, first, Fraction(1, 2))
    if node.kind == "**":
        exponent = node.inner[1]
        number = -exponent.inner[0].number if exponent.kind == "neg" else exponent.number
        return None if first is None else times(DIMENSIONLESS, first, Fraction(number))
    if node.kind in ("*", "/"):
        second = inner[1]
        return (
            None if first is None or second is None else times(first, second, 1 if node.kind == "*" else -1)
        )
    known = {each for each in inner if each is not None}
    if len(known) > 1:
        raise ExpressionError(
            f"'{node.kind}' joins values of different units; multiply one by a weighting number"
        )
    return None if len(known) == 0 or None in inner else known.pop()
