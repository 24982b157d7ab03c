# The two commands: `make demo` runs the main job, `make test` passes the tests. Both need Python 3.11+ only.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
JOBS ?= 2

.PHONY: demo studio test lint fuzz bench peers figures lock clean

demo: $(VENV)/.installed
	$(BIN)/dousa demo

# The demo's library in the browser; makes the demo first if need be.
studio: $(VENV)/.studio
	$(BIN)/dousa demo --studio

test: $(VENV)/.dev lint
	$(BIN)/pytest -n $(JOBS)

lint: $(VENV)/.dev
	$(BIN)/ruff check src tests benchmarks docs
	$(BIN)/ruff format --check src tests benchmarks docs

fuzz: $(VENV)/.dev
	DOUSA_FUZZ_SECONDS=300 $(BIN)/pytest -m fuzz

bench: $(VENV)/.bench
	for claim in benchmarks/[a-z]*.py; do echo "== $$claim"; $(BIN)/python $$claim || exit 1; done

# aeon needs an older NumPy and numba than our constraints: the comparison with it has an environment of its own.
peers:
	test -x $(VENV)-peers/bin/python || $(PYTHON) -m venv $(VENV)-peers
	$(VENV)-peers/bin/python -m pip install --quiet --disable-pip-version-check -e '.[studio]' 'aeon>=1.6' 'nicegui>=3' \
	  selenium pytest
	$(VENV)-peers/bin/python benchmarks/recognition.py
	$(VENV)-peers/bin/python benchmarks/studio_framework.py

figures: $(VENV)/.dev
	$(BIN)/python docs/make_figures.py

# Versions that were tested together; `make lock` writes them anew from the present environment.
$(VENV)/.installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	touch $@

$(VENV)/.studio: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[studio]'
	touch $@

$(VENV)/.dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

$(VENV)/.bench: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	touch $@

lock: $(VENV)/.bench
	$(BIN)/python -m pip freeze --exclude-editable --exclude dousa | grep -v '^-e' > constraints.txt

clean:
	rm -rf $(VENV) $(VENV)-peers demo-output .pytest_cache .hypothesis .ruff_cache
