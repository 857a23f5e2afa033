# Everything a user or CI needs; nothing but Debian, Python 3.11 and make is assumed.
PYTHON ?= python3
BIN := .venv/bin
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
# bytecode is kept: without it the tests take twice as long to collect, and nodes longer to start
unexport PYTHONDONTWRITEBYTECODE

# A sourced ROS 2 brings its own rclpy and messages; without one the wheels from PyPI are installed.
ifdef ROS_DISTRO
VENV_FLAGS := --system-site-packages
EXTRAS := dev
DEMO_EXTRAS := reports
# its messages, and the distribution's SciPy, are compiled for the NumPy beside them,
# mostly 1.26, which pyarrow 26 refuses
PINS = "numpy==$$($(PYTHON) -c 'import numpy; print(numpy.__version__)')" 'pyarrow<26'
ifdef LOCKED
$(error LOCKED=1 pins another NumPy than the sourced ROS is compiled for: leave out one of them)
endif
else
VENV_FLAGS :=
EXTRAS := dev,ros
DEMO_EXTRAS := reports,ros
endif

# $(call install,EXTRAS,LOCK)
# LOCKED=1: exactly what a file of requirements/ pins, hashes checked, as CI does
ifdef LOCKED
install = $(BIN)/python -m pip install --quiet --require-hashes --requirement requirements/$(2) \
	&& $(BIN)/python -m pip install --quiet --no-deps --editable .
else
install = $(BIN)/python -m pip install --quiet --editable '.[$(1)]' $(PINS)
endif

.PHONY: help setup setup-run demo test check lint format lock audit docs reference firmware bench rehearsal soak coverage mutation test-lower-bounds test-kilted clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 20

setup: .venv/ready  ## build .venv with everything in it
.venv/ready: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV_FLAGS) .venv
	$(call install,$(EXTRAS),lock.txt)
	touch $@ .venv/ready-to-run

setup-run: .venv/ready-to-run  ## build .venv with what plans, drives and identifies, without the developers' tools
.venv/ready-to-run: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV_FLAGS) .venv
	$(call install,$(DEMO_EXTRAS),run.txt)
	touch $@

# PLC=firmware drives the real firmware on simulated UNOs instead of emulated PLCs
demo: setup-run $(if $(filter firmware,$(PLC)),firmware)  ## plan, drive, record and judge two maneuvers; writes out/demo
	$(BIN)/tricycle demo --output out/demo --overwrite $(if $(filter firmware,$(PLC)),--firmware build/firmware)

test: lint  ## everything: lint, types, import contract, all tests
	$(BIN)/python -m pytest -m "not ros" -q -n 2 --dist worksteal
	$(BIN)/python -m pytest -m ros -q -n 2 --dist worksteal

check: setup lint  ## lint, types, import contract and the fast tests
	$(BIN)/python -m pytest -m "not slow and not ros" -q -n 2 --dist worksteal

lint: setup  ## formatting, lint, types and import contract; of the firmware too where cppcheck is there
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	if command -v cppcheck >/dev/null; then $(MAKE) --no-print-directory -C firmware lint; fi

format: setup  ## format and fix what can be fixed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

lock:  ## pin every dependency anew, with hashes
	$(PYTHON) -m venv build/lock && build/lock/bin/pip install --quiet uv
	build/lock/bin/uv pip compile --quiet --upgrade --universal --python-version 3.11 \
		--generate-hashes --no-annotate --no-header --no-strip-extras --extra dev --extra ros pyproject.toml \
		--output-file requirements/lock.txt
	sed -i '1i # Every dependency of `pip install .[dev,ros]`, pinned with its hashes; written by `make lock`.' \
		requirements/lock.txt
	build/lock/bin/uv pip compile --quiet --universal --python-version 3.11 \
		--generate-hashes --no-annotate --no-header --no-strip-extras --extra reports --extra ros pyproject.toml \
		--constraint requirements/lock.txt --output-file requirements/run.txt
	sed -i '1i # The same versions of `pip install .[reports,ros]`; written by `make lock`.' requirements/run.txt

audit:  ## known vulnerabilities of the pinned dependencies; names those it could not look up
	$(PYTHON) -m venv build/audit && build/audit/bin/pip install --quiet pip-audit
	build/audit/bin/pip-audit --require-hashes --disable-pip --progress-spinner off \
		--requirement requirements/lock.txt

# without --quiet, which would hide the warnings from --strict
docs: setup  ## the documentation, as a site in build/site; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

reference: setup  ## write the reference pages and the firmware's header, which come from the code, anew
	header=$$($(BIN)/python -m tricycle_bridge.protocol.firmware_header) && printf '%s\n' "$$header" > firmware/messages.h
	$(BIN)/python docs/generate_reference.py
	for vehicle in tricycle cargo_tadpole delta_tricycle car_1_10; do $(BIN)/tricycle vehicle check \
	  src/tricycle_sim/tricycle_sim/$$vehicle.yaml --draw docs/figures/$$vehicle.png --overwrite || exit 1; done

firmware: setup-run  ## the two PLCs for the Arduino UNO and their simulator (gcc-avr, avr-libc, libsimavr-dev)
	$(MAKE) -C firmware avr simulator

bench: setup firmware  ## the benchmarks that need no arguments, for hours; kept in benchmarks/history.jsonl and plotted
	$(BIN)/python -m pip install --quiet --editable '.[$(EXTRAS),bench]' $(PINS)
	$(MAKE) -C firmware host
	$(BIN)/python benchmarks/history.py run
	$(BIN)/python benchmarks/history.py plot

rehearsal: setup firmware  ## a scripted day on a foreign plant behind the firmware, with two faults; writes out/rehearsal
	$(BIN)/python rehearsal/day.py --output out/rehearsal

soak: setup  ## an hour of driving on a bad line, a hundred cables pulled, fifty recorders killed, 1000 faults
	$(BIN)/python benchmarks/link_soak.py
	FUZZ_RUNS=20000 $(BIN)/python -m pytest -q -o faulthandler_timeout=0 tests/tricycle_bridge/test_fuzz.py
	REPLUGS=100 $(BIN)/python -m pytest -q -o faulthandler_timeout=0 tests/tricycle_bridge/test_serial_port.py -k replugs
	$(BIN)/python benchmarks/recorder_kills.py
	$(MAKE) -C firmware host
	$(BIN)/python benchmarks/fault_soak.py --backend native
	$(BIN)/python benchmarks/fault_soak.py --backend native --healthy --drives 400

# Coverage sees into kernels only when they are not compiled; then whole drives take too long.
KERNELS := $(addprefix tests/tricycle_sim/,vehicle/test_uncompiled.py vehicle/test_kernel.py test_setpoints.py) \
	-k "uncompiled or setpoints or lagrange or linkage or ratio_of or inverse or servo or static"
COVERAGE := $(BIN)/python -m coverage
PROTOCOL := src/tricycle_bridge/*/protocol/*.py,src/tricycle_bridge/*/plc_link/*.py,src/tricycle_bridge/*/arming.py,src/tricycle_bridge/*/commands/command_stream.py,src/tricycle_sim/*/plc/plc.py,src/tricycle_sim/*/plc/steer.py,src/tricycle_sim/*/plc/drive.py
PHYSICS := src/tricycle_sim/*/vehicle/*.py,src/tricycle_sim/*/setpoints.py
STATISTICS := $(addprefix src/excitation_planner/*/,box.py trajectory_error.py indices/*.py design/criteria.py design/information.py design/noise.py design/prior.py design/problem.py)
comma := ,
empty :=
coverage: setup  ## branch coverage; physics, protocol and statistics must reach 95 %
	$(COVERAGE) erase
	NUMBA_DISABLE_JIT=1 $(COVERAGE) run -m pytest -q $(KERNELS)
	$(COVERAGE) run -m pytest -q -m "not ros"
	$(COVERAGE) combine --quiet
	$(COVERAGE) report
	$(COVERAGE) report --fail-under=95 --include='$(PHYSICS)'
	$(COVERAGE) report --fail-under=95 --include='$(PROTOCOL)'
	$(COVERAGE) report --fail-under=95 --include='$(subst $(empty) $(empty),$(comma),$(STATISTICS))'

mutation: setup  ## do the tests notice changes of codec, limits and watchdog, in Python and in C?
	$(BIN)/python tests/mutation.py

LOWER_BOUNDS := .venv-lower-bounds
test-lower-bounds:  ## all tests without live nodes, with the oldest versions that pyproject.toml admits
	test -x $(LOWER_BOUNDS)/bin/python || $(PYTHON) -m venv $(LOWER_BOUNDS)
	$(LOWER_BOUNDS)/bin/python -m pip install --quiet --editable '.[dev,ros]' --constraint requirements/lower-bounds.txt
	export NUMBA_CACHE_DIR=$(CURDIR)/$(LOWER_BOUNDS)/numba; \
	$(LOWER_BOUNDS)/bin/python -m pytest -q -n 2 -m "not slow and not ros"; \
	$(LOWER_BOUNDS)/bin/python -m pytest -q -n 2 -m "slow and not ros"

KILTED := .venv-kilted
test-kilted:  ## the fast tests of live nodes with the wheels of ROS 2 Kilted
	test -x $(KILTED)/bin/python || $(PYTHON) -m venv $(KILTED)
	$(KILTED)/bin/python -m pip install --quiet --editable '.[dev]' 'ros-kilted-rclpy[fastrtps]' ros-kilted-common-interfaces
	$(KILTED)/bin/python -m pytest -q -m "ros and not slow"

clean:  ## remove the environment and all output
	rm -rf .venv out build ros_ws/build ros_ws/install ros_ws/log
