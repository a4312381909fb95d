"""The record of a run: one SQLite file that holds every finished point, whatever happens to the process.

The header and each point are JSON, in which a float keeps all its bits, and their long lists of floats are typed
blobs. The process that created or resumed a record is the only one that writes to it; others may read at any time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from fosopt.ops import Array
from fosopt.study.blobs import blob, packed
from fosopt.study.database import RECORD, SCHEMA_VERSION, StoreError, said
from fosopt.study.record import Record

__all__ = ["RECORD", "SCHEMA_VERSION", "Answered", "Block", "Store", "StoreError"]

_DESIGN = -1  # place of the vector of all variables among the arrays of a point


@dataclass(frozen=True)
class Answered:
    """What the solver said to one request of a plan.

    Attributes
    ----------
    x
        (n,) values of all variables.
    status, objective
        As the solver saw it; NaN for no value.
    """

    x: Array
    status: str
    objective: float


@dataclass(frozen=True)
class Block:
    """Points of a sweep that were computed together, `first` to before `last`, and what became of them."""

    first: int
    last: int
    unstable: int
    failed: int
    reason: str | None


class Store(Record):
    """The record of a run: its points, and what is known of those to come."""

    def write_point(
        self,
        position: int,
        point: Mapping[str, object],
        identity: str | None = None,
        answer: Answered | None = None,
        session: Mapping[str, object] | None = None,
    ) -> None:
        """Add a point, or replace the one with its key.

        Parameters
        ----------
        position
            Where it stands among the points of the run [-].
        point
            A point of the run data.
        identity
            What is unique to its study and coordinates; that of the point it replaces, or else its key.
        answer
            What the solver said, where other points depend on it.
        session
            The record of the session so far, written with the point.

        Raises
        ------
        StoreError
            If the file can no longer be written.
        ValueError
            If a number of the point is not finite.
        """
        text, blobs = packed(point)
        key = str(point["key"])
        with said(self.path), self._transaction():
            known = self._connection.execute("SELECT identity FROM points WHERE key = ?", (key,)).fetchone()
            owner = identity or (known[0] if known else key)
            self._execute("DELETE FROM points WHERE key = ?", key)
            self._execute("DELETE FROM arrays WHERE owner = ? AND place >= 0", owner)
            self._execute(
                "INSERT INTO points VALUES (?, ?, ?, ?, ?, ?)",
                *(key, position, str(point["status"]), bool(point["verified"]), text, owner),
            )
            self._write_arrays(owner, dict(enumerate(blobs)))
            if answer is not None:
                self._write_answer(owner, answer, finished=point["status"] != "interrupted")
            if session is not None:
                self._write_session(session)

    def mark(self, key: str, point: Mapping[str, object]) -> None:
        """Replace what is said of a point that is there.

        Raises
        ------
        StoreError
            If the file can no longer be written.
        """
        with said(self.path):
            (position,) = self._connection.execute(
                "SELECT position FROM points WHERE key = ?", (key,)
            ).fetchone()
        self.write_point(position, point)

    def write_answer(self, identity: str, answer: Answered) -> None:
        """Add an answer that is no point of the run, but that points depend on.

        Raises
        ------
        StoreError
            If the file can no longer be written.
        """
        with said(self.path), self._transaction():
            self._write_answer(identity, answer, finished=answer.status != "interrupted")

    def answers(self) -> dict[str, Answered]:
        """What is known already by identity; an interrupted answer is none.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        with said(self.path):
            rows = self._connection.execute(
                "SELECT identity, status, objective, kind, shape, data FROM answers JOIN arrays "
                "ON owner = identity AND place = ? WHERE finished",
                (_DESIGN,),
            ).fetchall()
        nan = float("nan")
        return {
            identity: Answered(self._array(*stored), status, nan if value is None else value)
            for identity, status, value, *stored in rows
        }

    def tally(self) -> list[tuple[str, str, bool]]:
        """Key, status and whether it is verified, of each point in its position.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        with said(self.path):
            rows = self._connection.execute(
                "SELECT key, status, verified FROM points ORDER BY position, key"
            ).fetchall()
        return [(key, status, bool(verified)) for key, status, verified in rows]

    def best(self, names: Sequence[str]) -> dict[str, float]:
        """The least value of metrics among verified points but the start design, where there is one.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        found = {}
        with said(self.path):
            for name in names:
                statement = (
                    "SELECT min(json_extract(record, ?)) FROM points WHERE verified AND key != 'start'"
                )
                (value,) = self._connection.execute(statement, (f'$.metrics."{name}"',)).fetchone()
                if value is not None:
                    found[name] = float(value)
        return found

    def write_block(
        self, block: Block, identity: str, arrays: Mapping[int, Array], session: Mapping[str, object]
    ) -> None:
        """Add points of a sweep, with their arrays by place and the record of the session so far.

        Raises
        ------
        StoreError
            If the file can no longer be written.
        """
        with said(self.path), self._transaction():
            self._execute(
                "INSERT INTO blocks VALUES (?, ?, ?, ?, ?, ?)",
                *(block.first, block.last, block.unstable, block.failed, block.reason, identity),
            )
            self._write_arrays(identity, {place: blob(values) for place, values in arrays.items()})
            self._write_session(session)

    def blocks(self) -> list[Block]:
        """The blocks of a sweep that are finished, in the order of their points.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        with said(self.path):
            rows = self._connection.execute(
                "SELECT first, last, unstable, failed, reason FROM blocks ORDER BY first"
            ).fetchall()
        return [Block(*row) for row in rows]

    def block_arrays(self, first: int) -> dict[int, Array]:
        """Arrays of the block that begins at a point, by place.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        with said(self.path):
            rows = self._connection.execute(
                "SELECT place, kind, shape, data FROM blocks JOIN arrays ON owner = identity WHERE first = ?",
                (first,),
            ).fetchall()
        return {place: self._array(*stored) for place, *stored in rows}

    def run(self) -> dict[str, Any]:
        """The run data, with the points in the order of their positions.

        Raises
        ------
        StoreError
            If the record is damaged.
        """
        with said(self.path):
            # One transaction, so that header and points are of one moment.
            self._execute("BEGIN")
            try:
                header = self.header()
                first = self.version < 2
                rows = self._connection.execute(
                    f"SELECT {'key' if first else 'identity'}, record FROM points ORDER BY position, key"
                ).fetchall()
                stored: list[tuple[Any, ...]] = []
                if not first:
                    stored = self._connection.execute(
                        "SELECT owner, place, kind, shape, data FROM arrays WHERE place >= 0 "
                        "AND owner IN (SELECT identity FROM points) ORDER BY owner"
                    ).fetchall()
            finally:
                self._execute("ROLLBACK")
            owners = groupby(stored, lambda row: row[0])
            blobs = {owner: {place: (k, s, d) for _, place, k, s, d in each} for owner, each in owners}
            return {**header, "points": [self._parsed(text, blobs.get(owner)) for owner, text in rows]}

    def _write_answer(self, identity: str, answer: Answered, *, finished: bool) -> None:
        objective = answer.objective if abs(answer.objective) < float("inf") else None
        self._execute(
            "INSERT OR REPLACE INTO answers VALUES (?, ?, ?, ?)",
            *(identity, answer.status, objective, finished),
        )
        self._write_arrays(identity, {_DESIGN: blob(answer.x)})
