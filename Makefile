# Everything a fresh machine needs: Python 3.11 or newer, and git.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: setup demo repro proof replay replay-sample test test-slow ray test-ray gpu test-gpu servers test-servers record-example site check format

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

# The whole way at tiny size: about a minute.
demo: setup
	$(BIN)/porse demo

# Bit-identity: every recorded reply is what it was, everything is computed again, and the committed locks must still name
# every byte, and the tables what the pages say of them.
proof: setup
	$(BIN)/porse llm verify
	$(BIN)/porse repro --force --no-run-cache
	git diff --exit-code dvc.lock iterations metrics.json
	$(BIN)/pytest --quiet tests/test_default_run.py

# The smallest published run, all of it, and a stage of another one, drawn anew each time.
replay: setup replay-sample
	$(BIN)/porse replay

replay-sample: setup
	$(BIN)/porse replay --sample 1

# A file at a time to each core: many files share one small run between their tests.
test: setup
	$(BIN)/pytest --numprocesses auto --dist loadfile

# The long suite: minutes to an hour.
test-slow: setup
	$(BIN)/pytest -m "not servers and not ray and not gpu and not warp" --timeout 3600

# Ray, for PORSE_EXECUTOR=ray: what is not in the other locks.
ray: .venv/ray-ready

.venv/ray-ready: .venv/ready requirements-ray.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --requirement requirements-ray.lock
	@touch $@

# On a cluster of one machine and of two, a minute or two.
test-ray: ray
	$(BIN)/pytest -m ray

# MuJoCo Warp, for `device: cuda:0`: docs/gpu.md.
gpu: .venv/gpu

.venv/gpu: .venv/ready requirements-gpu.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --requirement requirements-gpu.lock
	@touch $@

# On the processor, and on a GPU where there is one. The first time compiles kernels for ten minutes.
test-gpu: gpu
	$(BIN)/pytest -m "gpu or warp" --timeout 3600

# An inference engine and a gateway, beside the project; the engine is compiled, ten to twenty minutes on one core.
servers: .venv-servers/ready

.venv-servers/ready: requirements-servers.lock
	$(PYTHON) -m venv .venv-servers
	.venv-servers/bin/pip install --quiet --disable-pip-version-check --no-deps --requirement requirements-servers.lock
	@touch $@

test-servers: setup servers
	$(BIN)/pytest -m servers

# The example of a small model's run, asked for anew: after a change of prompts, checks or verdicts.
record-example: setup servers
	$(BIN)/python tests/smollm2.py

# The documentation as a site, in site/; a link that leads nowhere is an error
site: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
