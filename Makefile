# Two commands matter on a fresh machine: `make emulator` and `make test`.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
MODEL  ?= ur3
ARGS   ?=
# which tests `make test` runs; MARKS= for all of them, with those of `make long` and `make pages`
MARKS  ?= not page and not long
# no more than there are cores: robots in real time have to keep up
JOBS   ?= $(shell nproc 2>/dev/null || echo 2)

# Byte code is kept, even where the surroundings say otherwise, as container images like to: the tests start some hundred
# processes, and half of the time of each would go into compiling what the one before compiled.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help emulator test long pages mutants soak bounded chaos fuzz cluster check audit wheel-check benchmarks docs site constraints clean

help: ## what there is to make
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

emulator: $(VENV)/.base ## sets up everything and starts a UR3; MODEL=ur5e for another arm, ARGS="--running" for options
	$(BIN)/ur-emulator --model $(MODEL) $(ARGS)

test: $(VENV)/.dev ## sets up what the tests need, and runs them
	tests/system_packages.sh
	$(BIN)/python -m pytest -n $(JOBS) --dist loadgroup -m "$(MARKS)" $(ARGS)

# Further models, keys and ways to be lost of tests that try some, and what takes long by its nature; every night in CI.
long: $(VENV)/.dev ## further arms and long runs of the same
	tests/system_packages.sh
	$(BIN)/python -m pytest -n $(JOBS) --dist loadgroup -m long $(ARGS)

# What README, docs and examples/ci tell a reader to type is typed, against robots in real time: some minutes.
pages: $(VENV)/.dev ## what README and docs tell you to type
	tests/system_packages.sh
	$(BIN)/python -m pytest -n $(JOBS) --dist loadgroup -m page $(ARGS)

# Bugs planted one at a time, and whether the tests of their subject find them: ten minutes to half an hour.
# ARGS="rtde motion" for those of some subjects only.
mutants: $(VENV)/.dev ## bugs planted one at a time, and whether the tests find them: ten minutes or more
	$(BIN)/python tests/mutants/mutants.py $(ARGS)

# Thousands of random programs in virtual time, some minutes: the arm keeps its limits, no number makes the controller
# fail, and no text or program takes more than half a control period. Then every test with random examples with twenty
# times as many, and hostile robots against every part of the client. The tests run a few of each. Then SEEDS stories of
# a driver and a robot with a network that fails, in virtual time. At last, two hours of everyday use, with bounds on the
# memory of emulator, pendant and client.
HOURS ?= 2
SEEDS ?= 100000
soak: $(VENV)/.dev ## thousands of random programs, hostile robots, SEEDS failing networks, then HOURS=2 of use: most of a day
	RANDOM_PROGRAMS=10000 RANDOM_EXTREMES=2000 RANDOM_COSTS=2000 $(BIN)/python -m pytest -n $(JOBS) --timeout 0 \
		tests/motion/test_random_programs.py tests/fuzzing
	EXAMPLES=20 $(BIN)/python -m pytest -n $(JOBS) --timeout 0 -m hypothesis
	HOSTILE_ROBOTS=4000 $(BIN)/python -m pytest --timeout 0 tests/client/test_hostile_robots.py \
		tests/ros2/test_hostile_robots.py
	SIMULATED_SEEDS=$(SEEDS) $(BIN)/python -m pytest -n $(JOBS) tests/simulation
	$(BIN)/python benchmarks/chaos.py --hours $(HOURS) mixed

# ARGS="dashboard" for the cases with this word in their names.
bounded: $(VENV)/.dev ## every command, verb, request and hostile file, against a bare loop: half an hour
	$(BIN)/python benchmarks/bounded.py $(ARGS)

# ARGS=--quick takes a minute.
chaos: $(VENV)/.dev ## accidents and enemies, against bars: a quarter of an hour
	$(BIN)/python benchmarks/chaos.py $(ARGS)

# Inputs that any reader of foreign bytes fails on, looked for with coverage: TIME seconds each, ARGS="rtde scripts" for
# some of them only, ARGS=--keep to keep what covered more.
TIME ?= 60
fuzz: $(VENV)/.fuzz ## inputs that a reader fails on; TIME=60 seconds each
	$(BIN)/python tests/fuzzing/fuzz.py --time $(TIME) $(ARGS)

# Campaigns on a Ray cluster of two nodes, of which one is killed; Ray is large, so it is installed for this alone.
cluster: $(VENV)/.cluster ## campaigns on two nodes of a Ray cluster
	$(BIN)/python -m pytest tests/campaign/test_cluster.py $(ARGS)

check: $(VENV)/.dev ## ruff, mypy and the other static checks
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32
	$(BIN)/mypy --platform darwin --cache-dir .mypy_cache/darwin
	$(BIN)/check-jsonschema --quiet --builtin-schema vendor.github-workflows $(wildcard .github/workflows/*.yml examples/ci/.github/workflows/*.yml)
	$(BIN)/check-jsonschema --quiet --builtin-schema vendor.github-actions action.yml
	$(BIN)/check-jsonschema --quiet --builtin-schema vendor.github-issue-forms .github/ISSUE_TEMPLATE/differs.yml .github/ISSUE_TEMPLATE/problem.yml
	$(BIN)/check-jsonschema --quiet --builtin-schema vendor.dependabot .github/dependabot.yml
	$(BIN)/check-jsonschema --quiet --builtin-schema vendor.gitlab-ci --data-transform gitlab-ci examples/ci/.gitlab-ci.yml
	$(BIN)/zizmor --offline --quiet --no-progress . examples/ci/.github
	@echo "make check: all clean"

# Known vulnerabilities of the packages in constraints.txt, from the index's advisories. Strict: a package about which it
# gets no answer, as without a network, is an error and not a package without vulnerabilities.
audit: | $(VENV)/bin/python ## known vulnerabilities of the packages in constraints.txt
	$(BIN)/python -m pip install --quiet pip-audit
	$(BIN)/pip-audit --strict --disable-pip --progress-spinner off --vulnerability-service pypi --requirement constraints.txt

# The wheel installs into a clean environment and is not confused by namesakes in the current folder.
wheel-check: $(VENV)/.dev ## the wheel and the source archive, in a clean environment
	$(BIN)/python tests/packaging/check_wheel.py

# ARGS="startup tick_rate" for some of them only. Results of a busy machine say little: close what else runs.
benchmarks: $(VENV)/.dev ## speed, memory, latency: half an hour
	tests/system_packages.sh
	$(BIN)/python benchmarks/run.py $(ARGS)

# Rewrites the generated tables in docs/ from the registries in the code.
docs: $(VENV)/.dev ## rewrites the generated pages
	$(BIN)/python docs/generate.py

# The documentation site, from docs/ and the pages beside it, without the internet; every link is followed.
site: $(VENV)/.dev ## the documentation site, in build/site
	$(BIN)/python docs/site.py

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { echo "Python 3.10 or newer is needed; set PYTHON=python3.12 or such" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV) || { echo "python3-venv is missing: install it (Debian: apt install python3-venv)" >&2; exit 2; }
	$(BIN)/python -m pip install --quiet --upgrade pip

# The first time takes one or two minutes: pip shows what it fetches.

$(VENV)/.base: pyproject.toml | $(VENV)/bin/python
	@echo "Setting up $(VENV): about 200 MB, one or two minutes, once."
	$(BIN)/python -m pip install --progress-bar on --editable '.[pendant]'
	touch $@

# CI takes what constraints.txt names, each file by its hash; elsewhere the newest packages are tried. Byte code comes
# into being where a package is used: compiling all packages takes as long as fetching them. The message packages of
# ROS 2 take one or two minutes, once, and a line is printed for each.
$(VENV)/.dev: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(if $(CI),tests/install_locked.sh $(BIN)/python,$(BIN)/python -m pip install --quiet --no-compile --editable '.[test,check]')
	$(BIN)/ur-client ros2 --setup || echo "Tests of the ROS 2 driver need the message packages: they will fail." >&2
	touch $@ $(VENV)/.base

$(VENV)/.fuzz: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --editable '.[fuzz]'
	touch $@

$(VENV)/.cluster: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --editable '.[cluster]'
	touch $@

# The newest packages that fit pyproject.toml, for every Python from 3.10 on and every system, with their hashes.
constraints: | $(VENV)/bin/python ## renews constraints.txt
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --extra test --extra check --universal --python-version 3.10 --upgrade \
	    --generate-hashes --custom-compile-command "make constraints" --quiet --output-file constraints.txt

clean: ## removes what the others made
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
