"""Chapter 2, the mirror on the reduced structure: figures 2.29 to 2.32."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np

from fosopt.ops import Array
from fosopt.plant import coupled_modes
from fosopt.reproduce import chapter2_system as system
from fosopt.reproduce.bode import bode_panels
from fosopt.reproduce.entry import Comparison, Entry, Reproduction
from fosopt.reproduce.judge import claim, judged
from fosopt.units import HZ

_RANGE = (0.2, 300.0)  # drawn [Hz]
# The ends are published (section 2.5), the steps between them are not.
_PERCENTS = (0.2, 2.0, 10.0, 50.0)
_KINDS = {system.ELECTROMAGNETIC: "20 Hz", system.PIEZOELECTRIC: "10 kHz"}
_INERTIA = f"A mirror inertia of {system.MIRROR_PERCENT:g} % of the truss's is assumed."


def separation(hertz: float, percent: float) -> tuple[Array, Array]:
    """Zero [Hz] and β_k of each elastic mode in the mirror's own transfer function, the mirror mode left out."""
    coupled = coupled_modes(system.mirror_structure(), system.mirror(hertz, percent), "tip")
    paired = np.isfinite(coupled.zero)
    return np.sqrt(coupled.zero[paired]) / HZ, coupled.pole_zero_separation[paired]


def hub_response(hertz: float) -> Reproduction:
    """Hub rotation per hub torque of Model#2."""
    of = system.OpticalSystem(system.mirror(hertz))
    reduced, full = (
        system.mirror_structure(f).natural_frequency[1 : system.REDUCED] / HZ for f in (False, True)
    )
    return judged(
        f"Model#2 with a {_KINDS[hertz]} mirror of {100 * system.MIRROR_SHARE:.0f} % of the whole mass. {_INERTIA}",
        (
            Comparison(
                "natural frequencies", None, _list(of.natural_frequencies), "Hz", "without the rigid body"
            ),
            Comparison(
                "the same without mirror inertia",
                None,
                _list(reduced),
                "Hz",
                f"the mirror's mass is added after the reduction, as section 2.4.2 does; the full structure has "
                f"{_list(full)} Hz",
            ),
        ),
        bode_panels([of.response("", "hub", *_RANGE)], "rad/(N m)"),
    )


def figure_2_31() -> Reproduction:
    """Mirror transfer function with either mirror."""
    soft, stiff = (separation(hertz, system.MIRROR_PERCENT) for hertz in _KINDS)
    above = soft[0] > system.ELECTROMAGNETIC
    reversed_modes = np.all(soft[1][above] > 1) and np.all(stiff[1][above] < 1)
    return judged(
        f"Model#2 with a 20 Hz and a 10 kHz mirror. {_INERTIA} Zeros are the poles of the structure without mirror "
        "inertia, the same for both.",
        (
            claim(
                "pole-zero orientation of the flexible modes above 20 Hz",
                "reversed",
                reversed_modes,
                "not reversed",
                f"β of these modes {_list(soft[1][above])} (20 Hz) and {_list(stiff[1][above])} (10 kHz); of those "
                f"below {_list(soft[1][~above])} and {_list(stiff[1][~above])}",
            ),
        ),
        bode_panels(
            [
                system.OpticalSystem(system.mirror(h)).response(name, "mirror", *_RANGE)
                for h, name in _KINDS.items()
            ],
            "rad/(N m)",
        ),
    )


def figure_2_32() -> Reproduction:
    """Mirror transfer function over the mirror's inertia."""
    hertz = system.ELECTROMAGNETIC
    largest = [float(np.abs(separation(hertz, percent)[1] - 1).max()) for percent in _PERCENTS]
    return judged(
        "Model#2 with a 20 Hz mirror of several inertias, in percent of the truss's about the hub.",
        (
            claim(
                "pole-zero separation and inertia ratio",
                "a function of the inertia ratio",
                bool(np.all(np.diff(largest) > 0)),
                "no growth with the inertia ratio",
                f"largest |β − 1| at {_list(_PERCENTS)} %: {_list(largest)}",
            ),
        ),
        bode_panels(
            [
                system.OpticalSystem(system.mirror(hertz, percent)).response(
                    f"{percent:g} %", "mirror", *_RANGE
                )
                for percent in _PERCENTS
            ],
            "rad/(N m)",
        ),
    )


def _list(values: Iterable[float]) -> str:
    return ", ".join(f"{v:.4g}" for v in values)


ENTRIES = (
    Entry(
        "figure-2.29",
        "Hub rotation per hub torque, 20 Hz mirror, Model#2",
        partial(hub_response, system.ELECTROMAGNETIC),
    ),
    Entry(
        "figure-2.30",
        "Hub rotation per hub torque, 10 kHz mirror, Model#2",
        partial(hub_response, system.PIEZOELECTRIC),
    ),
    Entry("figure-2.31", "Mirror angle per mirror torque, 20 Hz and 10 kHz mirror, Model#2", figure_2_31),
    Entry("figure-2.32", "Mirror angle per mirror torque over the mirror's inertia, Model#2", figure_2_32),
)
