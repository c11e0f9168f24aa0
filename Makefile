# Everything runs from .venv, which every target builds or refreshes first; nothing outside the checkout changes.
# Needs: python3 >= 3.11 with pip, make. No venv module, no root, no compiler.

PYTHON ?= python3
UV     := .tools/bin/uv
BIN    := .venv/bin
# Compiled once, on all cores: the processes of the tests start together, and each would compile them for itself.
LARGE  := dask google hypothesis matplotlib narwhals numpy onnx openpyxl pandas rich ruamel scipy skl2onnx sklearn
LOCKS  := requirements/live.lock requirements/dev.lock requirements/build.lock
DEMO_LOCKS := requirements/demo.lock requirements/build.lock
RATE   ?= 150
SIZE   ?= default
MODEL  ?= models/holdfast-150hz.onnx
CORES  := $(shell nproc 2>/dev/null || echo 2)
# Tests run in a process a core and one more (some wait for real time), a file at a time, the longest first.
PROCESSES ?= $(shell expr $(CORES) + 1)
ACROSS := -n $(PROCESSES) --dist loadfile --no-loadscope-reorder
# A process a core: numpy's own threads would only wait for each other.
test hard-cases safety: export OPENBLAS_NUM_THREADS := 1
browser docs-site: export ZIG_GLOBAL_CACHE_DIR := $(CURDIR)/build/zig

# Deaf to settings of the machine that could pick another interpreter; uv trusts the machine's certificates. Compiled modules
# are kept: without them each of a hundred processes of the tests compiles numpy, scipy and scikit-learn anew.
export UV_PYTHON_DOWNLOADS := never
export UV_NO_CONFIG        := 1
export UV_SYSTEM_CERTS     := 1
unexport VIRTUAL_ENV PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
# onnxruntime sends usage data otherwise; edge_runtime says so too.
export ORT_DISABLE_TELEMETRY := 1

.PHONY: help setup hooks demo test lint lock clean dist docs docs-site screenshots hard-cases safety soak real loop distortions evaluate study models bench latency browser world

help:  ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1\t\2/p' Makefile | expand -t 16

setup: .venv/.stamp  ## build .venv from the hashed locks (does nothing when it is current)

hooks: setup  ## run ruff and mypy before every commit from now on
	$(BIN)/pre-commit install

demo: .venv/.demo-stamp  ## simulate, train, export, watch trials go by that the model never saw
	$(BIN)/python -m examples.demo.demo

test: setup  ## run the tests
	$(BIN)/python -m pytest $(ACROSS) $(ARGS)

loop: setup  ## what holding on costs: grip controllers in a closed loop, into build/loop and docs/shared-control-figures.md
	$(BIN)/python -m studies loop --page $(ARGS)

real: setup  ## train, export and evaluate on the public recordings, into build/real
distortions: setup  ## one set of trials with one nuisance at a time, into build/distortions
evaluate: setup  ## the default model on unseen simulated sets, with baselines, into build/evaluate
real distortions evaluate:
	$(BIN)/python -m studies $@ $(if $(filter evaluate,$@),--model $(MODEL)) $(ARGS)
	$(if $(filter real,$@),$(BIN)/python -m studies people --kept docs/measured/people-2026-11-29.json)

study: setup  ## one study: make study NAME=adapt; without NAME the list
	$(BIN)/python -m studies $(NAME) $(ARGS)

models: setup  ## rebuild the shipped file from scenes and lifts of people, into models; RATE=50, SIZE=tiny; SETS=scenes: without people
	$(BIN)/python -m studies models --rate $(RATE) --size $(SIZE) --out build/models/$(RATE)hz $(if $(filter scenes,$(SETS)),--scenes) $(ARGS)

soak: setup  ## the long tests: a million steps, an hour of falls in real time, and the like; then the tests beside four busy loops
	$(BIN)/python -m pytest -m soak $(ARGS)
	.ci/busy

docs: setup  ## rewrite figures, tables and pictures of README and docs from docs/measured and the code; KEEP=1: first take those in build
	$(BIN)/python -m tools.doc_tables $(if $(KEEP),--keep)
	$(BIN)/python -m tools.doc_pictures

docs-site: .venv-docs/.stamp .venv-browser/.stamp  ## the documents as a site that opens from a folder, into build/docs-site; fails on a broken link
	NO_MKDOCS_2_WARNING=1 .venv-docs/bin/mkdocs build --strict --config-file tools/docs_site/mkdocs.yml

screenshots: setup  ## pictures of the site and the reports at 390, 1366 and 1920 px, light and dark, into build/screenshots; names what is cut off; needs chromium
	PYTHONPATH=tests/support $(BIN)/python tools/screenshots.py $(ARGS)

hard-cases: setup  ## run the hard cases and write their results into docs/hard-cases.md
	$(BIN)/python -m pytest $(ACROSS) -m "hard_case and not soak" --hard-cases=build/hard-cases.json $(ARGS)
	$(BIN)/python tests/support/hard_cases_page.py build/hard-cases.json docs/hard-cases.md

safety: setup  ## run the tests of the hazards and write their results into docs/safety.md
	$(BIN)/python -m pytest $(ACROSS) -m "hazard and not soak" --hazards=build/hazards.json $(ARGS)
	$(BIN)/python tests/support/safety_page.py build/hazards.json docs/safety.md

bench: setup  ## what accuracy costs in time on this machine; all, or only NAME=cost; into build/bench
	$(BIN)/python -m benchmarks $(or $(NAME),all) --out build/bench $(ARGS)

latency: setup  ## a step as deployed at 150 and 50 Hz, minutes on a quiet machine, into docs/measured, its tables and picture; OLDER=FILE: beside it
	$(BIN)/holdfast bench latency holdfast-150hz --force --out build/bench/150hz $(if $(OLDER),--older $(OLDER)) $(ARGS)
	$(BIN)/holdfast bench latency holdfast-50hz --force --out build/bench/50hz $(ARGS)
	for rate in 150hz 50hz; do cp build/bench/$$rate/latency.json docs/measured/latency-$$rate.json; done
	$(MAKE) docs

browser: setup .venv-browser/.stamp  ## a simulated hand to pull at, with the default model, as a page that needs no server, into build/browser
	$(BIN)/python examples/browser/build.py $(MODEL) build/browser

world: .venv-peers/.stamp  ## the shipped model in a second physics (MuJoCo), for testing only; FULL=1: all of it, hours, resumes; into build/world
	OPENBLAS_NUM_THREADS=1 .venv-peers/bin/python -m benchmarks world --out build/world --model $(MODEL) $(if $(FULL),--full) $(ARGS)

lint: setup  ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/mypy holdfast studies benchmarks tests
	$(BIN)/mypy --explicit-package-bases tools examples

lock: .tools/.stamp  ## rewrite the locks after a change of dependencies; UPGRADE=1 moves the pins too
	PYTHON=$(PYTHON) UPGRADE=$(UPGRADE) tools/lock.sh

clean:  ## remove .venv, the other environments, .tools, build and caches
	rm -rf .venv .venv-peers .venv-dist .venv-docs .venv-browser .tools build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

dist: setup .venv-dist/.stamp  ## the wheel and the source archive, checked, into dist
	rm -rf dist
	$(BIN)/python -m hatchling build -d dist
	.venv-dist/bin/twine check --strict dist/*

# pip is used once, to fetch uv: `--target` works where Debian marks its Python as externally managed.
.tools/.stamp: tools/uv.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Holdfast needs Python 3.11 or newer; try: make setup PYTHON=python3.11")'
	rm -rf .tools
	$(PYTHON) -m pip install --quiet --disable-pip-version-check --root-user-action=ignore --no-deps \
	    --only-binary :all: --target .tools --require-hashes -r tools/uv.txt
	@touch $@

.venv/.stamp: .tools/.stamp $(LOCKS) pyproject.toml
	@test -x $(BIN)/python || $(UV) venv --quiet --clear --python "$$(command -v $(PYTHON))" .venv
	$(UV) pip sync --quiet --python $(BIN)/python --only-binary :all: --require-hashes $(LOCKS)
	$(UV) pip install --quiet --python $(BIN)/python --no-build-isolation --no-deps --editable .
	@$(BIN)/python -m compileall -q -j 0 -x /tests/ $(addprefix .venv/lib/python3*/site-packages/,$(LARGE)) holdfast studies benchmarks
	@touch $@

# A part of what .stamp installs: `make demo` leaves what `make test` has installed, and `make test` after it adds the rest.
.venv/.demo-stamp: .tools/.stamp $(DEMO_LOCKS) pyproject.toml
	@test -x $(BIN)/python || $(UV) venv --quiet --clear --python "$$(command -v $(PYTHON))" .venv
	$(UV) pip install --quiet --python $(BIN)/python --only-binary :all: --no-deps --require-hashes \
	    $(addprefix --requirement ,$(DEMO_LOCKS))
	$(UV) pip install --quiet --python $(BIN)/python --no-build-isolation --no-deps --editable .
	@touch $@

# Environments beside .venv, which keeps to what is tested: each has the locks of its line, and of dev.lock where the same
# numpy or our own code must be there. .venv-peers: MuJoCo. .venv-dist: twine. .venv-docs: the site and its notebooks.
.venv-peers/.stamp: MORE := $(LOCKS)
.venv-docs/.stamp: MORE := $(LOCKS)
.venv-%/.stamp: .tools/.stamp $(LOCKS) requirements/%.lock pyproject.toml
	@test -x .venv-$*/bin/python || $(UV) venv --quiet --clear --python "$$(command -v $(PYTHON))" .venv-$*
	$(UV) pip sync --quiet --python .venv-$*/bin/python --only-binary :all: --require-hashes $(MORE) requirements/$*.lock
	$(if $(MORE),$(UV) pip install --quiet --python .venv-$*/bin/python --no-build-isolation --no-deps --editable .)
	@touch $@
