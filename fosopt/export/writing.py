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
        # A link stays and what it leads to is replaced; a device or a pipe must never be.
        target = path.resolve()
        if target.exists() and not (target.is_file() or target.is_dir()):
            raise ExportError(
                f"{path}: is a device or a pipe, and only a file can be replaced; give another path"
            )
        with replacing(target) as temporary:
            yield temporary
    except OSError as error:
        reason = error.strerror or str(error)
        message = f"{path}: cannot be written: {reason}; check the directory, its permissions and free space"
        raise ExportError(message) from None
