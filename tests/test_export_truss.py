"""The truss of a design for other programs: tables with its sizes, a deck that reads back, inert text."""

from __future__ import annotations

import csv
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fosopt.export.truss import DesignedTruss, ExportError, write_deck, write_members
from fosopt.structure import (
    Bar,
    Batten,
    Chain,
    Truss,
    assemble,
    assemble_chain,
    barker_truss,
    mass_matrix,
    stiffness_matrix,
    structural_mass,
)
from fosopt.structure.imported import ModelUnits
from fosopt.structure.readers.bulk_data import read_bulk_data


def designed(structure=None, **changes) -> DesignedTruss:
    """The dissertation's truss on three bays with sizes of its own."""
    structure = structure or assemble(barker_truss("fixed", 3), "tip")
    truss = structure.truss
    area = 1e-5 * (1 + np.arange(len(truss.bars)))
    batten_mass = 1.0 + np.arange(len(truss.battens))
    return replace(
        DesignedTruss(structure, area, batten_mass, structure.spring_stiffness, "tip", 2.5), **changes
    )


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_members_have_the_sizes_of_the_design(tmp_path):
    design = designed()
    paths = write_members(design, "seed 1", tmp_path / "a-members.csv")
    assert [path.name for path in paths] == ["a-members.csv", "a-nodes.csv", "a-battens.csv"]
    bars, nodes, battens = map(rows_of, paths)
    places = {row["name"]: [float(row[f"{axis}_m"]) for axis in "xyz"] for row in nodes}
    assert len(bars) == len(design.structure.truss.bars)
    for row, area in zip(bars, design.area, strict=True):
        length = float(row["length_m"])
        assert [float(row[f"start_{axis}_m"]) for axis in "xyz"] == places[row["start"]]
        assert [float(row[f"end_{axis}_m"]) for axis in "xyz"] == places[row["end"]]
        assert length == pytest.approx(np.linalg.norm(np.subtract(places[row["end"]], places[row["start"]])))
        assert float(row["area_m2"]) == area
        mass = float(row["density_kg_per_m3"]) * area * length
        assert float(row["mass_kg"]) == pytest.approx(mass, rel=1e-14)
        stiffness = float(row["young_pa"]) * area / length
        assert float(row["axial_stiffness_n_per_m"]) == pytest.approx(stiffness, rel=1e-14)
    whole = sum(float(row["mass_kg"]) for row in (*bars, *battens))
    assert whole == pytest.approx(
        structural_mass(design.structure, design.area, design.batten_mass), rel=1e-14
    )
    for row, batten, mass in zip(battens, design.structure.truss.battens, design.batten_mass, strict=True):
        assert float(row["inertia_z_kg_m2"]) == pytest.approx(batten.inertia * mass / batten.mass, rel=1e-15)
        assert row["inertia_x_kg_m2"] == row["inertia_y_kg_m2"] == ""
        assert row["nodes"].split() == list(batten.nodes)
        assert {row["batten"] for row in nodes if row["name"] in batten.nodes} == {batten.name}
        middle = np.mean([places[node] for node in batten.nodes], axis=0)
        assert [float(row[f"{axis}_m"]) for axis in "xyz"] == pytest.approx(middle.tolist())
    assert [row["held"] for row in battens] == ["x y rz", "", "", ""]
    assert [row["ports"] for row in battens] == ["hub", "", "", "tip"]
    assert {row["provenance"] for row in (*bars, *nodes, *battens)} == {"seed 1"}


def spatial(*names: str) -> Truss:
    """A mast on three legs; its nodes, bars and a batten have these names."""
    a, b, c, top, bar, body = names
    nodes = {a: (1.0, 0.0, 0.0), b: (0.0, 1.0, 0.0), c: (0.0, 0.0, 0.0), top: (0.3, 0.3, 1.0)}
    bars = tuple(Bar(f"{bar}{k}", (node, top), 1e-4, 70e9, 2700.0) for k, node in enumerate((a, b, c)))
    held = ("x", "y", "z", "rx", "ry", "rz")
    center = (0.1, 0.2, 0.3)
    batten = Batten(body, (a, b, c), 2.0, (0.1, 0.2, 0.3), center)
    return Truss(nodes, bars, {"hub": (body, "rz"), "tip": (top, "x")}, {body: held}, (batten,))


def test_a_batten_in_space_has_three_inertias_and_its_own_center(tmp_path):
    design = designed(assemble(spatial("a", "b", "c", "d", "L", "base"), "tip"), batten_mass=np.array([4.0]))
    (row,) = rows_of(write_members(design, "", tmp_path / "m.csv")[2])
    assert [float(row[f"inertia_{axis}_kg_m2"]) for axis in "xyz"] == [0.2, 0.4, 0.6]
    assert [float(row[f"{axis}_m"]) for axis in "xyz"] == [0.1, 0.2, 0.3]


def test_hostile_names_are_inert_in_tables_and_comments(tmp_path):
    hostile = ("=1+1", "@SUM(A1)", "-2", "+3\nENDDATA", "=bar", '=cmd|"/c calc"!A1')
    design = designed(assemble(spatial(*hostile), "tip"), batten_mass=np.array([4.0]))
    for path in write_members(design, "=origin", tmp_path / "m.csv"):
        for row in rows_of(path):
            assert not any(
                cell.startswith(("=", "@", "+")) or (cell.startswith("-") and not _number(cell))
                for cell in row.values()
            )
    title = "=evil\nENDDATA\nINCLUDE 'x'\r\u2028µ" + "x" * 41 + ", more"
    write_deck(design, title, {"note": "a\nGRID,1\nb " + "long " * 40}, tmp_path / "m.bdf")
    lines = (tmp_path / "m.bdf").read_bytes().decode("ascii").splitlines()
    assert lines.count("ENDDATA") == 1 and lines[-1] == "ENDDATA"
    assert not any(line.startswith(("INCLUDE", "GRID,")) for line in lines)
    assert max(map(len, lines)) <= 80
    (title_line,) = (line for line in lines if line.startswith("TITLE"))
    assert title_line.startswith("TITLE = =evil ENDDATA INCLUDE 'x' ?xx")
    # A comma at the end of a line of case control continues it.
    write_deck(design, "x" * 59 + ", more", {}, tmp_path / "n.bdf")
    assert f"TITLE = {'x' * 59}\n" in (tmp_path / "n.bdf").read_text(encoding="ascii")


def _number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def test_the_deck_reads_back_as_the_design(tmp_path):
    design = designed()
    write_deck(design, "three bays", {"study": "abc"}, tmp_path / "m.bdf")
    text = (tmp_path / "m.bdf").read_text(encoding="ascii")
    assert (
        "$ design: three bays" in text and "$ study: abc" in text and "$ units: lengths m, masses kg" in text
    )
    numbers = {
        name: number
        for _, kind, number, _, name in (
            line.split() for line in text.splitlines() if " = " in line and "$ " in line
        )
        if kind == "grid"
    }
    bodies = [batten.name for batten in design.structure.truss.battens]
    ports = {"hub": (numbers[bodies[0]], "rz"), "tip": (numbers[bodies[-1]], "rz")}
    again = assemble(read_bulk_data(tmp_path / "m.bdf", ModelUnits(1.0, 1.0), ports), "tip")
    own = design.structure
    digits = 1e-9  # large fields hold ten digits or more
    stiffness = stiffness_matrix(own, design.area)
    np.testing.assert_allclose(
        stiffness_matrix(again, again.area), stiffness, atol=digits * np.abs(stiffness).max()
    )
    # The deck has the mirror's mass on a body already.
    mass = mass_matrix(own, design.area, design.batten_mass, design.mirror_mass)
    found = mass_matrix(again, again.area, again.batten_mass, 0.0)
    np.testing.assert_allclose(found, mass, atol=digits * np.abs(mass).max())


def test_a_structure_without_members_is_refused():
    chain = assemble_chain(Chain({"hub": 50.0, "tip": 20.0}, (1e6,), False), "tip")
    with pytest.raises(ExportError, match=r"no members: .* export its plant"):
        designed(chain)


def test_all_tables_of_a_truss_are_new_or_none_is(tmp_path):
    (tmp_path / "m.csv").write_text("old")
    (tmp_path / "m-battens.csv").mkdir()
    with pytest.raises(ExportError, match=r"m-battens\.csv: cannot be written"):
        write_members(designed(), "", tmp_path / "m.csv")
    assert (tmp_path / "m.csv").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["m-battens.csv", "m.csv"]


def test_a_link_is_followed_and_a_pipe_is_left_alone(tmp_path):
    os.symlink("target.bdf", tmp_path / "link.bdf")
    write_deck(designed(), "", {}, tmp_path / "link.bdf")
    assert (tmp_path / "link.bdf").is_symlink() and (tmp_path / "target.bdf").is_file()
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ExportError, match="is a device or a pipe"):
        write_deck(designed(), "", {}, tmp_path / "pipe")
    assert (tmp_path / "pipe").is_fifo()
