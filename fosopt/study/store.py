"""The record of a run: one SQLite file that holds every finished point, whatever happens to the process.

The header and each point are JSON, in which a float keeps all its bits. The process that creates a record is
the only one that writes to it; others may read at any time.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

from fosopt.errors import FosoptError

RECORD = "run.sqlite"
"""Name of the record in the directory of a run."""
SCHEMA_VERSION = 1

_APPLICATION_ID = 0x666F736F  # "foso" in ASCII: tells a record from any other SQLite file
_PATIENCE = 30.0  # seconds a reader waits for the writer, and the writer for a reader
_SCHEMA = f"""
BEGIN;
PRAGMA application_id = {_APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
CREATE TABLE header (id INTEGER PRIMARY KEY CHECK (id = 1), record TEXT NOT NULL);
CREATE TABLE points (
    key TEXT PRIMARY KEY,
    position INTEGER NOT NULL,
    status TEXT NOT NULL,
    verified INTEGER NOT NULL CHECK (verified IN (0, 1)),
    record TEXT NOT NULL
);
INSERT INTO header VALUES (1, '{{}}');
COMMIT;
"""


class StoreError(FosoptError):
    """A record of a run that cannot be written or read."""


class Store:
    """An open record; `create` or `open` makes one, and it is a context manager.

    Parameters
    ----------
    path
        The SQLite file.
    connection
        In autocommit mode, so that a write is on disk when it returns.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection

    @classmethod
    def create(cls, path: Path, header: Mapping[str, object]) -> Self:
        """Start a record and become its only writer.

        Parameters
        ----------
        path
            A file that does not exist, in a directory that does.
        header
            The run data but for its points.

        Raises
        ------
        StoreError
            If the file exists or cannot be written.
        ValueError
            If a number of the header is not finite.
        """
        text = _json(header)
        try:
            path.touch(exist_ok=False)
        except FileExistsError:
            raise StoreError(f"{path}: exists already; give a directory without a run") from None
        except OSError as error:
            reason = error.strerror or str(error)
            raise StoreError(f"{path}: cannot be written: {reason}; give another directory") from None
        try:
            with _said(path):
                store = cls(path, _written_to(path))
                store._execute("UPDATE header SET record = ?", text)
        except StoreError:
            path.unlink(missing_ok=True)
            raise
        return store

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a record to read it, also while its run goes on or after its run was killed.

        Raises
        ------
        StoreError
            If there is no record, or it is damaged or written by a newer fosopt.
        """
        if not path.is_file():
            raise StoreError(f"{path}: no such file; give the directory of a run or its {RECORD}")
        with _said(path):
            # Opened for writing because what a killed process left half done is rolled back by the reader;
            # SQLite opens the file for reading where that is all the permissions allow.
            connection = _connect(path)
            try:
                connection.execute("PRAGMA query_only = ON")
                application, version = (
                    connection.execute(f"PRAGMA {name}").fetchone()[0]
                    for name in ("application_id", "user_version")
                )
                if application != _APPLICATION_ID:
                    raise StoreError(_no_record(path))
                if version > SCHEMA_VERSION:
                    raise StoreError(
                        f"{path}: written by a newer fosopt (record version {version}, this one reads "
                        f"{SCHEMA_VERSION}); update fosopt"
                    )
            except BaseException:
                connection.close()
                raise
        return cls(path, connection)

    def write_point(self, position: int, point: Mapping[str, object]) -> None:
        """Add a point, or replace the one with its key.

        Parameters
        ----------
        position
            Where it stands among the points of the run [-].
        point
            A point of the run data.

        Raises
        ------
        StoreError
            If the file can no longer be written.
        ValueError
            If a number of the point is not finite.
        """
        text = _json(point)
        with _said(self.path):
            self._execute(
                "INSERT INTO points VALUES (?, ?, ?, ?, ?) ON CONFLICT (key) DO UPDATE SET "
                "position = excluded.position, status = excluded.status, "
                "verified = excluded.verified, record = excluded.record",
                *(str(point["key"]), position, str(point["status"]), bool(point["verified"]), text),
            )

    def finish(self, header_updates: Mapping[str, object]) -> None:
        """Replace entries of the header by what is known at the end of the run.

        Raises
        ------
        StoreError
            If the file can no longer be written.
        ValueError
            If a number is not finite.
        """
        with _said(self.path):
            header = self._header()
            self._execute("UPDATE header SET record = ?", _json({**header, **header_updates}))

    def run(self) -> dict[str, Any]:
        """The run data, with the points in the order of their positions.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        with _said(self.path):
            # One transaction, so that header and points are of one moment.
            self._execute("BEGIN")
            try:
                header = self._header()
                rows = self._connection.execute("SELECT record FROM points ORDER BY position, key").fetchall()
            finally:
                self._execute("ROLLBACK")
            return {**header, "points": [self._parsed(text) for (text,) in rows]}

    def close(self) -> None:
        """Close the record; a complete one is then a single file that may be copied or write-protected."""
        # With a reader at work the log stays beside the file, and the last one to leave merges it.
        with suppress(sqlite3.Error):
            self._connection.execute("PRAGMA busy_timeout = 0")
            self._connection.execute("PRAGMA journal_mode = DELETE")
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _execute(self, statement: str, *values: object) -> None:
        self._connection.execute(statement, values)

    def _header(self) -> dict[str, Any]:
        row = self._connection.execute("SELECT record FROM header").fetchone()
        return self._parsed(row[0] if row else "")

    def _parsed(self, text: str) -> dict[str, Any]:
        try:
            record = json.loads(text, parse_constant=_refuse)
        except (TypeError, ValueError):
            record = None
        if not isinstance(record, dict):
            raise StoreError(f"{self.path}: is damaged: an entry is no record; run the study again")
        return record


def _connect(path: Path) -> sqlite3.Connection:
    # An address, because a plain name would be created where it is missing.
    return sqlite3.connect(
        f"{path.resolve().as_uri()}?mode=rw", uri=True, timeout=_PATIENCE, isolation_level=None
    )


def _written_to(path: Path) -> sqlite3.Connection:
    """A connection to a fresh record, logging ahead where the file system can."""
    try:
        return _prepared(path, "WAL")
    except sqlite3.OperationalError:
        # Network file systems grant the log and fail at its first use, since it needs shared memory.
        path.write_bytes(b"")
        for leftover in ("-wal", "-shm", "-journal"):
            path.with_name(path.name + leftover).unlink(missing_ok=True)
        return _prepared(path, "DELETE")


def _prepared(path: Path, journal: str) -> sqlite3.Connection:
    connection = _connect(path)
    try:
        connection.execute(f"PRAGMA journal_mode = {journal}")
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.executescript(_SCHEMA)
    except BaseException:
        connection.close()
        raise
    return connection


def _json(value: Mapping[str, object]) -> str:
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no JSON")


def _no_record(path: Path) -> str:
    return f"{path}: is not the record of a fosopt run; give the directory of a run or its {RECORD}"


@contextmanager
def _said(path: Path) -> Iterator[None]:
    """What SQLite complains about, as one line with a way out."""
    try:
        yield
    except sqlite3.Error as error:
        name, reason = getattr(error, "sqlite_errorname", ""), str(error)
        if name.startswith("SQLITE_NOTADB"):
            message = _no_record(path)
        elif name.startswith(("SQLITE_CORRUPT", "SQLITE_ERROR")):
            message = f"{path}: is damaged: {reason}; run the study again"
        elif name.startswith("SQLITE_FULL"):
            message = f"{path}: the disk is full; make room or give another directory"
        elif name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
            message = f"{path}: another program holds the file; close it and try again"
        else:
            message = f"{path}: cannot be used: {reason}; check the directory and its permissions"
        raise StoreError(message) from None
