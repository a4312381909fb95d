"""The uniform beam against its frequency equations, its boundary conditions, exact tip masses and the dissertation."""

from __future__ import annotations

from math import cos, cosh, pi, sin, sinh, tanh

import numpy as np
import pytest
import reference
from scipy import optimize

from fosopt.errors import ModelError
from fosopt.modes import Damping, Hub, modal_frame
from fosopt.structure import Beam, assemble_beam, barker_beam, mass_matrix, structural_mass, structure_inertia
from fosopt.structure.beam import MOST_MODES, lateral_roots

EPS = np.finfo(float).eps
BOUNDARIES = ("fixed", "pinned")
# 150 modes: sinh and cosh of the highest argument are 1e204, their difference has no digit left.
HIGH = 150


def beam(boundary="fixed"):
    return Beam(2.5, 3.0, 40.0, 7e3, boundary)


def gauss(length, count=1000):
    """Nodes and weights of a quadrature along a beam, exact to rounding for products of all modes used here."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (nodes + 1) * length / 2, weights * length / 2


# ---- frequencies ----


def test_the_first_roots_satisfy_the_frequency_equations_as_printed():
    # An error of four units in the last place of z moves the equations by their slope, about √2 cosh z.
    for z in lateral_roots("fixed", 8):
        assert abs(cos(z) * cosh(z) + 1) <= 8 * EPS * z * cosh(z)
    for z in lateral_roots("pinned", 8)[1:]:
        assert abs(sin(z) * cosh(z) - cos(z) * sinh(z)) <= 8 * EPS * z * cosh(z)


@pytest.mark.parametrize(
    ("boundary", "known"),
    [
        ("fixed", [1.875104068711961, 4.694091132974175, 7.854757438237613]),
        ("pinned", [0.0, 3.926602312047919, 7.068582745628732]),
    ],
)
def test_the_first_roots_have_their_known_digits(boundary, known):
    assert lateral_roots(boundary, 3) == pytest.approx(known, rel=4 * EPS, abs=0)


@pytest.mark.parametrize(("boundary", "limit"), [("fixed", 0.5), ("pinned", 0.25)])
def test_no_root_is_missed_and_high_ones_stand_at_their_limit(boundary, limit):
    roots = lateral_roots(boundary, 3000)
    elastic = roots[roots > 0]
    first = 1 if boundary == "pinned" else 0
    limits = (np.arange(elastic.size) + first + limit) * pi
    # The distance is asin(sech z) or half of sech² z: below the rounding of z from the twelfth on.
    assert np.all(np.abs(elastic - limits) <= 2.2 * np.exp(-elastic) + 4 * EPS * limits)
    assert np.count_nonzero(roots == 0) == first


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_natural_frequencies_follow_from_the_roots(boundary):
    of = beam(boundary)
    expected = lateral_roots(boundary, 5) ** 2 * (40.0 / (3.0 * 2.5**4)) ** 0.5
    assert of.lateral_modes(5).natural_frequency == pytest.approx(expected, rel=8 * EPS, abs=0)
    expected = (2 * np.arange(1, 5) - 1) * pi / 2 * (7e3 / (3.0 * 2.5**2)) ** 0.5
    assert of.longitudinal_modes(4).natural_frequency == pytest.approx(expected, rel=8 * EPS, abs=0)


# ---- mode shapes ----


def test_low_shapes_are_those_of_the_printed_equations():
    x = np.linspace(0, 2.5, 26)
    for z, shape in zip(lateral_roots("fixed", 4), beam().lateral_modes(4).shape(x), strict=True):
        t = z * x / 2.5
        printed = (sin(z) - sinh(z)) * (np.sin(t) - np.sinh(t)) + (cos(z) + cosh(z)) * (
            np.cos(t) - np.cosh(t)
        )
        scale = shape[-1] / printed[-1]
        assert np.abs(shape - scale * printed).max() <= 10 * EPS * cosh(z) * np.abs(shape).max()
    elastic = beam("pinned").lateral_modes(4).shape(x)[1:]
    for z, shape in zip(lateral_roots("pinned", 4)[1:], elastic, strict=True):
        t = z * x / 2.5
        printed = sinh(z) * np.sin(t) + sin(z) * np.sinh(t)
        scale = shape[-1] / printed[-1]
        assert np.abs(shape - scale * printed).max() <= 10 * EPS * z * np.abs(shape).max()
    printed = (2 / (3.0 * 2.5)) ** 0.5 * np.sin(np.outer([1, 3, 5], pi * x / (2 * 2.5)))
    assert np.abs(beam().longitudinal_modes(3).shape(x) - printed).max() <= 10 * EPS


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_shapes_are_orthonormal_in_the_mass_however_high(boundary):
    of = beam(boundary)
    x, weight = gauss(of.length)
    for modes in (of.lateral_modes(HIGH), of.longitudinal_modes(HIGH)):
        shapes = modes.shape(x)
        gram = (shapes * weight * of.mass_per_length) @ shapes.T
        # The argument of the highest sine, 470, is known to 470 eps; a sum of 1000 terms adds as much.
        assert np.abs(gram - np.eye(HIGH)).max() <= 2000 * EPS


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_shapes_meet_their_boundary_conditions_however_high(boundary):
    of = beam(boundary)
    modes = of.lateral_modes(HIGH)
    elastic = modes.wave_number > 0
    ends = [
        modes.shape([0.0, of.length], order)[elastic] / modes.wave_number[elastic, None] ** order
        for order in range(4)
    ]
    rounding = 10 * HIGH * pi * EPS / of.mass**0.5
    assert np.abs(ends[0][:, 0]).max() <= rounding
    assert np.abs(ends[1 if boundary == "fixed" else 2][:, 0]).max() <= rounding
    assert np.abs(ends[2][:, 1]).max() <= rounding
    assert np.abs(ends[3][:, 1]).max() <= rounding
    # What is not held moves, and by the closed form.
    assert np.abs(ends[0][:, 1]) == pytest.approx(2 / of.mass**0.5, rel=1e-12)
    free = ends[2 if boundary == "fixed" else 1][:, 0]
    assert np.all(free > 1 / of.mass**0.5)
    longitudinal = of.longitudinal_modes(HIGH)
    assert longitudinal.shape(0.0)[0] == 0
    strain = longitudinal.shape(of.length, 1)[:, 0] / longitudinal.wave_number
    assert np.abs(strain).max() <= rounding


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_each_derivative_is_the_slope_of_the_one_before(boundary, order):
    of = beam(boundary)
    modes, x, h = of.lateral_modes(6), np.linspace(0.01, 2.49, 40), 1e-3
    around = [modes.shape(x + k * h, order) for k in (-2, -1, 1, 2)]
    slope = (around[0] - 8 * around[1] + 8 * around[2] - around[3]) / (12 * h)
    exact = modes.shape(x, order + 1)
    # Fourth order: (β h)⁴/30 with β h below 0.007.
    assert np.abs(slope - exact).max() <= 1e-9 * np.abs(exact).max()


def test_a_bending_shape_solves_its_differential_equation():
    of = beam()
    modes, x, h = of.lateral_modes(3), np.linspace(0.2, 2.3, 20), 0.02
    w = [1, -4, 6, -4, 1]
    fourth = sum(c * modes.shape(x + k * h) for c, k in zip(w, range(-2, 3), strict=True)) / h**4
    expected = modes.wave_number[:, None] ** 4 * modes.shape(x)
    # Second order: (β h)²/6 with β h below 0.063.
    assert np.abs(fourth - expected).max() <= 1e-3 * np.abs(expected).max()


def test_the_rigid_body_mode_turns_about_the_pin():
    of = beam("pinned")
    modes = of.lateral_modes(1)
    assert modes.natural_frequency.tolist() == [0.0]
    rate = 1 / of.inertia**0.5
    assert of.inertia == pytest.approx(3.0 * 2.5**3 / 3, rel=4 * EPS)
    assert modes.shape([0.0, 1.0, 2.5]) == pytest.approx(np.array([[0.0, rate, 2.5 * rate]]), rel=4 * EPS)
    assert modes.shape([0.0, 2.5], 1) == pytest.approx(np.full((1, 2), rate), rel=4 * EPS)
    assert not modes.shape([0.0, 2.5], 2).any()


# ---- the dissertation ----


@pytest.mark.parametrize(("boundary", "table"), [("fixed", "table_2_2"), ("pinned", "table_2_3")])
def test_the_equivalent_beam_has_the_printed_bending_frequencies(boundary, table):
    printed = np.array(reference.DISSERTATION[table]["beam_theory"])
    longitudinal = int(np.argmin(np.abs(printed - 30.9)))
    bending = np.delete(printed, longitudinal)
    found = barker_beam(boundary).lateral_modes(bending.size).natural_frequency / reference.HZ
    # Two decimals are printed.
    assert np.abs(found - bending).max() <= 0.005


def test_the_printed_longitudinal_frequencies_need_another_stiffness_than_the_printed_one():
    tables = [reference.DISSERTATION[name]["beam_theory"] for name in ("table_2_2", "table_2_3")]
    printed = np.array([tables[0][3], tables[1][3]])
    of = barker_beam()
    assert (
        of.longitudinal_modes(1).natural_frequency
        == barker_beam("fixed").longitudinal_modes(1).natural_frequency
    )
    found = of.longitudinal_modes(1).natural_frequency[0] / reference.HZ
    assert found == pytest.approx(30.13, abs=0.005)
    # 2.5e6 lbf is printed: a stiffness of two digits lies within 2 % of the one used.
    assert np.all((printed / found) ** 2 > 1.04)


def test_the_equivalent_beam_has_the_mass_of_the_truss():
    of = barker_beam()
    assert of.mass == pytest.approx(reference.DISSERTATION["section_2_2"]["total_mass"], rel=2e-3)
    assert of.length == pytest.approx(reference.DISSERTATION["section_2_2"]["length"], rel=2e-3)


# ---- the structure in modal coordinates ----


def frame_of(of, mirror_mass=0.0, **options):
    structure = assemble_beam(of, **options)
    return modal_frame(structure, structure.area, structure.batten_mass, mirror_mass, "tip")


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_without_a_mirror_the_structure_has_the_modes_of_the_beam(boundary):
    of = beam(boundary)
    frame = frame_of(
        of, lateral_modes=7, longitudinal_modes=3, stations={"middle": (1.1, "y"), "end": (2.5, "x")}
    )
    expected = np.concatenate(
        [of.lateral_modes(7).natural_frequency, of.longitudinal_modes(3).natural_frequency]
    )
    order = np.argsort(expected)
    assert np.sqrt(frame.eigenvalue) == pytest.approx(expected[order], rel=1e-9, abs=0)
    modes = frame.modal_set(Hub(), Damping((0.0,)), ("hub", "tip", "middle", "end"))
    lateral, longitudinal = of.lateral_modes(7), of.longitudinal_modes(3)
    for port, bending, stretch in (
        ("hub", lateral.shape(0.0, 1), np.zeros(3)),
        ("tip", lateral.shape(2.5, 1), np.zeros(3)),
        ("middle", lateral.shape(1.1), np.zeros(3)),
        ("end", np.zeros(7), longitudinal.shape(2.5)),
    ):
        shape = np.concatenate([np.ravel(bending), np.ravel(stretch)])[order]
        assert np.abs(modes.at(port)) == pytest.approx(np.abs(shape), rel=1e-9, abs=1e-9)
    # A clamp is exact: nothing reaches the mirror from a held hub.
    assert np.any(modes.at("hub")) == (boundary == "pinned")


def exact_roots(boundary, ratio, count):
    """Roots β L of a beam with a tip mass of `ratio` times its own: its frequency equation over cosh."""

    def equation(z):
        if boundary == "fixed":
            return 1 / cosh(z) + cos(z) + ratio * z * (cos(z) * tanh(z) - sin(z))
        return sin(z) - cos(z) * tanh(z) + 2 * ratio * z * sin(z) * tanh(z)

    grid = np.linspace(1e-3, 20.0, 20001)
    values = [equation(z) for z in grid]
    brackets = [(a, b) for a, b, u, v in zip(grid, grid[1:], values, values[1:], strict=False) if u * v < 0]
    return np.array([optimize.brentq(equation, a, b, xtol=1e-14) for a, b in brackets[:count]])


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("ratio", [0.5, 7 / 3])
def test_frequencies_with_a_tip_mass_converge_from_above_at_third_order(boundary, ratio):
    of = barker_beam(boundary)
    roots = exact_roots(boundary, ratio, 3)
    exact = roots**2 * (of.bending_stiffness / (of.mass * of.length**3)) ** 0.5
    errors = []
    for count in (10, 20, 40, 80):
        frame = frame_of(of, ratio * of.mass, lateral_modes=count, longitudinal_modes=0)
        found = np.sqrt(frame.eigenvalue[frame.eigenvalue > 0][:3])
        errors.append(found / exact - 1)
    assert np.all(np.array(errors) > 0)
    # The next term is smaller by the number of modes; the largest of the third mode at ten modes is 8 %.
    assert np.log2(errors[-2] / errors[-1]) == pytest.approx(3.0, abs=0.06)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(3.0, abs=0.3)
    # The longitudinal modes carry the mass as well.
    stretched = frame_of(of, ratio * of.mass, lateral_modes=1, longitudinal_modes=80)
    z = optimize.brentq(lambda z: cos(z) / z - ratio * sin(z), 0.1, 1.5, xtol=1e-14)
    exact_rod = z / of.length * (of.axial_stiffness / of.mass_per_length) ** 0.5
    moving = np.abs(stretched.shapes[1:]).max(axis=0) > np.abs(stretched.shapes[0])
    first = np.sqrt(stretched.eigenvalue[moving][0])
    # First order here, since the strain at the tip does not vanish: 2 μ/(π² N) and less.
    assert 0 < first / exact_rod - 1 < ratio * 2 / (pi**2 * 80)


def test_six_modes_are_good_to_a_thousandth_for_the_first_frequency_with_the_mirror():
    of = barker_beam()
    exact = exact_roots("pinned", 7 / 3, 1)[0] ** 2 * (of.bending_stiffness / (of.mass * of.length**3)) ** 0.5
    frame = frame_of(of, 7 / 3 * of.mass)
    assert 0 < np.sqrt(frame.eigenvalue[1]) / exact - 1 < 1e-3


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("count", [1, 4, 30])
def test_mass_and_inertia_are_those_of_the_whole_beam_however_few_the_modes(boundary, count):
    of = beam(boundary)
    structure = assemble_beam(of, lateral_modes=count)
    none = np.zeros(0)
    assert structural_mass(structure, none, none) == of.mass
    assert structure_inertia(structure, none, none) == pytest.approx(3.0 * 2.5**3 / 3, rel=1e-14)
    x, weight = gauss(of.length)
    turned = of.lateral_modes(count).shape(x) @ (weight * of.mass_per_length * x)
    rounding = 1e-12 * of.inertia
    assert np.abs(structure.hub_arm[:count] - turned).max() <= rounding
    # The row that does not move holds the rest, and none of it enters the equations of motion.
    rest = structure.mass_constant[count + 1]
    assert rest == pytest.approx(of.inertia - np.sum(turned**2), rel=0, abs=rounding)
    assert (rest > 1e-9) == (boundary == "fixed")
    assert not structure.mass_rows[[count + 1]].toarray().any()


def test_the_mirrors_mass_rides_at_its_port():
    of = beam("pinned")
    structure = assemble_beam(of, "middle", 5, 2, {"middle": (1.1, "rz")})
    none = np.zeros(0)
    y, x = of.lateral_modes(5).shape(1.1)[:, 0], of.longitudinal_modes(2).shape(1.1)[:, 0]
    expected = np.eye(7) + 4.0 * (
        np.outer(np.r_[y, 0, 0], np.r_[y, 0, 0]) + np.outer(np.r_[np.zeros(5), x], np.r_[np.zeros(5), x])
    )
    assert np.abs(mass_matrix(structure, none, none, 4.0) - expected).max() <= 1e-13 * np.abs(expected).max()
    # A rotation of one radian about the hub carries the mirror through its distance.
    assert structure.hub_arm[-2:].tolist() == [0.0, 1.1]


def test_the_reference_inertia_falls_with_the_inverse_cube_of_the_number_of_modes():
    of = barker_beam("fixed")
    inertia = [
        1 / np.sum((assemble_beam(of, lateral_modes=n, longitudinal_modes=0).port("tip")) ** 2)
        for n in (25, 50, 100)
    ]
    assert np.log2(np.divide(inertia[:-1], inertia[1:])) == pytest.approx(3.0, abs=0.1)


# ---- refusals ----


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length": 0.0}, "length 0.0 is not above zero"),
        ({"mass_per_length": -1.0}, "mass_per_length -1.0 is not above zero"),
        ({"bending_stiffness": np.nan}, "bending_stiffness nan is not above zero"),
        ({"axial_stiffness": np.inf}, "axial_stiffness inf is not above zero"),
        ({"boundary": "free"}, "boundary 'free' does not exist; choose fixed or pinned"),
    ],
)
def test_a_beam_that_physics_does_not_allow_is_refused(change, message):
    good = {"length": 1.0, "mass_per_length": 1.0, "bending_stiffness": 1.0, "axial_stiffness": 1.0}
    with pytest.raises(ModelError, match=message):
        Beam(**{**good, **change})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mirror_port": "tipp"}, "port 'tipp' does not exist; did you mean 'tip'"),
        ({"lateral_modes": 0}, "0 lateral modes; give 1 or more"),
        ({"longitudinal_modes": -1}, "-1 longitudinal modes; give 0 or more"),
        ({"lateral_modes": MOST_MODES + 1}, f"{MOST_MODES + 1} lateral modes; give {MOST_MODES} at most"),
        ({"stations": {"tip": (1.0, "y")}}, "station 'tip': every beam has this port"),
        ({"stations": {"a": (1.0, "z")}}, "component 'z' does not exist; choose x, y or rz"),
        ({"stations": {"a": (9.0, "y")}}, "9 m is not on the beam; give 0 to 2.5 m"),
        ({"stations": {"a": (np.nan, "y")}}, "nan m is not on the beam"),
    ],
)
def test_a_structure_that_cannot_be_made_of_a_beam_is_refused(options, message):
    with pytest.raises(ModelError, match=message):
        assemble_beam(beam(), **options)


@pytest.mark.parametrize("x", [-0.1, 2.6, np.nan])
def test_a_place_off_the_beam_is_refused(x):
    with pytest.raises(ModelError, match=r"is not on it; give 0 to 2\.5 m"):
        beam().lateral_modes(2).shape([0.0, x])


def test_the_most_modes_a_beam_may_have_leave_the_first_frequency_its_digits():
    of = barker_beam("fixed")
    frame = frame_of(of, 7 / 3 * of.mass, lateral_modes=MOST_MODES, longitudinal_modes=MOST_MODES)
    exact = exact_roots("fixed", 7 / 3, 1)[0] ** 2 * (of.bending_stiffness / (of.mass * of.length**3)) ** 0.5
    assert frame.n_rigid == 0
    # The solver errs by 2e-15 of the largest eigenvalue, which is 1e10 of the first.
    assert np.sqrt(frame.eigenvalue[0]) == pytest.approx(exact, rel=1e-5)
