# make demo    build a small city at night, render it with LightTree and Cycles, write the report
# make test    all tests but the slow ones: compiled, then those of the core twice more, as plain
#              Python and with bounds checks;  make test-slow   converged images against Cycles
# make lint    ruff
# make clean   remove what was installed and made here
# make extension   the zips for Blender, in dist: one a platform and version of Python
#
# PYTHON=python3.13 make test   chooses the interpreter: 3.11 (Blender 4.5 LTS) or 3.13 (5.2 LTS).
# PYTHONS=3.14 PLATFORMS=linux-x64 make extension   builds for the Blenders with that Python there.

PYTHON ?= $(shell sh .ci/python 3.13 || sh .ci/python 3.11)
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
VENV := .venv-$(VERSION)
BIN := $(VENV)/bin
# Whole files on two processes, which share the compiled kernels.
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile
DEMO := demo
PYTHONS ?= 3.11 3.13
PLATFORMS ?= linux-x64 windows-x64 macos-arm64

.PHONY: demo test test-compiled test-blender test-plain test-bounds test-slow lint extension clean

demo: $(VENV)/installed
	$(BIN)/lighttree demo --out $(DEMO)

test: test-compiled test-plain test-bounds

test-compiled: $(VENV)/installed
	$(PYTEST) -m "not slow"

test-blender: $(VENV)/installed
	$(PYTEST) -m "blender and not slow"

test-plain: $(VENV)/installed
	NUMBA_DISABLE_JIT=1 $(PYTEST) -m "core and not slow" -k "not time_limit"

test-bounds: $(VENV)/installed
	NUMBA_BOUNDSCHECK=1 $(PYTEST) -m "core and not slow" -k "not time_limit"

test-slow: $(VENV)/installed
	$(BIN)/python -m pytest -m slow

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

extension: $(VENV)/installed
	$(BIN)/python .ci/extension.py --pythons $(PYTHONS) --platforms $(PLATFORMS)

$(VENV)/installed: pyproject.toml
	@test -n "$(VERSION)" || { echo "LightTree needs Python 3.11 or 3.13: install one, or say PYTHON=/path/to/python make ..."; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --editable '.[test]'
	touch $@

clean:
	rm -rf .venv-* build dist $(DEMO) *.egg-info .pytest_cache .ruff_cache .hypothesis
