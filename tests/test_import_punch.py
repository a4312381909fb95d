"""Eigenvectors of Nastran punch files: what is read, passed over and refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from foreign_models import evaluated, imported, metrics, modes, native, study_text

from fosopt.errors import StudyError
from fosopt.structure.readers.punch import read_punch


def punch(arrays: dict[str, Any]) -> str:
    """Eigenvectors as Nastran punches them: lines of 72 characters, then a running number."""
    grids: dict[str, dict[str, Any]] = {}
    for name, row in zip(arrays["dofs"], arrays["mode_shape"], strict=True):
        grids.setdefault(name.split(".")[0], {})[name.split(".")[1]] = row
    lines = []
    for k, frequency in enumerate(arrays["frequency_hz"]):
        value = (2 * np.pi * frequency) ** 2
        lines += [
            "$TITLE   = OWN MODEL",
            "$SUBTITLE=",
            "$LABEL   =",
            "$EIGENVECTOR",
            "$REAL OUTPUT",
            "$SUBCASE ID =           1",
        ]
        lines.append(f"$EIGENVALUE = {value:14.7E}  MODE = {k + 1:5d}")
        for grid, rows in grids.items():
            numbers = [float(rows[c][k]) if c in rows else 0.0 for c in ("x", "y", "z", "rx", "ry", "rz")]
            lines.append(f"{grid:>10}       G" + "".join(f"{x:18.6E}" for x in numbers[:3]))
            lines.append("-CONT-            " + "".join(f"{x:18.6E}" for x in numbers[3:]))
    return "".join(f"{line:<72}{n:8d}\n" for n, line in enumerate(lines, 1))


PUNCH_PORTS = "{hub: [100, rz], tip: [103, rz]}"


def punched() -> dict[str, Any]:
    """Modes by grid numbers."""
    arrays = modes()
    arrays["dofs"] = np.array(["100.rz", "103.x", "103.y", "103.rz"])
    return arrays


def test_eigenvectors_of_a_punch_file_give_the_metrics_to_their_seven_digits(tmp_path):
    (tmp_path / "modes.pch").write_text(punch(punched()))
    section = imported("type: modal_set, file: modes.pch", PUNCH_PORTS)
    assert metrics(evaluated(study_text(section), tmp_path)) == pytest.approx(native(), rel=3e-5, abs=0)


def test_every_component_of_a_punch_file_stands_in_its_place(tmp_path):
    arrays = punched()
    (tmp_path / "m.pch").write_text(punch(arrays))
    found = read_punch(tmp_path / "m.pch")
    assert found.dofs[:6] == ("100.x", "100.y", "100.z", "100.rx", "100.ry", "100.rz")
    for name, row in zip(arrays["dofs"], arrays["mode_shape"], strict=True):
        np.testing.assert_allclose(found.mode_shape[found.dofs.index(name)], row, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.frequency_hz, arrays["frequency_hz"], rtol=1e-7, atol=1e-5)


def test_a_rigid_body_mode_may_have_an_eigenvalue_a_little_below_zero(tmp_path):
    text = punch(punched())
    first = text.split("$EIGENVALUE =")[1][:15]
    (tmp_path / "m.pch").write_text(text.replace(first, " -1.1000000E-07", 1))
    assert read_punch(tmp_path / "m.pch").frequency_hz[0] == 0


def test_results_of_other_kinds_in_a_punch_file_are_passed_over(tmp_path):
    """The bar forces a beam's modes are punched with, as in Nastran's own files."""
    (tmp_path / "m.pch").write_text(punch(punched()))
    forces = (
        "$TITLE   = SIMPLE BEAM\n$SUBTITLE= MODES\n$LABEL   =\n$ELEMENT FORCES\n$REAL OUTPUT\n"
        "$SUBCASE ID =           1\n"
        "$ELEMENT TYPE =          34  BAR\n$EIGENVALUE =  8.2327765E+06  MODE =     1\n"
        "         1              1.146587E+05      7.685664E+05      1.001748E+05       9\n"
        "-CONT-                  6.714796E+05      1.448392E+04      9.708680E+04      10\n"
        "-CONT-                  1.193920E-09      9.946595E-10                        11\n"
    )
    (tmp_path / "n.pch").write_text(forces + punch(punched()) + forces)
    np.testing.assert_array_equal(
        read_punch(tmp_path / "m.pch").mode_shape, read_punch(tmp_path / "n.pch").mode_shape
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t[: len(t) - 81], "the file ends within grid 103: truncated"),
        (lambda t: t[: len(t) - 162], "differ in grid 103: truncated"),
        (lambda t: t.replace("$EIGENVECTOR", "$DISPLACEMENTS"), "has no real eigenvectors"),
        (lambda t: t.replace("REAL OUTPUT", "REAL-IMAGINARY OUTPUT", 1), ":5: complex eigenvectors"),
        (lambda t: t.replace("MODE =     2", "MODE =     1"), "mode 1 stands twice"),
        (lambda t: t.replace("E+00", "E+xx", 1), "is no finite number"),
        (lambda t: t.replace("\n       103", "\n       100", 1), "grid 100 stands twice"),
        (lambda t: t.replace("= ", "=-", 2), "eigenvalue"),
    ],
)
def test_a_broken_punch_file_is_refused_with_its_line(tmp_path, change, message):
    text = punch(punched())
    if message == "eigenvalue":
        value = text.split("$EIGENVALUE =")[3][:15]
        broken, message = text.replace(value, f" -{value.strip()}"), "is negative; the structure is unstable"
    else:
        broken = change(text)
    (tmp_path / "m.pch").write_text(broken)
    with pytest.raises(StudyError) as caught:
        read_punch(tmp_path / "m.pch")
    assert message in str(caught.value)
