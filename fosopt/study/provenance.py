"""Where the numbers of a run come from: study, program, versions, machine, options, seed and threads."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

LIBRARIES = ("fosopt", "casadi", "numpy", "scipy", "numba")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_PATIENCE = 5.0  # seconds git may take to answer


def environment() -> dict[str, str]:
    """What decides the last bits of a result: versions, and threads of linear algebra."""
    return {
        **{name: metadata.version(name) for name in LIBRARIES},
        "python": platform.python_version(),
        "threads": threads(),
    }


def unlike(other: Mapping[str, str]) -> str:
    """In words, what of an environment is another one in this process; empty for none."""
    own = environment()
    return ", ".join(f"{name} {own[name]} for {value}" for name, value in other.items() if own[name] != value)


def threads() -> str:
    """Threads that libraries of linear algebra may use in this process."""
    given = {os.environ.get(name, "") for name in _THREADS[:2]}
    return given.pop() or "all" if len(given) == 1 else "mixed"


def machine() -> str:
    """System and processor architecture."""
    return f"{platform.system()} {platform.machine()}"


def revision() -> str:
    """Git revision of the program with a word on uncommitted changes; of an installed package, that it has none."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return "none: an installed package"
    try:
        commit = _git(root, "rev-parse", "--short=12", "HEAD")
        return f"{commit} with changes" if _git(root, "status", "--porcelain", "--", "fosopt") else commit
    except (OSError, subprocess.SubprocessError):
        return "unknown: git does not answer"


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "-c", f"safe.directory={root}", "-C", str(root), *arguments]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        timeout=_PATIENCE,
        stdin=subprocess.DEVNULL,
        env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
    )
    return done.stdout.strip()
