"""Shared fixtures, and what must hold before NumPy loads."""

import os

import pytest
from hypothesis import settings

# A slow machine is no defect. Continuous integration repeats the same cases; elsewhere they are drawn anew.
settings.register_profile("any", deadline=None)
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable" if os.environ.get("CI") else "any")

# One thread: the last bits of an eigenvalue change with the number of threads.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


@pytest.fixture(scope="session")
def shared():
    """The module of shared systems, imported here because it loads NumPy."""
    import reference

    return reference


@pytest.fixture(scope="session")
def dissertation(shared):
    """Numbers printed in the dissertation, by the table they stand in."""
    return shared.DISSERTATION


@pytest.fixture(scope="session")
def fem2(shared):
    """The dissertation's truss, fixed-free."""
    return shared.structure("fixed")


@pytest.fixture(scope="session")
def fem3(shared):
    """The dissertation's truss, pinned-free."""
    return shared.structure("pinned")


@pytest.fixture(scope="session")
def frame3(shared, fem3):
    """Modes of the pinned-free truss with the mirror's mass at its tip."""
    return shared.frame(fem3)


@pytest.fixture(scope="session")
def evaluation(shared):
    """The reference system, stable, with a disturbance at each input."""
    return shared.evaluation()


@pytest.fixture(scope="module")
def chromium():
    """A headless Chromium for all tests of a file."""
    from headless import browsing

    with browsing() as browser:
        yield browser


@pytest.fixture
def browser(chromium):
    """The browser, which must have had no trouble and asked for nothing when a test ends."""
    chromium.troubles.clear()
    chromium.requests.clear()
    yield chromium
    assert not chromium.foreign, chromium.foreign
    assert not chromium.troubles, "\n".join(chromium.troubles)
