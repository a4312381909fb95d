"""Bounds on jitter over controllers: closed forms, routes that must agree, and controllers that must not pass them."""

from __future__ import annotations

from dataclasses import replace
from math import inf, pi, sqrt

import control_bounds as shared
import numpy as np
import pytest
import reference
from control_bounds import BENCHMARK, DISPLACEMENT, FORCE, NOISE, TRUSS
from reference import HZ
from scipy import integrate
from test_placement import CASES as PLACEMENTS
from test_placement import FREE
from test_placement import case as placed

from fosopt.control import PID, closed_loop_poles
from fosopt.errors import ModelError, SolverError, UnstableError
from fosopt.metrics.disturbances import Disturbance, ShapingFilter, high_pass, low_pass, white
from fosopt.metrics.functional import LoopModel
from fosopt.relax.bound import Bound
from fosopt.relax.log_integral import logarithmic_limit
from fosopt.relax.performance_limit import performance_limit
from fosopt.relax.pid_box import PidBox
from fosopt.relax.pid_relaxation import relaxation
from fosopt.relax.quadrature import nodes
from fosopt.relax.riccati import riccati_limit
from fosopt.relax.youla import youla

ROUTES = {
    "projection": lambda *given: performance_limit(*given).bound.value,
    "logarithm": logarithmic_limit,
    "riccati": riccati_limit,
}
EVERY_ROUTE = pytest.mark.parametrize("route", ROUTES.values(), ids=ROUTES)
EVERY_CASE = pytest.mark.parametrize("case", shared.CASES)
EVERY_PLACEMENT = pytest.mark.parametrize("name", PLACEMENTS)


def test_a_bound_above_a_verified_design_is_an_internal_error_that_names_both():
    bound = Bound(2.5, "jitter over all controllers", (), 0.0)
    bound.hold(2.5, "the design")
    with pytest.raises(RuntimeError, match=r"internal error.*2\.4.*2\.5"):
        bound.hold(2.4, "the design")


# The limit of performance: closed forms


@EVERY_ROUTE
def test_a_first_order_displacement_in_white_noise_has_the_filtering_error_of_the_textbook(route):
    # Density 2 a σ²/(ω² + a²) in noise of density r: the Kalman filter leaves r (√(a² + 2 a σ²/r) − a).
    corner, rms, density = 40.0, 3e-4, 2e-6
    seen = (Disturbance("d", "line_of_sight", low_pass(corner, rms)),)
    noise = (Disturbance("n", "sensor_noise", white(density)),)
    r = density**2 / 2
    expected = sqrt(r * (sqrt(corner**2 + 2 * corner * rms**2 / r) - corner))
    assert route(shared.benchmark(None), seen + noise) == pytest.approx(expected, rel=1e-8, abs=0)


@EVERY_ROUTE
def test_a_torque_on_the_mirror_in_white_noise_leaves_the_zeros_less_the_poles_of_the_spectrum(route):
    # Φ/r = Π(ω² + z²)/Π(ω² + p²), and (1/2π) ∫ log Φ/r dω = Σ z − Σ p.
    model = shared.benchmark(None)
    mirror, torque, density, corner = model.loop.mirror, 30.0, 3e-6, 60.0
    shape = low_pass(corner, torque)
    given = (
        Disturbance("f", "mirror_torque", shape),
        Disturbance("n", "sensor_noise", white(density)),
    )
    plant = np.polymul([mirror.inertia, mirror.damping, mirror.stiffness], shape.denominator)
    squared = np.polymul(plant, plant * (-1.0) ** np.arange(3, -1, -1))
    whole = np.polyadd(squared, [2 * shape.numerator[-1] ** 2 / density**2])
    zeros = np.roots(whole)
    zeros = zeros[zeros.real < 0]
    expected = sqrt(density**2 / 2 * (np.roots(plant).sum() - zeros.sum()).real)
    # The support of this model is heavy, not rigid.
    assert route(model, given) == pytest.approx(expected, rel=1e-7, abs=0)


def test_without_causality_the_limit_is_the_plain_integral():
    limit = performance_limit(shared.benchmark(None), (DISPLACEMENT, NOISE))

    def left_over(w):
        seen, noise = (0.5 * d.one_sided_psd(np.array([w]))[0] for d in (DISPLACEMENT, NOISE))
        return seen * noise / (seen + noise) / pi

    expected = integrate.quad(left_over, 0, 1e3, epsabs=0, limit=200)[0]
    expected += integrate.quad(left_over, 1e3, inf, epsabs=0, limit=200)[0]
    assert limit.noncausal == pytest.approx(sqrt(expected), rel=1e-8, abs=0)
    assert limit.bound.value > 1.2 * limit.noncausal


def test_without_noise_a_minimum_phase_loop_has_no_limit():
    limit = performance_limit(shared.benchmark(2), (FORCE, DISPLACEMENT))
    assert limit.noncausal < 1e-9 * 288e-6
    assert limit.bound.value < 1e-6 * 288e-6


# The limit of performance: routes that must agree


@EVERY_CASE
def test_frequency_response_and_riccati_equation_give_the_same_limit(case):
    model = shared.benchmark(case)
    found = performance_limit(model, BENCHMARK).bound.value
    assert logarithmic_limit(model, BENCHMARK) == pytest.approx(found, rel=1e-8, abs=0)
    assert riccati_limit(model, BENCHMARK) == pytest.approx(found, rel=1e-7, abs=0)


def test_they_agree_on_the_full_truss():
    model = shared.truss(0.2)
    found = performance_limit(model, TRUSS).bound
    assert found.allowance < 1e-8 * found.value
    assert logarithmic_limit(model, TRUSS) == pytest.approx(found.value, rel=1e-8, abs=0)
    assert riccati_limit(model, TRUSS) == pytest.approx(found.value, rel=1e-6, abs=0)


def test_they_agree_when_several_colored_noises_meet():
    noises = (
        Disturbance("steep", "sensor_noise", high_pass(70 * HZ, 3e-6, 2)),
        Disturbance("steeper", "sensor_noise", high_pass(7 * HZ, 1e-6, 3)),
        Disturbance("drift", "sensor_noise", low_pass(100 * HZ, 1e-6, 2)),
    )
    model = shared.benchmark(2)
    given = (FORCE, DISPLACEMENT, *noises)
    found = performance_limit(model, given).bound.value
    assert logarithmic_limit(model, given) == pytest.approx(found, rel=1e-7, abs=0)
    assert riccati_limit(model, given) == pytest.approx(found, rel=1e-7, abs=0)


def test_a_table_of_a_displacement_gives_the_limit_of_its_filter_as_its_rows_get_close():
    model = shared.benchmark(3)
    frequency = np.concatenate([[0.0], np.geomspace(1e-2, 1e8, 6000)])
    table = Disturbance("t", "line_of_sight", frequency=frequency, psd=DISPLACEMENT.one_sided_psd(frequency))
    given = (FORCE, table, NOISE)
    by_logarithm = logarithmic_limit(model, given)
    assert by_logarithm == pytest.approx(performance_limit(model, BENCHMARK).bound.value, rel=1e-5, abs=0)
    # A table has no poles whose mirror images would give the best g.
    assert 0.99999 * by_logarithm < performance_limit(model, given).bound.value < by_logarithm


@EVERY_PLACEMENT
def test_an_lqg_controller_comes_down_to_the_limit_as_its_torque_gets_free(name):
    model = placed(name).model
    limit = performance_limit(model, TRUSS)
    ratios = []
    for weight in (1e-13, 1e-15):
        controller = shared.Lqg(model, TRUSS, weight)
        assert controller.stable
        ratios.append(controller.jitter(limit.open_loop) / limit.bound.value)
    assert ratios[0] > ratios[1] > 1
    # A torque on the structure reaches the mirror through its soft spring only, and is far from free.
    assert ratios[1] < (10.0 if name == "action on the structure" else 1.5)


def test_zeros_in_the_right_half_plane_cost_what_an_lqg_controller_pays():
    model = placed("sensor and action on the structure").model
    limit = performance_limit(model, TRUSS)
    loop = limit.open_loop
    assert loop.zeros.size >= 2
    assert np.all(loop.zeros.real > 0)
    controller = shared.Lqg(model, TRUSS, 1e-16)
    assert controller.stable
    assert 1 < controller.jitter(loop) / limit.bound.value < 1.01
    blind = replace(limit, open_loop=replace(loop, zeros=np.zeros(0, complex)))
    count = int(np.sum(np.where(loop.zeros.imag > 0, 2, 1)))
    blind = replace(blind, coefficients=limit.coefficients[:-count])
    spectra = loop.spectra(loop.nodes(1e-6))
    # Without their functions the same g proves less.
    assert blind.variance(spectra) < 0.999 * limit.variance(spectra)


# The limit of performance: what must not pass it


@pytest.mark.parametrize("factor", [0.0, 0.5, 0.99, 1.01, 2.0])
def test_a_wrong_multiplier_makes_the_bound_lower(factor):
    limit = performance_limit(shared.benchmark(2), BENCHMARK)
    spectra = limit.open_loop.spectra(limit.open_loop.nodes(1e-6))
    wrong = replace(limit, coefficients=factor * limit.coefficients)
    assert wrong.variance(spectra) < limit.variance(spectra)


# No PID controller was found that stabilizes a mirror on a free body by a sensor on the structure.
@pytest.mark.parametrize(
    ("name", "hub"),
    [
        (n, h)
        for n in PLACEMENTS
        for h in (reference.HELD, FREE)
        if h != FREE or n != "sensor on the structure"
    ],
)
def test_jitter_is_the_limit_and_the_distance_from_its_filter_wherever_the_loop_acts(name, hub):
    model = placed(name, hub).model
    # Force and hub torque leave a free body alone at zero frequency, to the second order where a sensor needs it.
    washed = ShapingFilter((1e3, 0.0, 0.0), tuple(np.poly([-10.0, -60.0, -200.0, -900.0])))
    given = (Disturbance("f", "mirror_torque", washed), Disturbance("h", "hub_torque", washed), *TRUSS[2:])
    limit = performance_limit(model, given)
    pid, known = model.loop.controller, limit.open_loop.nodes(1e-6)
    compared = 0
    for factor in (0.01, 0.1, 0.3, 1.0):
        gains = np.array([factor * pid.gain, pid.kp, pid.ki, pid.kd])
        loop = replace(model.loop, controller=PID(*gains, pid.rolloff_time))
        expected = shared.jitter(model, given, loop.controller)
        if expected < inf:
            compared += 1
            closed = closed_loop_poles(loop, model.modes, "tip").value
            resolved = nodes(np.concatenate([known.poles, closed]), 0.0, inf, known.cuts)
            on_nodes = relaxation(limit, limit.open_loop.spectra(resolved), pid.rolloff_time)
            found = sqrt(on_nodes.variance(gains[None])[0])
            # A torque between two places of a free body loses digits near zero frequency.
            assert found == pytest.approx(expected, rel=1e-5, abs=0)
    assert compared


@EVERY_PLACEMENT
def test_no_stable_pid_controller_passes_the_limit(name):
    model = placed(name).model
    limit = performance_limit(model, TRUSS).bound
    pid = model.loop.controller
    box = PidBox((pid.gain / 100, 100 * pid.gain), (1, 6000), (10, 5e6), (0.1, 1), pid.rolloff_time)
    found = [shared.jitter(model, TRUSS, other) for other in shared.controllers(box, 40)]
    assert np.isfinite(found).sum() > 5
    assert min(found) >= limit.value


def test_jitter_is_the_limit_and_the_distance_from_its_filter():
    model = shared.benchmark(3)
    limit = performance_limit(model, BENCHMARK)
    spectra = limit.open_loop.spectra(limit.open_loop.nodes(1e-6).halved)
    on_nodes = relaxation(limit, spectra, 0.0)
    gains = np.array([[1.0, 1.4e6, 2e8, 2.1e3], [1300.0, 600.0, 5e4, 1.0]])
    for k, found in enumerate(np.sqrt(on_nodes.variance(gains))):
        expected = shared.jitter(model, BENCHMARK, PID(*gains[k]))
        assert found == pytest.approx(expected, rel=1e-6, abs=0)


def test_where_frequencies_do_not_count_causality_costs_nothing():
    banded = tuple(replace(d, band=(1.0, 2000 * HZ)) for d in BENCHMARK)
    limit = performance_limit(shared.benchmark(3), banded)
    assert limit.bound.value == pytest.approx(limit.noncausal, rel=1e-6, abs=0)
    assert any("bands" in sentence for sentence in limit.bound.assumptions)
    whole = performance_limit(shared.benchmark(3), BENCHMARK)
    assert not any("bands" in sentence for sentence in whole.bound.assumptions)


# The limit of performance: what has none


def test_a_plant_that_does_not_come_to_rest_is_refused():
    model = shared.benchmark(3)
    undamped = replace(model, modes=replace(model.modes, damping_ratio=np.zeros(2)))
    mirror = replace(undamped.loop.mirror, damping_ratio=0.0)
    undamped = replace(undamped, loop=replace(undamped.loop, mirror=mirror))
    with pytest.raises(UnstableError, match="damping"):
        performance_limit(undamped, BENCHMARK)


def test_structural_modes_that_only_the_mirror_damps_are_resolved():
    model = shared.truss(0.2, bays=3)
    values = []
    for ratio in (0.0, 1e-10):
        damped = replace(
            model, modes=replace(model.modes, damping_ratio=np.full_like(model.modes.damping_ratio, ratio))
        )
        values.append(performance_limit(damped, TRUSS).bound.value)
    # A damping of 1e-10 changes the poles, whose damping by the mirror is a thousand times larger.
    assert values[0] == pytest.approx(values[1], rel=1e-6)


def test_least_squares_without_a_solution_are_a_solver_error(monkeypatch):
    def fails(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr("numpy.linalg.lstsq", fails)
    with pytest.raises(SolverError, match="damping"):
        performance_limit(shared.benchmark(3), BENCHMARK)


@pytest.mark.parametrize(
    ("disturbances", "match"),
    [
        ((), "no disturbance"),
        ((Disturbance("d", "line_of_sight", white(1e-6)), NOISE), "infinite variance"),
        ((Disturbance("f", "hub_torque", low_pass(10.0, 1.0)), NOISE), "unbounded drift"),
    ],
)
def test_disturbances_without_a_limit_are_refused(disturbances, match):
    with pytest.raises(ModelError, match=match):
        performance_limit(shared.benchmark(3), disturbances)


def test_a_drift_that_the_torque_can_hardly_reach_is_refused():
    # Both ends of the torque turn with the free body.
    model = placed("action on the structure", FREE).model
    with pytest.raises(ModelError, match="rounding"):
        performance_limit(model, (FORCE, NOISE))


@pytest.mark.parametrize("route", [logarithmic_limit, riccati_limit])
@pytest.mark.parametrize(
    ("name", "disturbances", "match"),
    [
        ("bicollocated", (*TRUSS[:3], replace(TRUSS[3], band=(0.0, 1e4))), "rational"),
        ("bicollocated", TRUSS[:3], "white"),
        ("sensor on the structure", TRUSS, "minimum-phase"),
        ("action on the structure", TRUSS, "minimum-phase"),
    ],
)
def test_the_special_forms_refuse_what_they_do_not_hold_for(route, name, disturbances, match):
    with pytest.raises(ModelError, match=match):
        route(placed(name).model, disturbances)


def test_a_riccati_equation_without_solution_is_a_solver_error(monkeypatch):
    def fails(*_, **__):
        raise np.linalg.LinAlgError("no stabilizing solution")

    monkeypatch.setattr("scipy.linalg.solve_continuous_are", fails)
    with pytest.raises(SolverError, match="performance_limit"):
        riccati_limit(shared.benchmark(3), BENCHMARK)


# Youla designs


@EVERY_CASE
def test_a_youla_design_comes_close_to_the_limit(case):
    model = shared.benchmark(case)
    rough, fine = (youla(model, BENCHMARK, order=n, ms=2.0, mt=2.0) for n in (6, 32))
    limit = fine.limit.bound.value
    assert limit < fine.jitter < rough.jitter
    assert fine.jitter < 1.01 * limit


def test_a_youla_design_of_the_truss_comes_close_to_the_limit():
    design = youla(shared.truss(0.2), TRUSS, ms=2.0, mt=2.0)
    assert 1 < design.jitter / design.limit.bound.value < 1.02


def test_the_discs_of_a_youla_design_hold_at_frequencies_it_was_not_made_for():
    model = shared.benchmark(2)
    free = youla(model, BENCHMARK)
    held = youla(model, BENCHMARK, ms=1.2, mt=1.1)
    assert free.complementary_peak > 1.2
    s = 1j * np.random.default_rng(0).permutation(np.geomspace(1e-2, 1e7, 5003))
    closed = held.complementary_sensitivity(s)
    assert np.abs(closed).max() <= 1.1 * (1 + 2e-4)
    assert np.abs(1 - closed).max() <= 1.2 * (1 + 2e-4)
    assert held.complementary_peak == pytest.approx(np.abs(closed).max(), rel=1e-3)
    assert held.jitter > free.jitter


@pytest.mark.parametrize(("ms", "mt"), [(1.003, inf), (inf, 1.1)])
def test_peaks_between_the_frequencies_of_a_disc_are_found_and_held(ms, mt, monkeypatch):
    monkeypatch.setattr("fosopt.relax.youla._GRID", 8)
    monkeypatch.setattr("fosopt.relax.youla._DENSER", 300)
    held = youla(shared.benchmark(2), BENCHMARK, order=16, ms=ms, mt=mt)
    assert held.sensitivity_peak <= ms * (1 + 5e-4)
    assert held.complementary_peak <= mt * (1 + 5e-4)


@pytest.mark.parametrize("case", [None, 2])
def test_the_controller_of_a_youla_design_leaves_the_jitter_it_states(case):
    model = shared.benchmark(case)
    design = youla(model, BENCHMARK, mt=1.1)
    w = np.concatenate([np.linspace(1e-3, 100, 40001), np.geomspace(100, 3e7, 60000)[1:]])
    points = model.points(1j * w)
    response = design.controller_response(points.s)
    kappa = model.loop.mirror.damping * points.s + model.loop.mirror.stiffness
    compliant = 1 + kappa * points.g.direct
    impedance = model.loop.mirror.inertia * points.s**2 * compliant + kappa
    total = 0.0
    for disturbance, numerator in ((FORCE, compliant), (DISPLACEMENT, impedance), (NOISE, -response)):
        density = disturbance.one_sided_psd(w) * np.abs(numerator / (impedance + response)) ** 2
        total += integrate.trapezoid(density, w) / (2 * pi)
    # Three decades above the loop a hundred-thousandth of the noise is left out.
    assert design.jitter == pytest.approx(sqrt(total), rel=1e-4, abs=0)


def test_the_loop_of_a_youla_design_is_stable():
    # Rigidly supported, G = 1/(J s² + c s + k): zeros of 1 − F are poles of K, and the loop has those of F alone.
    design = youla(shared.benchmark(None), (DISPLACEMENT, NOISE), order=8, mt=1.2)
    s = 1j * np.geomspace(1e-4, 1e7, 200_001)
    closed = design.complementary_sensitivity(s)
    # F is analytic to the right: what it is at any point there, Poisson's integral gives from the axis.
    for point in (30.0, 400.0, 5e3):
        kernel = point / (pi * (point**2 + np.abs(s) ** 2))
        mean = 2 * integrate.trapezoid(kernel * closed.real, np.abs(s))
        inside = design.complementary_sensitivity(np.array([point + 0j]))[0].real
        assert mean == pytest.approx(inside, rel=1e-3, abs=1e-4)


def test_a_youla_design_keeps_out_of_the_zeros_of_its_plant():
    model = placed("bicollocated").model
    moved = replace(model.loop, placement=replace(model.loop.placement, action="B5.rz", reaction="B1.rz"))
    model = LoopModel(moved, placed("action on the structure").model.modes, "tip")
    design = youla(model, TRUSS, order=24)
    zeros = design.limit.open_loop.zeros
    assert zeros.size
    assert np.abs(design.complementary_sensitivity(zeros)).max() < 1e-6
    assert design.jitter > design.limit.bound.value


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"ms": 0.9}, ModelError, "raise them"),
        ({"mt": 1.0}, ModelError, "raise them"),
        ({"order": 0}, ModelError, "basis"),
        ({"order": 2, "ms": 1.0001, "mt": 1.0001}, ModelError, "raise the limits"),
    ],
)
def test_youla_designs_that_cannot_be_are_refused(options, error, match):
    with pytest.raises(error, match=match):
        youla(shared.benchmark(1), BENCHMARK, **options)


def test_a_youla_design_needs_its_sensor_on_the_mirror():
    with pytest.raises(ModelError, match="sensor on the mirror"):
        youla(placed("sensor on the structure").model, TRUSS)
