"""Quantities with units: text in, SI floats out, and the units numbers are shown in.

A frequency in hertz becomes rad/s; a density or a PSD stays per ordinary hertz, so that
``1 urad/sqrt(Hz)`` is 1e-6 rad/sqrt(Hz). The angle is a dimension of its own: a torque (N m) is no
rotational stiffness (N m/rad).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cache

from fosopt.errors import FosoptError, printable

HZ = 2 * math.pi
"""One hertz [rad/s]."""
MM2 = 1e-6
"""One square millimeter [m²]."""
URAD = 1e-6
"""One microradian [rad]."""
PERCENT = 1e-2
"""One percent [-]."""

Vector = tuple[Fraction, Fraction, Fraction, Fraction, Fraction]
"""Exponents of meter, kilogram, second, radian and hertz."""

_PI = Decimal("3.14159265358979323846264338327950288419716939937510")
_DIGITS = 50
_LONGEST = 100
_LARGEST_POWER = 9


class QuantityError(FosoptError, ValueError):
    """A quantity that is no number, has an unknown unit or has the wrong dimension."""


@dataclass(frozen=True)
class Dimension:
    """A kind of quantity: its SI unit, the unit it is shown in, and both units as ends of a column name."""

    unit: str
    shown: str
    column: str
    example: str
    column_unit: str | None = None


DIMENSIONS: dict[str, Dimension] = {
    "length": Dimension("m", "m", "m", "0.354 m or 22 mm"),
    "area": Dimension("m^2", "mm^2", "m2", "66 mm^2"),
    "mass": Dimension("kg", "kg", "kg", "2.5 kg or 120 g"),
    "mass_per_length": Dimension("kg/m", "kg/m", "kg_per_m", "15 kg/m"),
    "inertia": Dimension("kg m^2", "kg m^2", "kg_m2", "0.4 kg m^2"),
    "frequency": Dimension("rad/s", "Hz", "hz", "230 Hz or 1445 rad/s", "Hz"),
    "decay": Dimension("rad/s", "rad/s", "rad_per_s", "-0.1 rad/s"),
    "rate": Dimension("1/s", "1/s", "per_s", "600 1/s"),
    "rate_squared": Dimension("1/s^2", "1/s^2", "per_s2", "50000 1/s^2"),
    "time": Dimension("s", "s", "s", "50 ms"),
    "angle": Dimension("rad", "urad", "rad", "1 urad or 0.2 arcsec"),
    "ratio": Dimension("1", "", "", "0.7 or 0.02 %"),
    "force": Dimension("N", "N", "n", "2.5 kN"),
    "torque": Dimension("N m", "N m", "n_m", "0.02 N m"),
    "stiffness": Dimension("N/m", "N/m", "n_per_m", "1.6e7 N/m"),
    "rotational_stiffness": Dimension("N m/rad", "N m/rad", "n_m_per_rad", "6000 N m/rad"),
    "bending_stiffness": Dimension("N m^2", "N m^2", "n_m2", "2.9e5 N m^2"),
    "damper": Dimension("N s/m", "N s/m", "n_s_per_m", "50 N s/m"),
    "control_gain": Dimension("N m s/rad", "N m s/rad", "n_m_s_per_rad", "1300 N m s/rad"),
    "rotational_damper": Dimension("N m s/rad", "N m s/rad", "n_m_s_per_rad", "2 N m s/rad"),
    "pressure": Dimension("Pa", "GPa", "pa", "70 GPa"),
    "density": Dimension("kg/m^3", "kg/m^3", "kg_per_m3", "7.8 g/cm^3"),
    "torque_density": Dimension("N m/sqrt(Hz)", "N m/sqrt(Hz)", "n_m_per_rthz", "1e-3 N m/sqrt(Hz)"),
    "angle_density": Dimension("rad/sqrt(Hz)", "urad/sqrt(Hz)", "rad_per_rthz", "1 urad/sqrt(Hz)"),
    "torque_psd": Dimension("(N m)^2/Hz", "(N m)^2/Hz", "n2_m2_per_hz", "1e-6 (N m)^2/Hz"),
    "angle_psd": Dimension("rad^2/Hz", "urad^2/Hz", "rad2_per_hz", "1e-12 rad^2/Hz"),
    "angular_rate": Dimension("rad/s", "rad/s", "rad_per_s", "0.2 rad/s"),
    "integral_gain": Dimension("N m/(rad s)", "N m/(rad s)", "n_m_per_rad_s", "2e8 N m/(rad s)"),
}


def _vector(m: int = 0, kg: int = 0, s: int = 0, rad: int = 0, hz: int = 0) -> Vector:
    return Fraction(m), Fraction(kg), Fraction(s), Fraction(rad), Fraction(hz)


DIMENSIONLESS = _vector()


def times(left: Vector, right: Vector, power: Fraction | int = 1) -> Vector:
    """Exponents of ``left`` times ``right`` to a power."""
    m, kg, s, rad, hz = (a + power * b for a, b in zip(left, right, strict=True))
    return m, kg, s, rad, hz


def _with_prefixes() -> dict[str, tuple[Decimal, Vector]]:
    """Every unit symbol that is understood, with its size in SI units (hertz left as it is)."""
    force, energy, pressure = _vector(1, 1, -2), _vector(2, 1, -2), _vector(-1, 1, -2)
    scales = {
        "p": -12,
        "n": -9,
        "u": -6,
        "µ": -6,
        "m": -3,
        "": 0,
        "k": 3,
        "M": 6,
        "G": 9,
    }  # the micro sign; the Greek mu is mapped to it
    prefixed = {
        "m": ("pnuµmk", Decimal(1), _vector(m=1)),
        "g": ("nuµmkM", Decimal("1e-3"), _vector(kg=1)),
        "s": ("nuµm", Decimal(1), _vector(s=1)),
        "rad": ("pnuµm", Decimal(1), _vector(rad=1)),
        "Hz": ("umµkMG", Decimal(1), _vector(hz=1)),
        "N": ("nuµmkMG", Decimal(1), force),
        "Nm": ("nuµmkM", Decimal(1), energy),
        "Pa": ("mkMG", Decimal(1), pressure),
    }
    units = {
        "%": (Decimal("1e-2"), DIMENSIONLESS),
        "cm": (Decimal("1e-2"), _vector(m=1)),
        "in": (Decimal("0.0254"), _vector(m=1)),
        "ft": (Decimal("0.3048"), _vector(m=1)),
        "lb": (Decimal("0.45359237"), _vector(kg=1)),
        "lbf": (Decimal("4.4482216152605"), force),
        "t": (Decimal(1000), _vector(kg=1)),
        "min": (Decimal(60), _vector(s=1)),
        "deg": (_PI / 180, _vector(rad=1)),
        "arcmin": (_PI / 10800, _vector(rad=1)),
        "arcsec": (_PI / 648000, _vector(rad=1)),
        "rpm": (1 / Decimal(60), _vector(hz=1)),
    }
    for symbol, (prefixes, size, vector) in prefixed.items():
        for prefix in ("", *prefixes):
            units[prefix + symbol] = (size.scaleb(scales[prefix]), vector)
    return units


with localcontext() as _context:
    _context.prec = _DIGITS
    UNITS = _with_prefixes()

_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)\s*(.*)", re.ASCII | re.DOTALL)
_TOKEN = re.compile(r"\s*(sqrt\s*\(|[A-Za-zµ%]+|[()*/^]|[+-]?\d+)", re.ASCII)


class _UnitText:
    """One reading of a compound unit, from left to right."""

    def __init__(self, text: str) -> None:
        self.tokens: list[str] = []
        text = text.replace("²", "^2").replace("³", "^3").replace("·", "*").replace("\u03bc", "µ").strip()
        end = 0
        while end < len(text):
            match = _TOKEN.match(text, end)
            if match is None:
                raise QuantityError(f"{quote(text[end:].strip())} is no unit")
            self.tokens.append(match[1].replace(" ", ""))
            end = match.end()
        self.at = 0

    def peek(self) -> str:
        return self.tokens[self.at] if self.at < len(self.tokens) else ""

    def take(self) -> str:
        token = self.peek()
        self.at += 1
        return token

    def whole(self) -> tuple[Decimal, Vector]:
        unit = self.product()
        if self.peek():
            raise QuantityError(f"'{self.peek()}' is not expected in a unit")
        return unit

    def product(self) -> tuple[Decimal, Vector]:
        size, vector = self.factor()
        divided = False
        while self.peek() not in ("", ")"):
            sign = 1
            if self.peek() == "/":
                self.take()
                sign, divided = -1, True
            elif divided:
                raise QuantityError("a product after '/' is ambiguous; put it in parentheses")
            elif self.peek() == "*":
                self.take()
            other, exponents = self.factor()
            size, vector = size * other**sign, times(vector, exponents, sign)
        return size, vector

    def factor(self) -> tuple[Decimal, Vector]:
        token = self.take()
        if token in ("(", "sqrt("):
            size, vector = self.product()
            if self.take() != ")":
                raise QuantityError("a ')' is missing in the unit")
            if token == "sqrt(":
                size, vector = size.sqrt(), times(DIMENSIONLESS, vector, Fraction(1, 2))
        elif token == "1":
            size, vector = Decimal(1), DIMENSIONLESS
        elif token in UNITS:
            size, vector = UNITS[token]
        elif not token:
            raise QuantityError("the unit ends too early")
        else:
            raise QuantityError(f"unknown unit '{token}'")
        if self.peek() == "^":
            self.take()
            power = self.take()
            if not re.fullmatch(r"[+-]?\d", power, re.ASCII):
                raise QuantityError(f"the power '{power}' is no whole number of at most {_LARGEST_POWER}")
            size, vector = size ** int(power), times(DIMENSIONLESS, vector, int(power))
        return size, vector


@cache
def parse_unit(text: str) -> tuple[Decimal, Vector]:
    """Size in SI units (hertz stays hertz) and exponents of a compound unit such as ``N m/rad``.

    Raises
    ------
    QuantityError
        For an unknown symbol, an ambiguous product after a slash, or text that is no unit.
    """
    if len(text) > _LONGEST:
        raise QuantityError(f"a unit of {len(text)} characters; at most {_LONGEST} are read")
    with localcontext() as context:
        context.prec = _DIGITS
        return _UnitText(text).whole()


@cache
def exponents(dimension: str) -> Vector:
    """Exponents of a named dimension."""
    return parse_unit(DIMENSIONS[dimension].unit)[1]


def dimension_name(vector: Vector) -> str | None:
    """The first named dimension with these exponents, if there is one."""
    return next((name for name in DIMENSIONS if exponents(name) == vector), None)


def noun(dimension: str) -> str:
    """The dimension with its article, such as ``an area``."""
    return f"{'an' if dimension[0] in 'aeiou' else 'a'} {dimension.replace('_', ' ')}"


def quote(value: object) -> str:
    """A value as a message shows it: short, on one line."""
    text = "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
    text = printable(" ".join(text.split()))
    text = text if len(text) <= 40 else text[:37] + "..."
    return f"'{text}'" if isinstance(value, str) else text


def _unit_text(vector: Vector) -> str:
    powers = [(s, p) for s, p in zip(("m", "kg", "s", "rad", "Hz"), vector, strict=True) if p]
    return " ".join(symbol if power == 1 else f"{symbol}^{power}" for symbol, power in powers) or "1"


def parse_quantity(value: object, dimension: str | Vector | None) -> float:
    """A quantity in SI units: rad/s for frequencies, per hertz for densities and PSDs.

    A bare number, also in quotes, is SI already.

    Parameters
    ----------
    value
        A number, or text such as ``"66 mm^2"``.
    dimension
        A name of `DIMENSIONS`, or exponents, or None where any unit is right.

    Raises
    ------
    QuantityError
        For a value that is no finite number, an unknown unit, or another dimension.
    """
    name = dimension_name(dimension) if isinstance(dimension, tuple) else dimension
    if name is not None:
        way_out = f"give {noun(name)} such as {DIMENSIONS[name].example}"
    elif isinstance(dimension, tuple):
        way_out = f"give a quantity in {_unit_text(dimension)}, or a bare SI number"
    else:
        way_out = "give a quantity such as 66 mm^2, or a bare SI number"
    if isinstance(value, str):
        number = _from_text(value, dimension, way_out)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
    else:
        raise QuantityError(f"{quote(value)} is no quantity; {way_out}")
    if not math.isfinite(number):
        raise QuantityError(f"{quote(value)} is not finite; {way_out}")
    return number


def _from_text(text: str, dimension: str | Vector | None, way_out: str) -> float:
    match = _QUANTITY.fullmatch(text.strip()) if len(text) <= _LONGEST else None
    if match is None:
        raise QuantityError(f"{quote(text)} is no number with a unit; {way_out}")
    number, unit = match.groups()
    if not unit:
        return float(number)
    try:
        size, vector = parse_unit(unit)
    except QuantityError as error:
        raise QuantityError(f"{quote(text)}: {error}; {way_out}") from None
    wanted = exponents(dimension) if isinstance(dimension, str) else dimension
    with localcontext() as context:
        context.prec = _DIGITS
        hertz = vector[-1]
        if hertz and (wanted is None or not wanted[-1]):
            size *= (
                (2 * _PI) ** Decimal(hertz.numerator)
                if hertz.denominator == 1
                else (2 * _PI).sqrt() ** int(2 * hertz)
            )
            vector = times(vector, _vector(s=-1, rad=1, hz=-1), hertz)
        if wanted is not None and vector != wanted:
            raise QuantityError(f"{quote(text)} has the wrong dimension; {way_out}")
        return float(Decimal(number) * size)


def display(dimension: str) -> tuple[float, str]:
    """Factor from SI and name of the unit people read: Hz, mm^2, urad."""
    return _factor(dimension, DIMENSIONS[dimension].shown), DIMENSIONS[dimension].shown


def column(dimension: str) -> tuple[float, str]:
    """Factor from SI and end of a column's name: SI, but for a frequency in hertz."""
    kind = DIMENSIONS[dimension]
    return _factor(dimension, kind.column_unit or kind.unit), kind.column


@cache
def _factor(dimension: str, unit: str) -> float:
    size, vector = parse_unit(unit or "1")
    with localcontext() as context:
        context.prec = _DIGITS
        if vector[-1] and not exponents(dimension)[-1]:
            size *= 2 * _PI
        return float(1 / size)


def show(value: float, dimension: str) -> str:
    """A number with the unit people read, such as ``230 Hz``."""
    factor, unit = display(dimension)
    return f"{value * factor:.6g} {unit}".rstrip()
