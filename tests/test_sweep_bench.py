"""What points of a sweep share is built once, and is what each of them would build."""

from __future__ import annotations

import numpy as np
import pytest
from test_sweep_study import over, sweep_text

from fosopt.study import parse_study
from fosopt.study.sweep_points import bench


@pytest.mark.parametrize(
    ("quantity", "values"),
    [
        ("area_scale", (0.5, 2.0)),
        ("mirror_mass", (5.0, 40.0)),
        ("damping_ratio", (0.001, 0.02)),
        ("bays", (3, 4)),
    ],
)
def test_what_a_point_takes_over_from_another_one_changes_no_bit(quantity, values):
    study = parse_study(sweep_text(over("{quantity: kp, list: [600]}", "stable")))
    known = bench(study, {quantity: values[0]})
    fresh, reused = bench(study, {quantity: values[1]}), bench(study, {quantity: values[1]}, known)
    assert (reused.problem is known.problem) == (quantity != "bays")
    for name in ("natural_frequency", "damping_ratio", "mode_shape"):
        assert np.array_equal(getattr(fresh.first.modes, name), getattr(reused.first.modes, name))
    assert not np.array_equal(known.first.modes.damping, reused.first.modes.damping)
    assert fresh.first.value("spectral_abscissa") == reused.first.value("spectral_abscissa")
