"""Both axes of a mirror at once: one structure, two loops, common poles.

With the angles θ = [θ₁, θ₂] of the mirror about its axes and all that follows diagonal but the (2, 2) receptance g
between its ports,

    (J s² + κ + κ g J s² + K) θ = torques,

of which Z = J s² + κ + κ g J s² is the plant and det(Z + K) vanishes at the poles. What one axis sees of the other
stands in `control.loop`: an attachment with a loop of its own.    [Barker1991] Eqs. (4.12), (4.29)
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fosopt.control.loop import Loop, Receptances, attach, coupling
from fosopt.control.pid import pid_response
from fosopt.control.steered import SteeredAxis
from fosopt.errors import ModelError
from fosopt.ops import Array, ComplexArray


def about_other_axis(loop: Loop, mirror_port: str) -> tuple[Loop, str]:
    """The loop about the other axis, with this one beside it, and the port of the mirror about it.

    Raises
    ------
    ModelError
        If there is no other axis.
    """
    other = loop.beside
    if other is None:
        raise ModelError("the mirror has no second axis; give the loop one beside it")
    own = SteeredAxis(mirror_port, loop.mirror, loop.controller, loop.hub)
    hub = other.hub or loop.hub
    return replace(loop, mirror=other.mirror, controller=other.controller, beside=own, hub=hub), other.port


def structure_receptances(loop: Loop, s: Any, bare: Receptances) -> Receptances:
    """Receptances of the structure with everything on it but the mirror, about neither axis."""
    for port, body in loop.suspended:
        bare = attach(s, bare, port, body, loop.pairs)
    return bare


def determinant(loop: Loop, s: Any, g: Receptances) -> Any:
    """Determinant of Z + K, whose zeros are the poles of both loops [(N m/rad)²].

    Parameters
    ----------
    g
        As `structure_receptances` gives them.
    """
    other = loop.beside
    assert other is not None
    port = loop.index(other.port)
    kappa, kappa_other = coupling(loop, s), other.coupling(s)
    inertial, inertial_other = loop.mirror.inertia * s**2, other.inertia * s**2
    own = inertial * (1 + kappa * g.direct) + kappa + pid_response(loop.controller, s)
    beside = inertial_other * (1 + kappa_other * g.between(port, port)) + other.restoring(s)
    return own * beside - kappa * kappa_other * inertial * inertial_other * g.between(0, port) ** 2


def multivariable_distance(loop: Loop, s: ComplexArray, g: Receptances) -> Array:
    """(m,) Smallest singular value of 1 + L with L = Z⁻¹ K of both axes, 1/‖S‖ at each point [-].

    [Skogestad2005] Sec. 3.3; in the angles of the mirror about its axes, which are alike in unit and size.

    Parameters
    ----------
    g
        As `structure_receptances` gives them.
    """
    other = loop.beside
    assert other is not None
    port = loop.index(other.port)
    receptance = np.moveaxis(
        np.array([[g.between(0, 0), g.between(0, port)], [g.between(port, 0), g.between(port, port)]]), -1, 0
    )
    kappa = np.array([coupling(loop, s), other.coupling(s)]).T
    inertial = np.array([loop.mirror.inertia * s**2, other.inertia * s**2]).T
    feedback = np.array([pid_response(loop.controller, s), pid_response(other.controller, s)]).T
    identity = np.eye(2)
    plant = identity * (inertial + kappa)[:, None, :] + kappa[:, :, None] * receptance * inertial[:, None, :]
    sensitivity = np.linalg.solve(plant + identity * feedback[:, None, :], plant)
    return 1 / np.linalg.norm(sensitivity, 2, axis=(1, 2))
