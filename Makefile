# Every target sets up what it needs; `make help` lists them.
SHELL := /bin/bash
SEED ?= 0
# Python of the environment, 3.11 or 3.12; each that is named has a folder for itself.
PYTHON ?=
VENV := .venv$(if $(PYTHON),-$(PYTHON))
BIN := $(VENV)/bin
export AMENT_PREFIX_PATH := $(CURDIR)/$(VENV)
PYTEST := $(BIN)/python -m pytest
# Every Python package: src/NAME/setup.py builds src/NAME/NAME.
SOURCES := $(foreach p,$(notdir $(patsubst %/setup.py,%,$(wildcard src/*/setup.py))),src/$(p)/$(p))

.PHONY: help setup demo test coverage check format colcon dist lock docs clean

help: ## list the targets
	@grep -E '^[a-z]+:.*##' Makefile | sed -E 's/:.*## /\t/' | expand -t 12

setup: ## make .venv with everything in it (PYTHON=3.12 makes .venv-3.12)
	@tools/setup.sh $(VENV) $(PYTHON)

demo: setup ## a simulated Panda opens the ambiguous door; report in out/demo (SEED=n chooses the mode)
	$(BIN)/flowbothd demo --seed $(SEED)

test: setup ## all tests that this machine can run, colcon included (PYTHON=3.12 chooses the Python)
	$(PYTEST) -m "not slow" $(ARGS)

coverage: setup ## make test with line coverage, which may not fall below the floor of pyproject.toml
	$(PYTEST) -m "not slow" --cov --cov-report=

check: setup ## format, lint, types, spelling, and the tests that need no ROS
	$(BIN)/ruff format --check src tests tools examples conftest.py
	$(BIN)/ruff check src tests tools examples conftest.py
	$(BIN)/mypy $(SOURCES)
	$(BIN)/codespell src tests tools examples docs README.md ARCHITECTURE.md CONTRIBUTING.md CHANGELOG.md
	$(PYTEST) -q -m "not ros and not e2e and not long and not slow"

format: setup ## format the code and sort its imports
	$(BIN)/ruff format src tests tools examples conftest.py
	$(BIN)/ruff check --fix src tests tools examples conftest.py

colcon: setup ## build and test the Python packages with colcon, without any ROS sourced
	cd ros2_ws && ../$(BIN)/colcon build --packages-ignore flowbothd_interfaces
	cd ros2_ws && ../$(BIN)/colcon test --packages-ignore flowbothd_interfaces --pytest-args -m "not ros and not e2e and not slow"
	cd ros2_ws && ../$(BIN)/colcon test-result --verbose

dist: setup ## build the wheels of all packages into dist
	tools/build_wheels.sh $(VENV) dist

docs: setup ## write the generated tables of docs and README again
	$(BIN)/python tools/interface_tables.py

lock: ## compile requirements.in into requirements.lock
	.uv/bin/uv pip compile requirements.in --universal --python-version 3.11 --generate-hashes \
	  --no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" -o requirements.lock

clean: ## remove everything that the targets made
	rm -rf .venv .venv-* .uv out dist ros2_ws/build ros2_ws/install ros2_ws/log
