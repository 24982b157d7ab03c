# The two commands: `make demo` runs the main job, `make test` passes the tests. Both need Python 3.11+ only.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
JOBS ?= 2
BLENDER ?= 4.5

# Left to `make test-slow`: pages in a browser, commands of the documents, long properties, what is dear (tests/dear.toml).
SLOW := browser or documents or nightly or dear
# A worker begins with its own half and takes from the other's when it is done: files stay together, and what their tests
# share is made and compiled once. Tests start many processes: each would compile the whole package anew where Python is
# told to keep nothing of it. The workers fill the cores: threads that share one matrix would wait for each other there.
PYTEST := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/pytest --dist worksteal -n
# A test of a page waits for its browser now and then: with one worker more no core is idle meanwhile.
MORE := $(shell expr $(JOBS) + 1 2>/dev/null || echo $(JOBS))
# `make test COVERAGE=1` adds what it ran to the data that `make coverage` prints.
COVERED := $(if $(COVERAGE),--cov --cov-append --cov-report=)

.PHONY: demo studio test test-slow test-postgres submission nightly quick lint style types coverage wheel fuzz bench peers blender figures docs lock clean

# While the demo's first act runs on one core, the other compiles what the next acts need, then the byte code of the
# packages, which pip would compile alone before.
demo: $(VENV)/.demo
	{ $(BIN)/dousa warm evaluation estimation; $(BIN)/python -m compileall -q $(VENV)/lib; } > /dev/null 2>&1 & \
	  PYTHONDONTWRITEBYTECODE= $(BIN)/dousa demo

# The demo's library in the browser; makes the demo first if need be.
studio: $(VENV)/.demo
	$(BIN)/dousa demo --studio

# Style and tests; types, which a third of that time goes into, are for `make lint` and CI.
test: style quick

quick: $(VENV)/.dev
	$(PYTEST) $(JOBS) -m "not ($(SLOW))" $(COVERED)

test-slow: $(VENV)/.dev
	$(PYTEST) $(MORE) -rR -m "$(SLOW)" $(COVERED)

# The tests of libraries once more, each library a database of a PostgreSQL server that they start.
test-postgres: $(VENV)/.dev
	DOUSA_TEST_DATABASE=postgresql $(PYTEST) $(JOBS) -m "not nightly" tests/library $(COVERED)

# What CI runs with every submission: tests/submission.py says what is left to `make nightly`.
submission: $(VENV)/.dev
	$(PYTEST) $(JOBS) -rRs -m "not nightly" $(COVERED)

# Everything: all tests in one go, those of libraries on PostgreSQL, style, types, the site and the packages.
nightly: $(VENV)/.all
	NIGHTLY=1 .ci/run

lint: style types

style: $(VENV)/.dev
	$(BIN)/ruff check src lab tests docs blender .ci conftest.py
	$(BIN)/ruff format --check src lab tests docs blender .ci conftest.py

types: $(VENV)/.dev
	$(BIN)/mypy

# Lines and branches by rooms, of the tests that were run with COVERAGE=1.
coverage: $(VENV)/.dev
	$(BIN)/python .ci/print_coverage.py

# The packages as they are released, and the wheel tried in an environment of its own; with PLAIN=1 without extras alone.
wheel: $(VENV)/.dev
	rm -rf dist
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python .ci/try_wheel.py dist $(if $(PLAIN),--plain)

fuzz: $(VENV)/.dev
	DOUSA_FUZZ_SECONDS=300 $(BIN)/pytest -m fuzz

# The table of docs/performance.md, in some 15 minutes.
bench: $(VENV)/.bench
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m lab.benchmarks --write

# aeon needs an older NumPy and numba than our constraints: the comparison with it has an environment of its own.
peers:
	test -x $(VENV)-peers/bin/python || $(PYTHON) -m venv $(VENV)-peers
	$(VENV)-peers/bin/python -m pip install --quiet --disable-pip-version-check -e . 'aeon>=1.6'
	$(VENV)-peers/bin/python -m lab.trials.recognition

# The extension for Blender: tried in a Blender without windows (its package, 360 MB, wants Python 3.11), then packed.
# `make blender BLENDER=5.0` tries it with another one.
blender: $(VENV)/.demo
	test -x $(VENV)-blender/bin/python || $(PYTHON) -m venv $(VENV)-blender
	$(VENV)-blender/bin/python -m pip install --quiet --disable-pip-version-check 'bpy==$(BLENDER).*' pytest
	DOUSA=$(abspath $(BIN))/dousa $(VENV)-blender/bin/python -B -m pytest -c blender/tests/pytest.ini blender/tests
	mkdir -p build
	rm -rf blender/dousa_motion_search/__pycache__
	cd blender && ../$(BIN)/python -m zipfile -c ../build/dousa_motion_search.zip dousa_motion_search

figures: $(VENV)/.dev
	$(BIN)/python -m lab.figures.make_figures

# The documentation site, in build/site; the examples of its gallery are run, broken links fail.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

# Versions that were tested together; `make lock` writes them anew from the present environment.
$(VENV)/.demo: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[all]'
	touch $@

# One call resolves the packages, and builds ours, once. Two processes compile what pip would compile in one, and each
# worker of the tests for itself: a third less without packages' own tests and what few tests load. Some files are no Python.
$(VENV)/.dev: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[dev]'
	$(BIN)/python -m compileall -q -j 2 -x '/(tests|pip|moto)/' $(VENV)/lib src >/dev/null || true
	touch $(VENV)/.demo $@

$(VENV)/.docs: $(VENV)/.demo
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	touch $@

# All of it in one call.
$(VENV)/.all: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[dev,docs]'
	$(BIN)/python -m compileall -q -j 2 -x '/(tests|pip|moto)/' $(VENV)/lib src >/dev/null || true
	touch $(VENV)/.demo $(VENV)/.dev $(VENV)/.docs $@

$(VENV)/.bench: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	touch $@

lock: $(VENV)/.bench $(VENV)/.docs
	$(BIN)/python -m pip freeze --exclude-editable --exclude dousa | grep -v '^-e' > constraints.txt

clean:
	rm -rf $(VENV) $(VENV)-peers $(VENV)-blender build demo-output dist htmlcov .coverage* .pytest_cache .hypothesis .ruff_cache .mypy_cache
