"""State spaces of second-order equations, their exact response to input histories, and masses added to modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference

from fosopt.control import second_order_state_space, structure_state_space
from fosopt.control.time_response import time_response
from fosopt.errors import ModelError
from fosopt.modes import Damping, Hub, ModalSet, modal_frame, reduced_matrices
from fosopt.modes.added_mass import with_added_mass
from fosopt.structure import assemble, barker_truss

DAMPING = Damping((0.001,))
FREE = Hub()
STATIONS = {"y20": ("B20", "y"), "y15": ("B15", "y"), "x20": ("B20", "x")}
PORTS = ("hub", "tip", *STATIONS)
# A matrix exponential of a system whose frequencies span a factor of 200, carried over 2000 steps, leaves 3e-14.
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def stations():
    truss = barker_truss()
    return assemble(replace(truss, ports={**truss.ports, **STATIONS}), "tip")


@pytest.fixture(scope="module")
def bare(stations):
    return modal_frame(stations, stations.area, stations.batten_mass, 0.0, "tip")


@pytest.fixture(scope="module")
def modes(bare):
    return bare.modal_set(FREE, DAMPING, PORTS)


def oscillator(frequency: float, ratio: float) -> ModalSet:
    rigid = np.array([frequency == 0])
    return ModalSet(np.array([frequency]), np.array([ratio]), np.array([[1.0, 0.5]]), ("in", "out"), rigid)


def test_all_modes_answer_a_torque_step_as_the_sum_of_their_closed_forms(modes):
    count, step = 2000, 1e-3
    time = step * np.arange(count)
    found = time_response(structure_state_space(modes, PORTS), "hub", np.ones(count), step, ("tip", "y15"))
    expected = np.zeros((count, 2))
    for k, (w, z) in enumerate(zip(modes.natural_frequency, modes.damping_ratio, strict=True)):
        if w == 0:
            q = time**2 / 2
        else:
            wd = w * np.sqrt(1 - z**2)
            q = (1 - np.exp(-z * w * time) * (np.cos(wd * time) + z * w / wd * np.sin(wd * time))) / w**2
        shape = np.array([modes.at("tip")[k], modes.at("y15")[k]])
        expected += np.outer(q, modes.at("hub")[k] * shape)
    assert np.abs(found - expected).max() < ROUNDING * np.abs(expected).max()


@pytest.mark.parametrize(("frequency", "ratio"), [(0.0, 0.0), (3.0, 0.0), (3.0, 0.2), (3.0, 1.0), (3.0, 2.0)])
def test_a_ramp_input_is_exact_however_long_the_step(frequency, ratio):
    # Linear between samples: steps of several periods land on the same curve as steps of a tenth of one.
    system = structure_state_space(oscillator(frequency, ratio), ("in", "out"))
    fine = time_response(system, "in", np.linspace(0, 8, 801), 0.01, ("out",))[::400]
    coarse = time_response(system, "in", np.array([0.0, 4.0, 8.0]), 4.0, ("out",))
    assert coarse == pytest.approx(fine, rel=1e-11, abs=1e-13)
    if frequency == 0:
        assert coarse[-1, 0] == pytest.approx(0.5 * 8.0**3 / 6, rel=1e-12, abs=0)


def test_a_corner_between_samples_is_cut_with_the_square_of_the_step():
    system = structure_state_space(oscillator(3.0, 0.01), ("in", "out"))

    def error(count):
        # Even counts put the corner of the sine's absolute value between two samples.
        time = np.linspace(0, 2, count)
        history = np.abs(np.sin(4 * (time - 0.7)))
        return time_response(system, "in", history, time[1], ("out",))[-1, 0]

    exact = error(20001)
    errors = np.abs([error(n) - exact for n in (101, 401)])
    assert errors[1] < errors[0] / 12


def test_an_unstable_or_drifting_system_is_carried_exactly():
    system = second_order_state_space(
        np.array([[2.0]]), np.zeros((1, 1)), np.array([[-8.0]]), {"p": np.ones(1)}
    )
    time = 0.1 * np.arange(30)
    found = time_response(system, "p", np.ones(30), 0.1, ("p",))[:, 0]
    assert found == pytest.approx((np.cosh(2 * time) - 1) / 8, rel=1e-12, abs=1e-15)


def test_a_second_order_state_space_has_the_frequency_response_of_its_matrices(modes):
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(3, 4, 4))
    m, c, k = (f @ f.T for f in factor)
    rows = {"p": rng.normal(size=4), "q": rng.normal(size=4)}
    system = second_order_state_space(m, c, k, rows)
    s = np.array([0.3j, 2.0 + 1.0j])
    found = system.response(s, "p", "q")
    expected = [rows["q"] @ np.linalg.solve(m * x**2 + c * x + k, rows["p"]) for x in s]
    assert found == pytest.approx(np.array(expected), rel=1e-10, abs=0)
    assert system.a.shape == (8, 8)


def test_a_reduced_model_keeps_the_response_of_its_modes_in_its_degrees_of_freedom(bare, modes):
    dofs = ["B20.y", "B15.y", "B20.x", "B20.rz", "B0.rz"]
    kept = [0, 1, 2, 3, 4]
    matrices = reduced_matrices(bare, modes, dofs, kept)
    system = second_order_state_space(*matrices, {dof: row for dof, row in zip(dofs, np.eye(5), strict=True)})
    s = 1j * reference.HZ * np.array([0.5, 7.0, 31.0, 60.0])
    found = system.response(s, "B0.rz", "B15.y")
    # cond φ of the chosen degrees of freedom is a few hundred.
    assert found == pytest.approx(modes.keep(kept).receptance(s, "hub", "y15"), rel=1e-9, abs=0)


def test_masses_added_to_all_modes_give_the_modes_of_the_heavier_structure(stations, modes):
    mass = reference.MIRROR_MASS
    heavy = modal_frame(stations, stations.area, stations.batten_mass, mass, "tip")
    expected = heavy.modal_set(FREE, DAMPING, PORTS)
    found = with_added_mass(modes, {"x20": mass, "y20": mass}, DAMPING)
    assert found.natural_frequency == pytest.approx(expected.natural_frequency, rel=1e-9, abs=1e-4)
    assert found.natural_frequency[0] == 0 and found.rigid[0] and not found.rigid[1:].any()
    assert found.damping_ratio == pytest.approx(expected.damping_ratio)
    # Shapes have a free sign; their products have none.
    s = 1j * reference.HZ * np.array([1.0, 6.0, 20.0, 300.0])
    for pair in (("tip", "tip"), ("hub", "y15")):
        assert found.receptance(s, *pair) == pytest.approx(expected.receptance(s, *pair), rel=1e-7, abs=0)


def test_a_mass_added_to_a_reduced_model_is_the_mass_on_its_matrix(bare, modes):
    # Eq. (2.47) adds to the mass matrix of the reduced model; modal coordinates must do the same.
    dofs = ["B20.y", "B15.y", "B20.x", "B20.rz", "B0.rz"]
    m, _, k = reduced_matrices(bare, modes, dofs, range(5))
    m[0, 0] += 50.0
    m[2, 2] += 50.0
    expected = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(m, k)).real).clip(0))
    found = with_added_mass(modes.keep(range(5)), {"y20": 50.0, "x20": 50.0}, DAMPING)
    assert found.natural_frequency[1:] == pytest.approx(expected[1:], rel=1e-8, abs=0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda m: with_added_mass(m, {"y2O": 1.0}, DAMPING), "port 'y2O' does not exist.*y20"),
        (lambda m: with_added_mass(m, {"y20": -1.0}, DAMPING), "-1.0 kg is no physical value"),
        (lambda m: with_added_mass(m, {"y20": float("nan")}, DAMPING), "nan kg is no physical value"),
        (
            lambda m: with_added_mass(
                ModalSet(np.ones(1), np.ones(1), np.ones((1, 1)), ("p",), np.ones(1, bool)), {}, DAMPING
            ),
            "held already",
        ),
        (
            lambda m: time_response(structure_state_space(m, PORTS), "hub", np.ones(3), 0.0, ("tip",)),
            "step 0.0 s is not above zero",
        ),
        (
            lambda m: time_response(structure_state_space(m, PORTS), "hub", np.ones(3), 1.0, ("tipp",)),
            "'tipp' does not exist.*tip",
        ),
        (
            lambda m: second_order_state_space(np.zeros((1, 1)), np.eye(1), np.eye(1), {"p": np.ones(1)}),
            "mass matrix is singular",
        ),
    ],
)
def test_bad_input_is_refused_with_the_way_out(modes, make, message):
    with pytest.raises(ModelError, match=message):
        make(modes)
