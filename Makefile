# Everything a fresh machine needs: Python 3.11 or newer, and git.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: setup repro proof test test-slow check format

setup: .venv/ready

.venv/ready: requirements.lock requirements-dev.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "expected Python 3.11 or newer, found " + sys.version.split()[0] + "; name another with make PYTHON=...")'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --requirement requirements.lock --requirement requirements-dev.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

# The default run: PoRSE on Quadcopter, from recorded replies, without a network.
repro: setup
	$(BIN)/porse repro

# Bit-identity: every recorded reply is what it was, everything is computed again, and the committed locks must still name
# every byte.
proof: setup
	$(BIN)/porse llm verify
	$(BIN)/porse repro --force --no-run-cache
	git diff --exit-code dvc.lock iterations metrics.json

test: setup
	$(BIN)/pytest

# The long suite: minutes to an hour.
test-slow: setup
	$(BIN)/pytest -m "slow or not slow" --timeout 3600

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
