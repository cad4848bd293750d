# Everything from a fresh checkout. Each target makes .venv when it is missing.
#
#   make demo    the whole pipeline on the recorded lift    make bench     speed of the simulator
#   make test    the tests (make test ARGS="-m slow")       make validate  it, beside mechanics
#   make check   ruff and pyright                           make docs      the site, in docs/_build
#   make figures every stated number, from its command     make mutants   whether tests find small changes to the code
#   make clean   remove .venv, caches, demo/, docs/_build
#   make lerobot  data sets and integrations/ in LeRobot's own loaders (PYTHON: 3.12; torch is large)
#   make test-lowest   tests of what meets other packages, with the oldest versions that pyproject.toml allows
#
# PYTHON chooses the interpreter (3.11 or newer): make demo PYTHON=python3.12

PYTHON ?= python3
ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check

# Marks inside .venv. `place` holds this folder's name: a copied or moved .venv is made anew.
# `installing` is there while pip works: when it is found, pip was interrupted.
PLACE := $(VENV)/.place
INSTALLING := $(VENV)/.installing
CORE := $(VENV)/.core
FULL := $(VENV)/.full

ifneq ($(shell cat $(PLACE) 2>/dev/null),$(CURDIR))
.PHONY: $(PLACE)
else ifneq ($(wildcard $(INSTALLING)),)
.PHONY: $(PLACE)
else ifeq ($(shell $(BIN)/python -c "print(1)" 2>/dev/null),)
.PHONY: $(PLACE)
endif

.PHONY: demo test test-lowest lerobot check validate bench figures mutants docs clean
# Commands that tests start would compile the package each time.
export PYTHONDONTWRITEBYTECODE :=

.NOTPARALLEL:
.DELETE_ON_ERROR:

demo: $(CORE)
	@$(BIN)/gendom demo $(ARGS)

# As many workers as cores: threads of BLAS in each would only wait for each other.
test test-lowest: export OMP_NUM_THREADS := 1
test: $(FULL)
	@$(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist worksteal $(ARGS)

# In an environment of its own. Tests that need torch or Ray skip. What other packages do for us is used by these
# rooms; the rest is our own arithmetic.
LOWEST := cli datasets extending fuzz hardware perception robot viz sim/test_device.py sim/test_rollout.py \
  policies/test_policy.py reality/test_envs.py
test-lowest: ARGS := $(or $(ARGS),$(addprefix tests/,$(LOWEST)) $(wildcard tests/test_*.py))
test-lowest:
	@echo "installing the oldest versions in .venv-lowest (1 to 5 minutes)"
	@$(PYTHON) -m venv --clear .venv-lowest
	@.venv-lowest/bin/python -m pip --disable-pip-version-check install -qq -c constraints-lowest.txt \
	  -e '.[data,reality,camera,viz,ros]' pytest pytest-xdist matplotlib websockets
	@.venv-lowest/bin/python -m pytest --numprocesses auto --maxprocesses 4 --dist worksteal $(ARGS)

lerobot:
	@echo "installing LeRobot 0.6.1 in .venv-lerobot (2 to 10 minutes)"
	@$(PYTHON) -m venv .venv-lerobot
	@.venv-lerobot/bin/python -m pip --disable-pip-version-check install -qq -e '.[data,reality]' 'lerobot[dataset]==0.6.1' pytest
	@.venv-lerobot/bin/python -m pytest tests/test_integrations.py tests/datasets/test_lerobot.py $(ARGS)

check: $(FULL)
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/pyright

validate: $(CORE)
	@$(BIN)/python -m validation $(ARGS)

bench: $(CORE)
	@$(BIN)/gendom bench $(ARGS)

figures: $(FULL)
	@$(BIN)/python benchmarks/figures.py $(ARGS)

# About four minutes of CPU a room; interrupted, it goes on where it was.
mutants: $(FULL)
	@$(BIN)/python benchmarks/mutants.py $(ARGS)

# Warnings, such as a link or a reference that leads nowhere, end it.
docs: $(FULL)
	@$(BIN)/python -m sphinx -q -W --keep-going -n -b html -d docs/_build/.doctrees docs docs/_build
	@echo "docs/_build/index.html"

clean:
	rm -rf $(VENV) .venv-lowest .venv-lerobot build dist demo docs/_build .pytest_cache .ruff_cache
	find src tests validation -name __pycache__ -type d -prune -exec rm -rf {} +

$(PLACE):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "make: $(PYTHON) is missing or older than 3.11; install Python 3.11 or newer," \
	       "or name one: make PYTHON=python3.12" >&2; exit 2; }
	@echo "making $(VENV) with $$($(PYTHON) --version)"
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV) || { \
	  echo "make: no virtual environment was made; on Debian: apt install python3-venv" >&2; \
	  rm -rf $(VENV); exit 2; }
	@printf '%s\n' "$(CURDIR)" > $@

$(CORE): $(PLACE) pyproject.toml constraints.txt
	@echo "installing gendom, its core and MuJoCo (250 MB to fetch, 0.8 GB on disk, 1 to 4 minutes the first time)"
	@touch $(INSTALLING)
	@$(PIP) install -qq -c constraints.txt -e '.[reality]'
	@rm $(INSTALLING)
	@touch $@

$(FULL): $(PLACE) pyproject.toml constraints.txt
	@echo "installing gendom with test and training tools (torch is large: 1 to 10 minutes)"
	@touch $(INSTALLING)
	@$(PIP) install -qq -c constraints.txt -e '.[dev,data,train,reality,camera,robot,cluster,docs,ros,viz]'
	@rm $(INSTALLING)
	@touch $(CORE) $@
