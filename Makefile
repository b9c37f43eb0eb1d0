# make demo   the daemon's main job on the simulated rig, judged       make lint   ruff and mypy strict
# make test   the gate: smoke tests, then all in simulated time         make bench  timing against cyclictest
# make check   what a change touches, in two minutes (FILE=... BASE=...)     make test-live   evidence: studies, real time
# make test-machine   before a release: long runs, services in a systemd of their own, the guest kernel's bus faults
# make deb    Debian packages, installable offline     make docs   the documentation site, which `rigctl page` serves
# make coverage   branches of modes and safety table    make mutation   mutants, all or a sample    make fuzz
# make soak   SOAK=1h of random commands, kills and a full disk   make wheel, lock   release: wheel, SBOM, hashes
SHELL := /bin/bash
# Debian's own Python where there is one: the packages run it, and it is built with profile-guided optimisation.
BASE_PYTHON := $(shell PATH=/usr/bin:$$PATH command -v python3.11 || echo python3)
VENV := .venv
PYTHON := $(VENV)/bin/python
STAMP := $(VENV)/.installed
SOAK ?= 1h
BASE ?= main
# uv installs in a fifth of pip's time, and repeats a download itself; pip may be set up for an index that uv is not.
PIP := $(PYTHON) -m pip install --no-compile --quiet --disable-pip-version-check
# Where the environment forbids bytecode, each of the tests' many processes would compile the whole program anew.
unexport PYTHONDONTWRITEBYTECODE
GATE := not real_time and not study and not long
REAL_TIME := tests/guest tests/live tests/loop/test_pytest_plugin.py

.PHONY: demo test check test-live test-machine lint bench coverage mutation fuzz soak wheel lock deb docs setup system
.DELETE_ON_ERROR:

demo: $(STAMP)
	mkdir -p results
	$(VENV)/bin/rigctl demo config/paper_rig.yaml --json results/demo.json

test: $(STAMP) system
	@mkdir -p results; export SMOKE_SUMMARY=$(CURDIR)/results/smoke.txt; rm -f $$SMOKE_SUMMARY; smoke=0; tests=0; \
	$(PYTHON) -m pytest tests/guest tests/live -m smoke --numprocesses auto || smoke=$$?; \
	TEST_DURATIONS=results/durations.json \
	    $(PYTHON) -m pytest -m "$(GATE)" --numprocesses auto --dist worksteal || tests=$$?; \
	exit $$((smoke > tests ? smoke : tests))

check: $(STAMP)
	$(PYTHON) -m tests.check --marks "$(GATE)" --base $(BASE) $(FILE:%=--file %)

test-live: $(STAMP) system
	$(PYTHON) -m tests.evidence

test-machine: $(STAMP) system
	$(PYTHON) -m pytest -m "long and not real_time" --numprocesses auto
	$(PYTHON) -m pytest $(REAL_TIME) -m "long and real_time"
	$(PYTHON) -m pytest $(REAL_TIME) -m machine

lint: $(STAMP)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(PYTHON) -m tests.static_types

bench: $(STAMP) system
	mkdir -p results
	$(PYTHON) -m tests.bench --json results/bench.json

coverage: $(STAMP)
	mkdir -p results
	$(VENV)/bin/coverage run --branch --data-file results/.coverage --include rigctl/control/modes.py,rigctl/control/watch/safety.py \
	    -m pytest tests/unit/control
	$(VENV)/bin/coverage report --data-file results/.coverage --show-missing --fail-under 100

mutation: $(STAMP)
	$(PYTHON) -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,mutation]'
	$(PYTHON) -m tests.mutation

fuzz: $(STAMP)
	mkdir -p results
	$(PYTHON) -m pytest -m "hypothesis and not real_time" --hypothesis-profile search --numprocesses auto
	$(PYTHON) -m tests.fuzz --json results/fuzz.json

soak: $(STAMP) system
	$(PYTHON) -m tests.soak --for $(SOAK)

wheel: $(STAMP)
	$(PYTHON) deploy/release/wheel.py

docs: $(STAMP)
	@echo "building the pages of docs/ into rigctl/page/site:"
	$(PYTHON) -m mkdocs build --strict -f deploy/docs/mkdocs.yml
	@echo "rigctl/page/site/index.html; rigctl page serves it under /docs"

lock: $(STAMP)
	$(PYTHON) deploy/release/lock.py

setup: $(STAMP)

system:
	tests/guest/setup

$(STAMP): pyproject.toml constraints.txt
	test -x $(PYTHON) || $(BASE_PYTHON) -m venv $(VENV) || { tests/guest/apt python3-venv && $(BASE_PYTHON) -m venv $(VENV); }
	@echo "setting up $(VENV), which takes a minute or two:"
	tests/guest/thrice $(PIP) -c constraints.txt uv
	$(VENV)/bin/uv pip install --python $(PYTHON) -c constraints.txt -e '.[dev]' \
	    || tests/guest/thrice $(PIP) -c constraints.txt -e '.[dev]'
	$(PYTHON) -m hil.plant
	touch $@

deb: $(STAMP)
	deploy/deb $(PYTHON) dist
