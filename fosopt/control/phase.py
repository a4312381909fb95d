"""Phase of a transfer function by its poles and zeros, and the frequencies at which to look at it.

Each root turns the phase by itself, through half a turn at most, so that the phase is continuous by construction.
Unwrapping samples instead must guess which way each jump of half a turn goes, and guesses wrong where damping is
light and modes are dense: the ambiguity the dissertation notes in its plots.    [Barker1991] Sec. 4.4, footnote 4
"""

from __future__ import annotations

import numpy as np

from fosopt.errors import ModelError
from fosopt.ops import Array, ComplexArray

# Conjugates that come out of an eigenvalue solver one by one agree to this share of the largest root.
_CONJUGATE = 1e-6
_REACH = 3.5  # sinh of it is the reach of the frequencies about a root in its half widths
_NARROWEST = 1e-4  # half width given to a root without damping, as a share of its frequency


def continuous_phase(zeros: ComplexArray, poles: ComplexArray, sign: float, frequency: Array) -> Array:
    """Phase of k Π(s − z)/Π(s − p) along the imaginary axis, continuous in frequency.

    Exact however light the damping and however coarse the frequencies. A root in the left half plane turns the phase
    towards a lead (zero) or a lag (pole) as the frequency passes it, one in the right half plane the other way. A root
    on the imaginary axis is taken as the limit of vanishing positive damping: it jumps by half a turn at its frequency,
    where the middle of the jump stands; at the origin it counts a quarter turn at every frequency. A zero that equals
    a pole cancels it.

    Without real roots in the right half plane and with k above zero the phase starts at zero, less a quarter turn for
    each integrator. A real root there starts half a turn off, above for a zero and below for a pole, and a negative
    k half a turn below: k (z − s) with z > 0 starts at zero.

    Parameters
    ----------
    zeros, poles
        (n,) and (m,), both conjugates of a pair [rad/s].
    sign
        Of k, the gain at high frequency over its power of s; only its sign counts.
    frequency
        (f,) zero or above [rad/s].

    Returns
    -------
    (f,)
        Degrees.

    Raises
    ------
    ModelError
        If roots are not finite or lack their conjugates, or the gain is zero.
    """
    if not abs(sign) > 0:
        raise ModelError(f"phase: the gain {sign} has no sign; give one above or below zero")
    return (
        (-180.0 if sign < 0 else 0.0) + _turned("zero", zeros, frequency) - _turned("pole", poles, frequency)
    )


def _turned(what: str, roots: ComplexArray, frequency: Array) -> Array:
    """(f,) Angle of Π(jω − root) without the full turns of conjugate pairs [deg]."""
    roots = np.asarray(roots, dtype=complex)
    if not np.all(np.isfinite(roots)):
        raise ModelError(f"phase: a {what} is not finite; leave {what}s at infinity out")
    upper, lower = roots[roots.imag > 0], roots[roots.imag < 0].conj()
    size = np.abs(roots).max(initial=0.0)
    # Real and imaginary parts each in their own order: rounding may swap neighbors in any common one.
    if upper.size != lower.size or any(
        np.any(np.abs(np.sort(one) - np.sort(other)) > _CONJUGATE * size)
        for one, other in ((upper.real, lower.real), (upper.imag, lower.imag))
    ):
        raise ModelError(f"phase: {what}s come without their conjugates; give both of each pair")
    # arctan2 with a positive second argument stays within a quarter turn to either side.
    angle = np.arctan2(frequency[:, None] - roots.imag, np.abs(roots.real))
    right = roots.real > 0
    half_turns = np.count_nonzero(right & (roots.imag == 0))
    return np.degrees(angle @ np.where(right, -1.0, 1.0)) + 180.0 * half_turns


def resonance_grid(roots: ComplexArray, low: float, high: float, count: int, per_root: int = 9) -> Array:
    """Ascending frequencies from `low` to `high` that resolve what poles and zeros do near the imaginary axis.

    Around each root they lie closest at its frequency, farther apart outwards to 16 times its half width, so that
    no resonance or antiresonance is missed or cut off however sharp. A root without damping has no top to hit; it is
    approached to within a ten-thousandth of its frequency.

    Parameters
    ----------
    roots
        (n,) poles and zeros; those below the real axis are passed over [rad/s].
    low, high
        Above zero [rad/s].
    count
        Frequencies spaced evenly on a logarithmic scale over the whole range.
    per_root
        Frequencies about each root, odd so that its own is one of them.

    Returns
    -------
    (m,)
        [rad/s].
    """
    upper = roots[roots.imag > 0]
    damped = upper.real != 0
    width = np.where(damped, np.abs(upper.real), _NARROWEST * upper.imag)
    offsets = np.sinh(np.linspace(-_REACH, _REACH, per_root))
    local = upper.imag[:, None] + width[:, None] * offsets
    seen = (local >= low) & (local <= high) & (damped[:, None] | (offsets != 0))
    return np.unique(np.concatenate([local[seen], np.geomspace(low, high, count)]))
