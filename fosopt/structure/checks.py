"""Rules a truss must keep before it is assembled."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from fosopt.errors import ModelError, did_you_mean
from fosopt.structure.truss import Truss


def check_truss(truss: Truss, mirror_port: str) -> None:
    """Refuse a truss that names what is not there, or holds a value that physics does not allow.

    Raises
    ------
    ModelError
        For the first broken rule, with the member, its value and the way out.
    """
    dim = _check_nodes(truss)
    _check_battens(truss, dim)
    _check_bars(truss)
    bodies = {*truss.nodes, *(batten.name for batten in truss.battens)}
    for point in truss.points:
        refuse_unknown(point.at, bodies, "point mass")
        _at_least_zero(f"point mass at '{point.at}'", mass=point.mass, inertia=point.inertia)
    for spring in truss.springs:
        refuse_unknown(spring.at, bodies, "spring")
        _at_least_zero(f"spring at '{spring.at}'", stiffness=spring.stiffness)
    for port in ("hub", mirror_port):
        if port not in truss.ports:
            raise ModelError(f"port '{port}' does not exist; {did_you_mean(port, truss.ports)}")


def refuse_unknown(name: str, names: Collection[str], where: str) -> None:
    """Refuse a name that does not exist."""
    if name not in names:
        raise ModelError(f"{where}: '{name}' does not exist; {did_you_mean(name, names)}")


def _check_nodes(truss: Truss) -> int:
    dims = {len(xyz) for xyz in truss.nodes.values()}
    if dims not in ({2}, {3}):
        raise ModelError(
            f"nodes: {sorted(dims)} coordinates per node; give two for a planar truss or three for a spatial one"
        )
    for name, xyz in truss.nodes.items():
        if not np.all(np.isfinite(xyz)):
            raise ModelError(f"node '{name}': coordinates {tuple(xyz)} are not finite; correct them")
    return dims.pop()


def _check_battens(truss: Truss, dim: int) -> None:
    carried: dict[str, str] = {}
    _unique("battens", [batten.name for batten in truss.battens])
    rotations = 1 if dim == 2 else 3
    for batten in truss.battens:
        where = f"batten '{batten.name}'"
        if batten.name in truss.nodes:
            raise ModelError(f"{where}: a node has the same name; rename one")
        if not batten.nodes:
            raise ModelError(f"{where}: it carries no node; name at least one")
        for node in batten.nodes:
            refuse_unknown(node, truss.nodes, where)
            if node in carried:
                raise ModelError(
                    f"{where}: node '{node}' already belongs to '{carried[node]}'; a node has one batten"
                )
            carried[node] = batten.name
        inertia = np.atleast_1d(np.asarray(batten.inertia, dtype=float))
        if inertia.size not in (1, rotations):
            raise ModelError(f"{where}: {inertia.size} inertias; give one, or {rotations} along the axes")
        if not (_positive(batten.mass) and all(map(_positive, inertia))):
            raise ModelError(
                f"{where}: mass {batten.mass}, inertia {batten.inertia} must be above zero and finite"
            )
        if batten.center is not None and len(batten.center) != dim:
            raise ModelError(
                f"{where}: center has {len(batten.center)} coordinates; give {dim}, as the nodes have"
            )


def _check_bars(truss: Truss) -> None:
    if not truss.bars:
        raise ModelError("bars: there is none; a truss needs at least one")
    _unique("bars", [bar.name for bar in truss.bars])
    for bar in truss.bars:
        where = f"bar '{bar.name}'"
        for node in bar.nodes:
            refuse_unknown(node, truss.nodes, where)
        for what in ("area", "young", "density"):
            value = getattr(bar, what)
            if not _positive(value):
                raise ModelError(
                    f"{where}: {what} {value} is not above zero; give a positive value or leave the bar out"
                )
        start, end = (truss.nodes[node] for node in bar.nodes)
        if not np.linalg.norm(np.subtract(end, start)) > 0:
            raise ModelError(f"{where}: length 0.0 m; its two nodes must lie apart")


def _positive(value: float) -> bool:
    return bool(np.isfinite(value) and value > 0)


def _at_least_zero(where: str, **values: float) -> None:
    for what, value in values.items():
        if not (np.isfinite(value) and value >= 0):
            raise ModelError(f"{where}: {what} {value} is negative or not finite; give zero or more")


def _unique(what: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ModelError(f"{what}: the name '{name}' stands twice; rename one")
        seen.add(name)
