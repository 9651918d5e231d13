# make demo, make test, make check: each sets up its own environment first.
# It needs Python 3.11 or newer, pip and make; a second run installs nothing.

VENV ?= .venv
TESTFLAGS ?=
# Tests run side by side, one process a core (slow ones, which may be large, on two).
PARALLEL ?= -n auto --maxprocesses 4
# Bytecode is kept, also where the environment says not to: without it each process
# compiles every module and rewrites every assertion again. Without nbmake, which loads
# Jupyter, each process starts a second sooner.
PYTEST = PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -p no:nbmake
# make mutants MUTANTS="metrics kkt" SAMPLE=50
MUTANTS ?=
SAMPLE ?= 20
comma := ,
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DOCS_STAMP := $(VENV)/.installed-docs
LAB_STAMP := $(VENV)/.installed-lab
# make lab LABFLAGS="--no-browser --port 8890"
LABFLAGS ?=

# The first Python that is new enough; say `make PYTHON=...` for another.
PYTHON ?= $(firstword $(foreach name,python3 python3.14 python3.13 python3.12 \
	python3.11 python,$(if $(shell $(name) -c 'import sys; \
	sys.version_info >= (3, 11) and print("ok")' 2>/dev/null),$(name))))

.DEFAULT_GOAL := help
NOTEBOOKS = $(BIN)/python -m pytest --nbmake --nbmake-timeout=300 notebooks

.PHONY: help demo test slow browser long notebooks lab oldest newest mutants check picture docs \
	docs-check clean

help:
	@echo "make demo        run the whole method on the bundled example, into demo/"
	@echo "make test        run the fast tests"
	@echo "make slow        run the tests over half a second, and the notebooks"
	@echo "make browser     run the tests of the viewer's page, where Chromium is"
	@echo "make long        run the longest tests: many mutations, every solver"
	@echo "make check       check format, lint, types and layers"
	@echo "make notebooks   run the notebooks and store their outputs, made small"
	@echo "make lab         open the notebooks in JupyterLab"
	@echo "make docs        build the documentation into site/, notebooks included"
	@echo "make docs-check  check pages, also in a browser, links, names"
	@echo "make picture     draw the README's pictures"
	@echo "make oldest      run the fast tests with the oldest versions allowed"
	@echo "make newest      run the fast tests with the newest versions, pre-releases too"
	@echo "make mutants     put small mistakes into the code, count those the tests find"
	@echo "make clean       remove everything that the other targets made"

demo: $(STAMP)
	$(BIN)/ttus-opt demo -o demo

test: $(STAMP)
	$(PYTEST) -m "not slow" $(PARALLEL) $(TESTFLAGS)

slow: $(STAMP)
	$(NOTEBOOKS)
	$(PYTEST) -m "slow and not long and not browser" $(PARALLEL) --maxprocesses 2 $(TESTFLAGS)

# One process: several browsers that draw by software would wait for each other.
browser: $(DOCS_STAMP)
	$(PYTEST) -m browser $(TESTFLAGS)

long: $(STAMP)
	$(PYTEST) -m long $(PARALLEL) --maxprocesses 2 $(TESTFLAGS)

notebooks: $(STAMP)
	$(NOTEBOOKS) --overwrite
	$(BIN)/python docs/notebook_outputs.py notebooks

lab: $(LAB_STAMP)
	$(BIN)/python -m jupyterlab --ServerApp.root_dir=notebooks $(LABFLAGS)

# Each in an environment of its own, made anew; uv is what resolves to lower bounds.
oldest: RESOLUTION = --resolution lowest-direct
newest: RESOLUTION = --resolution highest --prerelease allow --upgrade
oldest newest: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv venv --quiet --clear --python "$(PYTHON)" $(VENV)-$@
	$(BIN)/uv pip install --quiet --python $(VENV)-$@/bin/python $(RESOLUTION) \
		--editable '.[dev]'
	PYTHONDONTWRITEBYTECODE= $(VENV)-$@/bin/python -m pytest -m "not slow" \
		$(PARALLEL) $(TESTFLAGS)

mutants: $(STAMP)
	$(BIN)/python tests/mutants.py --sample $(SAMPLE) $(subst $(comma), ,$(MUTANTS))

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy benchmarks
	$(BIN)/lint-imports

picture: demo $(DOCS_STAMP)
	cp demo/overview.png docs/overview.png
	$(BIN)/python docs/viewer_pictures.py

docs: $(DOCS_STAMP)
	$(BIN)/python docs/pictures.py
	$(BIN)/python docs/first_hour.py
	$(BIN)/python docs/devices.py
	$(BIN)/python -m mkdocs build --strict
	$(BIN)/python docs/browser.py site

# `make slow` runs the notebooks and the pages' blocks; this is all else that may rot.
docs-check: $(DOCS_STAMP)
	$(BIN)/python docs/pictures.py
	RUN_NOTEBOOKS=false $(BIN)/python -m mkdocs build --strict --site-dir .cache/site
	$(BIN)/python docs/browser.py .cache/site

clean:
	rm -rf $(VENV) $(VENV)-oldest $(VENV)-newest demo site .cache

$(STAMP): pyproject.toml constraints.txt
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "error: '$(PYTHON)' is not Python 3.11 or newer: install one, or name \
	it: make PYTHON=/path/to/python3" >&2; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--constraint constraints.txt --editable '.[dev]'
	@touch $@

$(DOCS_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--constraint constraints.txt --editable '.[docs]'
	@touch $@

$(LAB_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--constraint constraints.txt --editable '.[lab]'
	@touch $@
