"""Write a sweep as one HTML file that needs nothing but a browser.

The arrays of a large sweep are thinned to what a picture can show.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from math import ceil, isfinite, prod
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from fosopt.files import replacing
from fosopt.report.html import embeddable, policy

_SCRIPTS = ("format.js", "plot.js", "sweep.js")
_POINTS = 4000  # of a line or a heat map
_DIGITS = 7
_CELLS = 40_000  # of a per-mode output, all modes together


def write_sweep_report(run: Mapping[str, Any], directory: Path) -> None:
    """Write ``report.html`` of a sweep, all of it or nothing.

    Parameters
    ----------
    run
        What the sweep was, as in its ``sweep.json``.
    directory
        Of the run, which holds the arrays.
    """
    from plotly.offline import get_plotlyjs

    assets = files("fosopt.report") / "assets"
    parts = "".join((assets / name).read_text(encoding="utf-8") for name in _SCRIPTS)
    script = f'(() => {{\n"use strict";\n{parts}}})();\n'
    library: str = get_plotlyjs()
    text = Template((assets / "sweep.html").read_text(encoding="utf-8")).substitute(
        policy=policy([library, script], evaluates=False),
        style=(assets / "report.css").read_text(encoding="utf-8"),
        data=embeddable({**run, "shown": _shown(run, directory)}),
        plotly=library,
        script=script,
    )
    with replacing(directory / "report.html") as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def _shown(run: Mapping[str, Any], directory: Path) -> dict[str, Any]:
    """Numbers for the figures: whole lines of a grid while they are complete, else single points."""
    finished = int(run["finished"])
    shape = tuple(run["shape"])
    complete = finished == prod(shape)
    if complete and len(shape) == 2:
        step = [ceil(n / 150) if n * shape[1 - k] > _POINTS else 1 for k, n in enumerate(shape)]
        grid = np.arange(finished).reshape(shape)[:: step[0], :: step[1]]
        chosen, kept = grid.ravel(), list(grid.shape)
    else:
        chosen = np.arange(0, finished, max(1, ceil(finished / _POINTS)))
        kept = [chosen.size]
    widest = max((each["shape"][1] for each in run["outputs"] if len(each["shape"]) == 2), default=1)
    few = chosen[:: max(1, ceil(chosen.size * widest / _CELLS))]
    axes = {each["name"]: each for each in run["axes"]}
    scalars = [each for each in run["outputs"] if len(each["shape"]) == 1]
    arrays = [each for each in run["outputs"] if len(each["shape"]) == 2]
    return {
        "shape": kept,
        "thinned": chosen.size < finished,
        "axes": {name: _column(directory / each["file"], chosen) for name, each in axes.items()},
        "scalars": {each["name"]: _column(directory / each["file"], chosen) for each in scalars},
        "mode_axes": {name: _column(directory / each["file"], few) for name, each in axes.items()},
        "modes": {each["name"]: _columns(directory / each["file"], few) for each in arrays},
    }


def _column(path: Path, chosen: Any) -> list[float | None]:
    return _plain(np.load(path, mmap_mode="r")[chosen])


def _columns(path: Path, chosen: Any) -> list[list[float | None]]:
    """One list per mode."""
    return [_plain(column) for column in np.load(path, mmap_mode="r")[chosen].T]


def _plain(values: Any) -> list[float | None]:
    return [float(f"{x:.{_DIGITS}g}") if isfinite(x) else None for x in values.tolist()]
