"""Plant and controller as objects of python-control and SciPy, and as a MATLAB file.

python-control is an optional extra, `pip install fosopt[control]`, imported when it is first needed.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import signal

from fosopt.control import OTHER, Loop, StateSpace, loop_transfer, plant_state_space
from fosopt.control.sampled import sampled_loop
from fosopt.control.systems import (
    controller_state_space,
    sampled_controller_state_space,
    sampled_plant_state_space,
)
from fosopt.errors import FosoptError, ModelError, did_you_mean
from fosopt.metrics.functional import LoopModel
from fosopt.modes import ModalSet
from fosopt.ops import Array

if TYPE_CHECKING:
    import control


def systems(loop: Loop, modes: ModalSet, mirror_port: str) -> dict[str, StateSpace]:
    """Plant and controller of a loop, and where it is sampled both as the controller sees them.

    ``plant`` has disturbance torques and all motions; ``controller`` is left out where its derivative does not roll
    off. ``sampled_plant`` holds hold, delay and anti-alias filters, ``sampled_controller`` what the computer runs.
    Close the loop from ``control_torque`` to ``control_torque`` through ``sensor_angle``. A second axis has its own
    controller and signals, `control.OTHER` before their names, and its loop is closed through its ``mirror_angle``.
    """
    found = {"plant": plant_state_space(loop, modes, mirror_port)}
    if loop.beside is not None:
        with suppress(ModelError):
            found[f"{OTHER}controller"] = controller_state_space(loop.beside.controller)
    try:
        found["controller"] = controller_state_space(loop.controller)
    except ModelError:
        if loop.controller.path.sampling is None:
            return found
    if loop.controller.path.sampling is not None:
        found["sampled_plant"] = sampled_plant_state_space(loop, modes, mirror_port)
        found["sampled_controller"] = sampled_controller_state_space(loop.controller)
    return found


def control_system(system: StateSpace, name: str | None = None) -> control.StateSpace:
    """A system of python-control with the same signals.

    Raises
    ------
    FosoptError
        If python-control is not installed.
    """
    step = 0 if system.period is None else system.period
    return _control().ss(
        system.a,
        system.b,
        system.c,
        system.d,
        step,
        inputs=list(system.inputs),
        outputs=list(system.outputs),
        name=name,
    )


def loop_transfer_data(
    loop: Loop, modes: ModalSet, mirror_port: str, frequency: Array
) -> control.FrequencyResponseData:
    """The loop transfer function L(jω), of a sampled loop L(e^{jωT}), as frequency response data of python-control.

    Parameters
    ----------
    frequency
        (m,) ascending, of a sampled loop at most its Nyquist frequency [rad/s].

    Raises
    ------
    ModelError
        For frequencies beyond the Nyquist frequency.
    FosoptError
        If python-control is not installed.
    """
    sampling = loop.controller.path.sampling
    if sampling is None:
        points = LoopModel(loop, modes, mirror_port).points(1j * frequency)
        return _control().frd(loop_transfer(loop, points.s, points.g), frequency)
    top = np.pi / sampling.period
    if frequency.max() > top * (1 + 1e-12):
        raise ModelError(
            f"loop transfer: {frequency.max():.6g} rad/s is beyond the Nyquist frequency {top:.6g} rad/s"
        )
    sampled = sampled_loop(loop, modes, mirror_port)
    return _control().frd(
        sampled.loop_transfer(np.exp(1j * frequency * sampling.period)), frequency, sampling.period
    )


def scipy_system(system: StateSpace, input_name: str, output_name: str) -> signal.StateSpace:
    """One input and one output of a system as `scipy.signal.StateSpace`, discrete where it has a period.

    Raises
    ------
    ModelError
        For an unknown signal.
    """
    for name, known in ((input_name, system.inputs), (output_name, system.outputs)):
        if name not in known:
            raise ModelError(f"signal '{name}' does not exist; {did_you_mean(name, known)}")
    column, row = system.inputs.index(input_name), system.outputs.index(output_name)
    parts = system.a, system.b[:, [column]], system.c[[row]], system.d[[row]][:, [column]]
    return signal.StateSpace(*parts) if system.period is None else signal.StateSpace(*parts, dt=system.period)


def _control() -> Any:
    try:
        import control
    except ImportError as error:
        raise FosoptError(
            "python-control is not installed; install it with: pip install 'fosopt[control]'"
        ) from error
    return control
