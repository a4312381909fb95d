"""The record of a run: nothing is lost, nothing is changed, and what is no record is said to be none."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fake_run import fake_run, point
from hypothesis import given
from hypothesis import strategies as st

from fosopt.errors import FosoptError
from fosopt.study.blobs import array, blob
from fosopt.study.store import RECORD, SCHEMA_VERSION, Answered, Store

HEADER = {name: value for name, value in fake_run().items() if name != "points"}
FLOATS = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / RECORD


def complaint(path: Path) -> str:
    with pytest.raises(FosoptError) as caught, Store.open(path) as store:
        store.run()
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


def test_a_run_comes_back_as_it_was_written_in_the_order_of_positions(path):
    points = [point("start", "evaluated"), point("000"), point("001", "unstable")]
    with Store.create(path, HEADER) as store:
        for position in (2, 0, 1):
            store.write_point(position, points[position])
        assert store.run() == fake_run(*points)
    with Store.open(path) as store:
        assert store.run() == fake_run(*points)


@given(st.lists(FLOATS, min_size=1, max_size=20))
def test_every_bit_of_a_float_survives(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("bits") / RECORD
    with Store.create(path, HEADER) as store:
        store.write_point(0, point("000", variables={"area": values}))
    with Store.open(path) as store:
        found = store.run()["points"][0]["variables"]["area"]
    assert [struct.pack("d", value) for value in found] == [struct.pack("d", value) for value in values]


def test_a_point_written_again_replaces_the_one_with_its_key(path):
    with Store.create(path, HEADER) as store:
        store.write_point(0, point("000"))
        store.write_point(0, point("000", dominated=True, verified=False))
        assert store.run()["points"] == [point("000", dominated=True, verified=False)]
    with sqlite3.connect(path) as connection:
        rows = connection.execute("SELECT key, position, status, verified FROM points").fetchall()
    connection.close()
    assert rows == [("000", 0, "optimal", 0)]


def test_the_end_of_a_run_updates_its_header(path):
    with Store.create(path, HEADER) as store:
        store.finish({"interrupted": True, "comparison": [{"at": {"structural_mass": 9.0}}]})
    with Store.open(path) as store:
        run = store.run()
    assert run == {**fake_run(), "interrupted": True, "comparison": [{"at": {"structural_mass": 9.0}}]}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_number_that_is_not_finite_is_refused_and_leaves_no_trace(path, value):
    with pytest.raises(ValueError, match="JSON"):
        Store.create(path, {**HEADER, "requirements": {"jitter_total": value}})
    assert not path.exists()
    with Store.create(path, HEADER) as store:
        with pytest.raises(ValueError, match="JSON"):
            store.write_point(0, point("000", kkt_residual=value))
        with pytest.raises(ValueError, match="JSON"):
            store.finish({"comparison": [value]})
        assert store.run() == fake_run()


def test_a_record_has_one_writer(path):
    with Store.create(path, HEADER):
        with pytest.raises(FosoptError, match=r"exists already; give a directory"):
            Store.create(path, HEADER)
        with Store.open(path) as reader, pytest.raises(FosoptError, match="readonly"):
            reader.write_point(0, point("000"))


def test_a_reader_sees_each_point_once_it_is_written(path):
    with Store.create(path, HEADER) as store, Store.open(path) as reader:
        for position in range(3):
            store.write_point(position, point(f"{position:03d}"))
            assert len(reader.run()["points"]) == position + 1


WRITER = """
import os, signal, sys
from pathlib import Path
sys.path[:0] = sys.argv[2:]
from fake_run import fake_run, point
from fosopt.study.store import Store
store = Store.create(Path(sys.argv[1]), {k: v for k, v in fake_run().items() if k != "points"})
for position in range(20):
    store.write_point(position, point(f"{position:03d}"))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_process_loses_no_point_it_has_written(path):
    here = Path(__file__).parent
    killed = subprocess.run([sys.executable, "-c", WRITER, path, here, here.parent], check=False)
    assert killed.returncode == -signal.SIGKILL
    with Store.open(path) as store:
        assert [each["key"] for each in store.run()["points"]] == [f"{k:03d}" for k in range(20)]


def test_a_complete_record_is_a_single_file(path):
    with Store.create(path, HEADER) as store:
        store.write_point(0, point("000"))
        assert os.listdir(path.parent) != [RECORD]
    assert os.listdir(path.parent) == [RECORD]


class NoSharedMemory(sqlite3.Connection):
    """A file system that grants the write-ahead log and fails at its first use, as some networked ones do."""

    def executescript(self, script):
        if self.execute("PRAGMA journal_mode").fetchone()[0] == "wal":
            raise sqlite3.OperationalError("locking protocol")
        return super().executescript(script)


def test_where_there_is_no_write_ahead_log_a_journal_does(path, monkeypatch):
    connect = sqlite3.connect
    monkeypatch.setattr(
        sqlite3, "connect", lambda *args, **more: connect(*args, factory=NoSharedMemory, **more)
    )
    with Store.create(path, HEADER) as store:
        assert store._connection.execute("PRAGMA journal_mode").fetchone() == ("delete",)
        store.write_point(0, point("000"))
    with Store.open(path) as store:
        assert store.run() == fake_run(point("000"))


def test_what_is_no_record_is_refused(path, tmp_path):
    assert "no such file; give the directory of a run or its run.sqlite" in complaint(path)
    for content in (b"", b"fosopt: 1\n" * 100):
        path.write_bytes(content)
        assert "is not the record of a fosopt run; give" in complaint(path)
        assert path.read_bytes() == content
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE header (id, record)")
    connection.close()
    assert "is not the record of a fosopt run; give" in complaint(other)


def test_a_record_of_a_newer_version_is_refused(path):
    Store.create(path, HEADER).close()
    with sqlite3.connect(path) as connection:
        connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    connection.close()
    assert (
        f"newer fosopt (record version {SCHEMA_VERSION + 1}, this one reads {SCHEMA_VERSION})"
        in complaint(path)
    )


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE points SET record = substr(record, 1, 40)",
        "UPDATE points SET record = '[1]'",
        "UPDATE points SET record = replace(record, '12', 'NaN')",
        "UPDATE points SET record = x'ff00'",
        "DELETE FROM header",
        "DROP TABLE points",
    ],
)
def test_damaged_content_is_refused(path, damage):
    with Store.create(path, HEADER) as store:
        store.write_point(0, point("000"))
    with sqlite3.connect(path) as connection:
        connection.execute(damage)
    connection.close()
    assert "is damaged: " in complaint(path)


def test_a_truncated_file_is_refused(path):
    with Store.create(path, HEADER) as store:
        for position in range(50):
            store.write_point(position, point(f"{position:03d}"))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert "is damaged: " in complaint(path)


def test_a_directory_that_cannot_be_written_is_said(path, tmp_path):
    with pytest.raises(FosoptError, match=r"cannot be written: No such file .*; give another directory"):
        Store.create(tmp_path / "absent" / RECORD, HEADER)
    path.write_text("")
    with pytest.raises(FosoptError, match=r"cannot be written: Not a directory; give another directory"):
        Store.create(path / RECORD, HEADER)


def test_a_full_disk_is_said_and_what_was_written_stays(path):
    with Store.create(path, HEADER) as store:
        store.write_point(0, point("000"))
        (pages,) = store._connection.execute("PRAGMA page_count").fetchone()
        store._connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(FosoptError, match=r"the disk is full; make room"):
            store.write_point(1, point("001", label="x" * 100_000))
    with Store.open(path) as store:
        assert store.run() == fake_run(point("000"))


def test_the_record_is_json_that_other_programs_read(path):
    with Store.create(path, HEADER) as store:
        store.write_point(0, point("000"))
    with sqlite3.connect(path) as connection:
        (text,) = connection.execute("SELECT record FROM points").fetchone()
    connection.close()
    assert json.loads(text) == point("000")


@given(st.lists(st.tuples(FLOATS, FLOATS), min_size=8, max_size=12), st.lists(FLOATS, max_size=40))
def test_long_lists_are_typed_blobs_that_come_back_bit_for_bit(tmp_path_factory, pairs, values):
    path = tmp_path_factory.mktemp("blobs") / RECORD
    detail = {"poles": [list(pair) for pair in pairs], "values": values, "mixed": [1, 2.0] * 20}
    with Store.create(path, HEADER) as store:
        store.write_point(0, point("000", detail=detail))
        kinds = {row[0] for row in store._connection.execute("SELECT kind FROM arrays")}
        found = store.run()["points"][0]["detail"]
    assert kinds == {"<f8"}
    assert repr(found) == repr(detail), "signs of zero and whole numbers are kept"


def test_only_numbers_and_truth_values_become_blobs():
    for values in (np.arange(3), np.array([True, False]), np.ones((2, 3)), np.zeros(0)):
        found = array(*blob(values))
        assert (found.tolist(), found.shape, found.dtype) == (values.tolist(), values.shape, values.dtype)
    with pytest.raises(TypeError, match="an array of object is not stored"):
        blob(np.array([object()]))
    with pytest.raises(ValueError, match="is no element type of a record"):
        array("|O", "[1]", b"12345678")


def test_an_array_that_does_not_fit_its_shape_is_damage(path):
    with Store.create(path, HEADER) as store:
        store.write_point(0, point("000"), answer=Answered(np.ones(3), "optimal", 1.0))
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE arrays SET shape = '[4]'")
    connection.close()
    with Store.open(path) as store, pytest.raises(FosoptError, match="is damaged: an array does not fit"):
        store.answers()


def test_a_record_of_the_first_version_is_read_and_not_continued(path):
    with Store.create(path, HEADER) as store:
        store.write_point(0, point("000"))
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 1")
    connection.close()
    with Store.open(path) as store:
        assert store.run() == fake_run(point("000"))
    with pytest.raises(FosoptError, match=r"written by an older fosopt \(record version 1\)"):
        Store.resume(path)
