"""Arrays in a record: typed blobs with their shape, apart from the JSON they belong to."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

_SHORTEST = 16  # numbers: shorter lists stay where a person can read them
_MARK = "$array"
_KINDS = ("<f8", "<i8", "|b1")

Blob = tuple[str, str, bytes]
"""Type of an element, shape as JSON, and the elements in C order."""


def blob(values: NDArray[Any]) -> Blob:
    """An array as a typed blob.

    Raises
    ------
    TypeError
        If its elements are neither numbers nor truth values.
    """
    kind = np.asarray(values).dtype.newbyteorder("<").str
    if kind not in _KINDS:
        raise TypeError(f"an array of {values.dtype} is not stored; use one of {', '.join(_KINDS)}")
    ordered = np.ascontiguousarray(values, dtype=kind)
    return kind, json.dumps(list(values.shape)), ordered.tobytes()


def array(kind: str, shape: str, data: bytes) -> NDArray[Any]:
    """The array of a typed blob.

    Raises
    ------
    ValueError
        If the three do not agree.
    """
    if kind not in _KINDS:
        raise ValueError(f"'{kind}' is no element type of a record")
    return np.frombuffer(data, dtype=kind).reshape(json.loads(shape)).copy()


def packed(record: Mapping[str, Any]) -> tuple[str, list[Blob]]:
    """A record as JSON, with its long lists of floats as typed blobs.

    Raises
    ------
    ValueError
        If a number is not finite.
    """
    blobs: list[Blob] = []

    def without_arrays(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: without_arrays(inner) for key, inner in value.items()}
        if not isinstance(value, list | tuple):
            return value
        if _rectangular(value):
            values = np.array(value, dtype="<f8")
            if not np.isfinite(values).all():
                raise ValueError("a number that is not finite is no JSON")
            blobs.append(blob(values))
            return {_MARK: len(blobs) - 1}
        return [without_arrays(inner) for inner in value]

    text = json.dumps(without_arrays(record), allow_nan=False, separators=(",", ":"))
    return text, blobs


def unpacked(text: str, blobs: Mapping[int, Blob]) -> Any:
    """What `packed` was given, with lists for tuples.

    Raises
    ------
    ValueError
        If the text is no JSON, or an array is damaged.
    KeyError
        If an array is missing.
    """

    def with_arrays(value: dict[str, Any]) -> Any:
        return array(*blobs[value[_MARK]]).tolist() if value.keys() == {_MARK} else value

    return json.loads(text, parse_constant=_refuse, object_hook=with_arrays)


def _rectangular(value: Any) -> bool:
    """Whether a list holds floats only, or lists of equally many floats."""
    if len(value) < 1:
        return False
    if all(type(each) is float for each in value):
        return len(value) >= _SHORTEST
    width = len(value[0]) if isinstance(value[0], list | tuple) else 0
    return (
        width > 0
        and len(value) * width >= _SHORTEST
        and all(
            isinstance(row, list | tuple) and len(row) == width and all(type(each) is float for each in row)
            for row in value
        )
    )


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no JSON")
