# make setup | sweep [ARGS=..] | results | pages | check | lint | weight | test | test-fast | test-long | test-arm | docs | lock | dist | addresses
#
#   make sweep ARGS="--preset smoke --out results/try"

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
# Where torch for the CPU comes from: make setup TORCH= takes the usual build, with CUDA.
TORCH  ?= https://download.pytorch.org/whl/cpu
# Simulators and learner use one thread each; parallel work is done by processes.
export OMP_NUM_THREADS ?= 1
# Compiled modules are kept: processes begin in two thirds of the time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup sweep results check lint weight test test-fast test-long test-arm pages docs lock dist addresses clean

setup: $(STAMP)

# The stamp is written last, so an interrupted installation is done again.
# (editable_mode=compat: a plain path entry, so that modules added later are found without installing again.)
$(STAMP): pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or newer is needed; name one with: make $(MAKECMDGOALS) PYTHON=/path/to/python3" >&2; exit 1; }
	@echo "installing into $(VENV), about 3 GB: this takes minutes and prints little"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --retries 1 --timeout 10 -c requirements.lock \
	  $(if $(TORCH),--extra-index-url $(TORCH)) torch
	$(BIN)/python -m pip install --disable-pip-version-check --quiet -c requirements.lock \
	  --config-settings editable_mode=compat -e '.[study,reference,replica,gui,dev]'
	@touch $@

sweep: setup
	$(BIN)/python experiments/sweep.py $(ARGS)

# What a change has to pass.
check: lint test docs

lint: setup weight
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# No file above 500 kB outside of results and pictures: git keeps every version for ever.
weight:
	@git ls-files -z -- . ':!results' ':!docs/img' | xargs -0 du --apparent-size -k 2>/dev/null \
	  | awk '$$1 > 500 { print "too large for git: " $$2 " (" $$1 " kB)"; bad = 1 } END { exit bad }'

# Everything but what is marked "long", on two processes: under ten minutes.
test: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not long" --durations=25 $(ARGS)

# Six to seven CPU minutes: what to run while writing code. Of one room: docs/developers/architecture.md.
test-fast: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not long" $(ARGS)

# What takes longer; before a release.
test-long: setup
	$(BIN)/python -m pytest -n 2 -m long --timeout 3600 --durations=0 $(ARGS)

# The simulator on Linux for aarch64, under emulation: what tests/arm/run.sh says.
test-arm: setup
	PYTHON=$(BIN)/python bash tests/arm/run.sh

# The pages that quote results, from docs/templates and the stored tables.
pages: setup
	$(BIN)/python docs/pages.py

# The documentation as a site; open site/index.html.
docs: setup
	$(BIN)/python -m pip install --disable-pip-version-check --quiet -c requirements.lock \
	  --config-settings editable_mode=compat -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "open site/index.html"

# The wheel and the source distribution in dist/, checked.
dist: setup
	$(BIN)/python -m pip install --disable-pip-version-check --quiet build twine
	rm -rf dist && $(BIN)/python -m build --outdir dist
	$(BIN)/python -m twine check --strict dist/*

# The addresses of the project into all files that name them, once it has any; then: make pages.
#   make addresses REPOSITORY=https://... DOCUMENTATION=https://...     (without a slash at the end)
addresses:
	$(if $(and $(REPOSITORY),$(DOCUMENTATION)),,$(error REPOSITORY and DOCUMENTATION are needed))
	sed -i -e '/address: /{s|^# address: ||;s|^{# address: \(.*\) #}$$|\1|;s|REPOSITORY|$(REPOSITORY)|g;s|DOCUMENTATION|$(DOCUMENTATION)|g;}' \
	  -e 's|^DOCUMENTATION = ""|DOCUMENTATION = "$(DOCUMENTATION)"|' \
	  pyproject.toml CITATION.cff mkdocs.yml docs/templates/README.md.j2 sumo_env/unsupported.py

# The installed versions as the new constraint file; the head of the old file is kept.
lock: setup
	@sed -n '/^#/p' requirements.lock > requirements.lock.new
	@$(BIN)/python -m pip list --disable-pip-version-check --format=freeze --exclude-editable \
	  | grep -viE '^(pip|wheel)==' | sed 's/+cpu$$//' | sort -f >> requirements.lock.new
	@mv requirements.lock.new requirements.lock

clean:
	rm -rf .mypy_cache .ruff_cache .pytest_cache build site *.egg-info
