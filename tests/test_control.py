"""The loop in closed form: controller, transfer functions, poles and state space against one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
from scipy import linalg

from fosopt.actuators import Mirror
from fosopt.control import (
    NUMERATORS,
    PID,
    Loop,
    Receptances,
    characteristic,
    closed_loop_poles,
    closed_loop_response,
    closed_loop_state_space,
    coupling,
    gain_for_crossover,
    loop_transfer,
    open_loop_poles,
    pid_response,
    plant_impedance,
    plant_state_space,
)
from fosopt.control import poles as pole_finder
from fosopt.control.poles import pole_condition
from fosopt.errors import ModelError
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances
from fosopt.modes import Hub

HZ, PORTS = reference.HZ, reference.PORTS
FREE = Hub("free")
# Terms of one transfer function are added with rounding of 1e-16 each and cancel by a factor of 1e3 at most.
ROUNDING = 1e-12

CONTROLLERS = {
    "ideal": {},
    "rolled off": {"rolloff_time": 1e-4},
    "without integral": {"ki": 0.0},
    "without derivative": {"kd": 0.0},
    "without derivative, rolled off": {"kd": 0.0, "rolloff_time": 1e-4},
    "rolled off, without integral": {"ki": 0.0, "rolloff_time": 3e-3},
}


def receptances(modes, s):
    return Receptances(modes.receptance(s, "tip", "tip"), modes.receptance(s, "hub", "tip"))


def truss_loop(percent, hub=reference.HELD, keep=slice(None), **pid):
    modes = reference.modes_of(reference.structure(), hub).keep(keep)
    return reference.loop_of(reference.mirror_of(reference.structure(), percent), **pid), modes


# --- formulas


def test_the_controller_is_proportional_integral_and_derivative():
    s = np.array([3j, 1 + 2j])
    assert pid_response(PID(2.0, 5.0, 7.0, 3.0), s) == pytest.approx(2 * (5 + 7 / s + 3 * s))
    filtered = pid_response(PID(2.0, 5.0, 7.0, 3.0, 0.1), s)
    assert filtered == pytest.approx(2 * (5 + 7 / s + 3 * s / (1 + 0.1 * s)))


def test_a_mirror_has_the_stiffness_and_damping_of_its_frequency_and_ratio():
    mirror = Mirror(0.3, 40.0, 0.02)
    assert mirror.stiffness == pytest.approx(0.3 * 1600)
    assert mirror.damping == pytest.approx(2 * 0.02 * 40 * 0.3)
    loop = Loop(mirror, PID(1, 1, 1, 1))
    assert coupling(loop, 2j) == pytest.approx(mirror.damping * 2j + mirror.stiffness)


@pytest.mark.parametrize("name", ["inertia", "natural_frequency", "damping_ratio"])
@pytest.mark.parametrize("value", [-1.0, float("nan")])
def test_a_mirror_with_a_negative_or_undefined_quantity_is_refused(name, value):
    with pytest.raises(ModelError, match=f"mirror: {name} {value} is negative or not a number"):
        replace(Mirror(1.0, 1.0, 1.0), **{name: value})


@pytest.mark.parametrize("pid", CONTROLLERS.values(), ids=CONTROLLERS)
def test_at_the_crossover_the_loop_of_the_rigidly_supported_mirror_has_gain_one(pid):
    mirror, crossover = Mirror(0.4, 20 * HZ, 0.01), 230 * HZ
    terms = {"kp": 600.0, "ki": 5e4, "kd": 1.0, "rolloff_time": 0.0} | pid
    loop = Loop(mirror, PID(gain_for_crossover(crossover, mirror, **terms), **terms))
    rigid = Receptances(0.0, 0.0)
    assert abs(loop_transfer(loop, 1j * crossover, rigid)) == pytest.approx(1.0, rel=1e-13, abs=0)


def coupled_solve(loop, modes, s, torques):
    """(θ_m, θ_port) from the equations of motion in modal coordinates and mirror angle, loop open."""
    h = modes.at("tip")
    kappa = coupling(loop, s)
    n = h.size
    Z = np.zeros((n + 1, n + 1), complex)
    Z[:n, :n] = np.diag(s**2 + modes.damping * s + modes.stiffness) + kappa * np.outer(h, h)
    Z[:n, n] = Z[n, :n] = -kappa * h
    Z[n, n] = loop.mirror.inertia * s**2 + kappa
    q = linalg.solve(Z, np.concatenate([h * torques[0] + modes.at("hub") * torques[1], [torques[2]]]))
    return q[n], h @ q[:n]


@pytest.mark.parametrize("s", [30j, -3 + 200j, 50 + 10j])
def test_the_closed_form_of_the_plant_is_that_of_the_equations_of_motion(s):
    loop, modes = truss_loop(0.2)
    g = receptances(modes, np.array([s]))
    # A control torque acts on the mirror and reacts on its port.
    by_control = coupled_solve(loop, modes, s, (-1.0, 0.0, 1.0))[0]
    assert 1 / plant_impedance(loop, s, g)[0] == pytest.approx(by_control, rel=ROUNDING * 100, abs=0)
    K, delta = pid_response(loop.controller, s), characteristic(loop, s, g)[0]
    for name, torques in (("mirror_torque", (0.0, 0.0, 1.0)), ("hub_torque", (0.0, 1.0, 0.0))):
        opened = coupled_solve(loop, modes, s, torques)[0]
        closed = opened / (1 + K * by_control)
        assert closed_loop_response(name, loop, s, g)[0] == pytest.approx(closed, rel=ROUNDING * 100, abs=0)
    assert delta == pytest.approx(1 / by_control + K, rel=ROUNDING * 100, abs=0)


def test_sensitivity_and_complementary_sensitivity_add_up_to_one():
    loop, modes = truss_loop(0.2)
    s = 1j * np.geomspace(0.1, 1e5, 200)
    g = receptances(modes, s)
    L = loop_transfer(loop, s, g)
    S = closed_loop_response("line_of_sight", loop, s, g)
    T = closed_loop_response("command", loop, s, g)
    assert np.abs(S + T - 1).max() < ROUNDING
    assert np.abs(S * (1 + L) - 1).max() < ROUNDING
    assert np.abs(T / L - S).max() < ROUNDING
    assert np.array_equal(closed_loop_response("sensor_noise", loop, s, g), -T)


@pytest.mark.parametrize("hub", [reference.HELD, FREE], ids=["held", "free"])
def test_zeros_of_the_plant_are_the_poles_of_the_uncoupled_structure(hub):
    loop, modes = truss_loop(2.0, hub, slice(0, 7))
    plant = plant_state_space(loop, modes, "tip")
    n = plant.a.shape[0]
    pencil = np.block([[plant.a, plant.b[:, [0]]], [plant.c[[0]], np.zeros((1, 1))]])
    unit = np.zeros((n + 1, n + 1))
    unit[:n, :n] = np.eye(n)
    zeros = linalg.eigvals(pencil, unit)
    zeros = zeros[np.isfinite(zeros) & (np.abs(zeros) < 1e6)]
    open_loop = open_loop_poles(loop, modes, "tip")
    expected = np.concatenate([open_loop.first, open_loop.second])
    elastic, found = expected[np.abs(expected) > 1e-3], zeros[np.abs(zeros) > 1e-3]
    assert reference.worst_match(found, elastic) < 1e-6  # the pencil is not scaled
    # And the closed form agrees: the plant vanishes in proportion to the distance from such a pole.
    s = elastic[:1] * (1 + np.array([1e-6, 1e-7]))
    small = 1 / plant_impedance(loop, s, receptances(modes, s))
    assert small[0] / small[1] == pytest.approx(10, rel=1e-3, abs=0)


# --- state space


@pytest.mark.parametrize("hub", [reference.HELD, FREE], ids=["held", "free"])
@pytest.mark.parametrize("pid", CONTROLLERS.values(), ids=CONTROLLERS)
def test_the_state_space_has_the_frequency_response_of_the_closed_form(hub, pid):
    loop, modes = truss_loop(0.2, hub, slice(0, 12), **pid)
    system = closed_loop_state_space(loop, modes, "tip")
    s = 1j * np.array([0.05, 3.0, 44.0, 127.0, 1500.0, 2e4])
    g = receptances(modes, s)
    unit = np.eye(system.a.shape[0])
    response = np.array([system.c @ linalg.solve(x * unit - system.a, system.b) + system.d for x in s])
    T = closed_loop_response("command", loop, s, g)
    assert system.inputs == tuple(NUMERATORS)
    angle, sight = (system.outputs.index(name) for name in ("mirror_angle", "line_of_sight"))
    for i, name in enumerate(system.inputs):
        expected = closed_loop_response(name, loop, s, g)
        # The solve loses digits with the condition of the unscaled matrix, 1e4 or so.
        assert np.abs(response[:, sight, i] - expected).max() < 1e-9 * np.abs(expected).max()
        inertial = -T if name == "line_of_sight" else expected
        assert np.abs(response[:, angle, i] - inertial).max() < 1e-9 * np.abs(inertial).max()


def test_the_size_of_the_state_space_counts_what_the_controller_has():
    modes = reference.modes_of(reference.structure()).keep(slice(0, 7))
    mirror = reference.mirror_of(reference.structure(), 0.2)
    sizes = [
        closed_loop_state_space(reference.loop_of(mirror, **pid), modes, "tip").a.shape[0]
        for pid in CONTROLLERS.values()
    ]
    assert sizes == [17, 18, 16, 17, 17, 17]


# --- poles


def dense_poles(loop, modes, drifting=False):
    """Eigenvalues of the balanced state matrix, without a free rigid body's double zero."""
    a = closed_loop_state_space(loop, modes, "tip").a
    found = linalg.eigvals(linalg.matrix_balance(a)[0])
    return found[np.argsort(np.abs(found))][2 * drifting :]


def dense_error(loop, modes):
    """How far eigenvalues of the state matrix are from true ones: rounding of its balanced size."""
    balanced = linalg.matrix_balance(closed_loop_state_space(loop, modes, "tip").a)[0]
    return 1e-16 * linalg.norm(balanced)


@pytest.mark.parametrize("pid", CONTROLLERS.values(), ids=CONTROLLERS)
def test_poles_of_random_loops_are_the_eigenvalues_of_their_state_matrix(pid):
    rng = np.random.default_rng(5)
    unstable = 0
    for _ in range(60):
        loop, modes = reference.random_loop(rng, **pid)
        poles = closed_loop_poles(loop, modes, "tip")
        expected = dense_poles(loop, modes)
        assert poles.all.size == expected.size
        apart = np.abs(poles.all[:, None] - expected)
        # A factor for the condition of eigenvalues of matrices that are far from normal.
        allowed = 1e-9 * np.abs(expected) + 1e4 * dense_error(loop, modes)
        assert np.all(apart.min(axis=0) <= allowed)
        assert np.all(apart.min(axis=1) <= allowed[np.argmin(apart, axis=1)])
        rightmost = expected.real.max()
        assert abs(poles.spectral_abscissa - rightmost) <= allowed.max()
        unstable += poles.spectral_abscissa > 0
    # Without integral action the controller is a spring and damper, and J̄_k > 0 makes the plant passive.
    assert unstable == 0 if pid.get("ki") == 0 else unstable >= 3


@pytest.mark.parametrize("hub", [reference.HELD, FREE], ids=["held", "free"])
@pytest.mark.parametrize("percent", [2e-6, 0.02, 2.0, 1000.0])
def test_poles_of_the_truss_are_the_eigenvalues_of_its_state_matrix(hub, percent):
    loop, modes = truss_loop(percent, hub)
    poles = closed_loop_poles(loop, modes, "tip")
    drifting = hub.type == "free"
    expected = dense_poles(loop, modes, drifting)
    assert poles.open_loop.drifting == drifting
    assert poles.all.size == expected.size == 2 * 61 + 3 - 2 * drifting
    # Dense eigenvalues are the less accurate side: 1e-16 of the matrix over the smallest pole.
    assert reference.worst_match(poles.all, expected) < 1e-7


@pytest.mark.parametrize("pid", CONTROLLERS.values(), ids=CONTROLLERS)
def test_the_sum_of_all_poles_is_the_trace_of_the_state_matrix(pid):
    loop, modes = truss_loop(0.2, **pid)
    poles = closed_loop_poles(loop, modes, "tip")
    trace = np.trace(closed_loop_state_space(loop, modes, "tip").a)
    assert np.sum(poles.all).real == pytest.approx(trace, rel=1e-11, abs=0)
    assert abs(np.sum(poles.all).imag) < 1e-9


def test_every_pole_is_a_zero_of_the_characteristic_function():
    loop, modes = truss_loop(0.2)
    poles = closed_loop_poles(loop, modes, "tip")
    g = Receptances(*(pair.value for pair in poles.receptances().values[:2]))
    # Rounding of Δ itself, amplified by the ratio of the pole to its shift in κ g.
    assert pole_condition(loop, poles.value, g).max() < 1e-9
    away = poles.value * 1.001
    assert pole_condition(loop, away, receptances(modes, away)).min() > 1e-5


def test_receptances_and_slopes_at_poles_are_those_of_the_modal_sum():
    loop, modes = truss_loop(2.0, keep=slice(0, 7))
    poles = closed_loop_poles(loop, modes, "tip")
    g = poles.receptances()
    s = poles.value
    step = 1e-4 * np.abs(poles.shift)
    expected = receptances(modes, s)
    up, down = receptances(modes, s + step), receptances(modes, s - step)
    for part in ("direct", "cross"):
        assert np.abs(getattr(g, part).value / getattr(expected, part) - 1).max() < 1e-8
        difference = (getattr(up, part) - getattr(down, part)) / (2 * step)
        assert np.abs(getattr(g, part).slope / difference - 1).max() < 1e-5


@pytest.mark.parametrize("shape", [1e-3, 1e-6, 1e-9])
def test_the_shift_of_a_nearly_cancelled_mode_keeps_its_digits_however_small(shape):
    loop, modes = truss_loop(0.2, keep=slice(0, 7))
    weak = modes.mode_shape.copy()
    weak[4] *= shape
    modes = replace(modes, mode_shape=weak)
    poles = closed_loop_poles(loop, modes, "tip")
    zeta, omega = modes.damping_ratio[4], modes.natural_frequency[4]
    p = omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
    # To first order in φ²: Δ without the mode, plus J s² κ φ²/((s − p)(s − p̄)), is zero.
    others = modes.keep([0, 1, 2, 3, 5, 6])
    rest = characteristic(loop, p, Receptances(others.receptance(np.array([p]), "tip", "tip")[0], 0.0))
    h = modes.at("tip")[4]
    first_order = -loop.mirror.inertia * p**2 * coupling(loop, p) * h**2 / (rest * 2j * p.imag)
    at = np.argmin(np.abs(poles.base - p))
    # The second order is smaller by the shift over the distance to the axis and to other poles.
    second = 50 * abs(first_order / p)
    assert poles.shift[at] == pytest.approx(first_order, rel=second + 1e-11, abs=0)


def test_a_mode_with_a_node_at_the_mirror_stays_where_it_is_and_is_counted():
    loop, modes = truss_loop(0.2, keep=slice(0, 7))
    shape = modes.mode_shape.copy()
    shape[3, 1] = 0.0
    modes = replace(modes, mode_shape=shape)
    poles = closed_loop_poles(loop, modes, "tip")
    zeta, omega = modes.damping_ratio[3], modes.natural_frequency[3]
    own = omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
    assert poles.open_loop.uncoupled == pytest.approx([own, own.conjugate()])
    assert reference.worst_match(poles.all, dense_poles(loop, modes)) < 1e-7
    undamped = replace(modes, damping_ratio=np.where(np.arange(7) == 3, 0.0, modes.damping_ratio))
    assert closed_loop_poles(loop, undamped, "tip").spectral_abscissa == 0.0


@pytest.mark.parametrize("ratio", [0.999999, 1.0, 1.000001, 1.5, 40.0])
def test_poles_of_a_hub_loop_damped_to_and_beyond_the_critical_are_found(ratio):
    loop, modes = truss_loop(0.2, Hub("held", 0.3 * HZ, ratio), slice(0, 7))
    poles = closed_loop_poles(loop, modes, "tip")
    # Two poles that almost coincide move as the square root of rounding.
    assert reference.worst_match(poles.all, dense_poles(loop, modes)) < 1e-5
    real = poles.value[poles.multiplicity == 1]
    assert np.all(real.imag == 0)


def test_poles_are_found_where_two_structural_frequencies_coincide():
    loop, modes = truss_loop(0.2, keep=slice(0, 7))
    frequency = modes.natural_frequency.copy()
    for gap in (1e-3, 1e-6, 1e-9, 0.0):
        frequency[4] = frequency[3] * (1 + gap)
        twins = replace(modes, natural_frequency=frequency.copy())
        poles = closed_loop_poles(loop, twins, "tip")
        assert reference.worst_match(poles.all, dense_poles(loop, twins)) < 1e-6
    # At gap zero the two act as one mode, with the receptances of their sum.
    g = poles.receptances()
    expected = receptances(twins, poles.value)
    assert np.abs(g.direct.value / expected.direct - 1).max() < 1e-6
    assert np.abs(g.cross.value / expected.cross - 1).max() < 1e-6


def test_jitter_is_smooth_as_two_structural_frequencies_meet():
    loop, modes = truss_loop(0.2, keep=slice(0, 7))
    frequency = modes.natural_frequency.copy()
    values = []
    for gap in (0.0, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8):
        frequency[4] = frequency[3] * (1 + gap)
        twins = replace(modes, natural_frequency=frequency.copy())
        poles = closed_loop_poles(loop, twins, "tip")
        found = jitter_variances(LoopModel(loop, twins, "tip"), poles, reference.DISTURBANCES)
        values.append([variance.value for variance in found])
    change = np.array(values)[1:] / np.array(values)[0] - 1
    # In proportion to the gap, as far down as the gap is more than rounding.
    assert np.abs(change[-1]).max() < 1e-6
    assert np.abs(change[:-1] - change[-1] * 10.0 ** np.arange(-5, 0)[:, None]).max() < 1e-11


def test_poles_of_a_mirror_on_a_structure_without_a_mode_that_moves_it_are_those_on_a_rigid_support():
    loop, modes = reference.benchmark(None)
    poles = closed_loop_poles(loop, modes, "tip")
    m, c = loop.mirror, loop.controller
    rigid = np.roots([m.inertia, m.damping + c.gain * c.kd, m.stiffness + c.gain * c.kp, c.gain * c.ki])
    assert reference.worst_match(poles.all[np.abs(poles.all) > 10], rigid) < 1e-9


@pytest.mark.parametrize("percent", [0.002, 0.2, 2.0])
def test_poles_of_truss_loops_are_found_without_a_dense_eigenvalue_solver(percent, monkeypatch):
    def refuse(*_):
        raise AssertionError("Aberth's method gave up")

    monkeypatch.setattr(pole_finder, "_dense", refuse)
    for keep in (slice(0, 7), slice(None)):
        loop, modes = truss_loop(percent, keep=keep)
        closed_loop_poles(loop, modes, "tip")


def test_a_set_of_poles_with_one_missing_or_found_twice_is_noticed_and_found_anew(monkeypatch):
    loop, modes = truss_loop(0.2, keep=slice(0, 7))
    right = closed_loop_poles(loop, modes, "tip")
    once = np.array([0, 1, 2, 3, 4, 5, 6, 8])
    twice = np.array([0, 0, 2, 3, 4, 5, 6, 7, 8])
    assert right.value.size == 9
    aberth = pole_finder._aberth
    for chosen in (once, twice):
        wrong = [
            replace(
                right,
                base=right.base[chosen],
                shift=right.shift[chosen],
                multiplicity=right.multiplicity[chosen],
            )
        ]
        with monkeypatch.context() as patched:
            patched.setattr(pole_finder, "_aberth", lambda *a, w=wrong: w.pop() if w else aberth(*a))
            found = closed_loop_poles(loop, modes, "tip")
        assert not wrong
        assert reference.worst_match(found.all, right.all) < 1e-9


# --- the dissertation's verdicts


@pytest.mark.parametrize("kept", [7, 61])
def test_the_loops_of_table_4_1_are_stable_and_unstable_as_printed(dissertation, kept):
    table = dissertation["table_4_1"]
    for percent in (*table["stable"], *table["unstable"]):
        loop, modes = truss_loop(percent, keep=slice(0, kept))
        abscissa = closed_loop_poles(loop, modes, "tip").spectral_abscissa
        assert (abscissa < 0) == (percent in table["stable"])


@pytest.mark.parametrize("kept", [7, 61])
@pytest.mark.parametrize("hub", [reference.HELD, FREE], ids=["held", "free"])
def test_at_two_percent_a_mode_at_18_hz_grows_slowly(kept, hub):
    loop, modes = truss_loop(2.0, hub, slice(0, kept))
    poles = closed_loop_poles(loop, modes, "tip")
    worst = poles.value[np.argmax(poles.value.real)]
    assert worst.imag / HZ == pytest.approx(18.2, abs=0.05)
    assert worst.real == pytest.approx(0.10, abs=0.005)


def test_of_the_benchmark_problems_of_chapter_3_only_the_second_is_unstable(dissertation):
    growing = [
        f"case_{case}"
        for case in (1, 2, 3, 4)
        if closed_loop_poles(*reference.benchmark(case), "tip").spectral_abscissa >= 0
    ]
    assert growing == dissertation["table_3_4"]["unstable"]
