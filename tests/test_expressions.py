"""Arithmetic on named values."""

import math
import time

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fosopt.expressions import ExpressionError, parse_expression
from fosopt.units import exponents, times

VALUES = {("mass", None): 3.0, ("jitter", None): 4.0, ("frequency", 2): 5.0}


def value_of(name, index):
    return VALUES[name, index]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("mass", 3.0),
        ("  mass  ", 3.0),
        ("-mass + 2 * jitter", 5.0),
        ("mass - jitter - 1", -2.0),
        ("mass / jitter ** 2", 3 / 16),
        ("2 ** 3 * mass", 24.0),
        ("mass ** -1", 1 / 3),
        ("mass ** 0.5", math.sqrt(3)),
        ("frequency[2] * (mass + 1e-1)", 15.5),
        ("sqrt(mass ** 2 + jitter ** 2)", 5.0),
        ("log(exp(mass))", 3.0),
        ("min(mass, jitter, 1)", 1.0),
        ("max(mass, jitter, 1)", 4.0),
        ("abs(mass - jitter)", 1.0),
    ],
)
def test_numbers_arrays_and_symbols_give_the_same_value(text, value):
    expression = parse_expression(text)
    assert expression.evaluate(value_of) == pytest.approx(value, rel=1e-15)
    array = expression.evaluate(lambda name, index: np.full(3, value_of(name, index)))
    assert array == pytest.approx(np.full(3, value), rel=1e-15)
    keys = sorted(VALUES, key=str)
    for kind in (ca.SX, ca.MX):
        symbols = {key: kind.sym(key[0]) for key in keys}
        symbolic = expression.evaluate(lambda name, index, symbols=symbols: symbols[name, index])
        function = ca.Function("f", list(symbols.values()), [symbolic])
        assert float(function(*(VALUES[key] for key in keys))) == pytest.approx(value, rel=1e-15)


def test_an_expression_knows_its_text_and_references():
    expression = parse_expression("mass + frequency[2] / frequency[1] + mass")
    assert expression.text == str(expression) == "mass + frequency[2] / frequency[1] + mass"
    assert expression.references == {("mass", None), ("frequency", 2), ("frequency", 1)}
    assert expression.reference is None
    assert parse_expression("frequency[2]").reference == ("frequency", 2)
    assert expression == parse_expression(expression.text)
    assert hash(expression) == hash(parse_expression(expression.text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("mass +", "column 7"),
        ("mass ^ 2", r"column 1: 'mass \^ 2' uses '\^'; write a power as \*\*"),
        ("1 + squrt(mass)", "column 5: 'squrt.mass.' calls an unknown function; did you mean 'sqrt'"),
        ("sqrt(mass, 2)", "takes one value"),
        ("min(mass)", "takes two or more values"),
        ("sqrt(x=mass)", "takes one value"),
        ("min(*mass, 1)", "not allowed"),
        ("frequency[0]", "column 11: 0 is no index|column 11: '0' is no index"),
        ("frequency[True]", "no index"),
        ("frequency[1:2]", "no index"),
        ("frequency[mass]", "no index"),
        ("frequency[1][2]", "not allowed"),
        ("mass.real", "not allowed"),
        ("__import__('os').system('x')", "not allowed"),
        ("mass if mass else 1", "not allowed"),
        ("lambda: 1", "not allowed"),
        ("[mass]", "not allowed"),
        ("mass < 1", "not allowed"),
        ("mass % 2", "not allowed"),
        ("(a := 1)", "not allowed"),
        ("'mass'", "no number"),
        ("1j * mass", "no number"),
        ("None", "no number"),
        ("mass ** jitter", "an exponent is a plain number"),
        ("mass ** 1000", "too large an exponent; use at most 16"),
        ("9 ** 9 ** 9 ** 9", "an exponent is a plain number"),
        ("1e999 * mass", "too large"),
        ("9" * 400, "too large"),
        ("mass\n+ 1", "column 5"),
        ("mäss", "column 2"),
        ("m\x00", "column 2"),
        ("(" * 240 + "m", "column"),
        ("-" * 400 + "m", "nested more than 30"),
        ("m" * 501, "501 characters"),
        ("sqrt(" * 40 + "m" + ")" * 40, "nested more than 30"),
        (3, "no expression"),
    ],
)
def test_what_is_no_arithmetic_is_refused(text, words):
    with pytest.raises(ExpressionError, match=words) as caught:
        parse_expression(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["1 / (mass - 3)", "1e300 ** 2 * mass", "(mass - jitter) ** 0.5", "(mass-3) ** -1"]
)
def test_plain_numbers_without_a_value_are_an_error(text):
    with pytest.raises(ExpressionError):
        parse_expression(text).evaluate(value_of)


@given(st.text(alphabet="ab12+-*/()[]., \\'\"^:=<%", max_size=60) | st.text(max_size=40))
def test_any_text_is_read_or_refused(text):
    start = time.monotonic()
    try:
        expression = parse_expression(text)
    except ExpressionError as error:
        assert str(error).isprintable()
    else:
        assert parse_expression(expression.text) == expression
    assert time.monotonic() - start < 5.0


def test_dimensions_follow_the_arithmetic():
    mass, frequency = exponents("mass"), exponents("frequency")

    def dimension(text):
        return parse_expression(text).dimension({"m": mass, "w": frequency}.__getitem__)

    assert dimension("m") == dimension("-m") == dimension("max(m, m)") == dimension("abs(m) + m") == mass
    assert dimension("m * w ** 2") == times(mass, frequency, 2)
    assert dimension("sqrt(w ** 4) / m") == times(times(frequency, frequency), mass, -1)
    assert dimension("m / m") == dimension("log(w)") == exponents("ratio")
    assert dimension("2 * m + w") is None
    assert dimension("m + 1") is None
    with pytest.raises(ExpressionError, match="weighting number"):
        dimension("m + w")
    with pytest.raises(ExpressionError, match="weighting number"):
        dimension("min(m, w)")
