"""Pin-ended trusses with rigid battens: definition, mass and stiffness.

A `Truss` is what an engineer writes down: nodes, bars, battens, springs, supports and ports. `assemble` turns
it into a `Structure`, in which mass and stiffness are congruences of two constant sparse matrices with
weights that are linear in the design parameters (bar areas, batten masses, spring stiffnesses, mirror mass).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from fosopt import ops
from fosopt.errors import ModelError, did_you_mean
from fosopt.ops import Array

TRANSLATIONS = ("x", "y", "z")
ROTATIONS = ("rx", "ry", "rz")


@dataclass(frozen=True)
class Bar:
    """A pin-ended axial member.

    `young` and `density` may be effective values that include end fittings [Pa], [kg/m³]; `area` [m²] is the
    start value when it is a design variable.
    """

    name: str
    nodes: tuple[str, str]
    area: float
    young: float
    density: float
    kind: str = "bar"
    bay: int = 0


@dataclass(frozen=True)
class Batten:
    """A rigid body that carries nodes, with its mass [kg] and rotary inertia [kg m²] about its center.

    `inertia` is one value in a plane; in space the three principal values along the axes. `center` defaults
    to the mean of its nodes [m].
    """

    name: str
    nodes: tuple[str, ...]
    mass: float
    inertia: float | tuple[float, float, float]
    center: tuple[float, ...] | None = None
    bay: int = 0


@dataclass(frozen=True)
class PointMass:
    """A mass [kg] at a node, or a mass with rotary inertia [kg m²] at the center of a batten."""

    at: str
    mass: float
    inertia: float = 0.0


@dataclass(frozen=True)
class Spring:
    """A spring to ground at one component of a node or batten [N/m] or [N m/rad].

    `stiffness` is the start value when it is a design variable; `name` is by default place and component, such as
    ``B0.x``.
    """

    at: str
    component: str
    stiffness: float
    name: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", f"{self.at}.{self.component}")


@dataclass(frozen=True)
class Truss:
    """A truss as written down; lengths in m.

    `ports` names the degrees of freedom where something is attached, pushed or measured: port name to
    (node or batten, component). The port ``hub`` fixes the axis of rigid-body rotation.
    """

    nodes: Mapping[str, tuple[float, ...]]
    bars: tuple[Bar, ...]
    ports: Mapping[str, tuple[str, str]]
    supports: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    battens: tuple[Batten, ...] = ()
    points: tuple[PointMass, ...] = ()
    springs: tuple[Spring, ...] = ()


@dataclass(frozen=True)
class Structure:
    """An assembled structure: constant matrices and linear weights.

    Shapes: n degrees of freedom, b bars, r battens, s springs to ground, k stiffness rows, m mass rows.

    Attributes
    ----------
    truss
        What it was assembled from; of a beam or a chain, which have neither bars nor battens nor springs to ground,
        the places of its ports alone.
    dofs
        (n,) names such as ``B20.rz``.
    stiffness_rows, stiffness_by_area, stiffness_by_spring, stiffness_constant
        (k, n) elongation per displacement, (k, b) [N/m per m²], (k, s), (k,) [N/m].
    mass_rows, mass_by_area, mass_by_batten, mass_by_mirror, mass_constant
        (m, n) velocity per velocity, (m, b) [kg per m²], (m, r), (m,), (m,) [kg] or [kg m²].
    bar_mass_per_area, mass_fixed
        (b,) [kg/m²], and the mass that no parameter changes [kg].
    hub_arm
        (m,) motion of each mass row per unit rotation about the hub.
    ports
        Port name to its (n,) row.
    """

    truss: Truss
    dofs: tuple[str, ...]
    stiffness_rows: sparse.csr_array
    stiffness_by_area: sparse.csr_array
    stiffness_by_spring: sparse.csr_array
    stiffness_constant: Array
    mass_rows: sparse.csr_array
    mass_by_area: sparse.csr_array
    mass_by_batten: sparse.csr_array
    mass_by_mirror: Array
    mass_constant: Array
    bar_mass_per_area: Array
    mass_fixed: float
    hub_arm: Array
    ports: Mapping[str, Array]

    @property
    def area(self) -> Array:
        """(b,) Start areas of the bars [m²]."""
        return np.array([bar.area for bar in self.truss.bars])

    @property
    def batten_mass(self) -> Array:
        """(r,) Start masses of the battens [kg]."""
        return np.array([batten.mass for batten in self.truss.battens])

    @property
    def spring_stiffness(self) -> Array:
        """(s,) Start stiffnesses of the springs to ground [N/m], [N m/rad]."""
        return np.array([spring.stiffness for spring in self.truss.springs], dtype=float)

    @cached_property
    def stiffness_entries(self) -> sparse.csc_array:
        """(n², k) Entries of the stiffness matrix per weight."""
        return ops.congruence_entries(self.stiffness_rows)

    @cached_property
    def mass_entries(self) -> sparse.csc_array:
        """(n², m) Entries of the mass matrix per weight."""
        return ops.congruence_entries(self.mass_rows)

    @cached_property
    def weight_gradients(self) -> sparse.csr_array:
        """(b + r + s, k + m) Derivatives of stiffness and mass weights for areas, batten masses and springs."""
        k, m = self.stiffness_by_area.shape[0], self.mass_by_area.shape[0]
        stiffness_by_batten = sparse.csr_array((k, self.mass_by_batten.shape[1]))
        mass_by_spring = sparse.csr_array((m, self.stiffness_by_spring.shape[1]))
        table = [
            [self.stiffness_by_area, stiffness_by_batten, self.stiffness_by_spring],
            [self.mass_by_area, self.mass_by_batten, mass_by_spring],
        ]
        return sparse.csr_array(sparse.block_array(table).T)

    def port(self, name: str) -> Array:
        """(n,) Row that reads the motion of a port, or of a degree of freedom by its own name, such as ``B10.y``.

        Raises
        ------
        ModelError
            If there is no port or degree of freedom of that name.
        """
        if name in self.ports:
            return self.ports[name]
        if name not in self.dofs:
            known = self.ports if "." not in name else (*self.ports, *self.dofs)
            raise ModelError(f"port '{name}' does not exist; {did_you_mean(name, known)}")
        return np.array([float(dof == name) for dof in self.dofs])


def stiffness_matrix(structure: Structure, area: Any, spring_stiffness: Any = None) -> Any:
    """Stiffness matrix K(a, k) = Bᵀ diag(E a / L, k) B of bars and of springs to ground.

    Assumes small displacements and pin-ended bars.    [Barker1991] Eq. (2.1)

    Parameters
    ----------
    spring_stiffness
        (s,) k; by default those the structure was assembled with [N/m], [N m/rad].

    Returns
    -------
    (n, n)
        Linear in all parameters [N/m], [N m/rad].
    """
    weights = stiffness_weights(structure, area, spring_stiffness)
    return ops.congruence(structure.stiffness_rows, weights, structure.stiffness_entries)


def stiffness_weights(structure: Structure, area: Any, spring_stiffness: Any = None) -> Any:
    """(k,) Axial stiffness E a / L of each bar, then of each spring, see `stiffness_matrix` [N/m], [N m/rad]."""
    if spring_stiffness is None:
        spring_stiffness = structure.spring_stiffness
    return (
        ops.linear(structure.stiffness_by_area, area)
        + ops.linear(structure.stiffness_by_spring, spring_stiffness)
        + structure.stiffness_constant
    )


def mass_matrix(structure: Structure, area: Any, batten_mass: Any, mirror_mass: Any) -> Any:
    """Consistent mass matrix with rigid battens, point masses and the mirror's mass at its port.

    A bar of mass m contributes m |v̄|² + m |Δv|²/12, mean and difference of its end velocities, which is the
    consistent mass of a linear displacement field.    [Barker1991] Eq. (2.1)

    Returns
    -------
    (n, n)
        Linear in all parameters [kg], [kg m²].
    """
    weights = mass_weights(structure, area, batten_mass, mirror_mass)
    return ops.congruence(structure.mass_rows, weights, structure.mass_entries)


def mass_weights(structure: Structure, area: Any, batten_mass: Any, mirror_mass: Any) -> Any:
    """(m,) Mass or rotary inertia carried by each mass row [kg], [kg m²]."""
    return (
        ops.linear(structure.mass_by_area, area)
        + ops.linear(structure.mass_by_batten, batten_mass)
        + structure.mass_by_mirror * mirror_mass
        + structure.mass_constant
    )


def structural_mass(structure: Structure, area: Any, batten_mass: Any) -> Any:
    """Mass of bars, battens and all that is fixed, without the mirror [kg]."""
    bars = ops.total(structure.bar_mass_per_area * area)
    return bars + ops.total(batten_mass) + structure.mass_fixed


def structure_inertia(structure: Structure, area: Any, batten_mass: Any) -> Any:
    """Inertia of the structure about the hub, without the mirror: J_truss of section 4.3 [kg m²]."""
    weights = mass_weights(structure, area, batten_mass, 0.0)
    return ops.total(structure.hub_arm**2 * weights)
