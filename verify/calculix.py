"""CalculiX on random trusses, as springs, masses and ties that it models exactly.

A bar is a spring between its nodes (SPRINGA) and Simpson's rule for its mass: a sixth at each end and two thirds at
the middle, which moves as the mean of the ends; that is the consistent mass of a linear displacement field, exactly.
A batten is a rigid body with masses that have its mass and inertia.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fosopt.structure import Bar, Batten, PointMass, Spring, Structure, Truss

Array = NDArray[np.float64]

_MODES = 4  # CalculiX asks for four times as many unknowns


def missing() -> str | None:
    """What is not installed, as a sentence with the way out."""
    if shutil.which("ccx") is None:
        return "CalculiX is missing; install it: apt-get install calculix-ccx"
    return None


def version() -> str:
    """Name and version of what is compared with."""
    said = subprocess.run(["ccx", "-v"], capture_output=True, text=True, check=False).stdout
    return "CalculiX " + re.sub(r"[^0-9.]", "", said)


def random_truss(number: int, *, rigid: bool) -> Truss:
    """A planar or spatial truss that follows from its number alone: a lattice with some bars at random angles.

    Parameters
    ----------
    rigid
        With rigid battens (planar); otherwise all nodes are free joints.
    """
    rng = np.random.default_rng([2, number, rigid])
    if rigid:
        return _ladder(rng)
    dim = 2 + number % 2
    layers = int(rng.integers(5, 10))
    ring = {2: [(0.0,), (1.0,)], 3: [(0.0, 0.0), (1.0, 0.0), (0.4, 0.9)]}[dim]
    nodes, bars = {}, []

    def bar(one: str, other: str) -> None:
        area = float(1e-4 * 10 ** rng.uniform(-1, 1))
        bars.append(Bar(f"b{len(bars)}", (one, other), area, 70e9, 2700.0))

    size = len(ring)
    for i in range(layers + 1):
        for j, place in enumerate(ring):
            xyz = np.array([0.8 * i, *place]) + rng.uniform(-0.1, 0.1, dim)
            nodes[f"n{i}_{j}"] = tuple(float(x) for x in xyz)
    for i in range(layers + 1):
        for j in range(size):
            k = (j + 1) % size
            if (i and k > j) or (i and size > 2):
                bar(f"n{i}_{j}", f"n{i}_{k}")
            if i:
                bar(f"n{i - 1}_{j}", f"n{i}_{j}")
                bar(f"n{i - 1}_{j}", f"n{i}_{k}")
    points = tuple(PointMass(f"n{layers}_{j}", float(rng.uniform(0.5, 5))) for j in range(size))
    springs = (Spring(f"n{layers}_0", "y", float(10 ** rng.uniform(4, 6))),)
    last = f"n{layers}_{size - 1}"
    ports = {"hub": ("base", "rz"), "tip": (last, "y")}
    base = Batten("base", tuple(f"n0_{j}" for j in range(size)), 1.0, 1.0 if dim == 2 else (1.0, 1.0, 1.0))
    held = {"base": ("x", "y", "rz") if dim == 2 else ("x", "y", "z", "rx", "ry", "rz")}
    return Truss(nodes, tuple(bars), ports, held, (base,), points, springs)


def _ladder(rng: np.random.Generator) -> Truss:
    bays, half = int(rng.integers(8, 14)), 0.25
    nodes, battens, bars = {}, [], []
    for i in range(bays + 1):
        nodes[f"t{i}"], nodes[f"u{i}"] = (0.5 * i, half), (0.5 * i, -half)
        mass = float(rng.uniform(0.5, 4))
        # Half the mass at each end.
        battens.append(Batten(f"B{i}", (f"t{i}", f"u{i}"), mass, mass * half**2))
    for i in range(1, bays + 1):
        for one, other in ((f"t{i - 1}", f"t{i}"), (f"u{i - 1}", f"u{i}"), (f"t{i - 1}", f"u{i}")):
            area = float(1e-4 * 10 ** rng.uniform(-1, 1))
            bars.append(Bar(f"b{len(bars)}", (one, other), area, 70e9, 2700.0))
    ports = {"hub": ("B1", "rz"), "tip": (f"B{bays}", "rz")}
    return Truss(nodes, tuple(bars), ports, {"B0": ("x", "y", "rz")}, tuple(battens))


@dataclass
class _Deck:
    """An input file that is being written; nodes are numbered as they come."""

    lines: list[str] = field(default_factory=list)
    number: dict[str, int] = field(default_factory=dict)
    places: list[tuple[int, Array]] = field(default_factory=list)
    masses: list[tuple[int, float]] = field(default_factory=list)
    ties: list[str] = field(default_factory=list)
    elements: int = 0

    def node(self, name: str, xyz: Array) -> int:
        self.number[name] = len(self.number) + 1
        self.places.append((self.number[name], np.append(xyz, np.zeros(3 - xyz.size))))
        return self.number[name]

    def element(self, kind: str, nodes: tuple[int, ...], *card: str) -> None:
        self.elements += 1
        e = self.elements
        self.lines += [f"*ELEMENT, TYPE={kind}, ELSET=E{e}", f"{e}, {', '.join(map(str, nodes))}"]
        self.lines += [line.format(e=e) for line in card]


def deck(truss: Truss, job: str) -> str:
    """Input file for the lowest frequencies, or with `job` MATRIXSTORAGE for the matrices."""
    return _written(truss, job)[1]


def _written(truss: Truss, job: str) -> tuple[_Deck, str]:
    d = _Deck()
    dim = len(next(iter(truss.nodes.values())))
    where = {name: np.asarray(xyz, float) for name, xyz in truss.nodes.items()}
    for name, xyz in where.items():
        d.node(name, xyz)
    for bar in truss.bars:
        one, other = bar.nodes
        length = float(np.linalg.norm(where[other] - where[one]))
        ends = d.number[one], d.number[other]
        d.element("SPRINGA", ends, "*SPRING, ELSET=E{e}", "", f"{bar.young * bar.area / length:.17g}")
        mass = bar.density * bar.area * length
        middle = d.node(f"middle of {bar.name}", 0.5 * (where[one] + where[other]))
        d.masses += [(ends[0], mass / 6), (ends[1], mass / 6), (middle, 2 * mass / 3)]
        for axis in range(1, dim + 1):
            d.ties += ["*EQUATION", "3", f"{middle},{axis},1., {ends[0]},{axis},-0.5, {ends[1]},{axis},-0.5"]
    battens = [batten for batten in truss.battens if batten.name not in truss.supports]
    grounded = [node for each in truss.battens if each.name in truss.supports for node in each.nodes]
    for batten in battens:
        for node in batten.nodes:
            d.masses.append((d.number[node], batten.mass / len(batten.nodes)))
    for point in truss.points:
        d.masses.append((d.number[point.at], point.mass))
    for spring in truss.springs:
        axis = 1 + "xyz".index(spring.component)
        d.element(
            "SPRING1", (d.number[spring.at],), "*SPRING, ELSET=E{e}", str(axis), f"{spring.stiffness:.17g}"
        )
    for node, mass in d.masses:
        d.element("MASS", (node,), "*MASS, ELSET=E{e}", f"{mass:.17g}")
    boundary = []
    bodies = []
    for batten in battens:
        center = np.mean([where[node] for node in batten.nodes], axis=0)
        reference = d.node(f"reference of {batten.name}", center)
        turn = d.node(f"turn of {batten.name}", center)
        names = ",".join(str(d.number[node]) for node in batten.nodes)
        bodies += [f"*NSET, NSET=S{reference}", names]
        bodies += [f"*RIGID BODY, NSET=S{reference}, REF NODE={reference}, ROT NODE={turn}"]
        boundary += [f"{reference},3,3", f"{turn},1,2"]
    boundary += [f"{d.number[node]},1,3" for node in grounded]
    if dim == 2:
        flat = [node for node in where if not any(node in each.nodes for each in truss.battens)]
        flat += [f"middle of {bar.name}" for bar in truss.bars]
        boundary += [f"{d.number[node]},3,3" for node in flat]
    nodes = ["*NODE, NSET=NALL", *(f"{k}, {', '.join(f'{x:.17g}' for x in xyz)}" for k, xyz in d.places)]
    step = ["*STEP", f"*FREQUENCY{job}", str(_MODES), "*END STEP"]
    return d, "\n".join([*nodes, *d.lines, *bodies, *d.ties, "*BOUNDARY", *boundary, *step, ""])


def numbered(truss: Truss) -> dict[int, str]:
    """What each node of the input file is."""
    return {number: name for name, number in _written(truss, "")[0].number.items()}


def _run(text: str) -> dict[str, str]:
    """Files CalculiX leaves."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "job.inp").write_text(text)
        said = subprocess.run(["ccx", "job"], cwd=folder, capture_output=True, text=True, check=False)
        files = {path.suffix: path.read_text() for path in Path(folder).glob("job.*")}
        if "ERROR" in said.stdout or ".dat" not in files:
            raise RuntimeError(f"CalculiX stopped:\n{said.stdout[-2000:]}")
        return files


def frequencies(truss: Truss) -> Array:
    """Lowest natural frequencies [rad/s], to the seven digits that CalculiX prints."""
    rows = re.findall(r"^ +\d+ +(\S+) +(\S+) +\S+ +\S+ *$", _run(deck(truss, ""))[".dat"], re.MULTILINE)
    return np.array([float(rad) for _, rad in rows])


def matrices(truss: Truss, structure: Structure) -> tuple[Array, Array]:
    """Stiffness and mass matrix over the degrees of freedom of a structure, to the 14 digits CalculiX stores."""
    files = _run(deck(truss, ", SOLVER=MATRIXSTORAGE"))
    number = numbered(truss)
    places = []
    for entry in files[".dof"].split():
        node, axis = entry.split(".")
        name, component = number[int(node)], "xyz"[int(axis) - 1]
        if name.startswith("turn of "):
            component = f"r{component}"
        name = name.removeprefix("turn of ").removeprefix("reference of ")
        places.append(structure.dofs.index(f"{name}.{component}"))

    def full(text: str) -> Array:
        row, column, value = np.array([line.split() for line in text.splitlines()], dtype=float).T
        i, j = (np.array(places)[k.astype(int) - 1] for k in (row, column))
        found = np.zeros((len(structure.dofs),) * 2)
        found[i, j] = found[j, i] = value
        return found

    return full(files[".sti"]), full(files[".mas"])
