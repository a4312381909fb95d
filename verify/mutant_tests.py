"""Which tests execute which line, and whether they notice a mutant: the part of verify/mutants.py that runs pytest.

`record` runs the suite once and writes down what each test executes and how long it takes. Shared fixtures and
caches are emptied before each test, so that none lives on what another one has computed. `Loaded` imports fosopt and
its tests once and forks a process for each mutant, in which the code of the changed function is replaced. What that
cannot do, since it happens while modules are imported or is compiled by numba, `run_imported` does in a process that
imports fosopt with the changed file.
"""

from __future__ import annotations

import gc
import gzip
import importlib
import json
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest

LIBRARIES = (  # imported before anything is forked; none of them knows fosopt
    "numpy.testing casadi numba scipy.integrate scipy.interpolate scipy.io scipy.linalg scipy.optimize scipy.signal "
    "scipy.sparse.linalg scipy.stats cvxpy clarabel pydantic ruamel.yaml rich.console rich.table typer.testing "
    "hypothesis.strategies control openmdao.api plotly.graph_objects matplotlib.figure dask distributed"
)
OPTIONS = ["-q", "-s", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:cov"]
OPTIONS += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # of libraries imported before
# These start processes or browsers, or take minutes.
SKIPPED = ("browser", "bench", "cluster", "interrupt", "notebooks", "page", "reproduce", "resume")
MEMORY = 8 << 30  # bytes a mutant may take
NOTICED, SURVIVES, ENDLESS, CRASHES, OTHERWISE = (
    "noticed",
    "survives",
    "endless",
    "crashes",
    "irreplaceable",
)


@dataclass(frozen=True)
class Executed:
    """What the tests execute.

    Attributes
    ----------
    seconds
        Of each test that passes, with the fixtures it needs and under the recorder.
    tests
        Of each line of each file, those that execute it.
    imported
        Lines of each file that run while modules are imported.
    """

    seconds: dict[str, float]
    tests: dict[str, dict[int, list[str]]]
    imported: dict[str, set[int]]

    @classmethod
    def read(cls, path: Path) -> Executed:
        """What `record` has written."""
        with gzip.open(path, "rt") as file:
            raw = json.load(file)
        names = list(raw["seconds"])
        tests = {
            name: {int(line): [names[k] for k in numbers] for line, numbers in lines.items()}
            for name, lines in raw["tests"].items()
        }
        return cls(raw["seconds"], tests, {name: set(lines) for name, lines in raw["imported"].items()})


def warm_up(root: Path) -> None:
    """Import the libraries, and have fosopt come from a tree."""
    for name in LIBRARIES.split():
        with suppress(ImportError):
            importlib.import_module(name)
    os.chdir(root)
    os.environ.update(CI="1", PYTHONPATH=str(root))
    sys.path.insert(0, str(root))


def _processor_time() -> float:
    """Of this process and those it has waited for [s]."""
    return time.process_time() + sum(os.times()[2:4])


class _Recorder:
    """Runs every test as if it were the only one."""

    def __init__(self, root: Path, coverage: Any, path: Path) -> None:
        self.root, self.coverage, self.path = root, coverage, path
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self.failed.add(report.nodeid)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        for item in session.items:
            self._empty_caches()
            self.coverage.switch_context(item.nodeid)
            began = _processor_time()
            # No next item: fixtures of the session are torn down as well.
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
            self.seconds[item.nodeid] = _processor_time() - began
        self._write()
        return True

    def _write(self) -> None:
        data = self.coverage.get_data()
        seconds = {name: spent for name, spent in self.seconds.items() if name not in self.failed}
        number = {name: k for k, name in enumerate(seconds)}
        lines = {
            str(Path(file).relative_to(self.root)): data.contexts_by_lineno(file)
            for file in data.measured_files()
        }
        found = {
            "seconds": seconds,
            "tests": {
                file: {
                    line: [number[name] for name in names if name in number] for line, names in each.items()
                }
                for file, each in lines.items()
            },
            "imported": {
                file: [line for line, names in each.items() if "" in names] for file, each in lines.items()
            },
        }
        with gzip.open(self.path, "wt", compresslevel=1) as file:
            json.dump(found, file)

    def _empty_caches(self) -> None:
        for module in list(sys.modules.values()):
            if str(getattr(module, "__file__", None)).startswith(str(self.root)):
                for value in list(vars(module).values()):
                    if hasattr(value, "cache_clear"):
                        value.cache_clear()


def record(root: Path, packages: Iterable[str], path: Path) -> None:
    """Run the suite and write what each test executes of some packages."""
    import coverage

    warm_up(root)
    measured = coverage.Coverage(
        data_file=None, config_file=False, source=[str(root / "fosopt" / package) for package in packages]
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    measured.start()
    recorder = _Recorder(root, measured, path)
    ignored = [f"--ignore-glob=*_{name}*.py" for name in SKIPPED]
    pytest.main([*OPTIONS, *ignored, str(root / "tests")], plugins=[recorder])
    measured.stop()
    passed = len(recorder.seconds.keys() - recorder.failed)
    print(f"{passed} tests pass alone, {len(recorder.failed)} do not and are left out", flush=True)


class _Chosen:
    """Runs chosen tests until one fails."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self.seconds = seconds
        self.failed = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.failed |= report.failed

    def first_failure(self, items: Sequence[pytest.Item]) -> str:
        """What became of a mutant; a test that takes far too long ends the process."""
        for item, following in zip(items, [*items[1:], None], strict=True):
            signal.setitimer(signal.ITIMER_PROF, 5 + 10 * self.seconds[item.nodeid])
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            signal.setitimer(signal.ITIMER_PROF, 0)
            if self.failed:
                return f"{NOTICED} {item.nodeid}"
        return SURVIVES


class Loaded(_Chosen):
    """fosopt and all tests, imported once; `work` is called with this and judges mutants, each in a fork."""

    def __init__(self, root: Path, seconds: dict[str, float], work: Callable[[Loaded], None]) -> None:
        super().__init__(seconds)
        self.root, self.work = root, work
        self.items: dict[str, pytest.Item] = {}
        self.functions: dict[tuple[str, CodeType], list[FunctionType]] = {}

    def start(self) -> None:
        """Collect the tests and work."""
        files = sorted({name.partition("::")[0] for name in self.seconds})
        pytest.main([*OPTIONS, *files], plugins=[self])

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        for path in sorted((self.root / "fosopt").rglob("[a-z]*.py")):
            importlib.import_module(".".join(path.relative_to(self.root).with_suffix("").parts))
        self.items = {item.nodeid: item for item in session.items}
        for each in gc.get_objects():
            if isinstance(each, FunctionType) and each.__code__.co_filename.startswith(str(self.root)):
                self.functions.setdefault((each.__code__.co_filename, each.__code__), []).append(each)
        gc.freeze()
        self.work(self)
        return True

    def run(self, path: Path, source: bytes, tests: Sequence[str]) -> str:
        """What tests say to another source of a file, whose functions it replaces."""

        def verdict() -> str:
            old, new = (
                compile(text, path, "exec", dont_inherit=True) for text in (path.read_bytes(), source)
            )
            if not self._replace(str(path), old, new):
                return OTHERWISE
            return self.first_failure([self.items[name] for name in tests])

        return forked(verdict, 120 + 10 * sum(self.seconds[name] for name in tests))

    def _replace(self, path: str, old: CodeType, new: CodeType) -> int:
        if old == new:
            return 0
        functions = self.functions.get((path, old), [])
        for function in functions:
            function.__code__ = new
        inner = ([each for each in code.co_consts if isinstance(each, CodeType)] for code in (old, new))
        return len(functions) + sum(self._replace(path, *pair) for pair in zip(*inner, strict=True))


class _Imported(_Chosen):
    """Collects chosen tests and runs them in their order."""

    verdict = f"{CRASHES} before any test"

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        found = {item.nodeid: item for item in items}
        items[:] = [found[name] for name in self.seconds if name in found]

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            self.verdict = f"{NOTICED} while fosopt or its tests are imported"
        elif len(session.items) == len(self.seconds):
            self.verdict = self.first_failure(session.items)
        return True


def run_imported(path: Path, source: bytes, tests: dict[str, float]) -> str:
    """What tests say to another source of a file, in a process that has not imported fosopt before."""

    def verdict() -> str:
        from numba.core.dispatcher import Dispatcher

        read = SourceFileLoader.get_code

        def get_code(loader: SourceFileLoader, name: str) -> CodeType | None:
            changed = loader.path == str(path)
            return compile(source, path, "exec", dont_inherit=True) if changed else read(loader, name)

        setattr(SourceFileLoader, "get_code", get_code)  # noqa: B010
        if b"import numba" in source:
            # What it has stored belongs to the file on disk.
            Dispatcher.enable_caching = lambda self: None  # type: ignore[method-assign]
        plugin = _Imported(tests)
        pytest.main([*OPTIONS, *sorted({name.partition("::")[0] for name in tests})], plugins=[plugin])
        return plugin.verdict

    return forked(verdict, 120 + 10 * sum(tests.values()))


def forked(work: Callable[[], str], limit: float) -> str:
    """What a function says in a process of its own, or how that ended; it is stopped after so many seconds."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nowhere, stream)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        try:
            word = work()
        except BaseException as error:
            word = f"{CRASHES} {error!r}"
        os.write(writing, word.encode()[:4000])
        os._exit(0)
    os.close(writing)
    try:
        ready = select.select([reading], [], [], limit)[0]
        word = os.read(reading, 4096).decode() if ready else ENDLESS
        if not word:
            status = os.waitpid(child, 0)[1]
            child = 0
            word = ENDLESS if os.WTERMSIG(status) == signal.SIGPROF else f"{CRASHES} {status}"
    finally:
        os.close(reading)
        if child:
            with suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
    return word
