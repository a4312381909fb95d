"""From the disturbances of a study to their spectra."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np

from fosopt.metrics import disturbances as shaping
from fosopt.study.files import read_psd
from fosopt.study.schema import Study
from fosopt.study.schema_system import Disturbance


def disturbance_of(study: Study, given: Disturbance) -> shaping.Disturbance:
    """A disturbance of a study; about both axes of a mirror with two where the study does not say which."""
    band = given.band or (0.0, inf)
    axis = given.axis or ("first" if study.second_axis is None else "both")
    if given.filter is None:
        table = read_psd(study, given)
        return shaping.Disturbance(
            given.name,
            given.at,
            None,
            np.array(table.frequency),
            np.array(table.psd),
            band,
            table.interpolation,
            axis,
        )
    return shaping.Disturbance(given.name, given.at, _filter(given.filter), band=band, axis=axis)


def _filter(given: Any) -> shaping.ShapingFilter:
    if given.type == "low_pass":
        return shaping.low_pass(given.corner, given.rms, given.order)
    if given.type == "high_pass":
        return shaping.high_pass(given.corner, given.density, given.order)
    if given.type == "band_pass":
        return shaping.band_pass(given.lower, given.upper, given.rms, given.order)
    if given.type == "white":
        return shaping.white(given.density)
    return shaping.ShapingFilter(given.numerator, given.denominator)
