# Each target sets up what it needs in .venv: no root, no apt. PYTHON names another interpreter (3.11 or newer).
NEW_ENOUGH := import sys; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11 python3.14; do \
	$$python -c '$(NEW_ENOUGH)' 2>/dev/null && echo $$python && break; done)
BIN := .venv/bin
# How many tests run at the same time: each process comes to hold 2.6 GB.
WORKERS ?= 2

.PHONY: demo test slow docs acceptance clean

demo: .venv/ready
	$(BIN)/python -m octo solve mammal --goal walk --speed 0.5 --seconds 10 --out demo

# A file of tests stays with one process, which shares what it makes; what is timed then runs alone. Python keeps its bytecode, for
# tests start hundreds of processes.
TESTS := PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest
BESIDE := -n $(WORKERS) --dist loadfile --no-loadscope-reorder

test: .venv/ready-dev
	$(TESTS) -m 'not timed and not slow' $(BESIDE); first=$$?; \
	$(TESTS) -m 'timed and not slow' $$(grep -rl --include='test_*.py' mark.timed tests) && exit $$first

# The same on more robots, bases and terms, whole motions, and every kernel under the sanitizers.
slow: .venv/ready-dev
	$(TESTS) -m slow $(BESIDE)

# build/site/index.html; it needs no network to be read, and a warning is an error.
docs: .venv/ready-docs
	$(BIN)/python -m sphinx -q -W --keep-going docs build/site

acceptance: .venv/ready-dev
	$(BIN)/python -m benchmarks.acceptance

.venv/bin/python:
	@test -n '$(PYTHON)' || { echo 'octo needs Python 3.11 or newer: make PYTHON=/path/to/python'; exit 1; }
	$(PYTHON) -m venv .venv

.venv/ready: setup.cfg setup.py | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[view,robots]'
	touch $@

# dm_control is read as a folder of MJCF files: its own dependencies (rendering, protobuf) are not needed.
.venv/ready-dev: setup.cfg setup.py | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	$(BIN)/python -m pip install --quiet --no-deps dm_control
	touch $@ .venv/ready

.venv/ready-docs: setup.cfg setup.py | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[view,robots,docs]'
	touch $@

clean:
	rm -rf .venv demo build *.egg-info
