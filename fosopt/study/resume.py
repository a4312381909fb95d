"""A run that goes on: its record, the study it was made from, and whether that is still the same."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fosopt.errors import FosoptError, StudyError
from fosopt.study.directory import study_hash
from fosopt.study.files import side_files
from fosopt.study.load import dump_study, load_study, parse_study
from fosopt.study.schema import Study
from fosopt.study.store import RECORD, Store
from fosopt.study.work import STUDY

_ORIGIN, _AS_GIVEN = "origin.json", "origin.yaml"
_OWN = (_ORIGIN, _AS_GIVEN)  # inputs that are no files of the run's directory
_MOST_SHOWN = 5


@dataclass(frozen=True)
class Origin:
    """Where a study was read from.

    Attributes
    ----------
    file
        The study file.
    assignments
        What replaced values of the file.
    """

    file: Path
    assignments: Sequence[str] = ()


def record_of(run: Path) -> Path:
    """The record of a run, from its directory or the record itself."""
    return run / RECORD if run.is_dir() else run


def inputs_of(study: Study, files: Mapping[str, bytes], origin: Origin | None) -> dict[str, bytes]:
    """What a record keeps of what its run was made from."""
    kept = {**files, _AS_GIVEN: dump_study(study).encode()}
    if origin is not None:
        place = {"file": str(origin.file.absolute()), "set": list(origin.assignments)}
        kept[_ORIGIN] = json.dumps({**place, "hash": study_hash(study)}).encode()
    return kept


def recorded_study(store: Store) -> Study:
    """The study of a run; its side files lie in the directory of the run.

    Raises
    ------
    StudyError
        If the record keeps none.
    """
    text = recorded_files(store)[STUDY]
    return parse_study(text.decode(), store.path.parent, str(store.path.parent / STUDY))


def recorded_files(store: Store) -> dict[str, bytes]:
    """The study of a run and its side files, as the record keeps them, by name.

    Raises
    ------
    StudyError
        If the record keeps none.
    """
    files = {name: content for name, content in store.inputs().items() if name not in _OWN}
    if STUDY not in files:
        raise StudyError(f"{store.path}: keeps no study; run the study again")
    return files


def refuse_changed(store: Store) -> None:
    """Refuse to go on where what the run was made from has changed since.

    Raises
    ------
    StudyError
        With what differs.
    """
    run, inputs = store.path.parent, store.inputs()
    for name, content in inputs.items():
        path = run / name
        if name in _OWN:
            continue
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        elif path.read_bytes() != content:
            what = "it has another content"
            if name == STUDY:
                what = _differences(_read(content, run, path), load_study(path))
            raise StudyError(
                f"the study of this run has changed since it began: {what}; restore it, or remove the file to "
                "go on with the study that the record keeps",
                file=path,
            )
    if _ORIGIN in inputs:
        _refuse_changed_origin(json.loads(inputs[_ORIGIN]), inputs[_AS_GIVEN], run)


def _refuse_changed_origin(origin: Mapping[str, Any], as_given: bytes, run: Path) -> None:
    file = Path(origin["file"])
    if not file.exists():
        return  # the record keeps the study
    way_out = f"undo that to continue '{run}', or start the changed study with 'fosopt run'"
    try:
        now = load_study(file, origin["set"])
        if study_hash(now) == origin["hash"]:
            return
        before = _read(as_given, file.parent, file)
    except FosoptError as error:
        raise StudyError(f"the study has changed since this run began: {error}; {way_out}") from None
    what = _differences(before, now)
    raise StudyError(f"the study has changed since this run began: {what}; {way_out}", file=file)


def _read(text: bytes, base: Path, file: Path) -> Study:
    return parse_study(text.decode(), base, str(file))


def _differences(before: Study, now: Study) -> str:
    """What differs between two studies, in words."""
    old, new = (dict(_leaves(study.model_dump(mode="json", exclude_none=True))) for study in (before, now))
    found = [
        f"{name} is {_shown(new, name)}, was {_shown(old, name)}"
        for name in dict.fromkeys([*old, *new])
        if old.get(name) != new.get(name)
    ]
    if not found:
        files = ", ".join(path.name for path in side_files(now))
        return f"a side file has another content ({files})"
    more = f" and {len(found) - _MOST_SHOWN} more" if len(found) > _MOST_SHOWN else ""
    return "; ".join(found[:_MOST_SHOWN]) + more


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    items = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    )
    if items is None:
        yield path, value
        return
    for key, inner in items:
        yield from _leaves(inner, f"{path}.{key}" if path else str(key))


def _shown(leaves: Mapping[str, Any], name: str) -> str:
    return str(leaves[name]) if name in leaves else "absent"
