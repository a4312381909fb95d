"""Files for other tools: units in the names, all digits, inert text, all of a file or nothing."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from fake_run import HERTZ, fake_run, point, quantity
from pyarrow import parquet
from scipy.io import loadmat, netcdf_file

from fosopt.errors import FosoptError
from fosopt.export import write_csv, write_json, write_mat, write_netcdf, write_parquet

WRITERS = [write_csv, write_json, write_mat, write_netcdf, write_parquet]


def rows_of(run, tmp_path: Path) -> list[dict[str, str]]:
    path = tmp_path / "front.csv"
    write_csv(run, path)
    with path.open(encoding="utf-8", newline="") as stream:
        reader = csv.reader(stream)
        names = next(reader)
        assert len(set(names)) == len(names)
        return [dict(zip(names, row, strict=True)) for row in reader]


def arrays_of(run, tmp_path: Path):
    path = tmp_path / "front.mat"
    write_mat(run, path)
    return loadmat(path, simplify_cells=True)


@pytest.fixture
def run():
    return fake_run(
        point("start", "evaluated"), point("000"), point("001", "unstable", reason="grows; lower kp µ")
    )


def test_the_table_has_one_row_per_point_with_units_in_its_names(run, tmp_path):
    rows = rows_of(run, tmp_path)
    assert list(rows[0]) == [
        *("key", "label", "case", "strategy", "status", "verified", "dominated", "parent", "reason"),
        *("structural_mass_kg", "jitter_total_rad", "first_elastic_frequency_hz", "crossover_hz"),
        *("modulus_margin", "slack_first_elastic_frequency", "slack_a_b_2", "slack_a_b_2_2"),
        *("multiplier_first_elastic_frequency", "multiplier_a_b_2", "multiplier_a_b_2_2"),
        *("area_L1_m2", "area_root_bars_m2", "variable_crossover_hz"),
        *("seconds", "iterations", "kkt_residual", "provenance"),
    ]
    assert {row["provenance"] for row in rows} == {"seed 1"}
    assert [row["key"] for row in rows] == ["start", "000", "001"]
    assert [row["verified"] for row in rows] == ["true", "true", "false"]
    assert rows[0]["strategy"] == rows[0]["reason"] == rows[0]["multiplier_a_b_2"] == ""
    assert (rows[2]["jitter_total_rad"], rows[2]["reason"]) == ("", "grows; lower kp µ")
    assert float(rows[0]["first_elastic_frequency_hz"]) == pytest.approx(6, rel=1e-15)
    assert (rows[0]["slack_a_b_2"], rows[0]["slack_a_b_2_2"]) == ("0.5", "0.25")


def test_numbers_keep_all_their_digits(tmp_path):
    row = rows_of(fake_run(point("000", iterations=12)), tmp_path)[0]
    assert float(row["area_L1_m2"]) == 1e-5 / 3
    assert float(row["kkt_residual"]) == 1e-9 / 3
    assert row["iterations"] == "12"


def test_points_need_not_have_the_same_columns(tmp_path):
    first = point("000", constraints=[], metrics={"structural_mass": 1.0}, variables={"area": [1.0, 2.0]})
    second = point("001", variables={"kp": [600.0]}, metrics={"2 * jitter_total": 1.0})
    rows = rows_of(fake_run(first, second), tmp_path)
    assert [row["structural_mass_kg"] for row in rows] == ["1.0", ""]
    assert [row["2_jitter_total"] for row in rows] == ["", "1.0"]
    assert [row["area_root_bars_m2"] for row in rows] == ["2.0", ""]
    assert [row["kp"] for row in rows] == ["", "600.0"]
    assert [row["slack_a_b_2"] for row in rows] == ["", "0.5"]


@pytest.mark.parametrize(
    "text", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", '=cmd|"/c calc"!A1', "=HYPERLINK(\"x\"),'y'"]
)
def test_a_formula_in_a_name_is_inert(tmp_path, text):
    row = rows_of(fake_run(point("000", label=text, case=text, reason=text)), tmp_path)[0]
    assert {row["label"], row["case"], row["reason"]} == {"'" + text.replace("\r", "\n")}


def test_text_that_is_no_formula_and_negative_numbers_stay(tmp_path):
    text = 'a, "b"\nc = d; µ'
    row = rows_of(fake_run(point("000", label=text, metrics={"jitter_total": -1.5})), tmp_path)[0]
    assert (row["label"], row["jitter_total_rad"]) == (text, "-1.5")


def test_a_run_without_points_has_a_header_only(tmp_path):
    assert rows_of(fake_run(), tmp_path) == []
    assert arrays_of(fake_run(), tmp_path)["objectives"].size == 0


def test_json_holds_the_run_but_for_the_details(run, tmp_path):
    path = tmp_path / "front.json"
    write_json(run, path)
    found = json.loads(path.read_text(encoding="ascii"))
    assert all("detail" not in each for each in found["points"])
    assert all("detail" in each for each in run["points"])
    for each in run["points"]:
        del each["detail"]
    assert found == run


def test_matlab_arrays_hold_the_same_numbers(run, tmp_path):
    arrays = arrays_of(run, tmp_path)
    mass = [each["metrics"]["structural_mass"] for each in run["points"]]
    np.testing.assert_array_equal(arrays["metrics"]["structural_mass_kg"], mass)
    np.testing.assert_array_equal(arrays["objectives"][:, 0], mass)
    np.testing.assert_array_equal(np.isnan(arrays["objectives"][:, 1]), [False, False, True])
    np.testing.assert_allclose(arrays["variables"]["crossover_hz"], 230, rtol=1e-15)
    areas = [each["variables"]["area"] for each in run["points"]]
    np.testing.assert_array_equal(arrays["variables"]["area_m2"], areas)
    assert list(arrays["labels"]["area_m2"]) == ["L1", "root bars"]
    assert list(arrays["objective_names"]) == ["structural_mass_kg", "jitter_total_rad"]
    assert list(arrays["key"]) == ["start", "000", "001"]
    assert list(arrays["reason"])[2] == "grows; lower kp µ"
    assert list(arrays["verified"]) == [1, 1, 0]
    assert arrays["slack"]["a_b_2_2"].tolist() == [0.25] * 3
    assert np.isnan(arrays["multiplier"]["a_b_2"]).all()


def test_matlab_units_are_those_of_the_columns(run, tmp_path):
    units = arrays_of(run, tmp_path)["units"]
    assert units == {
        "structural_mass_kg": "kg",
        "jitter_total_rad": "rad",
        "first_elastic_frequency_hz": "Hz",
        "crossover_hz": "Hz",
        "modulus_margin": "1",
        "area_m2": "m^2",
    }


def test_matlab_gets_names_it_takes(tmp_path):
    long = "jitter_" + "x" * 64
    run = fake_run(point("000", metrics={long: 1.0, long + "y": 2.0, "2 * jitter_total": 3.0}))
    run["quantities"] |= {name: quantity(name, "urad", 1e6, f"{name}_rad") for name in (long, long + "y")}
    metrics = arrays_of(run, tmp_path)["metrics"]
    assert sorted(metrics.values()) == [1.0, 2.0, 3.0]
    assert all(name.isidentifier() and len(name) <= 63 for name in metrics)


@pytest.mark.parametrize("write", WRITERS)
def test_a_file_that_cannot_be_written_is_said_in_one_line(write, run, tmp_path):
    for path in (tmp_path / "absent" / "front", tmp_path):
        with pytest.raises(FosoptError, match=r"cannot be written: .*; check the directory") as caught:
            write(run, path)
        assert str(caught.value).startswith(f"{path}: ")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("write", WRITERS)
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(write, run, tmp_path, monkeypatch):
    path = tmp_path / "front"
    path.write_text("old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(FosoptError, match="No space left on device"):
        write(run, path)
    assert os.listdir(tmp_path) == ["front"]
    assert path.read_text() == "old"


@pytest.mark.parametrize("write", [write_csv, write_json])
def test_a_number_that_is_not_finite_is_refused(write, tmp_path):
    run = fake_run(point("000", kkt_residual=float("nan")))
    with pytest.raises(ValueError, match="JSON"):
        write(run, tmp_path / "front")
    assert os.listdir(tmp_path) == []


def test_frequencies_are_in_hertz_and_angles_in_radians(run, tmp_path):
    row = rows_of(run, tmp_path)[1]
    assert float(row["crossover_hz"]) * HERTZ == pytest.approx(run["points"][1]["metrics"]["crossover"])
    assert float(row["jitter_total_rad"]) == run["points"][1]["metrics"]["jitter_total"]


def table_of(run, tmp_path: Path) -> pyarrow.Table:
    path = tmp_path / "front.parquet"
    write_parquet(run, path)
    return parquet.read_table(path)


def axes_of(run, tmp_path: Path):
    """Variables, units and attributes of the netCDF file, by name, with texts as strings."""
    path = tmp_path / "front.nc"
    write_netcdf(run, path)
    with netcdf_file(path, mmap=False) as file:
        found = {name: (each.dimensions, each[:].copy()) for name, each in file.variables.items()}
        units = {name: each.units.decode() for name, each in file.variables.items() if hasattr(each, "units")}
        attributes = {name: value.decode() for name, value in file._attributes.items()}
    texts = {
        name: [b"".join(row).rstrip(b"\0").decode() for row in values]
        for name, (_, values) in found.items()
        if values.dtype.kind == "S"
    }
    return found, units, attributes, texts


def test_parquet_holds_the_columns_of_the_table_in_their_types(run, tmp_path):
    table, rows = table_of(run, tmp_path), rows_of(run, tmp_path)
    assert table.column_names == [name for name in rows[0] if name != "provenance"]
    for name in table.column_names:
        kind, cells = table.schema.field(name).type, table.column(name).to_pylist()
        for cell, row in zip(cells, rows, strict=True):
            if cell is None:
                assert row[name] == ""
            elif kind == pyarrow.bool_():
                assert row[name] == str(cell).lower()
            elif kind == pyarrow.string():
                assert row[name] == cell
            else:
                assert kind == pyarrow.float64()
                assert float(row[name]) == cell


def test_parquet_columns_carry_their_units_and_the_table_its_origin(run, tmp_path):
    schema = table_of(run, tmp_path).schema
    units = {
        name: (schema.field(name).metadata or {}).get(b"unit")
        for name in (
            "key",
            "jitter_total_rad",
            "area_L1_m2",
            "variable_crossover_hz",
            "slack_a_b_2",
            "seconds",
        )
    }
    assert units == {
        "key": None,
        "jitter_total_rad": b"rad",
        "area_L1_m2": b"m^2",
        "variable_crossover_hz": b"Hz",
        "slack_a_b_2": b"SI",
        "seconds": b"s",
    }
    assert schema.metadata[b"name"] == b"Mass against jitter"
    assert schema.metadata[b"seed"] == b"1"


def test_netcdf_has_a_matrix_for_a_variable_with_groups_and_labels_on_its_axis(run, tmp_path):
    found, units, attributes, texts = axes_of(run, tmp_path)
    axes, areas = found["area_m2"]
    assert axes == ("point", "area_group")
    assert texts["area_group"] == ["L1", "root bars"]
    np.testing.assert_array_equal(areas, [each["variables"]["area"] for each in run["points"]])
    assert (units["area_m2"], units["variable_crossover_hz"], units["seconds"]) == ("m^2", "Hz", "s")
    assert not any(name.startswith(("area_L1", "area_root")) for name in found)
    assert (attributes["name"], attributes["seed"]) == ("Mass against jitter", "1")


def test_netcdf_holds_the_columns_of_the_table(run, tmp_path):
    found, _, _, texts = axes_of(run, tmp_path)
    rows = rows_of(run, tmp_path)
    shared = [name for name in rows[0] if not name.startswith("area_") and name != "provenance"]
    assert set(found) == {*shared, "area_m2", "area_group"}
    for name in shared:
        values, cells = found[name][1], [row[name] for row in rows]
        if name in texts:
            assert texts[name] == cells
        elif values.dtype == np.int8:
            assert ["true" if flag else "false" for flag in values] == cells
        else:
            np.testing.assert_array_equal(values, [float(cell or "nan") for cell in cells])


@pytest.mark.parametrize("write", [write_netcdf, write_parquet])
def test_text_that_is_no_utf8_and_runs_without_points_can_be_written(write, tmp_path):
    write(fake_run(), tmp_path / "empty")
    write(fake_run(point("000", reason="a\udcffb"), name="\ud800"), tmp_path / "odd")
    assert (tmp_path / "odd").stat().st_size > 500
