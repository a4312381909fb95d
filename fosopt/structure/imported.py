"""Imported structures: a modal set or matrices of a foreign model, as a structure in modal coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import linalg, sparse

from fosopt.errors import ModelError, did_you_mean
from fosopt.ops import Array
from fosopt.structure.readers.common import bad
from fosopt.structure.readers.modal_set import ModalFile
from fosopt.structure.truss import TRANSLATIONS, Structure, Truss
from fosopt.units import HZ

RESIDUAL_DAMPING = 0.5**0.5
"""Damping ratio of the modes that stand for residual flexibility: no resonance of their own [-]."""
_RESIDUAL_RATIO = 10.0
# Frequencies below this share of the highest one are rigid-body modes that an eigenvalue solver left at rounding.
_RIGID = 1e-6
# A rigid-body mode moves what is in use if it does by more than this share of the one that moves it most.
_SEEN = 1e-6
# Two modes closer than this (relative) may be turned into one another.
_REPEATED = 1e-9
# A flexibility matrix may have eigenvalues this far (relative) below zero, by rounding of the tool that wrote it.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ModelUnits:
    """Units of a foreign model; its time is in seconds and its angles in radians.

    Attributes
    ----------
    length, force
        One unit of each [m], [N].
    wtmass
        Factor from what the model calls mass to force/(length/s²): 1/386.1 where masses are weights in pounds and
        lengths inches [-].
    """

    length: float
    force: float
    wtmass: float = 1.0

    @property
    def mass(self) -> float:
        """One unit of mass [kg]."""
        return self.wtmass * self.force / self.length

    def displacement(self, dofs: Sequence[str]) -> Array:
        """(p,) One unit of motion of each degree of freedom [m] or [rad]."""
        return np.array([self.length if name.rsplit(".", 1)[-1] in TRANSLATIONS else 1.0 for name in dofs])

    @property
    def energy(self) -> float:
        """One unit of energy [J]."""
        return self.force * self.length


@dataclass(frozen=True)
class ImportedModes:
    """Mass-normalized modes of a foreign model in SI units.

    Attributes
    ----------
    natural_frequency
        (n,) ascending, zero for rigid-body modes [rad/s].
    mode_shape
        (p, n) [1/√kg], [1/(√kg m)].
    dofs
        (p,) names such as ``101.rz``.
    damping_ratio
        (n,) where the model has them [-].
    residual_flexibility
        (p, p) static flexibility of what the modes leave out, where the model has it [m/N], [rad/N], [rad/(N m)].
    """

    natural_frequency: Array
    mode_shape: Array
    dofs: tuple[str, ...]
    damping_ratio: Array | None = None
    residual_flexibility: Array | None = None

    @property
    def n_rigid(self) -> int:
        """Number of rigid-body modes, which come first."""
        return int(np.count_nonzero(self.natural_frequency == 0))


def modes_in_si(found: ModalFile, units: ModelUnits, rigid_below: float | None = None) -> ImportedModes:
    """The modes of a file, ascending, mass-normalized and in SI units.

    Parameters
    ----------
    rigid_below
        Frequencies below are those of rigid-body modes and count as zero; by default a millionth of the highest
        [rad/s].

    Raises
    ------
    StudyError
        If modes of one frequency differ in damping, where only their plane is determined, or if the residual
        flexibility is not that of a passive structure.
    """
    frequency = found.frequency_hz * HZ
    order = np.argsort(frequency, kind="stable")
    frequency = frequency[order]
    limit = _RIGID * frequency[-1] if rigid_below is None else rigid_below
    frequency = np.where(frequency <= limit, 0.0, frequency)
    if not frequency[-1] > 0:
        raise bad(
            found.file,
            "every mode is a rigid-body mode; export elastic modes as well, or lower 'rigid_below'",
        )
    unit = units.displacement(found.dofs)
    modal_mass = np.ones(frequency.size) if found.modal_mass is None else found.modal_mass[order]
    # A modal mass of one file unit carries the energy ½ of one unit of energy at one unit of modal velocity.
    scale = np.sqrt(modal_mass * units.wtmass * units.energy)
    shape = unit[:, None] * found.mode_shape[:, order] / scale
    damping = None if found.damping_ratio is None else found.damping_ratio[order]
    if damping is not None:
        near = np.diff(frequency) <= _REPEATED * frequency[1:]
        for k in np.flatnonzero(near & (frequency[1:] > 0) & (np.diff(damping) != 0)):
            raise bad(
                found.file,
                f"modes {order[k] + 1} and {order[k + 1] + 1} have one frequency, {frequency[k] / HZ:g} Hz, but the "
                f"damping ratios {damping[k]:g} and {damping[k + 1]:g}; give both the same",
            )
    residual = found.residual_flexibility
    if residual is not None:
        residual = residual * np.outer(unit, unit) / units.energy
        _check_residual(found.file, residual)
    return ImportedModes(frequency, shape, found.dofs, damping, residual)


def _check_residual(file: Path, residual: Array) -> None:
    size = np.sqrt(np.abs(np.diag(residual)))
    scaled = residual / np.maximum(np.outer(size, size), np.finfo(float).tiny)
    uneven = np.abs(scaled - scaled.T)
    if uneven.max() > _ROUNDING:
        i, j = np.unravel_index(int(np.argmax(uneven)), uneven.shape)
        raise bad(
            file,
            f"'residual_flexibility' is not symmetric at ({i + 1}, {j + 1}); flexibility is: correct the file",
        )
    least = linalg.eigvalsh((scaled + scaled.T) / 2)[0]
    if least < -_ROUNDING * len(scaled):
        raise bad(
            file,
            "'residual_flexibility' has a negative eigenvalue; a passive structure has none: correct the file",
        )


def assemble_modes(
    modes: ImportedModes,
    ports: Mapping[str, tuple[str, str]],
    mirror_port: str,
    mass: float,
    inertia: float | None = None,
) -> Structure:
    """A structure whose degrees of freedom are the coordinates of imported modes [m √kg].

    The mirror's mass rides on those translations of its port's grid that the modes know. With it this is a
    Rayleigh-Ritz model on the imported modes, and exact if they are all there are. A residual flexibility becomes one
    mode per independent load at the ports, ten times above the highest frequency: right at zero frequency, and 1 %
    too flexible at the highest imported one. A port named ``hub`` that does not exist is held. Of a structure
    that floats, rigid-body modes that move no port are left out; then the mirror's mass cannot ride.

    Parameters
    ----------
    ports
        Port name to (grid, component).
    mass
        Of the structure without the mirror [kg].
    inertia
        About the hub; by default that of the one rigid-body mode that turns the hub [kg m²].

    Raises
    ------
    ModelError
        For a port the modes do not know, or where the inertia can be had from neither.
    """
    if mirror_port not in ports:
        raise ModelError(f"port '{mirror_port}' does not exist; {did_you_mean(mirror_port, ports)}")
    index = {name: k for k, name in enumerate(modes.dofs)}
    for port, (grid, component) in ports.items():
        if f"{grid}.{component}" not in index:
            raise ModelError(
                f"port '{port}': the model has no degree of freedom '{grid}.{component}'; "
                f"{did_you_mean(f'{grid}.{component}', index)}"
            )
    grid = ports[mirror_port][0]
    carried = [index[name] for c in TRANSLATIONS if (name := f"{grid}.{c}") in index]
    seen = {index[f"{at}.{c}"] for at, c in ports.values()}
    if inertia is None:
        inertia = _rigid_inertia(modes, ports, index)
    if modes.n_rigid > 1:
        floating = _rigid_seen(modes, sorted({*seen, *carried}))
        if floating.n_rigid > 1:
            # Of a model that floats, the mirror's mass would ride on rigid-body modes of its own.
            carried = []
            floating = _rigid_seen(modes, sorted(seen))
        modes = floating
    used = sorted({*carried, *seen})
    frequency, shape = _with_residual(modes, used)
    n = frequency.size
    rows = {name: shape[index[f"{at}.{c}"]] for name, (at, c) in ports.items()}
    rows.setdefault("hub", np.zeros(n))
    m = n + 1 + len(carried)
    return Structure(
        truss=Truss(nodes={at: (0.0, 0.0) for at, _ in ports.values()}, bars=(), ports=dict(ports)),
        dofs=tuple(f"mode.{k + 1}" for k in range(n)),
        stiffness_rows=sparse.eye_array(n, format="csr"),
        stiffness_by_area=sparse.csr_array((n, 0)),
        stiffness_by_spring=sparse.csr_array((n, 0)),
        stiffness_constant=frequency**2,
        # A held row carries the inertia about the hub, as modes need not span that rotation.
        mass_rows=sparse.csr_array(np.vstack([np.eye(n), np.zeros(n), shape[carried]])),
        mass_by_area=sparse.csr_array((m, 0)),
        mass_by_batten=sparse.csr_array((m, 0)),
        mass_by_mirror=np.concatenate([np.zeros(n + 1), np.ones(len(carried))]),
        mass_constant=np.concatenate([np.ones(n), [inertia], np.zeros(len(carried))]),
        bar_mass_per_area=np.zeros(0),
        mass_fixed=mass,
        hub_arm=np.concatenate([np.zeros(n), [1.0], np.zeros(len(carried))]),
        ports=rows,
    )


def _with_residual(modes: ImportedModes, used: Sequence[int]) -> tuple[Array, Array]:
    """Frequencies and shapes with the modes that stand for residual flexibility at the degrees of freedom in use."""
    residual = modes.residual_flexibility
    if residual is None:
        return modes.natural_frequency, modes.mode_shape
    block = residual[np.ix_(used, used)]
    size = np.sqrt(np.diag(block))
    size = np.where(size > 0, size, 1.0)
    value, vector = linalg.eigh(block / np.outer(size, size))
    loaded = value > _ROUNDING * max(value[-1], 0.0)
    above = _RESIDUAL_RATIO * modes.natural_frequency[-1]
    extra = np.zeros((len(modes.dofs), int(np.count_nonzero(loaded))))
    extra[used] = above * size[:, None] * vector[:, loaded] * np.sqrt(value[loaded])
    frequency = np.concatenate([modes.natural_frequency, np.full(extra.shape[1], above)])
    return frequency, np.hstack([modes.mode_shape, extra])


def _rigid_seen(modes: ImportedModes, used: Sequence[int]) -> ImportedModes:
    """The modes with as few rigid-body modes as the degrees of freedom in use can tell apart.

    Any basis of rigid-body motion is right; in this one the others move nothing that is in use, and are left out.
    """
    count = modes.n_rigid
    rigid = modes.mode_shape[:, :count]
    _, size, turn = linalg.svd(rigid[used])
    rank = int(np.count_nonzero(size > _SEEN * size[0])) if size.size and size[0] > 0 else 0
    kept = rigid @ turn[:rank].T
    damping = None if modes.damping_ratio is None else modes.damping_ratio[count - rank :]
    return ImportedModes(
        modes.natural_frequency[count - rank :],
        np.hstack([kept, modes.mode_shape[:, count:]]),
        modes.dofs,
        damping,
        modes.residual_flexibility,
    )


def _rigid_inertia(
    modes: ImportedModes, ports: Mapping[str, tuple[str, str]], index: Mapping[str, int]
) -> float:
    at, component = ports.get("hub", ("", ""))
    turning = modes.mode_shape[index[f"{at}.{component}"], : modes.n_rigid] if at else np.zeros(modes.n_rigid)
    if modes.n_rigid != 1 or turning[0] == 0:
        raise ModelError(
            f"the inertia about the hub does not follow from {modes.n_rigid} rigid-body modes; add 'structure_inertia'"
        )
    return float(1 / turning[0] ** 2)
