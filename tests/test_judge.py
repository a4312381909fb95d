"""Verdicts that follow from rows, and where the phase of a drawn response starts."""

from __future__ import annotations

import numpy as np
import pytest

from fosopt.reproduce.bode import bode_panels, resolved_response
from fosopt.reproduce.entry import Comparison
from fosopt.reproduce.judge import NOTHING_SAID, agrees, claim, judged
from fosopt.reproduce.published import Printed

HZ = 2 * np.pi


@pytest.mark.parametrize(
    ("printed", "computed", "expected"),
    [
        (Printed("9.50"), 9.5049, True),
        (Printed("9.50"), 9.5051, False),
        (Printed("9.50"), 9.4951, True),
        (Printed("10"), 10.4, True),
        (Printed("10"), 10.6, False),
        (7, 7, True),
        (7, 8, False),
        ("interlaced", "interlaced", True),
        ("interlaced", "not interlaced", False),
        (7, "seven", False),
        (None, 3.0, True),
    ],
)
def test_a_number_agrees_to_its_printed_digits_and_a_statement_word_by_word(printed, computed, expected):
    assert agrees(Comparison("row", printed, computed)) == expected


def test_one_row_apart_makes_a_difference_and_is_named():
    rows = [Comparison("first", 7, 7), Comparison("second", 7, 8), Comparison("third", None, 1.0)]
    found = judged("text", rows)
    assert found.verdict == "differs"
    assert "second" in found.reason and "first" not in found.reason and "third" not in found.reason
    assert judged("text", rows, differs="because").reason == "because"
    assert judged("text", rows[:1]).verdict == "matches"


def test_without_a_published_row_nothing_can_be_determined():
    for rows in ((), [Comparison("third", None, 1.0)]):
        found = judged("text", rows)
        assert (found.verdict, found.reason) == ("not determinable", NOTHING_SAID)


def test_a_claim_says_what_the_text_says_only_if_it_holds():
    assert agrees(claim("zeros", "interlaced", True, "not"))
    refuted = claim("zeros", "interlaced", np.bool_(False), "not", "note")
    assert (refuted.published, refuted.computed, refuted.note) == ("interlaced", "not", "note")


@pytest.mark.parametrize(
    ("zeros", "poles", "gain", "start", "end"),
    [
        ([], [-1 + 10j, -1 - 10j], 1.0, 0.0, -180.0),
        ([], [-1 + 10j, -1 - 10j], -1.0, -180.0, -360.0),
        ([0.0, 0.0], [-1 + 10j, -1 - 10j], 1.0, 180.0, 0.0),
        ([], [0.0, 0.0], 1.0, -180.0, -180.0),
        # A real zero in the right half plane leads from a negative to a positive gain: the value decides.
        ([10.0], [0.0, 0.0], -1.0, -180.0, -270.0),
        ([10.0, 20.0], [0.0, 0.0, -1e4], 1.0, -180.0, -360.0),
        # What cancels at the origin turns nothing.
        ([0.0, 0.0], [0.0, 0.0, -1 + 10j, -1 - 10j], 1.0, 0.0, -180.0),
    ],
)
def test_a_phase_starts_where_integrators_and_the_sign_of_the_gain_put_it(zeros, poles, gain, start, end):
    zeros, poles = np.array(zeros, complex), np.array(poles, complex)

    def transfer(s):
        up = np.prod(s[:, None] - zeros, axis=1)
        return gain * up / np.prod(s[:, None] - poles, axis=1)

    response = resolved_response("", transfer, zeros, poles, 1e-3, 300.0)
    assert response.phase[0] == pytest.approx(start, abs=0.5)
    assert response.phase[-1] == pytest.approx(end, abs=15.0)
    angle = np.degrees(np.angle(response.value))
    assert np.cos(np.radians(response.phase - angle)) == pytest.approx(1.0)


def test_panels_show_decibels_and_degrees_over_hertz():
    response = resolved_response(
        "name", lambda s: 100.0 / (s + HZ), np.zeros(0, complex), np.array([-HZ + 0j]), 0.1, 10.0, 21
    )
    magnitude, phase = bode_panels([response], "m/N")
    assert magnitude.curves[0].x[0] == pytest.approx(0.1) and magnitude.curves[0].label == "name"
    assert "m/N" in magnitude.y_label
    at_one = np.argmin(np.abs(magnitude.curves[0].x - 1.0))
    assert magnitude.curves[0].y[at_one] == pytest.approx(20 * np.log10(100 / (HZ * 2**0.5)))
    assert phase.curves[0].y[at_one] == pytest.approx(-45.0)
