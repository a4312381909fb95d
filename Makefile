# make help lists the targets. PYTHON names another interpreter: make PYTHON=python3.13 test

PYTHON ?= $(shell for p in python3.11 python3 python3.12 python3.13; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
READY := .venv/ready

# One thread: the last bits of an eigenvalue change with the number of threads, and small matrices are faster.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

.PHONY: help test lint demo docs bench verify clean

help:
	@echo "make test    lint, then all tests"
	@echo "make lint    ruff and mypy"
	@echo "make demo    solve studies/mass-jitter.yaml; results and report go to runs/mass-jitter (the next to -2)"
	@echo "make docs    renew docs/study-file.md, the reference of the study file"
	@echo "make bench   run every benchmark"
	@echo "make verify  compare with Octave and CalculiX, and renew docs/verification.md"
	@echo "make clean   remove the environment and all caches; runs/ stays"

# One process to a processor; tests of one file share fixtures and stay together.
test: lint
	$(BIN)/pytest -n logical --dist loadfile

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

demo: $(READY)
	$(BIN)/fosopt run studies/mass-jitter.yaml

docs: $(READY)
	$(BIN)/fosopt schema --page docs/study-file.md

bench: $(READY)
	@set -e; for file in $$(grep -l '^if __name__' benchmarks/*.py); do echo "$$file"; $(BIN)/python "$$file"; done

verify: $(READY)
	$(BIN)/python verify/run.py

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis build dist *.egg-info
	find fosopt tests -name __pycache__ -type d -prune -exec rm -rf {} +

# The lock holds the build backend too, so nothing unpinned is fetched.
$(READY): requirements.lock pyproject.toml
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
		{ echo "fosopt needs Python 3.11 or newer; install it or name it: make PYTHON=... test" >&2; exit 1; }
	@echo "setting up .venv"
	@"$(PYTHON)" -m venv --clear .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@$(BIN)/python -m pip check
	@touch $@
