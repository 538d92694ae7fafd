# Needs Python 3.11 to 3.13, make and pip; installs nothing outside this folder: `make demo`, `make test`.
PYTHON ?= python3
UV := .tools/bin/uv
BIN := .venv/bin
OUT ?= out/demo

.PHONY: help demo test test-all lint format docs bench vocabulary setup clean
.DEFAULT_GOAL := help

help:
	@echo "make demo    base, Dual-SLAM and LDSO under three stresses, then a few trials of Eq. 1 (OUT=$(OUT))"
	@echo "make test    the test suite without the slow tests    make test-all   all of it"
	@echo "make lint    formatting, lint, types, layers            make bench      speed of the tracker"
	@echo "make docs    the documentation, in site/index.html"
	@echo "make vocabulary   train the place recognition vocabulary (minutes)"
	@echo "make clean   remove the virtual environment, tools, outputs and compiled kernels"

setup: .venv/.ready

.tools/bin/uv:
	@echo "dslab setup: installing uv"
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --no-warn-script-location --root-user-action=ignore --target .tools "uv==0.13.8"

# Enough for what runs none of our code.
.venv/.installed: pyproject.toml uv.lock .tools/bin/uv
	@echo "dslab setup: installing the locked packages into .venv"
	@$(UV) sync --quiet --frozen --extra cluster --extra evo --extra rosbag --python $(PYTHON)
	@touch $@

.venv/.ready: .venv/.installed
	@# Sources are compiled here, beside the kernels: not everywhere may Python write what it compiles.
	@$(BIN)/python -m dslab.sim.rendering.gl_setup --uv $(UV) & gl=$$!; \
	packages=$$($(BIN)/python -c "import sysconfig; print(sysconfig.get_path('purelib'))"); \
	$(BIN)/python -m compileall -qq -x '/tests?/|/OpenGL/raw/' "$$packages" dslab/*/ & \
	$(BIN)/dslab warmup && wait $$gl && wait
	@echo "dslab setup: done; \`source .venv/bin/activate\` puts dslab onto the PATH"
	@touch $@

demo: setup
	@$(BIN)/dslab demo --out $(OUT)

test: setup
	@$(BIN)/pytest -m "not slow" -n 2 --dist worksteal

test-all: setup
	@$(BIN)/pytest -n 2 --dist worksteal

lint: .venv/.installed
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/lint-imports
	@$(BIN)/pyright

format: .venv/.installed
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

docs: setup
	@$(BIN)/python docs/generate.py .docs
	@$(BIN)/zensical build --strict
	@! grep -rE '<(script|link|img)[^>]*https?://' site --include='*.html'

bench: setup
	@$(BIN)/dslab bench

vocabulary: setup
	@$(BIN)/dslab vocabulary train --out slam/places/data/vocabulary.npz

clean:
	rm -rf .venv .tools .docs site .cache .pytest_cache .ruff_cache .import_linter_cache out
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
