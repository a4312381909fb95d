"""Sweeps for other programs: the numbers of the run under stable names, written piece by piece."""

from __future__ import annotations

import csv
import os
import resource
import sys
import tracemalloc
from math import inf, nan, prod
from pathlib import Path
from types import SimpleNamespace

import netCDF4
import numpy as np
import pytest
from export_tables import OTHERS, TABLES
from pyarrow import parquet
from scipy.io import loadmat
from small_studies import run_text
from test_sweep_study import GRID, sweep_text
from typer.testing import CliRunner

from fosopt.cli.commands import app
from fosopt.cli.export import Format
from fosopt.errors import FosoptError
from fosopt.export.sweep import SweepData, write_sweep_csv, write_sweep_parquet
from fosopt.export.sweep_matlab import write_sweep_mat
from fosopt.export.sweep_netcdf import boxes, write_sweep_netcdf
from fosopt.study import parse_study
from fosopt.study.schema_names import METRICS
from fosopt.study.schema_sweep import LISTED
from fosopt.study.store import Block
from fosopt.study.sweep_export import stored_pieces
from fosopt.study.sweep_job import SweepPlan

WRITERS = [write_sweep_csv, write_sweep_parquet, write_sweep_netcdf, write_sweep_mat]
HERTZ = 2 * np.pi
HOSTILE = "=cmd|'/c calc'!A1"


def invoke(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


# ---- a sweep as the runner leaves it ----


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A grid of ten points; its run data with arrays by name, and its directory."""
    folder = tmp_path_factory.mktemp("sweep")
    data = run_text(sweep_text(GRID + "    - natural_frequency\n"), folder)
    out = folder / "out"
    arrays = {each["name"]: np.load(out / each["file"]) for each in (*data["axes"], *data["outputs"])}
    return data, arrays, out


def exported(run, form: str, folder: Path) -> Path:
    path = folder / f"sweep.{form}"
    result = invoke("export", run[2], "--format", form, "--out", path)
    assert (result.exit_code, result.stdout) == (0, f"wrote {path}\n"), result.output
    return path


def test_the_table_is_that_of_the_run_with_its_origin(run, tmp_path):
    with exported(run, "csv", tmp_path).open(encoding="utf-8", newline="") as stream:
        rows = list(csv.reader(stream))
    with (run[2] / "points.csv").open(encoding="utf-8", newline="") as stream:
        own = list(csv.reader(stream))
    assert rows == own
    assert rows[0][-1] == "provenance"
    assert rows[1][-1].startswith(f"study {run[0]['provenance']['study']}; ")
    assert {row[-1] for row in rows[2:]} == {""}


def test_netcdf_has_the_axes_of_the_grid(run, tmp_path):
    data, arrays, _ = run
    with netCDF4.Dataset(exported(run, "netcdf", tmp_path)) as file:
        file.set_auto_mask(False)
        sizes = {name: axis.size for name, axis in file.dimensions.items()}
        assert sizes == {"damping_ratio": 2, "mirror_inertia_ratio": 5, "structure_mode": 10, "mode": 11}
        for axis in data["axes"]:
            np.testing.assert_array_equal(file[axis["name"]][:], axis["values"])
        found = file["spectral_abscissa_rad_per_s"]
        assert found.dimensions == ("damping_ratio", "mirror_inertia_ratio")
        np.testing.assert_array_equal(found[:].ravel(), arrays["spectral_abscissa"])
        assert file["spectral_abscissa_rad_per_s"].units == "rad/s"
        for name, axis in (("structure_frequency", "structure_mode"), ("natural_frequency", "mode")):
            each = file[f"{name}_hz"]
            assert (each.dimensions[2], each.units, each.long_name) == (axis, "Hz", name)
            np.testing.assert_allclose(each[:].reshape(10, -1) * HERTZ, arrays[name], rtol=1e-15)
            assert file[axis][:].tolist() == list(range(1, sizes[axis] + 1))
        assert file["one_minus_separation"].units == "1"
        np.testing.assert_array_equal(
            file["one_minus_separation"][:].reshape(10, -1), arrays["one_minus_separation"]
        )
        assert {name: file.getncattr(name) for name in data["provenance"]} == data["provenance"]
        assert file.getncattr("name") == data["name"]


def test_parquet_has_types_units_and_lists_of_modes(run, tmp_path):
    data, arrays, _ = run
    table = parquet.read_table(exported(run, "parquet", tmp_path))
    with (run[2] / "points.csv").open(encoding="utf-8") as stream:
        head = next(csv.reader(stream))
    by_mode = ["one_minus_separation", "structure_frequency_hz", "natural_frequency_hz"]
    assert table.column_names == [*head[:-1], *by_mode]
    assert table.column("jitter_total_rad").to_pylist() == arrays["jitter_total"].tolist()
    assert table.schema.field("natural_frequency_hz").metadata[b"unit"] == b"Hz"
    found = np.array(table.column("natural_frequency_hz").to_pylist())
    np.testing.assert_allclose(found * HERTZ, arrays["natural_frequency"], rtol=1e-15)
    assert table.schema.metadata[b"study"].decode() == data["provenance"]["study"]


def test_matlab_has_what_the_run_itself_left(run, tmp_path):
    found = loadmat(exported(run, "mat", tmp_path), simplify_cells=True)
    own = loadmat(run[2] / "sweep.mat", simplify_cells=True)
    assert found.keys() == own.keys()
    assert found["about"]["provenance"]["study"] == run[0]["provenance"]["study"]
    for name in found.keys() - {"about", "__header__", "__version__", "__globals__"}:
        np.testing.assert_array_equal(found[name], own[name])
    assert found["about"]["units"] == own["about"]["units"]


def test_json_of_a_sweep_is_refused_with_the_way_out(run):
    before = (run[2] / "sweep.json").read_bytes()
    result = invoke("export", run[2], "--format", "json")
    assert result.exit_code == 3
    assert "too many points for JSON; write csv, parquet, mat or netcdf" in result.stderr
    assert (run[2] / "sweep.json").read_bytes() == before


# ---- a sweep of made-up numbers ----


def quantity(column: str, factor: float = 1.0, unit: str = "") -> dict:
    return {"label": column, "unit": unit, "factor": factor, "column": column, "column_factor": factor}


def fake(shape=(2, 3), modes=4, grid=True, pieces=None, finished=None, width=2) -> SweepData:
    """A port and a frequency against a value, and two outputs for each mode."""
    count = prod(shape)
    axes = [
        {
            "name": "mirror_port",
            "unit": "1",
            "labels": [HOSTILE, "tip"],
            "values": [0.0, 1.0],
            "file": "arrays/mirror_port.npy",
        },
        {
            "name": "f",
            "unit": "rad/s",
            "labels": None,
            "values": np.linspace(1, 2, shape[-1]).tolist(),
            "file": "arrays/f.npy",
        },
    ]
    if not grid:
        axes = [{**axis, "values": None} for axis in axes]
    outputs = [
        {"name": "value", "shape": [count], "dimensions": ["point"], "unit": "1", "file": "arrays/value.npy"},
        *(
            {
                "name": name,
                "shape": [count, size],
                "dimensions": ["point", axis],
                "unit": "rad/s",
                "file": f"arrays/{name}.npy",
            }
            for name, size, axis in (("a", modes, "mode"), ("b", width, "structure_mode"))
        ),
    ]
    run = {
        "name": "fake\ud800",
        "sampling": "grid" if grid else "sobol",
        "provenance": {"study": "=abc", "seed": "1"},
        "shape": list(shape) if grid else [count],
        "count": count,
        "axes": axes,
        "outputs": outputs,
        "quantities": {
            "mirror_port": quantity("mirror_port"),
            "f": quantity("f_hz", 1 / HERTZ, "Hz"),
            "value": quantity("value"),
            "a": quantity("a_hz", 1 / HERTZ, "Hz"),
            "b": quantity("b"),
        },
    }
    return SweepData(
        run, pieces or (lambda: numbers(count if finished is None else finished, shape, modes, width))
    )


def numbers(count, shape, modes, width=2, together=5):
    """Every number of a point from its place."""
    inner = shape[-1]
    for first in range(0, count, together):
        k = np.arange(first, min(first + together, count), dtype=float)
        f = HERTZ * np.linspace(1, 2, inner)[(k % inner).astype(int)]
        scalars = np.column_stack([(k // inner) % 2, f, np.where(k == 1, nan, -k)])
        yield scalars, {"a": HERTZ * (k[:, None] + np.arange(modes) / 100), "b": k[:, None] * np.ones(width)}


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_names_of_ports_and_origins_are_no_formulas(tmp_path):
    write_sweep_csv(fake(), tmp_path / "a.csv")
    rows = rows_of(tmp_path / "a.csv")
    assert [row["mirror_port"] for row in rows] == ["'" + HOSTILE] * 3 + ["tip"] * 3
    assert rows[0]["provenance"] == "study =abc; seed 1"
    assert [row["value"] for row in rows] == ["-0", "", "-2", "-3", "-4", "-5"]
    assert [float(row["f_hz"]) for row in rows] == pytest.approx([1, 1.5, 2] * 2, rel=1e-15)


@pytest.mark.parametrize("shape", [(5,), (2, 3), (4, 1, 3), (3, 4, 5), (1, 1), (2, 3, 2, 2)])
def test_boxes_cover_any_range_in_its_order(shape):
    count = prod(shape)
    grid = np.arange(count).reshape(shape)
    for first in range(count + 1):
        for last in range(first, count + 1):
            parts = [np.atleast_1d(grid[box]).ravel() for box in boxes(first, last, shape)]
            assert np.concatenate([np.zeros(0, int), *parts]).tolist() == list(range(first, last))
            assert len(parts) <= 2 * len(shape) - 1


@pytest.mark.parametrize("finished", [0, 4, 6])
def test_points_that_are_not_finished_are_nan_on_the_grid(tmp_path, finished, monkeypatch):
    monkeypatch.setattr("fosopt.export.sweep_netcdf._ROWS", 4)  # five points are written, and then one
    write_sweep_netcdf(fake(finished=finished), tmp_path / "a.nc")
    with netCDF4.Dataset(tmp_path / "a.nc") as file:
        file.set_auto_mask(False)
        assert file["mirror_port"][:].tolist() == [HOSTILE, "tip"]
        np.testing.assert_allclose(file["f_hz"][:], [1 / HERTZ, 1.5 / HERTZ, 2 / HERTZ], rtol=1e-15)
        value, modes = file["value"][:].ravel(), file["a_hz"][:].reshape(6, 4)
        k = np.arange(6.0)
        k[finished:] = nan
        np.testing.assert_array_equal(value, np.where(k == 1, nan, -k))
        np.testing.assert_allclose(modes, k[:, None] + np.arange(4) / 100, rtol=1e-14)
        assert file["b"].dimensions == ("mirror_port", "f_hz", "structure_mode")


def test_drawn_points_have_an_axis_of_their_own(tmp_path):
    write_sweep_netcdf(fake(grid=False), tmp_path / "a.nc")
    with netCDF4.Dataset(tmp_path / "a.nc") as file:
        file.set_auto_mask(False)
        assert file["mirror_port"].dimensions == file["f_hz"].dimensions == ("point",)
        assert file["mirror_port"][:].tolist() == [HOSTILE] * 3 + ["tip"] * 3
        np.testing.assert_allclose(file["f_hz"][:], [1, 1.5, 2] * 2, rtol=1e-15)
        assert file["a_hz"].dimensions == ("point", "mode")


def test_two_axes_of_modes_of_one_name_and_other_lengths_are_told_apart(tmp_path):
    data = fake()
    data.run["outputs"][2]["dimensions"] = ["point", "mode"]
    write_sweep_netcdf(data, tmp_path / "a.nc")
    with netCDF4.Dataset(tmp_path / "a.nc") as file:
        assert (file["a_hz"].dimensions[2], file["b"].dimensions[2]) == ("mode", "mode_2")


def test_parquet_knows_missing_numbers_and_texts(tmp_path, monkeypatch):
    monkeypatch.setattr("fosopt.export.sweep._ROWS", 4)
    write_sweep_parquet(fake(), tmp_path / "a.parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table.column("mirror_port").to_pylist() == [HOSTILE] * 3 + ["tip"] * 3
    assert table.column("value").to_pylist() == [0, None, -2, -3, -4, -5]
    assert table.schema.field("mirror_port").metadata is None
    assert table.column("b").to_pylist()[3] == [3.0, 3.0]
    assert table.schema.metadata[b"name"] == b"fake\\ud800"


def test_an_axis_and_an_output_of_one_name_are_two_columns(tmp_path):
    data = fake()
    data.run["quantities"]["value"]["column"] = "f_hz"
    write_sweep_csv(data, tmp_path / "a.csv")
    assert list(rows_of(tmp_path / "a.csv")[0]) == ["mirror_port", "f_hz", "f_hz_2", "provenance"]


def test_infinities_are_written(tmp_path):
    def endless():
        yield np.array([[0.0, 1.0, inf]]), {"a": np.full((1, 4), inf), "b": np.zeros((1, 2))}

    data = fake(shape=(1, 1), pieces=endless)
    write_sweep_csv(data, tmp_path / "a.csv")
    assert rows_of(tmp_path / "a.csv")[0]["value"] == "inf"
    write_sweep_parquet(data, tmp_path / "a.parquet")
    assert parquet.read_table(tmp_path / "a.parquet").column("a_hz").to_pylist() == [[inf] * 4]


@pytest.mark.parametrize("write", WRITERS[:3])
def test_memory_does_not_grow_with_the_number_of_points(write, tmp_path):
    """NumPy reports its arrays to tracemalloc; what is written is 35 MB the first time and four times that then."""

    def peak(points):
        shape = (points // 100, 100)
        data = fake(shape, 40, grid=False, pieces=lambda: numbers(points, shape, 40, together=500))
        tracemalloc.start()
        write(data, tmp_path / "a")
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    peak(500)
    small, large = peak(20_000), peak(80_000)
    assert large < 1.1 * small + 100_000
    assert large < 20e6


def test_an_array_that_matlab_cannot_hold_is_refused_before_any_work(tmp_path):
    data = fake((2, 3_000_000), 60, pieces=lambda: pytest.fail("the points were asked for"))
    with pytest.raises(FosoptError, match=r"'a' takes 2\.68 GiB, .* write --format netcdf"):
        write_sweep_mat(data, tmp_path / "a.mat")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("write", WRITERS)
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(write, tmp_path):
    def broken():
        yield from numbers(4, (2, 3), 4)
        raise OSError(28, "No space left on device")

    (tmp_path / "a").write_text("old")
    with pytest.raises(FosoptError, match="No space left"):
        write(fake(pieces=broken), tmp_path / "a")
    assert os.listdir(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "old"
    with pytest.raises(FosoptError, match="cannot be written"):
        write(fake(), tmp_path / "absent" / "a")


@pytest.mark.parametrize("write", WRITERS)
def test_a_full_disk_is_said_in_one_line(write, tmp_path):
    """A limit on the size of files stands for the disk; Python ignores its signal."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    data = fake((2, 1000), 40, pieces=lambda: noise(2000, 40))
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, before[1]))
    try:
        with pytest.raises(FosoptError, match=r"a: cannot be written: .*; check the directory") as caught:
            write(data, tmp_path / "a")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == []


def noise(count, modes):
    """Numbers that no compression makes small."""
    random = np.random.default_rng(1)
    scalars = np.column_stack([np.zeros(count), random.random((count, 2))])
    yield scalars, {"a": random.random((count, modes)), "b": random.random((count, 2))}


def test_points_between_others_that_are_not_finished_have_no_values():
    plan = SweepPlan.of(parse_study(sweep_text()))
    arrays = {0: np.full((2, len(plan.scalars)), 7.0)}
    arrays |= {k: np.full((2, width), 8.0) for k, width in enumerate(plan.widths.values(), 1)}
    blocks = [Block(first, first + 2, 0, 0, None) for first in (0, 5, 7)]
    store = SimpleNamespace(blocks=lambda: blocks, block_arrays=lambda first: arrays)
    pieces = list(stored_pieces(store, plan))
    assert [scalars.shape[0] for scalars, _ in pieces] == [2, 3, 2, 2]
    gap, by_mode = pieces[1]
    np.testing.assert_array_equal(gap[:, :2], plan.points.rows(2, 5))
    assert np.isnan(gap[:, 2:]).all() and all(np.isnan(values).all() for values in by_mode.values())
    assert all(np.all(values == 8.0) for values in pieces[2][1].values())


@pytest.mark.parametrize(
    ("write", "module", "extra"),
    [(write_sweep_parquet, "pyarrow", "parquet"), (write_sweep_netcdf, "netCDF4", "netcdf")],
)
def test_a_library_that_is_missing_is_named(write, module, extra, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(FosoptError, match=rf"pip install 'fosopt\[{extra}\]'"):
        write(fake(), tmp_path / "a")


# ---- the page ----


@pytest.mark.parametrize("name", TABLES)
def test_the_page_lists_every_column_with_its_unit(name):
    page = (Path(__file__).parents[1] / "docs" / "exports.md").read_text(encoding="utf-8")
    table = page.split(f"<!-- {name} -->\n")[1].split("\n\n")[0]
    assert table.splitlines() == list(TABLES[name]())


def test_the_page_names_what_is_no_metric_and_every_format():
    page = (Path(__file__).parents[1] / "docs" / "exports.md").read_text(encoding="utf-8")
    for word in (*OTHERS, *LISTED):
        assert f"`{word}`" in page
    for form in Format:
        assert f"| `{form}` |" in page


def test_the_columns_of_the_page_are_those_of_a_run(run):
    listed = {row.split("`")[1] for rows in TABLES.values() for row in rows()}
    quantities = run[0]["quantities"]
    for name in (*(name for name in METRICS if name in quantities), *(a["name"] for a in run[0]["axes"])):
        assert quantities[name]["column"] in listed
