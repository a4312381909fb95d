"""Sampled loops that several test modules share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import reference
from scipy import linalg

from fosopt.actuators import Mirror
from fosopt.control import PID, Loop, Sampling, SignalPath, low_pass_filter, notch_filter, plant_state_space
from fosopt.control.discrete import discrete_controller

HZ = reference.HZ
ANTI_ALIAS = (low_pass_filter(4000 * HZ, 2),)


def sampled(period, delay=0.0, *, gain=0.3, rolloff_time=1e-4, anti_alias=ANTI_ALIAS, **sampling):
    """The reference loop, sampled, and its modes."""
    of = reference.structure()
    loop = reference.loop_of(reference.mirror_of(of, 0.2), rolloff_time)
    path = SignalPath((notch_filter(384 * HZ, 0.3, 0.2),), anti_alias, Sampling(period, delay, **sampling))
    pid = replace(loop.controller, gain=gain * loop.controller.gain, path=path)
    return replace(loop, controller=pid), reference.modes_of(of)


def rigid(gain, sampling, damping_ratio=0.05, **pid):
    """A mirror of 1 kg m² at 100 rad/s on a structure too heavy to move, under proportional control or more."""
    _, modes = reference.benchmark(None)
    terms = {"kp": 1.0, "ki": 0.0, "kd": 0.0} | pid
    controller = PID(gain, path=SignalPath(sampling=sampling), **terms)
    return Loop(Mirror(1.0, 100.0, damping_ratio), controller), modes


def plain_simulation(loop, modes, count, steps, command):
    """The loop in small equal steps of T/count, with the delay a multiple of that: angle, stroke, rate and torque."""
    plant = plant_state_space(loop, modes, "tip")
    n = plant.a.shape[0]
    period, delay = loop.controller.path.sampling.period, loop.controller.path.sampling.delay
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = plant.a, plant.b[:, plant.inputs.index("control_torque")]
    carried = linalg.expm(whole * period / count)
    controller = discrete_controller(loop.controller)
    x, held, queue = np.zeros(n), 0.0, {}
    memory = [
        ([0.0] * len(t.numerator), [0.0] * len(t.numerator)) for t in (*controller.filters, *controller.pid)
    ]
    angle, rate = (plant.c[plant.outputs.index(f"mirror_{name}")] for name in ("angle", "rate"))
    port = np.zeros(n)
    port[: modes.natural_frequency.size] = modes.at("tip")
    turning = np.roll(port, n // 2)
    found = []

    def run(term, state, value):
        ins, outs = state
        ins[1:], ins[0] = ins[:-1], value
        result = np.dot(term.numerator, ins) - np.dot(term.denominator[1:], outs[: len(term.denominator) - 1])
        outs[1:], outs[0] = outs[:-1], result
        return result

    late = round(delay / period * count)
    for k in range(steps * count):
        if k % count == 0:
            e = command(k // count) - angle @ x
            for term, state in zip(controller.filters, memory, strict=False):
                e = run(term, state, e)
            torques = zip(controller.pid, memory[len(controller.filters) :], strict=True)
            queue[k + late] = sum(run(term, state, e) for term, state in torques)
        held = queue.pop(k, held)
        found.append([angle @ x, (angle - port) @ x, (rate - turning) @ x, held])
        x = (carried @ np.append(x, held))[:n]
    return np.array(found)
