# `make demo` and `make test` need nothing but a Python >= 3.11; they set up .venv themselves.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DOCS_READY := $(VENV)/.ready-docs
# lines of the package that the tests run, in percent; numba's kernels are not counted
COVERAGE := 96

.PHONY: demo test types kernels fuzz bench tables docs format clean clean-kernels

demo: $(READY)
	$(BIN)/slammot-graph demo --output runs/demo

test: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@$(MAKE) --no-print-directory -j 2 types kernels
	$(BIN)/pytest -n 2 --cov --cov-report=term --cov-fail-under=$(COVERAGE)

types: $(READY)
	$(BIN)/mypy

# compiled once here, beside the types; the processes of the tests would all compile the same ones
kernels: $(READY)
	$(BIN)/slammot-graph demo --output build/demo

# 20,000 examples for each reader, other ones each time
fuzz: $(READY)
	SLAMMOT_HYPOTHESIS=long $(BIN)/pytest -n 2 tests/fuzz

bench: $(READY)
	$(BIN)/python -m experiments.speed --gate

# all tables that are not of today's code, hours; goes on where it was ended. Pieces: make tables ONLY="sweep ladder"
tables: $(READY)
	$(BIN)/python -m experiments.gallery $(ONLY)

docs: $(DOCS_READY)
	$(BIN)/sphinx-build -q -W --keep-going -d build/doctrees docs build/docs
	@echo "open build/docs/index.html"

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean-kernels:
	find slammot_graph -name '*.nb[ic]' -delete

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .coverage
	find slammot_graph tests experiments -name __pycache__ -type d -prune -exec rm -rf {} +

$(READY): pyproject.toml
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(v < (3, 11) and "this needs Python 3.11 or newer, not %d.%d; name one with: make PYTHON=python3.11" % v[:2])'
	@echo "setting up $(VENV) (once; a few minutes)"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

$(DOCS_READY): $(READY)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@touch $@
