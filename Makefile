# The index of commands. `make demo` and `make test` work on a fresh machine that has
# Python >= 3.11 with venv, Node.js >= 20 with npm, and make.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PAGE := web/dist/index.html
# One BLAS thread: two cores are for two engines, and a result must not depend on a thread count.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.DEFAULT_GOAL := help
.PHONY: help install install-dev page demo test test-py test-web test-browser lint types bench chromium wire clean

help: ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1|\2/' | column -t -s '|'

install: $(VENV)/.runtime page ## the station and the simulator into .venv, and the map page

install-dev: $(VENV)/.dev ## the same with training, tests and tools

demo: install ## a simulated swarm, the service and the map page (DEMO="--scenario rubble --seed 3")
	$(BIN)/groundstation demo $(DEMO)

test: install-dev lint test-web chromium test-py ## everything: lint, types, page, Python, browser

test-py: $(VENV)/.dev page
	$(BIN)/pytest $(PYTEST)

test-web: web/node_modules/.installed
	cd web && npm run --silent check && npm test --silent

test-browser: $(VENV)/.dev page chromium ## only what a browser must show
	$(BIN)/pytest tests/browser $(PYTEST)

lint: $(VENV)/.dev types ## ruff, import rules, strict types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(VENV)/.dev
	$(BIN)/mypy

bench: $(VENV)/.dev ## every performance claim, measured beside its named alternative
	$(BIN)/python benchmarks/run.py $(BENCH)

page: $(PAGE) ## build the map page

wire: $(VENV)/.dev web/node_modules/.installed ## web/src/wire.ts from the server's schema
	cd web && npm run --silent wire

chromium: ## a browser for the browser tests, by the system's package manager
	@sh .ci/ensure-chromium

clean: ## remove everything that was built or installed
	rm -rf $(VENV) web/node_modules web/dist groundstation/mavlink/generated build dist *.egg-info

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python >= 3.11 is needed, $$($(PYTHON) --version) was found; name another one: make PYTHON=python3.12"; exit 1; }
	@echo "installing into $(VENV) and web/node_modules: a minute or two, once"
	@$(PYTHON) -m venv $(VENV) || { echo "python venv is needed (Debian: apt install python3-venv)"; exit 1; }

$(VENV)/.runtime: pyproject.toml constraints.txt hatch_build.py groundstation/mavlink/sar_radio.xml | $(BIN)/python
	@test -e $(VENV)/.dev || $(BIN)/python -m pip install -q -c constraints.txt -e .
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt hatch_build.py groundstation/mavlink/sar_radio.xml | $(BIN)/python
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[dev]'
	@touch $@ $(VENV)/.runtime

web/node_modules/.installed: web/package-lock.json
	@command -v npm >/dev/null || { echo "Node.js >= 20 with npm is needed to build the page (https://nodejs.org)"; exit 1; }
	@node -e 'process.exit(+process.versions.node.split(".")[0] < 20 ? 1 : 0)' || \
	  { echo "Node.js >= 20 is needed, $$(node --version) was found"; exit 1; }
	cd web && npm ci --no-audit --no-fund --silent
	@touch $@

$(PAGE): web/node_modules/.installed $(shell find web/src web/public web/index.html web/*.ts web/*.json -type f 2>/dev/null)
	cd web && npm run --silent build
	@touch $@
