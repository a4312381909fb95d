"""A record: an SQLite file with a header, what it was made from, sessions and arrays; what all runs have in common.

The header is JSON, in which a float keeps all its bits. The process that created or resumed a record is the only one
that writes to it; others may read at any time.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fosopt.files import replacing
from fosopt.ops import Array
from fosopt.study.blobs import Blob, array, unpacked
from fosopt.study.database import (
    APPLICATION_ID,
    RECORD,
    SCHEMA_VERSION,
    StoreError,
    connect,
    created,
    no_record,
    opened_to_write,
    said,
)


class Record:
    """An open record; `create`, `open` or `resume` makes one, and it is a context manager.

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
    def create(
        cls, path: Path, header: Mapping[str, object], inputs: Mapping[str, bytes] | None = None
    ) -> Self:
        """Start a record and become its only writer; a record that exists is complete.

        Parameters
        ----------
        path
            A file that does not exist, in a directory that does.
        header
            The run data but for its points.
        inputs
            What the run is made from, by name.

        Raises
        ------
        StoreError
            If the file exists or cannot be written.
        ValueError
            If a number of the header is not finite.
        """
        text = _json(header)
        if path.exists():
            raise StoreError(f"{path}: exists already; give a directory without a run")
        try:
            with replacing(path) as temporary:
                temporary.touch(exist_ok=False)
                with said(path), cls(path, created(temporary)) as store:
                    store._execute("UPDATE header SET record = ?", text)
                    store.write_inputs(inputs or {})
        except OSError as error:
            reason = error.strerror or str(error)
            raise StoreError(f"{path}: cannot be written: {reason}; give another directory") from None
        return cls.resume(path)

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
        with said(path):
            # Opened for writing because what a killed process left half done is rolled back by the reader;
            # SQLite opens the file for reading where that is all the permissions allow.
            connection = connect(path)
            try:
                connection.execute("PRAGMA query_only = ON")
                application, version = (
                    connection.execute(f"PRAGMA {name}").fetchone()[0]
                    for name in ("application_id", "user_version")
                )
                if application != APPLICATION_ID:
                    raise StoreError(no_record(path))
                if version > SCHEMA_VERSION:
                    raise StoreError(
                        f"{path}: written by a newer fosopt (record version {version}, this one reads "
                        f"{SCHEMA_VERSION}); update fosopt"
                    )
            except BaseException:
                connection.close()
                raise
        return cls(path, connection)

    @classmethod
    def resume(cls, path: Path) -> Self:
        """Open a record to go on writing it; the caller sees to it that nobody else does.

        Raises
        ------
        StoreError
            As `open`; also where the record was written by an older fosopt.
        """
        with cls.open(path) as reader, said(path):
            if reader.version < SCHEMA_VERSION:
                raise StoreError(
                    f"{path}: written by an older fosopt (record version {reader.version}); it can be read but not "
                    "continued: run the study again"
                )
        with said(path):
            return cls(path, opened_to_write(path))

    @property
    def version(self) -> int:
        """Of the record's schema."""
        return int(self._connection.execute("PRAGMA user_version").fetchone()[0])

    @property
    def journal(self) -> str:
        """How SQLite keeps an unfinished write from harm: ``wal`` or ``delete``."""
        return str(self._connection.execute("PRAGMA journal_mode").fetchone()[0])

    def write_inputs(self, inputs: Mapping[str, bytes]) -> None:
        """Keep what the run was made from, by name.

        Raises
        ------
        StoreError
            If the file can no longer be written.
        """
        with said(self.path), self._transaction():
            for name, content in inputs.items():
                self._execute("INSERT OR REPLACE INTO inputs VALUES (?, ?)", name, content)

    def inputs(self) -> dict[str, bytes]:
        """What the run was made from, by name.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        with said(self.path):
            return dict(self._connection.execute("SELECT name, content FROM inputs").fetchall())

    def write_session(self, session: Mapping[str, object]) -> None:
        """Add the record of a session, or replace the one with its number.

        Raises
        ------
        StoreError
            If the file can no longer be written.
        """
        with said(self.path), self._transaction():
            self._write_session(session)

    def sessions(self) -> list[dict[str, Any]]:
        """The sessions of the run: the one that began it, and those that continued it.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        with said(self.path):
            rows = self._connection.execute("SELECT record FROM sessions ORDER BY number").fetchall()
            return [self._parsed(text) for (text,) in rows]

    def finish(self, header_updates: Mapping[str, object]) -> None:
        """Replace entries of the header by what is known at the end of the run.

        Raises
        ------
        StoreError
            If the file can no longer be written.
        ValueError
            If a number is not finite.
        """
        with said(self.path):
            header = self.header()
            self._execute("UPDATE header SET record = ?", _json({**header, **header_updates}))

    def header(self) -> dict[str, Any]:
        """The run data but for its points.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        with said(self.path):
            row = self._connection.execute("SELECT record FROM header").fetchone()
            return self._parsed(row[0] if row else "")

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

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._execute("BEGIN IMMEDIATE")
        try:
            yield
            self._execute("COMMIT")
        except BaseException:
            # After a full disk SQLite may have rolled back on its own.
            with suppress(sqlite3.Error):
                self._execute("ROLLBACK")
            raise

    def _write_arrays(self, owner: str, blobs: Mapping[int, Blob]) -> None:
        self._connection.executemany(
            "INSERT OR REPLACE INTO arrays VALUES (?, ?, ?, ?, ?)",
            ((owner, place, *stored) for place, stored in blobs.items()),
        )

    def _write_session(self, session: Mapping[str, object]) -> None:
        self._execute("INSERT OR REPLACE INTO sessions VALUES (?, ?)", session["number"], _json(session))

    def _array(self, kind: str, shape: str, data: bytes) -> Array:
        try:
            return array(kind, shape, data)
        except (TypeError, ValueError):
            raise self._damaged("an array does not fit its shape") from None

    def _parsed(self, text: str, blobs: Mapping[int, Blob] | None = None) -> dict[str, Any]:
        try:
            record = unpacked(text, blobs or {})
        except (TypeError, ValueError, KeyError):
            record = None
        if not isinstance(record, dict):
            raise self._damaged("an entry is no record")
        return record

    def _damaged(self, what: str) -> StoreError:
        return StoreError(f"{self.path}: is damaged: {what}; run the study again")


def _json(value: Mapping[str, object]) -> str:
    return json.dumps(value, allow_nan=False, separators=(",", ":"))
