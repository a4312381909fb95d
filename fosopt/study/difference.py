"""Two runs side by side: whose front is better, and where."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from fosopt.errors import StudyError
from fosopt.study.points import SAME
from fosopt.study.store import Store

_Front = Mapping[str, tuple[float, ...]]


def difference(first: Path, second: Path) -> dict[str, Any]:
    """Compare the verified points of two runs by their objectives.

    Returns
    -------
    dict
        `objectives`; `hypervolume` of each front beyond the worst values of both, as shares of the box between the
        best and the worst values of both, None where they have no two objectives; `gained` and `lost` points by key
        with their objectives in SI; `quantities`, how objectives are shown.

    Raises
    ------
    StoreError
        If there is no record, or it is damaged.
    StudyError
        If the runs have other objectives, or none.
    """
    runs = []
    for path in (first, second):
        with Store.open(path) as store:
            runs.append(store.run())
    names = [run.get("objectives") or [] for run in runs]
    if names[0] != names[1] or not names[0]:
        texts = [", ".join(each) or "none" for each in names]
        raise StudyError(
            f"the objectives are {texts[0]} and {texts[1]}; compare two runs that minimize the same"
        )
    before, now = (_front(run, names[0]) for run in runs)
    return {
        "runs": [str(first.parent), str(second.parent)],
        "objectives": names[0],
        "quantities": {name: runs[0]["quantities"][name] for name in names[0]},
        "points": [len(before), len(now)],
        "hypervolume": _hypervolumes(before, now) if len(names[0]) == 2 and before and now else None,
        "gained": {key: list(values) for key, values in now.items() if not _matched(values, before)},
        "lost": {key: list(values) for key, values in before.items() if not _matched(values, now)},
    }


def _front(run: Mapping[str, Any], names: Sequence[str]) -> _Front:
    """Objectives of the points that count, by key."""
    return {
        point["key"]: tuple(point["metrics"][name] for name in names)
        for point in run["points"]
        if point["verified"]
        and point["strategy"] is not None
        and not point["dominated"]
        and all(point["metrics"].get(name) is not None for name in names)
    }


def _matched(values: Sequence[float], others: _Front) -> bool:
    """Whether another front has a point that is as good in all objectives."""
    return any(
        all(a <= b + SAME * abs(b) for a, b in zip(other, values, strict=True)) for other in others.values()
    )


def _hypervolumes(before: _Front, now: _Front) -> list[float]:
    both = [*before.values(), *now.values()]
    worst, best = (tuple(pick(v[k] for v in both) for k in range(2)) for pick in (max, min))
    box = (worst[0] - best[0]) * (worst[1] - best[1])
    return [hypervolume(front.values(), worst) / box if box > 0 else 0.0 for front in (before, now)]


def hypervolume(points: Any, reference: tuple[float, ...]) -> float:
    """Area that points dominate below a reference, for two objectives that are minimized."""
    steps = []
    least = reference[1]
    for first, second in sorted(points):
        if first < reference[0] and second < least:
            steps.append((first, second))
            least = second
    edges = [*steps, (reference[0], least)]
    return sum((b[0] - a[0]) * (reference[1] - a[1]) for a, b in pairwise(edges))


def said(found: Mapping[str, Any]) -> Iterator[str]:
    """The comparison in lines for people."""
    quantities = [found["quantities"][name] for name in found["objectives"]]
    yield f"{found['runs'][0]}: {found['points'][0]} points; {found['runs'][1]}: {found['points'][1]} points"
    if found["hypervolume"] is not None:
        before, now = found["hypervolume"]
        yield f"hypervolume {before:.6f} and {now:.6f} of the box of both ({now - before:+.2e})"
    for word in ("gained", "lost"):
        yield f"{len(found[word])} points {word}"
        for key, values in found[word].items():
            shown = (
                f"{q['label']} {v * q['factor']:.6g} {q['unit']}".rstrip()
                for q, v in zip(quantities, values, strict=True)
            )
            yield f"  {key}: {', '.join(shown)}"
