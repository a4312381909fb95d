"""Reactionless mirrors, placements and reaction-mass actuators of a study file."""

from __future__ import annotations

import json
from typing import Any

import pytest
from small_studies import analysis, edited, run_text

from fosopt.errors import StudyError
from fosopt.study import parse_study
from fosopt.study.build import build_problem
from fosopt.study.describe import describe_study

CONTROLLER = "controller:                      # K(s)"
ACTUATORS = """\
actuators:
  - {port: B3.y, mass: 1 kg, frequency: 10 Hz, damping_ratio: 0.05, rate_gain: 20 N s/m}
  - {port: B2.rz, inertia: 10 kg cm^2, frequency: 40 Hz, damping_ratio: 0.05, rate_gain: 0.1 N m s/rad}
"""
MIRROR = "  frequency: 20 Hz\n  damping_ratio: 0.01\n"
REACTIONLESS = MIRROR + "  reaction_mass: {inertia_ratio: 0.9, torque_ratio: 110 %}\n"
PLACEMENT = "placement: {reaction: B2.rz}\n"


PARTS = ((CONTROLLER, PLACEMENT + ACTUATORS + CONTROLLER), (MIRROR, REACTIONLESS))


def with_actuators(*changes: tuple[str, str]) -> str:
    return edited(*PARTS, *changes)


def refusal(text: str) -> str:
    with pytest.raises(StudyError) as caught:
        build_problem(parse_study(text))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_every_part_arrives_in_the_loop_in_si_units():
    loop = build_problem(parse_study(with_actuators())).base.loop
    shares = loop.mirror.reaction_mass
    assert (shares.inertia_ratio, shares.stiffness_ratio, shares.torque_ratio) == (
        0.9,
        1.0,
        pytest.approx(1.1),
    )
    assert (loop.placement.reaction, loop.placement.sensor, loop.placement.action) == ("B2.rz", None, None)
    along, turning = loop.actuators
    assert (along.port, along.mass, along.rate_gain, along.rotary) == ("B3.y", 1.0, 20.0, False)
    assert (turning.port, turning.mass, turning.rate_gain, turning.rotary) == (
        "B2.rz",
        pytest.approx(1e-3),
        0.1,
        True,
    )


def test_a_check_shows_every_part():
    text = "\n".join(describe_study(parse_study(with_actuators())))
    assert "reactionless: inertia 0.9, stiffness 1 and torque 1.1 of the mirror's" in text
    assert "placement   reaction at B2.rz" in text
    assert "at port B3.y: proof mass 1 kg, 10 Hz, damping ratio 0.05, rate gain 20 N s/m" in text
    assert "at port B2.rz: proof mass 0.001 kg m^2" in text


def test_a_study_with_every_part_is_verified_and_reported(tmp_path):
    run = run_text(analysis(*PARTS), tmp_path)
    (point,) = run["points"]
    assert point["verified"], point["reason"]
    modes: list[dict[str, Any]] = point["detail"]["modes"]
    assert {row["pole_zero_separation"] for row in modes} == {None}
    assert sum(row["effective_modal_reaction_inertia"] for row in modes) > 0
    # The proof mass that moves along counts, the one that turns does not.
    plain = run_text(analysis(), tmp_path / "plain")["points"][0]
    assert point["metrics"]["total_mass"] - plain["metrics"]["total_mass"] == pytest.approx(1.0, rel=1e-12)
    assert json.loads((tmp_path / "out" / "front.json").read_text()) is not None


def test_a_reaction_at_the_port_of_the_mirror_is_the_usual_one():
    named = with_actuators((PLACEMENT, "placement: {reaction: B3.rz}\n"))
    assert build_problem(parse_study(named)).base.loop.placement.reaction is None


def test_a_metric_of_bicollocated_mirrors_is_refused_for_others():
    problem = build_problem(parse_study(with_actuators()))
    evaluation = problem.evaluate(problem.start)
    with pytest.raises(Exception, match=r"pole_zero_separation\[2\] is a metric of a bicollocated mirror"):
        evaluation.value("pole_zero_separation", 2)
    assert evaluation.value("structure_frequency", 2) > 0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "reaction: B2.rz",
            "reaction: B9.rz",
            "placement.reaction: port 'B9.rz' does not exist; did you mean",
        ),
        (
            "reaction: B2.rz",
            "sensor: tipp",
            "placement.sensor: port 'tipp' does not exist; did you mean 'tip'",
        ),
        ("reaction: B2.rz", "action: tip", "placement.action: the torque acts and reacts at 'tip'"),
        (
            "reaction: B2.rz",
            "reaction: B2.rz, action: B2.rz",
            "placement.action: the torque acts and reacts at 'B2.rz'",
        ),
        ("port: B3.y", "port: B3.w", "actuators.0.port: port 'B3.w' does not exist; did you mean"),
        ("mass: 1 kg, ", "", "one of mass, inertia is required"),
        ("mass: 1 kg, ", "mass: 1 kg, inertia: 1 kg m^2, ", "exclude each other"),
        ("mass: 1 kg", "mass: 0 kg", "a proof mass of zero does nothing"),
        ("20 N s/m", "20 N m s/rad", "N s/m"),
        ("rate_gain: 20 N s/m", "rate_gain: -1", "negative"),
        ("inertia_ratio: 0.9", "inertia_ratio: 0", "mirror.reaction_mass.inertia_ratio"),
        ("torque_ratio: 110 %", "torque_ratio: -1", "mirror.reaction_mass.torque_ratio"),
    ],
)
def test_what_contradicts_itself_is_refused_with_its_place(old, new, words):
    text = with_actuators()
    assert old in text
    assert words in refusal(text.replace(old, new, 1))
