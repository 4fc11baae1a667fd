# Needs only python3 (3.11 to 3.13) with its venv module, make and git; all else goes into .venv.
.DEFAULT_GOAL := help
.PHONY: help setup demo quick test check format mutate build pythons docs clean

PYTHON ?= python3
BIN := .venv/bin
SETUP := .venv/.set-up
SOURCES := $(wildcard scan3d_twin tests examples benchmarks docs hatch_build.py)
ENGINE := hatch_build.py $(wildcard scan3d_twin/core/registration/native/*.[ch])
# One thread per worker: the arrays are small, and more threads only get into each other's way.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' Makefile | expand -t 16

$(SETUP): pyproject.toml uv.lock tools/setup.sh $(ENGINE)
	@PYTHON=$(PYTHON) sh tools/setup.sh
	@touch $@

setup: $(SETUP)  ## set up .venv

demo: $(SETUP)  ## digitise the paper's scene of three boxes in the twin
	$(BIN)/twin sim --scene three_boxes

quick: $(SETUP)  ## run the tests that take no simulator, in a minute
	@echo "the tests of the core, the codecs and the settings: under a minute on 2 cores"
	$(BIN)/pytest -n 2 -m "not slow" tests/core tests/devices tests/run tests/recording

# Three for two cores, as tests also wait for programs and emulated devices. Each takes a row of files,
# whose fixtures are then made once.
WORKERS ?= 3
test: $(SETUP)  ## run all tests
	@echo "all tests: about 14 minutes on 2 cores; make quick takes one"
	$(BIN)/pytest -n $(WORKERS) --dist worksteal

check: $(SETUP)  ## format, lint, types, import rules, spelling
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/mypy
	PYTHONPATH=. $(BIN)/lint-imports
	$(BIN)/codespell

format: $(SETUP)  ## format the code and repair what the linter can
	$(BIN)/ruff format $(SOURCES)
	$(BIN)/ruff check --fix $(SOURCES)

mutate: $(SETUP)  ## break the codecs and drivers in small ways; list what no test notices (hours)
	$(BIN)/python tools/mutate.py --sample $(or $(SAMPLE),0)

build: $(SETUP)  ## build the wheel, install it into an empty environment and run it
	sh tools/build.sh

pythons: $(SETUP)  ## build the wheel and run it on each Python that can be found
	sh tools/pythons.sh

docs: $(SETUP)  ## build the documentation as a site in build/docs; runs the examples (a minute)
	$(BIN)/uv sync --quiet --locked --inexact --group docs
	rm -rf docs/gallery build/docs
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going docs build/docs
	@echo "open build/docs/index.html"

clean:  ## remove what the other targets made
	rm -rf .venv dist build docs/gallery runs .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
