"""Filters, sampling, PID forms and limits of a study file, from the file to what is judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_studies import HELD_KEYS, analysis, edited, run_text, section, single

from fosopt.certify import certify
from fosopt.cli.outcome import closing
from fosopt.control import pid_response
from fosopt.errors import ModelError, StudyError, UnstableError
from fosopt.metrics.peaks import peaks
from fosopt.metrics.sampled import SampledModel
from fosopt.metrics.sampled_steps import sampled_peaks, sampled_response, sampled_step_metrics
from fosopt.problem import Rows
from fosopt.problem.correction import as_model_sees
from fosopt.solve import front
from fosopt.solve.corrected import corrected
from fosopt.solve.ipopt import Options
from fosopt.solve.strategies import Goal, reach
from fosopt.study import TEMPLATE, dump_study, parse_study
from fosopt.study.build import build_problem, start_vector
from fosopt.study.describe_loop import describe_controller
from fosopt.study.detail import detail_of

CROSSOVER = "  crossover: 100 Hz              # sets the gain, on a rigid support\n"
GAINS = "  kd: 1\n  kp: 600\n  ki: 50000\n"
BUILT = """\
  anti_alias: {corner: 3 kHz, order: 2}
  filters:
    - {type: notch, frequency: 700 Hz, damping_ratio: 0.3, depth: 0.2}
    - {type: low_pass, corner: 4 kHz}
  sampling: {rate: 5 kHz, delay: 100 us}
"""
STEP = "step: {command: 10 urad, window: [20 ms, 50 ms]}\n"
LIMITS = STEP + "limits: {stroke: 1 mrad, rate: 10 rad/s, torque: 2 kN m, engagements: 3}\n"


def built(*changes, extra="", maker=analysis):
    """The small quickstart with a sampled loop."""
    changed = (CROSSOVER, CROSSOVER + BUILT), ("disturbances:\n", extra + "disturbances:\n"), *changes
    return maker(*changed)


def problem_of(text):
    study = parse_study(text)
    return study, build_problem(study)


def refusal(text):
    with pytest.raises(StudyError) as caught:
        build_problem(parse_study(text))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_every_part_arrives_in_the_loop_in_si_units():
    study, problem = problem_of(
        built(("delay: 100 us", "delay: 100 us, derivative: backward, pade_order: 2"))
    )
    # The crossover sets the same gain wherever it is asked for, filters counted.
    again = problem.design(start_vector(study, problem)).loop.controller
    assert again.gain == pytest.approx(problem.base.loop.controller.gain, abs=0, rel=1e-12)
    path = problem.base.loop.controller.path
    assert path.sampling.period == pytest.approx(2e-4)
    assert (path.sampling.delay, path.sampling.order) == (pytest.approx(1e-4), 2)
    notch, low_pass = path.filters
    assert notch.center == pytest.approx(700 * 2 * np.pi)
    assert abs(notch.response(700j * 2 * np.pi)) == pytest.approx(0.2)
    assert low_pass.poles == pytest.approx([-8000 * np.pi])
    assert len(path.anti_alias) == 1 and path.anti_alias[0].order == 2


def test_a_lead_lag_and_a_rational_filter_are_read_too():
    filters = (
        "  filters:\n    - {type: lead_lag, zero: 10 Hz, pole: 1 kHz}\n"
        "    - {type: rational, numerator: [2, 1], denominator: [1, 100, 10000]}\n"
    )
    _, problem = problem_of(analysis((CROSSOVER, CROSSOVER + filters)))
    lead, rational = problem.base.loop.controller.path.filters
    assert lead.direct == pytest.approx(100)
    assert (rational.numerator, rational.denominator) == ((2.0, 1.0), (1.0, 100.0, 10000.0))


@pytest.mark.parametrize(
    "form",
    [
        "  ideal: {gain: 600 kN m/rad, integral_time: 12 ms, derivative_time: 1 ms, filter_time: 20 us}\n",
        "  series: {gain: 500 kN m/rad, integral_time: 12 ms, derivative_time: 1 ms, filter_time: 20 us}\n",
        "  parallel: {proportional: 600 kN m/rad, integral: 5e7 N m/(rad s), derivative: 600 N m s/rad}\n",
    ],
)
def test_a_form_of_another_tool_is_the_same_controller_and_survives_a_dump(form):
    study, problem = problem_of(analysis((GAINS, form), (CROSSOVER, "")))
    pid = problem.base.loop.controller
    s = 1j * np.array([3.0, 400.0, 2e4])
    if "parallel" in form:
        expected = 6e5 + 5e7 / s + 600 * s
    elif "ideal" in form:
        expected = 6e5 * (1 + 1 / (0.012 * s) + 1e-3 * s / (1 + 2e-5 * s))
    else:
        expected = 5e5 * (1 + 1 / (0.012 * s)) * (1 + 1e-3 * s) / (1 + 2e-5 * s)
    np.testing.assert_allclose(pid_response(pid, s), expected, rtol=1e-9)
    assert parse_study(dump_study(study)) == study
    # With a crossover the gain follows from it, as ever.
    crossing, _ = problem_of(analysis((GAINS, form)))
    assert crossing.controller.gain is None and crossing.controller.kp == study.controller.kp


def test_an_analysis_reports_the_sampled_loop_and_what_the_model_is_off(tmp_path):
    text = built(extra=LIMITS)
    study, problem = problem_of(text)
    x = start_vector(study, problem)
    truth = problem.evaluate(x, truth=True)
    found = certify(problem, x, problem.constraints)
    assert found.stable and found.jitter_disagreement < 1e-8
    model = SampledModel(truth.design.loop, truth.modes, "tip", problem.system.disturbances)
    assert found.spectral_abscissa == pytest.approx(model.spectral_abscissa, abs=0, rel=1e-9)
    assert found.metrics["modulus_margin"] == pytest.approx(model.modulus_margin, abs=0, rel=1e-9)
    for name, square in model.variances.items():
        assert found.metrics[f"jitter_{name}"] == pytest.approx(np.sqrt(square), abs=0, rel=1e-9)
    assert found.metrics["jitter_total"] == pytest.approx(
        np.sqrt(sum(model.variances.values())), abs=0, rel=1e-9
    )
    steps = sampled_step_metrics(model.bare, problem.system.step)
    steps |= sampled_peaks(model.bare, problem.system.retargeting)
    for name, value in steps.items():
        assert found.metrics[name] == pytest.approx(value, abs=0, rel=1e-9)
    # The difference to the continuous model is there, and stated.
    continuous = problem.evaluate(x)
    for name in ("jitter_noise", "modulus_margin", "peak_torque"):
        off = abs(continuous.value(name) / found.metrics[name] - 1)
        assert found.truncation_error[name] == pytest.approx(off)
    assert 1e-4 < found.truncation_error["modulus_margin"] < 0.05
    run = run_text(text, tmp_path)
    (point,) = run["points"]
    assert point["verified"] and point["metrics"]["jitter_total"] == found.metrics["jitter_total"]


@pytest.mark.parametrize(("given", "pattern"), [("square_wave", "square wave"), ("staircase", "staircase")])
def test_limits_are_checked_on_the_sequence_asked_for(given, pattern):
    _, problem = problem_of(
        built(extra=LIMITS.replace("engagements: 3", f"engagements: 3, pattern: {given}"))
    )
    found = problem.system.retargeting
    assert (found.count, found.pattern) == (3, pattern)
    assert (found.command, found.settling_time, found.dwell_time) == pytest.approx(
        (1e-5, 0.02, 0.03), abs=0, rel=1e-9
    )


def test_a_limit_that_is_broken_is_said_and_one_that_holds_is_not():
    study, problem = problem_of(built(extra=LIMITS.replace("2 kN m", "1e-3 N m")))
    found = certify(problem, start_vector(study, problem), problem.constraints)
    assert not found.verified
    reason = found.reasons[-1]
    assert reason.startswith("constraint 'peak_torque' is violated by ")
    assert {c.name: c.slack > 0 for c in found.constraints} == {
        "peak_stroke": True,
        "peak_rate": True,
        "peak_torque": False,
    } | {c.name: c.slack > 0 for c in found.constraints[: len(problem.constraints)]}


def test_limits_of_a_continuous_loop_are_its_peaks():
    rolled = CROSSOVER + "  rolloff: 3 kHz\n"
    study, problem = problem_of(
        analysis((CROSSOVER, rolled), ("disturbances:\n", LIMITS + "disturbances:\n"))
    )
    x = start_vector(study, problem)
    evaluation = problem.evaluate(x)
    expected = peaks(evaluation.model, evaluation.poles, problem.system.retargeting)
    found = certify(problem, x, problem.constraints)
    for name, value in expected.items():
        assert found.metrics[name] == pytest.approx(value)
    with pytest.raises(ModelError, match="no gradient"):
        evaluation.metric("peak_torque")


def test_an_unstable_sampled_loop_has_no_jitter_although_its_model_may_be_stable():
    study, problem = problem_of(built(("delay: 100 us", "delay: 3 ms"), extra=LIMITS))
    found = certify(problem, start_vector(study, problem), problem.constraints)
    assert not found.stable and found.reasons[0].startswith("unstable")
    for name in ("jitter_total", "jitter_noise", "modulus_margin", "step_rms", "peak_torque"):
        assert found.metrics[name] is None


def test_a_sweep_sees_the_sampled_loop():
    sweep = "sweep:\n  axes:\n    - {quantity: crossover, list: [80 Hz, 100 Hz]}\n  outputs: [jitter_total]\n"
    text = built(("kind: analysis", "kind: sweep"), extra=sweep)
    text = text.replace("constraints:\n  - metric: first_elastic_frequency\n    lower: 4 Hz\n", "")
    text = text.replace("  - metric: modulus_margin\n    lower: 0.5\n", "")
    text = text[: text.index("solve:")]
    study, problem = problem_of(text)
    x = start_vector(study, problem)
    assert problem.system.as_built
    assert problem.evaluate(x).value("jitter_total") == problem.evaluate(x, truth=True).value("jitter_total")


def margin_limited(built_as=BUILT):
    """Least jitter under a limit on the margin of the sampled loop: goal and first solution, on the model as it is."""
    text = single(
        "jitter_total", "  - metric: modulus_margin\n    lower: 0.5\n", **{CROSSOVER: CROSSOVER + built_as}
    )
    study, problem = problem_of(text.replace("    group_by: kind               #", "    group_by: all    #"))
    start = start_vector(study, problem)
    goal = Goal(problem, problem.objectives[0], problem.constraints, np.ones(start.size, bool))
    return goal, reach(goal, start, "simultaneous", Options())


def margins(problem, x):
    """Modulus margin of the sampled loop and of its continuous model."""
    row = Rows(problem, (problem.constraints[0].expression,))
    return row.values(x, problem.evaluate(x, truth=True))[0], row.values(x, problem.evaluate(x))[0]


@pytest.mark.parametrize("sampling", ["rate: 5 kHz, delay: 100 us", "rate: 3 kHz, delay: 0 s, pade_order: 1"])
def test_a_constraint_is_met_by_the_sampled_loop_after_optimizing_its_model(sampling):
    goal, first = margin_limited(BUILT.replace("rate: 5 kHz, delay: 100 us", sampling))
    problem = goal.problem
    solution = corrected(goal, first, "simultaneous", Options())
    assert solution.status == "optimal"
    truth, model = margins(problem, solution.x)
    assert truth == pytest.approx(0.5, abs=0, rel=1e-5)
    assert abs(model - truth) > 1e-4
    (moved,) = as_model_sees(problem, problem.constraints, solution.x)
    assert moved.lower == pytest.approx(0.5 - (truth - model), abs=0, rel=1e-12)
    found = certify(problem, solution.x, problem.constraints, goal.objective, goal.free)
    assert found.verified, found.reasons
    assert found.constraints[0].active and found.constraints[0].multiplier != 0
    # Of a loop that is not sampled, constraints stay as they are.
    bare = replace(problem.base.loop.controller, path=type(problem.base.loop.controller.path)())
    base = replace(problem.base, loop=replace(problem.base.loop, controller=bare))
    continuous = replace(problem, base=base)
    assert as_model_sees(continuous, problem.constraints, solution.x) == problem.constraints
    assert corrected(replace(goal, problem=continuous), first, "simultaneous", Options()) is first


def test_the_judge_sees_a_limit_as_the_corrected_model_does(monkeypatch):
    # Jitter of the model is below that of the sampled loop, so that a limit on it binds before it is reached.
    limit = "  - {metric: jitter_total, upper: 12 urad}\n"
    text = single("structural_mass", limit, **{CROSSOVER: CROSSOVER + BUILT})
    study, problem = problem_of(text.replace("    group_by: kind               #", "    group_by: all    #"))
    start = start_vector(study, problem)
    goal = Goal(problem, problem.objectives[0], problem.constraints, np.ones(start.size, bool))
    first = reach(goal, start, "simultaneous", Options())
    x = corrected(goal, first, "simultaneous", Options()).x
    truth, model = margins(problem, x)
    assert truth == pytest.approx(12e-6, abs=0, rel=1e-5) and model < 0.999 * truth
    found = certify(problem, x, problem.constraints, goal.objective, goal.free)
    assert found.verified, found.reasons
    (price,) = [c.multiplier for c in found.constraints if c.name == "jitter_total"]
    assert price < 0
    monkeypatch.setattr("fosopt.certify.as_model_sees", lambda problem, constraints, x: tuple(constraints))
    other = certify(problem, x, problem.constraints, goal.objective, goal.free)
    assert not other.verified and other.kkt_residual > 1e-2


def test_corrections_stay_near_the_optimum_they_start_from(monkeypatch):
    goal, first = margin_limited()
    seen = []

    def watched(asked, start, strategy, options, stop):
        seen.append((asked.constraints[0].lower, options.near, reach(asked, start, strategy, options, stop)))
        return seen[-1][2]

    monkeypatch.setattr("fosopt.solve.corrected.reach", watched)
    options = Options(tolerance=1e-7)
    found = corrected(goal, first, "simultaneous", options)
    assert found.status == "optimal" and 2 <= len(seen) <= 4
    assert all(near for _, near, _ in seen)
    last = as_model_sees(goal.problem, goal.constraints, found.x)[0].lower
    assert last == pytest.approx(seen[-1][0], abs=0, rel=5e-7)
    assert abs(seen[0][0] - last) > 1e-6
    assert found.iterations == first.iterations + sum(each.iterations for _, _, each in seen)
    assert found.seconds == pytest.approx(first.seconds + sum(each.seconds for _, _, each in seen))
    # From the optimum itself it is found again, without the detour through the interior that it takes otherwise.
    again = reach(goal, first.x, "simultaneous", Options(near=True))
    assert again.objective == pytest.approx(first.objective, abs=0, rel=1e-5)
    assert again.iterations < 0.5 * reach(goal, first.x, "simultaneous", Options()).iterations


def test_a_correction_that_fails_nearby_is_tried_from_further_off(monkeypatch):
    goal, first = margin_limited()
    asked = []

    def hard(asked_goal, start, strategy, options, stop):
        asked.append(options.near)
        if options.near:
            return replace(first, status="failed", iterations=7, seconds=2.0)
        return reach(asked_goal, start, strategy, options, stop)

    monkeypatch.setattr("fosopt.solve.corrected.reach", hard)
    found = corrected(goal, first, "simultaneous", Options())
    assert found.status == "optimal"
    assert asked[:2] == [True, False]
    assert found.iterations > first.iterations + 7 * asked.count(True)
    assert margins(goal.problem, found.x)[0] == pytest.approx(0.5, abs=0, rel=1e-5)


def test_corrections_that_do_not_settle_are_no_optimum(monkeypatch):
    goal, first = margin_limited()
    rounds = []

    def drifting(problem, constraints, x):
        rounds.append(x)
        return tuple(replace(c, lower=c.lower + 1e-3 * len(rounds)) for c in constraints)

    monkeypatch.setattr("fosopt.solve.corrected.as_model_sees", drifting)
    monkeypatch.setattr("fosopt.solve.corrected.reach", lambda *given: first)
    found = corrected(goal, first, "simultaneous", Options())
    assert found.status == "failed" and len(rounds) == 9
    assert found.reason.startswith("constraint 'modulus_margin': ") and "after 8 corrections" in found.reason
    # What has stopped is left as it is.
    stopped = replace(first, status="interrupted")
    assert corrected(goal, stopped, "simultaneous", Options()) is stopped


def test_limits_of_a_front_are_judged_where_the_truth_has_a_value(monkeypatch):
    _, problem = problem_of(built(maker=edited))
    objective = problem.objectives[1]
    truth, model = (problem.evaluate(problem.start, truth=t).value("jitter_total") for t in (True, False))
    assert abs(truth / model - 1) > 1e-6
    assert front._judged(problem, problem.start, objective) == pytest.approx(truth, abs=0, rel=1e-12)

    def unstable(*given):
        raise UnstableError("no value")

    monkeypatch.setattr(front, "objective_value", unstable)
    assert front._judged(problem, problem.start, objective) == pytest.approx(model, abs=0, rel=1e-12)


def test_a_report_shows_the_loop_as_sampled():
    study, problem = problem_of(built(extra=STEP))
    truth = problem.evaluate(start_vector(study, problem), truth=True)
    model = truth.sampled.model
    detail = detail_of(truth)
    assert detail["sampling_rate_hz"] == pytest.approx(5000)
    bode, frequency = detail["bode"], np.array(detail["bode"]["frequency_hz"])
    assert 2400 < frequency[-1] <= 2500
    # Some way off the resonances, where six digits of a frequency say enough.
    z = np.exp(2j * np.pi * frequency / 5000)
    transfer = model.bare.loop_transfer(z)
    smooth = np.abs(np.gradient(np.log(np.abs(transfer)), np.log(frequency))) < 5
    assert np.count_nonzero(smooth) > 20
    expected = {
        "loop_magnitude": np.abs(transfer),
        "sensitivity": 1 / np.abs(1 + transfer),
        "complementary_sensitivity": np.abs(transfer / (1 + transfer)),
    }
    for name, curve in expected.items():
        np.testing.assert_allclose(np.array(bode[name])[smooth], curve[smooth], rtol=1e-3)
    turned = np.exp(1j * np.deg2rad(bode["loop_phase_deg"]))[smooth]
    np.testing.assert_allclose(turned, (transfer / np.abs(transfer))[smooth], atol=1e-3)
    assert max(bode["sensitivity"]) == pytest.approx(1 / model.modulus_margin, abs=0, rel=0.02)
    # The continuous model is something else close to the Nyquist frequency.
    continuous = detail_of(replace(problem, system=problem.system).evaluate(problem.start))["bode"]
    assert continuous["frequency_hz"][-1] > 2500
    step = detail["step"]
    time = np.array(step["time_s"])
    assert time[-1] == pytest.approx(0.05) and step["response"][0] == 0
    assert np.any(np.abs(5000 * time - np.round(5000 * time)) > 0.1), "nothing between samples"
    np.testing.assert_allclose(
        step["response"][1:], 1e-5 * sampled_response(model.bare, time)[1:], rtol=0, atol=1e-5 * 1e-3
    )
    metrics = sampled_step_metrics(model.bare, problem.system.step)
    assert abs(step["mean"]) == pytest.approx(metrics["step_offset"], abs=0, rel=1e-9)
    assert step["rms"] == pytest.approx(metrics["step_rms"], abs=0, rel=1e-9)
    error = np.interp(np.linspace(0.02, 0.05, 5000), step["window_time_s"], step["window_error"])
    assert np.sign(error.mean()) == np.sign(step["mean"])
    assert (step["window_time_s"][0], step["window_time_s"][-1]) == pytest.approx((0.02, 0.05))


def test_an_analysis_whose_limits_are_broken_says_so_at_its_end(tmp_path):
    broken = run_text(built(extra=LIMITS.replace("2 kN m", "1e-3 N m")), tmp_path)
    lines = list(closing(broken, tmp_path, 1.0))
    assert any(
        line.startswith("000 evaluated: ") and "'peak_torque' is violated by" in line for line in lines
    )
    (point,) = broken["points"]
    assert next(c for c in point["constraints"] if c["name"] == "peak_torque")["slack"] < 0


def test_the_controller_is_printed_in_every_form_and_as_it_runs():
    study, problem = problem_of(built(extra=LIMITS))
    text = "\n".join(describe_controller(study, problem))
    for part in (
        "parallel: k_p = ",
        "ideal: K = ",
        "series: K = ",
        "notch at 700 Hz, damping ratio 0.3, depth 0.2",
        "low pass of order 1 at 4000 Hz",
        "anti-alias: low pass of order 2 at 3000 Hz",
        "every 200 us (5000 Hz), torque 100 us later",
        "Padé delay of order 3 and 200 us",
        "u[k] = p[k] + i[k] + d[k]",
        "stroke at most 1000 urad, rate at most 10 rad/s, torque at most 2000 N m, over 3 steps",
    ):
        assert part in text, part


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (built(("rate: 5 kHz", "rate: 5 kHz, period: 1 ms")), "'rate' and 'period' exclude each other"),
        (built(("rate: 5 kHz, ", "")), "one of rate, period is required"),
        (built(("rate: 5 kHz", "rate: -5 kHz")), "is not positive"),
        (built(("rate: 5 kHz", "rate: 1 kHz")), "center 700 Hz is not below the Nyquist frequency 500 Hz"),
        (built(("rate: 5 kHz", "rate: 200 Hz")), "crossover: 100 Hz is not below the Nyquist frequency 100 Hz"),
        (edited((CROSSOVER, CROSSOVER + BUILT), ("rate: 5 kHz", "rate: 600 Hz")), "upper: 500 Hz is not below"),
        (built(("rate: 5 kHz", "rate: 200 MHz")), "sampling.rate: 2e+08 samples a second, at most 1e+08"),
        (built(("rate: 5 kHz", "period: 1e-300 s")), "sampling.period: 1e+300 samples a second"),
        (built(("delay: 100 us", "delay: 100")), "100 s are 500000 periods, at most 100 can be"),
        (built(extra=STEP.replace("50 ms", "201 s")), "201 s are 1.01e+06 samples, at most 1000000 are followed"),
        (built(extra=LIMITS.replace("50 ms", "70 s")), "210 s are 1.05e+06 samples"),
        (built(("delay: 100 us", "delay: 100 us, derivative: trapezoidal")), "ring at every second sample"),
        (built(("delay: 100 us", "dealy: 100 us")), "unknown key; did you mean 'delay'"),
        (built(("depth: 0.2", "depth: -0.2")), "is negative"),
        (built(("type: low_pass, corner: 4 kHz", "type: rational, numerator: [1], denominator: [1, -1]")), "decay"),
        (built(("  anti_alias: {corner: 3 kHz, order: 2}\n", ""), ),
         "disturbances.1: sampled loop: a 'sensor_noise' disturbance that does not roll off"),
        (built(("type: held                     #", "type: free #"), *HELD_KEYS,
               (section(TEMPLATE, "disturbances"), ""), extra="placement: {reaction: B2.y}\n"),
         "placement: the control torque turns the free hub"),
        (built(extra="limits: {stroke: 1 mrad}\n"), "add 'step'"),
        (built(extra=STEP + "limits: {engagements: 3}\n"), "no limit is given"),
        (analysis(("disturbances:\n", LIMITS + "disturbances:\n")), "infinite torque"),
        (analysis((GAINS, "  kp: 600\n  ki: 1\n  ideal: {gain: 1 kN m/rad}\n")), "'ideal' and 'kp' exclude"),
        (analysis((GAINS, "  series: {gain: 1 kN m/rad}\n  ideal: {gain: 1 kN m/rad}\n")), "exclude each other"),
        (analysis((GAINS, "  ideal: {gain: -1 kN m/rad}\n")), "is not positive"),
        (analysis((GAINS, "  ideal: {gian: 1 kN m/rad}\n")), "unknown key; did you mean 'gain'"),
        (analysis((GAINS, "  ideal: {integral_time: 1 s}\n")), "the key 'gain' is required"),
        (analysis((GAINS, "  ideal: 3\n")), "3 is no section; give gain"),
        (analysis((GAINS, "  series: {gain: 1 kN m/rad, integral_time: 1 ms, derivative_time: 1 us, "
                   "filter_time: 2 ms}\n")), "negative gain"),
        (edited(("  - minimize: jitter_total", "  - minimize: peak_torque"), ("variables:\n", LIMITS + "variables:\n")),
         "has no gradient"),
        (edited(("  - minimize: jitter_total", "  - minimize: peak_torque")), "peak_torque"),
    ],
)  # fmt: skip
def test_a_loop_that_cannot_be_built_is_refused_in_one_line(text, says):
    assert says in refusal(text)
