"""Uniform Euler-Bernoulli beams: exact modes, and the structure they make in modal coordinates.

Frequency equations are solved and shapes evaluated without hyperbolic functions of a large argument, so that the
thousandth mode is as good as the first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, exp, isfinite, pi, sin, tanh
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, sparse

from fosopt.errors import ModelError, did_you_mean
from fosopt.ops import Array
from fosopt.structure.truss import Structure, Truss

Boundary = Literal["fixed", "pinned"]
Component = Literal["x", "y", "rz"]
Station = tuple[float, Component]

# A beam of more modes spans more decades of stiffness than an eigenvalue solver resolves.
MOST_MODES = 200
# brentq takes no finer relative tolerance than this.
_ROOT = 4 * float(np.finfo(float).eps)
_INCH, _POUND_FORCE = 0.0254, 4.4482216152605  # [m], [N], exact by definition


@dataclass(frozen=True)
class BeamModes:
    """Mass-normalized modes of one kind of vibration of a uniform beam, ascending.

    Y_n(x) = a x/L + b sin β_n x + c cos β_n x + d exp(−β_n x) + e exp(β_n (x − L)): the general solution with
    exponentials that decay from the ends in place of sinh and cosh, which overflow and cancel in high modes.
    A shape starts out from the root to the positive side.    [Barker1991] Eqs. (2.10), (2.19)

    Attributes
    ----------
    natural_frequency
        (n,) zero for the rigid-body mode [rad/s].
    wave_number
        (n,) β_n, zero for the rigid-body mode [1/m].
    terms
        (5, n) a to e [1/√kg].
    length
        L [m].
    """

    natural_frequency: Array
    wave_number: Array
    terms: Array
    length: float

    def shape(self, x: ArrayLike, derivative: int = 0) -> Array:
        """Mode shapes, or their derivatives along the beam; the first one of a bending mode is its rotation.

        Parameters
        ----------
        x
            (p,) distances from the root [m].

        Returns
        -------
        (n, p)
            [1/√kg], for each order of the derivative [1/m] more.

        Raises
        ------
        ModelError
            For a place that is not on the beam.
        """
        place = np.atleast_1d(np.asarray(x, dtype=float))
        off = ~((place >= 0) & (place <= self.length))
        if off.any():
            raise ModelError(f"beam: x {place[off][0]:g} m is not on it; give 0 to {self.length:g} m")
        a, b, c, d, e = self.terms[:, :, None]
        beta = self.wave_number[:, None]
        phase = beta * place
        # Each derivative turns sine to cosine and cosine to minus sine.
        turned = (np.sin(phase), np.cos(phase), -np.sin(phase), -np.cos(phase))
        waves = b * turned[derivative % 4] + c * turned[(derivative + 1) % 4]
        ends = (-1) ** derivative * d * np.exp(-phase) + e * np.exp(beta * (place - self.length))
        straight = (place / self.length, np.full_like(place, 1 / self.length), np.zeros_like(place))
        return beta**derivative * (waves + ends) + a * straight[min(derivative, 2)]


@dataclass(frozen=True)
class Beam:
    """A uniform slender beam along x, fixed or pinned at its root x = 0 and free at its tip.

    Assumes no shear deformation and no rotary inertia of the cross section.    [Barker1991] Eqs. (2.2)-(2.9)

    Attributes
    ----------
    length
        L [m].
    mass_per_length
        m [kg/m].
    bending_stiffness
        E I [N m²].
    axial_stiffness
        E A [N].
    boundary
        ``fixed``, or ``pinned``: free to rotate about the root.
    """

    length: float
    mass_per_length: float
    bending_stiffness: float
    axial_stiffness: float
    boundary: Boundary = "pinned"

    def __post_init__(self) -> None:
        for name in ("length", "mass_per_length", "bending_stiffness", "axial_stiffness"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise ModelError(f"beam: {name} {value} is not above zero; give a positive, finite value")
        if self.boundary not in ("fixed", "pinned"):
            raise ModelError(f"beam: boundary '{self.boundary}' does not exist; choose fixed or pinned")

    @property
    def mass(self) -> float:
        """Total mass, m L [kg]."""
        return self.mass_per_length * self.length

    @property
    def inertia(self) -> float:
        """Inertia about the root, m L³/3 [kg m²]."""
        return self.mass * self.length**2 / 3

    def lateral_modes(self, count: int) -> BeamModes:
        """The first bending modes, with ω_n = (β_n L)² √(E I/(m L⁴)); a pinned beam's first one is rigid.

        The shapes of Eqs. (2.12) and (2.30), ∫ m Y² dx = 1. Every elastic one has 2/√(m L) at the tip, since
        4 ∫ Y² dx = L Y(L)² where Y″ and Y‴ vanish.    [Barker1991] Eqs. (2.5), (2.12), (2.13), (2.30)
        """
        _refuse_count("lateral modes", count, 1)
        z = lateral_roots(self.boundary, count)
        terms = np.zeros((5, count))
        elastic = z > 0
        s, c, q = np.sin(z[elastic]), np.cos(z[elastic]), np.exp(-z[elastic])
        if self.boundary == "fixed":
            # cosh ξ − cos ξ − σ (sinh ξ − sin ξ), with e^ξ (1 − σ)/2 written as its value at the tip, fading inward.
            tip = (s - c - q) / ((1 - q**2) / 2 + q * s)
            sigma = 1 - q * tip
            terms[1:] = sigma, -np.ones(count), (1 + sigma) / 2, tip / 2
        else:
            terms[0, 0] = 3**0.5
            rise = s / (1 - q**2)  # of sin z sinh ξ/sinh z
            terms[1:, elastic] = np.array([np.ones_like(s), 0 * s, -q * rise, rise]) / np.abs(s)
        speed = (self.bending_stiffness / self.mass_per_length) ** 0.5
        wave_number = z / self.length
        return BeamModes(speed * wave_number**2, wave_number, terms / self.mass**0.5, self.length)

    def longitudinal_modes(self, count: int) -> BeamModes:
        """The first longitudinal modes, alike for both boundaries.    [Barker1991] Eqs. (2.21)-(2.24)"""
        _refuse_count("longitudinal modes", count, 0)
        wave_number = (np.arange(count, dtype=np.float64) + 0.5) * (pi / self.length)
        terms = np.zeros((5, count))
        terms[1] = (2 / self.mass) ** 0.5
        speed = (self.axial_stiffness / self.mass_per_length) ** 0.5
        return BeamModes(speed * wave_number, wave_number, terms, self.length)


def lateral_roots(boundary: Boundary, count: int) -> Array:
    """Roots β_n L of the frequency equation of bending, right to rounding however many are asked for.

    cos z cosh z = −1 (fixed) and sin z cosh z = cos z sinh z (pinned), divided by cosh z: what is left is
    bounded, and each root has a bracket of its own. A pinned beam's first root is zero.

    [Barker1991] Eqs. (2.11), (2.29)

    Returns
    -------
    (count,)
        Ascending [-].
    """
    if boundary == "fixed":
        return np.array([_root(_fixed_free, (n - 1) * pi, n * pi) for n in range(1, count + 1)])
    return np.array([0.0, *(_root(_pinned_free, n * pi, (n + 0.5) * pi) for n in range(1, count))])


def _fixed_free(z: float) -> float:
    return cos(z) + 2 * exp(-z) / (1 + exp(-2 * z))


def _pinned_free(z: float) -> float:
    return sin(z) - cos(z) * tanh(z)


def _root(equation: Callable[[float], float], low: float, high: float) -> float:
    return float(optimize.brentq(equation, low, high, xtol=_ROOT, rtol=_ROOT))


def _refuse_count(what: str, count: int, least: int) -> None:
    if count < least:
        raise ModelError(f"beam: {count} {what}; give {least} or more")


def barker_beam(boundary: Boundary = "pinned") -> Beam:
    """The beam that stands for the dissertation's truss: 7.06 m, 108.4 kg.    [Barker1991] Sec. 2.2.3

    Given as 278 in, 2.227e-3 lbf s²/in², E I = 1e8 lbf in² and E A = 2.5e6 lbf. Its bending frequencies are those
    printed in tables 2.2 and 2.3. Its longitudinal one is 30.13 Hz, where the tables print 30.93 and 30.79 Hz:
    these differ though the two boundaries are alike, and need an E A of 2.63e6 and 2.61e6 lbf.
    """
    return Beam(
        length=278 * _INCH,
        mass_per_length=2.227e-3 * _POUND_FORCE / _INCH**2,
        bending_stiffness=1e8 * _POUND_FORCE * _INCH**2,
        axial_stiffness=2.5e6 * _POUND_FORCE,
        boundary=boundary,
    )


def assemble_beam(
    beam: Beam,
    mirror_port: str = "tip",
    lateral_modes: int = 6,
    longitudinal_modes: int = 1,
    stations: Mapping[str, Station] = MappingProxyType({}),
) -> Structure:
    """A structure whose degrees of freedom are the coordinates of a beam's modes [m √kg].

    With the mirror's mass at its port this is a Rayleigh-Ritz model: its frequencies lie above the exact ones and
    approach them with the inverse cube of the number of modes in bending, with the inverse along the beam. The
    rotation of a point under a torque converges with the inverse of that number as well, and the reference inertia
    at a port falls with the inverse cube, toward none: a point of such a beam has no inertia of its own. Choose
    the modes for the band of interest.

    Assumes the chosen modes span the motion of interest. Mass and inertia about the root are those of the whole
    beam all the same: what the modes of a fixed beam leave out of m L³/3 is carried by a mass row that is held.

    Parameters
    ----------
    mirror_port
        Name of the port where the mirror's mass rides.
    lateral_modes, longitudinal_modes
        How many of each, the rigid-body mode of a pinned beam included.
    stations
        Further ports: name to (distance from the root [m], component x, y or rz). ``hub`` and ``tip`` are the
        rotations of the two ends.

    Raises
    ------
    ModelError
        For an unknown port or component, a place off the beam, or a number of modes out of range.
    """
    for what, count in (("lateral modes", lateral_modes), ("longitudinal modes", longitudinal_modes)):
        if count > MOST_MODES:
            raise ModelError(f"beam: {count} {what}; give {MOST_MODES} at most")
    places = _places(beam, stations)
    if mirror_port not in places:
        raise ModelError(f"port '{mirror_port}' does not exist; {did_you_mean(mirror_port, places)}")
    lateral, longitudinal = beam.lateral_modes(lateral_modes), beam.longitudinal_modes(longitudinal_modes)
    n = lateral_modes + longitudinal_modes

    def row(x: float, component: str) -> Array:
        if x == 0 and (component != "rz" or beam.boundary == "fixed"):
            return np.zeros(n)  # held: zero, where shapes leave rounding
        if component == "x":
            return np.concatenate([np.zeros(lateral_modes), longitudinal.shape(x)[:, 0]])
        return np.concatenate([lateral.shape(x, int(component == "rz"))[:, 0], np.zeros(longitudinal_modes)])

    at = places[mirror_port][0]
    carried = [row(at, "x"), row(at, "y")]
    turning = np.concatenate([_turning(beam, lateral), np.zeros(longitudinal_modes)])
    left_out = max(beam.inertia - float(np.sum(turning**2)), 0.0)
    m = n + 1 + len(carried)
    return Structure(
        truss=Truss(
            nodes={name: (x, 0.0) for name, (x, _) in places.items()},
            bars=(),
            ports={name: (name, component) for name, (_, component) in places.items()},
        ),
        dofs=(
            *(f"lateral.{k + 1}" for k in range(lateral_modes)),
            *(f"longitudinal.{k + 1}" for k in range(longitudinal_modes)),
        ),
        stiffness_rows=sparse.eye_array(n, format="csr"),
        stiffness_by_area=sparse.csr_array((n, 0)),
        stiffness_by_spring=sparse.csr_array((n, 0)),
        stiffness_constant=np.concatenate([lateral.natural_frequency, longitudinal.natural_frequency]) ** 2,
        mass_rows=sparse.csr_array(np.vstack([np.eye(n), np.zeros(n), *carried])),
        mass_by_area=sparse.csr_array((m, 0)),
        mass_by_batten=sparse.csr_array((m, 0)),
        mass_by_mirror=np.concatenate([np.zeros(n + 1), np.ones(len(carried))]),
        mass_constant=np.concatenate([np.ones(n), [left_out], np.zeros(len(carried))]),
        bar_mass_per_area=np.zeros(0),
        mass_fixed=beam.mass,
        hub_arm=np.concatenate([turning, [1.0, 0.0, at]]),
        ports={name: row(x, component) for name, (x, component) in places.items()},
    )


def lateral_motion(structure: Structure, x: Array) -> Array:
    """Lateral displacement at places along an assembled beam, per coordinate of its modes.

    Shapes of a uniform beam depend on its length, mass and boundary, which an assembled one still has.

    Parameters
    ----------
    x
        (p,) distances from the root [m].

    Returns
    -------
    (p, n)
        [1/√kg], zero for the longitudinal modes.
    """
    length = structure.truss.nodes["tip"][0]
    boundary: Boundary = "fixed" if np.all(structure.stiffness_constant > 0) else "pinned"
    count = sum(name.startswith("lateral.") for name in structure.dofs)
    beam = Beam(length, structure.mass_fixed / length, 1.0, 1.0, boundary)
    motion = np.zeros((x.size, len(structure.dofs)))
    motion[:, :count] = beam.lateral_modes(count).shape(x).T
    return motion


def _places(beam: Beam, stations: Mapping[str, Station]) -> dict[str, Station]:
    places: dict[str, Station] = {"hub": (0.0, "rz"), "tip": (beam.length, "rz")}
    for name, (x, component) in stations.items():
        if name in places:
            raise ModelError(f"station '{name}': every beam has this port; choose another name")
        if component not in ("x", "y", "rz"):
            raise ModelError(f"station '{name}': component '{component}' does not exist; choose x, y or rz")
        if not 0 <= x <= beam.length:
            raise ModelError(f"station '{name}': {x:g} m is not on the beam; give 0 to {beam.length:g} m")
        places[name] = (x, component)
    return places


def _turning(beam: Beam, lateral: BeamModes) -> Array:
    """(n,) Coordinates of a unit rotation about the root, ∫ m x Y dx; by parts m Y″(0)/β⁴ for an elastic mode."""
    rigid = lateral.wave_number == 0
    beta = np.where(rigid, 1.0, lateral.wave_number)
    curvature = lateral.shape(0.0, 2)[:, 0]
    return np.where(rigid, beam.inertia**0.5, beam.mass_per_length * curvature / beta**4)
