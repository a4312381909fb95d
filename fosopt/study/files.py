"""Side files of a study: PSD tables and damping tables in CSV."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fosopt.errors import ModelError, StudyError
from fosopt.study.schema_imports import structure_files
from fosopt.study.schema_names import SIGNAL
from fosopt.study.source import read_text
from fosopt.units import DIMENSIONS, HZ, QuantityError, parse_quantity, quote

if TYPE_CHECKING:
    from fosopt.metrics.tabulated import Interpolation
    from fosopt.study.schema import Study
    from fosopt.study.schema_system import Disturbance

_MOST_ROWS = 200_000
_DENSITIES = (("psd_", "^2/Hz"), ("asd_", "/sqrt(Hz)"))
_CUMULATIVE = (("cumulative_rms_", ""),)
"""How the name of a column of values begins and ends; between stands the unit."""


@dataclass(frozen=True)
class PsdTable:
    """A one-sided power spectral density over frequency.

    Parameters
    ----------
    frequency
        (n_row,) Ascending and positive [rad/s].
    psd
        (n_row,) One-sided, per ordinary hertz [(N m)²/Hz or rad²/Hz].
    interpolation
        What stands between the rows.
    """

    frequency: tuple[float, ...]
    psd: tuple[float, ...]
    interpolation: Interpolation = "linear"


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
    names = [disturbance.table for disturbance in study.disturbances if disturbance.table is not None]
    if isinstance(study.damping.table, str):
        names.append(study.damping.table)
    names += structure_files(study.structure)
    if study.requirement_line is not None:
        names.append(study.requirement_line)
    return tuple(study.base / name for name in names)


def read_psd(study: Study, disturbance: Disturbance) -> PsdTable:
    """The PSD table of a disturbance.

    Its header is ``frequency_hz,psd_<unit>^2/Hz``, or ``frequency_hz,asd_<unit>/sqrt(Hz)`` for an amplitude density;
    that of a table of cumulative rms ``frequency_hz,cumulative_rms_<unit>``.

    Raises
    ------
    StudyError
        For a file that is missing, has another header or unit, fewer than two rows, or a value that is
        not finite, negative or out of order; or a band that leaves the table.
    """
    signal = SIGNAL[disturbance.at]
    file = study.base / (disturbance.table or "")
    shown = "N m" if signal == "torque" else "rad"
    cumulative = disturbance.cumulative_rms is not None
    header, rows = _read(
        file, f"frequency_hz,{f'cumulative_rms_{shown}' if cumulative else f'psd_{shown}^2/Hz'}"
    )
    kinds = _CUMULATIVE if cumulative else _DENSITIES
    kind = next((each for each in kinds if header.startswith(each[0]) and header.endswith(each[1])), None)
    unit = "" if kind is None else header[len(kind[0]) : len(header) - len(kind[1])]
    try:
        factor = parse_quantity(f"1 {unit}", signal) if unit else math.nan
    except QuantityError:
        factor = math.nan
    if kind is None or not factor > 0:
        ways = " or ".join(f"{start}{DIMENSIONS[signal].unit}{end}" for start, end in kinds)
        what = "cumulative rms" if cumulative else "PSD"
        message = f"{quote(header)} names no {what} of the signal's unit; write {ways}"
        raise StudyError(message, file=file, line=1, column=len("frequency_hz,") + 1)
    frequency, values = _numbers(file, rows, "rms" if cumulative else "PSD", math.inf)
    if cumulative:
        table = PsdTable(frequency, _levels(file, frequency, values, factor), "level")
    else:
        power = 2 if kind[0] == "asd_" else 1
        psd = tuple(value**power * factor**2 for value in values)
        if disturbance.interpolation == "log" and 0.0 in psd:
            line = rows[psd.index(0.0)][0]
            message = "a density of zero has no place on logarithmic axes; write 'interpolation: linear'"
            raise StudyError(message, file=file, line=line)
        table = PsdTable(frequency, psd, disturbance.interpolation or "linear")
    if disturbance.band is not None and not (
        frequency[0] <= disturbance.band[0] * (1 + 1e-9) and disturbance.band[1] <= frequency[-1] * (1 + 1e-9)
    ):
        message = (
            f"the band of '{disturbance.name}' leaves the table, which covers {frequency[0] / HZ:.6g} to "
            f"{frequency[-1] / HZ:.6g} Hz; narrow the band or extend the table"
        )
        raise StudyError(message, file=file)
    return table


def read_requirement_line(study: Study) -> dict[str, list[float]] | None:
    """The most that jitter may have accumulated below each frequency, if the study states it: in hertz and rad.

    The file has the header ``frequency_hz,cumulative_rms_<unit>``.

    Raises
    ------
    StudyError
        For a file that is missing, has another header or unit, fewer than two rows, a value that is not finite,
        negative or out of order, or an allowance that falls.
    """
    if study.requirement_line is None:
        return None
    file = study.base / study.requirement_line
    header, rows = _read(file, "frequency_hz,cumulative_rms_rad")
    start = _CUMULATIVE[0][0]
    try:
        factor = (
            parse_quantity(f"1 {header.removeprefix(start)}", "angle")
            if header.startswith(start)
            else math.nan
        )
    except QuantityError:
        factor = math.nan
    if not factor > 0:
        message = f"{quote(header)} names no cumulative rms of an angle; write cumulative_rms_rad"
        raise StudyError(message, file=file, line=1, column=len("frequency_hz,") + 1)
    frequency, values = _numbers(file, rows, "rms", math.inf)
    for (line, _), before, value in zip(rows[1:], values, values[1:], strict=False):
        if value < before:
            message = f"the allowance falls from {before:g} to {value:g}, and accumulated jitter never does; correct it"
            raise StudyError(message, file=file, line=line)
    return {"frequency_hz": [f / HZ for f in frequency], "rms": [factor * value for value in values]}


def _levels(
    file: Path, frequency: tuple[float, ...], values: tuple[float, ...], factor: float
) -> tuple[float, ...]:
    """Density whose rms accumulates as a table says."""
    # Reading other studies needs no numerical library.
    import numpy as np

    from fosopt.metrics.tabulated import levels_of_cumulative_rms

    try:
        levels = levels_of_cumulative_rms(np.array(frequency) / HZ, factor * np.array(values))
    except ModelError as error:
        raise StudyError(str(error), file=file, line=1) from None
    return tuple(levels.tolist())


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
