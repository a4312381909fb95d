"""Requests answered by worker processes, on this machine or on a cluster, through dask.distributed."""

from __future__ import annotations

import logging
import queue
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any, Self

import dask
from distributed import Client, LocalCluster, get_worker
from distributed.diagnostics.plugin import WorkerPlugin
from distributed.scheduler import KilledWorker

from fosopt.errors import StoppedError
from fosopt.study.build import build_problem
from fosopt.study.engine import Asked, Job
from fosopt.study.processes import METHOD, SURROUNDINGS
from fosopt.study.work import Parcel, job_of, late_reason

_TICK = 0.2  # seconds between two looks at what else has happened
_GRACE = 10.0  # seconds a point may take beyond its limit before its worker is stopped
_LONELY = 60.0  # seconds to wait for a worker where there is none
_CONNECT = "30 s"
_FAREWELL = 5.0  # seconds to wait for an orderly end of the workers
_ALONE = threading.Lock()  # solvers are not made for threads: a worker with several works with one of them
_AT_WORK = {
    # What dask observes of itself nobody looks at; it took one part in thirty of two processors.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.worker.multiprocessing-method": METHOD,
    "distributed.nanny.pre-spawn-environ": SURROUNDINGS,
}


class Delivery(WorkerPlugin):
    """A parcel on every worker, also on those that join later or are started again."""

    def __init__(self, name: str, parcel: Parcel) -> None:
        self.name, self.parcel = name, parcel
        self.job: Any = None
        self.files: ExitStack | None = None

    def setup(self, worker: Any) -> None:
        """Leave Ctrl-C to the process that began the run."""
        import signal

        if threading.current_thread() is threading.main_thread() and worker.nanny is not None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    def work(self) -> Any:
        """What is done with requests, made ready once per worker."""
        if self.job is None:
            # A sweep builds structures as it goes, so that the files stay for as long as the worker does.
            self.files = ExitStack()
            study = self.files.enter_context(self.parcel.laid_out())
            self.job = job_of(study, build_problem(study))
        return self.job


def perform(name: str, request: Any) -> Any:
    """Answer a request on a worker."""
    worker = get_worker()
    with _ALONE:
        worker.log_event(name, {"request": request.name, "worker": worker.address})
        delivery = worker.plugins[name]
        assert isinstance(delivery, Delivery)
        return delivery.work().respond(request)


class Cluster:
    """Workers that answer requests; a context manager.

    The workers start while this process finds the ends of the front, which nothing else can do meanwhile.

    Parameters
    ----------
    job
        What is done with requests, in this process.
    parcel
        The study they are about, for workers.
    perform
        What a worker does with the name of the parcel and a request.
    workers
        Number of processes to start on this machine.
    scheduler
        Address of a scheduler that has workers, in place of processes of its own.
    """

    def __init__(
        self,
        job: Job,
        parcel: Parcel,
        *,
        perform: Callable[[str, Any], Any] = perform,
        workers: int = 1,
        scheduler: str | None = None,
    ) -> None:
        self._job, self._perform = job, perform
        self._workers, self._scheduler = workers, scheduler
        self._delivery = Delivery(f"fosopt-{uuid.uuid4().hex}", parcel)
        self._local: list[Asked] = []
        self._held: list[Asked] = []
        self._futures: dict[str, tuple[Asked, Any]] = {}
        self._begun: dict[str, tuple[float, str]] = {}
        # Dask blames what a worker had been given when it died, begun or not: that is tried again alone.
        self._suspects: list[Asked] = []
        self._alone: str | None = None
        self._events: queue.Queue[str] = queue.Queue()
        self._company = time.monotonic()
        self._client: Client | None = None
        self._cluster: LocalCluster | None = None
        self._failure: BaseException | None = None
        self._starting = threading.Thread(target=self._start, name="fosopt-workers", daemon=True)

    def __enter__(self) -> Self:
        # What happens to workers and schedulers is said by the run, in one line.
        for name in list(logging.root.manager.loggerDict):
            if name.startswith(("distributed", "tornado")):
                logging.getLogger(name).setLevel(logging.CRITICAL)
        self._starting.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._starting.join()
        # Whoever does not answer in time is left behind; processes of this machine end with this one.
        if self._client is not None:
            with suppress(TimeoutError, OSError):
                self._withdraw(self._client)
            with suppress(TimeoutError, OSError):
                self._client.close(timeout=_FAREWELL)
        if self._cluster is not None:
            with suppress(TimeoutError, OSError):
                self._cluster.close(timeout=_FAREWELL)

    def _withdraw(self, client: Client) -> None:
        """Take back what is not done, and the parcel from workers that go on."""
        if client.status != "running":
            return
        if self._futures:
            client.cancel([future for _, future in self._futures.values()], force=True)
        if self._cluster is None:
            client.unregister_worker_plugin(self._delivery.name)

    def _start(self) -> None:
        try:
            address = self._scheduler
            if address is None:
                with dask.config.set(_AT_WORK):
                    self._cluster = LocalCluster(
                        n_workers=self._workers,
                        threads_per_worker=1,
                        processes=True,
                        host="127.0.0.1",
                        dashboard_address=None,
                        # Dask serves its state even so, on one port for all runs of a machine, and warns of the second.
                        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                        memory_limit=0,
                        silence_logs=logging.CRITICAL,
                    )
                address = self._cluster.scheduler_address
            client = Client(address, set_as_default=False, timeout=_CONNECT)
            client.register_plugin(self._delivery, name=self._delivery.name)
            client.subscribe_topic(self._delivery.name, self._hear)
            self._client = client
        except Exception as error:
            self._failure = error

    def _hear(self, event: tuple[float, dict[str, str]]) -> None:
        """Note which worker began a request, and when by the clock of this process."""
        told = event[1]
        self._begun[told["request"]] = time.monotonic(), told["worker"]

    def submit(self, request: Asked) -> None:
        """As `Pool`."""
        (self._local if request.position is None else self._held).append(request)

    @property
    def busy(self) -> bool:
        """As `Pool`."""
        return bool(self._local or self._held or self._futures or self._suspects)

    def next(self, stop: Callable[[], bool]) -> tuple[Any, Any] | None:
        """As `Pool`."""
        if self._local:
            request = self._local.pop(0)
            return request, self._job.respond(request, stop)
        self._starting.join(_TICK)
        if self._starting.is_alive():
            return None
        client = self._connected()
        for request in self._held:
            self._send(client, request)
        self._held.clear()
        if self._suspects and not self._futures:
            suspect = self._suspects.pop(0)
            self._alone = suspect.name
            self._send(client, suspect)
        try:
            return self._answer(self._events.get(timeout=_TICK))
        except queue.Empty:
            self._look(client)
            return self._late(client)

    def _connected(self) -> Client:
        if self._client is None:
            if self._scheduler is None:
                why = str(self._failure).rstrip(".")
                raise StoppedError(
                    f"no workers on this machine: {why}; look at its memory, and if a script of your own began them, "
                    "begin them under 'if __name__ == \"__main__\":'"
                )
            raise StoppedError(
                f"no workers on {self._scheduler}: {self._failure}; check the address and the network"
            )
        return self._client

    def _send(self, client: Client, request: Asked) -> None:
        future = client.submit(
            self._perform,
            self._delivery.name,
            request,
            key=f"{self._delivery.name}-{request.name}{'-alone' if request.name == self._alone else ''}",
            # Otherwise the chains, which keep no more than a worker each busy, would be all that is left at the end.
            priority=request.followers,
            pure=False,
        )
        self._futures[request.name] = request, future
        future.add_done_callback(lambda _: self._events.put(request.name))

    def _answer(self, name: str) -> tuple[Any, Any] | None:
        """The answer that came in, unless it is none."""
        if name not in self._futures:
            return None
        request, future = self._futures[name]
        if future.status in ("lost", "cancelled"):
            self._look(self._connected())
            raise StoppedError("the scheduler has lost the work it was given")
        del self._futures[name]
        try:
            response = future.result()
        except KilledWorker:
            if name != self._alone:
                self._suspects.append(request)
                return None
            reason = "every worker process that tried it died; look at its memory"
            return request, self._job.unanswered(request, reason)
        future.release()
        return request, response

    def _look(self, client: Client) -> None:
        """See that the scheduler is there, and has workers."""
        if client.status != "running":
            raise StoppedError(f"the scheduler {self._scheduler or 'of this machine'} is lost")
        now = time.monotonic()
        if client.scheduler_info(n_workers=-1)["workers"]:
            self._company = now
        elif now - self._company > _LONELY:
            raise StoppedError(f"there has been no worker for {_LONELY:.0f} s")

    def _late(self, client: Client) -> tuple[Any, Any] | None:
        """Stop a point that hangs, together with its worker."""
        now = time.monotonic()
        for name, (begin, worker) in list(self._begun.items()):
            if name not in self._futures or now - begin < self._job.limit + _GRACE:
                continue
            request, future = self._futures.pop(name)
            client.cancel([future], force=True)
            client.restart_workers([worker], timeout=30, raise_for_error=False)
            return request, self._job.unanswered(request, late_reason(self._job.limit))
        return None
