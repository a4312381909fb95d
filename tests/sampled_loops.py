"""Sampled loops that several test modules share."""

from __future__ import annotations

from dataclasses import replace

import reference

from fosopt.actuators import Mirror
from fosopt.control import PID, Loop, Sampling, SignalPath, low_pass_filter, notch_filter

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
