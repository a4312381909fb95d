"""One writer for the directory of a run, on pain of nothing but a refusal."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fosopt.errors import StudyError

LOCK = ".lock"
"""File in the directory of a run that its writer holds locked; it means nothing once nobody does."""

_TRIES, _GLANCE = 3, 0.05  # attempts to lock, and the time between them [s]


@contextmanager
def only_writer(directory: Path) -> Iterator[None]:
    """Be the only writer of a directory; the operating system lets go of it when the process ends, however it ends.

    Raises
    ------
    StudyError
        If another process writes there, or the directory cannot be written.
    """
    path = directory / LOCK
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise StudyError(
            f"'{directory}' cannot be written: {error.strerror}; check its permissions"
        ) from error
    try:
        if not _taken_at_last(handle) or not _same(handle, path):
            raise StudyError(
                f"another run writes to '{directory}'; wait for it, or choose another directory with --out"
            )
        yield
        path.unlink(missing_ok=True)
    finally:
        os.close(handle)


def is_written(directory: Path) -> bool:
    """Whether a process writes to a directory at this moment."""
    try:
        handle = os.open(directory / LOCK, os.O_RDWR)
    except OSError:
        return False
    try:
        return not _taken(handle)
    finally:
        os.close(handle)


def _taken_at_last(handle: int) -> bool:
    """Lock a file, which a glance of `is_written` may hold for a moment."""
    for _ in range(_TRIES):
        if _taken(handle):
            return True
        time.sleep(_GLANCE)
    return False


def _same(handle: int, path: Path) -> bool:
    """Whether a file is still the one with its name: a run that just ended may have removed it."""
    return path.exists() and os.path.samestat(os.fstat(handle), path.stat())


if sys.platform == "win32":
    import msvcrt

    def _taken(handle: int) -> bool:
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _taken(handle: int) -> bool:
        """Lock a file if nobody has locked it."""
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
