"""The dissertation's planar truss: 20 square bays, rigid battens, one alternating diagonal per bay.

Geometry and total mass are published (section 2.2, figure 2.2). Member stiffnesses and the split of the mass
were measured by others and not printed; the values here reproduce tables 2.2 and 2.3 within 1.2 %. They are
effective values that include the terminal bolts and joints, so `young` and `density` of a bar are not those
of aluminum.
"""

from __future__ import annotations

from math import pi
from typing import Literal

from fosopt.errors import ModelError
from fosopt.structure.truss import Bar, Batten, Spring, Truss

LENGTH = 7.07  # [m], section 2.2
BAYS = 20
BAY_LENGTH = LENGTH / BAYS  # "0.354 m" to three digits
TUBE_AREA = pi / 4 * (22.0e-3**2 - 20.0e-3**2)  # tube of 22 mm by 1 mm [m²], section 2.2
TOTAL_MASS = 108.3  # 7.42 slug [kg], section 2.2.3

LONGERON_STIFFNESS, DIAGONAL_STIFFNESS = 1.6245e7, 1.041e7  # E A / L [N/m], fitted to tables 2.2 and 2.3
LONGERON_MASS, DIAGONAL_MASS = 0.12, 0.16  # [kg], fitted
BATTEN_INERTIA = 0.077  # about its center [kg m²], fitted
BATTEN_MASS = (TOTAL_MASS - 2 * BAYS * LONGERON_MASS - BAYS * DIAGONAL_MASS) / (BAYS + 1)  # [kg]

# The root table of FEM1: a rigid mass on springs to ground, connected to batten 0 (section 2.2.1). None of its values
# is printed; these four are the optimum of studies/root-table.yaml, a least-squares fit to the FEM1 column of table
# 2.2 that comes within 0.4 % of each of its five frequencies. Its rotary inertia is not free as well, since five
# parameters would fit five frequencies whatever they are: the table has the radius of gyration of a batten, 0.13 m.
# Any radius up to 0.3 m moves the mass by 4 % and the fit hardly.
TABLE_MASS = 59.076  # [kg]
_TABLE_SPRINGS = (
    Spring("B0", "x", 3.8690e7),
    Spring("B0", "y", 9.9229e6),
    Spring("B0", "rz", 3.0422e6),
)

Boundary = Literal["table", "fixed", "pinned"]


def barker_truss(
    boundary: Boundary = "pinned",
    bays: int = BAYS,
    *,
    longeron_area: float = TUBE_AREA,
    diagonal_area: float = TUBE_AREA,
    batten_mass: float = BATTEN_MASS,
) -> Truss:
    """The planar truss of section 2.2 with any number of bays.    [Barker1991] Sec. 2.2, Figs. 2.2, 2.3

    Parameters
    ----------
    boundary
        ``table`` is FEM1 (63 degrees of freedom on the flexible root table, whose mass rides on batten 0), ``fixed``
        FEM2 (fixed-free), ``pinned`` FEM3 (61 degrees of freedom, free to rotate about the hub).
    bays
        Number of square bays.
    longeron_area, diagonal_area
        Cross sections [m²].
    batten_mass
        Mass of one batten [kg]; its inertia scales with it.

    Raises
    ------
    ModelError
        For less than one bay or an unknown boundary.
    """
    if bays < 1:
        raise ModelError(f"bays: {bays} is below one; a truss needs at least one bay")
    if boundary not in ("table", "fixed", "pinned"):
        raise ModelError(f"boundary '{boundary}' does not exist; choose table, fixed or pinned")
    h = BAY_LENGTH / 2
    nodes: dict[str, tuple[float, ...]] = {}
    battens = []
    for i in range(bays + 1):
        nodes[f"N{i}a"] = (i * BAY_LENGTH, -h)
        nodes[f"N{i}b"] = (i * BAY_LENGTH, h)
        mass = batten_mass + (TABLE_MASS if boundary == "table" and i == 0 else 0.0)
        inertia = BATTEN_INERTIA * mass / BATTEN_MASS
        battens.append(Batten(f"B{i}", (f"N{i}a", f"N{i}b"), mass, inertia, bay=max(i, 1)))
    longeron = (LONGERON_STIFFNESS * BAY_LENGTH / TUBE_AREA, LONGERON_MASS / (TUBE_AREA * BAY_LENGTH))
    slant = BAY_LENGTH * 2**0.5
    diagonal = (DIAGONAL_STIFFNESS * slant / TUBE_AREA, DIAGONAL_MASS / (TUBE_AREA * slant))
    bars = []
    for i in range(1, bays + 1):
        for side in "ab":
            ends = (f"N{i - 1}{side}", f"N{i}{side}")
            bars.append(Bar(f"L{i}{side}", ends, longeron_area, *longeron, kind="longeron", bay=i))
        ends = (f"N{i - 1}a", f"N{i}b") if i % 2 else (f"N{i - 1}b", f"N{i}a")
        bars.append(Bar(f"D{i}", ends, diagonal_area, *diagonal, kind="diagonal", bay=i))
    held = {"table": (), "fixed": ("x", "y", "rz"), "pinned": ("x", "y")}[boundary]
    return Truss(
        nodes=nodes,
        bars=tuple(bars),
        battens=tuple(battens),
        springs=_TABLE_SPRINGS if boundary == "table" else (),
        supports={"B0": held} if held else {},
        ports={"hub": ("B0", "rz"), "tip": (f"B{bays}", "rz")},
    )
