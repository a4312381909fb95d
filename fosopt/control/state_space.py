"""State-space form of plant and closed loop, for time simulation, export and independent checks.

    ẋ = A x + B u,   y = C x + D u

with x = [coordinates q, velocities q̇, anti-alias filters, filters on the error, integral of the error, derivative
filter] and q = [modal coordinates, mirror angle, mirror reaction mass, proof masses].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fosopt.control.filter_states import FilterStates, filter_state_space
from fosopt.control.loop import Loop
from fosopt.errors import ModelError, did_you_mean
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray
from fosopt.plant import CoupledMatrices, coupled_matrices

INPUTS = ("mirror_torque", "hub_torque", "line_of_sight", "sensor_noise", "command")
OUTPUTS = ("mirror_angle", "line_of_sight")


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
    rows = {port: modes.at(port) for port in loop.ports(mirror_port)}
    return coupled_matrices(structure, rows, mirror_port, loop.mirror, loop.placement, loop.actuators)


def plant_state_space(loop: Loop, modes: ModalSet, mirror_port: str) -> StateSpace:
    """Structure, mirror and actuators without the controller.    [Barker1991] Eqs. (2.51)-(2.54)

    Inputs are the control torque, an external torque on the mirror, a torque on the hub [N m] and the interaction
    force of each reaction-mass actuator [N]. Outputs are mirror angle [rad] and rate [rad/s], the sensed angle and
    rate, the angle of the mirror's reaction mass if it has one, and the relative velocity of each proof mass [m/s].
    """
    coupled = modal_matrices(loop, modes, mirror_port)
    size, n = coupled.mass.shape[0], modes.natural_frequency.size
    on_mirror, on_hub, none = np.eye(size)[n], np.zeros(size), np.zeros(size)
    on_hub[:n] = modes.at("hub")
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

    An ideal derivative differentiates what it measures. Those inputs u enter as B₀ u + B₁ u̇; with the states
    x − B₁ u the derivative disappears, A B₁ + B₀ takes the place of B, and y is unchanged because C B₁ = 0.
    """
    plant = plant_state_space(loop, modes, mirror_port)
    pid = loop.controller
    n = plant.a.shape[0]
    lagging = pid.lag > 0 and pid.kd != 0
    anti_alias, on_error = filter_state_space(pid.path.anti_alias), filter_state_space(pid.path.on_error)
    places = np.cumsum([0, n, anti_alias.order, on_error.order, int(pid.ki != 0), int(lagging)])
    size = int(places[-1])
    _, xa, xe, xi, w = (slice(int(i), int(j)) for i, j in pairwise(places))
    # Signals as rows over [states, measured, command, and the rates of these two].
    signals = np.eye(size + 4)
    measured, command, measured_rate, command_rate = signals[size:]

    def of_plant(row: Array) -> Array:
        return np.append(row, np.zeros(size + 4 - n))

    def passed(part: FilterStates, states: slice, value: Array, rate: Array) -> tuple[Array, Array, Array]:
        """Rates of a filter's states, its output and the rate of that."""
        moved = part.a @ signals[states] + np.outer(part.b, value)
        return moved, part.c @ signals[states] + part.d * value, part.c @ moved + part.d * rate

    mirror, _, angle, turning = (of_plant(row) for row in plant.c[:4])
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
    rows[:n, :n] += plant.a
    rows[:n] += pid.gain * np.outer(plant.b[:, 0], torque)
    a, direct, derivative = rows[:, :size], rows[:, size : size + 2], rows[:, size + 2 :]
    column = direct + a @ derivative
    external = np.zeros((size, 2))
    external[:n] = plant.b[:, 1:3]
    b = np.column_stack([external, column[:, 0], column[:, 0], column[:, 1]])
    c = np.vstack([mirror[:size], mirror[:size]])
    d = np.zeros((2, 5))
    d[1, INPUTS.index("line_of_sight")] = 1.0
    return StateSpace(a, b, c, d, INPUTS, OUTPUTS)
