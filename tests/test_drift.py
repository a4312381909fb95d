"""The drift of a free structure under an external torque, counted from a lower band edge."""

from __future__ import annotations

from math import inf, pi

import numpy as np
import pytest
import reference

from fosopt.control import closed_loop_poles, closed_loop_response
from fosopt.metrics.disturbances import Disturbance, white
from fosopt.metrics.functional import LoopModel
from fosopt.metrics.jitter import jitter_variances


@pytest.mark.parametrize("lower", [1e-2, 1e-4, 1e-7])
def test_what_lies_below_the_slowest_pole_grows_with_the_reciprocal_of_the_band_edge(lower):
    loop, modes = reference.benchmark(4)
    model, poles = LoopModel(loop, modes, "tip"), closed_loop_poles(loop, modes, "tip")
    upper = 0.1
    edges = [
        Disturbance(f"from {edge}", "mirror_torque", white(1.0), band=(edge, inf)) for edge in (lower, upper)
    ]
    more = np.subtract(*(v.value for v in jitter_variances(model, poles, edges)))
    # With integral action the output goes as c/s there, but for (ω/ω_1)² of the slowest pole ω_1 ~ 100 rad/s.
    s = np.array([1e-8j])
    c = s * closed_loop_response("mirror_torque", loop, s, model.points(s).g)
    expected = abs(c[0]) ** 2 * (1 / lower - 1 / upper) / (2 * pi)
    assert more == pytest.approx(expected, rel=1e-5)
