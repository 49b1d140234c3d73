# Everything runs in a private virtual environment that the first target builds: Python >= 3.11 and make suffice.
IS_RECENT := 'import sys; sys.exit(sys.version_info < (3, 11))'
PYTHON ?= $(shell for python in python3 python3.14 python3.13 python3.12 python3.11 python; do \
  $$python -c $(IS_RECENT) 2>/dev/null && echo $$python && break; done)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
READY_FOR_DOCS := $(VENV)/.ready_for_docs

# One thread of linear algebra, as on the command line: two test workers share the cores.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help demo test faults lint docs regress setup clean

help:
	@echo "make demo   render a roundabout with known truth, analyse and evaluate it"
	@echo "make test   run all tests"
	@echo "make faults kill, damage and starve every command at many drawn moments and places, and disturb a batch"
	@echo "make regress  analyse simulated clips, hold them against their baselines"
	@echo "make lint   style, types and the direction of imports"
	@echo "make docs   the documentation as a searchable site: open site/index.html"
	@echo "make clean  remove the virtual environment and all caches"

demo: $(READY)
	$(BIN)/ttcvid demo --out out/demo --overwrite

# Files, not tests, are shared out: what the tests of a file have in common is made once. Those with slow tests come
# first (tests/conftest.py), so that no worker waits long for the other at the end. Tests with asserts that explain
# themselves take long to compile, which each worker would do anew where Python is told to write no bytecode.
test: $(READY)
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

faults: $(READY)
	$(BIN)/python -m pytest -n 2 -m exhaustive tests

regress: $(READY)
	$(BIN)/ttcvid regress sample_configs/regression.yaml --jobs 2 --out out/regress

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Links that lead nowhere and pages that nothing leads to are errors.
docs: $(READY_FOR_DOCS)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" && $(PYTHON) -c $(IS_RECENT) || { echo "make: error: no Python >= 3.11 found:" \
	  "install one, or name it: make $(MAKECMDGOALS) PYTHON=/path/to/python3.12" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { echo "make: error: $(PYTHON) cannot make virtual environments:" \
	  "install its venv module (on Debian and Ubuntu the package python3-venv)" >&2; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@# pip compiles what it copies, but not a package that stays where it is; where Python is told to write no bytecode
	@# (PYTHONDONTWRITEBYTECODE), every start would compile it again, which takes half a second.
	$(BIN)/python -m compileall -q ttcvid
	@# What every first analysis would compile, and every test process for itself.
	$(BIN)/ttcvid doctor --warm
	@touch $@

$(READY_FOR_DOCS): $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

clean:
	rm -rf $(VENV) out site .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +
