"""Bounds on structure and controller together: enclosures that hold, kernels, and designs that must not pass them."""

from __future__ import annotations

import heapq
from dataclasses import replace
from math import inf, pi
from typing import Any

import control_bounds as shared
import numpy as np
import pytest
import reference
from numpy.typing import NDArray
from reference import HZ
from small_problems import DISTURBANCES, limit, truss_problem
from small_sizings import form

from fosopt.actuators import Placement
from fosopt.control import NUMERATORS, plant_impedance
from fosopt.errors import ModelError
from fosopt.metrics.disturbances import Disturbance, high_pass, white
from fosopt.metrics.functional import LoopModel
from fosopt.modes import Damping, Hub
from fosopt.relax import joint_limit as module
from fosopt.relax.bound import Bound
from fosopt.relax.joint_arithmetic import Affine
from fosopt.relax.joint_family import StructureFamily, chain_family, structure_family
from fosopt.relax.joint_limit import JointLimit, family_limit, joint_limit
from fosopt.relax.joint_weights import best_weights, kernels, sources
from fosopt.relax.log_integral import logarithmic_limit
from fosopt.relax.performance_limit import performance_limit
from fosopt.relax.pid_bound import best_pid
from fosopt.structure import Chain, two_body_stiffness

Array = NDArray[np.float64]

POINTS = np.array([1.0, 30.0, 400.0, 20 + 20j, 100 + 300j, 30 + 350j])
# Rounding of enclosures that are exact but for it.
EXACT = 1e-12
WHITE = Disturbance("noise", "sensor_noise", white(3e-6))


def rate_of(case: int) -> float:
    """Frequency of the structure alone in one of the cases of chapter 3."""
    return float(reference.DISSERTATION["chapter_3"]["structure_frequency"][case - 1] * HZ)


def chains(low: float, high: float) -> StructureFamily:
    """The modified benchmark problem with the frequency of its structure in a range."""
    given = reference.DISSERTATION["chapter_3"]
    mass = given["end_mass"]
    spring = [np.array([two_body_stiffness(rate, mass, mass)]) for rate in (low, high)]
    chain = Chain({"aft": mass, "fore": mass}, tuple(float(k) for k in spring[0]), False)
    mirror = reference.benchmark(None)[0].mirror
    return chain_family(chain, spring[0], spring[1], mirror, given["zeta_structure"])


def chain_at(rate: float) -> LoopModel:
    """The same as a loop on a modal set."""
    loop, modes = reference.benchmark(3)
    return LoopModel(loop, replace(modes, natural_frequency=np.array([0.0, rate])), "tip")


def sample(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Numbers of any phase."""
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


# ---- arithmetic ----


def random_affine(rng: np.random.Generator, radius: float) -> Affine:
    """Numbers away from zero with two parameters."""
    return Affine(3 * np.exp(2j * pi * rng.random(50)), 0.3 * sample(rng, (50, 2)), np.full(50, radius))


def apart(found: Affine, delta: Array, value: Array) -> Array:
    """Distance from what is linear, less the radius."""
    return np.abs(value - found.value - found.slope @ delta) - found.radius


@pytest.mark.parametrize("radius", [0.0, 0.2])
def test_products_reciprocals_and_logarithms_stay_within_their_discs(radius):
    rng = np.random.default_rng(1)
    first, second = random_affine(rng, radius), random_affine(rng, radius)
    for _ in range(40):
        delta = rng.choice([-1.0, 1.0], 2) * rng.choice([1.0, rng.random()])
        a, b = (
            x.value + x.slope @ delta + radius * np.exp(2j * pi * rng.random(50)) for x in (first, second)
        )
        assert apart(first * second, delta, a * b).max() <= EXACT
        assert apart(first.reciprocal(), delta, 1 / a).max() <= EXACT
        assert apart(first.log_magnitude(), delta, np.log(np.abs(a))).max() <= EXACT
        assert apart(first + second * 2j, delta, a + 2j * b).max() <= EXACT


def test_discs_are_as_small_as_they_can_be():
    # 2 + δ/2 + ε between 1.25 and 2.75: what is not linear is largest at an end.
    one = Affine(np.array([2.0]), np.array([[0.5]]), np.array([0.25]))
    low, high, up, down = 1.25, 2.75, np.ones(1), -np.ones(1)
    assert apart(one * one, up, np.array([high**2])) == pytest.approx(0.0, rel=0, abs=EXACT)
    assert apart(one.log_magnitude(), down, np.log([low])) == pytest.approx(0.0, rel=0, abs=EXACT)
    assert apart(one.reciprocal(), down, np.array([1 / low])) == pytest.approx(0.0, rel=0, abs=EXACT)


@pytest.mark.parametrize("shift", [-1.9, -2.0])
def test_of_what_may_be_zero_nothing_is_known(shift):
    one = Affine(np.array([2.0 + 0j]), np.array([[0.5]]), np.array([0.25])) + shift
    assert np.isinf(one.log_magnitude().radius[0])
    assert np.isinf(one.reciprocal().radius[0])


# ---- structures over a box ----


def family_and_model(boundary: str, damping: float) -> tuple[StructureFamily, Any]:
    """A short truss of two groups, and the loop at given areas."""
    problem = truss_problem(bays=2, damping=damping)
    hub = {"pinned": Hub("held", 2 * HZ, 0.7), "free": Hub("free"), "fixed": Hub("fixed")}[boundary]
    of = reference.structure("fixed" if boundary == "fixed" else "pinned", 2)
    problem = replace(problem, system=replace(problem.system, structure=of, hub=hub))
    truth = problem.evaluate(problem.start, truth=True)
    family, _ = structure_family(problem, problem.start, (), truth)

    def model(area: Array) -> LoopModel:
        x = problem.start.copy()
        x[: area.size] = area
        return problem.evaluate(x, truth=True).model

    return family, model


@pytest.mark.parametrize("boundary", ["pinned", "free", "fixed"])
@pytest.mark.parametrize("damping", [0.002, 0.2])
def test_receptances_and_responses_over_a_box_hold_those_of_every_structure_in_it(boundary, damping):
    family, model = family_and_model(boundary, damping)
    rng = np.random.default_rng(3)
    middle = np.array([7e-5, 5e-5])
    for wide in (0.0, 1e-3, 0.05):
        box = middle * (1 - wide), middle * (1 + wide)
        found = family.receptances(*box, POINTS)
        answers, lowest = family.responses(*box, POINTS), family.lowest(*box, POINTS)
        for _ in range(8):
            delta = rng.choice([-1.0, 1.0], 2) * rng.choice([1.0, rng.random()])
            at = model(middle * (1 + wide * delta))
            g = at.points(POINTS).g
            for enclosed, value in zip(found, (g.direct, g.cross), strict=True):
                assert np.all(apart(enclosed, delta, value) <= EXACT * np.abs(value))
            for name, enclosed in answers.items():
                if name == "hub_torque" and boundary == "fixed":
                    assert np.all(np.isinf(enclosed.radius))
                    continue
                response = NUMERATORS[name](at.loop, POINTS, g) / plant_impedance(at.loop, POINTS, g)
                assert np.all(apart(enclosed, delta, np.log(np.abs(response))) <= EXACT)
                assert np.all(lowest[name] <= np.log(np.abs(response)) + EXACT)
                # Of one structure all is known but for damping and how the hub is held.
                known = np.isfinite(lowest[name])
                assert np.array_equal(known, POINTS.imag == 0) or wide or name == "hub_torque"


def test_discs_of_a_single_inertia_are_as_small_as_they_can_be_at_its_resonance():
    # At |c|² = k/J of the softest spring, |k + c² J| is cos θ (k + |c|² J), and all of the disc is used.
    inertia, low, high = 2.0, 9.0, 11.0
    chain = Chain({"hub": 1.0, "tip": inertia}, (low,), True)
    family = chain_family(chain, np.array([low]), np.array([high]), reference.benchmark(None)[0].mirror, 0.0)
    c = np.sqrt(low / inertia) * np.exp(1j * np.radians([0.0, 45.0, 85.0]))
    found, _ = family.receptances(np.array([low]), np.array([high]), c)
    value = 1 / (low + c**2 * inertia)
    assert apart(found, -np.ones(1), value) / found.radius == pytest.approx(0.0, rel=0, abs=1e-9)


def test_enclosures_shrink_with_the_square_of_the_box_but_for_damping():
    family, _ = family_and_model("pinned", 0.0)
    middle = np.array([7e-5, 5e-5])
    radii = [
        family.receptances(middle * (1 - wide), middle * (1 + wide), POINTS)[0].radius
        for wide in (1e-2, 1e-3)
    ]
    # N₀ of the larger box is one percent lower.
    assert np.all((radii[0] / radii[1] > 90) & (radii[0] / radii[1] < 110))


def test_boxes_without_a_structure_within_the_limits_are_known():
    family = replace(chains(10 * HZ, 100 * HZ), slowest=40 * HZ)
    stiffness = [np.array([two_body_stiffness(rate * HZ, 0.22, 0.22)]) for rate in (20, 39, 41)]
    assert not family.possible(stiffness[0], stiffness[1])
    assert family.possible(stiffness[0], stiffness[2])
    problem = truss_problem(bays=2)
    truth = problem.evaluate(problem.start, truth=True)
    mass = truth.value("structural_mass")
    for share, possible in ((1.001, True), (0.999, False)):
        asked = (limit("structural_mass", upper=share * mass), limit("area[1] + area[2]", upper=1.0))
        some, part = structure_family(problem, problem.start, asked, truth)
        here = problem.start[:2]
        assert some.possible(here, here) == possible
        assert part.left_out == ("area[1] + area[2] <= 1 m^2",)


# ---- weights ----


def test_kernels_have_integral_one_and_give_harmonic_functions_back():
    c = np.array([3.0 + 0j, 1 + 5j])
    t = np.linspace(-20, 20, 40001)
    frequency = np.exp(t)
    share = 2 * frequency * (t[1] - t[0])
    kernel = kernels(frequency, c)
    # What the grid leaves out below and above: Poisson's kernel falls off as Re c/πω².
    assert share @ kernel == pytest.approx(1.0, rel=1e-7, abs=0)
    harmonic = np.log(np.abs(1j * frequency + 7.0))
    assert (share * harmonic) @ kernel == pytest.approx(np.log(np.abs(c + 7.0)), rel=1e-6, abs=0)


@pytest.mark.parametrize("noise", [shared.NOISE, WHITE], ids=["high pass", "white"])
@pytest.mark.parametrize("case", [1, 3])
def test_at_one_structure_the_bound_is_below_the_limit_and_close(case, noise):
    disturbances = (shared.FORCE, shared.DISPLACEMENT, noise)
    rate = rate_of(case)
    model = chain_at(rate)
    exact = logarithmic_limit(model, disturbances)
    found = family_limit(chains(rate, rate), disturbances)
    assert found.finished
    # Smooth weights lose what resonances and corners of the spectrum have beyond them.
    assert 0.985 * exact < found.bound.value <= exact
    assert found.attained == pytest.approx(found.bound.value, rel=1e-6, abs=0)


@pytest.mark.parametrize("noise", [shared.NOISE, WHITE], ids=["high pass", "white"])
def test_what_no_structure_changes_is_bounded_exactly(noise):
    rate = rate_of(3)
    exact = logarithmic_limit(chain_at(rate), (shared.DISPLACEMENT, noise))
    found = family_limit(chains(rate, rate), (shared.DISPLACEMENT, noise))
    # The tangent is looked for to a tenth and a half; it errs by the square.
    assert 0.998 * exact < found.bound.value <= exact


def test_any_weights_that_fit_give_a_bound():
    model, disturbances = chain_at(rate_of(3)), shared.BENCHMARK
    exact = logarithmic_limit(model, disturbances)
    of = sources(disturbances)
    points = of.points()
    g = model.points(points).g
    response = NUMERATORS["mirror_torque"](model.loop, points, g) / plant_impedance(model.loop, points, g)
    true = (2 * np.log(np.abs(response)) + of.filters(points)[0])[None]
    rng = np.random.default_rng(5)
    for _ in range(3):
        # Made for another structure, at some of the points.
        guess = true + rng.normal(size=true.shape)
        weights = best_weights(of, points, guess, rng.random(true.shape) < 0.7)
        value = weights.constant + weights.factor * float(np.sum(weights.weight * true))
        assert np.all(weights.weight >= 0)
        assert value <= exact**2


def test_a_hub_torque_through_a_truss_with_zeros_in_the_right_half_plane_is_bounded_too():
    problem = truss_problem(bays=2, disturbances=DISTURBANCES)
    truth = problem.evaluate(problem.start, truth=True)
    family, _ = structure_family(problem, problem.start, (), truth)
    here = problem.start[:2]
    one = replace(family, sizing=replace(family.sizing, lower=here, upper=here))
    exact = performance_limit(truth.model, DISTURBANCES).bound.value
    found = family_limit(one, DISTURBANCES).bound.value
    assert 0.85 * exact < found <= exact


def test_disturbances_that_do_not_enter_are_named_and_only_lower_the_bound():
    table = Disturbance("table", "mirror_torque", frequency=np.array([1.0, 100.0]), psd=np.array([1.0, 1.0]))
    banded = replace(shared.FORCE, name="banded", band=(1.0, 100.0))
    second = Disturbance("second", "sensor_noise", high_pass(70 * HZ, 1e-6, 2))
    quiet = Disturbance("quiet", "sensor_noise", white(1e-9))
    of = sources((*shared.BENCHMARK, table, banded, second, quiet))
    assert of.left_out == ("table", "banded", "second", "quiet")
    assert of.torques == (shared.FORCE,)
    assert of.fixed == (shared.NOISE, shared.DISPLACEMENT)
    assert of.corner == pytest.approx(70 * HZ, rel=1e-12, abs=0)
    assert of.density == pytest.approx(3.14e-6**2 / 2, rel=1e-12, abs=0)
    assert sources((WHITE,)).corner == 0
    with pytest.raises(ModelError, match="white or a high pass of first order"):
        sources((shared.FORCE, second))


# ---- the joint bound ----


def test_no_structure_of_the_benchmark_passes_the_joint_bound_and_a_pid_controller_comes_close():
    low, high = 150 * HZ, 500 * HZ
    found = family_limit(chains(low, high), shared.BENCHMARK, tolerance=0.01)
    assert found.finished and found.boxes > 1
    rates = np.geomspace(low, high, 9)
    limits = [performance_limit(chain_at(rate), shared.BENCHMARK).bound.value for rate in rates]
    assert found.bound.value <= min(limits)
    # One percent of boxes, and what weights at one structure lose.
    assert found.bound.value >= 0.975 * min(limits)
    design = best_pid(chain_at(high), shared.BENCHMARK, shared.WIDE, gap=0.1)
    found.bound.hold(design.jitter, "the PID controller")
    assert found.bound.value >= 0.96 * design.jitter


def test_boxes_that_were_cut_still_hold_every_structure():
    family, _ = family_and_model("pinned", 0.002)
    search = module._Search(family, DISTURBANCES)
    for _ in range(12):
        search._cut(heapq.heappop(search.open))
    low, high = (np.array([getattr(box, end) for box in search.open]) for end in ("low", "high"))
    assert search.count == 25
    for share in np.random.default_rng(2).random((200, 2)):
        x = family.sizing.lower + share * (family.sizing.upper - family.sizing.lower)
        assert np.any(np.all((low <= x) & (x <= high), axis=1))


def test_over_a_box_the_bound_is_the_least_of_its_corners_but_for_discs():
    family, _ = family_and_model("pinned", 0.002)
    middle = np.array([7e-5, 5e-5])

    def search(low: Array, high: Array) -> Any:
        box = replace(family.sizing, lower=low, upper=high)
        return module._Search(replace(family, sizing=box), DISTURBANCES)

    whole = search(middle * (1 - 1e-4), middle * (1 + 1e-4))
    assert not whole.run(0.02, -inf)
    weights = [best_weights(whole.of, whole.points, box.value, box.radius < 1) for box in whole.open]
    least, here = whole.open[0].under(weights[0])
    corners = []
    for signs in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        corner = middle * (1 + 1e-4 * np.array(signs))
        corners.append(search(corner, corner).open[0].under(weights[0])[1])
    assert least <= min(corners) < here
    # Discs are second order, but for those of the damping.
    assert here - least == pytest.approx(here - min(corners), rel=0.2, abs=0)


def test_limits_on_a_truss_bound_what_is_looked_at_and_an_impossible_one_is_proved():
    problem = truss_problem(bays=1)
    areas, *gains = problem.variables
    near = replace(areas, lower=0.8 * areas.start, upper=1.25 * areas.start)
    problem = replace(problem, variables=(near, *gains))
    truth = problem.evaluate(problem.start, truth=True)
    mass, first = truth.value("structural_mass"), truth.value("first_elastic_frequency")
    asked = (
        limit("structural_mass", upper=mass),
        limit("first_elastic_frequency", lower=0.9 * first),
        limit("modulus_margin", lower=0.5),
    )
    found = joint_limit(problem, problem.start, asked, tolerance=0.2)
    assert found.finished
    assert found.left_out == ("0.5 <= modulus_margin",)
    assert 0 < found.bound.value <= truth.value("jitter_total")
    assert np.all(found.low < found.high)
    # No structure within the limits does better than the bound, or the bound is above what it says it attains.
    exact = performance_limit(truth.model, DISTURBANCES).bound.value
    assert found.bound.value <= min(exact, found.attained)
    family, _ = structure_family(problem, problem.start, (limit("structural_mass", upper=0.1 * mass),), truth)
    assert family_limit(family, DISTURBANCES).bound.value == inf


def test_areas_member_by_member_are_bounded_at_once():
    problem = truss_problem(bays=2, disturbances=shared.TRUSS)
    of = problem.system.structure
    areas, *gains = problem.variables
    groups = tuple((i,) for i in range(of.area.size))
    ends = [np.full(of.area.size, end) for end in (13e-6, 330e-6)]
    each = replace(areas, lower=ends[0], upper=ends[1], start=of.area, groups=groups, labels=())
    problem = replace(problem, variables=(each, *gains))
    family, _ = structure_family(problem, problem.start, (), problem.evaluate(problem.start, truth=True))
    found = family_limit(family, shared.TRUSS, time_limit=0.5)
    assert not found.finished
    rng = np.random.default_rng(7)
    limits = []
    for _ in range(5):
        x = problem.start.copy()
        x[: of.area.size] = rng.uniform(*ends)
        limits.append(performance_limit(problem.evaluate(x, truth=True).model, shared.TRUSS).bound.value)
    assert 0.5 * min(limits) < found.bound.value <= min(limits)


def test_without_time_the_bound_is_low_but_one():
    found = family_limit(chains(1 * HZ, 500 * HZ), shared.BENCHMARK, time_limit=0.0)
    assert not found.finished
    assert found.bound.value == 0.0
    assert found.attained == inf


def test_a_bound_above_the_design_stops_with_an_internal_error(monkeypatch):
    problem = truss_problem(bays=2)
    truth = problem.evaluate(problem.start, truth=True)
    none = np.zeros(0)
    too_high = Bound(2 * truth.value("jitter_total"), "all", (), 0.0)
    wrong = JointLimit(too_high, 1.0, none, none, (), 1, 1, True, 0.0)
    monkeypatch.setattr(module, "family_limit", lambda *_, **__: wrong)
    with pytest.raises(RuntimeError, match="internal error"):
        joint_limit(problem, problem.start, ())
    # A design beyond the limits is no witness against it.
    mass = truth.value("structural_mass")
    assert (
        joint_limit(problem, problem.start, (limit("structural_mass", upper=0.99 * mass),)).bound == too_high
    )
    with pytest.raises(RuntimeError, match="internal error"):
        joint_limit(problem, problem.start, (limit("structural_mass", upper=mass * (1 - 1e-7)),))


# ---- refusals ----


def refused(problem: Any, constraints: Any = ()) -> None:
    """Ask for the bound."""
    joint_limit(problem, problem.start, constraints)


def test_what_the_bound_is_not_made_for_is_refused():
    problem = truss_problem(bays=2)
    area, mirror = problem.variables[0], replace(problem.variables[2], name="m", quantity="mirror_frequency")
    with pytest.raises(ModelError, match="given mirror"):
        refused(replace(problem, variables=(area, mirror)))
    with pytest.raises(ModelError, match="nothing of the structure"):
        refused(replace(problem, variables=problem.variables[1:]))
    with pytest.raises(ModelError, match="one damping ratio"):
        refused(replace(problem, system=replace(problem.system, damping=Damping((0.01, 0.02)))))
    loop = replace(problem.base.loop, placement=Placement(sensor="tip"))
    with pytest.raises(ModelError, match="sensor on it"):
        refused(replace(problem, base=replace(problem.base, loop=loop)))
    family = chains(HZ, 2 * HZ)
    for lower, upper in ((0.0, 1.0), (1.0, inf)):
        with pytest.raises(ModelError, match="box above zero"):
            replace(
                family,
                sizing=replace(
                    family.sizing, cost=np.ones(1), lower=np.array([lower]), upper=np.array([upper])
                ),
            )
    with pytest.raises(ModelError, match="stiffness falls"):
        replace(family, stiffness=form([1, -1], [5.0], [[-1.0]]))
