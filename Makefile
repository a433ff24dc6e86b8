# Scatola. `make help` lists what can be done; everything below sets itself up first.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
PYTHON ?= python3
BIN := .venv/bin
PYTEST_WORKERS ?= 2

.PHONY: help setup run test check bench bench-mounting bench-service bench-crash vendor lock clean bench-moved bench-held-out coverage test-faults thesis-figures
.DEFAULT_GOAL := help

help:  ## This list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*##/\t/' | expand -t 16

setup: .venv/ready  ## A .venv with everything, kernels compiled

run: setup  ## The service and a simulated fleet, on this machine; Ctrl-C stops both
	@$(BIN)/scatola demo

test: setup  ## All tests; what needs a browser, PostgreSQL or RabbitMQ is skipped where it is missing
	@scripts/browser.sh
	$(BIN)/python -m pytest -n $(PYTEST_WORKERS) --dist loadfile

test-faults: setup  ## Try to break it: decoders fuzzed for twice ten minutes each, 200 random kills in each mode, the whole API (hours)
	SCATOLA_FUZZ_SECONDS=$${SCATOLA_FUZZ_SECONDS:-600} SCATOLA_KILLS=$${SCATOLA_KILLS:-200} \
	  SCATOLA_OPENAPI_EXAMPLES=$${SCATOLA_OPENAPI_EXAMPLES:-100} $(BIN)/python -m pytest tests/faults -n $(PYTEST_WORKERS) -s

check: setup node_modules/ready  ## Lint, types, architecture, JavaScript, migrations in step with models
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	node_modules/.bin/pyright
	$(BIN)/lint-imports
	node_modules/.bin/tsc -p web/jsconfig.json
	$(BIN)/scatola migrate --check

bench: setup  ## Speed of the numerics and of the ingest path; WRITE=docs/performance.md keeps the tables
	$(BIN)/python benchmarks/run.py $(if $(WRITE),--write $(WRITE))

bench-service: setup  ## The service under load, in processes and servers of its own; PARTS=, SHORT=1, WRITE=docs/service-benchmark.md
	$(BIN)/python benchmarks/service.py $(PARTS) $(if $(SHORT),--short) $(if $(WRITE),--write $(WRITE))

bench-mounting: setup  ## Over 2000 simulated drives: docs/mounting-benchmark.md (resumable, half an hour)
	$(BIN)/python benchmarks/mounting.py

bench-crash: setup  ## 500 simulated crashes, 200 hours without one; writes docs/crash-benchmark.md (half an hour; goes on where it was stopped)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/crash.py

bench-moved: setup  ## False and missed alarms of a moved box, 3000 h (hours to run; goes on where it was stopped)
	$(BIN)/python benchmarks/moved.py

bench-held-out: setup  ## Unlike springs, smoothing receivers, straight roads on seeds of their own (a quarter of an hour; goes on where it was stopped)
	$(BIN)/python benchmarks/held_out.py

# Kernels show their lines to no tracer once compiled: the tests that compare them with plain code run again without.
KERNELS := agree or compiled or matrices or kernel or plain or one_by_one or filterpy or digits or double_sum or whole_record \
  or order_of_the_rule or halves or rest_stays or left_out or straight
# Whole drives take minutes each without the compiler, and reach no line that these do not.
DRIVES := mounting_trouble or mounting_real or whole_drive or mounting_fusion or two_phase or no_alarm or lasting_one or crash
COVER := $(BIN)/python -m pytest tests/nav_core -n $(PYTEST_WORKERS) -m "not slow" --cov=nav_core --cov-config=/dev/null \
  --cov-report=

coverage: setup  ## Lines of nav_core that its tests reach, at least 97 %; slow tests left out
	COVERAGE_FILE=.coverage.compiled $(COVER)
	NUMBA_DISABLE_JIT=1 COVERAGE_FILE=.coverage.plain $(COVER) -k "($(KERNELS)) and not ($(DRIVES))"
	$(BIN)/coverage combine --rcfile=/dev/null .coverage.compiled .coverage.plain
	$(BIN)/coverage report --rcfile=/dev/null --skip-covered --show-missing --fail-under=97

thesis-figures: setup  ## The theses' figures and tables in kind: docs/thesis-results.md, docs/img
	$(BIN)/python benchmarks/thesis_figures.py
	$(BIN)/python scripts/figures.py docs/img

vendor: node_modules/ready  ## Copy the pinned front-end libraries into web/vendor
	node scripts/vendor.mjs

lock: .venv/ready  ## Pin the requirements anew (hashes, no index addresses)
	$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-annotate --no-header \
	  --extra server --extra tracing --extra test pyproject.toml requirements/build.in -o requirements/dev.txt
	$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-annotate --no-header \
	  --extra server --extra tracing pyproject.toml requirements/build.in -o requirements/server.txt

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
