"""Large structures: sparse modes, residual flexibility, its stated error, and gradients through a truncated basis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference

from fosopt.certify import independent_variance
from fosopt.control import closed_loop_state_space
from fosopt.errors import ModelError, UnstableError
from fosopt.modes import Damping, Hub, lanczos, modal_frame, modes_below, truncated_frame
from fosopt.problem import Evaluation, ModeSelection
from fosopt.structure import assemble, mass_weights, stiffness_weights

HZ = reference.HZ
COOLING, AFT_BODY, AIR, SENSOR = reference.DISTURBANCES
PORTS = ("tip", "hub")
# Both solvers err by some units in the last place of the largest eigenvalue, 1e5 to 1e7 times the lowest here.
EIGEN = 1e-8


def spatial(boundary, bays=5, stretch=1.0):
    """The spatial mast, whose hub is held or turns about one axis."""
    mast = reference.square_mast(bays, stretch)
    held = ("x", "y", "z", "rx", "ry") if boundary == "pinned" else mast.supports["B0"]
    return assemble(replace(mast, supports={"B0": held}), "tip")


STRUCTURES = {
    "planar, pinned": lambda: reference.structure("pinned", 12),
    "planar, fixed": lambda: reference.structure("fixed", 12),
    "planar, on its table": lambda: reference.structure("table", 12),
    "spatial, fixed": lambda: spatial("fixed"),
    "spatial, pinned": lambda: spatial("pinned"),
    "spatial, uneven": lambda: spatial("fixed", stretch=1.3),
}
EACH = pytest.mark.parametrize("name", STRUCTURES)


def both(name, count, ports=PORTS, mirror_mass=20.0):
    of = STRUCTURES[name]()
    sizes = of.area, of.batten_mass, mirror_mass
    return modal_frame(of, *sizes, ports[0]), truncated_frame(of, *sizes, ports, count)


def elastic_receptance(frame, eigenvalue, ports=PORTS):
    """Receptances between ports at s² = −eigenvalue, without the rigid-body mode."""
    elastic = frame.eigenvalue > 0
    rows = np.array([frame.structure.port(port) for port in ports]) @ frame.shapes[:, elastic]
    return (rows / (frame.eigenvalue[elastic] - eigenvalue)) @ rows.T


@pytest.fixture
def everything_is_large(monkeypatch):
    """Trusses of any size are solved as large ones are."""
    monkeypatch.setattr("fosopt.problem.system.LARGE", 0)


@EACH
def test_sparse_modes_are_those_of_the_dense_solver(name):
    dense, sparse = both(name, 12)
    n = sparse.n_exact
    assert sparse.eigenvalue[:n] == pytest.approx(dense.eigenvalue[:n], rel=EIGEN)
    momentum = sparse.mass_shapes.T * reference_weights(sparse)
    assert np.abs(momentum @ sparse.mass_shapes - np.eye(sparse.eigenvalue.size)).max() < EIGEN
    # Shapes of a repeated frequency may differ; what they span may not.
    between = np.linalg.svd(
        dense.mass_shapes[:, :n].T * reference_weights(sparse) @ sparse.mass_shapes[:, :n]
    )[1]
    assert between == pytest.approx(np.ones(n), abs=1e-6)


def reference_weights(frame, mirror_mass=20.0):
    of = frame.structure
    return mass_weights(of, of.area, of.batten_mass, mirror_mass)


@EACH
def test_receptances_at_rest_are_exact_however_few_modes_are_kept(name):
    for count in (2, 5, 9):
        dense, sparse = both(name, count)
        exact = elastic_receptance(dense, 0.0)
        assert elastic_receptance(sparse, 0.0) == pytest.approx(exact, abs=EIGEN * np.abs(exact).max())


@EACH
def test_the_error_of_truncation_falls_with_the_modes_and_stays_below_what_is_stated(name):
    worst = []
    for count in (3, 6, 12):
        dense, sparse = both(name, count)
        edge = sparse.outside.next_eigenvalue
        for share in (0.1, 0.5, 0.9, 0.99):
            error = elastic_receptance(dense, share * edge) - elastic_receptance(sparse, share * edge)
            stated = sparse.outside.receptance_error(np.sqrt([share * edge]))[0]
            rounding = 1e-9 * np.abs(elastic_receptance(dense, share * edge)).max()
            assert np.all(np.abs(error) <= stated + rounding)
            # A Galerkin model is too stiff for a load of one sign.
            assert np.all(np.diag(error) >= -rounding)
        fixed = 0.2 * dense.eigenvalue[dense.n_rigid + 2]
        worst.append(np.abs(elastic_receptance(dense, fixed) - elastic_receptance(sparse, fixed)).max())
    # Modes with a node at the ports change nothing.
    assert worst[1] <= worst[0] * (1 + 1e-6) and worst[2] < min(worst[0], worst[1]) / 3


def test_the_stated_error_is_nothing_at_rest_and_endless_at_the_next_mode():
    _, sparse = both("planar, pinned", 8)
    edge = sparse.outside.next_eigenvalue**0.5
    at_rest, below, at, above = sparse.outside.receptance_error(np.array([0.0, 0.999, 1.001, 2.0]) * edge)
    assert np.all(at_rest == 0) and np.all(np.isfinite(below)) and np.all(np.isinf([at, above]))


def test_where_the_next_eigenvalue_is_twice_the_square_half_the_residual_flexibility_may_be_missing():
    # ω⁴/(Λ (Λ − ω²)) with ω² = Λ/2.
    outside = both("planar, pinned", 8)[1].outside
    error = outside.receptance_error(np.sqrt([0.5 * outside.next_eigenvalue]))[0]
    np.testing.assert_allclose(np.diag(error), 0.5 * np.diag(outside.residual_flexibility), rtol=1e-12)


def test_a_long_truss_keeps_its_digits():
    # The first eigenvalue is 1e-10 of the last: stiffness entries carry six digits of it, elongations nearly all.
    of = reference.structure("fixed", 800)
    frame = truncated_frame(of, of.area, of.batten_mass, 250.0, PORTS, 20)
    weights = mass_weights(of, of.area, of.batten_mass, 250.0)
    gram = (frame.mass_shapes.T * weights) @ frame.mass_shapes
    assert np.abs(gram - np.eye(gram.shape[0])).max() < 1e-11
    stiffness = (frame.stiffness_shapes.T * stiffness_weights(of, of.area)) @ frame.stiffness_shapes
    size = np.sqrt(np.outer(frame.eigenvalue, frame.eigenvalue))
    assert (np.abs(stiffness - np.diag(frame.eigenvalue)) / size)[:20].max() < 1e-7


def test_a_repeated_frequency_is_kept_as_a_whole():
    dense, sparse = both("spatial, fixed", 1)
    assert dense.eigenvalue[1] == pytest.approx(dense.eigenvalue[0], rel=EIGEN)
    assert sparse.n_exact == 2


def test_of_a_repeated_frequency_one_mode_alone_moves_the_mirror():
    _, sparse = both("spatial, fixed", 6)
    motion = np.abs(sparse.structure.port("tip") @ sparse.shapes[:, :2])
    assert motion.min() < 1e-9 * motion.max()


def test_a_port_that_is_held_adds_no_shape():
    _, sparse = both("planar, fixed", 6)
    assert sparse.eigenvalue.size == sparse.n_exact + 1
    assert np.all(sparse.structure.port("hub") == 0)


def test_two_ports_in_one_place_add_one_shape_and_disturb_nothing():
    of = STRUCTURES["planar, pinned"]()
    sizes = of.area, of.batten_mass, 20.0
    once = truncated_frame(of, *sizes, PORTS, 6)
    twice = truncated_frame(of, *sizes, (*PORTS, "B12.rz"), 6)
    assert twice.eigenvalue == pytest.approx(once.eigenvalue, rel=EIGEN)


def test_missing_copies_of_a_mode_are_searched_for(monkeypatch):
    whole = lanczos._search

    def forgetful(pencil, count, beside, seed):
        shapes = whole(pencil, count, beside, seed)
        return shapes if seed else np.delete(shapes, [1, 4], axis=1)

    monkeypatch.setattr(lanczos, "_search", forgetful)
    dense, sparse = both("spatial, fixed", 8)
    assert sparse.eigenvalue[:8] == pytest.approx(dense.eigenvalue[:8], rel=EIGEN)


def test_modes_found_slice_by_slice_are_the_same(monkeypatch):
    of = reference.structure("pinned", 60)
    sizes = of.area, of.batten_mass, 250.0
    at_once = truncated_frame(of, *sizes, PORTS, 60)
    asked = []
    about = lanczos._about
    monkeypatch.setattr(lanczos, "_SLICE", 20)
    monkeypatch.setattr(lanczos, "_about", lambda *a: asked.append(a[1]) or about(*a))
    sliced = truncated_frame(of, *sizes, PORTS, 60)
    assert len(asked) >= 3
    assert sliced.eigenvalue == pytest.approx(at_once.eigenvalue, rel=EIGEN)
    rows = np.array([of.port(port) for port in PORTS])
    assert np.abs(rows @ sliced.shapes) == pytest.approx(np.abs(rows @ at_once.shapes), rel=1e-5, abs=1e-8)


def test_modes_are_counted_below_a_frequency_without_being_computed():
    of = reference.structure("pinned", 12)
    dense = modal_frame(of, of.area, of.batten_mass, 20.0, "tip")
    frequency = np.sqrt(dense.eigenvalue)
    for k in (1, 4, 11):
        middle = 0.5 * (frequency[k - 1] + frequency[k])
        assert modes_below(of, of.area, of.batten_mass, 20.0, middle) == k


def test_what_cannot_be_solved_is_refused_by_name():
    of = reference.structure("pinned", 6)
    with pytest.raises(ModelError, match=r"mechanism.*rotation about the hub may be free"):
        truncated_frame(
            of, np.where(np.arange(of.area.size) == 5, 0.0, of.area), of.batten_mass, 20.0, PORTS, 4
        )
    with pytest.raises(ModelError, match="no mass"):
        truncated_frame(of, 0 * of.area, 0 * of.batten_mass, 20.0, PORTS, 4)
    with pytest.raises(ModelError, match=r"area: -.* is negative"):
        truncated_frame(of, -of.area, of.batten_mass, 20.0, PORTS, 4)
    for count in (0, 18):
        with pytest.raises(ModelError, match=f"{count} of 19 are no truncation"):
            truncated_frame(of, of.area, of.batten_mass, 20.0, PORTS, count)


REFERENCES = (
    *(("first_elastic_frequency",), ("reference_inertia",), ("spectral_abscissa",), ("modulus_margin",)),
    *(("loop_crossover",), ("structure_frequency", 3), ("modal_inertia", 2), ("natural_frequency", 3)),
    *(("effective_modal_reaction_inertia", 3), ("pole_zero_separation", 2), ("participation", 2)),
)
CONFIGURATIONS = {
    "held hub": {},
    "free hub": {"hub": Hub("free"), "disturbances": (AIR, SENSOR)},
    "fixed hub": {"boundary": "fixed", "hub": Hub("fixed"), "disturbances": (COOLING, AIR, SENSOR)},
    "root table": {"boundary": "table", "hub": Hub("free")},
    "table damping": {"damping": Damping((0.001, 0.02), (10.0, 3000.0))},
}
STEPS = (2e-4, 5e-5, 1.2e-5, 3e-6)


def check_gradients(system, design, references, rng):
    found = Evaluation(system, design)
    assert found.frame.outside is not None and found.stable
    base = design.parameters
    direction = base * rng.normal(size=base.size)

    def along(t):
        moved = Evaluation(system, design.with_parameters(base + t * direction))
        return np.array([moved.value(*r) for r in references])

    expected, error = reference.plateau(along, STEPS)
    for r, slope, doubt in zip(references, expected, error, strict=True):
        value, gradient = found.metric(*r)
        # Differences admit their own error; a derivative that is small against its value is known to 1e-8 of it.
        allowed = 1e-6 * abs(slope) + 3 * doubt + 1e-8 * abs(value)
        assert abs(gradient @ direction - slope) <= allowed, (r, gradient @ direction, slope, doubt)


@pytest.mark.usefixtures("everything_is_large")
@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_gradients_of_a_truncated_model_are_those_of_central_differences(name):
    parts = {"step": None, "selection": ModeSelection(6), "percent": 1.0} | CONFIGURATIONS[name]
    system, design = reference.system_and_design(bays=9, seed=3, **parts)
    jitter = tuple((f"jitter_{d.name}",) for d in system.disturbances)
    check_gradients(system, design, (*REFERENCES, *jitter), np.random.default_rng(5))


@pytest.mark.usefixtures("everything_is_large")
def test_gradients_hold_where_frequencies_are_repeated():
    system, design = reference.system_and_design(bays=9, step=None, selection=ModeSelection(7))
    of = spatial("fixed", 4)
    system = replace(system, structure=of, hub=Hub("fixed"), disturbances=(COOLING, AIR, SENSOR))
    mirror = replace(design.loop.mirror, inertia=0.05)
    design = replace(
        design,
        area=of.area,
        batten_mass=of.batten_mass,
        spring_stiffness=of.spring_stiffness,
        mirror_mass=2.0,
        loop=reference.loop_of(mirror, 1e-4),
    )
    assert np.diff(Evaluation(system, design).frame.eigenvalue[:2])[0] < EIGEN
    references = (("reference_inertia",), ("modulus_margin",), ("jitter_cooling",), ("jitter_air",))
    check_gradients(system, design, references, np.random.default_rng(2))


@pytest.mark.usefixtures("everything_is_large")
def test_jitter_and_its_gradient_approach_those_of_all_modes():
    system, design = reference.system_and_design(bays=12, seed=1, step=None)
    value, gradient = Evaluation(system, design).metric("jitter_aft_body")
    errors = []
    for count in (4, 9, 18):
        less = Evaluation(replace(system, selection=ModeSelection(count)), design).metric("jitter_aft_body")
        errors.append(
            (abs(less[0] / value - 1), np.linalg.norm(less[1] - gradient) / np.linalg.norm(gradient))
        )
    assert np.all(np.diff(np.array(errors), axis=0) < 0)
    assert max(errors[-1]) < 1e-4


@pytest.mark.usefixtures("everything_is_large")
def test_the_reference_inertia_is_that_of_all_modes():
    system, design = reference.system_and_design(bays=9, selection=ModeSelection(5))
    every = Evaluation(replace(system, selection=ModeSelection()), design)
    assert every.frame.outside is None
    value, gradient = Evaluation(system, design).metric("reference_inertia")
    assert value == pytest.approx(every.value("reference_inertia"), rel=EIGEN)
    expected = every.metric("reference_inertia")[1]
    assert gradient == pytest.approx(expected, abs=EIGEN * np.abs(expected).max())


def test_cost_grows_with_the_members(monkeypatch):
    # Not timed: entries of the factors, columns solved for, and shapes held, per bay.
    counts = {}
    for bays in (60, 120, 240):
        of = reference.structure("fixed", bays)
        solved, entries = [], []
        factors, flexibility = lanczos._factors, lanczos.SparsePencil.flexibility

        def counted(matrix, entries=entries, factors=factors):
            found = factors(matrix)
            entries.append(found.nnz)
            return found

        def watched(self, loads, solved=solved, flexibility=flexibility):
            solved.append(1 if loads.ndim == 1 else loads.shape[1])
            return flexibility(self, loads)

        with monkeypatch.context() as patch:
            patch.setattr(lanczos, "_factors", counted)
            patch.setattr(lanczos.SparsePencil, "flexibility", watched)
            frame = truncated_frame(of, of.area, of.batten_mass, 250.0, PORTS, 10)
        held = frame.mass_shapes.size + frame.outside.shapes.size
        counts[bays] = np.array([max(entries), held, len(of.area)]) / bays, sum(solved), len(entries)
    first, last = counts[60], counts[240]
    assert last[0] == pytest.approx(first[0], rel=0.15)
    assert last[1] <= 1.5 * first[1] and last[2] == first[2]


EDGES = {
    "zero coupling": {"frequency": 0.0},
    "mirror of a billionth": {"percent": 1e-7},
    "mirror a thousand times the truss": {"percent": 1e5},
    "mirror of 10 kHz": {"frequency": 1e4 * HZ},
    "mirror on a structural frequency": {"frequency": None},
    "mirror on the frequency of the residual shape": {"frequency": -1},
    "ordinary": {},
}


@pytest.mark.usefixtures("everything_is_large")
@pytest.mark.parametrize("name", EDGES)
def test_edges_of_the_mirror_agree_with_a_lyapunov_equation_on_the_truncated_model(name):
    asked = {"percent": 0.2, "frequency": 20 * HZ} | EDGES[name]
    system, design = reference.system_and_design(bays=9, step=None, selection=ModeSelection(6))
    modes = Evaluation(system, design).modes
    frequency = asked["frequency"]
    if frequency is None or frequency == -1:
        frequency = float(modes.natural_frequency[2 if frequency is None else -1])
    mirror = replace(reference.mirror_of(system.structure, asked["percent"]), natural_frequency=frequency)
    check_against_lyapunov(system, replace(design, loop=reference.loop_of(mirror)))


@pytest.mark.usefixtures("everything_is_large")
def test_a_node_at_the_port_and_a_drifting_hub_are_no_trouble():
    # The mirror's port is the hub's own: held, it sees nothing of the structure.
    system, design = reference.system_and_design(
        bays=9, boundary="fixed", hub=Hub("fixed"), step=None, selection=ModeSelection(6)
    )
    check_against_lyapunov(replace(system, mirror_port="hub", disturbances=(COOLING, AIR, SENSOR)), design)
    system, design = reference.system_and_design(
        bays=9, hub=Hub("free"), step=None, disturbances=(AIR, SENSOR), selection=ModeSelection(6)
    )
    check_against_lyapunov(system, design)


def check_against_lyapunov(system, design):
    found = Evaluation(system, design)
    assert found.frame.outside is not None
    space = closed_loop_state_space(design.loop, found.modes, system.mirror_port)
    dense = np.linalg.eigvals(space.a)
    if found.poles.open_loop.drifting:
        dense = dense[np.argsort(np.abs(dense))[2:]]
    assert found.poles.all.size == dense.size
    assert found.poles.spectral_abscissa == pytest.approx(dense.real.max(), abs=1e-9 * np.abs(dense).max())
    for disturbance in system.disturbances:
        if not found.stable:
            with pytest.raises(UnstableError):
                found.value(f"jitter_{disturbance.name}")
            continue
        expected = independent_variance(found, space, disturbance)
        # The Lyapunov equation of a stiff state matrix loses digits, and all of them where nothing is coupled.
        assert found.mean_squares[f"jitter_{disturbance.name}"] == pytest.approx(
            expected, rel=1e-4, abs=1e-20
        )
