"""Bodies in a row, joined by springs: the benchmark problem of structural control and its kin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from scipy import sparse

from fosopt.errors import ModelError, did_you_mean
from fosopt.structure.truss import Structure, Truss


@dataclass(frozen=True)
class Chain:
    """Bodies that turn about one axis, each joined to the next by a torsion spring.

    The benchmark problem translates; a mirror turns. The equations are the same with inertias [kg m²] for masses
    and angles for displacements: a displacement unit of the dissertation reads as one radian. Springs have no
    dampers of their own: damping comes with the modes.    [Barker1991] Figs. 3.4, 3.5

    Attributes
    ----------
    inertias
        Name of each body, in the order of the row, to its inertia [kg m²].
    springs
        Stiffness between each body and the next, one less than there are bodies [N m/rad].
    held
        Whether the first body is held; otherwise the whole is free to turn.
    """

    inertias: Mapping[str, float]
    springs: tuple[float, ...]
    held: bool = False

    def __post_init__(self) -> None:
        bodies = tuple(self.inertias)
        if len(bodies) < 2:
            raise ModelError(f"chain: {len(bodies)} bodies; give two or more")
        if len(self.springs) != len(bodies) - 1:
            raise ModelError(
                f"chain: {len(bodies)} bodies need {len(bodies) - 1} springs, one between each two neighbors; "
                f"{len(self.springs)} given"
            )
        for name, value in self.inertias.items():
            if not (isfinite(value) and value > 0):
                raise ModelError(
                    f"body '{name}': inertia {value} is not above zero; give a positive, finite one"
                )
        for k, value in enumerate(self.springs):
            if not (isfinite(value) and value > 0):
                raise ModelError(
                    f"spring between '{bodies[k]}' and '{bodies[k + 1]}': stiffness {value} is not above zero; "
                    "give a positive, finite one"
                )
        for port, place in (("hub", 0), ("tip", -1)):
            if port in bodies and bodies[place] != port:
                raise ModelError(
                    f"body '{port}': this is the port at the {'last' if place else 'first'} body; rename the body"
                )


def two_body_stiffness(frequency: Any, first: Any, second: Any) -> Any:
    """Stiffness k = ω² J₁ J₂/(J₁ + J₂) with which two free bodies swing at ω on their spring alone [N m/rad].

    [Barker1991] Eq. (3.19)

    Parameters
    ----------
    frequency
        ω [rad/s].
    first, second
        Inertias J₁, J₂ [kg m²].
    """
    return frequency**2 * first * second / (first + second)


def assemble_chain(chain: Chain, mirror_port: str = "tip") -> Structure:
    """The structure of a chain: one rotation per body, each a port by the body's name.

    ``hub`` is the first body and ``tip`` the last. Nothing translates, so the structure has no mass, and the mirror's
    mass moves nothing.

    Parameters
    ----------
    mirror_port
        Name of the port that carries the mirror.

    Raises
    ------
    ModelError
        For an unknown port.
    """
    bodies = tuple(chain.inertias)
    n = len(bodies)
    motion = np.eye(n)
    ports = dict(zip(bodies, motion, strict=True)) | {"hub": motion[0], "tip": motion[-1]}
    if mirror_port not in ports:
        raise ModelError(f"port '{mirror_port}' does not exist; {did_you_mean(mirror_port, ports)}")
    free = slice(1 if chain.held else 0, n)
    return Structure(
        truss=Truss(
            nodes=dict.fromkeys(bodies, (0.0, 0.0)),
            bars=(),
            ports={name: (bodies[int(np.argmax(row))], "rz") for name, row in ports.items()},
        ),
        dofs=tuple(f"{name}.rz" for name in bodies[free]),
        stiffness_rows=sparse.csr_array(np.diff(motion, axis=0)[:, free]),
        stiffness_by_area=sparse.csr_array((n - 1, 0)),
        stiffness_by_spring=sparse.csr_array((n - 1, 0)),
        stiffness_constant=np.array(chain.springs, dtype=float),
        mass_rows=sparse.csr_array(motion[:, free]),
        mass_by_area=sparse.csr_array((n, 0)),
        mass_by_batten=sparse.csr_array((n, 0)),
        mass_by_mirror=np.zeros(n),
        mass_constant=np.array(list(chain.inertias.values()), dtype=float),
        bar_mass_per_area=np.zeros(0),
        mass_fixed=0.0,
        hub_arm=np.ones(n),
        ports={name: row[free] for name, row in ports.items()},
    )
