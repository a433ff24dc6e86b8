# Scatola. `make help` lists what can be done; everything below sets itself up first.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
PYTHON ?= python3
BIN := .venv/bin
PYTEST_WORKERS ?= 2

.PHONY: help setup run test check bench bench-crash vendor lock clean
.DEFAULT_GOAL := help

help:  ## This list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*##/\t/' | expand -t 16

setup: .venv/ready  ## A .venv with everything, kernels compiled

run: setup  ## The service and a simulated fleet, on this machine; Ctrl-C stops both
	@$(BIN)/scatola demo

test: setup  ## All tests; what needs a browser, PostgreSQL or RabbitMQ is skipped where it is missing
	@scripts/browser.sh
	$(BIN)/python -m pytest -n $(PYTEST_WORKERS) --dist loadfile

check: setup node_modules/ready  ## Lint, types, architecture, JavaScript, migrations in step with models
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	node_modules/.bin/pyright
	$(BIN)/lint-imports
	node_modules/.bin/tsc -p web/jsconfig.json
	$(BIN)/scatola migrate --check

bench: setup  ## Speed of the numerics and of the ingest path
	$(BIN)/python benchmarks/run.py

bench-crash: setup  ## 500 simulated crashes, 200 hours without one; writes docs/crash-benchmark.md (half an hour)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/crash.py

vendor: node_modules/ready  ## Copy the pinned front-end libraries into web/vendor
	node scripts/vendor.mjs

lock: .venv/ready  ## Pin the requirements anew (hashes, no index addresses)
	$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-annotate --no-header \
	  --extra server --extra test pyproject.toml requirements/build.in -o requirements/dev.txt
	$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-annotate --no-header \
	  --extra server pyproject.toml requirements/build.in -o requirements/server.txt

clean:  ## Remove what setup and tests made; keeps data
	rm -rf .venv node_modules artifacts .pytest_cache .ruff_cache .hypothesis .import_linter_cache

.venv/ready: requirements/dev.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "Python 3.11 or newer is needed; set PYTHON=")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python scripts/bootstrap.py requirements/dev.txt
	$(BIN)/scatola warm-up
	@touch $@

node_modules/ready: package-lock.json
	npm ci --ignore-scripts --no-fund --no-audit
	@touch $@
