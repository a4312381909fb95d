"""Quantities with units."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fosopt import units
from fosopt.errors import FosoptError
from fosopt.units import DIMENSIONS, QuantityError, parse_quantity


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("66 mm^2", "area", 66e-6),
        ("66mm²", "area", 66e-6),
        ("6.6e-5", "area", 6.6e-5),
        ("0.66 cm^2", "area", 66e-6),
        ("0.02 %", "ratio", 2e-4),
        ("1 urad", "angle", 1e-6),
        ("1 µrad", "angle", 1e-6),
        ("1 \u03bcrad", "angle", 1e-6),
        ("180 deg", "angle", math.pi),
        ("3600 arcsec", "angle", math.pi / 180),
        ("50 ms", "time", 0.05),
        ("2 min", "time", 120.0),
        ("2.5e-3 kg m^2", "inertia", 2.5e-3),
        ("2.5 kg*mm^2", "inertia", 2.5e-6),
        ("2.5 g·m²", "inertia", 2.5e-3),
        ("6000 N m/rad", "rotational_stiffness", 6000.0),
        ("6 kN m/rad", "rotational_stiffness", 6000.0),
        ("20 mNm", "torque", 0.02),
        ("0.02 N m", "torque", 0.02),
        ("7.8 g/cm^3", "density", 7800.0),
        ("70 GPa", "pressure", 70e9),
        ("70 kN/mm^2", "pressure", 70e9),
        ("1 urad/sqrt(Hz)", "angle_density", 1e-6),
        ("1 urad / sqrt( Hz )", "angle_density", 1e-6),
        ("1 mNm/sqrt(kHz)", "torque_density", 1e-3 / math.sqrt(1000)),
        ("1e-12 rad^2/Hz", "angle_psd", 1e-12),
        ("1 urad^2/Hz", "angle_psd", 1e-12),
        ("4 (mN m)^2/kHz", "torque_psd", 4e-9),
        ("600 1/s", "rate", 600.0),
        ("5 1/s/s", "rate_squared", 5.0),
        ("5 s^-2", "rate_squared", 5.0),
        ("1300 N m s/rad", "control_gain", 1300.0),
        ("230 Hz", "frequency", 2 * math.pi * 230),
        ("0.23 kHz", "frequency", 2 * math.pi * 230),
        ("60 rpm", "frequency", 2 * math.pi),
        ("1 rad/s", "frequency", 1.0),
        ("7.5", "frequency", 7.5),
        (7, "frequency", 7.0),
    ],
)
def test_a_quantity_with_a_unit_is_its_si_value(text, dimension, value):
    assert parse_quantity(text, dimension) == pytest.approx(value, rel=4e-16)


@pytest.mark.parametrize(
    ("text", "dimension"),
    [
        ("20 Hz", "area"),
        ("1 N m", "rotational_stiffness"),
        ("1 N m/rad", "torque"),
        ("1 rad", "ratio"),
        ("1 urad", "angle_density"),
        ("1 rad/sqrt(rad/s)", "angle_density"),
    ],
)
def test_a_wrong_dimension_is_refused_with_an_example(text, dimension):
    with pytest.raises(QuantityError, match=r"wrong dimension; give an? .* such as") as caught:
        parse_quantity(text, dimension)
    assert DIMENSIONS[dimension].example in str(caught.value)
    assert repr(text) in str(caught.value)


@pytest.mark.parametrize(
    "value",
    [
        *(
            "",
            "mm^2",
            "1 mmm^2",
            "nan",
            "inf",
            "1e999",
            "1 mm^",
            "1 mm^2.5",
            "1 mm^99",
            "1 (mm",
            "1 mm)",
            "1 /s",
        ),
        *("1 N/m kg", "1 J$", "1_0 m", "\u0661 m", "1 sqrt()", "1 2", "(" * 99, "1 mm^2 \x1b[31m"),
        *(True, None, [1], float("nan"), float("-inf"), 10**400),
    ],
)
def test_what_is_no_quantity_is_refused(value):
    with pytest.raises(QuantityError) as caught:
        parse_quantity(value, "area")
    assert isinstance(caught.value, FosoptError)
    assert isinstance(caught.value, ValueError)
    assert str(caught.value).isprintable()
    assert "66 mm^2" in str(caught.value)


def test_a_product_below_a_slash_is_called_ambiguous():
    with pytest.raises(QuantityError, match="ambiguous; put it in parentheses"):
        parse_quantity("1 N/m rad", "stiffness")
    assert parse_quantity("1 N m/(rad s)", None) == 1.0


def test_a_dimension_may_be_given_by_its_exponents_or_left_open():
    mass_for_a_time = units.times(units.exponents("mass"), units.exponents("time"))
    assert parse_quantity("3 g s", mass_for_a_time) == 3e-3
    with pytest.raises(QuantityError, match=r"in kg s,"):
        parse_quantity("3 g", mass_for_a_time)
    assert parse_quantity("1 Hz", None) == pytest.approx(2 * math.pi, rel=1e-15)
    root = units.times(units.DIMENSIONLESS, units.exponents("frequency"), Fraction(1, 2))
    assert parse_quantity("1 sqrt(Hz)", root) == pytest.approx(math.sqrt(2 * math.pi), rel=1e-15)


@given(st.floats(min_value=1e-12, max_value=1e12), st.sampled_from(sorted(DIMENSIONS)))
def test_what_is_displayed_reads_back(value, dimension):
    factor, unit = units.display(dimension)
    assert parse_quantity(f"{value * factor!r} {unit}", dimension) == pytest.approx(value, rel=1e-14)


@given(st.text(max_size=30))
def test_any_text_is_a_finite_number_or_an_error_of_one_line(text):
    try:
        assert math.isfinite(parse_quantity(text, None))
    except QuantityError as error:
        assert str(error).isprintable()


def test_columns_are_si_but_frequencies_are_in_hertz():
    assert units.column("area") == (1.0, "m2")
    assert units.column("angle") == (1.0, "rad")
    assert units.column("frequency") == (pytest.approx(1 / (2 * math.pi)), "hz")
    assert units.column("ratio") == (1.0, "")


def test_values_are_shown_in_the_units_people_read():
    assert units.show(66e-6, "area") == "66 mm^2"
    assert units.show(230 * units.HZ, "frequency") == "230 Hz"
    assert units.show(1e-6, "angle") == "1 urad"
    assert units.show(0.5, "ratio") == "0.5"
