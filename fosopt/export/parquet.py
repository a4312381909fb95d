"""A front as a Parquet table, for data frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from fosopt.export.columns import about, encoded, front_columns, plain
from fosopt.export.writing import ExportError, written_to


def write_parquet(run: Mapping[str, Any], path: Path) -> None:
    """Write the points as a table with `export.columns.front_columns`, one row each.

    Every column carries its unit as field metadata ``unit``; name and provenance of the run are metadata of the
    table. A missing value is null.

    Parameters
    ----------
    run
        The run data.
    path
        The file to write.

    Raises
    ------
    ExportError
        If the file cannot be written, or pyarrow is not installed.
    """
    pa, parquet = arrow()
    types = {"text": pa.string(), "verdict": pa.bool_(), "number": pa.float64()}
    columns = front_columns(run)
    schema = arrow_schema(columns, [types[column.kind] for column in columns], run)
    arrays = [pa.array([_plain(value) for value in column.values], types[column.kind]) for column in columns]
    with written_to(path) as temporary:
        parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), temporary)


class Named(Protocol):
    """A column with a name and a unit."""

    @property
    def name(self) -> str:
        """Unique in the table."""

    @property
    def unit(self) -> str:
        """Of its numbers; empty for texts."""


def arrow() -> tuple[Any, Any]:
    """Pyarrow, and its part that writes Parquet.

    Raises
    ------
    ExportError
        If pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise ExportError("Parquet needs pyarrow; install it: pip install 'fosopt[parquet]'") from None
    return pa, parquet


def arrow_schema(columns: Sequence[Named], kinds: Sequence[Any], run: Mapping[str, Any]) -> Any:
    """Columns of pyarrow's kinds with their units, and what is known about the run."""
    pa, _ = arrow()
    fields = [
        pa.field(column.name, kind, metadata={"unit": column.unit} if column.unit else None)
        for column, kind in zip(columns, kinds, strict=True)
    ]
    return pa.schema(fields, {key: encoded(text) for key, text in about(run).items()})


def _plain(value: object) -> object:
    if isinstance(value, str):
        return plain(value)
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value
