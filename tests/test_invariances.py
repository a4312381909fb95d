"""What cannot matter does not: units, names, orders, orientation; and what physics demands of every structure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import reference
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from fosopt.actuators import Mirror, ReactionMassActuator
from fosopt.control import PID, Loop, plant_state_space
from fosopt.metrics.disturbances import Disturbance, low_pass
from fosopt.modes import Damping, Hub
from fosopt.problem import Design, Evaluation, System
from fosopt.structure import Truss, assemble, barker_truss

HZ = reference.HZ
# Eigenvalues are right to rounding of the largest, a million times the lowest; what follows from them as well.
ROUNDING = 1e-9
LOS_RMS, TORQUE_RMS = 1e-5, 0.02
METRICS = ("jitter_air", "jitter_cooling", "modulus_margin", "loop_crossover", "first_elastic_frequency")


@dataclass(frozen=True)
class Case:
    """A truss with a loop, as an engineer writes it down."""

    truss: Truss
    mirror_mass: float
    mirror: Mirror
    pid: PID
    hub: Hub
    low_pass_corner: float = 8 * HZ
    torque_rms: float = TORQUE_RMS
    port: str = "tip"

    def evaluation(self) -> Evaluation:
        structure = assemble(self.truss, self.port)
        disturbances = (
            Disturbance("air", "line_of_sight", low_pass(self.low_pass_corner, LOS_RMS)),
            Disturbance("cooling", "mirror_torque", low_pass(self.low_pass_corner, self.torque_rms)),
        )
        system = System(structure, self.port, self.hub, Damping((0.004,)), disturbances)
        sizes = structure.area, structure.batten_mass, structure.spring_stiffness
        return Evaluation(system, Design(*sizes, self.mirror_mass, Loop(self.mirror, self.pid)))

    def metrics(self) -> np.ndarray:
        evaluation = self.evaluation()
        assert evaluation.stable
        return np.array([evaluation.value(name) for name in METRICS])


def case(seed: int, spatial: bool = False) -> Case:
    """A stable system that follows from its seed."""
    rng = np.random.default_rng(seed)
    truss = reference.square_mast(3, 1.3) if spatial else barker_truss("pinned", 5)
    bars = tuple(replace(bar, area=bar.area * rng.uniform(0.4, 2.5)) for bar in truss.bars)
    truss = replace(truss, bars=bars)
    mirror = Mirror(0.02 * rng.uniform(0.5, 2), 15 * HZ, 0.02)
    pid = PID(0.02 * rng.uniform(200, 500), 400.0, 2e4, 1.0, 3e-4)
    return Case(truss, 30.0, mirror, pid, Hub("fixed") if spatial else reference.HELD)


def agree(found: np.ndarray, expected: np.ndarray) -> None:
    assert np.abs(found / expected - 1).max() < ROUNDING


seeds = st.integers(0, 10**6)
factors = st.floats(0.01, 100.0)
few = settings(max_examples=10)


@few
@given(seed=seeds, spatial=st.booleans(), a=factors)
def test_a_clock_that_runs_faster_changes_frequencies_alone(seed, spatial, a):
    slow = case(seed, spatial)
    m, c, hub = slow.mirror, slow.pid, slow.hub
    fast = replace(
        slow,
        truss=replace(
            slow.truss, bars=tuple(replace(bar, young=bar.young * a**2) for bar in slow.truss.bars)
        ),
        mirror=replace(m, natural_frequency=a * m.natural_frequency),
        # C(s) with s in units of the new clock is a² that of the old.
        pid=PID(a * c.gain, a * c.kp, a**2 * c.ki, c.kd, c.rolloff_time / a),
        hub=hub if hub.bandwidth is None else replace(hub, bandwidth=a * hub.bandwidth),
        low_pass_corner=a * slow.low_pass_corner,
        torque_rms=a**2 * slow.torque_rms,
    )
    agree(fast.metrics(), slow.metrics() * np.array([1, 1, 1, a, a]))


@few
@given(seed=seeds, spatial=st.booleans(), m=factors)
def test_more_of_the_same_mass_and_stiffness_moves_alike(seed, spatial, m):
    light = case(seed, spatial)
    truss = light.truss

    def heavier(inertia):
        return m * inertia if isinstance(inertia, float) else tuple(m * x for x in inertia)

    heavy = replace(
        light,
        truss=replace(
            truss,
            bars=tuple(replace(bar, young=m * bar.young, density=m * bar.density) for bar in truss.bars),
            battens=tuple(replace(b, mass=m * b.mass, inertia=heavier(b.inertia)) for b in truss.battens),
        ),
        mirror_mass=m * light.mirror_mass,
        mirror=replace(light.mirror, inertia=m * light.mirror.inertia),
        pid=replace(light.pid, gain=m * light.pid.gain),
        torque_rms=m * light.torque_rms,
    )
    agree(heavy.metrics(), light.metrics())


@few
@given(seed=seeds, spatial=st.booleans(), k=factors)
def test_a_longer_unit_of_length_changes_no_angle(seed, spatial, k):
    given_one = case(seed, spatial)
    truss = given_one.truss

    def rotary(inertia):
        return k**2 * inertia if isinstance(inertia, float) else tuple(k**2 * x for x in inertia)

    scaled = replace(
        given_one,
        truss=replace(
            truss,
            nodes={name: tuple(k * x for x in xyz) for name, xyz in truss.nodes.items()},
            # The same stiffness E A / L and the same mass ρ A L of each bar.
            bars=tuple(replace(bar, young=k * bar.young, density=bar.density / k) for bar in truss.bars),
            battens=tuple(replace(b, inertia=rotary(b.inertia)) for b in truss.battens),
        ),
        mirror=replace(given_one.mirror, inertia=k**2 * given_one.mirror.inertia),
        pid=replace(given_one.pid, gain=k**2 * given_one.pid.gain),
        torque_rms=k**2 * given_one.torque_rms,
    )
    agree(scaled.metrics(), given_one.metrics())


@few
@given(seed=seeds, spatial=st.booleans())
def test_the_order_of_members_and_the_names_of_ports_do_not_matter(seed, spatial):
    one = case(seed, spatial)
    rng = np.random.default_rng(seed)
    truss = one.truss

    def shuffled(items):
        return [items[i] for i in rng.permutation(len(items))]

    turned = [replace(bar, nodes=bar.nodes[::-1]) if rng.random() < 0.5 else bar for bar in truss.bars]
    ports = {"nose" if name == "tip" else name: at for name, at in shuffled(list(truss.ports.items()))}
    other = replace(
        one,
        truss=replace(
            truss,
            nodes=dict(shuffled(list(truss.nodes.items()))),
            bars=tuple(shuffled(turned)),
            battens=tuple(replace(b, nodes=tuple(shuffled(b.nodes))) for b in shuffled(truss.battens)),
            ports=ports,
        ),
        port="nose",
    )
    agree(other.metrics(), one.metrics())
    # The gradient goes with the member, wherever it stands.
    gradients = []
    for each in (one, other):
        _, gradient = each.evaluation().metric("jitter_air")
        names = [bar.name for bar in each.truss.bars]
        gradients.append(gradient[np.argsort(names)])
    assert np.abs(gradients[1] - gradients[0]).max() < 1e-7 * np.abs(gradients[0]).max()


@few
@given(seed=seeds, spatial=st.booleans(), angle=st.floats(-3.2, 3.2))
def test_the_whole_may_stand_at_any_angle(seed, spatial, angle):
    upright = case(seed, spatial)
    truss = upright.truss
    cos, sin = np.cos(angle), np.sin(angle)
    if spatial:
        # About z, the axis the mirror turns about; inertias alike about all axes turn into themselves.
        battens = tuple(replace(b, inertia=(0.06, 0.06, 0.1)) for b in truss.battens)
        truss = replace(truss, battens=battens)
        upright = replace(upright, truss=truss)
    nodes = {
        name: (cos * xyz[0] - sin * xyz[1], sin * xyz[0] + cos * xyz[1], *xyz[2:])
        for name, xyz in truss.nodes.items()
    }
    slanted = replace(upright, truss=replace(truss, nodes=nodes))
    agree(slanted.metrics(), upright.metrics())


PORTS = ("tip", "middle")


def structure_modes(seed: int, hub: Hub):
    truss = case(seed).truss
    truss = replace(truss, ports=truss.ports | {"middle": ("B2", "y")})
    structure = assemble(truss, "tip")
    return reference.frame(structure, 30.0).modal_set(hub, Damping((0.004,)), ("hub", *PORTS))


@few
@given(seed=seeds, decay=st.floats(-3, 3), frequency=st.floats(-1, 5))
def test_a_structure_is_reciprocal_and_passive(seed, decay, frequency):
    modes = structure_modes(seed, reference.HELD)
    s = np.array([10.0**decay + 1j * 10.0**frequency])
    g = np.array([[modes.receptance(s, p, q)[0] for q in PORTS] for p in PORTS])
    assert abs(g[0, 1] - g[1, 0]) <= 1e-14 * abs(g[0, 1])
    # Work is done on it, not by it: the mobility s G(s) is positive real.
    mobility = s[0] * g
    scale = np.sqrt(np.diag(mobility).real)
    normalized = (mobility + mobility.conj().T) / 2 / np.outer(scale, scale)
    assert linalg.eigvalsh(normalized).min() >= -1e-12


@few
@given(seed=seeds, frequency=st.floats(-1, 5))
def test_a_structure_with_a_mirror_and_an_absorber_is_reciprocal_and_passive(seed, frequency):
    modes = structure_modes(seed, reference.HELD)
    absorber = ReactionMassActuator("middle", 2.0, 30 * HZ, 0.1, rate_gain=40.0)
    loop = Loop(case(seed).mirror, PID(0.0, 0.0, 0.0, 0.0), actuators=(absorber,))
    plant = plant_state_space(loop, modes, "tip")
    w = 10.0**frequency
    s = np.array([1j * w])
    # Control torque and mirror angle are no pair of power; torque on the mirror and its angle are.
    direct = plant.response(s, "mirror_torque", "mirror_angle")[0]
    assert (s[0] * direct).real >= -1e-12 * abs(s[0] * direct)


@few
@given(seed=seeds, rate_gain=st.floats(0, 100))
def test_dampers_dissipate_what_white_noise_puts_in(seed, rate_gain):
    modes = structure_modes(seed, reference.HELD)
    absorber = ReactionMassActuator("middle", 2.0, 30 * HZ, 0.1, rate_gain=rate_gain)
    mirror = case(seed).mirror
    loop = Loop(mirror, PID(0.0, 0.0, 0.0, 0.0), actuators=(absorber,))
    plant = plant_state_space(loop, modes, "tip")
    n = modes.natural_frequency.size
    half = n + 2
    # States of like size: displacements times a frequency.
    scale = np.concatenate([modes.natural_frequency, [15 * HZ, 30 * HZ], np.ones(half)])
    load = scale[:, None] * plant.b[:, [plant.inputs.index("mirror_torque")]]
    covariance = linalg.solve_continuous_lyapunov(scale[:, None] * plant.a / scale, -load @ load.T)
    # White noise of unit intensity puts ½ fᵀ M⁻¹ f into a body: ½/J into the mirror, wherever it is mounted.
    supplied = 0.5 / mirror.inertia
    rate = covariance[half:, half:]
    tip, middle = (np.append(modes.at(port), [0.0, 0.0]) for port in PORTS)
    of_mirror, of_absorber = np.eye(half)[n] - tip, np.eye(half)[n + 1] - middle
    dissipated = (
        (modes.damping * np.diag(rate)[:n]).sum()
        + mirror.damping * of_mirror @ rate @ of_mirror
        + absorber.suspended.damping * of_absorber @ rate @ of_absorber
    )
    assert dissipated == pytest.approx(supplied, rel=ROUNDING)
