"""A mirror with two axes on one structure: both loops closed, against the state space of the whole."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
import reference
import two_axes
from scipy import linalg
from two_axes import DISTURBANCES, HZ, OFF

from fosopt import certify as judge
from fosopt.actuators import Mirror, MirrorReactionMass, Placement
from fosopt.certify import certify
from fosopt.control import (
    NUMERATORS,
    OTHER,
    OTHER_AXIS,
    PID,
    Loop,
    Sampling,
    SignalPath,
    SteeredAxis,
    about_other_axis,
    characteristic,
    closed_loop_poles,
    closed_loop_response,
    closed_loop_state_space,
    gain_for_crossover,
    loop_transfer,
    low_pass_filter,
)
from fosopt.control.loop_phase import loop_transfer_roots
from fosopt.control.many import many_closed_loop_poles
from fosopt.errors import ModelError, UnstableError
from fosopt.expressions import parse_expression
from fosopt.metrics import margins
from fosopt.metrics.axes import axis_models, axis_variances, multivariable_margin
from fosopt.metrics.disturbances import Disturbance, low_pass
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances, pole_residues
from fosopt.metrics.spectrum import axis_spectrum
from fosopt.metrics.step import StepCommand
from fosopt.modes import Damping, ModalSet
from fosopt.problem import (
    Definitions,
    ModeSelection,
    Problem,
    SecondAxisDefinitions,
    TwoAxisEvaluation,
    Variable,
    evaluation_of,
)
from fosopt.relax.open_loop import open_loop

# Dense solves of a state matrix of unlike numbers leave this much of a response's largest value.
SOLVED = 1e-9
ROUTES = 1e-8
BY_QUADRATURE = 1e-9
FREQUENCY = np.geomspace(5.0, 1500.0, 80)


def on(axis: int, source: int, name: str) -> tuple[str, str, str]:
    """Name of a response as the model of an axis has it, and input and output of the whole state space."""
    own = name if source == axis else f"other_{name}"
    return own, (OTHER if source else "") + name, (OTHER if axis else "") + "line_of_sight"


# ---- formulas against the state space of the whole ----


@pytest.mark.parametrize("seed", range(8))
def test_responses_between_all_inputs_and_both_axes_are_those_of_the_state_space(seed):
    loop, modes = two_axes.on_random_modes(seed, actuators=seed % 2 == 0)
    whole = closed_loop_state_space(loop, modes, "tip")
    s = 1j * FREQUENCY
    for axis, model in enumerate(axis_models(LoopModel(loop, modes, "tip"))):
        g = model.points(s).g
        for name in ("mirror_torque", "hub_torque", "line_of_sight", "sensor_noise"):
            for source in (0, 1):
                own, entry, out = on(axis, source, name)
                expected = whole.response(s, entry, out)
                found = closed_loop_response(own, model.loop, s, g)
                assert np.abs(found - expected).max() <= SOLVED * np.abs(expected).max(), (axis, own)


@pytest.mark.parametrize("seed", range(8))
def test_poles_are_the_eigenvalues_of_the_whole_for_either_axis(seed):
    loop, modes = two_axes.on_random_modes(seed, actuators=seed % 2 == 0)
    eigenvalue = linalg.eigvals(closed_loop_state_space(loop, modes, "tip").a)
    other, port = about_other_axis(loop, "tip")
    for one, at in ((loop, "tip"), (other, port)):
        found = closed_loop_poles(one, modes, at).all
        assert found.size == eigenvalue.size
        assert reference.worst_match(found, eigenvalue) < 1e-9


def test_poles_are_zeros_of_the_characteristic_function_of_either_axis_though_the_fastest_is_far_off():
    """Eigenvalues of a state matrix err by rounding of the largest, a million times the slowest here."""
    loop, modes = two_axes.on_random_modes(3)
    modes = replace(modes, natural_frequency=np.geomspace(3.0, 3e6, 6))
    poles = closed_loop_poles(loop, modes, "tip")
    for model in axis_models(LoopModel(loop, modes, "tip")):
        at = model.points(poles.value)
        delta = characteristic(model.loop, *model.along(at))
        # A Newton step from each pole, relative to it; eigenvalues alone leave 6e-13 here.
        assert np.abs(delta.value / delta.slope / poles.value).max() < 1e-14


@pytest.mark.parametrize("seed", range(4))
def test_jitter_of_both_axes_is_that_of_the_lyapunov_equation_of_the_whole(seed):
    loop, modes = two_axes.on_random_modes(seed, actuators=seed % 2 == 0)
    whole = judge._scaled(closed_loop_state_space(loop, modes, "tip"), modes)
    models = axis_models(LoopModel(loop, modes, "tip"))
    poles = closed_loop_poles(loop, modes, "tip")
    for disturbance, shares in zip(DISTURBANCES, axis_variances(models, poles, DISTURBANCES), strict=True):
        sources = [whole.inputs.index(f"{axis}{disturbance.at}") for axis in judge._sources(disturbance)]
        for out, share in zip(("line_of_sight", f"{OTHER}line_of_sight"), shares, strict=True):
            row = [whole.outputs.index(out)]
            expected = sum(judge._filtered_variance(whole, k, row, disturbance.filter) for k in sources)
            assert share.value == pytest.approx(expected, rel=ROUTES, abs=0), (disturbance.name, out)


@pytest.mark.parametrize("seed", range(4))
def test_sensitivity_and_complementary_sensitivity_of_each_loop_sum_to_one(seed):
    loop, modes = two_axes.on_random_modes(seed)
    for model in axis_models(LoopModel(loop, modes, "tip")):
        points = model.points(1j * FREQUENCY)
        s_and_t = (
            closed_loop_response(name, model.loop, points.s, points.g)
            for name in ("line_of_sight", "command")
        )
        assert np.abs(sum(s_and_t) - 1).max() < 1e-12
        transfer = loop_transfer(model.loop, points.s, points.g)
        sensitivity = closed_loop_response("line_of_sight", model.loop, points.s, points.g)
        np.testing.assert_allclose(sensitivity, 1 / (1 + transfer), rtol=1e-10)


@pytest.mark.parametrize("free", [False, True], ids=["held", "free"])
def test_the_loop_transfer_has_the_zeros_and_poles_it_is_drawn_with(free):
    loop, modes = two_axes.on_random_modes(2, actuators=not free)
    modes = two_axes.set_free(modes) if free else modes
    for model in axis_models(LoopModel(loop, modes, "tip")):
        zeros, poles = loop_transfer_roots(model.loop, modes, model.mirror_port)
        s = 1j * FREQUENCY
        drawn = np.prod(s[:, None] - zeros, axis=1) / np.prod(s[:, None] - poles, axis=1)
        ratio = loop_transfer(model.loop, s, model.points(s).g) / drawn
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-7)


def test_swapping_the_axes_swaps_the_answers():
    loop, modes = two_axes.on_random_modes(5)
    other, port = about_other_axis(loop, "tip")
    back, tip = about_other_axis(other, port)
    assert (back, tip) == (loop, "tip") and (other.hub, port) == ("hub_y", "tip_y")
    swapped = [
        replace(d, axis={"first": "second", "second": "first", "both": "both"}[d.axis]) for d in DISTURBANCES
    ]
    found = axis_variances(
        axis_models(LoopModel(loop, modes, "tip")), closed_loop_poles(loop, modes, "tip"), DISTURBANCES
    )
    again = axis_variances(
        axis_models(LoopModel(other, modes, port)), closed_loop_poles(other, modes, port), swapped
    )
    for (first, second), (one, two) in zip(found, again, strict=True):
        assert (first.value, second.value) == pytest.approx((two.value, one.value), rel=BY_QUADRATURE, abs=0)


# ---- axes that do not couple ----


def decoupled() -> tuple[Loop, Loop, ModalSet]:
    """Two loops that are alike on a structure that keeps them apart, and one of them alone."""
    mirror, terms = Mirror(0.02, 60.0, 0.02), {"kp": 60.0, "ki": 500.0, "kd": 1.0, "rolloff_time": 1e-3}
    controller = PID(gain_for_crossover(100.0, mirror, **terms), **terms)
    loop = Loop(mirror, controller)
    return replace(loop, beside=SteeredAxis("tip_y", mirror, controller, "hub_y")), loop, two_axes.apart()


def test_axes_apart_have_the_numbers_of_one_loop_though_every_pole_is_double():
    both, one, modes = decoupled()
    model, single = LoopModel(both, modes, "tip"), LoopModel(one, modes, "tip")
    models, poles, own = (
        axis_models(model),
        closed_loop_poles(both, modes, "tip"),
        closed_loop_poles(one, modes, "tip"),
    )
    moved = np.repeat(np.concatenate([own.value, own.value[own.multiplicity == 2].conj()]), 2)
    assert poles.all.size == moved.size
    assert reference.worst_match(poles.all, moved) < 1e-9
    alike = [replace(d, axis="both") for d in DISTURBANCES]
    expected = [v.value for v in jitter_variances(single, own, DISTURBANCES)]
    for shares, alone in zip(axis_variances(models, poles, alike), expected, strict=True):
        for share in shares:
            assert share.value == pytest.approx(alone, rel=BY_QUADRATURE, abs=0)
    least = margins.modulus_margins(single, own, 1)[0][0]
    for each in models:
        assert margins.modulus_margins(each, poles, 1)[0][0] == pytest.approx(least, rel=1e-9, abs=0)
        assert margins.crossover(each, poles)[0] == pytest.approx(
            margins.crossover(single, own)[0], rel=1e-9, abs=0
        )
    assert multivariable_margin(model, poles) == pytest.approx(least, rel=1e-9, abs=0)


def test_a_disturbance_about_one_axis_does_not_reach_the_other_where_they_are_apart():
    both, _, modes = decoupled()
    models, poles = axis_models(LoopModel(both, modes, "tip")), closed_loop_poles(both, modes, "tip")
    found = axis_variances(models, poles, [replace(d, axis="second") for d in DISTURBANCES])
    assert all(first.value == 0.0 and second.value > 0 for first, second in found)


def test_a_symmetric_mast_has_the_jitter_of_one_loop_times_the_root_of_two():
    alike = tuple(replace(d, axis="both") for d in DISTURBANCES)
    system, design = two_axes.on_mast(None, 1.0, disturbances=alike)
    found, one = evaluation_of(system, design), evaluation_of(*two_axes.alone(system, design))
    single = one.value("jitter_total")
    # The mast's bars are symmetric to rounding, which its lightly damped modes magnify.
    assert found.value("jitter_total") == pytest.approx(sqrt(2) * single, rel=1e-7, abs=0)
    for axis in ("first", "second"):
        assert found.value(f"jitter_{axis}_axis") == pytest.approx(single, rel=1e-7, abs=0)
        assert found.value(f"modulus_margin_{axis}_axis") == pytest.approx(
            one.value("modulus_margin"), rel=1e-7, abs=0
        )


def test_the_decay_of_a_double_pole_has_the_gradient_of_one_loop():
    """About alike axes the rightmost pole is double: each of the two follows one loop."""
    system, design = two_axes.on_mast(None, 1.0)
    found, one = evaluation_of(system, design), evaluation_of(*two_axes.alone(system, design))
    branches = found.branches("spectral_abscissa")
    # The one loop alone leaves the other axis' mode where it was, and that one decays more slowly.
    (_, _), (value, gradient), *_ = one.branches("spectral_abscissa")
    assert branches[0][0] == pytest.approx(branches[1][0], rel=1e-7, abs=0)
    assert branches[0][0] == pytest.approx(value, rel=1e-7, abs=0)
    start = design.loop_start
    for of_axis in (branches[0][1][start:], branches[1][1][start:]):
        half = of_axis.size // 2
        first, second = of_axis[:half], of_axis[half:]
        own, other = (first, second) if np.abs(first).max() > np.abs(second).max() else (second, first)
        np.testing.assert_allclose(
            own, gradient[start:], rtol=1e-5, atol=1e-9 * np.abs(gradient[start:]).max()
        )
        assert np.abs(other).max() <= 1e-5 * np.abs(own).max()


# ---- loops that are stable alone and unstable together ----


def coupled_strongly(seed: int) -> tuple[Loop, ModalSet]:
    """Found by search: a structure over which two loops, each stable beside a mirror that rests, destabilize."""
    rng = np.random.default_rng(seed)
    frequency, ratio = np.sort(rng.uniform(20, 400, 3)), rng.uniform(0.001, 0.01, 3)
    shapes = 3 * rng.normal(size=(3, 4))
    modes = ModalSet(frequency, ratio, shapes, two_axes.PORTS[:4], np.zeros(3, dtype=bool))
    first = Mirror(0.02, rng.uniform(20, 200), 0.02)
    second = Mirror(0.02 * rng.uniform(0.5, 2), rng.uniform(20, 200), 0.03)
    time = 1e-3 * (seed % 2)
    controllers = [
        PID(0.02 * rng.uniform(20, 600), rng.uniform(0, 80), rng.uniform(0, 5000), 1.0, time)
        for _ in range(2)
    ]
    return Loop(first, controllers[0], beside=SteeredAxis("tip_y", second, controllers[1], "hub_y")), modes


@pytest.mark.parametrize("seed", [156, 199])
def test_loops_that_are_stable_alone_and_unstable_together_are_found_unstable_and_have_no_jitter(seed):
    loop, modes = coupled_strongly(seed)
    assert loop.beside is not None

    def abscissa(own: PID, other: PID) -> float:
        beside = replace(loop.beside, controller=other)
        return closed_loop_poles(replace(loop, controller=own, beside=beside), modes, "tip").spectral_abscissa

    own, other = loop.controller, loop.beside.controller
    assert abscissa(own, OFF) < -0.01 and abscissa(OFF, other) < -0.01
    assert abscissa(own, other) > 0.3
    poles = closed_loop_poles(loop, modes, "tip")
    with pytest.raises(UnstableError, match="a pole has the real part 0"):
        axis_variances(axis_models(LoopModel(loop, modes, "tip")), poles, DISTURBANCES)
    with pytest.raises(UnstableError):
        axis_spectrum(axis_models(LoopModel(loop, modes, "tip")), poles, DISTURBANCES)


# ---- margins of both loops at once ----


@pytest.mark.parametrize("seed", range(4))
def test_the_multivariable_margin_is_one_over_the_peak_of_the_sensitivity_of_the_whole(seed):
    loop, modes = two_axes.on_random_modes(seed, actuators=seed % 2 == 0)
    model = LoopModel(loop, modes, "tip")
    models, poles = axis_models(model), closed_loop_poles(loop, modes, "tip")
    found = multivariable_margin(model, poles)
    whole = closed_loop_state_space(loop, modes, "tip")
    names = ("line_of_sight", f"{OTHER}line_of_sight")

    def peak(frequency):
        s = 1j * frequency
        sensitivity = np.array([[whole.response(s, entry, out) for entry in names] for out in names])
        return np.linalg.norm(np.moveaxis(sensitivity, -1, 0), 2, axis=(1, 2))

    grid = np.geomspace(1.0, 5000.0, 3000)
    around = grid[np.argmax(peak(grid))] * np.linspace(0.995, 1.005, 2001)
    assert found == pytest.approx(1 / peak(around).max(), rel=1e-6, abs=0)
    each = [margins.modulus_margins(one, poles, 1)[0][0] for one in models]
    assert found <= min(each) * (1 + 1e-9)


# ---- evaluation, gradients, judge ----


LOS_TABLE = Disturbance(
    "table",
    "hub_torque",
    frequency=np.array([1.0, 30.0, 900.0]),
    psd=np.array([1e-3, 1e-3, 1e-6]),
    axis="second",
)
CONFIGURATIONS = {
    "all modes": {},
    "lowest modes": {"selection": ModeSelection(count=9)},
    "tables and bands": {
        "disturbances": (LOS_TABLE, replace(DISTURBANCES[1], band=(5.0, 700.0)), DISTURBANCES[3])
    },
    # As a large truss is solved: the lowest modes by themselves, and the flexibility of the others at the ports.
    "truncated": {"bays": 6, "selection": ModeSelection(count=12)},
    "a filter about the second axis": {"path": SignalPath((low_pass_filter(300 * HZ, 2),))},
    "damping by frequency": {"damping": Damping((0.004, 0.02), (50.0, 5000.0))},
}
SAMPLED = SignalPath(sampling=Sampling(1e-3))
WITHOUT_GRADIENT = "modulus_margin_multivariable"


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_gradients_of_all_metrics_are_those_of_central_differences(name, monkeypatch):
    if name == "truncated":
        monkeypatch.setattr("fosopt.problem.system.LARGE", 5)
    system, design = two_axes.on_mast(**CONFIGURATIONS[name])
    evaluation = evaluation_of(system, design)
    assert (evaluation.frame.outside is not None) == (name == "truncated")
    assert isinstance(evaluation, TwoAxisEvaluation) and evaluation.stable
    names = [each for each in system.metric_names if each != WITHOUT_GRADIENT]
    base, rng, start = design.parameters, np.random.default_rng(3), design.loop_start
    parts = [slice(0, start), slice(start, start + 8), slice(start + 8, base.size)]
    values = np.array([evaluation.value(each) for each in names])
    gradients = np.array([evaluation.metric(each)[1] for each in names])
    # Structure, first and second axis apart once; of the other configurations together.
    for part in parts if name == "all modes" else [slice(0, base.size)]:
        direction = np.zeros(base.size)
        direction[part] = base[part] * rng.normal(size=base[part].size)

        def along(t, direction=direction):
            moved = evaluation_of(system, design.with_parameters(base + t * direction))
            return np.array([moved.value(each) for each in names])

        expected, error = reference.plateau(along, (2e-4, 5e-5, 1.2e-5))
        # Differences admit their own error; a derivative that is small against its value is known to 1e-8 of it.
        allowed = 1e-6 * np.abs(expected) + 3 * error + 1e-8 * np.abs(values)
        wrong = np.flatnonzero(~(np.abs(gradients @ direction - expected) <= allowed))
        assert not wrong.size, [(names[i], (gradients @ direction)[i], expected[i], error[i]) for i in wrong]


def test_the_margin_of_both_loops_at_once_has_a_value_and_no_gradient():
    evaluation = evaluation_of(*two_axes.on_mast())
    assert 0 < evaluation.value(WITHOUT_GRADIENT) <= evaluation.value("modulus_margin")
    with pytest.raises(
        ModelError, match="no gradient; judge designs by it, and optimize for 'modulus_margin'"
    ):
        evaluation.metric(WITHOUT_GRADIENT)


def test_totals_are_root_sum_squares_and_the_least_of_both_axes():
    evaluation = evaluation_of(*two_axes.on_mast())
    value = evaluation.value
    sources = [value(f"jitter_{d.name}") for d in DISTURBANCES]
    axes = [value(f"jitter_{axis}_axis") for axis in ("first", "second")]
    assert value("jitter_total") == pytest.approx(np.hypot(*axes), rel=1e-12, abs=0)
    assert value("jitter_total") == pytest.approx(np.linalg.norm(sources), rel=1e-12, abs=0)
    for name in ("modulus_margin", "loop_crossover"):
        each = [value(f"{name}_{axis}_axis") for axis in ("first", "second")]
        assert value(name) == min(each) and each[0] != each[1]
    branches = [value for value, _ in evaluation.branches("modulus_margin")]
    assert branches == sorted(branches) and branches[0] == value("modulus_margin")


def test_differentials_stand_on_few_points_where_poles_are_apart_and_on_all_where_they_are_double():
    for options, few in (((), True), ((None, 1.0), False)):
        evaluation = evaluation_of(*two_axes.on_mast(*options))
        points = [f.points.s.size for v in evaluation.variances.values() for f in v.functionals]
        assert (max(points) < 60) if few else (np.median(points) > 500)


def test_jitter_of_a_shifted_response_has_the_gradient_of_differences():
    """By which an unstable design is stabilized."""
    system, design = two_axes.on_mast()
    gradient = evaluation_of(system, design, 5.0).metric("jitter_total")[1]
    base, rng = design.parameters, np.random.default_rng(4)
    direction = base * rng.normal(size=base.size)

    def along(t):
        moved = evaluation_of(system, design.with_parameters(base + t * direction), 5.0)
        return np.array([moved.value("jitter_total")])

    expected, error = reference.plateau(along, (5e-5, 1.2e-5))
    assert gradient @ direction == pytest.approx(expected[0], rel=1e-6, abs=3 * error[0])


def problem_on_mast(**parts) -> Problem:
    system, design = two_axes.on_mast(**parts)
    return Problem(system, design, (), (parse_expression("structural_mass"),))


def test_the_judge_finds_the_same_poles_and_jitter_by_its_own_routes():
    banded = replace(DISTURBANCES[2], name="air_2", axis="second", band=(1.0, 900.0))
    every = (*DISTURBANCES, LOS_TABLE, banded)
    certificate = certify(problem_on_mast(disturbances=every), np.zeros(0), ())
    assert certificate.verified and certificate.stable, certificate.reasons
    assert certificate.jitter_disagreement is not None and certificate.jitter_disagreement < ROUTES
    assert certificate.pole_disagreement < 1e-10
    assert certificate.metrics["modulus_margin_multivariable"] is not None


@pytest.mark.parametrize("axis", [0, 1])
def test_the_judge_notices_a_jitter_that_forgets_what_crosses_over(axis, monkeypatch):
    from fosopt.metrics import axes

    def own_alone(disturbance, of):
        return [] if of == axis and disturbance.axis != ("first", "second")[axis] else honest(disturbance, of)

    honest = axes.responses_of
    monkeypatch.setattr(axes, "responses_of", own_alone)
    certificate = certify(problem_on_mast(), np.zeros(0), ())
    assert not certificate.verified and certificate.reasons[0].startswith("jitter: two routes differ by")


def test_the_spectrum_by_source_and_axis_integrates_to_the_jitter():
    evaluation = evaluation_of(*two_axes.on_mast())
    assert isinstance(evaluation, TwoAxisEvaluation)
    spectrum = axis_spectrum(evaluation.models, evaluation.poles, DISTURBANCES)
    exact = [share.value for shares in evaluation.shares for share in shares]
    np.testing.assert_allclose(spectrum.by_source[:, -1], exact, rtol=1e-7)
    assert spectrum.pole.size == 0


# ---- variables ----


def scalar(quantity, value, **parts) -> Variable:
    at = np.array([value])
    return Variable(parts.pop("name", quantity), quantity, 0.1 * at, 10 * at, at, **parts)


def designed(definitions, *variables):
    system, design = two_axes.on_mast()
    problem = Problem(
        system, design, variables, (parse_expression("structural_mass"),), definitions=definitions
    )
    return problem.design(problem.start).loop


def test_the_second_axis_follows_the_first_where_it_has_nothing_of_its_own():
    loop = designed(
        Definitions(second=SecondAxisDefinitions(frozenset({"mirror_damping_ratio"}))),
        *(scalar("mirror_inertia", 0.02), scalar("gain", 7.0), scalar("kp", 400.0)),
    )
    assert (loop.mirror.inertia, loop.controller.gain, loop.controller.kp) == (0.02, 7.0, 400.0)
    assert loop.beside.controller == loop.controller
    assert loop.beside.mirror == replace(loop.mirror, damping_ratio=0.03)


def test_a_crossover_sets_the_gain_of_each_axis_for_its_own_mirror():
    own = frozenset({"mirror_inertia"})
    loop = designed(Definitions(crossover=50 * HZ, second=SecondAxisDefinitions(own)), scalar("kp", 400.0))
    pid = loop.controller
    for mirror, controller in ((loop.mirror, pid), (loop.beside.mirror, loop.beside.controller)):
        gain = gain_for_crossover(50 * HZ, mirror, 400.0, pid.ki, pid.kd, pid.rolloff_time)
        assert controller.gain == pytest.approx(gain, rel=1e-12, abs=0)
    assert loop.beside.controller.gain == pytest.approx(1.3 * pid.gain, rel=1e-12, abs=0)


def test_a_variable_of_the_second_axis_sets_that_one_alone():
    loop = designed(
        Definitions(crossover=50 * HZ, second=SecondAxisDefinitions()),
        scalar("kp", 350.0, axis="second", name="kp_2"),
        scalar("crossover", 70 * HZ, axis="second", name="crossover_2"),
    )
    pid, other = loop.controller, loop.beside.controller
    assert (pid.kp, other.kp) == (600.0, 350.0)
    for mirror, each, crossover in ((loop.mirror, pid, 50 * HZ), (loop.beside.mirror, other, 70 * HZ)):
        gain = gain_for_crossover(crossover, mirror, each.kp, each.ki, each.kd, each.rolloff_time)
        assert each.gain == pytest.approx(gain, rel=1e-12, abs=0)
    own = Definitions(crossover=50 * HZ, second=SecondAxisDefinitions(frozenset({"gain"}), 90 * HZ))
    loop = designed(own, scalar("kp", 350.0, axis="second", name="kp_2"))
    other, mirror = loop.beside.controller, loop.beside.mirror
    gain = gain_for_crossover(90 * HZ, mirror, 350.0, other.ki, other.kd, other.rolloff_time)
    assert other.gain == pytest.approx(gain, rel=1e-12, abs=0)
    given = designed(
        own,
        scalar("gain", 3.0, axis="second", name="gain_2"),
    )
    assert given.beside.controller.gain == 3.0


# ---- what two axes cannot be ----


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"placement": Placement(sensor="hub")},
            "sensor, action or reaction elsewhere than at the mirror are",
        ),
        ({"mirror": Mirror(0.02, 60.0, 0.02, MirrorReactionMass())}, "reaction masses are"),
        ({"controller": PID(1.0, 1.0, 1.0, 1.0, path=SAMPLED)}, "controllers that sample are"),
    ],
)
def test_a_loop_that_two_axes_cannot_have_is_refused(parts, message):
    loop, _ = two_axes.on_random_modes(1)
    with pytest.raises(
        ModelError, match=f"two axes: {message} not known .*; study one axis, or both without it"
    ):
        replace(loop, **parts)
    if "placement" not in parts:
        with pytest.raises(ModelError, match=message):
            replace(loop, beside=replace(loop.beside, **parts))


def test_what_is_of_one_loop_is_refused_of_two():
    loop, modes = two_axes.on_random_modes(1)
    model, poles = LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip")
    with pytest.raises(ModelError, match="may be double and have no residues"):
        pole_residues(model, poles, "command")
    with pytest.raises(ModelError, match="bounds over controllers are those of one loop"):
        open_loop(model, DISTURBANCES)
    assert many_closed_loop_poles([loop, loop], modes, "tip", poles) == [None, None]
    system, design = two_axes.on_mast()
    with pytest.raises(ModelError, match="a step command is judged about one axis"):
        replace(system, step=StepCommand(1e-6, (0.1, 0.2)))
    with pytest.raises(ModelError, match="differ in how many the mirror has"):
        Problem(replace(system, two_axes=False), design, (), (parse_expression("structural_mass"),))
    alone_system, alone_design = two_axes.alone(system, design)
    with pytest.raises(ModelError, match="one is of a second axis, which the mirror has not"):
        Problem(alone_system, alone_design, (scalar("kp", 1.0, axis="second"),), (parse_expression("kp"),))
    with pytest.raises(ModelError, match="'mirror_inertia_ratio' is not about one axis"):
        scalar("mirror_inertia_ratio", 1.0, axis="second")


def test_a_mirror_with_one_axis_has_nothing_about_another():
    loop, modes = two_axes.on_random_modes(1)
    model = LoopModel(replace(loop, beside=None), modes, "tip")
    points = model.points(1j * FREQUENCY)
    with pytest.raises(ModelError, match="no second axis"):
        about_other_axis(model.loop, "tip")
    for name in OTHER_AXIS:
        with pytest.raises(ModelError, match="about a second axis, which the mirror has not"):
            closed_loop_response(name, model.loop, points.s, points.g)
    assert {name.removeprefix("other_") for name in OTHER_AXIS} == set(NUMERATORS) - {"command"}


def test_jitter_of_one_axis_with_the_other_closed_needs_no_residues():
    loop, modes = two_axes.on_random_modes(4)
    model, poles = LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip")
    disturbance = Disturbance("push", "mirror_torque", low_pass(30 * HZ, 1e-3))
    (found,) = jitter_variances(model, poles, [disturbance])
    ((first, _),) = axis_variances(axis_models(model), poles, [disturbance])
    assert found.value == first.value


def test_a_hub_that_does_not_turn_about_the_second_axis_shakes_it_about_the_first():
    loop, modes = two_axes.on_random_modes(1)
    loop = replace(loop, beside=replace(loop.beside, hub=None))
    models, poles = axis_models(LoopModel(loop, modes, "tip")), closed_loop_poles(loop, modes, "tip")
    whole = closed_loop_state_space(loop, modes, "tip")
    assert f"{OTHER}hub_torque" not in whole.inputs
    s = 1j * FREQUENCY
    for model, name, out in ((models[0], "hub_torque", ""), (models[1], "other_hub_torque", OTHER)):
        expected = whole.response(s, "hub_torque", f"{out}line_of_sight")
        found = closed_loop_response(name, model.loop, s, model.points(s).g)
        assert np.abs(found - expected).max() <= SOLVED * np.abs(expected).max()
    with pytest.raises(ModelError, match="of which no port is known; give the axis its hub"):
        axis_variances(models, poles, [DISTURBANCES[1]])
    assert axis_variances(models, poles, [replace(DISTURBANCES[1], axis="first")])[0][1].value > 0


def test_a_free_hub_refuses_a_torque_that_pushes_it_away_about_either_axis():
    loop, modes = two_axes.on_random_modes(1)
    free = two_axes.set_free(modes)
    poles = closed_loop_poles(loop, free, "tip")
    models = axis_models(LoopModel(loop, free, "tip"))
    assert poles.open_loop.drifting and poles.all.size == closed_loop_poles(loop, modes, "tip").all.size
    with pytest.raises(ModelError, match="unbounded drift"):
        axis_variances(models, poles, [DISTURBANCES[1]])
    whole = closed_loop_state_space(loop, free, "tip")
    s = 1j * FREQUENCY
    for axis, model in enumerate(models):
        own, entry, out = on(axis, 1 - axis, "hub_torque")
        expected = whole.response(s, entry, out)
        found = closed_loop_response(own, model.loop, s, model.points(s).g)
        assert np.abs(found - expected).max() <= SOLVED * np.abs(expected).max()


def test_modes_that_neither_axis_sees_keep_their_poles_and_the_gradients_of_these():
    """A symmetric mast stretches and twists without turning its mirror."""
    system, design = two_axes.on_mast(None, 1.0)
    found, one = evaluation_of(system, design), evaluation_of(*two_axes.alone(system, design))
    hidden = found.poles.open_loop.uncoupled
    assert hidden.size == 8
    whole = closed_loop_state_space(design.loop, found.modes, "tip")
    assert reference.worst_match(found.poles.all, linalg.eigvals(whole.a)) < 1e-9
    still = [
        (value, g) for value, g in found.branches("spectral_abscissa") if not g[design.loop_start :].any()
    ]
    alone = {round(value, 8): g for value, g in one.branches("spectral_abscissa")}
    assert len(still) == 2
    for value, gradient in still:
        expected = alone[round(value, 8)][: design.loop_start]
        np.testing.assert_allclose(
            gradient[: design.loop_start], expected, rtol=1e-8, atol=1e-8 * abs(expected).max()
        )


def test_of_modes_that_share_a_pole_the_one_that_neither_axis_moves_tells_its_decay():
    shapes = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    frequency, ratio = np.full(3, 20.0), np.full(3, 0.01)
    modes = ModalSet(frequency, ratio, shapes, ("hub", "tip", "tip_y"), np.zeros(3, dtype=bool))
    found = margins.decay_functional(
        frequency**2, modes, Damping((0.01,)), ("tip", "tip_y"), np.arange(3), -0.2
    )
    assert np.flatnonzero(found.stiffness.any(axis=0)).tolist() == [2]
