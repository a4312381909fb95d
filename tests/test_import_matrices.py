"""Structures known by stiffness and mass matrices: every format, every refusal, and large models that are truncated."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_models import DATA, MM, evaluated, imported, matrices, metrics, native, study_text, truss
from scipy import io, linalg, sparse

from fosopt.errors import ModelError, StudyError
from fosopt.modes import Damping, Hub, modal_frame
from fosopt.structure import assemble, barker_truss, mass_matrix, stiffness_matrix
from fosopt.structure.imported import ModelUnits, assemble_modes
from fosopt.structure.imported_matrices import ForeignMatrices, matrices_in_si, modes_of
from fosopt.structure.readers.dmig import read_dmig
from fosopt.structure.readers.matrices import read_dofs, read_matrix
from fosopt.structure.readers.op4 import read_op4

ROUNDING = 1e-8
OP4 = sorted(DATA.glob("*.op4"))
GRIDS = {"B0": "101", "B1": "102", "B2": "103", "B3": "104"}


def write_dofs(folder: Path, names: tuple[str, ...] | None = None) -> None:
    """The list of degrees of freedom of the truss."""
    rows = [name.replace(".", ",") for name in names or truss().dofs]
    (folder / "dofs.csv").write_text("grid,component\n" + "\n".join(rows) + "\n")


def write_matrices(folder: Path, kind: str) -> str:
    """Files of a format; returns the keys that name them."""
    k, m = matrices()
    write_dofs(folder)
    match kind:
        case "mtx":
            io.mmwrite(folder / "k.mtx", sparse.coo_array(k), precision=17, symmetry="symmetric")
            io.mmwrite(folder / "m.mtx", m, precision=17)
            return "stiffness: k.mtx, mass: m.mtx"
        case "mat":
            io.savemat(folder / "km.mat", {"K": k, "M": sparse.csc_array(m), "note": "text"})
            return "stiffness: {file: km.mat, matrix: K}, mass: {file: km.mat, matrix: M}"
        case "npz":
            sparse.save_npz(folder / "k.npz", sparse.csc_array(k))
            np.savez(folder / "m.npz", mass=m)
            return "stiffness: k.npz, mass: m.npz"
    raise AssertionError(kind)


@pytest.mark.parametrize("kind", ["mtx", "mat", "npz"])
def test_matrices_give_the_metrics_of_the_structure_they_came_from(tmp_path, kind):
    section = imported(f"type: matrices, {write_matrices(tmp_path, kind)}, dofs: dofs.csv")
    assert metrics(evaluated(study_text(section), tmp_path)) == pytest.approx(native(), rel=ROUNDING, abs=0)


@pytest.mark.parametrize("file", OP4, ids=lambda file: file.stem)
def test_every_form_of_output4_that_another_program_writes_is_read_to_the_last_bit(file):
    """Written by pyYeti 1.4.7: text and binary, either byte order, dense and both sparse forms."""
    found = read_op4(file)
    assert list(found) == ["KAA", "MAA"]
    for matrix, expected in zip(found.values(), matrices(), strict=True):
        np.testing.assert_array_equal(matrix.toarray(), np.array(expected))


def test_there_is_a_file_of_each_form_of_output4():
    assert len(OP4) == 9


def test_output4_matrices_run_a_study(tmp_path):
    write_dofs(tmp_path)
    keys = ", ".join(
        f"{what}: {{file: {DATA / 'pyyeti_big_nonbigmat.op4'}, matrix: {name}}}"
        for what, name in (("stiffness", "KAA"), ("mass", "maa"))
    )
    section = imported(f"type: matrices, {keys}, dofs: dofs.csv")
    assert metrics(evaluated(study_text(section), tmp_path)) == pytest.approx(native(), rel=ROUNDING, abs=0)


def test_punched_dmig_names_its_own_degrees_of_freedom():
    """Written by pyYeti 1.4.7 with ten digits; its grids are 101 to 104."""
    file = DATA / "pyyeti_dmig.pch"
    k, dofs = read_dmig(file)["KAAX"]
    assert dofs == tuple(f"{GRIDS[name[:2]]}{name[2:]}" for name in truss().dofs)
    np.testing.assert_allclose(k.toarray(), matrices()[0], rtol=1e-9, atol=1e-9 * np.abs(matrices()[0]).max())
    keys = ", ".join(
        f"{what}: {{file: {file}, matrix: {name}}}"
        for what, name in (("stiffness", "KAAX"), ("mass", "MAAX"))
    )
    section = imported(f"type: matrices, {keys}, rigid_below: 0.1 Hz", "{hub: [101, rz], tip: [104, rz]}")
    # The mass matrix has ten digits, and pairs of terms of it cancel in the modes of a chain of stiff bays.
    assert metrics(evaluated(study_text(section), Path())) == pytest.approx(native(), rel=1e-6, abs=0)


# ---- hand-built output4 files ----


def fortran(order: str, *bodies: bytes) -> bytes:
    """Records between their lengths."""
    return b"".join(struct.pack(f"{order}i", len(b)) + b + struct.pack(f"{order}i", len(b)) for b in bodies)


def test_output4_of_64_bit_words_and_single_precision_is_read(tmp_path):
    wide = fortran(
        "<",
        struct.pack("<4q", 2, 2, 6, 2) + b"KAA             ",
        struct.pack("<3q2d", 1, 1, 2, 4.0, -1.0),
        struct.pack("<3q2d", 2, 1, 2, -1.0, 3.0),
        struct.pack("<3qd", 3, 1, 1, 0.0),
    )
    single = fortran(
        ">",
        struct.pack(">4i", 2, 2, 6, 1) + b"KAA     ",
        struct.pack(">3i2f", 1, 1, 2, 4.0, -1.0),
        # A string of length 1 at row 2 of a sparse column: 65536 (1 + 1) + 2.
        struct.pack(">3iif", 2, 0, 2, 65536 * 2 + 2, 3.0),
        struct.pack(">3if", 3, 1, 1, 0.0),
    )
    # What is single precision in 32-bit words is double in 64-bit ones.
    one = wide.replace(struct.pack("<4q", 2, 2, 6, 2), struct.pack("<4q", 2, 2, 6, 1))
    assert one != wide
    for content, expected in (
        (wide, [[4, -1], [-1, 3]]),
        (one, [[4, -1], [-1, 3]]),
        (single, [[4, 0], [-1, 3]]),
    ):
        (tmp_path / "a.op4").write_bytes(content)
        np.testing.assert_array_equal(read_op4(tmp_path / "a.op4")["KAA"].toarray(), expected)


def odd_op4(first: int, *rest: int) -> bytes:
    """A 2 x 2 matrix of doubles with a column of three words."""
    body = struct.pack(f"<{3 + len(rest)}i", 1, first, 3 + len(rest), *rest) + bytes(12)
    return fortran("<", struct.pack("<4i", 2, 2, 6, 2) + b"KAA     ", body)


def small_op4(kind: int = 2, value: float = 3.0, words: int = 4, column: int = 2, row: int = 1) -> bytes:
    """A 2 x 2 matrix in 32-bit words, with one thing wrong as asked for."""
    return fortran(
        "<",
        struct.pack("<4i", 2, 2, 6, kind) + b"KAA     ",
        struct.pack("<3i2d", 1, 1, 4, 4.0, -1.0),
        struct.pack("<3i2d", column, row, words, -1.0, value),
        struct.pack("<3id", 3, 1, 2, 0.0),
    )


def test_a_broken_binary_output4_file_is_refused_with_its_record(tmp_path):
    good = small_op4()
    damaged = bytearray(good)
    damaged[32 + 4 + 28] = 99  # the length at the end of record 2
    cases = [
        (good[:50], "record 2: 28 bytes announced and 14 left; the file is truncated"),
        (good[: 32 + 36], "the file ends within KAA, after record 2: truncated"),
        (bytes(damaged), "record 2: length 28 at its start and"),
        (small_op4(kind=4), "record 1: KAA is complex"),
        (small_op4(kind=7), "record 1: KAA has the type 7"),
        (small_op4(value=np.nan), "record 3: KAA(2, 2) is not finite"),
        (small_op4(words=6), "record 3: wrong record length, 28 bytes where column 2 of KAA announces 36"),
        (small_op4(row=2), "record 3: rows 2 to 3 of column 2 leave the 2 x 2 matrix KAA"),
        (small_op4(row=0), "does not fit column 2 of KAA"),
        (good + good[:20], "record 5: 24 bytes announced and 16 left"),
        (odd_op4(1), "record 2: 3 words are no whole number of values of KAA"),
        (odd_op4(0, 65536 * 4 + 1), "record 2: a string of 3 words does not fit column 1 of KAA"),
        (b"\0" * 40, "no OUTPUT4 file"),
        (b"", "the file is empty"),
    ]
    for content, message in cases:
        (tmp_path / "a.op4").write_bytes(content)
        with pytest.raises(StudyError) as caught:
            read_op4(tmp_path / "a.op4")
        assert message in str(caught.value) and "a.op4" in str(caught.value)


@pytest.mark.parametrize("form", ["dense", "bigmat", "nonbigmat"])
def test_a_broken_text_output4_file_is_refused_with_its_line(tmp_path, form):
    text = (DATA / f"pyyeti_text_{form}.op4").read_text()
    lines = text.splitlines(keepends=True)
    cases = [
        ("".join(lines[:5]), "the file ends within KAA: truncated"),
        (text[: len("".join(lines[:6])) + 20], "truncated"),
        (text.replace("       2KAA", "       4KAA"), ":1: header: KAA is complex"),
        (text.replace("      10", "      xx", 1), ":1: "),
        (text.replace("E+0", "E?0", 1), "no"),
    ]
    for content, message in cases:
        (tmp_path / "a.op4").write_text(content)
        with pytest.raises(StudyError) as caught:
            read_op4(tmp_path / "a.op4")
        assert message in str(caught.value) and "a.op4:" in str(caught.value)


def test_any_cut_of_an_output4_file_is_refused_or_leaves_whole_matrices(tmp_path):
    """No byte count of a file that breaks off ends in anything but a refusal, or the matrices that are complete."""
    for file in (DATA / "pyyeti_little_nonbigmat.op4", DATA / "pyyeti_text_bigmat.op4"):
        content, whole = file.read_bytes(), read_op4(file)
        for end in range(1, len(content), 7):
            (tmp_path / "a.op4").write_bytes(content[:end])
            try:
                found = read_op4(tmp_path / "a.op4")
            except StudyError:
                continue
            for name, matrix in found.items():
                np.testing.assert_array_equal(matrix.toarray(), whole[name].toarray())


# ---- what is refused ----


def refused(folder: Path, k: np.ndarray, m: np.ndarray, **more: str) -> str:
    """What is said of two matrices in .npz files."""
    np.savez(folder / "k.npz", k=k)
    np.savez(folder / "m.npz", m=m)
    extra = "".join(f", {key}: {value}" for key, value in more.items())
    section = imported("type: matrices, stiffness: k.npz, mass: m.npz, dofs: dofs.csv" + extra)
    with pytest.raises(StudyError) as caught:
        evaluated(study_text(section), folder)
    return str(caught.value)


def test_matrices_of_no_structure_are_refused_by_file(tmp_path):
    write_dofs(tmp_path)
    k, m = (np.array(each) for each in matrices())
    n = len(k)
    skew, nan, minus, soft, hollow = k.copy(), k.copy(), m.copy(), k.copy(), m.copy()
    skew[2, 5] *= 1.01
    nan[3, 3] = np.nan
    minus[4, 4] *= -1
    soft[1, 1] *= 0.1
    hollow[1, 4] = hollow[4, 1] = 10 * m[1, 1]
    cases = [
        (skew, m, "k.npz: not symmetric: the terms (3, 6) and (6, 3)"),
        (nan, m, "k.npz: 'k' is not finite at (4, 4)"),
        (k, m + 1e-9j, "m.npz: 'm' is complex"),
        (k, minus, f"m.npz: negative mass {minus[4, 4]:g} at 'B2.x'"),
        (soft, m, "k.npz: the stiffness has a negative eigenvalue"),
        (k, hollow, "m.npz: the mass matrix is not positive definite"),
        (k, 0 * m, "m.npz: the mass matrix is zero"),
        (k[:, :-1], m, "k.npz: the matrix is 10 x 9"),
        (k[:-1, :-1], m, "k.npz: the matrix is 9 x 9, but 10 degrees of freedom are named"),
    ]
    assert n == 10
    for first, second, message in cases:
        assert message in refused(tmp_path, first, second)


def test_files_that_hold_no_matrix_or_several_are_refused(tmp_path):
    k, m = matrices()
    np.savez(tmp_path / "two.npz", k=k, m=m)
    io.mmwrite(tmp_path / "k.mtx", k)
    whole = (tmp_path / "k.mtx").read_bytes()
    (tmp_path / "cut.mtx").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "complex.mtx").write_text(
        "%%MatrixMarket matrix coordinate complex general\n1 1 1\n1 1 2.0 1.0\n"
    )
    (tmp_path / "k.xyz").write_text("1")
    cases = [
        ("two.npz", None, "the file holds 2 matrices; name one of k, m"),
        ("two.npz", "K1", "no matrix 'K1'; known: k, m"),
        ("cut.mtx", None, "truncated or damaged: "),
        ("complex.mtx", None, "is complex"),
        ("k.xyz", None, "'.xyz' is no format of a matrix"),
        ("none.mtx", None, "no such file"),
    ]
    for name, matrix, message in cases:
        with pytest.raises(StudyError) as caught:
            read_matrix(tmp_path / name, matrix)
        assert message in str(caught.value) and name in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grid,component\n1,3\n1,3\n", "dofs.csv:3: the degree of freedom '1.z' stands twice"),
        ("grid,component\n1,7\n", "dofs.csv:2: '7' is no component of grid '1'"),
        ("grid,component\n,3\n", "dofs.csv:2: a degree of freedom without a grid"),
        ("id,component\n1,3\n", "dofs.csv:1: the header is 'id,component'"),
        ("grid,component\n", "names no degree of freedom"),
    ],
)
def test_a_broken_list_of_degrees_of_freedom_is_refused_with_its_line(tmp_path, text, message):
    (tmp_path / "dofs.csv").write_text(text)
    with pytest.raises(StudyError) as caught:
        read_dofs(tmp_path / "dofs.csv")
    assert message in str(caught.value)


def test_degrees_of_freedom_may_be_one_name_a_line(tmp_path):
    (tmp_path / "dofs.txt").write_text("# rows\n101.1\n101.T3\n\n102.R3\n103.0\n")
    assert read_dofs(tmp_path / "dofs.txt") == ("101.x", "101.z", "102.rz", "103.x")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("       6       2", "       6       4", ":1: DMIG KAAX: type 4 is complex"),
        ("       6       2", "       2       2", ":1: DMIG KAAX: form 2 is neither square"),
        ("DMIG    KAAX", "$", "column of 'KAAX' before its header"),
        ("1.177613003D+09", "1.17x", ":3: DMIG: KAAX(101.6, 101.6): '1.17x' is no finite number"),
        (
            "                    102               1-9.199837500D+05",
            "                    101               6 1.0D+05",
            "stands twice",
        ),
        ("               6\n", "               9\n", "is no degree of freedom"),
    ],
)
def test_broken_dmig_entries_are_refused_with_their_line(tmp_path, old, new, message):
    text = (DATA / "pyyeti_dmig.pch").read_text()
    assert old in text
    (tmp_path / "a.pch").write_text(text.replace(old, new, 1))
    with pytest.raises(StudyError) as caught:
        read_dmig(tmp_path / "a.pch")
    assert message in str(caught.value) and "a.pch:" in str(caught.value)


def test_a_symmetric_dmig_gives_one_triangle(tmp_path):
    (tmp_path / "a.pch").write_text(
        "DMIG,K,0,6,2\nDMIG,K,1,1,,1,1,4.0\n,2,3,-1.0\nDMIG,K,2,3,,1,1,-1.0\n,2,3,3.0\n"
    )
    with pytest.raises(StudyError, match=r"a.pch:4: DMIG K: the term \(1.1, 2.3\) stands twice"):
        read_dmig(tmp_path / "a.pch")


def test_dmig_in_free_fields_and_with_either_triangle_is_the_same_matrix(tmp_path):
    for rows in ("DMIG,K,1,1,,1,1,4.0\n,2,3,-1.0\n", "DMIG,K,1,1,,1,1,4.\nDMIG,K,2,3,,1,1,-1.+0\n"):
        (tmp_path / "a.pch").write_text(f"DMIG,K,0,6,2,,,,2\n{rows}DMIG,K,2,3,,2,3,3.\n")
        matrix, dofs = read_dmig(tmp_path / "a.pch")["K"]
        assert dofs == ("1.x", "2.z")
        np.testing.assert_array_equal(matrix.toarray(), [[4, -1], [-1, 3]])


# ---- physics of the reduction ----


def chain(n: int, held: bool = True) -> ForeignMatrices:
    """Unit masses and springs in a row, the first one held by a spring if asked for."""
    k = sparse.diags_array([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1]).tolil()
    k[n - 1, n - 1] = 1
    if not held:
        k[0, 0] = 1
    dofs = tuple(f"{i}.x" for i in range(n))
    return ForeignMatrices(sparse.csc_array(k), sparse.eye_array(n, format="csc"), dofs, Path("k"), Path("m"))


def static(found: object, i: int, j: int) -> float:
    """Flexibility of elastic modes and residual flexibility between two degrees of freedom."""
    elastic = found.natural_frequency > 0
    shape = found.mode_shape[:, elastic]
    own = float(np.sum(shape[i] * shape[j] / found.natural_frequency[elastic] ** 2))
    return own + (0.0 if found.residual_flexibility is None else float(found.residual_flexibility[i, j]))


@pytest.mark.parametrize("n", [600, 2500])
def test_a_large_model_keeps_its_lowest_modes_and_the_static_flexibility_of_the_rest(n):
    """Dense to 2000 degrees of freedom, sparse beyond: ω_k = 2 sin((2k − 1)π/(2(2n + 1))), and i springs in a row."""
    found = modes_of(chain(n), ["9", str(n - 1)])
    k = np.arange(1, 201)
    np.testing.assert_allclose(
        found.natural_frequency, 2 * np.sin((2 * k - 1) * np.pi / (4 * n + 2)), rtol=1e-7
    )
    assert static(found, 0, 0) == pytest.approx(10.0, rel=1e-9, abs=0)
    assert static(found, 0, 1) == pytest.approx(10.0, rel=1e-9, abs=0)
    assert static(found, 1, 1) == pytest.approx(n, rel=1e-9, abs=0)


def test_a_free_large_model_keeps_the_flexibility_of_its_elastic_modes():
    """Against the pseudo-inverse of the stiffness, which is that flexibility for unit masses."""
    n = 500
    found = modes_of(chain(n, held=False), ["3", "400"])
    flexible = linalg.pinvh(chain(n, held=False).stiffness.toarray())
    assert found.n_rigid == 1
    for i, a in enumerate((3, 400)):
        for j, b in enumerate((3, 400)):
            assert static(found, i, j) == pytest.approx(flexible[a, b], rel=1e-6, abs=0)


def test_a_model_that_floats_keeps_the_one_rigid_body_mode_that_its_ports_see():
    """Receptances against the dynamic stiffness itself: the truss without supports, free in its plane."""
    free = assemble(replace(barker_truss("pinned", 3), supports={}), "tip")
    k = np.asarray(stiffness_matrix(free, free.area))
    m = np.asarray(mass_matrix(free, free.area, free.batten_mass, 0.0))
    model = ForeignMatrices(sparse.csc_array(k), sparse.csc_array(m), free.dofs, Path("k"), Path("m"))
    found = modes_of(model, ["B0", "B3"])
    assert found.n_rigid == 3
    ports = {"hub": ("B0", "rz"), "tip": ("B3", "rz")}
    with pytest.raises(ModelError, match="does not follow from 3 rigid-body modes"):
        assemble_modes(found, ports, "tip", 1.0)
    structure = assemble_modes(found, ports, "tip", 1.0, 5.0)
    assert not structure.mass_by_mirror.any()
    frame = modal_frame(structure, structure.area, structure.batten_mass, 0.0, "tip")
    assert frame.n_rigid == 1
    modes = frame.modal_set(Hub("free"), Damping((0.0,)), ("hub", "tip"))
    rows = np.array([free.port("hub"), free.port("tip")])
    for frequency in (3.0, 700.0, 2500.0):
        expected = rows @ linalg.solve(k - frequency**2 * m, rows.T)
        own = np.abs(expected).max()
        for i, first in enumerate(("hub", "tip")):
            for j, other in enumerate(("hub", "tip")):
                value = modes.receptance(np.array([1j * frequency]), first, other)[0].real
                assert value == pytest.approx(expected[i, j], rel=1e-7, abs=1e-7 * own)


def test_degrees_of_freedom_without_mass_follow_statically():
    """A massless point between two springs in a row: the frequency of one spring of half the stiffness."""
    k = sparse.csc_array(np.array([[2.0, -1.0], [-1.0, 1.0]]))
    m = sparse.csc_array(np.diag([0.0, 3.0]))
    model = ForeignMatrices(k, m, ("1.x", "2.x"), Path("k"), Path("m"))
    found = modes_of(model, ["1", "2"])
    assert found.natural_frequency == pytest.approx([np.sqrt(0.5 / 3)], rel=1e-13, abs=0)
    assert found.mode_shape[:, 0] / found.mode_shape[1, 0] == pytest.approx([0.5, 1.0], rel=1e-13, abs=0)
    # The point itself gives way locally: 1/2 in all, a quarter of it through the mode.
    assert static(found, 0, 0) == pytest.approx(1.0, rel=1e-12, abs=0)
    assert static(found, 1, 1) == pytest.approx(2.0, rel=1e-12, abs=0)


def test_what_has_neither_mass_nor_stiffness_is_refused():
    k = sparse.csc_array(np.diag([0.0, 1.0]))
    m = sparse.csc_array(np.diag([0.0, 3.0]))
    with pytest.raises(StudyError, match=r"neither mass nor stiffness, '1.x'"):
        modes_of(ForeignMatrices(k, m, ("1.x", "2.x"), Path("k"), Path("m")), ["1", "2"])


def test_wtmass_scales_the_mass_of_a_model_in_weight_units():
    """A weight of 386.09 lbf on a spring of 1 lbf/in swings at 1 rad/s."""
    k, m = sparse.csc_array([[1.0]]), sparse.csc_array([[386.09]])
    units = ModelUnits(0.0254, 4.4482216152605, 1 / 386.09)
    model = matrices_in_si(k, m, ("1.x",), units, (Path("k"), Path("m")))
    assert modes_of(model, ["1"]).natural_frequency == pytest.approx([1.0], rel=1e-12, abs=0)
    assert model.mass[0, 0] == pytest.approx(
        386.09 * 0.45359237 * 9.80665 / (386.09 * 0.0254), rel=1e-12, abs=0
    )


def test_units_turn_every_block_of_the_matrices():
    """N/mm, N and N mm of stiffness; tonnes, tonne mm and tonne mm² of mass."""
    ones = sparse.csc_array(np.ones((2, 2)))
    model = matrices_in_si(ones, ones, ("1.x", "1.rz"), ModelUnits(MM, 1.0), (Path("k"), Path("m")))
    np.testing.assert_allclose(model.stiffness.toarray(), [[1e3, 1], [1, 1e-3]], rtol=1e-14)
    np.testing.assert_allclose(model.mass.toarray(), [[1e3, 1], [1, 1e-3]], rtol=1e-14)


def test_the_number_of_modes_kept_can_be_stated(tmp_path):
    keys = write_matrices(tmp_path, "mtx")
    section = imported(f"type: matrices, {keys}, dofs: dofs.csv, lowest_modes: 6")
    found = evaluated(study_text(section), tmp_path)
    assert found.all_modes.natural_frequency.size == 6 + 4  # with one for each of four loads at the ports
    assert found.value("jitter_total") == pytest.approx(native()["jitter_total"], rel=1e-3, abs=0)
