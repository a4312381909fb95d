"""Write a run as one HTML file that needs nothing but a browser.

plotly.js, the style, the script and the run's data stand in the file. Its content security policy names the
two scripts by their hashes and forbids every request, so a hostile study name can neither run nor call home.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from string import Template

from fosopt.files import replacing
from fosopt.report.pack import packed

SCRIPTS = (
    "format.js",
    "unpack.js",
    "plot.js",
    "loop.js",
    "jitter.js",
    "figures.js",
    "structure.js",
    "shape.js",
    "plain.js",
    "front.js",
    "tables.js",
    "account.js",
    "report.js",
)
"""Parts of the page's script, in the order in which they use each other."""

_OF_STABLE = ("jitter", "spectrum", "cumulative", "by_mode", "step")
"""Details that only a stable loop has."""

WEBGL_POINTS = 10_000
"""Above this many points the front is drawn by WebGL, as in ``front.js`` [-]."""


def write_report(run: Mapping[str, object], path: Path) -> None:
    """Write the report of a run, all of it or nothing.

    The file replaces an older one only when it is complete. Points that are unstable or failed lose their
    jitter, step response and margin before anything is written: such numbers exist nowhere in the file.

    Parameters
    ----------
    run
        The run data: names, quantities, points with their details, comparison.
    path
        The HTML file to write.

    Raises
    ------
    ValueError
        If a number of the run is not finite.
    OSError
        If the file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(document(run), encoding="utf-8", newline="\n")


def document(run: Mapping[str, object]) -> str:
    """The HTML text of the report of a run."""
    # plotly takes a while to import, and only a report needs it.
    from plotly.offline import get_plotlyjs

    assets = files("fosopt.report") / "assets"
    parts = "".join((assets / name).read_text(encoding="utf-8") for name in SCRIPTS)
    script = f'(() => {{\n"use strict";\n{parts}}})();\n'
    library: str = get_plotlyjs()
    points, trusses = packed([_without_false_numbers(point) for point in _points(run)])
    return Template((assets / "report.html").read_text(encoding="utf-8")).substitute(
        policy=policy([library, script], evaluates=len(points) > WEBGL_POINTS),
        style=(assets / "report.css").read_text(encoding="utf-8"),
        data=embeddable({**run, "points": points, "trusses": trusses}),
        plotly=library,
        script=script,
    )


def policy(scripts: list[str], *, evaluates: bool) -> str:
    """A content security policy that allows these inline scripts and no request at all."""
    digests = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts)
    sources = [f"'sha256-{digest}'" for digest in digests]
    if evaluates:
        # plotly's WebGL scatter compiles its drawing commands; no other figure here needs it.
        sources.append("'unsafe-eval'")
    # plotly writes style rules at run time and makes an image of a figure through a data or blob address.
    return (
        f"default-src 'none'; script-src {' '.join(sources)}; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


def embeddable(data: object) -> str:
    """JSON that no HTML parser can mistake for markup: ASCII, without ``<``, ``>`` and ``&``."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _points(run: Mapping[str, object]) -> list[Mapping[str, object]]:
    points = run.get("points")
    return points if isinstance(points, list) else []


def _without_false_numbers(point: Mapping[str, object]) -> dict[str, object]:
    """The point as it may be shown: an unstable or failed one loses all that means something when stable."""
    kept = dict(point)
    metrics = _mapping(point.get("metrics"))
    abscissa = metrics.get("spectral_abscissa")
    growing = isinstance(abscissa, int | float) and abscissa >= 0
    if not growing and point.get("status") not in ("unstable", "failed"):
        return kept
    kept["metrics"] = {name: None if _needs_stability(name) else value for name, value in metrics.items()}
    constraints, history = point.get("constraints"), point.get("history")
    if isinstance(constraints, list):
        kept["constraints"] = [_without_false_prices(constraint) for constraint in constraints]
    if isinstance(history, list):
        # The objective may be the jitter; how far the constraints were from holding stays worth seeing.
        kept["history"] = [[iteration, None, infeasibility] for iteration, _, infeasibility in history]
    if point.get("detail") is not None:
        detail = {**_mapping(point["detail"]), **dict.fromkeys(_OF_STABLE)}
        modes = detail.get("modes")
        if isinstance(modes, list):
            detail["modes"] = [{**mode, "jitter_share": None} for mode in modes]
        kept["detail"] = detail
    kept["bounds"] = []
    if isinstance(point.get("requirement_line"), Mapping):
        kept["requirement_line"] = dict.fromkeys(_mapping(point["requirement_line"]))
    return kept


def _without_false_prices(constraint: Mapping[str, object]) -> dict[str, object]:
    """A constraint of a point that is unstable or failed: nothing there has a price."""
    kept = {**constraint, "multiplier": None, "statement": None}
    return {**kept, "value": None, "slack": None} if _needs_stability(str(constraint.get("name"))) else kept


def _needs_stability(name: str) -> bool:
    """Whether a metric, or an expression of metrics, means something for a stable loop only."""
    return any(part in name for part in ("jitter_", "step_", "modulus_margin"))


def _mapping(value: object) -> dict[str, object]:
    return dict(value) if isinstance(value, Mapping) else {}
