"""Poles of a structure with everything on it but the mirror, and its receptances close to them.

Each pair of receptances is a sum over modes, g_pq(s) = Σ_k (a_k + b_k s)/((s − p_k)(s − p_k′)). For a structure
alone b is zero and a = φ_pk φ_qk; reaction masses make its modes complex, which b carries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from fosopt.actuators import Suspended
from fosopt.control.free_body import refuse_turning
from fosopt.control.loop import Loop, Receptances, attach
from fosopt.control.steered import SteeredAxis
from fosopt.modes import ModalSet
from fosopt.ops import Array, ComplexArray, Dual
from fosopt.plant import attached

_SAME = 1e-13
# A mode whose motion at a port is this small beside the largest one there stands still, about both axes of a mirror.
_NODE = 1e-9
# Points times modes that are worked on at once: more of them leave the cache.
BLOCK = 2**15


@dataclass(frozen=True)
class OpenLoopPoles:
    """Poles of the modes a mirror can move, and what they contribute to the receptances.

    Attributes
    ----------
    first, second
        (n,) the two poles of each mode; conjugate, or both real [rad/s].
    constant, linear
        (n, q) a and b of each mode, one column per pair of ports in the order of `Loop.pairs`; `linear` is None
        where all b are zero.
    seen
        Which modes of the modal set take part.
    uncoupled
        Poles of modes with a node at the mirror port: the loop neither moves nor sees them.
    drifting
        Whether a free rigid-body mode is present; its double pole at zero stays where it is, because internal
        torque cannot move it.
    hung
        What hangs on the structure beyond its poles, with the index of its port: `receptances` adds it.
    """

    first: ComplexArray
    second: ComplexArray
    constant: Array
    linear: Array | None
    seen: NDArray[np.bool_]
    uncoupled: ComplexArray
    drifting: bool
    hung: tuple[tuple[int, Suspended | SteeredAxis], ...] = ()

    def factors(
        self, base: ComplexArray, shift: ComplexArray, without: NDArray[np.intp] | None = None
    ) -> tuple[ComplexArray, ComplexArray]:
        """1/D_k and D_k′/D_k of each mode's D_k = (s − p_k)(s − p_k′) at s = base + shift.

        Exact as the shift goes to zero.

        Parameters
        ----------
        without
            (m,) the mode to leave out at each point.

        Returns
        -------
        (m, n), (m, n)
            One row per point.
        """
        to_first = (base[:, None] - self.first) + shift[:, None]
        to_second = (base[:, None] - self.second) + shift[:, None]
        product = to_first * to_second
        if without is not None:
            product[np.arange(without.size), without] = np.inf
        inverse = 1.0 / product
        return inverse, (to_first + to_second) * inverse

    def numerators(self, s: ComplexArray, modes: NDArray[np.intp]) -> ComplexArray:
        """(m, q) a + b s of one mode at each of (m,) points."""
        constant = self.constant[modes].astype(complex)
        return constant if self.linear is None else constant + s[:, None] * self.linear[modes]

    @property
    def mobility(self) -> Receptances:
        """Lim s² g_pq(s) for s to infinity, the inverse of the inertias at the ports [1/(kg m²)]."""
        total = self.constant.sum(axis=0)
        if self.linear is not None:
            total = total + (self.first + self.second).real @ self.linear
        return Receptances.of(total)

    def receptances(self, base: ComplexArray, shift: ComplexArray) -> Receptances:
        """Receptances at s = base + shift, (m,) each, with their derivatives in `s`."""
        s = base + shift
        g = Receptances.of(self.sums(base, shift)[0])
        for port, body in self.hung:
            g = attach(Dual(s, 1.0), g, port, body, g.pairs)
        return g

    def sums(
        self, base: ComplexArray, shift: ComplexArray, first: int | None = None
    ) -> tuple[list[Dual], ComplexArray]:
        """The `first` pairs of receptances, or all, at s = base + shift, and Σ_k D_k′/D_k there.

        A double pole at zero is no part of the last sum.
        """
        moving = (self.first != 0).astype(float)
        rows = max(BLOCK // max(self.first.size, 1), 1)
        found = []
        for start in range(0, max(base.size, 1), rows):
            b, d = base[start : start + rows], shift[start : start + rows]
            inverse, logarithmic = self.factors(b, d)
            found.append((self.summed(inverse, logarithmic, b + d, first), logarithmic @ moving))
        if len(found) == 1:
            return found[0]
        pairs = [
            Dual(
                np.concatenate([each.value for each in parts]), np.concatenate([each.slope for each in parts])
            )
            for parts in zip(*(pairs for pairs, _ in found), strict=True)
        ]
        return pairs, np.concatenate([known for _, known in found])

    def summed(
        self, inverse: ComplexArray, logarithmic: ComplexArray, s: ComplexArray, first: int | None = None
    ) -> list[Dual]:
        """The same from `factors` that are known already, of the `first` pairs or all."""
        constant = self.constant[:, :first]
        slope = -inverse * logarithmic
        value, change = inverse @ constant, slope @ constant
        if self.linear is not None:
            linear = self.linear[:, :first]
            by_s = inverse @ linear
            value = value + s[:, None] * by_s
            change = change + s[:, None] * (slope @ linear) + by_s
        return [Dual(value[:, k], change[:, k]) for k in range(value.shape[1])]


def open_loop_poles(loop: Loop, modes: ModalSet, mirror_port: str) -> OpenLoopPoles:
    """Open-loop poles of a modal set and what is attached to it, split by whether the loop can move them.

    Raises
    ------
    ModelError
        If the control torque turns a free rigid body.
    """
    refuse_turning(loop, modes, mirror_port)
    shapes = np.array([modes.at(port) for port in loop.ports(mirror_port)]).T
    if loop.beside is not None:
        return _of_both_axes(loop, modes, shapes)
    if not loop.bare:
        return _with_attachments(loop, modes, mirror_port, shapes)
    if loop.plain and loop.mirror.stiffness == 0:
        shapes = np.zeros_like(shapes)  # Without a spring the mirror neither moves nor feels the structure.
    stiffness, (first, second) = modes.stiffness, _modal_poles(modes)
    constant = np.column_stack([shapes[:, a] * shapes[:, b] for a, b in loop.pairs])
    seen = np.any(constant[:, moving_pairs(loop)], axis=1)
    constant, hidden = _combined(loop, modes, constant)
    return OpenLoopPoles(
        first[~hidden],
        second[~hidden],
        constant[~hidden],
        None,
        seen,
        np.concatenate([first[hidden & (stiffness > 0)], second[hidden & (stiffness > 0)]]),
        drifting=bool(np.any(stiffness == 0)),
    )


def _of_both_axes(loop: Loop, modes: ModalSet, shapes: Array) -> OpenLoopPoles:
    """Poles of the structure alone; what is attached to it, the other axis included, hangs on it."""
    ports = shapes[:, sorted({0, *(port for port, _ in loop.attachments)})]
    seen = np.any(np.abs(ports) > _NODE * np.abs(ports).max(axis=0), axis=1)
    first, second = _modal_poles(modes)
    constant = np.column_stack([shapes[:, a] * shapes[:, b] for a, b in loop.pairs])
    hidden = ~seen & (modes.stiffness > 0)
    return OpenLoopPoles(
        first[seen],
        second[seen],
        constant[seen],
        None,
        seen,
        np.concatenate([first[hidden], second[hidden]]),
        bool(np.any(modes.stiffness == 0)),
        tuple(loop.attachments),
    )


def _modal_poles(modes: ModalSet) -> tuple[ComplexArray, ComplexArray]:
    """(n,), (n,) The two poles of each mode."""
    half = 0.5 * modes.damping
    root = np.sqrt((half**2 - modes.stiffness).astype(complex))
    return -half + root, -half - root


def moving_pairs(loop: Loop, hub: bool = False) -> list[int]:
    """Places in `Loop.pairs` of those through which the loop can move a mode, on which Δ depends.

    Parameters
    ----------
    hub
        Whether those are wanted too through which a torque on the hub reaches the line of sight.
    """
    place = loop.placement
    beside = None if loop.beside is None else loop.beside.port
    named = (place.reaction, place.sensor, place.action, beside)
    in_loop = {0, *(loop.index(p) for p in named if p is not None)}
    if hub:
        in_loop.add(1)
    # A sensor on the mirror sees a mode through the mirror's port alone.
    rows = {0} if place.sensor is None and beside is None else in_loop
    return [k for k, (a, b) in enumerate(loop.pairs) if {a, b} <= in_loop and rows & {a, b}]


def _combined(loop: Loop, modes: ModalSet, constant: Array) -> tuple[Array, NDArray[np.bool_]]:
    """What each mode contributes, with modes of one and the same pole combined into one, and which are hidden.

    Modes that share frequency and damping act as one with the sum of their contributions; what is left of them
    the loop cannot move.
    """
    moving = moving_pairs(loop)
    if loop.placement.sensor is not None:
        # Seen from the structure, two modes of one pole may both be moved.
        return constant, ~np.any(constant[:, moving], axis=1)
    constant = constant.copy()
    order = np.argsort(modes.stiffness, kind="stable")
    stiffness, damping = modes.stiffness[order], modes.damping[order]
    same = (np.diff(stiffness) <= _SAME * stiffness[1:]) & (np.abs(np.diff(damping)) <= _SAME * damping[1:])
    for i in np.flatnonzero(same & (stiffness[1:] > 0)):
        lower, upper = order[i], order[i + 1]
        if np.any(constant[lower][moving]):
            constant[upper] += constant[lower]
            constant[lower] = 0.0
    return constant, ~np.any(constant[:, moving], axis=1)


def _with_attachments(loop: Loop, modes: ModalSet, mirror_port: str, shapes: Array) -> OpenLoopPoles:
    """Complex modes of the structure with reaction masses.

    With M, C and K symmetric, mode shape ψ of pole p contributes ψψᵀ/(ψᵀ(2pM + C)ψ)/(s − p), and the Rayleigh
    quotient of ψ gives p to the square of what the eigenvalue solver left of an error.    [Lancaster1966]
    """
    deaf = ~np.any(np.delete(shapes, 1, axis=1), axis=1)
    seen = modes.keep(np.flatnonzero(~deaf))
    n = seen.natural_frequency.size
    structure = (np.eye(n), np.diag(seen.damping), np.diag(seen.stiffness))
    bodies = [(shapes[~deaf, k], body) for k, body in loop.suspended]
    mass, damping, stiffness, _ = attached(structure, bodies)
    inertia, size = np.diag(mass), mass.shape[0]
    # States of like size: displacements times a frequency.
    scale = np.sqrt(np.maximum(np.diag(stiffness) / inertia, 1.0))
    a = np.zeros((2 * size, 2 * size))
    a[:size, size:] = np.diag(scale)
    a[size:, :size], a[size:, size:] = -stiffness / inertia[:, None] / scale, -damping / inertia[:, None]
    pole, vectors = linalg.eig(a)
    shape = vectors[:size] / scale[:, None]
    drifting = bool(np.any(seen.stiffness == 0))
    order = np.argsort(np.abs(pole), kind="stable")[2 if drifting else 0 :]
    pole, shape = pole[order], shape[:, order]
    slope = _quadratic(shape, 2 * pole * inertia[:, None] * shape + damping @ shape)
    force = pole**2 * inertia[:, None] * shape + pole * (damping @ shape) + stiffness @ shape
    pole = pole - _quadratic(shape, force) / slope
    at = shapes[~deaf].T @ shape[:n]
    residue = np.array([at[p] * at[q] / slope for p, q in loop.pairs]).T
    first, second, constant, linear = _paired(pole, residue)
    if drifting:
        still = int(np.flatnonzero(seen.stiffness == 0)[0])
        own = shapes[~deaf][still]
        # The free rigid body carries every mass on it.
        whole = 1 + sum(body.inertia * row[still] ** 2 for row, body in bodies)
        first, second = np.append(first, 0.0), np.append(second, 0.0)
        constant = np.vstack([constant, [own[p] * own[q] / whole for p, q in loop.pairs]])
        linear = np.vstack([linear, np.zeros(linear.shape[1])])
    hidden = np.concatenate(_modal_poles(modes.keep(np.flatnonzero(deaf))))
    return OpenLoopPoles(first, second, constant, linear, ~deaf, hidden, drifting)


def _quadratic(shape: ComplexArray, image: ComplexArray) -> ComplexArray:
    """ψᵀ x of each column, without conjugation."""
    return np.einsum("ik,ik->k", shape, image)


def _paired(pole: ComplexArray, residue: ComplexArray) -> tuple[ComplexArray, ComplexArray, Array, Array]:
    """Single poles joined to pairs of one real numerator a + b s over (s − p)(s − p′)."""
    upper = np.flatnonzero(pole.imag > 0)
    real = np.flatnonzero(pole.imag == 0)
    real = real[np.argsort(pole[real].real)]
    low, high = real[::2], real[1::2]
    first = np.concatenate([pole[upper], pole[low]])
    second = np.concatenate([pole[upper].conj(), pole[high]])
    mine = np.concatenate([residue[upper], residue[low]])
    other = np.concatenate([residue[upper].conj(), residue[high]])
    linear = np.real(mine + other)
    constant = -np.real(mine * second[:, None] + other * first[:, None])
    return first, second, constant, linear
