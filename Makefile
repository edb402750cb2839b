# Two commands do on a machine that has nothing yet:
#   make calibrate DATA=datasets/xu-wang-2017
#   make test

SHELL := /bin/bash
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
.PHONY: help setup setup-dev calibrate check live test test-slow lint format bench lock clean distclean

DATA ?=
OUT ?= reports/$(notdir $(patsubst %/,%,$(DATA)))
ARGS ?=
BIN := .venv/bin

help: ## this list
	@grep -hE '^[a-z%/-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([^:]+):.*## (.*)/  make \1 \t\2/' | expand -t 26
	@echo "  Variables: DATA=datasets/NAME  OUT=reports/NAME  ARGS='--seed 1'"

setup: ## environment for calibrating: Debian packages, .venv, locked Python packages
	@tools/setup.sh runtime

setup-dev: ## the same with what tests and linters need
	@tools/setup.sh dev

calibrate: setup ## calibrate DATA, results in OUT
	@$(if $(DATA),,echo "calibrate what? make calibrate DATA=datasets/xu-wang-2017" >&2; exit 2)
	@$(BIN)/calib calibrate "$(DATA)" --out "$(OUT)" $(ARGS)

check: setup ## list every problem of DATA
	@$(if $(DATA),,echo "check what? make check DATA=datasets/xu-wang-2017" >&2; exit 2)
	@$(BIN)/calib check "$(DATA)"

live: setup ## the rig as a page in the browser; without rig.toml a virtual one: ARGS='--rig rig.toml'
	@tools/setup_web.sh
	@$(BIN)/calib live $(ARGS)

datasets/demo: setup ## a rendered rig with images, sweep, gaze and validation rows
	@$(BIN)/calib simulate $@ --seed 1 --images --set baseline_mm=120

datasets/bouguet-stereo: ## real stereo pictures, from Debian's opencv-doc package
	@python3 tools/bouguet_stereo.py $@

test: setup-dev ## tests, under eight minutes on two cores
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

test-slow: setup-dev ## statistical studies and long trials
	$(BIN)/python -m pytest -n 2 --dist worksteal -m slow

lint: setup-dev ## ruff (security rules among its own), mypy, import contract, audit of the packages
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/audit.py

format: setup-dev ## let ruff format and mend what it can
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: setup-dev ## timings as ratios, side by side in one run
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python tools/bench.py $(ARGS)

lock: setup-dev ## rewrite the lock files from pyproject.toml
	tools/lock.sh

clean: ## delete results and caches
	rm -rf reports/*/ .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find calib tests tools -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## delete the environment too
	rm -rf .venv
