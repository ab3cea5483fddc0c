# make demo      set everything up in .venv and reproduce the paper
# make test      set up what the tests need and run the quick ones, with the import contract (three minutes)
# make check     everything quick: lint, format, types, import contract, tests
# make ci        the longer tests, and every command of the docs as printed; pictures of pages stay in build/screenshots
# make nightly   what is too long for every push: before a release (some hours)
# make docs      the documentation site, in build/docs/html;  make docs-links also asks whether external addresses answer
# make release   wheel and source distribution in dist, tried in an empty environment (docs/releasing.md)
# make pages     the tables, transcripts and figures of the docs, computed anew
# make bench, make bench-hji, make bench-arm, make bench-jitter, make bench-hardware, make bench-workspace,
# make bench-limits, make bench-firmware, make bench-codegen, make bench-estimator, make bench-certificates,
# make bench-filters, make bench-studio, make bench-robots: measure
# make faults    faults of sensors, drives, mechanics and clocks on four arms: what an exported controller does about them
# make mutants;  make clean;  make locks
#
# Needs Python 3.11 or newer, pip and make. A stamp in .venv remembers what was installed from which lock:
# when a lock changes, .venv is made anew.

VENV   ?= .venv
PEERS  ?= .venv-peers
PYTHONS := python3 python3.13 python3.12 python3.11 python
PYTHON ?= $(shell for p in $(PYTHONS); do \
             $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && { echo $$p; exit; }; done)

# The venv's Python keeps bytecode, whatever the user's shell says: tests start hundreds of processes.
unexport PYTHONDONTWRITEBYTECODE

PY      := $(VENV)/bin/python
RUN     := $(VENV)/.stamp-run
DEV     := $(VENV)/.stamp-dev
PROJECT := $(VENV)/.stamp-project
DOCS    := $(VENV)/.stamp-docs
# Beside a venv's own pip stands the outer one, for systems whose Python ships without ensurepip.
HAS      = -c 'import importlib.util, sys; sys.exit(importlib.util.find_spec(sys.argv[1]) is None)'
PIP     := if $(PY) $(HAS) pip; then pip="$(PY) -m pip"; else pip="$(PYTHON) -m pip --python $(PY)"; fi; \
           $$pip --disable-pip-version-check --no-input install --quiet

# All cores; the tests of a file stay together, so that what they share is made once.
SHARED  := -n auto --maxprocesses 8 --dist loadfile
QUICK   := -m "not ci and not nightly" $(SHARED)

.PHONY: demo test check ci nightly bench bench-hji bench-arm bench-jitter bench-campaign bench-hardware bench-workspace bench-compared bench-limits bench-firmware bench-codegen bench-estimator bench-certificates bench-filters bench-studio bench-robots faults peers pages docs docs-links mutants release released locks clean environment environment-dev environment-docs
.DELETE_ON_ERROR:

demo: environment
	$(VENV)/bin/flexhinf paper

test: environment-dev
	$(VENV)/bin/lint-imports
	$(PY) -m pytest $(QUICK)

check: environment-dev
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/pyright --pythonpath $(PY)
	$(VENV)/bin/lint-imports
	$(PY) -m pytest $(QUICK)

ci: environment-dev
	$(PY) -m pytest -m "ci and not nightly" $(SHARED)

# Needs example-robot-data (414 MB), which no lock has, and `make peers`; what is missing is skipped by name.
nightly: environment-dev
	$(PY) -m pytest -m nightly $(SHARED)
	$(PY) docs/make.py nightly

pages: environment-dev
	$(PY) docs/make.py

# Warnings are errors, and every program of gallery and notebooks runs; what ran before and has not changed is kept.
SPHINX := $(PY) -m sphinx -W --keep-going
docs: environment-docs
	@$(PY) docs/website/words.py
	$(SPHINX) -q docs build/docs/html
	@echo "The site: build/docs/html/index.html"

# Needs a network.
docs-links: environment-docs
	$(SPHINX) -b linkcheck docs build/docs/links

# Refuses a version that another file or the tag contradicts. An empty environment has what requirements.lock names alone.
release: environment-dev
	$(PY) .ci/release.py dist
	@rm -rf build/released
	@$(MAKE) --no-print-directory VENV=build/released released

released: $(RUN)
	@for each in dist/*.whl dist/*.tar.gz; do \
	  ( $(PIP) --no-deps --no-build-isolation --force-reinstall $$each ) && \
	  test "$$(cd / && $(CURDIR)/$(VENV)/bin/flexhinf --version)" = "flexhinf $$(echo $$each | sed 's/^dist.flexhinf-//; s/-py3.*//; s/.tar.gz//')" && \
	  (cd / && $(CURDIR)/$(VENV)/bin/flexhinf robots > /dev/null) && echo "$$each installs and runs" || exit 1; done

# Changes the checker in one place at a time and runs its tests: hours. Needs cosmic-ray: .venv/bin/python -m pip install cosmic-ray
mutants: environment-dev
	$(PY) -m fuzz.mutants checker

bench: environment-dev
	$(PY) -m benchmarks

bench-hji: environment-dev
	OMP_NUM_THREADS=1 $(PY) -m benchmarks.hji

bench-arm: environment-dev
	OMP_NUM_THREADS=1 $(PY) -m benchmarks.arm

# Against numba and JAX where `make peers` has been run: they have an environment of their own, and no lock.
bench-campaign: environment-dev
	FLEXHINF_PEERS=$(PEERS) $(PY) -m benchmarks.campaign

# Proofs beside matrix inequalities and sums of squares by cvxpy and Clarabel (`make peers`); about ten minutes.
bench-certificates: environment-dev
	FLEXHINF_PEERS=$(PEERS) $(PY) -m benchmarks.certificates

# Kalman filters beside FilterPy and Dynamax (`make peers`) on hard linear filters, and NEES; about half an hour.
bench-filters: environment-dev
	FLEXHINF_PEERS=$(PEERS) $(PY) -m benchmarks.filters

peers: $(PEERS)/.stamp

$(PEERS)/.stamp: benchmarks/campaign/peers.txt benchmarks/certificates/peers.txt benchmarks/filters/peers.txt
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/python -m pip --disable-pip-version-check --no-input install --quiet $(addprefix -r ,$^)
	touch $@

# 10,000 steps of seven links in real time; for more on an idle machine, python -m benchmarks.jitter --steps 1000000
bench-jitter: environment-dev
	OMP_NUM_THREADS=1 $(PY) -m benchmarks.jitter

# Designs at one pose, then the whole workspace: the rows that are missing in benchmarks/hardware/rows, one after the
# other, an hour or two with every row missing; and those of bench-workspace.
bench-hardware: environment-dev
	$(PY) -m benchmarks.hardware
	$(MAKE) bench-workspace

# Rows that are missing in benchmarks/workspace/rows for 200 goals of each robot; with every row missing, hours:
# make bench-workspace JOBS=4 makes four at a time.
JOBS ?= 1
bench-workspace: environment-dev
	$(PY) -m benchmarks.workspace --jobs $(JOBS)

# Rows that are missing in benchmarks/compared/rows: laws and campaigns over workspaces, at most half an hour a robot.
bench-compared: environment-dev
	$(PY) -m benchmarks.compared

# Designs, C and help of a commit (COMMIT=…) beside those of the present tree, number by number; ten minutes. The exit code
# is 1 where a law or a verdict changed, or a number that has no reason in benchmarks/frozen/reasons.py.
bench-frozen: environment-dev
	$(PY) -m benchmarks.frozen $(COMMIT)

# Designs of the arms of docs/limits.md, then the rows that are missing, in an hour or two with every one missing;
# FILES=folder has the robot files of others.
bench-limits: environment-dev
	$(PY) -m benchmarks.limits $(if $(FILES),--files $(FILES))

# Needs gcc. A seed is drawn and printed; OPTIONS="--seed 74 --runs 100" repeats and runs more. Two minutes.
faults: environment-dev
	$(PY) -m benchmarks.faults $(OPTIONS)

# Needs gcc, valgrind, arm-none-eabi-gcc and qemu-system-arm; two minutes.
bench-firmware: environment-dev
	$(PY) -m benchmarks.firmware

# Needs gcc, objdump, valgrind and cppcheck; two designs of seven links, half an hour.
bench-codegen: environment-dev
	$(PY) -m benchmarks.codegen

# A step of the filters in both forms, and beside filterpy's; some minutes.
bench-estimator: environment-dev
	OMP_NUM_THREADS=1 $(PY) -m benchmarks.estimator

# From a slider of the studio to its new band, in Chromium; a minute, on an idle machine.
bench-studio: environment-dev
	$(PY) -m benchmarks.studio

# Public URDF files, at once and after flexhinf init: those of example-robot-data where it is installed, and
# SOURCES="owner/name@commit=folder ..."; some minutes for 400 files.
bench-robots: environment-dev
	$(PY) -m benchmarks.robots $(foreach source,$(SOURCES),--source $(source))

# Set-up -----------------------------------------------------------------------------------------------------

environment: $(PROJECT)
environment-dev: $(DEV) $(PROJECT)
environment-docs: $(DOCS) $(PROJECT)

# Either lock makes the venv anew, so that nothing of an older lock stays behind.
$(RUN): requirements.lock requirements-dev.lock
	@test -n "$(PYTHON)" || { for p in $(PYTHONS); do command -v $$p && $$p --version; done >&2; \
	  echo "flexhinf needs Python 3.11 or newer, and none of $(PYTHONS) is one. Try: make PYTHON=/path/to/python3" >&2; exit 1; }
	@echo "Setting up $(VENV) with $$($(PYTHON) --version) (about half a minute) ..."
	@rm -rf $(VENV)
	@if $(PYTHON) $(HAS) ensurepip; then $(PYTHON) -m venv $(VENV); else $(PYTHON) -m venv --without-pip $(VENV); fi
	@$(PIP) --require-hashes -r requirements.lock
	@touch $@

$(DEV): $(RUN) requirements-dev.lock
	@echo "Adding the test tools ..."
	@$(PIP) --require-hashes -r requirements-dev.lock
	@touch $@

# On top of the test tools, which the same lock pins to the same versions.
$(DOCS): $(RUN) $(DEV) requirements-docs.lock
	@echo "Adding what builds the documentation ..."
	@$(PIP) --require-hashes -r requirements-docs.lock
	@touch $@

$(PROJECT): $(RUN) pyproject.toml
	@$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

# For maintainers (needs uv): pin what pyproject.toml asks for, with hashes and without addresses. The small lock
# constrains the other, so that one venv serves both.
LOCK := uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --no-emit-index-url --quiet
locks:
	$(LOCK) --group build pyproject.toml --output-file requirements.lock
	$(LOCK) --group build --extra test --extra docs --constraint requirements.lock pyproject.toml --output-file requirements-docs.lock
	$(LOCK) --group build --extra test --constraint requirements-docs.lock pyproject.toml --output-file requirements-dev.lock

clean:
	rm -rf $(VENV) $(PEERS) build dist .pytest_cache .ruff_cache .hypothesis .import_linter_cache .benchmarks
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
