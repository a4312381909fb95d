"""Nastran decks as trusses: fields and entries that are read, round trips, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from foreign_models import evaluated, metrics, native, study_text

from fosopt.errors import ModelError, StudyError
from fosopt.modes import modal_frame
from fosopt.structure import (
    Bar,
    Batten,
    PointMass,
    Spring,
    Structure,
    Truss,
    assemble,
    barker_truss,
    mass_matrix,
    stiffness_matrix,
    structural_mass,
    structure_inertia,
)
from fosopt.structure.imported import ModelUnits
from fosopt.structure.readers.bulk_data import read_bulk_data
from fosopt.structure.readers.bulk_writer import bulk_data
from fosopt.structure.readers.cards import read_cards
from fosopt.study import parse_study
from fosopt.study.runner import run_study

SI = ModelUnits(1.0, 1.0)
DIGITS = 1e-9  # large fields hold ten digits or more

# A tripod of two rods and a spring, in inches, pounds of force and pounds of weight: small, large and free fields.
DECK = """\
$ executive control is passed over
SOL 103
CEND
SPC = 2
BEGIN BULK
PARAM,WTMASS,2.590079-3
$23456781234567812345678123456781234567812345678
GRID          10             0.0     0.0     0.0
GRID*                 20                            10.0             0.0
*                   0.0
GRID,30,,10.,10.,0.
GRID,40,,10.,10.,0.
GRID,50,,12.,10.,0.
CROD           1       5      10      30
CROD,2,6,20,30
CONROD,3,40,50,7,.25
PROD           5       7     0.5             +P5
+P5
PROD           6       7     2.0                     .01
MAT1           7   1.0+7              .3      .1
RBE2           9      30  123456      40
CONM2*                11              30               0         38.609
*
*                   40.0                            40.0
*                                   80.0
CELAS2        12   1.5+3      50       2
CELAS1        13       8      50       3
PELAS          8   2.0+3
SPC1           2     123      10      20
SPC,1,10,1,0.0
SPC1,2,1345,30
SPC1,2,3,50
EIGRL          1
ENDDATA
GRID 99 is never read
"""
INCH = ModelUnits(0.0254, 4.4482216152605, 2.590079e-3)
PORTS = {"hub": ("30", "rz"), "tip": ("30", "rz")}


def deck(folder: Path, text: str = DECK) -> Path:
    """The deck in a file."""
    file = folder / "truss.bdf"
    file.write_text(text)
    return file


# ---- what is read ----


def test_fields_of_every_width_and_numbers_of_every_kind_are_read(tmp_path):
    lines = [
        "A              1       2     3.5   4.5-6  2.5D-3   -1.+5\n",
        "A*                     1               2             3.5           4.5-6\n"
        "*                 2.5D-3           -1.+5\n",
        "A,1,2,3.5,4.5-6,2.5D-3,-1.+5\n",
        "A*,1,2,3.5,4.5-6\n*,2.5D-3,-1.+5\n",
        "A\t1\t2\t3.5\t4.5-6\t2.5D-3\t-1.+5\n",
        "A,1,2,3.5 $ comment\n+,,,,\n",
    ]
    for line in lines[:5]:
        (card,) = read_cards(deck(tmp_path, line))
        assert (card.name, card.integer(1, ""), card.integer(2, "")) == ("A", 1, 2)
        assert [card.real(k, "") for k in range(3, 7)] == [3.5, 4.5e-6, 2.5e-3, -1e5]
    (card,) = read_cards(deck(tmp_path, lines[5]))
    assert card.real(3, "") == 3.5 and len(card.fields) == 16


def test_continuations_follow_their_card_whatever_their_mark(tmp_path):
    for mark in ("+", "+ABC", "*", "        ", ","):
        body = "\n".join(
            [
                "RBE2,1,2,123,4,5,6,7,8,+ABC" if mark in "+ABC" else "RBE2,1,2,123,4,5,6,7,8",
                f"{mark:<8}       9" if mark != "," else ",9",
            ]
        )
        (card,) = read_cards(deck(tmp_path, body + "\n"))
        assert [card.text(k) for k in (8, 9)] == ["8", "9"], mark


def test_a_deck_is_the_truss_an_engineer_would_write_down(tmp_path):
    truss = read_bulk_data(deck(tmp_path), INCH, PORTS)
    inch, pound = 0.0254, 4.4482216152605
    mass = 2.590079e-3 * pound / inch
    # It moves in a plane: grids 10 to 50 have z = 0 and are held there.
    assert truss.nodes["50"] == pytest.approx((12 * inch, 10 * inch))
    assert set(truss.nodes) == {"10", "20", "30_center", "40", "50"}
    assert truss.supports == {"10": ("x", "y"), "20": ("x", "y"), "30": ("x",)}
    first, second, third = truss.bars
    assert (first.nodes, first.kind) == (("10", "30_center"), "PROD 5")
    assert (third.nodes, third.kind) == (("40", "50"), "CONROD")
    assert [bar.area for bar in truss.bars] == pytest.approx([0.5 * inch**2, 2 * inch**2, 0.25 * inch**2])
    assert first.young == pytest.approx(1e7 * pound / inch**2)
    assert first.density == pytest.approx(0.1 * mass / inch**3)
    assert second.density == pytest.approx((0.1 + 0.01 / 2.0) * mass / inch**3)  # with mass per length
    (batten,) = truss.battens
    assert (batten.name, batten.nodes) == ("30", ("30_center", "40"))
    assert batten.mass == pytest.approx(38.609 * mass)
    assert batten.inertia == pytest.approx(80 * mass * inch**2)
    assert [(s.at, s.component) for s in truss.springs] == [("50", "y")]
    assert truss.springs[0].stiffness == pytest.approx(1.5e3 * pound / inch)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("GRID,50,,12.,10.,0.", "GRID,50,,12.,10.,1."),
        ("SPC1,2,1345,30", "SPC1,2,13,30"),
        ("SPC1,2,3,50", "SPC1,2,2,50"),
    ],
)
def test_a_model_that_is_not_held_to_a_plane_stays_in_space(tmp_path, old, new):
    assert old in DECK
    truss = read_bulk_data(deck(tmp_path, DECK.replace(old, new)), INCH, PORTS)
    assert {len(xyz) for xyz in truss.nodes.values()} == {3}
    assert np.size(truss.battens[0].inertia) == 3 and [s.component for s in truss.springs] == ["y", "z"]


def test_wtmass_makes_pounds_of_weight_to_kilograms():
    assert INCH.mass == pytest.approx(0.45359237, rel=1e-6, abs=0)


def matrices_of(structure: Structure) -> list[np.ndarray]:
    """Stiffness and mass."""
    return [
        np.asarray(stiffness_matrix(structure, structure.area)),
        np.asarray(mass_matrix(structure, structure.area, structure.batten_mass, 0.0)),
    ]


def tetrahedron() -> Truss:
    """A spatial truss with a batten, point masses, springs and names of its own."""
    nodes = {
        "foot a": (0.0, 0.0, 0.0),
        "foot b": (1.1, 0.0, 0.1),
        "foot c": (0.4, 0.9, 0.0),
        "p": (0.5, 0.3, 1.0),
        "q": (0.7, 0.3, 1.0),
        "r": (0.6, 0.5, 1.05),
    }
    ends = [(f, top) for f in ("foot a", "foot b", "foot c") for top in ("p", "q", "r")]
    bars = tuple(
        Bar(f"bar {k}", pair, 1e-5 * (k + 1), 7e10 if k % 2 else 1.1e11, 2700.0)
        for k, pair in enumerate(ends)
    )
    return Truss(
        nodes,
        bars,
        {"hub": ("mirror", "rx"), "tip": ("mirror", "rx"), "push": ("foot b", "z")},
        {"foot a": ("x", "y", "z"), "foot b": ("y",), "foot c": ("x", "y", "z")},
        (Batten("mirror", ("p", "q", "r"), 2.5, (0.02, 0.03, 0.04), (0.6, 0.35, 1.02)),),
        (PointMass("foot b", 0.7), PointMass("mirror", 0.2, 0.001)),
        (Spring("foot b", "x", 2e6), Spring("mirror", "rz", 30.0), Spring("foot b", "z", 3e5)),
    )


@pytest.mark.parametrize(
    "truss",
    [tetrahedron(), *(barker_truss(boundary, 3) for boundary in ("table", "fixed", "pinned"))],
    ids=["spatial", "table", "fixed", "pinned"],
)
def test_a_truss_written_and_read_has_the_same_matrices(tmp_path, truss):
    text = bulk_data(truss, title="round trip")
    numbers = {
        line.split("= ")[1]: line.split()[2] for line in text.splitlines() if line.startswith("$ grid")
    }
    ports = {name: (numbers[at], component) for name, (at, component) in truss.ports.items()}
    again = read_bulk_data(deck(tmp_path, text), SI, ports)
    first, second = assemble(truss, "tip"), assemble(again, "tip")
    assert [f"{numbers[name.rpartition('.')[0]]}.{name.rpartition('.')[2]}" for name in first.dofs] == list(
        second.dofs
    )
    for before, after in zip(matrices_of(first), matrices_of(second), strict=True):
        np.testing.assert_allclose(after, before, rtol=DIGITS, atol=DIGITS * np.abs(before).max())
    for quantity in (structural_mass, structure_inertia):
        values = [float(quantity(s, s.area, s.batten_mass)) for s in (first, second)]
        assert values[1] == pytest.approx(values[0], rel=DIGITS, abs=0)
    # What has been read once is numbered, and is written and read to the same truss but for rounding.
    third = read_bulk_data(deck(tmp_path, bulk_data(again)), SI, ports)
    assert third.nodes.keys() == again.nodes.keys() and [b.name for b in third.bars] == [
        b.name for b in again.bars
    ]
    assert third.supports == again.supports


def test_a_design_is_written_with_its_own_sizes_and_its_mirror(tmp_path):
    truss = tetrahedron()
    area = np.linspace(1e-5, 4e-5, 9)
    text = bulk_data(truss, area, np.array([5.0]), np.array([1e6, 10.0, 1e5]), mirror=("tip", 0.9))
    numbers = {
        line.split("= ")[1]: line.split()[2] for line in text.splitlines() if line.startswith("$ grid")
    }
    again = assemble(
        read_bulk_data(
            deck(tmp_path, text), SI, {"hub": (numbers["mirror"], "rx"), "tip": (numbers["mirror"], "rx")}
        ),
        "tip",
    )
    design = assemble(truss, "tip")
    frames = [
        modal_frame(design, area, np.array([5.0]), 0.9, "tip", np.array([1e6, 10.0, 1e5])),
        modal_frame(again, again.area, again.batten_mass, 0.0, "tip"),
    ]
    np.testing.assert_allclose(frames[1].eigenvalue, frames[0].eigenvalue, rtol=1e-8)
    with pytest.raises(ModelError, match="area: 2 values for 9 members"):
        bulk_data(truss, area[:2])


def test_no_line_of_a_deck_is_wider_than_its_fields():
    for truss in (tetrahedron(), barker_truss("table", 20)):
        for line in bulk_data(truss, title="x" * 200).splitlines():
            assert len(line) <= 72 or line.startswith(("$", "TITLE"))
            assert line.isascii()


def test_a_deck_runs_every_kind_of_study_its_areas_included(tmp_path):
    text = bulk_data(barker_truss("pinned", 3))
    numbers = {
        line.split("= ")[1]: line.split()[2] for line in text.splitlines() if line.startswith("$ grid")
    }
    deck(tmp_path, text)
    ports = f"{{hub: [{numbers['B0']}, rz], tip: [{numbers['B3']}, rz]}}"
    section = (
        f"structure: {{type: bulk_data, file: truss.bdf, units: {{length: m, mass: kg}}, ports: {ports}}}\n"
    )
    assert metrics(evaluated(study_text(section), tmp_path)) == pytest.approx(native(), rel=1e-8, abs=0)
    more = """\
variables: [{quantity: area, group_by: all, lower: 10 mm^2, upper: 200 mm^2}]
objectives: [{minimize: structural_mass}]
constraints: [{metric: first_elastic_frequency, lower: 20 Hz}]
"""
    study = parse_study(study_text(section, ("kind: analysis", "kind: codesign")) + more, tmp_path)
    run = run_study(study, tmp_path / "out")
    assert run["points"][1]["verified"]
    kept = (tmp_path / "out" / "study.yaml").read_text()
    assert "bulk_data" not in kept  # the run directory is complete without the deck
    parse_study(kept, tmp_path / "elsewhere")


# ---- what is refused ----


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("EIGRL          1", "INCLUDE 'more.bdf'", ":33: INCLUDE is not followed"),
        ("EIGRL          1", "CBAR,1,1,10,20", ":33: CBAR is not in the subset"),
        ("EIGRL          1", "MPC,1,10,1,1.0,20,1,-1.0", "MPC is not in the subset"),
        ("GRID,30,,10.,10.,0.", "GRID,10,,10.,10.,0.", "GRID 10 stands twice, first in line 8"),
        ("GRID,30,,10.,10.,0.", "GRID,30,4,10.,10.,0.", "GRID 30: coordinate system CP 4"),
        ("GRID,30,,10.,10.,0.", "GRID,30,,10.,10.,0.,4", "GRID 30: coordinate system CD 4"),
        ("GRID,30,,10.,10.,0.", "GRID,30,,ten,10.,0.", ":11: GRID: X1: 'ten' is no finite number"),
        ("GRID,30,,10.,10.,0.", "GRID,30,,NaN,10.,0.", "GRID: X1: 'NaN' is no finite number"),
        ("GRID,30,,10.,10.,0.", "GRID,-3,,1.,10.,0.", "its number is not above zero"),
        ("CROD,2,6,20,30", "CROD,2,6,20,31", "CROD 2: grid 31 does not exist"),
        ("CROD,2,6,20,30", "CROD,2,4,20,30", "CROD 2: property 4 does not exist"),
        ("CROD,2,6,20,30", "CROD,1,6,20,30", "CROD 1 stands twice"),
        ("CONROD,3,40,50,7,.25", "CONROD,3,40,50,8,.25", "CONROD 3: material 8 does not exist"),
        ("CONROD,3,40,50,7,.25", "CONROD,3,40,50,7,0.", "CONROD 3: area 0 is not above zero"),
        ("CONROD,3,40,50,7,.25", "CONROD,3,40,50,7,.25,.1", "CONROD 3: J .1: rods are pin-ended"),
        ("   1.0+7              .3      .1", "  -1.0+7              .3      .1", "MAT1 7: E -1e+07"),
        ("   1.0+7              .3      .1", "   1.0+7              .3     -.1", "RHO not negative"),
        ("   1.0+7              .3      .1", "   1.0+7              .3", "PROD 5: the rod has no mass"),
        ("         38.609", "        -38.609", "CONM2 11: negative mass: M -38.609"),
        (
            "*                                   80.0",
            "*                    0.5              80.0",
            "is 0.5; give the mass at its grid",
        ),
        (
            "RBE2           9      30  123456      40",
            "RBE2           9      30      12      40",
            "leave translations free",
        ),
        (
            "RBE2           9      30  123456      40",
            "RBE2           9      30  123456      40      50",
            "grid 50 depends on RBE2 grid 30",
        ),
        (
            "RBE2           9      30  123456      40",
            "RBE2,9,30,123456,40,THRU,50",
            "THRU in a list of grids",
        ),
        (
            "CONM2*                11              30 ",
            "CONM2*                11              10 ",
            "inertia at grid 10",
        ),
        (
            "CONM2*                11              30 ",
            "CONM2*                11              40 ",
            "grid 40 depends on RBE2 grid 30",
        ),
        (
            "CELAS2        12   1.5+3      50       2",
            "CELAS2        12   1.5+3      50       2      10       2",
            "a spring between two grids",
        ),
        (
            "CELAS2        12   1.5+3      50       2",
            "CELAS2        12   1.5+3      50       6",
            "component 6 of grid 50",
        ),
        (
            "CELAS2        12   1.5+3      50       2",
            "CELAS2        12  -1.5+3      50       2",
            "stiffness -1500 is negative",
        ),
        ("PELAS          8   2.0+3", "PELAS          9   2.0+3", "CELAS1 13: property 8 does not exist"),
        ("SPC1,2,1345,30", "SPC1,2,1347,30", "components '1347' are none of 1 to 6"),
        ("SPC1,2,1345,30", "SPC1,2,1345,40", "grid 40 depends on RBE2 grid 30; hold that one"),
        ("SPC,1,10,1,0.0", "SPC,2,10,1,0.1", "an enforced motion 0.1"),
        ("SPC = 2\n", "", "2 sets of supports (1, 2); choose one with SPC ="),
        ("SPC = 2\n", "SPC = 3\n", "2 sets of supports (1, 2); choose one with SPC ="),
        ("GRID,40,,10.,10.,0.", "GRID,40,,10.,10.,0.,0,,0,0,0,0", "12 fields in a line"),
        ("BEGIN BULK\n", "BEGIN BULK\n+       1\n", ":6: a continuation without a card before it"),
    ],
)
def test_entries_that_mean_nothing_to_a_truss_are_refused_with_their_line(tmp_path, old, new, message):
    assert old in DECK
    with pytest.raises(StudyError) as caught:
        read_bulk_data(deck(tmp_path, DECK.replace(old, new, 1)), INCH, PORTS)
    assert message in str(caught.value)
    assert f"{tmp_path / 'truss.bdf'}:" in str(caught.value)


def test_files_that_are_no_deck_are_refused(tmp_path):
    for content, message in (
        (b"SOL 103\nCEND\nBEGIN BULK\n", "0 grids and 0 rods are no truss"),
        (b"GRID\0", "is binary"),
        (b"", "is empty"),
    ):
        file = tmp_path / "truss.bdf"
        file.write_bytes(content)
        with pytest.raises(StudyError, match=message):
            read_bulk_data(file, SI, PORTS)


def test_a_body_without_mass_is_refused_by_its_grid(tmp_path):
    start = DECK.index("CONM2*")
    text = DECK[:start] + DECK[DECK.index("CELAS2 ") :]
    with pytest.raises(
        StudyError, match="RBE2 9: no mass or no inertia at its independent grid 30; add a CONM2"
    ):
        read_bulk_data(deck(tmp_path, text), INCH, PORTS)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("units: {length: in, force: lbf}, ", "", "the key 'units' is required"),
        ("force: lbf", "force: lbf, wtmass: 0.01", "PARAM WTMASS is 0.00259008 and the study's wtmass 0.01"),
        ("truss.bdf", "none.bdf", "none.bdf: no such file"),
        ("hub: [30, rz]", "hub: [31, rz]", "unknown node or batten '31'"),
        ("tip: [30, rz]", "tip: [50, rz]", "the pin-ended node '50' has no rotation"),
    ],
)
def test_a_section_that_does_not_fit_its_deck_is_refused_with_its_place(tmp_path, old, new, message):
    deck(tmp_path)
    section = (
        "structure: {type: bulk_data, file: truss.bdf, units: {length: in, force: lbf}, "
        "ports: {hub: [30, rz], tip: [30, rz]}}\n"
    )
    assert old in section
    (batten,) = parse_study(study_text(section), tmp_path).structure.battens
    assert batten.mass == pytest.approx(38.609 * 0.45359237, rel=1e-6, abs=0)  # by the deck's own WTMASS
    with pytest.raises(StudyError) as caught:
        parse_study(study_text(section.replace(old, new)), tmp_path)
    assert message in str(caught.value) and "study.yaml:4" in str(caught.value)
