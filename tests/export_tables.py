"""Tables of docs/exports.md, from fosopt's own lists; `python tests/export_tables.py` prints them."""

from __future__ import annotations

from collections.abc import Iterator

from fosopt.study.schema_names import BOUNDS, JITTER, METRICS, QUANTITIES, Metric
from fosopt.study.schema_sweep import AXES, ONE_MINUS, STABLE
from fosopt.units import DIMENSIONS, column


def column_row(name: str, metric: Metric) -> str:
    kind = DIMENSIONS[metric.dimension]
    suffix = column(metric.dimension)[1]
    return f"| `{name}_{suffix}` | {kind.column_unit or kind.unit} | {metric.meaning} |".replace("_`", "`")


def metric_rows() -> Iterator[str]:
    """One row for each metric with one value."""
    yield from (column_row(name, metric) for name, metric in METRICS.items() if not metric.indexed)
    yield column_row("jitter_<disturbance>", JITTER)


def bound_rows() -> Iterator[str]:
    yield from (column_row(name, metric) for name, metric in BOUNDS.items())


def mode_rows() -> Iterator[str]:
    """One row for each metric of a mode."""
    yield from (column_row(name, metric) for name, metric in METRICS.items() if metric.indexed)


def variable_rows() -> Iterator[str]:
    """One row for each design variable and axis of a sweep whose unit is known beforehand."""
    known = {name: kind for name, kind in QUANTITIES.items() if kind is not None}
    known |= {name: axis.dimension for name, axis in AXES.items() if axis.dimension is not None}
    for name, dimension in known.items():
        used = [use for use, names in (("variable", QUANTITIES), ("axis", AXES)) if name in names]
        yield column_row(name, Metric(dimension, "", ", ".join(used)))


TABLES = {"metrics": metric_rows, "bounds": bound_rows, "modes": mode_rows, "variables": variable_rows}
OTHERS = (STABLE, ONE_MINUS)

if __name__ == "__main__":
    for title, rows in TABLES.items():
        print(f"<!-- {title} -->")
        print("\n".join(rows()))
