# Every command a person or a CI machine types. Each target does its own set-up: a Python >= 3.11 is all it needs.
#   make run ARGS="scenarios/paper.toml --uavs 50"      make test ARGS="-k rician"      make PYTHON=python3.12 test

.DEFAULT_GOAL := help
VENV := .venv
LEARNERS := .venv-learners
BIN := $(VENV)/bin
PYTHON ?=
ARGS ?=
WORKERS ?=
COMPOSE ?= docker compose
CERTS ?=
AFTER ?=
SECURE = $(if $(CERTS),-f docker-compose.yml -f $(CERTS)/compose.yaml --profile secure)
# Bytecode is kept whatever the environment says: else each worker compiles all tests, and each process what changed.
PYTEST := PYTHONDONTWRITEBYTECODE= $(BIN)/pytest

# One BLAS thread in each process: a swarm is already as many processes as it has vehicles.
export OPENBLAS_NUM_THREADS ?= 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# The environment is stale when its interpreter is gone or when the checkout has been moved or copied.
in_place := [ -x $(BIN)/python ] && [ "$$(cat $(VENV)/.home 2>/dev/null)" = "$$(pwd -P)" ]
STALE := $(shell $(in_place) || echo stale)

.PHONY: help run test check format bench learners peers fuzz soak picture docs results images up test-compose judges wheels constraints clean stale

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  \033[1m%-14s\033[0m %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

run: $(VENV)/.ground ## Fly the paper's scenario: 25 UAV processes, leader and world (ARGS="--method mfg --uavs 50")
	@$(BIN)/meanflock run $(ARGS)

# Tests that start whole swarms come last (tests/conftest.py), so that their deadlines do not compete with unit tests for
# the cores; half of the time they wait, so three go at once, also on two cores. Tests that share a swarm, or something
# dear, are a group: all on one worker.
test: $(VENV)/.dev ## Run all tests but those of containers, judges and wheels (ARGS="-k rician")
	@$(PYTEST) -n $(or $(WORKERS),3) --dist loadgroup --no-loadscope-reorder --ignore=tests/compose --ignore=tests/judges --ignore=tests/wheels $(ARGS)

judges: $(VENV)/.dev ## Have foreign software read what we write, each in an environment of its own (rclpy needs Python 3.11)
	@$(PYTEST) tests/judges $(ARGS)

learners: $(LEARNERS)/.ready ## Fly models of PyTorch, in an environment of its own (PIP_EXTRA_INDEX_URL: for a torch without CUDA)
	@PYTHONDONTWRITEBYTECODE= $(LEARNERS)/bin/python -m pytest tests/judges/learners tests/agent/learning $(ARGS)

wheels: $(VENV)/.dev ## Build the wheel, audit it, and fly with it on each Python that is here, in environments of its own
	@$(PYTEST) tests/wheels $(ARGS)

check: $(VENV)/.dev ## Format, lint and types, changing nothing
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(VENV)/.dev ## Apply the format, and fix what the linter can fix
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.dev ## Run the benchmarks
	@$(BIN)/python -m benchmarks $(ARGS)

peers: $(VENV)/.dev ## Install the software that `make bench` compares with, each in an environment of its own (ARGS="pyrvo pfl")
	@$(BIN)/python -m benchmarks.peers --setup $(ARGS)

fuzz: $(VENV)/.dev ## Throw a million mutated messages at a flight (ARGS="--count 10000")
	@$(BIN)/python -m tests.fuzz $(ARGS)

soak: $(VENV)/.dev ## Fly 10,000 ticks on processes that are killed, frozen and restarted (ARGS="--ticks 1000")
	@$(BIN)/python -m tests.soak $(ARGS)

results: $(VENV)/.dev ## Fly published results again, a part or more; without ARGS list the parts (ARGS=federation)
	@$(BIN)/python -m research.results $(ARGS)

picture: $(VENV)/.ground ## Draw the pictures of recordings again (needs a software or hardware Vulkan driver)
	@$(BIN)/python -m research.pictures

docs: .docs/.ready ## Build the documentation as a web site, site/index.html, and check its links
	@.docs/bin/python docs/website.py

images: ## Build the container images (BASE_IMAGE=... for another Python image; EXTRAS=torch)
	$(COMPOSE) build

# Containers run as whoever types it, and as the images' user where that is root.
up: images ## The same run in containers, recorded into runs/ (MEANFLOCK_UAVS=25 MEANFLOCK_SET="seed=7" CERTS=DIR: mutual TLS)
	@set -eu; uid=$$(id -u) gid=$$(id -g); mkdir -p runs; \
	if [ $$uid = 0 ]; then uid=1000 gid=1000; chown 1000:1000 runs; fi; \
	MEANFLOCK_UID=$${MEANFLOCK_UID:-$$uid} MEANFLOCK_GID=$${MEANFLOCK_GID:-$$gid} $(COMPOSE) $(SECURE) up --no-build $(ARGS)

test-compose: ## Test the containers, on whichever container engine is running
	@if [ -d tests/compose ]; then \
		$(MAKE) --no-print-directory $(VENV)/.dev images && $(PYTEST) --timeout 600 -n $(or $(WORKERS),2) tests/compose tests/test_images.py $(ARGS); \
	else \
		echo "test-compose: there is no tests/compose, so nothing to test"; \
	fi

constraints: ## Pin the newest versions within the ranges of pyproject.toml in constraints.txt
	@set -eu; tmp=$$(mktemp -d); trap 'rm -rf "$$tmp"' EXIT; \
	$(find_python); $(call make_venv,"$$tmp/venv"); \
	"$$tmp/venv/bin/python" -m pip install -qq -e '.[dev]'; \
	{ echo "# Every direct and transitive dependency of .[dev], at the version we test; pyproject.toml has the ranges. Refresh: make constraints"; \
	  "$$tmp/venv/bin/python" -m pip freeze --exclude-editable --exclude meanflock | tr 'A-Z_' 'a-z-' | sed -E ':a; s/^([^=]*)\./\1-/; ta' | LC_ALL=C sort; \
	} > "$$tmp/constraints.txt"; \
	cp "$$tmp/constraints.txt" constraints.txt; echo "constraints.txt: $$(grep -c == constraints.txt) packages"

clean: ## Remove the environment, caches and build leftovers; runs/ stays
	rm -rf $(VENV) $(LEARNERS) .bench .docs site build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# ---- set-up -----------------------------------------------------------------------------------------------------------
# find_python sets $python: the first that is recent enough and can make an environment with pip in it; failing that, the
# first recent enough one that has a pip of its own to lend.
define find_python
python=; recent=; \
for candidate in $(or $(PYTHON),python3.13 python3.12 python3.11 python3); do \
	"$$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || continue; \
	recent=$${recent:-$$candidate}; \
	if "$$candidate" -c 'import ensurepip, venv' 2>/dev/null; then python=$$candidate; pip=own; break; fi; \
done; \
if [ -z "$$recent" ]; then \
	echo "meanflock needs Python 3.11 or newer; tried: $(or $(PYTHON),python3.13 python3.12 python3.11 python3)." >&2; \
	echo "Install one (Debian, Ubuntu: apt-get install python3 python3-venv), or name yours: make PYTHON=/path/to/python3.12" >&2; \
	exit 1; \
fi; \
if [ -z "$$python" ] && "$$recent" -c 'import pip, venv' 2>/dev/null; then python=$$recent; pip=lent; fi; \
if [ -z "$$python" ]; then \
	package=$$("$$recent" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'); \
	echo "$$recent cannot make a virtual environment: its venv or ensurepip module is missing." >&2; \
	echo "Install it (Debian, Ubuntu: apt-get install $$package), then repeat the command." >&2; \
	exit 1; \
fi
endef

# $(call make_venv,DIRECTORY), after find_python. Older versions of pip work, but take twice the time.
PIP := 'pip>=25'
define make_venv
if [ $$pip = own ]; then \
	"$$python" -m venv --clear $(1); \
	$(1)/bin/python -m pip install -qq $(PIP) || echo "Going on with the pip that this Python brings" >&2; \
else "$$python" -m venv --clear --without-pip $(1); "$$python" -m pip --python $(1)/bin/python install -qq $(PIP); fi
endef

# $(call install,EXTRA): make the environment if there is none, then install this checkout into it. Type checkers do not
# find an editable install, so a .pth file names a folder with nothing but a link to meanflock/. Bytecode of what flights
# and studies import is made here: where PYTHONDONTWRITEBYTECODE is set, every process would compile it for itself, each
# time. To compile all packages, as pip does, takes half of the installation.
define install
@set -eu; \
if ! { $(in_place); }; then \
	$(find_python); \
	echo "Setting up $(VENV) with $$("$$python" --version): once, about a minute"; \
	$(call make_venv,$(VENV)); \
fi; \
$(BIN)/python -m pip install -qq --no-compile -c constraints.txt -e '.[$(1)]'; \
mkdir -p $(VENV)/checkout; \
ln -sfn ../../meanflock $(VENV)/checkout/meanflock; \
echo "$$(pwd -P)/$(VENV)/checkout" > "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/checkout.pth"; \
$(BIN)/python -m compileall -q meanflock $$(find meanflock -type l -exec readlink -f {} +); \
PYTHONDONTWRITEBYTECODE= $(BIN)/python -c 'import meanflock.cli.study_results, meanflock.launch.progress, meanflock.launch.run, meanflock.recording.recorder, meanflock.results.plots.run, meanflock.studies.runner'; \
pwd -P > $(VENV)/.home
endef

# Torch and Flower need other versions of some libraries than the rest: constraints-learners.txt. They are large, and
# tests import a small part of them: that is compiled when it is first imported.
$(LEARNERS)/.libraries: constraints-learners.txt
	@set -eu; $(find_python); $(call make_venv,$(LEARNERS)); \
	$(LEARNERS)/bin/python -m pip install -qq --no-compile -r constraints-learners.txt
	@touch $@

# Both environments build the kernels in place: where they are made at once, this one waits for AFTER=.venv/.dev.
$(LEARNERS)/.ready: $(LEARNERS)/.libraries pyproject.toml setup.py $(wildcard meanflock/kernels/*.[ch] meanflock/kernels/*/*.[ch]) | $(AFTER)
	@set -eu; $(LEARNERS)/bin/python -m pip install -qq --no-compile -c constraints-learners.txt -e '.[flower,torch]' $$($(LEARNERS)/bin/python -c \
	'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["dependency-groups"]["learners"])')
	@touch $@

# What builds the site, at the version that the dependency group `docs` pins.
.docs/.ready: pyproject.toml
	@set -eu; $(find_python); $(call make_venv,.docs); \
	.docs/bin/python -m pip install -qq $$(sed -n 's/^docs = \["\(zensical==[0-9.]*\)"\].*/\1/p' pyproject.toml)
	@touch $@

$(VENV)/.ground: pyproject.toml setup.py constraints.txt $(wildcard meanflock/kernels/*.[ch] meanflock/kernels/*/*.[ch]) $(STALE)
	$(call install,ground)
	@touch $@

$(VENV)/.dev: pyproject.toml setup.py constraints.txt $(wildcard meanflock/kernels/*.[ch] meanflock/kernels/*/*.[ch]) $(STALE)
	$(call install,dev)
	@touch $@ $(VENV)/.ground
