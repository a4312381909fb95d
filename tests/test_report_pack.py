"""What is packed for a report comes back as it was, as finely as a figure shows it."""

from __future__ import annotations

import json
from base64 import b64decode
from typing import Any

import fake_report as fake
import numpy as np
import pytest

from fosopt.report.pack import packed


def curve(value: Any) -> Any:
    """A curve unpacked as ``unpack.js`` does it."""
    if not (isinstance(value, list) and len(value) == 5 and isinstance(value[4], str)):
        return value
    size, logarithmic, low, high, text = value
    data = np.frombuffer(b64decode(text), np.uint8).reshape(-1, size).astype(float)
    found = low + data @ (256.0 ** np.arange(size)) * (high - low) / (256**size - 1)
    return 10**found if logarithmic else found


@pytest.fixture(scope="module")
def point() -> dict[str, Any]:
    return fake.point(3, 8.0)


def test_curves_come_back_to_a_thousandth_of_a_decibel_or_of_their_range(point):
    (found,), _ = packed([point])
    for name in ("bode", "spectrum", "cumulative", "step"):
        for key, given in point["detail"][name].items():
            back = curve(found["detail"][name][key])
            if not isinstance(given, list) or len(given) < 12:
                assert back == given
                continue
            given = np.array(given)
            size = 24 if key in ("frequency_hz", "time_s", "window_time_s") else 16
            if found["detail"][name][key][1]:
                error, span = np.abs(np.log10(back / given)), np.ptp(np.log10(given))
            else:
                error, span = np.abs(back - given), np.ptp(given)
            assert error.max() <= 0.5001 * span / (2**size - 1) + 1e-12 * span


def test_a_curve_that_is_none_stays_as_it_is(point):
    bode = {
        "frequency_hz": [1.0] * 20,
        "loop_phase_deg": None,
        "loop_magnitude": [None] * 20,
        "few": [1.0, 2.0],
    }
    (found,), _ = packed([{"detail": {"bode": bode}}])
    back = found["detail"]["bode"]
    assert curve(back["frequency_hz"]).tolist() == [1.0] * 20
    assert (back["loop_phase_deg"], back["loop_magnitude"], back["few"]) == (None, [None] * 20, [1.0, 2.0])


def test_points_of_one_truss_share_its_nodes(point):
    other = fake.point(4, 9.0)
    moved = json.loads(json.dumps(other))
    moved["detail"]["truss"]["nodes"][0] = [9.0, 9.0]
    found, trusses = packed([point, other, moved])
    assert [each["detail"]["truss"]["of"] for each in found] == [0, 0, 1]
    assert trusses[0]["nodes"] == point["detail"]["truss"]["nodes"]
    assert found[1]["detail"]["truss"]["areas"] == pytest.approx(other["detail"]["truss"]["areas"], rel=1e-5)


def test_tables_keep_six_digits_and_what_has_no_value(point):
    (found,), _ = packed([point])
    modes = found["detail"]["modes"]
    for row, given in zip(modes["rows"], point["detail"]["modes"], strict=True):
        for name, value in zip(modes["names"], row, strict=True):
            assert (value is None) == (given[name] is None)
            assert value is None or value == pytest.approx(given[name], rel=1e-5)
    assert found["history"][5] == pytest.approx(point["history"][5], rel=1e-5)
    assert found["metrics"] == point["metrics"]
    assert found["variables"] == point["variables"]


def test_rows_that_know_different_things_keep_them():
    (found,), _ = packed([{"detail": {"modes": [{"a": 1.0}, {"a": 2.0, "b": None}, {"b": 3.0}]}}])
    assert found["detail"]["modes"] == {"names": ["a", "b"], "rows": [[1.0, None], [2.0, None], [None, 3.0]]}


def test_packing_leaves_its_input_alone(point):
    before = json.dumps(point)
    packed([point])
    assert json.dumps(point) == before
