"""State-space form of plant and closed loop, for time simulation, export and independent checks.

    ẋ = A x + B u,   y = C x + D u

with x = [coordinates q, velocities q̇, anti-alias filters, filters on the error, integral of the error, derivative
filter] and q = [modal coordinates, mirror angle, mirror reaction mass, proof masses].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import linalg

from fosopt.control.filter_states import FilterStates, filter_state_space
from fosopt.control.loop import Loop
from fosopt.control.pid import PID
from fosopt.errors import ModelError, did_you_mean
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray
from fosopt.plant import CoupledMatrices, coupled_matrices

INPUTS = ("mirror_torque", "hub_torque", "line_of_sight", "sensor_noise", "command")
OUTPUTS = ("mirror_angle", "line_of_sight")
OTHER = "second_axis_"
"""Before the names of signals about a mirror's second axis."""


@dataclass(frozen=True)
class StateSpace:
    """A linear system with named inputs and outputs.

    Attributes
    ----------
    a, b, c, d
        (n, n), (n, m), (p, n), (p, m).
    inputs, outputs
        (m,), (p,) names.
    period
        Of a system from sample to sample, in whose response s is z; None for a continuous one [s].
    """

    a: Array
    b: Array
    c: Array
    d: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    period: float | None = None

    def response(self, s: ComplexArray, input_name: str, output_name: str) -> ComplexArray:
        """(m,) C (sI − A)⁻¹ B + D from one input to one output at (m,) Laplace variables.

        Raises
        ------
        ModelError
            For an unknown name.
        """
        for name, known in ((input_name, self.inputs), (output_name, self.outputs)):
            if name not in known:
                raise ModelError(f"signal '{name}' does not exist; {did_you_mean(name, known)}")
        column, row = self.inputs.index(input_name), self.outputs.index(output_name)
        identity = np.eye(self.a.shape[0])
        moved = [np.linalg.solve(point * identity - self.a, self.b[:, column]) for point in s]
        return np.array(moved).reshape(s.size, -1) @ self.c[row] + self.d[row, column]


def modal_matrices(loop: Loop, modes: ModalSet, mirror_port: str) -> CoupledMatrices:
    """Mirror and actuators of a loop attached to a modal set, in its modal coordinates."""
    structure = (np.eye(modes.natural_frequency.size), np.diag(modes.damping), np.diag(modes.stiffness))
    return loop_matrices(loop, structure, modes.at, mirror_port)


def loop_matrices(
    loop: Loop, structure: tuple[Array, Array, Array], row: Callable[[str], Array], mirror_port: str
) -> CoupledMatrices:
    """Mirror and actuators of a loop attached to a structure.

    Parameters
    ----------
    structure, row
        (n, n) mass, damping and stiffness, and the (n,) row that reads a port's motion, in any coordinates.
    """
    rows = {port: row(port) for port in loop.ports(mirror_port)}
    other = None if loop.beside is None else (loop.beside.port, loop.beside.mirror)
    return coupled_matrices(structure, rows, mirror_port, loop.mirror, loop.placement, loop.actuators, other)


def plant_state_space(loop: Loop, modes: ModalSet, mirror_port: str) -> StateSpace:
    """Structure, mirror and actuators without the controller.    [Barker1991] Eqs. (2.51)-(2.54)

    Inputs are the control torque, an external torque on the mirror, a torque on the hub [N m] and the interaction
    force of each reaction-mass actuator [N]. Outputs are mirror angle [rad] and rate [rad/s], the sensed angle and
    rate, the angle of the mirror's reaction mass if it has one, and the relative velocity of each proof mass [m/s].
    A second axis adds its torques and motions after these, their names with `OTHER` before them.
    """
    coupled = modal_matrices(loop, modes, mirror_port)
    size, n = coupled.mass.shape[0], modes.natural_frequency.size
    on_mirror, on_hub, none = np.eye(size)[n], np.zeros(size), np.zeros(size)
    on_hub[:n] = modes.at(loop.hub)
    loads = {"control_torque": coupled.control, "mirror_torque": on_mirror, "hub_torque": on_hub}
    motions = {
        "mirror_angle": np.append(on_mirror, none),
        "mirror_rate": np.append(none, on_mirror),
        "sensor_angle": np.append(coupled.sensor, none),
        "sensor_rate": np.append(none, coupled.sensor),
    }
    if coupled.counter is not None:
        motions["reaction_mass_angle"] = np.append(np.eye(size)[coupled.counter], none)
    for k, row in enumerate(coupled.relative):
        loads[f"actuator_force_{k + 1}"] = row
        motions[f"actuator_rate_{k + 1}"] = np.append(none, row)
    if coupled.other is not None and loop.beside is not None:
        angle = np.eye(size)[-1]
        loads[f"{OTHER}control_torque"], loads[f"{OTHER}mirror_torque"] = coupled.other, angle
        if loop.beside.hub is not None:
            loads[f"{OTHER}hub_torque"] = np.append(modes.at(loop.beside.hub), np.zeros(size - n))
        motions[f"{OTHER}mirror_angle"] = np.append(angle, none)
        motions[f"{OTHER}mirror_rate"] = np.append(none, angle)
    return _first_order(coupled.mass, coupled.damping, coupled.stiffness, loads, motions)


def second_order_state_space(
    mass: Array, damping: Array, stiffness: Array, ports: Mapping[str, Array]
) -> StateSpace:
    """State space of M q̈ + C q̇ + K q = f with a load and a motion at each port.

    The state is [q, q̇], the dissertation's two halves exchanged.    [Barker1991] Eqs. (2.51)-(2.54)

    Parameters
    ----------
    mass, damping, stiffness
        (n, n).
    ports
        Name to the (n,) row that reads a port's motion; its transpose applies the port's load.

    Returns
    -------
    StateSpace
        Inputs and outputs both carry the names of the ports.

    Raises
    ------
    ModelError
        If the mass matrix is singular.
    """
    motions = {name: np.append(row, np.zeros(mass.shape[0])) for name, row in ports.items()}
    return _first_order(mass, damping, stiffness, ports, motions)


def structure_state_space(modes: ModalSet, ports: Sequence[str]) -> StateSpace:
    """State space of a modal set alone, with a load and a motion at each named port.

    The state is [modal coordinates, their velocities].    [Barker1991] Eqs. (2.51)-(2.54)
    """
    matrices = (np.eye(modes.natural_frequency.size), np.diag(modes.damping), np.diag(modes.stiffness))
    return second_order_state_space(*matrices, {port: modes.at(port) for port in ports})


def _first_order(
    mass: Array, damping: Array, stiffness: Array, loads: Mapping[str, Array], motions: Mapping[str, Array]
) -> StateSpace:
    """M q̈ + C q̇ + K q = Σ load as a system of first order, with rows of [q, q̇] as outputs."""
    n = mass.shape[0]
    columns = np.array(list(loads.values())).reshape(len(loads), n).T
    try:
        moved = np.linalg.solve(mass, np.hstack([stiffness, damping, columns]))
    except np.linalg.LinAlgError as error:
        raise ModelError("state space: the mass matrix is singular; every coordinate needs mass") from error
    a = np.zeros((2 * n, 2 * n))
    a[:n, n:] = np.eye(n)
    a[n:] = -moved[:, : 2 * n]
    b = np.vstack([np.zeros((n, len(loads))), moved[:, 2 * n :]])
    c = np.array(list(motions.values())).reshape(len(motions), 2 * n)
    return StateSpace(a, b, c, np.zeros((len(motions), len(loads))), tuple(loads), tuple(motions))


def closed_loop_state_space(loop: Loop, modes: ModalSet, mirror_port: str) -> StateSpace:
    """Closed loop from all disturbances and the command to mirror angle and line of sight.

    Of a mirror with two axes both loops are closed; signals about the second one follow, their names with `OTHER`
    before them.
    """
    plant = plant_state_space(loop, modes, mirror_port)
    closed = _closed(plant, loop.controller, "", plant.a)
    if loop.beside is None:
        return closed
    every = _closed(plant, loop.beside.controller, OTHER, closed.a)
    return StateSpace(
        every.a,
        np.hstack([_rows_added(closed.b, every.a.shape[0]), every.b]),
        np.vstack([_rows_added(closed.c.T, every.a.shape[0]).T, every.c]),
        linalg.block_diag(closed.d, every.d),
        (*closed.inputs, *every.inputs),
        (*closed.outputs, *every.outputs),
    )


def _rows_added(matrix: Array, rows: int) -> Array:
    return np.vstack([matrix, np.zeros((rows - matrix.shape[0], matrix.shape[1]))])


def _closed(plant: StateSpace, pid: PID, axis: str, open_loop: Array) -> StateSpace:
    """A controller about one axis closed over a system whose first states are those of the plant.

    An ideal derivative differentiates what it measures. Those inputs u enter as B₀ u + B₁ u̇; with the states
    x − B₁ u the derivative disappears, A B₁ + B₀ takes the place of B, and y is unchanged because C B₁ = 0: a torque
    moves no mirror's angle at once, nor the rate of the mirror about the other axis.

    Parameters
    ----------
    axis
        What stands before the names of its signals.
    open_loop
        (n, n) state matrix of the system.
    """
    n = open_loop.shape[0]
    lagging = pid.lag > 0 and pid.kd != 0
    anti_alias, on_error = filter_state_space(pid.path.anti_alias), filter_state_space(pid.path.on_error)
    places = np.cumsum([0, n, anti_alias.order, on_error.order, int(pid.ki != 0), int(lagging)])
    size = int(places[-1])
    _, xa, xe, xi, w = (slice(int(i), int(j)) for i, j in pairwise(places))
    # Signals as rows over [states, measured, command, and the rates of these two].
    signals = np.eye(size + 4)
    measured, command, measured_rate, command_rate = signals[size:]

    def of_plant(name: str) -> Array:
        row = plant.c[plant.outputs.index(f"{axis}{name}")]
        return np.append(row, np.zeros(size + 4 - row.size))

    def load(name: str) -> Array:
        column = plant.b[:, plant.inputs.index(f"{axis}{name}")]
        return np.append(column, np.zeros(size - column.size))

    def passed(part: FilterStates, states: slice, value: Array, rate: Array) -> tuple[Array, Array, Array]:
        """Rates of a filter's states, its output and the rate of that."""
        moved = part.a @ signals[states] + np.outer(part.b, value)
        return moved, part.c @ signals[states] + part.d * value, part.c @ moved + part.d * rate

    mirror = of_plant("mirror_angle")
    # About its second axis a mirror is sensed at itself.
    sensed = ("sensor_angle", "sensor_rate") if not axis else ("mirror_angle", "mirror_rate")
    angle, turning = (of_plant(name) for name in sensed)
    moved, seen, seeing = passed(anti_alias, xa, angle + measured, turning + measured_rate)
    rows = np.zeros((size, size + 4))
    rows[xa] = moved
    rows[xe], error, erring = passed(on_error, xe, command - seen, command_rate - seeing)
    torque = pid.kp * error
    if pid.ki != 0:
        torque += pid.ki * signals[xi][0]
        rows[xi] = error
    if lagging:
        rate = (error - signals[w][0]) / pid.lag
        torque += pid.kd * rate
        rows[w] = rate
    else:
        torque += pid.kd * erring
    rows[:n, :n] += open_loop
    rows += pid.gain * np.outer(load("control_torque"), torque)
    a, direct, derivative = rows[:, :size], rows[:, size : size + 2], rows[:, size + 2 :]
    column = direct + a @ derivative
    torques = [name for name in ("mirror_torque", "hub_torque") if f"{axis}{name}" in plant.inputs]
    b = np.column_stack([*(load(name) for name in torques), column[:, 0], column[:, 0], column[:, 1]])
    inputs = (*torques, *INPUTS[2:])
    d = np.zeros((2, len(inputs)))
    d[1, inputs.index("line_of_sight")] = 1.0
    c = np.vstack([mirror[:size], mirror[:size]])
    names = tuple(f"{axis}{name}" for name in inputs), tuple(f"{axis}{name}" for name in OUTPUTS)
    return StateSpace(a, b, c, d, *names)
