"""Modal sets, damping models and hubs: all that the plant knows of a structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fosopt.errors import ModelError
from fosopt.ops import Array, ComplexArray


@dataclass(frozen=True)
class Damping:
    """Modal damping ratios of the elastic modes.

    Attributes
    ----------
    ratio
        One value for all modes, or one per elastic mode, the last one repeated for the modes beyond [-].
    frequency
        When given, `ratio` is a table over these ascending frequencies [rad/s], linear between them and
        constant outside.
    """

    ratio: tuple[float, ...]
    frequency: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for value in self.ratio:
            if not (np.isfinite(value) and value >= 0):
                raise ModelError(
                    f"damping ratio {value} is negative or not finite; give values of zero or above"
                )
        if not self.ratio:
            raise ModelError("damping: no ratio given; give at least one")
        if self.frequency is not None and (
            len(self.frequency) != len(self.ratio) or np.any(np.diff(self.frequency) <= 0)
        ):
            raise ModelError("damping table: frequencies must ascend, one ratio each")

    def of(self, frequency: Array) -> Array:
        """(n,) Damping ratio of each elastic mode, `frequency` ascending [rad/s]."""
        if self.frequency is not None:
            return np.interp(frequency, self.frequency, self.ratio)
        return np.array([self.ratio[min(k, len(self.ratio) - 1)] for k in range(frequency.size)])

    def slopes(self, frequency: Array, ratio: Array) -> Array:
        """(n, n) Divided differences (ζ_k − ζ_l)/(ω_k − ω_l) [s], the derivative on the diagonal.

        Ratios listed per mode are no function of frequency: where two such modes cross, jitter has a kink and
        these differences grow without limit.
        """
        if len(self.ratio) == 1:
            return np.zeros((frequency.size, frequency.size))
        apart = frequency[:, None] - frequency[None, :]
        same = np.abs(apart) <= 1e-9 * frequency[:, None]
        quotient = (ratio[:, None] - ratio[None, :]) / np.where(same, 1.0, apart)
        if self.frequency is None:
            return np.where(same, 0.0, quotient)
        step = 1e-7 * frequency
        local = (self.of(frequency + step) - self.of(frequency - step)) / np.where(step > 0, 2 * step, 1.0)
        return np.where(same, local[:, None], quotient)


@dataclass(frozen=True)
class Hub:
    """How the hub is held.

    ``free`` and ``fixed`` follow from the supports. ``held`` gives the rigid-body mode the natural frequency
    `bandwidth` [rad/s] and `damping_ratio` [-] of a slow attitude loop.

    Assumes the attitude loop is rolled off below the first elastic mode, so that it acts on the rigid-body
    mode alone and neither moves nor damps an elastic one.
    """

    type: Literal["free", "fixed", "held"] = "free"
    bandwidth: float = 0.0
    damping_ratio: float = 0.0


@dataclass(frozen=True)
class ModalSet:
    """Modes at the ports.

    Attributes
    ----------
    natural_frequency
        (n,) ascending, zero for a free rigid-body mode [rad/s].
    damping_ratio
        (n,) [-].
    mode_shape
        (n, p) mass-normalized, one column per port.
    ports
        (p,) port names.
    rigid
        (n,) true for rigid-body modes, free or held.
    """

    natural_frequency: Array
    damping_ratio: Array
    mode_shape: Array
    ports: tuple[str, ...]
    rigid: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for what in ("natural_frequency", "damping_ratio"):
            values = getattr(self, what)
            if not np.all(np.isfinite(values)) or np.any(values < 0):
                raise ModelError(
                    f"modal set: {what} holds {values.min()}; every value must be finite and not negative"
                )
        n = self.natural_frequency.size
        if self.mode_shape.shape != (n, len(self.ports)):
            raise ModelError(
                f"modal set: mode_shape has shape {self.mode_shape.shape}; expected {(n, len(self.ports))}, "
                "one row per mode and one column per port"
            )

    @property
    def stiffness(self) -> Array:
        """(n,) ω_k² [rad²/s²]."""
        return self.natural_frequency**2

    @property
    def damping(self) -> Array:
        """(n,) 2 ζ_k ω_k [rad/s]."""
        return 2 * self.damping_ratio * self.natural_frequency

    def at(self, port: str) -> Array:
        """(n,) Mode shapes at a port."""
        return self.mode_shape[:, self.ports.index(port)]

    def receptance(self, s: ComplexArray, port: str, other: str) -> ComplexArray:
        """Receptance Σ φ_pk φ_qk / (s² + 2ζ_k ω_k s + ω_k²) between two ports.    [Barker1991] Eq. (3.1)

        Returns
        -------
        (m,)
            One value per Laplace variable `s` (m,), [rad/(N m)] between rotations.
        """
        denominator = s[:, None] ** 2 + self.damping * s[:, None] + self.stiffness
        return np.sum(self.at(port) * self.at(other) / denominator, axis=1)

    def keep(self, chosen: Sequence[int] | NDArray[np.intp] | slice) -> ModalSet:
        """Modal truncation to the chosen modes (indices from zero).    [Barker1991] Sec. 2.3"""
        return ModalSet(
            self.natural_frequency[chosen],
            self.damping_ratio[chosen],
            self.mode_shape[chosen],
            self.ports,
            self.rigid[chosen],
        )
