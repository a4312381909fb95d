"""Lower bounds of jitter over boxes of PID gains.

By `performance_limit`, a stabilizing controller has the mean square D + Σ_i c_i(K(jω_i)) on quadrature nodes, with
what is plainly a distance from the limit's filter at each frequency,

    c(K) = |α − β/u|²,     u = 1/G + K,     α = √(wΦ) (ρ − F_g),     β = √(wΦ) ρ/G,

ρ being one for a sensor on the mirror. A box of gains gives a rectangle of u. Two functions lie below c on it:

- its least value, found exactly: on an edge, c is a quotient of quadratics with one minimum;
- its tangent, less a bound on how far c curves below it. The least eigenvalue of the Hessian is
  2 |β| (|β| − 2 |α u − β|)/|u|⁴, positive where the error is less than half of β: close to the limit c is convex.

The tangents are linear in the gains and are summed over all frequencies before they are minimized over the box, which
keeps the gains from taking another value at each frequency. Close to a local optimum, where tangents cancel, this
bound errs by the square of the box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fosopt.ops import Array, ComplexArray
from fosopt.relax.open_loop import Spectra
from fosopt.relax.performance_limit import PerformanceLimit
from fosopt.relax.pid_box import Boxes

# A tangent is used where its curvature costs less than this share of what the least value loses.
_CURVATURE_SHARE = 0.3


@dataclass(frozen=True)
class Relaxation:
    """c(K) at quadrature nodes.

    Attributes
    ----------
    frequency
        (m,) [rad/s].
    constant
        D, what every controller has in common [rad²].
    impedance
        (m,) 1/G.
    alpha, beta
        (m,).
    rolloff_time
        Of the derivative [s].
    """

    frequency: Array
    constant: float
    impedance: ComplexArray
    alpha: ComplexArray
    beta: ComplexArray
    rolloff_time: float

    @property
    def derivative(self) -> ComplexArray:
        """(m,) Response to a derivative gain of one; real and imaginary part are never negative."""
        s = 1j * self.frequency
        return s / (1 + self.rolloff_time * s)

    def variance(self, gains: Array) -> Array:
        """(b,) Mean square of (b, 4) controllers if they are stable, as the nodes see it [rad²]."""
        absolute = gains[:, :1] * gains[:, 1:]
        response = (
            absolute[:, :1] - 1j * absolute[:, 1:2] / self.frequency + absolute[:, 2:] * self.derivative
        )
        cost = np.abs(self.alpha - self.beta / (self.impedance + response)) ** 2
        return self.constant + cost.sum(axis=1)

    def bounds(self, boxes: Boxes) -> tuple[Array, Array]:
        """Lower bounds over boxes, and how much each gain matters.

        Returns
        -------
        (b,)
            No stabilizing controller in the box has a lower mean square on these nodes [rad²].
        (b, 4)
            Change of the mean square over the box by each gain alone, in first order and without cancellation.
        """
        left, right, bottom, top = self._rectangles(boxes)
        least = self._least(left, right, bottom, top)

        center = 0.5 * (left + right) + 0.5j * (bottom + top)
        reach2 = (0.5 * (right - left)) ** 2 + (0.5 * (top - bottom)) ** 2
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            error = self.alpha - self.beta / center
            here = np.abs(error) ** 2
            # dc = Re(slope du)
            slope = 2 * error.conj() * self.beta / center**2
            nearest = (
                np.maximum(np.maximum(left, -right), 0.0) ** 2
                + np.maximum(np.maximum(bottom, -top), 0.0) ** 2
            )
            farthest = np.abs(error * center) + np.abs(self.alpha) * np.sqrt(reach2)
            size = np.abs(self.beta)
            curvature = np.minimum(2 * size * (size - 2 * farthest), 0.0) / nearest**2
            loss = -0.5 * curvature * reach2
            tangent = loss <= _CURVATURE_SHARE * (here - least)
        tangent &= nearest > 0
        used = np.where(tangent, slope, 0.0)
        value = np.where(tangent, here - np.nan_to_num(loss), least).sum(axis=1)
        by_integral, by_derivative = used.imag / self.frequency, (used * self.derivative).real
        slopes = np.column_stack([part.sum(axis=1) for part in (used.real, by_integral, by_derivative)])
        # The tangents touch at the middle of the rectangles, which is that of the absolute gains.
        middle = 0.5 * np.sum(boxes.absolute, axis=0)
        summed = value + boxes.least(slopes) - np.sum(slopes * middle, axis=1)
        bound = self.constant + np.maximum(summed, least.sum(axis=1))
        return bound, self._influence(boxes, np.where(nearest > 0, slope, 0.0), center - self.impedance)

    def too_close(self, boxes: Boxes, margin: float) -> NDArray[np.bool_]:
        """(b,) Whether at one frequency all controllers of a box bring 1 + L closer to zero than `margin`."""
        left, right, bottom, top = self._rectangles(boxes)
        farthest = np.hypot(np.maximum(np.abs(left), np.abs(right)), np.maximum(np.abs(bottom), np.abs(top)))
        return np.any(farthest < margin * np.abs(self.impedance), axis=1)

    def _rectangles(self, boxes: Boxes) -> tuple[Array, Array, Array, Array]:
        """Least and largest real and imaginary part of u, each (b, m)."""
        low, high = boxes.absolute
        derivative, z = self.derivative, self.impedance
        left = z.real + low[:, :1] + low[:, 2:] * derivative.real
        right = z.real + high[:, :1] + high[:, 2:] * derivative.real
        bottom = z.imag + low[:, 2:] * derivative.imag - high[:, 1:2] / self.frequency
        top = z.imag + high[:, 2:] * derivative.imag - low[:, 1:2] / self.frequency
        return left, right, bottom, top

    def _influence(self, boxes: Boxes, slope: ComplexArray, response: ComplexArray) -> Array:
        gain = 0.5 * (boxes.low[:, 0] + boxes.high[:, 0])
        width = boxes.high - boxes.low
        each = [
            np.abs((slope * response).real).sum(axis=1) / gain,
            gain * np.abs(slope.real).sum(axis=1),
            gain * np.abs(slope.imag / self.frequency).sum(axis=1),
            gain * np.abs((slope * self.derivative).real).sum(axis=1),
        ]
        return width * np.column_stack(each)

    def _least(self, left: Array, right: Array, bottom: Array, top: Array) -> Array:
        """(b, m) Least value of c on rectangles of u."""
        alpha2, beta2 = np.abs(self.alpha) ** 2, np.abs(self.beta) ** 2
        turned = self.alpha.conj() * self.beta
        re, im = turned.real, turned.imag

        def cost(x: Array, y: Array) -> Array:
            size = x * x + y * y
            return alpha2 + (beta2 - 2 * (re * x + im * y)) / size

        def along(y: Array, first: Array, last: Array, re: Array, im: Array) -> Array:
            # Zero of the slope of c in x at constant y that is a minimum: a root of re x² + b x − re y².
            b = 2 * im * y - beta2
            root = np.sqrt(b * b + (2 * re * y) ** 2)
            x = np.where(b < 0, (root - b) / (2 * re), 2 * re * y * y / (b + root))
            return np.fmin(np.fmax(x, first), last)

        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            least = cost(along(bottom, left, right, re, im), bottom)
            least = np.fmin(least, cost(along(top, left, right, re, im), top))
            least = np.fmin(least, cost(left, along(left, bottom, top, im, re)))
            least = np.fmin(least, cost(right, along(right, bottom, top, im, re)))
            for x in (left, right):
                for y in (bottom, top):
                    least = np.fmin(least, cost(x, y))
            inside = (
                (left * alpha2 <= re)
                & (re <= right * alpha2)
                & (bottom * alpha2 <= im)
                & (im <= top * alpha2)
            )
        return np.where(inside, 0.0, np.maximum(least, 0.0))


def relaxation(limit: PerformanceLimit, spectra: Spectra, rolloff_time: float) -> Relaxation:
    """The relaxation on the nodes of `spectra`."""
    amplitude = np.sqrt(spectra.nodes.weight * spectra.measured)
    counts = amplitude > 0
    # ρ − F_g with 1 − F_g known without cancellation.
    short = (spectra.share - 1) + limit.lack(spectra)
    return Relaxation(
        spectra.nodes.frequency[counts],
        limit.variance(spectra),
        spectra.impedance[counts],
        (amplitude * short)[counts],
        (amplitude * spectra.share * spectra.impedance)[counts],
        rolloff_time,
    )
