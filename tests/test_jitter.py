"""Jitter against Lyapunov equations and plain quadrature, and what has none."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import inf

import control
import numpy as np
import pytest
import reference
from scipy import integrate, linalg

from fosopt.actuators import Mirror
from fosopt.control import (
    PID,
    Loop,
    closed_loop_poles,
    closed_loop_response,
    closed_loop_state_space,
)
from fosopt.errors import ModelError, UnstableError
from fosopt.metrics.disturbances import (
    Disturbance,
    ShapingFilter,
    band_pass,
    high_pass,
    low_pass,
    refuse_infinite_variance,
    white,
)
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances, resonance_quadrature
from fosopt.metrics.step import step_response
from fosopt.modes import Damping, Hub
from fosopt.problem import ModeSelection

HZ = reference.HZ
REDUCED = ModeSelection(count=7)
EACH = pytest.mark.parametrize("disturbance", reference.DISTURBANCES, ids=lambda d: d.at)


def variance(evaluation, disturbance, shift=0.0):
    return jitter_variances(evaluation.model, evaluation.poles, [disturbance], shift)[0].value


def shaped(evaluation, disturbance, shift=0.0):
    """State space from white noise through the shaping filter to the line of sight, its states balanced."""
    system = closed_loop_state_space(evaluation.design.loop, evaluation.modes, "tip")
    i, o = system.inputs.index(disturbance.at), system.outputs.index("line_of_sight")
    loop = control.ss(system.a, system.b[:, [i]], system.c[[o]], system.d[[o], [i]])
    shape = disturbance.filter
    both = loop * control.ss(control.tf(list(shape.numerator), list(shape.denominator)))
    a, (scale, _) = linalg.matrix_balance(both.A, permute=False, separate=True)
    a = a - shift * np.eye(a.shape[0])
    return control.ss(a, both.B / scale[:, None], both.C * scale, both.D)


def lyapunov_rms(system):
    """Root of C P Cᵀ with A P + P Aᵀ + B Bᵀ = 0."""
    gramian = linalg.solve_continuous_lyapunov(system.A, -system.B @ system.B.T)
    return np.sqrt((system.C @ gramian @ system.C.T).item())


def response(evaluation, name, frequency):
    model = evaluation.model
    s = 1j * np.atleast_1d(frequency)
    return closed_loop_response(name, model.loop, s, model.points(s).g)


def by_quad(evaluation, disturbance, low, high):
    """Variance by adaptive quadrature over ordinary frequency, cut at resonances and table rows [rad²]."""
    poles = evaluation.poles.all
    poles = poles[poles.imag > 0]
    edges = (poles.imag[:, None] + np.abs(poles.real)[:, None] * np.array([-50, -5, 0, 5, 50])).ravel()
    rows = disturbance.frequency if disturbance.frequency is not None else np.zeros(0)
    edges = np.concatenate([edges, rows, np.geomspace(max(low, 1e-4), high, 40), [low, high]])
    edges = np.unique(edges[(edges >= low) & (edges <= high)])

    def density(w):
        return float(
            np.abs(response(evaluation, disturbance.at, w))[0] ** 2
            * disturbance.one_sided_psd(np.array([w]))[0]
            / HZ
        )

    return sum(integrate.quad(density, a, b, epsrel=1e-9, epsabs=0)[0] for a, b in pairwise(edges))


# --- jitter


@EACH
@pytest.mark.parametrize("percent", [0.002, 0.02, 0.2])
def test_jitter_over_all_frequencies_is_that_of_the_lyapunov_equation(disturbance, percent):
    evaluation = reference.evaluation(percent=percent)
    expected = lyapunov_rms(shaped(evaluation, disturbance))
    # Order 130 with poles from 0.4 to 1e4 rad/s, balanced: eight digits or so.
    assert np.sqrt(variance(evaluation, disturbance)) == pytest.approx(expected, rel=1e-6, abs=0)


# python-control's norm gives up when rounding leaves a Gramian with a negative eigenvalue, as behind a hub torque.
@pytest.mark.parametrize("at", ["mirror_torque", "line_of_sight", "sensor_noise"])
def test_jitter_over_all_frequencies_is_the_norm_python_control_gives(at):
    disturbance = next(d for d in reference.DISTURBANCES if d.at == at)
    evaluation = reference.evaluation(selection=REDUCED, damping=Damping((0.05,)))
    system = shaped(evaluation, disturbance)
    if at == "sensor_noise":
        # Here too, yet the variance itself is not touched by it.
        gramian = control.lyap(system.A, system.B @ system.B.T)
        expected = np.sqrt((system.C @ gramian @ system.C.T).item())
    else:
        expected = control.norm(system, 2)
    assert np.sqrt(variance(evaluation, disturbance)) == pytest.approx(expected, rel=1e-7, abs=0)


@EACH
def test_jitter_over_all_frequencies_is_what_plain_quadrature_of_the_spectrum_gives(disturbance):
    evaluation = reference.evaluation(selection=REDUCED)
    expected = by_quad(evaluation, disturbance, 0.0, 1e6)
    # Beyond 1e6 rad/s |H F|² falls with the square of frequency or faster; beyond 1e13 less than 1e-10 is left.
    tail = by_quad(evaluation, disturbance, 1e6, 1e13)
    assert variance(evaluation, disturbance) == pytest.approx(expected + tail, rel=2e-7, abs=0)


@EACH
@pytest.mark.parametrize("hub", [reference.HELD, Hub("free")], ids=["held", "free"])
def test_jitter_over_a_band_is_what_plain_quadrature_of_the_band_gives(disturbance, hub):
    evaluation = reference.evaluation(selection=REDUCED, hub=hub)
    low, high = 0.5 * HZ, 60 * HZ
    banded = replace(disturbance, band=(low, high))
    expected = by_quad(evaluation, disturbance, low, high)
    assert variance(evaluation, banded) == pytest.approx(expected, rel=1e-8, abs=0)


@EACH
def test_variances_over_adjacent_bands_add_up(disturbance, evaluation):
    edges = (0.0, 0.3 * HZ, 5 * HZ, 64.1 * HZ, inf)
    parts = [variance(evaluation, replace(disturbance, band=band)) for band in pairwise(edges)]
    assert sum(parts) == pytest.approx(variance(evaluation, disturbance), rel=1e-8, abs=0)


@EACH
def test_a_spectrum_table_counts_what_lies_between_its_rows(disturbance):
    evaluation = reference.evaluation(selection=REDUCED)
    frequency = np.array([2.0, 30.0, 31.0, 400.0, 3000.0])
    psd = np.array([1e-3, 5e-3, 5e-3, 1e-4, 0.0])
    table = Disturbance("table", disturbance.at, frequency=frequency, psd=psd)
    expected = by_quad(evaluation, table, 2.0, 3000.0)
    assert variance(evaluation, table) == pytest.approx(expected, rel=1e-8, abs=0)
    narrowed = replace(table, band=(10.0, 100.0))
    assert narrowed.counted == (10.0, 100.0)
    assert variance(evaluation, narrowed) == pytest.approx(
        by_quad(evaluation, table, 10.0, 100.0), rel=1e-8, abs=0
    )


def test_a_spectrum_table_is_linear_between_rows_and_zero_outside():
    table = Disturbance("t", "hub_torque", frequency=np.array([1.0, 3.0]), psd=np.array([4.0, 8.0]))
    assert table.one_sided_psd(np.array([0.5, 1.0, 2.5, 3.0, 3.1])) == pytest.approx([0, 4, 7, 8, 0])
    assert table.counted == (1.0, 3.0)


REPEATED = {
    "double": np.poly([-40.0, -40.0]),
    "triple": np.poly([-40.0] * 3),
    "quadruple": np.poly([-40.0] * 4),
    "double pair": np.poly([-30 + 40j, -30 - 40j] * 2).real,
    "nearly double": np.poly([-40.0, -40.0 * (1 + 1e-5)]),
    "nearly triple": np.poly([-40.0, -40.0 * (1 + 1e-3), -40.0 * (1 - 1e-3)]),
}


@EACH
@pytest.mark.parametrize("denominator", REPEATED.values(), ids=REPEATED)
def test_a_filter_with_repeated_poles_gives_the_jitter_of_its_lyapunov_equation(disturbance, denominator):
    evaluation = reference.evaluation(selection=REDUCED)
    repeated = replace(disturbance, filter=ShapingFilter((1.0, 7.0), tuple(float(c) for c in denominator)))
    expected = lyapunov_rms(shaped(evaluation, repeated))
    assert np.sqrt(variance(evaluation, repeated)) == pytest.approx(expected, rel=1e-6, abs=0)


def test_a_filter_pole_that_meets_a_pole_of_the_loop_does_no_harm():
    evaluation = reference.evaluation(selection=REDUCED)
    poles = evaluation.poles.value
    real = poles[poles.imag == 0].real
    assert real.size
    for offset in (1e-3, 1e-6, 1e-9):
        meeting = Disturbance(
            "meeting", "mirror_torque", ShapingFilter((1.0,), (1.0, float(-real[0] * (1 + offset))))
        )
        expected = lyapunov_rms(shaped(evaluation, meeting))
        assert np.sqrt(variance(evaluation, meeting)) == pytest.approx(expected, rel=1e-6, abs=0)


@EACH
def test_shifted_jitter_is_that_of_poles_moved_left_by_the_shift(disturbance):
    evaluation = reference.evaluation(percent=2.0)
    assert evaluation.poles.spectral_abscissa > 0
    shift = 2.0
    expected = lyapunov_rms(shaped(evaluation, disturbance, shift))
    assert np.sqrt(variance(evaluation, disturbance, shift)) == pytest.approx(expected, rel=1e-6, abs=0)


@pytest.mark.parametrize(
    "whole",
    [
        *reference.DISTURBANCES[:2],
        *(Disturbance("white", at, white(1e-3)) for at in ("mirror_torque", "hub_torque")),
    ],
    ids=lambda d: f"{d.name} {d.at}",
)
def test_shifted_jitter_over_a_band_that_leaves_nothing_out_is_the_same(whole):
    # Torques move the line of sight as 1/s² or less at high frequency; beyond 1e6 rad/s nothing is left.
    evaluation, shift = reference.evaluation(percent=2.0), 2.0
    expected = variance(evaluation, whole, shift)
    assert variance(evaluation, replace(whole, band=(0.0, 1e6)), shift) == pytest.approx(
        expected, rel=1e-8, abs=0
    )


@EACH
def test_shifted_jitter_of_a_stable_loop_is_its_jitter_as_the_shift_goes_to_zero(disturbance, evaluation):
    values = np.array([variance(evaluation, disturbance, s) for s in (1e-5, 1e-6, 0.0)])
    assert abs(values[1] / values[2] - 1) < 1e-3
    assert values[0] - values[2] == pytest.approx(10 * (values[1] - values[2]), rel=1e-2, abs=0)


def test_total_jitter_is_the_root_of_the_sum_of_squares(evaluation):
    parts = [evaluation.value(f"jitter_{d.name}") for d in reference.DISTURBANCES]
    assert evaluation.value("jitter_total") == pytest.approx(
        np.sqrt(np.sum(np.square(parts))), rel=1e-14, abs=0
    )


def test_jitter_is_proportional_to_the_disturbance(evaluation):
    one = Disturbance("one", "hub_torque", low_pass(5 * HZ, 1.0))
    two = Disturbance("two", "hub_torque", low_pass(5 * HZ, 3.0))
    assert variance(evaluation, two) == pytest.approx(9 * variance(evaluation, one), rel=1e-12, abs=0)


def test_jitter_on_a_rigid_support_has_its_closed_form():
    # Δ = s² + c s + k with proportional and derivative action: ∫|1/Δ|² dω/2π = 1/(2 c k).
    loop = Loop(Mirror(1.0, 3.0, 0.1), PID(2.0, 10.0, 0.0, 5.0))
    _, modes = reference.benchmark(None)
    model = LoopModel(loop, modes, "tip")
    poles = closed_loop_poles(loop, modes, "tip")
    noise = Disturbance("white", "mirror_torque", white(np.sqrt(2)))
    found = jitter_variances(model, poles, [noise])[0].value
    assert found == pytest.approx(1 / (2 * (0.6 + 10.0) * (9 + 20.0)), rel=1e-12, abs=0)


@pytest.mark.parametrize("column", ["displacement", "noise"])
@pytest.mark.parametrize("case", [1, 3, 4])
def test_jitter_of_the_benchmark_problems_follows_table_3_4(dissertation, column, case):
    printed = dissertation["table_3_4"][column]
    # The spectra were published as figures; these filters are read from the table itself.
    disturbance = {
        "displacement": Disturbance("d", "line_of_sight", low_pass(8.5 * HZ, 1.0)),
        "noise": Disturbance("n", "sensor_noise", high_pass(70 * HZ, 1.0), band=(0.0, 2000 * HZ)),
    }[column]
    values = []
    for which in (None, case):
        loop, modes = reference.benchmark(which)
        poles = closed_loop_poles(loop, modes, "tip")
        values.append(jitter_variances(LoopModel(loop, modes, "tip"), poles, [disturbance])[0].value)
    found = np.sqrt(values[1] / values[0]) * printed["rigid"]
    assert found == pytest.approx(printed[f"case_{case}"], rel=0.01, abs=0)


# --- filters


@pytest.mark.parametrize(
    "shape",
    [low_pass(3.0, 0.7), low_pass(50.0, 0.7, 3), band_pass(3.0, 80.0, 0.7), band_pass(3.0, 80.0, 0.7, 2)],
    ids=["low 1", "low 3", "band 1", "band 2"],
)
def test_a_filter_of_given_rms_has_that_rms(shape):
    d = Disturbance("d", "hub_torque", shape)
    edges = np.concatenate([[0.0], np.geomspace(1e-3, 1e10, 61)])
    power = sum(
        integrate.quad(lambda w: float(d.one_sided_psd(np.array([w]))[0]) / HZ, a, b, epsrel=1e-10)[0]
        for a, b in pairwise(edges)
    )
    assert np.sqrt(power) == pytest.approx(0.7, rel=2e-6, abs=0)
    assert all(p.real < 0 for p in shape.poles)


def test_filters_have_their_half_power_at_the_corner():
    for shape, corner, beyond in (
        (low_pass(20.0, 1.0, 2), 20.0, 1e-6),
        (high_pass(20.0, 1.0, 2), 20.0, 1e8),
    ):
        at, flat = np.abs(shape.response(1j * np.array([corner, beyond])))
        assert at / flat == pytest.approx(np.sqrt(0.5), rel=1e-9, abs=0)


def test_densities_are_one_sided_per_hertz():
    for shape in (white(3e-8), high_pass(5.0, 3e-8)):
        d = Disturbance("n", "sensor_noise", shape)
        assert np.sqrt(d.one_sided_psd(np.array([1e9]))) == pytest.approx([3e-8], rel=1e-12, abs=0)


def test_a_filter_knows_its_poles_zeros_and_degree():
    shape = ShapingFilter((2.0, 0.0, 0.0), (1.0, 3.0, 2.0, 0.5))
    assert (shape.relative_degree, shape.zeros_at_origin) == (1, 2)
    # Of zeros elsewhere there may be any number.
    assert ShapingFilter((2.0, 5.0, 1.0, 0.0), (1.0, 3.0, 2.0, 0.5)).zeros_at_origin == 1
    s = np.array([3 + 1j])
    partial = np.sum(shape.residues / (s - shape.poles))
    assert partial == pytest.approx(shape.response(s)[0], rel=1e-12, abs=0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ShapingFilter((1.0,), (1.0, -2.0)), "does not decay"),
        (lambda: ShapingFilter((1.0,), (1.0, 0.0)), "does not decay"),
        (lambda: ShapingFilter((), (1.0, 2.0)), "must be finite"),
        (lambda: ShapingFilter((1.0,), (0.0, 2.0)), "leading one that is not zero"),
        (lambda: ShapingFilter((float("nan"),), (1.0, 2.0)), "must be finite"),
        (lambda: Disturbance("d", "mirror_torqe", white(1.0)), "did you mean 'mirror_torque'"),
        (lambda: Disturbance("d", "hub_torque"), "either a shaping filter or a spectrum table"),
        (lambda: Disturbance("d", "hub_torque", white(1.0), band=(3.0, 2.0)), "lower edge must be below"),
        (lambda: Disturbance("d", "hub_torque", white(1.0), band=(-1.0, 2.0)), "band -1 to 2"),
    ],
)
def test_a_disturbance_that_cannot_be_is_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()


# --- what has no jitter


def test_an_unstable_loop_has_neither_jitter_nor_step_metrics():
    for keep in (REDUCED, ModeSelection()):
        evaluation = reference.evaluation(percent=2.0, rolloff_time=0.0, selection=keep)
        assert not evaluation.stable
        assert evaluation.value("spectral_abscissa") > 0
        for name in evaluation.system.metric_names:
            if name.startswith(("jitter_", "step_")):
                with pytest.raises(UnstableError, match="a pole has the real part"):
                    evaluation.value(name)
        with pytest.raises(UnstableError):
            step_response(evaluation.model, evaluation.poles, np.array([0.1]))


def test_no_random_loop_that_is_unstable_gets_a_number():
    rng = np.random.default_rng(11)
    verdicts = set()
    for _ in range(60):
        loop, modes = reference.random_loop(rng)
        poles = closed_loop_poles(loop, modes, "tip")
        model = LoopModel(loop, modes, "tip")
        system = closed_loop_state_space(loop, modes, "tip")
        stable = np.linalg.eigvals(linalg.matrix_balance(system.a)[0]).real.max() < 0
        verdicts.add(bool(stable))
        for disturbance in reference.DISTURBANCES:
            if stable:
                assert jitter_variances(model, poles, [disturbance])[0].value > 0
            else:
                with pytest.raises(UnstableError):
                    jitter_variances(model, poles, [disturbance])
    assert verdicts == {True, False}


def test_an_undamped_mode_that_the_loop_does_not_see_leaves_it_without_jitter(evaluation):
    modes = evaluation.modes
    shape, ratio = modes.mode_shape.copy(), modes.damping_ratio.copy()
    shape[5, 1], ratio[5] = 0.0, 0.0
    hidden = replace(modes, mode_shape=shape, damping_ratio=ratio)
    loop = evaluation.design.loop
    poles = closed_loop_poles(loop, hidden, "tip")
    with pytest.raises(UnstableError):
        jitter_variances(LoopModel(loop, hidden, "tip"), poles, [reference.DISTURBANCES[0]])


IDEAL = PID(1.0, 1.0, 1.0, 1.0)
FLOW = ShapingFilter((1.0, 0.0, 0.0), (1.0, 1.0))
WASHED, WASHED_TWICE = ShapingFilter((1.0, 0.0), (1.0, 2.0, 1.0)), ShapingFilter((1.0, 0, 0), (1.0, 3, 3, 1))
TABLE = Disturbance("d", "hub_torque", frequency=np.array([0.0, 5.0]), psd=np.array([0.0, 1.0]))


@pytest.mark.parametrize(
    ("disturbance", "controller", "drifting", "message"),
    [
        (Disturbance("d", "line_of_sight", white(1.0)), IDEAL, False, "does not fall off"),
        (Disturbance("d", "line_of_sight", high_pass(1.0, 1.0)), IDEAL, False, "does not fall off"),
        (Disturbance("d", "line_of_sight", low_pass(1.0, 1.0)), IDEAL, True, None),
        (Disturbance("d", "line_of_sight", white(1.0), band=(0.0, 9.0)), IDEAL, False, None),
        (Disturbance("d", "sensor_noise", white(1.0)), IDEAL, True, None),
        (Disturbance("d", "sensor_noise", FLOW), IDEAL, True, "fall off"),
        (
            Disturbance("d", "sensor_noise", FLOW),
            replace(IDEAL, rolloff_time=1.0),
            True,
            None,
        ),
        (
            Disturbance("d", "sensor_noise", FLOW),
            replace(IDEAL, kd=0.0),
            True,
            None,
        ),
        (Disturbance("d", "mirror_torque", white(1.0)), IDEAL, False, None),
        (Disturbance("d", "mirror_torque", white(1.0)), IDEAL, True, "unbounded drift"),
        (Disturbance("d", "hub_torque", low_pass(1.0, 1.0)), IDEAL, True, "unbounded drift"),
        (Disturbance("d", "hub_torque", low_pass(1.0, 1.0), band=(0.1, inf)), IDEAL, True, None),
        (Disturbance("d", "hub_torque", WASHED), IDEAL, True, None),
        (Disturbance("d", "hub_torque", WASHED), replace(IDEAL, ki=0.0), True, "unbounded drift"),
        (Disturbance("d", "hub_torque", WASHED_TWICE), replace(IDEAL, ki=0.0), True, None),
        (TABLE, IDEAL, True, "unbounded drift"),
        (TABLE, IDEAL, False, None),
        (replace(TABLE, band=(0.1, 9.0)), IDEAL, True, None),
        (replace(TABLE, at="line_of_sight"), IDEAL, True, None),
    ],
)
def test_infinite_variance_is_refused_and_nothing_else(disturbance, controller, drifting, message):
    loop = Loop(Mirror(1.0, 3.0, 0.1), controller)
    if message is None:
        refuse_infinite_variance(disturbance, loop, drifting)
    else:
        with pytest.raises(ModelError, match=message):
            refuse_infinite_variance(disturbance, loop, drifting)


def test_jitter_that_would_be_infinite_is_refused_and_not_computed():
    everywhere = Disturbance("white", "line_of_sight", white(1e-9))
    with pytest.raises(ModelError, match="infinite variance"):
        reference.evaluation(disturbances=(everywhere,)).value("jitter_white")
    pushed = Disturbance("push", "hub_torque", low_pass(5 * HZ, 1.0))
    with pytest.raises(ModelError, match="unbounded drift"):
        reference.evaluation(disturbances=(pushed,), hub=Hub("free")).value("jitter_total")


@pytest.mark.parametrize("ki", [5e4, 0.0], ids=["with integral", "without integral"])
def test_a_torque_reaches_the_line_of_sight_through_a_free_rigid_body_as_the_refusal_assumes(ki):
    mirror = reference.mirror_of(reference.structure(), 0.2)
    evaluation = reference.evaluation(hub=Hub("free"), loop=reference.loop_of(mirror, ki=ki))
    low = np.abs(response(evaluation, "hub_torque", [1e-5, 1e-6]))
    assert low[1] / low[0] == pytest.approx(10.0 if ki else 100.0, rel=1e-3, abs=0)
    # Washed out as often as needed, it has a jitter, and that is what quadrature gives.
    shape = WASHED if ki else WASHED_TWICE
    washed = Disturbance("washed", "hub_torque", shape)
    by_band = variance(evaluation, replace(washed, band=(1e-9, inf)))
    assert variance(evaluation, washed) == pytest.approx(by_band, rel=1e-6, abs=0)


# --- quadrature


def test_the_quadrature_integrates_resonances_however_narrow():
    for width in (1.0, 0.02, 1e-4, 1e-7):
        # Real poles far apart share the panels about zero with the slowest of them.
        poles = np.array([-width + 40j, -0.2 + 90j, -5.0, -1e-3, -4000.0])
        nodes, weights = resonance_quadrature(poles, 0.0, inf, np.zeros(0))
        # ∫ σ/((ω − ω₀)² + σ²) dω over the half line, in closed form.
        values = sum(-p.real / ((nodes - p.imag) ** 2 + p.real**2) for p in poles)
        expected = sum(np.pi / 2 - np.arctan(-p.imag / -p.real) for p in poles)
        # Beside the rule's own error, a node's distance from the resonance is rounded as the frequency is.
        within = 1e-11 + np.finfo(float).eps * 40 / width
        assert weights @ values == pytest.approx(expected, rel=within, abs=0)
