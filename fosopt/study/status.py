"""How far a run has come, from its record alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fosopt.study.lock import is_written
from fosopt.study.store import Store


def status_of(path: Path) -> dict[str, Any]:
    """State of a run by its record, also while it goes on.

    Returns
    -------
    dict
        `state` is running, finished, interrupted, or killed; `done` and `total` points; `failed` ones; `rate` in
        points per second of the last session and the `seconds` left at that rate, None where there is none; `best`
        value of each objective among verified points, as ``{name: [value, unit]}``.

    Raises
    ------
    StoreError
        If there is no record, or it is damaged.
    """
    with Store.open(path) as store:
        header, sessions, tally = store.header(), store.sessions(), store.tally()
        last = sessions[-1] if sessions else {}
        best = {} if header["kind"] == "sweep" else _best(store, header)
        blocks = store.blocks() if header["kind"] == "sweep" else []
    # A killed process leaves no word of its end.
    state = "running" if is_written(path.parent) else last.get("end") or "killed"
    fresh = last.get("done", 0) - last.get("known", 0)
    rate = fresh / last["seconds"] if fresh and last["seconds"] > 0 else None
    done, total = last.get("done", 0), last.get("total", 0)
    left = (total - done) / rate if rate and done < total else None
    failed = [
        key for key, status, verified in tally if status == "failed" or (status == "optimal" and not verified)
    ]
    return {
        "name": header["name"],
        "kind": header["kind"],
        "directory": str(path.parent),
        "state": state,
        "done": done,
        "total": total,
        "failed": sum(b.failed for b in blocks) if blocks else len(failed),
        "failed_points": failed,
        "rate": rate,
        "left": left if state == "running" else None,
        "sessions": [
            {k: each[k] for k in ("began", "seconds", "done", "end", "options")} for each in sessions
        ],
        "best": best,
        "provenance": header["provenance"],
    }


def _best(store: Store, header: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in store.best(header["objectives"]).items():
        quantity = header["quantities"][name]
        found[name] = [value * quantity["factor"], quantity["unit"]]
    return found


def said(found: Mapping[str, Any]) -> Iterator[str]:
    """The state of a run in lines for people."""
    yield f"{found['name']} ({found['directory']})"
    counts = f"{found['done']} of {found['total']} points"
    if found["failed"]:
        counts += f", {found['failed']} failed"
    yield f"{found['state']}: {counts}"
    for key in found["failed_points"]:
        yield f"  failed: {key}"
    for name, (value, unit) in found["best"].items():
        yield f"best {name}: {value:.6g} {unit}".rstrip()
    for each in found["sessions"]:
        yield f"session of {each['began']}: {each['options']}, {each['seconds']:.1f} s, {each['done']} points"
    if found["rate"] is not None:
        left = f", about {found['left']:.0f} s left" if found["left"] is not None else ""
        yield f"{found['rate']:.3g} points/s{left}"
    if found["state"] in ("interrupted", "killed", "stopped"):
        yield f"continue with: fosopt resume {found['directory']}"
