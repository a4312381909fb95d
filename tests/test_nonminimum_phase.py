"""The dissertation's condition for nonminimum phase zeros of a mirror that reacts elsewhere, Eq. (4.27)."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from hypothesis import assume, example, given
from hypothesis import strategies as st

from fosopt.actuators import Mirror
from fosopt.metrics.flexibility import nonminimum_phase_excess
from fosopt.metrics.inertias import modal_inertia
from fosopt.modes import Damping, Hub, ModalSet
from fosopt.plant import mirror_zeros

HZ = reference.HZ


@example(80.0, 1.0, 1.8, 100.0, 0.01)  # a complex pair: the damper oversteps before the spring does
@example(80.0, 1.0, 1.8, 100.0, 0.0)
@example(40.0, 1.0, 2.2, 100.0, 0.01)
@given(
    st.floats(1.0, 100.0),
    st.floats(-2, 2),
    st.floats(-2, 2),
    st.floats(1, 300),
    st.sampled_from([0.0, 0.01, 0.1]),
)
def test_on_a_single_mode_the_condition_and_its_damped_companion_say_exactly_when_zeros_lie_right(
    frequency, here, there, tuned, damping
):
    modes = ModalSet(
        np.array([frequency]), np.array([damping]), np.array([[here, there]]), ("r", "h"), np.zeros(1, bool)
    )
    mirror = Mirror(0.7, tuned, 2 * damping)
    a, b = nonminimum_phase_excess(modes, mirror, "r", "h")
    assume(abs(a[0]) > 1e-6 * frequency**2 and (not damping or abs(b[0]) > 1e-6 * frequency))
    assume(abs(here * (there - here)) > 1e-6)
    if abs(there) > 1e-6:
        # Eqs. (4.23), (4.24).
        inverse = 1 / modal_inertia(modes, "r", "h") - 1 / modal_inertia(modes, "r", "r")
        expected = mirror.stiffness * inverse - frequency**2
        assert a == pytest.approx(expected, rel=1e-9, abs=1e-9 * frequency**2)
    zeros = mirror_zeros(modes, mirror, "r", "h")
    right = zeros.real > 0
    if not damping:
        assert right.any() == (a[0] > 0)
    assert right.any() == (a[0] > 0 or b[0] > 0)
    if a[0] > 0:  # one real zero
        assert zeros[right].imag == 0
        assert right.sum() == 1
    elif b[0] > 0:  # both
        assert right.sum() == 2


@pytest.mark.parametrize("sign", [1, -1])
@given(seed=st.integers(0, 10_000), inertia=st.floats(1e-3, 10))
def test_residues_of_one_sign_leave_zeros_on_the_axes_and_the_static_response_says_on_which(
    sign, seed, inertia
):
    rng = np.random.default_rng(seed)
    frequency = np.cumsum(rng.uniform(1, 10, 5))
    here = rng.uniform(0.2, 2, 5) * rng.choice([-1, 1], 5)
    # Port h moves less than port r in every mode, or more.
    there = here * (1 - sign * rng.uniform(0.1, 0.9, 5))
    modes = ModalSet(frequency, np.zeros(5), np.column_stack([here, there]), ("r", "h"), np.zeros(5, bool))
    mirror = Mirror(inertia, 15.0, 0.0)
    still = np.zeros(1)
    apart = modes.receptance(still, "r", "r") - modes.receptance(still, "r", "h")
    static = 1 + mirror.stiffness * apart[0].real
    assume(abs(static) > 1e-6)
    zeros = mirror_zeros(modes, mirror, "r", "h")
    assert np.all((zeros.real == 0) | (zeros.imag == 0))
    assert np.count_nonzero(zeros.real > 0) == (1 if static < 0 else 0)


def holds(modes, mirror, reference_port, reaction):
    """Whether the condition holds for the first flexible mode, and how many zeros lie right and on the real axis."""
    a, _ = nonminimum_phase_excess(modes, mirror, reference_port, reaction)
    zeros = mirror_zeros(modes, mirror, reference_port, reaction)
    first = int(np.flatnonzero(~modes.rigid)[0])
    return a[first] > 0, np.count_nonzero(zeros.real > 0), np.count_nonzero(zeros[zeros.real > 0].imag == 0)


def test_with_all_modes_the_condition_is_neither_necessary_nor_sufficient():
    frame = reference.stations()
    ports = (*reference.PORTS, *reference.STATIONS)
    modes = frame.modal_set(Hub("free"), Damping((0.0,)), ports)
    whole = reference.inertia_of(frame.structure)
    # Mirror on the tip, reaction half way down: quadruples of zeros though no mode fulfills the condition.
    mirror = Mirror(0.2 * whole, 20 * HZ, 0.0)
    a, _ = nonminimum_phase_excess(modes, mirror, "tip", "r10")
    assert np.all(a <= 0)
    assert holds(modes, mirror, "tip", "r10")[1] == 8
    # The other way round the first mode fulfills it, and still it is a quadruple: no zero is real.
    stiff = Mirror(2.0 * whole, 20 * HZ, 0.0)
    met, right, real = holds(modes, stiff, "r10", "r20")
    assert (met, right > 0, real) == (True, True, 0)
    # Between other stations it is fulfilled with every zero on the imaginary axis.
    for reference_port, reaction in (("r10", "r13"), ("r14", "r20"), ("r19", "r20")):
        assert holds(modes, stiff, reference_port, reaction)[:2] == (True, 0)
