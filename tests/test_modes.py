"""Modal sets: normalization, truncation, repeated eigenvalues, and derivatives of receptances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference
from scipy import linalg

from fosopt.errors import ModelError
from fosopt.metrics.inertias import modal_inertia, reference_inertia
from fosopt.modes import (
    Damping,
    Hub,
    ModalSet,
    modal_frame,
    receptance_functional,
    reduced_matrices,
)
from fosopt.problem import ModeSelection
from fosopt.structure import (
    assemble,
    barker_truss,
    mass_matrix,
    mass_weights,
    stiffness_matrix,
    stiffness_weights,
)

HZ, HELD, DAMPING, PORTS = reference.HZ, reference.HELD, reference.DAMPING, reference.PORTS
# eigh leaves an error of some units in the last place of the largest eigenvalue; the spectrum of the truss
# spans a factor of 1e5 in eigenvalue, which takes 1e-15 to this.
EIGEN = 1e-9


def matrices(frame, mirror_mass=reference.MIRROR_MASS):
    s = frame.structure
    return stiffness_matrix(s, s.area), mass_matrix(s, s.area, s.batten_mass, mirror_mass)


def test_mode_shapes_are_mass_normalized_and_solve_the_eigenvalue_problem(frame3):
    K, M = matrices(frame3)
    shapes, eigenvalue = frame3.shapes, frame3.eigenvalue
    assert np.abs(shapes.T @ M @ shapes - np.eye(eigenvalue.size)).max() < 1e-11
    residual = np.abs(K @ shapes - M @ shapes * eigenvalue)
    assert residual.max() < 1e-12 * np.abs(K @ shapes).max()
    assert np.all(np.diff(eigenvalue) > 0)


def test_the_pinned_truss_has_one_rigid_mode_and_its_eigenvalue_is_zero_exactly(frame3, fem2):
    assert frame3.n_rigid == 1
    assert frame3.eigenvalue[0] == 0.0
    assert reference.frame(fem2).n_rigid == 0


def test_the_rigid_mode_turns_all_stations_alike_about_the_hub(frame3):
    turn = np.array([frame3.structure.port("hub"), frame3.structure.port("tip")]) @ frame3.shapes[:, 0]
    total = reference.inertia_of(frame3.structure) + reference.MIRROR_MASS * 7.07**2
    assert np.abs(turn) == pytest.approx(1 / np.sqrt(total), rel=1e-9, abs=0)


def test_the_reference_inertia_is_one_over_the_inverse_mass_matrix_at_the_port(frame3):
    modes = frame3.modal_set(HELD, DAMPING, PORTS)
    _, M = matrices(frame3)
    e = frame3.structure.port("tip")
    found = reference_inertia(modes, "tip")
    assert found == pytest.approx(1 / (e @ linalg.solve(M, e)), rel=1e-12, abs=0)
    assert 1 / found == pytest.approx(np.sum(1 / modal_inertia(modes, "tip")), rel=1e-12, abs=0)


def test_the_smallest_mirror_of_chapter_4_is_45_percent_of_the_reference_inertia(dissertation, frame3):
    modes = frame3.modal_set(HELD, DAMPING, PORTS)
    mirror = 0.002e-2 * reference.inertia_of(frame3.structure)
    printed = dissertation["chapter_4"]["two_thousandths_percent_over_reference_inertia"]
    # Two printed digits.
    assert mirror / reference_inertia(modes, "tip") == pytest.approx(printed, abs=0.01)


def test_uniform_damping_gives_every_elastic_mode_the_same_ratio():
    assert Damping((0.02,)).of(np.array([1.0, 10.0, 100.0])) == pytest.approx([0.02] * 3)


def test_damping_per_mode_repeats_the_last_ratio_for_the_modes_beyond():
    assert Damping((0.01, 0.03)).of(np.array([1.0, 2.0, 3.0, 4.0])) == pytest.approx([0.01, 0.03, 0.03, 0.03])


def test_a_damping_table_is_linear_between_its_rows_and_constant_outside():
    table = Damping((0.01, 0.03), (10.0, 20.0))
    assert table.of(np.array([1.0, 10.0, 15.0, 18.0, 50.0])) == pytest.approx([0.01, 0.01, 0.02, 0.026, 0.03])


def test_slopes_of_a_damping_table_are_divided_differences_and_derivatives_on_the_diagonal():
    table = Damping((0.01, 0.03), (10.0, 20.0))
    frequency = np.array([5.0, 12.0, 12.0, 18.0])
    slopes = table.slopes(frequency, table.of(frequency))
    inside = 0.02 / 10
    assert slopes[1:, 1:] == pytest.approx(np.full((3, 3), inside), rel=1e-6, abs=0)
    assert slopes[0, 0] == 0
    assert slopes[0, 1] == pytest.approx((0.014 - 0.01) / 7)
    assert slopes == pytest.approx(slopes.T)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Damping(()), "no ratio given"),
        (lambda: Damping((-0.1,)), "-0.1 is negative"),
        (lambda: Damping((float("nan"),)), "nan is negative or not finite"),
        (lambda: Damping((0.1, 0.2), (2.0, 1.0)), "must ascend"),
        (lambda: Damping((0.1, 0.2), (1.0,)), "must ascend, one ratio each"),
    ],
)
def test_damping_that_is_no_damping_is_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()


def test_a_held_hub_gives_the_rigid_mode_its_bandwidth_and_leaves_elastic_modes_alone(frame3):
    free = frame3.modal_set(Hub("free"), DAMPING, PORTS)
    held = frame3.modal_set(HELD, DAMPING, PORTS)
    assert (free.natural_frequency[0], free.damping_ratio[0]) == (0.0, 0.0)
    assert (held.natural_frequency[0], held.damping_ratio[0]) == (HELD.bandwidth, HELD.damping_ratio)
    for what in ("natural_frequency", "damping_ratio", "mode_shape"):
        assert np.array_equal(getattr(free, what)[1:], getattr(held, what)[1:])
    assert list(np.flatnonzero(free.rigid)) == list(np.flatnonzero(held.rigid)) == [0]


def test_a_hub_that_contradicts_the_supports_is_refused(frame3, fem2):
    with pytest.raises(ModelError, match="type 'fixed', but the supports let the structure rotate"):
        frame3.modal_set(Hub("fixed"), DAMPING, PORTS)
    with pytest.raises(ModelError, match="type 'held' needs one rigid-body mode, the supports leave 0"):
        reference.frame(fem2).modal_set(HELD, DAMPING, PORTS)


def test_a_truss_with_a_loose_part_is_refused_as_a_mechanism_by_name():
    truss = barker_truss("pinned", 3)
    loose = replace(truss, bars=tuple(bar for bar in truss.bars if bar.name != "D3"))
    with pytest.raises(ModelError, match=r"mechanism: 2 motion\(s\) without stiffness, the loosest at 'B3"):
        reference.frame(assemble(loose, "tip"))


def test_a_truss_that_floats_is_refused_as_a_mechanism():
    floating = replace(barker_truss("pinned", 3), supports={})
    with pytest.raises(ModelError, match=r"3 motion\(s\) without stiffness"):
        reference.frame(assemble(floating, "tip"))


def test_a_single_free_motion_that_does_not_turn_the_hub_is_refused():
    sliding = replace(barker_truss("pinned", 3), supports={"B0": ("y", "rz")})
    with pytest.raises(ModelError, match=r"1 motion\(s\) without stiffness"):
        reference.frame(assemble(sliding, "tip"))


def test_a_degree_of_freedom_without_mass_is_refused():
    truss = barker_truss("pinned", 2)
    lone = replace(truss, nodes={**truss.nodes, "lone": (9.0, 9.0)})
    with pytest.raises(ModelError, match="every degree of freedom needs mass"):
        reference.frame(assemble(lone, "tip"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"natural_frequency": np.array([-1.0, 2.0])}, "natural_frequency holds -1"),
        ({"damping_ratio": np.array([0.1, np.inf])}, "must be finite"),
        ({"mode_shape": np.ones((2, 3))}, r"shape \(2, 3\); expected \(2, 2\)"),
    ],
)
def test_a_modal_set_that_cannot_be_is_refused(changes, message):
    good = {
        "natural_frequency": np.array([1.0, 2.0]),
        "damping_ratio": np.zeros(2),
        "mode_shape": np.ones((2, 2)),
        "ports": PORTS,
        "rigid": np.zeros(2, bool),
    }
    with pytest.raises(ModelError, match=message):
        ModalSet(**(good | changes))


def test_receptances_are_those_of_the_dynamic_stiffness_solved_directly(frame3):
    damping = Damping((0.01,), None)
    modes = frame3.modal_set(HELD, damping, PORTS)
    K, M = matrices(frame3)
    shapes = frame3.shapes
    C = M @ shapes * modes.damping @ shapes.T @ M
    rigid = M @ shapes[:, 0]
    held = K + HELD.bandwidth**2 * np.outer(rigid, rigid)
    e, o = frame3.structure.port("tip"), frame3.structure.port("hub")
    s = np.array([0.5j, 3 + 40j, -1 + 300j, 2000j, 500.0])
    for one, other, first, second in (("tip", "tip", e, e), ("tip", "hub", e, o), ("hub", "hub", o, o)):
        direct = [first @ linalg.solve(held + x * C + x**2 * M, second.astype(complex)) for x in s]
        assert np.abs(modes.receptance(s, one, other) / direct - 1).max() < EIGEN


# --- truncation


def test_reduced_matrices_keep_frequencies_damping_and_the_response_between_ports(dissertation, fem3):
    frame = reference.frame(fem3)
    modes = frame.modal_set(HELD, Damping((0.01, 0.002, 0.003, 0.004, 0.005, 0.006)), PORTS)
    dofs = dissertation["section_2_3"]["reduced_dofs"]
    keep = [0, 1, 2, 3, 4, 5, 7]
    M, C, K = reduced_matrices(frame, modes, dofs, keep)
    kept = modes.keep(keep)
    assert np.sqrt(linalg.eigvalsh(K, M)) == pytest.approx(kept.natural_frequency, rel=EIGEN, abs=0)
    tip, hub = dofs.index("B20.rz"), dofs.index("B0.rz")
    s = np.array([1j, 5 + 60j, -2 + 200j, 900j])
    for one, other, i, j in (("tip", "tip", tip, tip), ("tip", "hub", tip, hub)):
        reduced = np.array([linalg.inv(M * x**2 + C * x + K)[i, j] for x in s])
        assert np.abs(reduced / kept.receptance(s, one, other) - 1).max() < EIGEN
    for matrix in (M, C, K):
        assert np.abs(matrix - matrix.T).max() <= 1e-12 * np.abs(matrix).max()


def test_a_reduction_that_cannot_be_made_is_refused(frame3):
    modes = frame3.modal_set(HELD, DAMPING, PORTS)
    with pytest.raises(ModelError, match="2 degrees of freedom but 1 modes"):
        reduced_matrices(frame3, modes, ["B20.y", "B20.rz"], [0])
    with pytest.raises(ModelError, match=r"'B99\.y' does not exist"):
        reduced_matrices(frame3, modes, ["B99.y"], [0])
    with pytest.raises(ModelError, match="singular reduced modal matrix"):
        reduced_matrices(frame3, modes, ["B20.y", "B20.y"], [0, 1])


def test_the_error_of_truncation_below_the_kept_modes_falls_with_every_mode_kept(frame3):
    modes = frame3.modal_set(HELD, Damping((0.0,)), PORTS)
    s = 1j * np.array([0.3 * HZ, 3 * HZ])
    full = modes.receptance(s, "tip", "tip")
    errors = np.array(
        [np.abs(modes.keep(slice(0, n)).receptance(s, "tip", "tip") - full) for n in range(3, 62)]
    )
    # Below all modes left out their terms φ²/(ω² − |s|²) have one sign, so none can make up for another.
    # A mode that hardly turns the tip changes the sum by less than its rounding.
    assert np.all(np.diff(errors, axis=0) <= 1e-15 * np.abs(full))
    assert np.all(errors[-1] == 0)


@pytest.mark.parametrize(
    ("selection", "kept"),
    [
        (ModeSelection(), [0, 1, 2, 3]),
        (ModeSelection(count=2), [0, 1]),
        (ModeSelection(below=3.0), [0, 1]),
        (ModeSelection(keep=(3, 1, 1)), [1, 3]),
    ],
)
def test_a_selection_keeps_the_modes_it_names(selection, kept):
    assert list(selection.of(np.array([0.0, 2.0, 3.0, 5.0]))) == kept


@pytest.mark.parametrize(
    "selection",
    [
        ModeSelection(count=0),
        ModeSelection(count=5),
        ModeSelection(below=0.0),
        ModeSelection(keep=(-1, 2)),
        ModeSelection(keep=(4,)),
    ],
)
def test_a_selection_of_no_mode_or_one_that_does_not_exist_is_refused(selection):
    with pytest.raises(ModelError, match="choose between 1 and 4"):
        selection.of(np.array([0.0, 2.0, 3.0, 5.0]))


# --- repeated eigenvalues


def test_in_a_repeated_eigenspace_one_mode_alone_moves_the_port():
    frame = reference.frame(assemble(reference.square_mast(), "tip"), 50.0)
    pairs = np.flatnonzero(np.diff(frame.eigenvalue) < 1e-9 * frame.eigenvalue[1:])
    assert pairs.size >= 6
    motion = frame.structure.port("tip") @ frame.shapes
    scale = np.abs(motion).max()
    for k in pairs:
        assert min(abs(motion[k]), abs(motion[k + 1])) < 1e-12 * scale
    K, M = matrices(frame, 50.0)
    assert np.abs(frame.shapes.T @ M @ frame.shapes - np.eye(frame.eigenvalue.size)).max() < 1e-12
    residual = K @ frame.shapes - M @ frame.shapes * frame.eigenvalue
    assert np.abs(residual).max() < 1e-10 * np.abs(K @ frame.shapes).max()


# --- derivatives


def test_eigenvalue_gradients_are_differences_of_the_eigenvalues():
    structure = reference.structure("pinned", 5)
    frame = reference.frame(structure)
    rng = np.random.default_rng(0)
    da = structure.area * rng.normal(size=structure.area.size)
    dm = structure.batten_mass * rng.normal(size=structure.batten_mass.size)

    def eigenvalues(h):
        return modal_frame(
            structure, structure.area + h * da, structure.batten_mass + h * dm, reference.MIRROR_MASS, "tip"
        ).eigenvalue

    expected, error = reference.plateau(eigenvalues, (1e-2, 3e-3, 1e-3))
    dk = structure.stiffness_by_area @ da
    dw = structure.mass_by_area @ da + structure.mass_by_batten @ dm
    for k in range(1, 16):
        by_stiffness, by_mass = frame.eigenvalue_gradient(k)
        assert by_stiffness @ dk + by_mass @ dw == pytest.approx(expected[k], rel=1e-7, abs=3 * error[k])


S = np.array([3 + 40j, -2 + 300j, 900j, 4000.0 + 10j])
DIRECT = np.array([1 + 2j, -0.5j, 3.0, 2 - 1j])
CROSS = np.array([0.3j, 1.0, -2.0 + 1j, 0.7])


@pytest.mark.parametrize("hub", [HELD, Hub("free")], ids=["held", "free"])
@pytest.mark.parametrize(
    "damping",
    [
        Damping((0.02,)),
        Damping((0.01, 0.05), (30.0, 3000.0)),
        Damping(tuple(0.01 + 0.003 * k for k in range(20))),
    ],
    ids=["uniform", "table", "per mode"],
)
@pytest.mark.parametrize("kept", [slice(None), slice(0, 5), [1, 2, 4, 9]], ids=["all", "lowest", "chosen"])
def test_the_differential_of_the_receptances_is_that_of_central_differences(hub, damping, kept):
    structure = reference.structure("pinned", 5)
    rng = np.random.default_rng(2)
    da = structure.area * rng.normal(size=structure.area.size)
    dm = structure.batten_mass * rng.normal(size=structure.batten_mass.size)

    def sums(h):
        area, batten_mass = structure.area + h * da, structure.batten_mass + h * dm
        frame = modal_frame(structure, area, batten_mass, reference.MIRROR_MASS, "tip")
        modes = frame.modal_set(hub, damping, PORTS).keep(kept)
        g, g0 = (modes.receptance(S, "tip", port) for port in ("tip", "hub"))
        return np.concatenate([np.real(DIRECT * g), np.real(CROSS * g0)])

    expected, error = reference.plateau(sums, (1e-2, 3e-3, 1e-3, 3e-4))
    frame = reference.frame(structure)
    modes = frame.modal_set(hub, damping, PORTS)
    indices = np.arange(modes.natural_frequency.size)[kept]
    inside = modes.keep(kept)
    modal = 1 / (S[:, None] ** 2 + inside.damping * S[:, None] + inside.stiffness)
    dk = stiffness_weights(structure, da)
    dw = mass_weights(structure, da, dm, 0.0)
    found = []
    for other, coefficient in (("tip", DIRECT), ("hub", CROSS)):
        for i in range(S.size):
            by_stiffness, by_mass = receptance_functional(
                frame, modes, damping, indices, S[[i]], modal[[i]], {("tip", other): coefficient[[i]]}
            )
            found.append(by_stiffness @ dk + by_mass @ dw)
    # What the differences admit, and 1e-7 of the largest for a truncation error that shrinks with it.
    assert np.all(np.abs(np.array(found) - expected) <= 1e-6 * np.abs(expected) + 3 * error)
