"""Ctrl-C during a sweep, as a shell sends it: what is finished is kept, and every file can be read."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from scipy.io import loadmat
from test_sweep_study import sweep_text

LONG = """\
sweep:
  axes:
    - quantity: mirror_inertia_ratio
      log: {from: 0.02 %, to: 20 %, points: 200000}
  outputs: [stable, jitter_total, one_minus_separation]
  boundary: {along: mirror_inertia_ratio}
"""
PATIENCE = 60.0  # for a machine that does much else [s]


@pytest.fixture(scope="module")
def cut(tmp_path_factory):
    """A sweep of minutes that is sent an interrupt as soon as points are finished: process and directory."""
    folder = tmp_path_factory.mktemp("cut")
    (folder / "study.yaml").write_text(sweep_text(LONG, bays=20), encoding="utf-8")
    command = [sys.executable, "-m", "fosopt", "run", "study.yaml", "--out", "out", "--json"]
    with subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        seen, begin = "", time.monotonic()
        assert process.stderr is not None
        while " points/s" not in seen and time.monotonic() - begin < PATIENCE and process.poll() is None:
            seen += process.stderr.readline()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    return process.returncode, out, seen + err, folder / "out"


def test_an_interrupted_sweep_says_so_and_how_far_it_came(cut):
    code, out, err, _ = cut
    assert code == 130
    summary = json.loads(out)
    assert summary["interrupted"]
    assert 0 < summary["finished"] < summary["count"] == 200_000
    assert "Traceback" not in err


def test_an_interrupted_sweep_leaves_whole_files_of_what_is_finished(cut):
    folder = cut[3]
    described = json.loads((folder / "sweep.json").read_text(encoding="utf-8"))
    finished = described["finished"]
    for each in (*described["axes"], *described["outputs"]):
        values = np.load(folder / each["file"])
        assert values.shape[0] == finished
        assert not np.isnan(values).all()
    with (folder / "points.csv").open(encoding="utf-8") as stream:
        assert sum(1 for _ in csv.reader(stream)) == finished + 1
    assert loadmat(folder / "sweep.mat")["stable"].size == finished
    assert (folder / "report.html").read_text(encoding="utf-8").rstrip().endswith("</html>")
    assert not list(folder.glob("**/*.tmp"))
    # Boundaries come after all points.
    assert described["boundaries"] is None
