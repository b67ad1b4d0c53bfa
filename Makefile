# Two commands matter: `make calibrate` and `make test`. Each makes the environment that it needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# One thread per test worker: two workers fill two cores.
ONE_THREAD := OMP_NUM_THREADS=1 XLA_FLAGS=--xla_cpu_multi_thread_eigen=false
# Each module's tests stay in one worker, which makes its beds and compiles its programs once.
TESTS := $(ONE_THREAD) $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: calibrate test quick test-slow test-rare check lint docs notebooks verification verification-quick clean help

calibrate: $(STAMP)  ## fit the bundled soil with 2000 spheres; results in results/calibrate
	$(BIN)/calibrate fit --preset standard --out results/calibrate

test: $(STAMP)  ## lint and, at the same time, the tests that take seconds, on two cores
	@$(MAKE) --no-print-directory --jobs=2 lint quick

quick: $(STAMP)
	$(TESTS) -m "not slow"

test-slow: $(STAMP)  ## the other tests, but for rare ones
	$(TESTS) -m "slow and not rare"

test-rare: $(STAMP)  ## tests of minutes: derivatives through a run, thousands of files, races of a study
	$(TESTS) -m rare

check: lint  ## lint and the fast tests, in about a minute
	$(TESTS) -m "not thorough and not slow"

lint: $(STAMP)  ## style, format and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

docs: $(STAMP)  ## the documentation as a searchable site, in build/docs/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

notebooks: $(STAMP)  ## run all notebooks in place, with times; a quarter of an hour
	$(BIN)/python notebooks/execute.py

verification: $(STAMP)  ## make the numbers of README and pages again, as far as they are out of date; many hours
	$(BIN)/python -m verification

verification-quick: $(STAMP)  ## which of these numbers no longer hold; ten minutes
	$(BIN)/python -m verification.quick

clean:  ## remove the environment, caches and build products; results/ stays
	rm -rf $(VENV) build dist *.egg-info .jax_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

help:  ## show this list
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 20

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "error: Python 3.11 or later is needed ($(PYTHON) is older or missing); try: make PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet -r requirements.lock
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --no-build-isolation --no-deps -e .
	@touch $@
