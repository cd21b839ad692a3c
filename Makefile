# Needs only make and Python 3.11 or newer. The commands install what they need on first use.
PYTHON ?= python3
ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
DEVELOPED := $(VENV)/.developed
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

.PHONY: help demo test lint docs lock three clean

help:
	@echo "make demo   the whole workflow on a virtual arm: design, run, identify, diagnose, report"
	@echo "make test   the test suite without the slow statistical tests"
	@echo "make lint   ruff, mypy and the import rules"
	@echo "make docs   the documentation as a site, in build/docs"
	@echo "make lock   resolve pyproject.toml anew into requirements.lock and requirements-dev.lock"
	@echo "make three  bundle the 3D library of the pages anew; needs npm"
	@echo "make clean  remove the virtual environment, caches and build products (keeps runs/)"
	@echo
	@echo "Options: ARGS='...' passed to demo or to pytest; PYTHON=python3.12 chooses the interpreter."

demo: $(INSTALLED)
	$(BIN)/excitant demo $(ARGS)

test: $(DEVELOPED)
	@echo "The fast tests take about 4 minutes on two idle cores, all of them about 20."
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --maxprocesses 8 --dist worksteal -m "not slow" $(ARGS)

lint: $(DEVELOPED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(DEVELOPED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "build/docs/index.html; with search: $(BIN)/python -m http.server -d build/docs"

# The stamp goes first and comes back last: an interrupted install is started over, not trusted.
$(INSTALLED): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "excitant needs Python 3.11 or newer, which '$(PYTHON)' is not;" \
	    "choose another one, for example: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; \
	  exit 1; }
	@test -e $@ || { echo "Creating $(VENV) with $$($(PYTHON) --version)"; \
	  $(PYTHON) -m venv --clear $(VENV); }
	@rm -f $@
	@echo "Installing what excitant needs to run, pinned in requirements.lock (about 0.8 GB)"
	@$(PIP) install --requirement requirements.lock
	@rm -rf $(VENV)/lib/python*/site-packages/cmeel.prefix/include # 0.2 GB of headers for C++
	@echo "Installing excitant from this folder"
	@$(PIP) install --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m compileall -q design identify analysis reports robots src # pip does libraries
	@touch $@

$(DEVELOPED): $(INSTALLED) requirements-dev.lock
	@rm -f $@
	@echo "Installing the tools of developers, pinned in requirements-dev.lock (about 0.5 GB)"
	@$(PIP) install --requirement requirements-dev.lock
	@touch $@

# Pins and hashes of every file of a release, for every platform; SETUPTOOLS builds excitant itself.
SETUPTOOLS := setuptools>=77
RESOLVE := build/lock/bin/uv pip compile pyproject.toml - --quiet --no-config --universal \
  --python-version 3.11 --only-binary :all: --generate-hashes --no-annotate \
  --custom-compile-command "make lock"

lock:
	$(PYTHON) -m venv --clear build/lock
	build/lock/bin/python -m pip install --quiet uv
	echo "$(SETUPTOOLS)" | $(RESOLVE) --upgrade --extra dev --output-file requirements-dev.lock
	echo "$(SETUPTOOLS)" | $(RESOLVE) --upgrade --constraints requirements-dev.lock \
	  --output-file requirements.lock
	@rm -r build/lock

THREE := 0.187.0
three:
	npm install --prefix build/three --no-save --no-audit --no-fund --ignore-scripts three@$(THREE) esbuild@0.28.2
	cp reports/templates/three.mjs build/three/
	build/three/node_modules/.bin/esbuild build/three/three.mjs --bundle --minify --format=iife \
	  --global-name=THREE --legal-comments=inline --outfile=reports/templates/three.js \
	  --banner:js='/* three.js $(THREE), MIT, see three.LICENSE; bundled by make three */'
	cp build/three/node_modules/three/LICENSE reports/templates/three.LICENSE
	@rm -r build/three

clean:
	rm -rf $(VENV) build dist src/*.egg-info
	rm -rf .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .coverage
	find . -type d -name __pycache__ -prune -exec rm -rf {} +
