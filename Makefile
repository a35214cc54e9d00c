PYTHON ?= python3.11
# What `--no-compile` leaves is compiled when it is first imported: not anew by every process.
unexport PYTHONDONTWRITEBYTECODE
BIN := .venv/bin
LIBRARIES := .venv-libraries/bin
OTHER := .venv-$(notdir $(PYTHON))
TESTS ?= tests
# Python compiles what is imported when it is; to compile all that is installed takes pip a minute.
PIP = $(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt
INSTALLED := .venv/.installed
DOCS_INSTALLED := .venv/.installed-docs

.PHONY: install kernels demo test test-all test-libraries test-python test-newer test-outside coverage check format docs clean

install: $(INSTALLED)

$(INSTALLED): pyproject.toml constraints.txt
	@echo "installing into .venv, which takes one to three minutes"
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(PIP) --editable ".[dev]"
	$(BIN)/python -m pip check
	touch $@

# Compiled kernels are kept in ~/.cache/lidarnaut, for all checkouts.
kernels: install
	$(BIN)/python -m lidarnaut.compile_kernels

demo: install
	$(BIN)/python -m lidarnaut.benchmarks.demo

test: install
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal

# Everything that takes longer: damaged inputs, kills, long runs, the examples for RLlib and TorchRL, a newer Python.
test-all: install test-libraries test-newer
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal --slow

test-libraries:
	test -x $(LIBRARIES)/python || $(PYTHON) -m venv .venv-libraries
	$(LIBRARIES)/python -m pip install --quiet --editable . --requirement examples/requirements.txt
	$(LIBRARIES)/python -m pytest tests/examples -k "rllib or torchrl or tianshou"

# Environments and baselines with another Python, PYTHON=python3.13: all but torch, stable-baselines3 and their tests.
test-python:
	test -x $(OTHER)/bin/python || $(PYTHON) -m venv $(OTHER)
	$(OTHER)/bin/python -c "import tomllib; needed = tomllib.load(open('pyproject.toml', 'rb'))['project']['dependencies']; \
		print(*(one for one in needed if not one.startswith(('torch', 'stable-baselines3'))), sep='\n')" > $(OTHER)/requirements.txt
	$(OTHER)/bin/python -m pip install --quiet --no-compile --constraint constraints.txt \
		--requirement $(OTHER)/requirements.txt hypothesis pettingzoo pytest pytest-xdist
	$(OTHER)/bin/python -m pip install --quiet --no-deps --editable .
	$(OTHER)/bin/python -m pytest --numprocesses 2 --dist worksteal $(TESTS)

# What every environment must hold, with Python 3.13, where there is one. It compiles all kernels anew.
# With pyenv there is a `python3.13` for this version alone.
test-newer: export PYENV_VERSION = 3.13
test-newer:
	if python3.13 --version; then $(MAKE) test-python PYTHON=python3.13 TESTS=tests/test_contract.py; fi

# Files of the package, held against public tools in environments of their own; writes the page of formats.
test-outside: install
	$(BIN)/python -m tests.outside --write docs/reference/formats.md

coverage: install
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal --cov

check: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: install
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(DOCS_INSTALLED)
	$(BIN)/python -m sphinx --jobs 2 --fail-on-warning --keep-going --quiet docs build/site
	@echo "the site is in build/site/index.html; tests of its pages follow"
	LIDARNAUT_SITE=build/site $(BIN)/python -m pytest --quiet --noconftest --numprocesses 2 tests/docs/test_site.py

$(DOCS_INSTALLED): $(INSTALLED)
	$(PIP) --editable ".[dev,docs]"
	touch $@

clean:
	rm -rf .venv .venv-* build dist *.egg-info docs/reference/gallery
