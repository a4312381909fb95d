"""Plant, controller and closed loop of a design as a MATLAB file, with the names and units of all signals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fosopt.control import StateSpace
from fosopt.export.matlab import struct_of_texts
from fosopt.export.writing import written_to


def write_systems(
    systems: Mapping[str, StateSpace],
    about: Mapping[str, str | bool],
    provenance: Mapping[str, Any],
    path: Path,
) -> None:
    """Write systems as structs with A, B, C, D, ``dt`` and the names and units of inputs and outputs.

    ``dt`` is zero for a continuous system, else its period [s]. ``about`` says what design they are of, ``provenance``
    where it came from.

    Raises
    ------
    ExportError
        If the file cannot be written.
    """
    # SciPy takes a while to import, and only this needs it.
    import numpy as np
    from scipy.io import savemat

    def cells(texts: tuple[str, ...]) -> Any:
        return np.array(texts, dtype=object)

    content: dict[str, Any] = {
        name: {
            "A": system.a,
            "B": system.b,
            "C": system.c,
            "D": system.d,
            "dt": 0.0 if system.period is None else system.period,
            "inputs": cells(system.inputs),
            "input_units": cells(tuple(map(signal_unit, system.inputs))),
            "outputs": cells(system.outputs),
            "output_units": cells(tuple(map(signal_unit, system.outputs))),
        }
        for name, system in systems.items()
    }
    content["about"] = dict(about)
    content["provenance"] = struct_of_texts(provenance)
    with written_to(path) as temporary, temporary.open("wb") as stream:
        savemat(stream, content, long_field_names=True)


def signal_unit(name: str) -> str:
    """Unit of a signal of `control.StateSpace`, by its name."""
    if name.startswith("actuator_force"):
        return "N"
    if name.startswith("actuator_rate"):
        return "m/s"
    if name.endswith("_torque"):
        return "N m"
    return "rad/s" if name.endswith("_rate") else "rad"
