# Everything happens in .venv, which the first target makes. PYTHON= chooses the interpreter (3.11 to 3.14).
# PIP_ARGS= goes to every `pip install`, for example --extra-index-url with PyTorch's CPU builds. RECORDS= is where
# `make records` writes.

VENV ?= .venv
BIN := $(VENV)/bin
SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))
PYTHON ?= $(firstword $(foreach name,python3 python3.14 python3.13 python3.12 python3.11,$(shell $(name) -c '$(SUPPORTED)' 2>/dev/null && echo $(name))))
PIP_ARGS ?=
ARGS ?=
# Processes that run tests; ARGS="-n 0" is one that a debugger can stop.
WORKERS ?= 2
# A process that dies fails its test by name, and the others end. Replaced, it would leave pytest-xdist 3.8 waiting for
# ever: it hands out files again that have nothing left to run.
PARALLEL = -n $(WORKERS) --dist loadfile --max-worker-restart=0
RECORDS ?= bench/results
# Where `make figures` draws.
FIGURES ?= docs
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) -c constraints.txt
CODE = $(wildcard sdm kernels tests bench docs/site)

# Adapters of other libraries, which need these.
INTEGRATIONS = dev,bench,explore,formats,integrations,jax,monai,nnunet,pyvista,torchio
INTEGRATION_TESTS = tests/unit/test_jax.py tests/unit/losses tests/unit/compat tests/unit/core tests/unit/io \
	tests/unit/explore tests/unit/bench/dropins tests/unit/bench/edt tests/unit/bench/pipelines \
	"tests/unit/test_examples.py::test_example_leaves_its_picture[monai_pipeline]"

.PHONY: demo docs figures notebooks test test-all test-bounds test-integrations run-integrations lint format bench records release install clean help
.DEFAULT_GOAL := help

help: ## List the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1	/p' $(MAKEFILE_LIST) | expand -t 12

demo: $(VENV)/.installed ## Compute the built-in mesh's map: demo/demo.nii.gz and demo/demo.png
	$(BIN)/sdm demo --out demo $(ARGS)

# Thousands of assertions are rewritten by pytest, once if what is compiled may be kept.
unexport PYTHONDONTWRITEBYTECODE

test: $(VENV)/.installed-dev ## Run the quick tests
	$(BIN)/python -m pytest -m "not slow" $(PARALLEL) $(ARGS)

test-all: $(VENV)/.installed-dev ## Run every test
	$(BIN)/python -m pytest $(PARALLEL) $(ARGS)

test-bounds: $(VENV)/.installed-dev ## Run the quick tests with kernels that check every index, in about an hour
	WARP_CACHE_PATH=$(VENV)/warp-bounds $(BIN)/python -m pytest -p tests.helpers.checked_bounds -m "not slow" $(PARALLEL) $(ARGS)

test-integrations: ## Run the tests of adapters beside the libraries that they are for, in an environment of its own
	$(MAKE) VENV=$(VENV)-integrations run-integrations

run-integrations: $(VENV)/.installed-integrations
	$(BIN)/python -m pytest $(PARALLEL) -rs $(INTEGRATION_TESTS) $(ARGS)

lint: $(VENV)/.installed-dev ## Check style, types and import rules
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports --no-cache

format: $(VENV)/.installed-dev ## Put the code into the house format
	$(BIN)/ruff check --fix $(CODE)
	$(BIN)/ruff format $(CODE)

bench: $(VENV)/.installed-bench ## Compare with the other libraries on this machine
	$(BIN)/sdm bench $(ARGS)

records: $(VENV)/.installed-bench ## On a GPU, about ten minutes: its tests, then its records in RECORDS, all of one commit
	$(BIN)/python -m pytest -m "not slow" tests/gpu
	$(BIN)/python -m sdm.bench.dense --device cuda --out $(RECORDS)/dense-cuda.json
	$(BIN)/python -m sdm.bench.gpu.sanitize --out $(RECORDS)/sanitizer.json
	$(BIN)/python -m sdm.bench.stream --parts rates training loader --out $(RECORDS)/stream.json
	$(BIN)/python -m sdm.bench.edt --device cuda --out $(RECORDS)/edt-cuda.json
	$(BIN)/python -m sdm.bench.dense.accuracy --device cuda --out $(RECORDS)/accuracy-cuda.json

figures: $(VENV)/.installed-bench ## Draw the pictures of README and docs again, from records or in seconds, in FIGURES
	$(BIN)/sdm demo --out $(FIGURES)/new-demo --device cpu
	mv $(FIGURES)/new-demo/demo.png $(FIGURES)/new-demo/surrogate.png $(FIGURES)
	rm -r $(FIGURES)/new-demo
	$(BIN)/python -m sdm.bench.dense.stages_figure --out $(FIGURES)/stages.png
	$(BIN)/python -m sdm.bench.drawings --out $(FIGURES)
	$(BIN)/python -m sdm.bench.dense.plot_results bench/results/dense-cuda.json --out $(FIGURES)/new-dense
	mv $(FIGURES)/new-dense/dense-cuda-ratios.png $(FIGURES)/new-dense/dense-cuda-triangles.png $(FIGURES)
	rm -r $(FIGURES)/new-dense
	$(BIN)/python -m sdm.bench.surrogate.plots --out $(FIGURES)
	$(BIN)/python -m sdm.bench.segmentation.plots --out $(FIGURES)
	$(BIN)/python -m sdm.bench.deepsdf.study plot --out $(FIGURES)/deepsdf-study.png
	$(BIN)/python -m sdm.bench.fit pictures --docs $(FIGURES)

notebooks: $(VENV)/.made ## Make the notebooks of docs/examples from their scripts
	$(BIN)/python docs/site/notebooks.py

release: $(VENV)/.installed-release ## Build dist/, check it in a fresh environment, and stop before the upload
	rm -rf dist build
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/python -m sdm.bench.suite.release_check dist -- $(PIP_ARGS)

install: $(VENV)/.installed ## Make the environment alone

docs: $(VENV)/.installed-docs ## Build the documentation's site in build/site, where every warning is an error
	$(BIN)/python -m sphinx -W --keep-going -q -j auto -c docs/site -d build/doctrees . build/site
	@echo "Open build/site/index.html"

clean: ## Remove what the targets made
	rm -rf $(VENV) $(VENV)-integrations demo build dist *.egg-info .pytest_cache .ruff_cache .hypothesis .benchmarks
	find sdm kernels tests bench -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

# Debian and Ubuntu keep ensurepip in the package python3-venv; where it is missing, the system's own pip fills the folder.
$(VENV)/.made:
	@test -n "$(PYTHON)" && $(PYTHON) -c '$(SUPPORTED)' || \
	{ echo "Python 3.11, 3.12, 3.13 or 3.14 is needed: install one, or name it with PYTHON=/path/to/python3" >&2; exit 1; }
	@echo "Making $(VENV) with $$($(PYTHON) --version)"
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV) >/dev/null 2>&1 || \
	{ rm -rf $(VENV) && $(PYTHON) -m venv --without-pip $(VENV) && \
	$(PYTHON) -m pip --quiet --disable-pip-version-check --python $(BIN)/python install pip; } || \
	{ rm -rf $(VENV); echo "$(PYTHON) can make no environment: install venv for it (on Debian: apt install python3-venv)" >&2; exit 1; }
	@touch $@

$(VENV)/.installed: $(VENV)/.made pyproject.toml constraints.txt
	@echo "Installing sdm and its libraries into $(VENV); the first time takes minutes"
	$(INSTALL) -e .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.made pyproject.toml constraints.txt
	@echo "Installing sdm and its tools into $(VENV); the first time takes minutes"
	$(INSTALL) -e ".[dev]"
	@touch $(VENV)/.installed $@

$(VENV)/.installed-bench: $(VENV)/.installed-dev
	$(INSTALL) -e ".[dev,bench]"
	@touch $@

$(VENV)/.installed-release: $(VENV)/.installed
	$(INSTALL) -e ".[release]"
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(INSTALL) -e ".[docs]"
	@touch $@

$(VENV)/.installed-integrations: $(VENV)/.made pyproject.toml constraints.txt
	@echo "Installing sdm and the libraries that it works with into $(VENV); this takes minutes and some gigabytes"
	$(INSTALL) -e ".[$(INTEGRATIONS)]"
	@touch $@
