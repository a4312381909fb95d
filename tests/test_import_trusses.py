"""Trusses from tables of nodes and members, and a mirror of two axes on one of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from foreign_models import REST
from scipy import linalg
from small_studies import STUDIES

from fosopt.errors import StudyError
from fosopt.modes import Damping, Hub, ModalSet
from fosopt.modes.axes import axis_coupling, axis_difference
from fosopt.structure.readers.truss_tables import read_bars, read_nodes
from fosopt.study import load_study, parse_study
from fosopt.study.build import build_problem, start_vector

NODES = "# feet first\nnode,x [mm],y [m]\na,0,0\nb,1000,0\nc,500,0.8\nd,500,1.2\n"
BARS = """\
start,end,area [mm^2],young [GPa],density [kg/m^3],kind,name
a,c,50,70,2700,leg,left
b,c,50,70,2700,leg,right
a,d,60,70,2700,leg,

b,d,60,70,2700,,
"""
STUDY = f"""\
fosopt: 1
name: Table
kind: analysis
structure:
  type: truss
  nodes: nodes.csv
  bars: bars.csv
  battens: [{{name: top, nodes: [c, d], mass: 3 kg, inertia: 0.4 kg m^2}}]
  supports: {{a: [x, y], b: [x, y]}}
  ports: {{hub: [top, rz], tip: [top, rz]}}
{REST}"""


def tables(folder: Path, nodes: str = NODES, bars: str = BARS) -> Path:
    """Files of nodes and bars."""
    (folder / "nodes.csv").write_text(nodes)
    (folder / "bars.csv").write_text(bars)
    return folder


def fixed(text: str) -> str:
    """The study without an attitude loop, as its truss stands on its feet."""
    return text.replace("hub: {type: held, bandwidth: 0.1 Hz, damping_ratio: 0.7}\n", "")


def test_tables_are_the_truss_they_describe(tmp_path):
    study = parse_study(fixed(STUDY), tables(tmp_path))
    nodes = {"a": (0.0, 0.0), "b": (1.0, 0.0), "c": (0.5, 0.8), "d": (0.5, 1.2)}
    assert study.structure.nodes == nodes
    first, _, third, fourth = study.structure.bars
    assert (first.name, first.nodes, first.kind) == ("left", ("a", "c"), "leg")
    assert (third.name, fourth.kind) == ("a-d", "bar")
    assert (first.area, first.young, first.density) == pytest.approx((50e-6, 70e9, 2700.0), rel=1e-14, abs=0)
    inline = fixed(STUDY).replace(
        "nodes: nodes.csv", f"nodes: {{{', '.join(f'{k}: [{x}, {y}]' for k, (x, y) in nodes.items())}}}"
    )
    assert parse_study(inline, tmp_path).structure.nodes == nodes
    assert build_problem(study).system.structure.dofs == ("top.x", "top.y", "top.rz")


@pytest.mark.parametrize(
    ("which", "old", "new", "message"),
    [
        (0, "x [mm]", "x", ":2:2: the column 'x' is left without a unit; write 'x [m]'"),
        (0, "x [mm]", "x [kg]", ":2:2: 'kg' is no unit of 'x'"),
        (0, "x [mm]", "u [mm]", ":2:2: unknown column 'u [mm]'"),
        (0, ",y [m]", "", "the column 'y' is missing; add 'y [m]'"),
        (0, "a,0,0", "a,0,nan", ":3: y: 'nan' is no finite number"),
        (0, "b,1000,0", "a,1000,0", ":4: the node 'a' stands twice"),
        (0, "b,1000,0", ",1000,0", ":4: a node without a name"),
        (1, "area [mm^2]", "area", "the column 'area' is left without a unit; write 'area [m^2]'"),
        (1, "kind", "kind [m]", "the column 'kind' has no unit"),
        (1, "a,c,50", "a,c,-50", ":2: area '-50' is not above zero"),
        (1, "a,c,50,70,2700", "a,c,50,70,0", ":2: density '0' is not above zero"),
        (1, "a,c,50", "a,,50", ":2: an end without a name"),
        (1, "a,c,50", "a,e,50", "unknown node 'e'"),
        (1, "a,c,50,", "a,c,", ":2: 6 values where the header names 7"),
        (1, "density [kg/m^3]", "bay", "the column 'density' is missing; add 'density [kg/m^3]'"),
        (1, "left", "right", "the bar 'right' stands twice"),
    ],
)
def test_a_broken_table_is_refused_with_its_line(tmp_path, which, old, new, message):
    texts = [NODES, BARS]
    assert old in texts[which]
    texts[which] = texts[which].replace(old, new, 1)
    with pytest.raises(StudyError) as caught:
        parse_study(fixed(STUDY), tables(tmp_path, *texts))
    assert message in str(caught.value)


def test_a_table_that_is_missing_or_empty_is_refused(tmp_path):
    with pytest.raises(StudyError, match=r"study.yaml:5:3: structure: .*nodes.csv: no such file"):
        parse_study(fixed(STUDY), tmp_path)
    for read, text in ((read_nodes, "node,x [m],y [m]\n"), (read_bars, BARS.splitlines()[0])):
        (tmp_path / "t.csv").write_text(text)
        with pytest.raises(StudyError, match="0 rows; give 1 to"):
            read(tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("# nothing\n")
    with pytest.raises(StudyError, match="no header"):
        read_nodes(tmp_path / "t.csv")


# ---- two axes ----


@pytest.fixture(scope="module")
def tripod():
    """The shipped tripod, its problem and its start."""
    study = load_study(STUDIES / "tripod.yaml")
    problem = build_problem(study)
    return study, problem, start_vector(study, problem)


def port_modes(problem, x) -> ModalSet:
    """Modes at the ports of both axes."""
    frame = problem.evaluate(x).frame
    return frame.modal_set(Hub("free"), Damping((0.003,)), ("hub", "tip", "hub_y", "tip_y"))


def test_receptances_between_the_axes_of_the_tripod_vanish_and_those_of_each_are_alike(tripod):
    """Against the dynamic stiffness itself, solved at three frequencies, without modes."""
    _, problem, x = tripod
    structure, design = problem.system.structure, problem.design(x)
    from fosopt.structure import mass_matrix, stiffness_matrix

    k = np.asarray(stiffness_matrix(structure, design.area))
    m = np.asarray(mass_matrix(structure, design.area, design.batten_mass, design.mirror_mass))
    rows = np.array([structure.port(name) for name in ("hub", "tip", "hub_y", "tip_y")])
    for frequency in (5.0, 60.0, 140.0):
        g = rows @ linalg.solve(k - (2 * np.pi * frequency) ** 2 * m, rows.T)
        own = np.abs(g[:2, :2]).max()
        # Tables of the tripod hold nanometers, and its legs are a third of a turn apart to that.
        np.testing.assert_allclose(g[:2, 2:], 0, atol=1e-7 * own)
        np.testing.assert_allclose(g[2:, 2:], g[:2, :2], atol=1e-7 * own)


def test_modal_constants_say_the_same(tripod):
    _, problem, x = tripod
    modes = port_modes(problem, x)
    assert axis_coupling(modes, "tip", "tip_y") < 1e-6
    assert axis_coupling(modes, "hub", "tip_y") < 1e-6
    assert axis_difference(modes, ("tip", "tip"), ("tip_y", "tip_y")) < 1e-6
    assert axis_difference(modes, ("hub", "tip"), ("hub_y", "tip_y")) < 1e-6
    assert axis_coupling(modes, "tip", "tip") == pytest.approx(1.0, rel=1e-12, abs=0)


def test_coupling_is_the_largest_shared_modal_constant_of_an_eigenspace():
    shapes = np.array([[2.0, 0.0], [0.0, 3.0], [1.0, 1.0], [1.0, -1.0], [1.0, 0.5]])
    frequency = np.array([1.0, 2.0, 3.0, 3.0, 4.0])
    modes = ModalSet(frequency, np.zeros(5), shapes, ("a", "b"), np.zeros(5, bool))
    # The pair at 3 rad/s shares nothing; the last mode shares 0.5 of the largest own constants 4 and 9.
    assert axis_coupling(modes, "a", "b") == pytest.approx(0.5 / 6, rel=1e-12, abs=0)
    assert axis_difference(modes, ("a", "a"), ("b", "b")) == pytest.approx(9 / 4, rel=1e-12, abs=0)


def test_the_loop_about_the_other_axis_has_the_same_metrics(tripod):
    study, problem, x = tripod
    from fosopt.study import dump_study

    text = dump_study(study).replace("other_axis: {port: tip_y, hub: hub_y}", "")
    turned = text.replace("hub: [cell, rx]", "hub: [cell, ry]").replace(
        "tip: [secondary, rx]", "tip: [secondary, ry]"
    )
    assert turned != text
    other = parse_study(turned)
    found, again = (
        problem.evaluate(x),
        build_problem(other).evaluate(start_vector(other, build_problem(other))),
    )
    for name in ("jitter_total", "modulus_margin", "first_elastic_frequency", "spectral_abscissa"):
        assert again.value(name) == pytest.approx(found.value(name), rel=1e-6, abs=0), name


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("port: tip_y, hub: hub_y", "port: tip", "the axes couple: 'tip' and 'tip' share modes with 1 of"),
        ("hub: hub_y}", "hub: tip_y}", "the axes differ: 'tip_y' has modal constants"),
        ("inertia: [0.02, 0.02, 0.03]", "inertia: [0.02, 0.025, 0.03]", "the axes differ: 'tip_y'"),
        ("group_by: kind", "group_by: member", "the axes couple"),
        ("stiffness: 4000000.0, name: cell.ry", "stiffness: 5000000.0, name: cell.ry", "the axes"),
        (
            "port: tip_y, hub: hub_y",
            "port: tipy, hub: hub_y",
            "port 'tipy' does not exist; did you mean 'tip_y'?",
        ),
    ],
)
def test_axes_that_couple_or_differ_are_refused(tripod, old, new, message):
    from fosopt.study import dump_study

    text = dump_study(tripod[0])
    if "stiffness" in old and old not in text:
        old, new = "component: ry, stiffness: 4000000.0", "component: ry, stiffness: 5000000.0"
    assert old in text, text[-1500:]
    with pytest.raises(StudyError) as caught:
        build_problem(parse_study(text.replace(old, new)))
    assert message in str(caught.value) and "mirror.other_axis" in str(caught.value)


def test_a_tripod_of_handed_legs_couples_its_hub_to_the_other_axis(tmp_path):
    """A third of a turn leaves the mirror's axes apart, but torque about one axis of the hub reaches the other."""
    lines = (STUDIES / "tripod-members.csv").read_text().splitlines()

    def handed(line: str) -> bool:
        if "diagonal" not in line:
            return True
        start, end, *_ = line.split(",")
        return ("uvw".index(end[-1]) - "uvw".index(start[-1])) % 3 == 1

    (tmp_path / "bars.csv").write_text("\n".join(line for line in lines if handed(line)) + "\n")
    text = (STUDIES / "tripod.yaml").read_text()
    text = text.replace("tripod-nodes.csv", str(STUDIES / "tripod-nodes.csv")).replace(
        "tripod-members.csv", "bars.csv"
    )
    with pytest.raises(StudyError, match="the axes couple: 'hub_y' and 'tip' share modes"):
        build_problem(parse_study(text, tmp_path))
    build_problem(parse_study(text.replace("{port: tip_y, hub: hub_y}", "{port: tip_y}"), tmp_path))
