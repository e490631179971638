# Everything from a fresh clone: `make demo`, `make test`. `make help` lists the rest.

PYTHON ?=
VENV ?= .venv
BAG ?= bags/demo
OUT ?= out/$(notdir $(BAG:%/=%))
CLOUD ?=
PAIRS ?=

# The environment is complete in itself: a sourced ROS or another environment must not leak in.
unexport PYTHONPATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
export PYTHON VENV

# A stamp says that a step of the set-up was done for these inputs; a second run takes seconds.
stamps := $(VENV)/stamps
interface_files = $(wildcard $(1)/*.* $(1)/msg/*.msg $(1)/srv/*.srv) \
  wheels/build-tools.txt scripts/install_interfaces.sh scripts/wheel_targets.cmake

.PHONY: help setup demo test soak check run-bag bench benchmark benchmark-full clean distclean
.DELETE_ON_ERROR:

help:
	@echo 'make demo       set up, replay the bundled bag of two agents, say where the report is'
	@echo 'make test       set up, run the tests'
	@echo 'make soak       the long forms of the fault tests: fuzz, ten agents under fire [MINUTES=30]'
	@echo 'make check      set up, check format, lint, types, the colcon build and the README'
	@echo 'make run-bag    replay your own bag: make run-bag BAG=path/to/bag [OUT=out/name]'
	@echo 'make bench      CPU seconds by stage: make bench [CLOUD=path/to/cloud.ply]'
	@echo 'make benchmark  this package and other methods on the pairs of the suite short, or of PAIRS, a'
	@echo '                suite or folder; make benchmark-full: many more; both go on where they stopped'
	@echo 'make setup      only set up: Debian packages, $(VENV), wheels, messages'
	@echo 'make clean      remove build products and outputs; make distclean also $(VENV)'
	@echo 'PYTHON=/path/to/python3 picks the interpreter (3.11 or newer)'

setup: $(stamps)/share $(stamps)/topometric_msgs $(stamps)/tf2_msgs

$(stamps)/wheels: setup.py pyproject.toml wheels/build-tools.txt scripts/create_venv.sh
	@scripts/system_packages.sh
	@scripts/create_venv.sh $(VENV)
	@mkdir -p $(@D) && touch $@

$(stamps)/topometric_msgs: $(call interface_files,msg_schemas/topometric_msgs) | $(stamps)/wheels
	@scripts/install_interfaces.sh $(VENV) msg_schemas/topometric_msgs
	@touch $@

$(stamps)/tf2_msgs: $(call interface_files,wheels/tf2_msgs) | $(stamps)/wheels
	@scripts/install_interfaces.sh $(VENV) wheels/tf2_msgs
	@touch $@

$(stamps)/share: $(stamps)/wheels package.xml $(wildcard config/* launch/* rviz/* security/* executables/*)
	@scripts/install_share.sh $(VENV)
	@touch $@

demo: setup
	@scripts/demo.sh

test: setup
	$(VENV)/bin/python -m pytest

MINUTES ?= 30
soak: setup
	TOPOMETRIC_FUZZ_CASES=10000 $(VENV)/bin/python -m pytest test/test_fuzz.py
	TOPOMETRIC_PARTITION_S=600 $(VENV)/bin/python -m pytest test/test_bad_radio.py
	$(VENV)/bin/python scripts/soak.py out/soak --minutes $(MINUTES)

check: setup
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy
	scripts/colcon_build.sh $(VENV)
	$(VENV)/bin/python scripts/check_readme.py README.md

run-bag: setup
	$(VENV)/bin/topometric replay $(BAG) -o $(OUT)

bench: setup
	$(VENV)/bin/python scripts/benchmark_extraction.py $(CLOUD)

# The suite grid needs the development data beside the repository.
benchmark_extra = $(VENV)/bin/pip install --quiet "kiss-matcher>=1.0; python_version < '3.13'"
full_suites = full $(if $(wildcard ../shared/data/pairs),grid)
benchmark: setup
	@$(benchmark_extra)
	$(VENV)/bin/topometric benchmark $(or $(PAIRS),short) -o out/benchmark-short --timeout 120

benchmark-full: setup
	@$(benchmark_extra)
	set -e; for suite in $(or $(PAIRS),$(full_suites)); do \
	  $(VENV)/bin/topometric benchmark $$suite -o out/benchmark-$$(basename $$suite); \
	done

clean:
	rm -rf build install log out dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find topometric_ros test scripts -name __pycache__ -prune -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV)
