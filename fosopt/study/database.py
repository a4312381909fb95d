"""The SQLite file of a run: its tables, how it is opened, and what is said where it cannot be."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fosopt.errors import FosoptError

RECORD = "run.sqlite"
"""Name of the record in the directory of a run."""
SCHEMA_VERSION = 2

APPLICATION_ID = 0x666F736F  # "foso" in ASCII: tells a record from any other SQLite file
_PATIENCE = 30.0  # seconds a reader waits for the writer, and the writer for a reader
_SCHEMA = f"""
BEGIN;
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
CREATE TABLE header (id INTEGER PRIMARY KEY CHECK (id = 1), record TEXT NOT NULL);
CREATE TABLE points (
    key TEXT PRIMARY KEY,
    position INTEGER NOT NULL,
    status TEXT NOT NULL,
    verified INTEGER NOT NULL CHECK (verified IN (0, 1)),
    record TEXT NOT NULL,
    identity TEXT NOT NULL UNIQUE
);
CREATE TABLE answers (
    identity TEXT PRIMARY KEY, status TEXT NOT NULL, objective REAL, finished INTEGER NOT NULL
);
CREATE TABLE arrays (
    owner TEXT NOT NULL,
    place INTEGER NOT NULL,
    kind TEXT NOT NULL,
    shape TEXT NOT NULL,
    data BLOB NOT NULL,
    PRIMARY KEY (owner, place)
);
CREATE TABLE blocks (
    first INTEGER PRIMARY KEY,
    last INTEGER NOT NULL,
    unstable INTEGER NOT NULL,
    failed INTEGER NOT NULL,
    reason TEXT,
    identity TEXT NOT NULL UNIQUE
);
CREATE TABLE inputs (name TEXT PRIMARY KEY, content BLOB NOT NULL);
CREATE TABLE sessions (number INTEGER PRIMARY KEY, record TEXT NOT NULL);
INSERT INTO header VALUES (1, '{{}}');
COMMIT;
"""


_PROBE = "BEGIN IMMEDIATE; UPDATE header SET id = id; COMMIT;"


class StoreError(FosoptError):
    """A record of a run that cannot be written or read."""


def connect(path: Path) -> sqlite3.Connection:
    """A connection in autocommit mode, so that a write is on disk when it returns."""
    # An address, because a plain name would be created where it is missing.
    return sqlite3.connect(
        f"{path.resolve().as_uri()}?mode=rw", uri=True, timeout=_PATIENCE, isolation_level=None
    )


def created(path: Path) -> sqlite3.Connection:
    """A connection to a fresh record, logging ahead where the file system can."""
    try:
        return _prepared(path, "WAL")
    except sqlite3.OperationalError:
        # Network file systems grant the log and fail at its first use, since it needs shared memory.
        path.write_bytes(b"")
        for leftover in ("-wal", "-shm", "-journal"):
            path.with_name(path.name + leftover).unlink(missing_ok=True)
        return _prepared(path, "DELETE")


def opened_to_write(path: Path) -> sqlite3.Connection:
    """A connection to a record that exists, logging ahead where the file system can."""
    try:
        return _prepared(path, "WAL", _PROBE)
    except sqlite3.OperationalError:
        return _prepared(path, "DELETE", _PROBE)


def _prepared(path: Path, journal: str, script: str = _SCHEMA) -> sqlite3.Connection:
    connection = connect(path)
    try:
        connection.execute(f"PRAGMA journal_mode = {journal}")
        # A point that was reported is on disk, also when the power fails.
        connection.execute("PRAGMA synchronous = FULL")
        connection.executescript(script)
    except BaseException:
        connection.close()
        raise
    return connection


def no_record(path: Path) -> str:
    """What is said of a file that is something else."""
    return f"{path}: is not the record of a fosopt run; give the directory of a run or its {RECORD}"


@contextmanager
def said(path: Path) -> Iterator[None]:
    """What SQLite complains about, as one line with a way out."""
    try:
        yield
    except sqlite3.Error as error:
        name, reason = getattr(error, "sqlite_errorname", ""), str(error)
        if name.startswith("SQLITE_NOTADB"):
            message = no_record(path)
        elif name.startswith(("SQLITE_CORRUPT", "SQLITE_ERROR")):
            message = f"{path}: is damaged: {reason}; run the study again"
        elif name.startswith("SQLITE_FULL"):
            message = f"{path}: the disk is full; make room"
        elif name.startswith("SQLITE_IOERR"):
            message = (
                f"{path}: the disk fails to take what is written ({reason}); look at its space and its health"
            )
        elif name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
            message = f"{path}: another program holds the file; close it and try again"
        else:
            message = f"{path}: cannot be used: {reason}; check the directory and its permissions"
        raise StoreError(message) from None
