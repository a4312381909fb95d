"""Real eigenvectors of Nastran punch files, each with its eigenvalue.    [MscQrg2021] case control VECTOR(PUNCH)"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from fosopt.structure.readers.common import COMPONENTS, bad, number, text_lines
from fosopt.structure.readers.modal_set import ModalFile
from fosopt.units import HZ

_EIGENVALUE = re.compile(r"\$EIGENVALUE\s*=\s*(\S+)\s+MODE\s*=\s*(\d+)")
_DATA = 72  # columns before the running number of a line
# A negative eigenvalue is a rigid-body mode at rounding if it is below this share of the highest one.
_ROUNDING = 1e-8


def read_punch(file: Path) -> ModalFile:
    """Eigenvectors of a punch file; other results in it are passed over.

    Assumes mass-normalized vectors, as Nastran gives by default. They are in the displacement coordinates of each grid.

    Raises
    ------
    StudyError
        For a file without real eigenvectors, complex ones, a grid that is missing from a mode, or a truncated file.
    """
    lines = text_lines(file)
    modes: dict[int, tuple[float, dict[str, list[float]]]] = {}
    shape: dict[str, list[float]] | None = None
    kind, kind_line, grid = "", 0, ""
    for k, raw in enumerate(lines, 1):
        line = raw[:_DATA].rstrip()
        if line.startswith("$"):
            shape = None
            word = line[1:].split("=")[0].strip().upper()
            if word == "EIGENVECTOR":
                kind, kind_line = "vector", k
            elif word == "TITLE":
                kind = ""
            elif kind and word in ("REAL-IMAGINARY OUTPUT", "MAGNITUDE-PHASE OUTPUT"):
                raise bad(file, "complex eigenvectors; punch those of the undamped structure (SOL 103)", k)
            elif kind and (match := _EIGENVALUE.match(line)):
                mode = int(match[2])
                if mode in modes:
                    raise bad(file, f"mode {mode} stands twice; punch one subcase", k)
                modes[mode] = number(file, match[1], f"eigenvalue of mode {mode}", k), {}
                shape = modes[mode][1]
            continue
        if not kind or not line:
            continue
        if shape is None:
            raise bad(file, "an eigenvector without its eigenvalue before it; export the file again", k)
        if line.startswith("-CONT-"):
            if not grid:
                raise bad(file, "a continuation without a grid before it; export the file again", k)
            shape[grid] += _values(file, line, k)
            grid = ""
            continue
        if grid:
            raise bad(
                file, f"grid {grid} has three components only; the file is damaged, export it again", k - 1
            )
        grid = line[:10].strip()
        if not grid.isdigit():
            raise bad(file, f"'{grid}' is no grid; the file is damaged, export it again", k)
        if grid in shape:
            raise bad(file, f"grid {grid} stands twice in a mode; punch one subcase", k)
        shape[grid] = _values(file, line, k)
    if not modes:
        raise bad(file, "the file has no real eigenvectors; request VECTOR(PUNCH)=ALL in SOL 103")
    if grid:
        raise bad(file, f"the file ends within grid {grid}: truncated; export it again", len(lines))
    return _modal_file(file, modes, kind_line)


def _values(file: Path, line: str, k: int) -> list[float]:
    cells = [line[i : i + 18].strip() for i in (18, 36, 54)]
    return [number(file, cell, "an eigenvector", k) for cell in cells]


def _modal_file(file: Path, modes: dict[int, tuple[float, dict[str, list[float]]]], line: int) -> ModalFile:
    numbers = sorted(modes)
    grids = list(modes[numbers[0]][1])
    for mode in numbers:
        if list(modes[mode][1]) != grids:
            missing = next(iter(set(grids) ^ set(modes[mode][1])), "the order of grids")
            raise bad(
                file,
                f"mode {mode} and mode {numbers[0]} differ in grid {missing}: truncated or damaged; export it again",
                line,
            )
    if not grids:
        raise bad(file, "the modes hold no grids: truncated; export the file again", line)
    value = np.array([modes[mode][0] for mode in numbers])
    if value.min() < -_ROUNDING * value.max():
        mode = numbers[int(np.argmin(value))]
        raise bad(
            file, f"mode {mode}: eigenvalue {value.min():g} is negative; the structure is unstable", line
        )
    table = np.array([[x for grid in grids for x in modes[mode][1][grid]] for mode in numbers]).T
    dofs = tuple(f"{grid}.{c}" for grid in grids for c in COMPONENTS)
    return ModalFile(file, np.sqrt(np.maximum(value, 0.0)) / HZ, table, dofs)
