# demo: the main job in one go; test: the quick checks; test-slow: the long ones; test-kernels: the fit under every other
# BLAS kernel that this processor runs; reliability: kills, full disks, signals, bad input, into their results.md; audit:
# known vulnerabilities of constraints.txt; bench: the benchmarks; docs: the pages.  Needs python3 >= 3.11 only.
# test begins with static (ruff, imports, mypy) on one core and kernels (what the tests would compile) on the other.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
# A test that records waits for its board: with one process more than cores (at most five) none of these stands idle.
PYTEST = $(BIN)/python -m pytest -n $(shell n=$$(getconf _NPROCESSORS_ONLN); echo $$((n < 4 ? n + 1 : 5))) --dist loadfile --no-loadscope-reorder
# The newest, which a processor takes by itself, runs in the other tests.
BLAS_KERNELS = Prescott Sandybridge $(shell grep -qsw avx512f /proc/cpuinfo && echo Haswell)

# Hundreds of tests start a process: without bytecode each would compile our sources again, 0.2 s of CPU.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test static kernels test-slow test-kernels reliability audit bench docs clean

demo: $(VENV)/.installed
	$(BIN)/daq demo

test: $(VENV)/.installed-test
	@$(MAKE) --no-print-directory -j2 static kernels
	$(PYTEST) -m "not slow"

static: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache
	$(BIN)/mypy

kernels: $(VENV)/.installed-test
	$(BIN)/python tests/compile_kernels.py

test-slow: $(VENV)/.installed-test
	$(PYTEST) -m slow

test-kernels: $(VENV)/.installed-test
	@for kernel in $(BLAS_KERNELS); do echo "== OPENBLAS_CORETYPE=$$kernel"; \
	  OPENBLAS_CORETYPE=$$kernel STICKSLIP_BLAS_KERNEL=$$kernel $(PYTEST) -q -m "not slow" \
	    tests/fitting/judge tests/fitting/test_processors.py tests/test_pipe.py || exit 1; done

reliability: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n 2 --dist load --maxschedchunk 1 -m slow --full tests/reliability

audit: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --group audit
	$(BIN)/python tests/audit_dependencies.py

bench: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --group bench
	@for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

docs: docs/atlas/atlas.md
	$(BIN)/python -m pip install --quiet --group docs
	$(BIN)/python -m sphinx -W -q -b html docs build/docs
	@echo "open build/docs/index.html"

docs/atlas/atlas.md: $(shell find rig_sim -name '*.py' -o -name '*.toml') | $(VENV)/.installed
	$(BIN)/rig-sim atlas -o docs/atlas --force

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "stickslip needs python3 >= 3.11; set PYTHON=/path/to/one"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[live]'
	@touch $@

$(VENV)/.installed-test: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --editable . --group test
	@touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis stickslip-demo
