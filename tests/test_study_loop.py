"""Filters, sampling, PID forms and limits of a study file, from the file to what is judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_studies import analysis, edited, run_text, single

from fosopt.certify import certify
from fosopt.control import pid_response
from fosopt.errors import ModelError, StudyError
from fosopt.metrics.peaks import peaks
from fosopt.metrics.sampled import SampledModel
from fosopt.metrics.sampled_steps import sampled_peaks, sampled_step_metrics
from fosopt.problem import Rows
from fosopt.problem.correction import as_model_sees
from fosopt.solve.front import Request, Search, answer
from fosopt.study import dump_study, parse_study
from fosopt.study.build import build_problem, start_vector
from fosopt.study.describe_loop import describe_controller

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


def test_a_constraint_is_met_by_the_sampled_loop_after_optimizing_its_model():
    text = single(
        "jitter_total",
        "  - metric: modulus_margin\n    lower: 0.5\n",
        **{CROSSOVER: CROSSOVER + BUILT},
    )
    text = text.replace("    group_by: kind               #", "    group_by: all    #")
    study, problem = problem_of(text)
    start = start_vector(study, problem)
    outcome = answer(problem, Request("it", "it", "simultaneous", 0, (start,)), Search())
    assert outcome.solution.status == "optimal"
    x = outcome.solution.x
    row = Rows(problem, (problem.constraints[0].expression,))
    truth = row.values(x, problem.evaluate(x, truth=True))[0]
    model = row.values(x, problem.evaluate(x))[0]
    assert truth == pytest.approx(0.5, abs=1e-5)
    assert abs(model - truth) > 1e-4
    (moved,) = as_model_sees(problem, problem.constraints, x)
    assert moved.lower == pytest.approx(0.5 - (truth - model), abs=0, rel=1e-12)
    found = certify(problem, x, problem.constraints, problem.objectives[0], np.ones(x.size, bool))
    assert found.verified, found.reasons
    # Of a loop that is not sampled, constraints stay as they are.
    bare = replace(problem.base.loop.controller, path=type(problem.base.loop.controller.path)())
    base = replace(problem.base, loop=replace(problem.base.loop, controller=bare))
    assert as_model_sees(replace(problem, base=base), problem.constraints, x) == problem.constraints


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
        (built(("rate: 5 kHz", "rate: 1 kHz")), "Nyquist"),
        (built(("delay: 100 us", "delay: 100 us, derivative: trapezoidal")), "ring at every second sample"),
        (built(("delay: 100 us", "dealy: 100 us")), "unknown key; did you mean 'delay'"),
        (built(("depth: 0.2", "depth: -0.2")), "is negative"),
        (built(("type: low_pass, corner: 4 kHz", "type: rational, numerator: [1], denominator: [1, -1]")), "decay"),
        (built(("type: held                     #", "type: free #"), ("  bandwidth: 0.1 Hz\n", ""),
               ("  damping_ratio: 0.7\n", "")), "free hub drifts"),
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
