"""One thread before NumPy loads: the last bits of an eigenvalue change with the number of threads."""

import os

import pytest

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
