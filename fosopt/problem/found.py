"""A metric that was found, and its gradient once somebody asks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from fosopt.ops import Array

Valued = tuple[float, Array]
"""Value and gradient."""


@dataclass(frozen=True)
class Found:
    """A metric whose gradient, by far the dearer part, is computed when first asked for."""

    value: float
    make_gradient: Callable[[], Array]

    @cached_property
    def gradient(self) -> Array:
        """(p,) over `Design.parameters`."""
        return self.make_gradient()

    @property
    def valued(self) -> Valued:
        """Value and gradient."""
        return self.value, self.gradient
