# Everything runs in .venv, which `make setup` fills from Python wheels; no ROS installation is needed or used.

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-all lint clean distclean

BIN := .venv/bin

# A sourced ROS, or a calling process that runs in another environment, must not leak into this one.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE

help:  ## print this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup:  ## create or update .venv: dependencies, this package (editable), ROS interfaces
	@tools/setup.sh

demo: setup  ## evaluate grasps on a soft object through the ROS service, from nothing
	$(BIN)/python examples/demo.py

test: lint  ## lint and run the tests, but for the slow ones
	$(BIN)/python -m pytest -m "not slow"

test-all: lint  ## lint and run all tests
	$(BIN)/python -m pytest

lint: setup  ## check the code with ruff
	$(BIN)/ruff check

clean:  ## remove caches, and what colcon and the demo made
	rm -rf build install log demo_output .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -path ./.venv -prune -o -name __pycache__ -type d -exec rm -rf {} +

distclean: clean  ## clean and remove .venv
	rm -rf .venv
