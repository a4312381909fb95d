"""From errors to exit codes, and output that outlives its reader."""

from __future__ import annotations

import functools
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from types import FrameType
from typing import ParamSpec

import typer

from fosopt.errors import FosoptError, StoppedError

_P = ParamSpec("_P")
_STOPPING = "fosopt: finishing what is at hand, then writing the results; Ctrl-C again aborts at once\n"
_SHOW_CURSOR = "\r\x1b[K\x1b[?25h"


Stop = Callable[[], bool]
EXIT_CODES = """\b
Exit codes:
  0    finished; at least one point is verified, none failed, and one that is
       verified meets all requirements
  1    a defect of fosopt; FOSOPT_DEBUG=1 shows the traceback
  2    wrong usage
  3    the study file, a file it names, the record or the directory is at
       fault
  4    finished, but a point failed (no convergence, out of time or not
       verified), or no point is verified
  5    stopped by the machine (disk full, scheduler or workers lost); what
       was finished is on disk, and 'fosopt resume' continues
  6    finished, but no verified point meets all that the study requires: its
       constraints, requirements and requirement line
  130  interrupted; what was found so far is on disk, and 'fosopt resume'
       continues
"""


class Code(IntEnum):
    """Exit codes beside 2, which typer gives for wrong usage."""

    DONE = 0
    DEFECT = 1
    REFUSED = 3
    UNVERIFIED = 4
    STOPPED = 5
    UNMET = 6
    INTERRUPTED = 130


def guarded(command: Callable[_P, None]) -> Callable[_P, None]:
    """A command whose errors are one line on stderr and an exit code."""

    @functools.wraps(command)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except (typer.Exit, typer.BadParameter):
            raise
        except StoppedError as error:
            say(f"fosopt: {_one_line(str(error))}", error=True)
            raise typer.Exit(Code.STOPPED) from None
        except FosoptError as error:
            _refuse(str(error))
        except OSError as error:
            file = f"{error.filename}: " if error.filename else ""
            _refuse(f"{file}{error.strerror or error}; check the path, permissions and free space")
        except KeyboardInterrupt:
            say("fosopt: interrupted", error=True)
            raise typer.Exit(Code.INTERRUPTED) from None
        except Exception as error:
            if os.environ.get("FOSOPT_DEBUG") == "1":
                raise
            at = traceback.extract_tb(error.__traceback__)[-1]
            what = f"{type(error).__name__}: {error} ({os.path.basename(at.filename)}:{at.lineno})"
            way_out = "this is a defect, please report it with this line; FOSOPT_DEBUG=1 shows the traceback"
            say(f"fosopt: {_one_line(what)}: {way_out}", error=True)
            raise typer.Exit(Code.DEFECT) from None

    return run


def _refuse(message: str) -> None:
    say(f"fosopt: {_one_line(message)}", error=True)
    raise typer.Exit(Code.REFUSED) from None


def _one_line(text: str) -> str:
    return " ".join(text.split())


def say(text: str, *, error: bool = False) -> None:
    """Write a line to stdout or stderr; when nobody reads it any more, go on in silence."""
    stream = sys.stderr if error else sys.stdout
    try:
        try:
            stream.write(text + "\n")
        except UnicodeEncodeError:
            encoding = stream.encoding
            stream.write(text.encode(encoding, "replace").decode(encoding) + "\n")
        stream.flush()
    except BrokenPipeError:
        # What is still buffered goes nowhere, too, or Python would complain about it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C into a wish to stop, and leave the second one to the operating system.

    SIGTERM, with which a batch system announces that time is up, is the same wish. A solver in the middle of native
    code would not notice an exception, and one raised inside its callback would look like a failure to it.

    Yields
    ------
    Callable[[], bool]
        Whether to stop.
    """
    asked = threading.Event()

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()
        signal.signal(number, signal.SIG_DFL)
        # Not through sys.stderr: the signal may have come in the middle of a write to it.
        with suppress(OSError):
            os.write(2, ((_SHOW_CURSOR if os.isatty(2) else "") + _STOPPING).encode())

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
