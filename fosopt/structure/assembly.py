"""From a `Truss` as written down to the constant matrices of a `Structure`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from fosopt.errors import ModelError, did_you_mean
from fosopt.ops import Array
from fosopt.structure.checks import check_truss, refuse_unknown
from fosopt.structure.truss import ROTATIONS, TRANSLATIONS, Batten, Structure, Truss


@dataclass(frozen=True)
class _Motion:
    """Motion of a node or body, `block` times the degrees of freedom from the first one on."""

    first: int
    block: Array

    def seen(self, by: Array) -> _Motion:
        """What linear measurements `by` of it are."""
        return _Motion(self.first, by @ self.block)


@dataclass(frozen=True)
class _Frame:
    """Where each node and batten keeps its degrees of freedom, before supports are removed."""

    dim: int
    names: tuple[str, ...]
    index: Mapping[str, int]
    node_maps: Mapping[str, _Motion]  # (dim,) displacement of each node
    body_maps: Mapping[str, _Motion]  # (n_component,) motion of each free node or batten
    center: Mapping[str, Array]

    def rows(self, parts: Sequence[Sequence[_Motion]]) -> sparse.csr_array:
        """Sums of motions, one below the other; linear in their number, as thousands of bars need it."""
        places: list[tuple[int, int, int, int]] = []
        count = 0
        for group in parts:
            height = group[0].block.shape[0]
            places += [(count, height, motion.first, motion.block.shape[1]) for motion in group]
            count += height
        values = [motion.block.ravel() for group in parts for motion in group]
        i = [np.repeat(np.arange(row, row + height), width) for row, height, _, width in places]
        j = [np.tile(np.arange(first, first + width), height) for _, height, first, width in places]
        entries = np.concatenate(values), (np.concatenate(i), np.concatenate(j))
        matrix = sparse.csr_array(entries, shape=(count, len(self.names)))
        matrix.eliminate_zeros()
        return matrix


def assemble(truss: Truss, mirror_port: str) -> Structure:
    """Assemble a truss whose mirror sits at a port.

    Rigid battens are eliminated exactly: the motion of a node they carry is u = u_c + θ × r.

    Parameters
    ----------
    mirror_port
        Name of the port at whose node or batten the mirror's mass rides.

    Raises
    ------
    ModelError
        For an unknown node, batten, component or port, a bar of no length, a quantity without a physical
        value, or a truss without a port ``hub``.
    """
    check_truss(truss, mirror_port)
    frame = _frame(truss)
    stiffness_rows, by_area, by_spring = _stiffness(truss, frame)
    mass = _mass(truss, frame, mirror_port)
    hub_arm = mass.rows @ _unit_rotation(truss, frame)

    held = {_dof(frame, at, c, "support") for at, components in truss.supports.items() for c in components}
    free = [index for index, name in enumerate(frame.names) if name not in held]
    if not free:
        raise ModelError("supports: they hold every degree of freedom; leave at least one free")
    ports = {}
    for name, (at, component) in truss.ports.items():
        row = np.array([frame.names[i] == _dof(frame, at, component, f"port '{name}'") for i in free], float)
        ports[name] = row
    return Structure(
        truss=truss,
        dofs=tuple(frame.names[i] for i in free),
        stiffness_rows=stiffness_rows[:, free],
        stiffness_by_area=by_area,
        stiffness_by_spring=by_spring,
        stiffness_constant=np.zeros(stiffness_rows.shape[0]),
        mass_rows=mass.rows[:, free],
        mass_by_area=mass.by_area,
        mass_by_batten=mass.by_batten,
        mass_by_mirror=mass.by_mirror,
        mass_constant=mass.constant,
        bar_mass_per_area=mass.bar_mass_per_area,
        mass_fixed=float(sum(point.mass for point in truss.points)),
        hub_arm=hub_arm,
        ports=ports,
    )


def bar_lengths(truss: Truss) -> Array:
    """(b,) Length of each bar [m]."""
    nodes = {name: np.asarray(xyz, dtype=float) for name, xyz in truss.nodes.items()}
    return np.array([np.linalg.norm(nodes[bar.nodes[1]] - nodes[bar.nodes[0]]) for bar in truss.bars])


def motion_at(structure: Structure, places: Sequence[str]) -> sparse.csr_array:
    """Displacement of nodes, those that battens carry included, and of centers of battens.

    Parameters
    ----------
    places
        (p,) names of nodes or battens.

    Returns
    -------
    (dim p, n)
        The components of each place one below the other, per degree of freedom [m/m] or [m/rad].
    """
    frame = _frame(structure.truss)
    centers = {
        name: body.seen(np.eye(frame.dim, body.block.shape[0])) for name, body in frame.body_maps.items()
    }
    maps = {**centers, **frame.node_maps}
    rows = frame.rows([[maps[name]] for name in places])
    return rows[:, [frame.index[name] for name in structure.dofs]]


def _rotations(dim: int) -> tuple[str, ...]:
    return ("rz",) if dim == 2 else ROTATIONS


def _frame(truss: Truss) -> _Frame:
    dim = len(next(iter(truss.nodes.values())))
    carried = {node for batten in truss.battens for node in batten.nodes}
    components = (*TRANSLATIONS[:dim], *_rotations(dim))
    names: list[str] = []
    start: dict[str, int] = {}
    for node in truss.nodes:
        if node not in carried:
            start[node] = len(names)
            names += [f"{node}.{c}" for c in components[:dim]]
    for batten in truss.battens:
        start[batten.name] = len(names)
        names += [f"{batten.name}.{c}" for c in components]

    node_maps, body_maps, center = {}, {}, {}
    for node, xyz in truss.nodes.items():
        if node not in carried:
            node_maps[node] = body_maps[node] = _Motion(start[node], np.eye(dim))
            center[node] = np.asarray(xyz, dtype=float)
    for batten in truss.battens:
        center[batten.name] = _center(truss, batten)
        body_maps[batten.name] = _Motion(start[batten.name], np.eye(len(components)))
        for node in batten.nodes:
            arm = np.asarray(truss.nodes[node], dtype=float) - center[batten.name]
            node_maps[node] = _Motion(start[batten.name], np.hstack([np.eye(dim), _cross(arm)]))
    index = {name: i for i, name in enumerate(names)}
    return _Frame(dim, tuple(names), index, node_maps, body_maps, center)


def _center(truss: Truss, batten: Batten) -> Array:
    if batten.center is not None:
        return np.asarray(batten.center, dtype=float)
    return np.mean([truss.nodes[node] for node in batten.nodes], axis=0)


def _cross(arm: Array) -> Array:
    """(dim, n_rotation) Matrix of θ ↦ θ × arm."""
    if arm.size == 2:
        return np.array([[-arm[1]], [arm[0]]])
    x, y, z = arm
    return np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]], dtype=float)


def _dof(frame: _Frame, at: str, component: str, where: str) -> str:
    refuse_unknown(at, frame.body_maps, where)
    name = f"{at}.{component}"
    if name not in frame.index:
        known = [n.split(".")[-1] for n in frame.names if n.rsplit(".", 1)[0] == at]
        raise ModelError(f"{where}: '{at}' has no component '{component}'; {did_you_mean(component, known)}")
    return name


def _stiffness(truss: Truss, frame: _Frame) -> tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array]:
    """Rows, and weights per area and per spring: bars come first, springs after them."""
    lengths = bar_lengths(truss)
    rows = []
    for bar, length in zip(truss.bars, lengths, strict=True):
        start, end = bar.nodes
        direction = (np.subtract(truss.nodes[end], truss.nodes[start]) / length)[None, :]
        rows.append([frame.node_maps[end].seen(direction), frame.node_maps[start].seen(-direction)])
    for spring in truss.springs:
        rows.append([_Motion(frame.index[_dof(frame, spring.at, spring.component, "spring")], np.eye(1))])
    per_area = np.array([bar.young for bar in truss.bars]) / lengths
    n_bar, n_spring = len(truss.bars), len(truss.springs)
    by_area = sparse.vstack([sparse.diags_array(per_area), sparse.csr_array((n_spring, n_bar))], format="csr")
    by_spring = sparse.eye_array(n_bar + n_spring, n_spring, k=-n_bar, format="csr")
    return frame.rows(rows), by_area, by_spring


@dataclass(frozen=True)
class _Mass:
    rows: sparse.csr_array
    by_area: sparse.csr_array
    by_batten: sparse.csr_array
    by_mirror: Array
    constant: Array
    bar_mass_per_area: Array


def _mass(truss: Truss, frame: _Frame, mirror_port: str) -> _Mass:
    dim, n_bar, n_batten = frame.dim, len(truss.bars), len(truss.battens)
    rows: list[list[_Motion]] = []
    area_entries: list[tuple[int, int, float]] = []
    batten_entries: list[tuple[int, int, float]] = []
    constant_entries: list[tuple[int, float]] = []
    count = 0
    bar_mass_per_area = np.array([bar.density for bar in truss.bars]) * bar_lengths(truss)
    for e, bar in enumerate(truss.bars):
        start, end = (frame.node_maps[node] for node in bar.nodes)
        mean, difference = np.eye(dim) / 2, np.eye(dim)
        for signs, share in (((mean, mean), 1.0), ((-difference, difference), 1 / 12)):
            rows.append([start.seen(signs[0]), end.seen(signs[1])])
            area_entries += [(count + i, e, share * bar_mass_per_area[e]) for i in range(dim)]
            count += dim
    for r, batten in enumerate(truss.battens):
        inertia = np.broadcast_to(np.asarray(batten.inertia, dtype=float), (len(_rotations(dim)),))
        shares = np.concatenate([np.ones(dim), inertia / batten.mass])
        rows.append([frame.body_maps[batten.name]])
        batten_entries += [(count + i, r, share) for i, share in enumerate(shares)]
        count += shares.size
    for point in truss.points:
        refuse_unknown(point.at, frame.body_maps, "point mass")
        body = frame.body_maps[point.at]
        values = np.full(body.block.shape[0], point.inertia)
        values[:dim] = point.mass
        rows.append([body])
        constant_entries += [(count + i, value) for i, value in enumerate(values)]
        count += values.size
    at, component = truss.ports[mirror_port]
    _dof(frame, at, component, f"port '{mirror_port}'")
    body = frame.body_maps[at]
    rows.append([body.seen(np.eye(dim, body.block.shape[0]))])
    by_mirror = np.concatenate([np.zeros(count), np.ones(dim)])
    count += dim

    def table(entries: list[tuple[int, int, float]], columns: int) -> sparse.csr_array:
        i, j, v = zip(*entries, strict=True) if entries else ((), (), ())
        return sparse.csr_array(
            (np.array(v, float), (np.array(i, int), np.array(j, int))), shape=(count, columns)
        )

    constant = np.zeros(count)
    for index, value in constant_entries:
        constant[index] = value
    return _Mass(
        rows=frame.rows(rows),
        by_area=table(area_entries, n_bar),
        by_batten=table(batten_entries, n_batten),
        by_mirror=by_mirror,
        constant=constant,
        bar_mass_per_area=bar_mass_per_area,
    )


def _unit_rotation(truss: Truss, frame: _Frame) -> Array:
    """(n,) Displacement of all degrees of freedom for a unit rotation about the hub's axis."""
    at, component = truss.ports["hub"]
    _dof(frame, at, component, "port 'hub'")
    axes = _rotations(frame.dim)
    if component not in axes:
        raise ModelError(f"port 'hub': component '{component}' is no rotation; give one of {', '.join(axes)}")
    axis = np.array([float(component == c) for c in axes])
    motion = np.zeros(len(frame.names))
    for name, body in frame.body_maps.items():
        rotation = _cross(frame.center[name] - frame.center[at]) @ axis
        count = body.block.shape[0]
        motion[body.first : body.first + count] += np.concatenate([rotation, axis])[:count]
    return motion
