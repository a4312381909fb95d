"""Files that take the place of an older one when they are complete."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fosopt.errors import FosoptError
from fosopt.files import replacing


class ExportError(FosoptError):
    """A file that cannot be written."""


@contextmanager
def written_to(path: Path) -> Iterator[Path]:
    """A file to write that takes the place of `path` when it is complete.

    Raises
    ------
    ExportError
        If the file cannot be written, or is a device or a pipe.
    """
    try:
        with replacing(path) as temporary:
            yield temporary
    except OSError as error:
        reason = error.strerror or str(error)
        message = f"{path}: cannot be written: {reason}; check the directory, its permissions and free space"
        raise ExportError(message) from None
