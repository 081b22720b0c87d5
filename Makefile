# make run | test | check (lint and test) | docs | fields (its tables of settings) | wheels | smoke-wheels | changelog; each
# installs first where needed, into .venv, from constraints.txt. make test-rsl-rl has an environment of its own.

# The first Python that really starts (a pyenv shim may exist and fail), is 3.11 or 3.12, and can make environments.
SUPPORTED := import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 13))
PYTHON ?= $(shell for python in python3 python3.12 python3.11 python; do \
	if $$python -c '$(SUPPORTED)' >/dev/null 2>&1; then echo $$python; break; fi; done)

BIN := .venv/bin
DISTRIBUTIONS := . plugins/power plugins/noise robots/go1
EDITABLE := $(foreach distribution,$(DISTRIBUTIONS),-e $(distribution))
PINS := constraints.txt pyproject.toml hts/__init__.py $(wildcard plugins/*/pyproject.toml robots/*/pyproject.toml)
PIP := $(BIN)/python -m pip --disable-pip-version-check
WORKERS ?= 2

# An environment of its own: mjlab and rsl_rl as they are on the index, which hts's own environment cannot hold.
RSL_RL := integrations/rsl_rl/.environment

.PHONY: install install-dev run test test-rsl-rl lint check format docs fields changelog hooks wheels smoke-wheels clean
.DEFAULT_GOAL := install

install: .venv/installed
install-dev: .venv/installed-dev

run: install
	$(BIN)/hts run --objective power --robot go1

# Tests start many processes: what one of them compiled, the next ones read.
test: install-dev
	env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest -n $(WORKERS)

test-rsl-rl: $(RSL_RL)/installed install
	HTS_PYTHON=$(abspath $(BIN)/python) $(RSL_RL)/bin/python -m pytest integrations/rsl_rl/tests

check: lint test

lint: install-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: install-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: install-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo site/index.html

fields: install-dev
	$(BIN)/python -m hts.testing.field_tables docs/authors/api.md

changelog: install-dev
	@$(BIN)/towncrier build --draft --version next 2>/dev/null

hooks: install-dev
	$(BIN)/pre-commit install

wheels: .venv/builder
	rm -rf dist
	$(PIP) wheel --quiet --no-deps --no-build-isolation --wheel-dir dist $(DISTRIBUTIONS:%=./%)
	@ls dist/*.whl

smoke-wheels: wheels
	.ci/smoke-wheels $(BIN)/python

clean:
	rm -rf .venv dist $(RSL_RL)

$(BIN)/python:
	@$(if $(strip $(PYTHON)),,echo "No Python 3.11 or 3.12 found. Install one, or name it: make PYTHON=/path/to/python3.12" >&2; exit 1)
	@$(PYTHON) -c '$(SUPPORTED)' || { echo "$(PYTHON) is not Python 3.11 or 3.12 with venv. Name another: make PYTHON=/path/to/python3.12" >&2; exit 1; }
	$(PYTHON) -m venv .venv

.venv/builder: $(BIN)/python constraints.txt
	$(PIP) install --quiet --constraint constraints.txt hatchling
	@touch $@

.venv/installed: .venv/builder $(PINS)
	$(PIP) install --quiet --constraint constraints.txt --no-build-isolation $(EDITABLE)
	@touch $@

.venv/installed-dev: .venv/installed
	$(PIP) install --quiet --constraint constraints.txt --no-build-isolation -e '.[dev,gpu]'
	@touch $@

$(RSL_RL)/installed: integrations/rsl_rl/pyproject.toml
	$(PYTHON) -m venv $(RSL_RL)
	$(RSL_RL)/bin/python -m pip --disable-pip-version-check install --quiet torch==2.13.0 -e 'integrations/rsl_rl[test]'
	@touch $@
