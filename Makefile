# Two commands matter on a fresh machine: `make emulator` and `make test`.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
MODEL  ?= ur3
ARGS   ?=
# one more than there are cores: a good part of the tests waits for robots in real time
JOBS   ?= $(shell expr $$(nproc 2>/dev/null || echo 2) + 1)

.PHONY: emulator test soak check wheel-check benchmarks docs clean

emulator: $(VENV)/.base
	$(BIN)/ur-emulator --model $(MODEL) $(ARGS)

test: $(VENV)/.dev
	tests/system_packages.sh
	$(BIN)/python -m pytest -n $(JOBS) --dist loadgroup $(ARGS)

# Thousands of random programs in virtual time, some minutes: the arm keeps its limits, no number makes the controller
# fail, and no text or program takes more than half a control period. The tests run a few of each.
soak: $(VENV)/.dev
	RANDOM_PROGRAMS=10000 RANDOM_EXTREMES=2000 RANDOM_COSTS=2000 $(BIN)/python -m pytest -n $(JOBS) --timeout 0 \
		tests/motion/test_random_programs.py tests/fuzz

check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	@echo "make check: all clean"

# The wheel installs into a clean environment and is not confused by namesakes in the current folder.
wheel-check: $(VENV)/.dev
	$(BIN)/python tests/packaging/check_wheel.py

benchmarks: $(VENV)/.dev
	$(BIN)/python benchmarks/run.py

# Rewrites the generated tables in docs/ from the registries in the code.
docs: $(VENV)/.dev
	$(BIN)/python docs/generate.py

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed; set PYTHON=python3.12 or such" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV) || { echo "python3-venv is missing: install it (Debian: apt install python3-venv)" >&2; exit 2; }
	$(BIN)/python -m pip install --quiet --upgrade pip

# The first time takes a minute: pip shows what it fetches.

$(VENV)/.base: pyproject.toml | $(VENV)/bin/python
	@echo "Setting up $(VENV): about 200 MB of packages, a minute or so, once."
	$(BIN)/python -m pip install --progress-bar on --editable '.[pendant]'
	touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[test,check]'
	touch $@ $(VENV)/.base

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
