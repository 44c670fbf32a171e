# The only commands one has to know: make run, test, lint, bench, screenshots.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
PYTHON ?= python3
BIN := .venv/bin

.PHONY: help setup run test lint bench screenshots clean
.DEFAULT_GOAL := help

help:  ## this list
	@sed -nE 's/^([a-z]+):.*##(.*)/  make \1\t\2/p' $(MAKEFILE_LIST)

# The stamp stands for an environment that matches these two files.
.venv/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit("malipp-field needs Python 3.11 or newer; this is " + sys.version.split()[0] + ". Say which with: make PYTHON=python3.11") if sys.version_info < (3, 11) else None'
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "Installing pinned dependencies into .venv (about a minute the first time) ..."
	@# Without --no-compile pip spends half of the time on byte code that is never run.
	@$(BIN)/python -m pip install --no-compile --progress-bar off --disable-pip-version-check \
		--constraint constraints.txt --editable '.[dev]' | sed -nE 's/^Collecting ([^ ]+).*/  \1/p'
	@# Without its dependencies: for the tests it needs none but ours, and its map views would bring 750 MB.
	@$(BIN)/python -m pip install --no-compile --progress-bar off --disable-pip-version-check \
		--constraint constraints.txt --no-deps mavproxy | sed -nE 's/^Collecting ([^ ]+).*/  \1/p'
	@# This also stores the byte code of all that planning imports, wherever that has been switched off.
	@PYTHONDONTWRITEBYTECODE= $(BIN)/python -m malipp_field.planner.warm
	@touch $@

setup: .venv/.ready  ## a .venv with pinned dependencies

run: setup  ## plan, export, fly a simulated team, record and review missions/quarry.yaml
	@$(BIN)/malipp run missions/quarry.yaml --output runs/quarry

lint: setup  ## ruff, mypy strict, import contracts
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo

test: lint  ## lint, then all tests
	@# Byte code is kept, wherever that is switched off: workers and the processes of tests all load the same.
	@PYTHONDONTWRITEBYTECODE= $(BIN)/pytest

bench: setup  ## measure planning (some 20 minutes); the results pages are in benchmarks/
	@$(BIN)/python benchmarks/planning.py
	@$(BIN)/python benchmarks/exact.py --sizes 2x5,3x6,2x10 --seeds 2 --literal-limit 60

screenshots: setup  ## the README's picture from a fresh run (needs xvfb and a software Vulkan)
	@PATH="$(CURDIR)/$(BIN):$$PATH" docs/screenshots.sh

clean:  ## remove what was built
	rm -rf .venv runs build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
