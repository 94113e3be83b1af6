# One command each. All but `help` and `clean` set the workspace up first when that is needed.
SHELL := /bin/bash
MAKEFLAGS += --no-print-directory
.DEFAULT_GOAL := help
.PHONY: help setup cli demo play test test-tools lint format bench charts docs clean workspace checks

# A mistyped name would be ignored without a word.
NAMES := ARGS CAMERA METHOD PORT PYTHON RIG SCENARIO SOURCES TRANSPORT WORKERS
$(foreach name,$(.VARIABLES),$(if $(filter command line,$(origin $(name))),$(if $(filter $(NAMES) MAKE% -%,$(name)),,\
    $(error $(name) is unknown, allowed: $(NAMES)))))

ENTER := . ./env.sh &&
# Everything that is type-checked
TYPED := $(filter-out %.egg-info %__pycache__/,$(wildcard src/*/plate_* bench/*.py bench/*/ tools/*.py tools/cases tools/graph tools/record))

help: ## List these commands
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' Makefile

setup: ## Install everything into .venv and build the packages
	@tools/setup.sh

cli: workspace ## Install the `ros2` command line, where there is no ROS: [SOURCES=https://github.com]
	@tools/cli.sh

workspace:
	@tools/setup.sh --quiet

checks:
	@tools/setup.sh --quiet --checks

# Options of demo and play. Variables set after `make` reach the shell through its environment, whatever they contain.
RUN = $${SCENARIO:+--scenario "$$SCENARIO"} $${RIG:+--rig "$$RIG"} $${METHOD:+--method "$$METHOD"} \
	    $${CAMERA:+--camera "$$CAMERA"} $${PORT:+--port "$$PORT"}

demo: workspace ## Run the closed loop: [SCENARIO=sort_10] [RIG=...] [METHOD=...] [TRANSPORT=...] [CAMERA=...] [PORT=...]
	@$(ENTER) exec python tools/demo.py $(RUN) $${TRANSPORT:+--transport "$$TRANSPORT"} $(ARGS)

play: workspace ## Play on a live page: [SCENARIO=play] [RIG=...] [METHOD=...] [CAMERA=...] [PORT=...]
	@$(ENTER) exec python tools/play.py $(RUN) $(ARGS)

# One for each core, 2 to 8: half of them mostly wait for real nodes, to which the others give way (test/lanes.py).
# With one more, the driver sometimes sends nothing for too long, and the board stops the plate.
WORKERS ?= $(shell cores=$$(env -u OMP_NUM_THREADS nproc); echo $$(( cores < 2 ? 2 : cores > 8 ? 8 : cores )))

test-tools: checks ## Install Chromium, ARM compilers and launch, for some tests: [SOURCES=https://github.com]
	@$(ENTER) exec python tools/needs.py --install

# What was made of the tests' code is kept, or each worker makes it anew, in 7 s, before its first one.
test: checks ## Run all tests: [ARGS='-k name'] [WORKERS=2; 0: in one process]
	@$(if $(ARGS),,echo "About 10 minutes on two idle cores; some tests: make test ARGS='-k name'";) \
	    $(ENTER) unset PYTHONDONTWRITEBYTECODE && export ROS_PYTHON_CHECK_FIELDS=1 && \
	    python tools/needs.py && exec python -m pytest -n $(WORKERS) $(ARGS)

lint: checks ## Check style, sentences and types
	@$(ENTER) ruff check . && ruff format --check . && python tools/english.py && exec mypy $(TYPED)

format: checks ## Put the code into the project's format
	@$(ENTER) ruff check --fix . && exec ruff format .

bench: workspace ## Measure: out/bench/NAME.json [ARGS=...]
	@$(ENTER) exec python bench/run.py $(ARGS)

charts: workspace ## Measure and draw: out/report/index.html, docs/results.md [ARGS='--quick' or '--draw']
	@$(ENTER) python tools/install.py -r requirements-bench.txt && \
	    exec python bench/charts.py $(ARGS)

docs: workspace ## Build the site, guide and API: out/site/docs/index.html
	@$(ENTER) python tools/install.py -r requirements-docs.txt && \
	    python -m sphinx -q -W --keep-going -c docs . out/site && echo out/site/docs/index.html

clean: ## Remove everything that set-up made; results in out/ stay
	rm -rf .venv build install log .matplotlib_cache .mypy_cache .pytest_cache .ruff_cache *.egg-info
