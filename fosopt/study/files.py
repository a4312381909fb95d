"""Side files of a study: PSD tables and damping tables in CSV."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fosopt.errors import StudyError
from fosopt.study.schema_names import SIGNAL
from fosopt.study.source import read_text
from fosopt.units import DIMENSIONS, HZ, QuantityError, parse_quantity, quote

if TYPE_CHECKING:
    from fosopt.study.schema import Study
    from fosopt.study.schema_system import Disturbance

_MOST_ROWS = 200_000


@dataclass(frozen=True)
class PsdTable:
    """A one-sided power spectral density over frequency.

    Parameters
    ----------
    frequency
        (n_row,) Ascending and positive [rad/s].
    psd
        (n_row,) One-sided, per ordinary hertz [(N m)²/Hz or rad²/Hz].
    """

    frequency: tuple[float, ...]
    psd: tuple[float, ...]


@dataclass(frozen=True)
class DampingTable:
    """Damping ratios over frequency.

    Parameters
    ----------
    frequency
        (n_row,) Ascending [rad/s].
    damping_ratio
        (n_row,) Of a mode at that frequency [-].
    """

    frequency: tuple[float, ...]
    damping_ratio: tuple[float, ...]


def side_files(study: Study) -> tuple[Path, ...]:
    """Paths of the side files the study reads."""
    names = [disturbance.psd for disturbance in study.disturbances if disturbance.psd is not None]
    if isinstance(study.damping.table, str):
        names.append(study.damping.table)
    return tuple(study.base / name for name in names)


def read_psd(study: Study, disturbance: Disturbance) -> PsdTable:
    """The PSD table of a disturbance, with the header ``frequency_hz,psd_<unit>^2/Hz``.

    Raises
    ------
    StudyError
        For a file that is missing, has another header or unit, fewer than two rows, or a value that is
        not finite, negative or out of order; or a band that leaves the table.
    """
    signal = SIGNAL[disturbance.at]
    file = study.base / (disturbance.psd or "")
    header, rows = _read(file, f"frequency_hz,psd_{'N m' if signal == 'torque' else 'rad'}^2/Hz")
    unit = header.removeprefix("psd_").removesuffix("^2/Hz")
    if not (header.startswith("psd_") and header.endswith("^2/Hz")):
        unit = ""
    try:
        factor = parse_quantity(f"1 {unit}", signal) if unit else math.nan
    except QuantityError:
        factor = math.nan
    if not factor > 0:
        shown = DIMENSIONS[signal].unit
        message = f"{quote(header)} names no PSD of the signal's unit; write psd_{shown}^2/Hz"
        raise StudyError(message, file=file, line=1, column=len("frequency_hz,") + 1)
    frequency, psd = _numbers(file, rows, "PSD", math.inf)
    table = PsdTable(frequency, tuple(value * factor**2 for value in psd))
    if disturbance.band is not None and not (
        frequency[0] <= disturbance.band[0] * (1 + 1e-9) and disturbance.band[1] <= frequency[-1] * (1 + 1e-9)
    ):
        message = (
            f"the band of '{disturbance.name}' leaves the table, which covers {frequency[0] / HZ:.6g} to "
            f"{frequency[-1] / HZ:.6g} Hz; narrow the band or extend the table"
        )
        raise StudyError(message, file=file)
    return table


def read_damping(study: Study) -> DampingTable:
    """The damping table of the study, from its file or as given.

    The file has the header ``frequency_hz,damping_ratio``.

    Raises
    ------
    StudyError
        For a file that is missing, has another header, fewer than two rows, or a value that is not
        finite, negative, too large or out of order.
    """
    table = study.damping.table
    if not isinstance(table, str):
        rows = table or ()
        return DampingTable(tuple(row[0] for row in rows), tuple(row[1] for row in rows))
    file = study.base / table
    header, lines = _read(file, "frequency_hz,damping_ratio")
    if header != "damping_ratio":
        message = f"{quote(header)} is not 'damping_ratio'; write the header frequency_hz,damping_ratio"
        raise StudyError(message, file=file, line=1, column=len("frequency_hz,") + 1)
    return DampingTable(*_numbers(file, lines, "damping ratio", 1.0))


_Rows = list[tuple[int, list[str]]]


def _read(file: Path, header: str) -> tuple[str, _Rows]:
    """Name of the second column, and the rows with their line numbers."""
    lines = read_text(file, str(file)).splitlines()
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    if len(names) != 2 or names[0] != "frequency_hz":
        found = quote(lines[0]) if lines else "an empty file"
        raise StudyError(f"{found} is not the header; write {header}", file=file, line=1, column=1)
    rows = [(k, line.split(",")) for k, line in enumerate(lines[1:], 2) if line.strip()]
    if not 2 <= len(rows) <= _MOST_ROWS:
        rule = "at least 2 are needed" if len(rows) < 2 else f"at most {_MOST_ROWS} are read"
        raise StudyError(f"{len(rows)} rows of numbers; {rule}", file=file, line=len(lines), column=1)
    return names[1], rows


def _numbers(file: Path, rows: _Rows, name: str, below: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Frequencies in rad/s and the values beside them."""
    frequencies: list[float] = []
    values: list[float] = []
    for line, cells in rows:
        if len(cells) != 2:
            raise StudyError(
                f"{len(cells)} columns; give frequency and {name}", file=file, line=line, column=1
            )
        frequency = _number(file, line, 1, cells[0], lambda f: f > 0, "a positive frequency in hertz")
        if frequencies and not frequency * HZ > frequencies[-1]:
            message = f"{quote(cells[0].strip())} Hz is not above the row before; sort by ascending frequency"
            raise StudyError(message, file=file, line=line, column=1)
        frequencies.append(frequency * HZ)
        limit = "" if math.isinf(below) else f" below {below:g}"
        meaning = f"a {name} of zero or more{limit}"
        values.append(_number(file, line, len(cells[0]) + 2, cells[1], lambda v: 0 <= v < below, meaning))
    return tuple(frequencies), tuple(values)


def _number(
    file: Path, line: int, column: int, cell: str, rule: Callable[[float], bool], meaning: str
) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and rule(value)):
        message = f"{quote(cell.strip())} is not {meaning}; correct the value"
        raise StudyError(message, file=file, line=line, column=column)
    return value
