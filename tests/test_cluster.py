"""Workers: the serial answer to the last bit, whatever happens to them."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import dask
import hanging
import psutil
import pytest
from small_studies import STUDIES

from fosopt.errors import StoppedError, StudyError
from fosopt.study import cluster, load_study
from fosopt.study.processes import SURROUNDINGS, prepare
from fosopt.study.runner import Workers, resume_run, run_study
from fosopt.study.store import RECORD, Store

SMALL = ("structure.bays=2", "front.points=10")
_PATIENCE = 120.0  # seconds for what takes one on a quiet machine


def study(*changes: str):
    """The quickstart on two bays, with two chains of points."""
    return load_study(STUDIES / "quickstart.yaml", (*SMALL, *changes))


def numbers(points: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """All that points say but how long they took."""
    return [{name: value for name, value in point.items() if name != "seconds"} for point in points]


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """The run data of one process."""
    return run_study(study(), tmp_path_factory.mktemp("serial") / "run")


def worker_processes() -> list[psutil.Process]:
    """Processes that this one has begun to compute in."""
    return [each for template in template_processes() for each in template.children()]


def template_processes() -> list[psutil.Process]:
    """The process that those are copies of, where there is one."""
    living = [each for each in psutil.Process().children() if each.status() != psutil.STATUS_ZOMBIE]
    return [each for each in living if "forkserver" in " ".join(each.cmdline())]


def test_two_workers_of_which_one_is_killed_give_the_serial_answer(serial, tmp_path):
    killed = []

    def kill(progress):
        if progress.done >= 4 and not killed:
            killed.append(worker_processes()[0])
            killed[0].kill()

    run = run_study(study(), tmp_path / "run", workers=Workers(2), progress=kill)
    assert killed
    assert numbers(run["points"]) == numbers(serial["points"])
    assert run["comparison"] == serial["comparison"]
    assert run["provenance"]["options"] == "2 workers"
    assert not worker_processes()


@pytest.fixture(scope="module")
def network():
    """A scheduler with two workers in processes of their own, on loopback; its address, and the processes."""
    here = Path(cluster.__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": f"{here}{os.pathsep}{Path(__file__).parent}"}

    def begin(*command: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *command],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,
        )

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    begun = [
        begin("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"),
        *(begin("worker", address, "--nthreads", "1", "--no-dashboard") for _ in range(2)),
    ]
    yield address, begun
    for each in begun:
        with suppress(ProcessLookupError):
            os.killpg(each.pid, signal.SIGKILL)
        each.wait()


def test_a_scheduler_with_workers_of_its_own_gives_the_serial_answer_also_when_a_worker_is_lost(
    serial, network, tmp_path
):
    address, (_, first, _) = network

    def kill(progress):
        if progress.done == 6:
            os.killpg(first.pid, signal.SIGKILL)  # the worker with the nanny that would start it again

    run = run_study(study(), tmp_path / "run", workers=Workers(scheduler=address), progress=kill)
    assert first.wait(timeout=_PATIENCE) == -signal.SIGKILL
    assert numbers(run["points"]) == numbers(serial["points"])


def test_a_lost_scheduler_ends_the_run_with_what_it_has_and_resuming_gives_the_serial_answer(
    serial, network, tmp_path
):
    address, (scheduler, *_) = network

    def kill(progress):
        if progress.done == 5 and progress.point is not None:
            os.killpg(scheduler.pid, signal.SIGKILL)

    out = tmp_path / "run"
    with pytest.raises(StoppedError, match=r"scheduler tcp://.* is lost; .* continue with 'fosopt resume"):
        run_study(study(), out, workers=Workers(scheduler=address), progress=kill)
    with Store.open(out / RECORD) as store:
        run = store.run()
    assert run["interrupted"]
    assert 5 <= len(run["points"]) < len(serial["points"])
    assert (out / "report.html").is_file()
    heard = []
    again = resume_run(out, progress=heard.append)
    assert numbers(again["points"]) == numbers(serial["points"])
    done_again = [p.point["key"] for p in heard if p.point is not None]
    assert set(done_again).isdisjoint(point["key"] for point in run["points"])


def test_no_scheduler_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT", "0.2 s")
    with pytest.raises(StoppedError, match=r"no workers on tcp://127.0.0.1:9: .*; check the address"):
        run_study(study(), tmp_path / "run", workers=Workers(scheduler="tcp://127.0.0.1:9"))


def test_workers_that_cannot_start_are_said(tmp_path, monkeypatch):
    def fail(**_):
        raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr(cluster, "LocalCluster", fail)
    with pytest.raises(
        StoppedError, match=r"no workers on this machine: Nanny failed to start; .*'if __name__"
    ):
        run_study(study(), tmp_path / "run", workers=Workers(2))


def test_workers_are_copies_of_a_process_with_one_thread_that_has_everything():
    prepare()
    (template,) = template_processes()
    assert {name: template.environ()[name] for name in SURROUNDINGS} == SURROUNDINGS


def test_ctrl_c_is_not_for_workers_even_while_their_process_starts():
    begin = (
        "import os, signal, time, psutil; from fosopt.study.processes import prepare;"
        # A shell makes what it begins in the background deaf to it.
        "signal.signal(signal.SIGINT, signal.SIG_DFL); prepare();"
        "kids = [each for each in psutil.Process().children() if 'forkserver' in ' '.join(each.cmdline())];"
        "[each.send_signal(signal.SIGINT) for each in kids]; time.sleep(0.3);"
        "print(len(kids), [each.status() != psutil.STATUS_ZOMBIE for each in kids]);"
        "os.kill(os.getpid(), signal.SIGINT)"
    )
    found = subprocess.run(
        [sys.executable, "-c", begin], capture_output=True, text=True, timeout=60, check=False
    )
    assert found.stdout == "1 [True]\n"
    # This process itself listens to it as before.
    assert found.returncode == -signal.SIGINT


def answers_of(pool: cluster.Cluster, *names: str) -> dict[str, Any]:
    """What a pool answers to errands that it is given all at once."""
    answers = {}
    for position, name in enumerate(names):
        pool.submit(hanging.Errand(name, position))
    end = time.monotonic() + _PATIENCE
    while pool.busy and time.monotonic() < end:
        found = pool.next(lambda: False)
        if found is not None:
            answers[found[0].name] = found[1]
    return answers


def test_what_hangs_is_stopped_at_its_time_limit_and_what_kills_its_worker_is_given_up(monkeypatch):
    monkeypatch.setattr(cluster, "_GRACE", 0.5)
    # By default a request is tried on four workers before it is blamed for their ends.
    once = dask.config.set({"distributed.scheduler.allowed-failures": 0})
    with once, cluster.Cluster(hanging.Job(), None, perform=hanging.perform, workers=2) as pool:
        answers = answers_of(pool, "a", "b") | answers_of(pool, "stuck", "deadly") | answers_of(pool, "c")
    assert answers == {
        "a": "a",
        "b": "b",
        "c": "c",
        "stuck": "stopped after 0.2 s, all the time that a point has; raise solve.time_limit",
        "deadly": "every worker process that tried it died; look at its memory",
    }


def test_two_runs_at_a_time_do_not_disturb_each_other():
    # The scheduler's page has one port by default; what cannot have it warns, and warnings are errors here.
    with ExitStack() as pools:
        for each in [hanging.Job(), hanging.Job()]:
            pool = pools.enter_context(cluster.Cluster(each, None, perform=hanging.perform, workers=1))
            pool.submit(hanging.Errand("a", 0))
            while (found := pool.next(lambda: False)) is None:
                pass
            assert found[1] == "a"


def test_what_waits_at_a_worker_that_dies_is_not_blamed_for_it():
    once = dask.config.set({"distributed.scheduler.allowed-failures": 0})
    with once, cluster.Cluster(hanging.Job(), None, perform=hanging.perform, workers=1) as pool:
        answers = answers_of(pool, "deadly", "a", "b")
    assert answers == {
        "a": "a",
        "b": "b",
        "deadly": "every worker process that tried it died; look at its memory",
    }


def test_workers_need_a_process_with_one_thread(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    with pytest.raises(StudyError, match="set OMP_NUM_THREADS=1 and OPENBLAS_NUM_THREADS=1"):
        run_study(study(), tmp_path / "run", workers=Workers(2))
    assert not (tmp_path / "run").exists()
