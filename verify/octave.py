"""Octave's control package on the random systems."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, savemat
from scipy.optimize import linear_sum_assignment

HERE = Path(__file__).parent


def missing() -> str | None:
    """What is not installed, as a sentence with the way out."""
    if shutil.which("octave-cli") is None:
        return "Octave is missing; install it: apt-get install octave octave-control"
    probe = _run("pkg load control; printf('%s', OCTAVE_VERSION)")
    if probe.returncode:
        return "Octave's control package is missing; install it: apt-get install octave-control"
    return None


def version() -> str:
    """Names and versions of what is compared with."""
    script = "pkg load control; d = pkg('describe', 'control'); printf('%s, control %s', OCTAVE_VERSION, d{1}.version)"
    return f"Octave {_run(script).stdout.strip()}"


def _run(script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["octave-cli", "--no-gui", "--quiet", "--no-init-file", "--eval", script],
        capture_output=True,
        text=True,
        check=False,
    )


def answers(systems: Sequence[dict[str, Any]], script: str = "loops.m") -> list[dict[str, Any]]:
    """What Octave finds for each system.

    Raises
    ------
    RuntimeError
        If Octave stops; with what it says.
    """
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "systems.mat", Path(folder) / "answers.mat"
        cells = np.empty(len(systems), dtype=object)
        cells[:] = list(systems)
        savemat(given, {"systems": cells})
        run = subprocess.run(
            [
                "octave-cli",
                "--no-gui",
                "--quiet",
                "--no-init-file",
                str(HERE / script),
                str(given),
                str(found),
            ],
            capture_output=True,
            text=True,
            check=False,
        )
        if run.returncode or not found.exists():
            raise RuntimeError(f"Octave stopped: {run.stderr.strip()}")
        return list(loadmat(found, simplify_cells=True)["answers"])


def apart(ours: Any, theirs: Any) -> float:
    """Largest difference of two arrays over the largest size."""
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    return float(np.abs(ours - theirs).max() / np.abs(ours).max())


def each_apart(ours: Any, theirs: Any) -> float:
    """Largest relative difference of two arrays, entry by entry."""
    ours, theirs = np.atleast_1d(ours), np.atleast_1d(theirs)
    return float((np.abs(ours - theirs) / np.abs(ours)).max())


def poles_apart(ours: Any, theirs: Any, drifting: int) -> float:
    """Largest distance of paired poles, each over its size, without those of a drift, which are zero."""
    ours, theirs = (np.array(sorted(np.asarray(p, complex), key=abs))[drifting:] for p in (ours, theirs))
    if ours.size != theirs.size:
        return float("inf")
    distance = np.abs(ours[:, None] - theirs) / np.abs(ours)[:, None]
    return float(distance[linear_sum_assignment(distance)].max())


def farthest_pole(ours: Any, theirs: Any) -> float:
    """Largest distance from a pole of either set to the nearest of the other.

    Not in pairs: what is taken off a delay in whole periods may stand at zero more often on one side.
    """
    distance = np.abs(np.asarray(ours, complex)[:, None] - np.asarray(theirs, complex))
    return float(max(distance.min(axis=0).max(), distance.min(axis=1).max()))
