# One environment, made once, in .venv. `make demo` and `make test` are all that a newcomer needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test test-long lint types unit mutants build clean

$(STAMP): setup.py constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt torch==2.13.0
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[ros,test]' \
		--config-settings editable_mode=compat
	touch $@

demo: $(STAMP)
	$(BIN)/python -m raw2drive_ros.cli.main demo

test: lint types unit

lint: $(STAMP)
	$(BIN)/python -m ruff check .

types: $(STAMP)
	$(BIN)/python -m mypy

# Two at a time, then those with a ROS graph one by one. Lines that no test runs are counted, also those of nodes in
# processes of their own.
unit: $(STAMP)
	rm -rf .coverage
	mkdir .coverage
	$(BIN)/python -m coverage run -m pytest -q -n 2 --dist loadfile -m 'not long and not graph' test
	$(BIN)/python -m coverage run -m pytest -q -m 'graph and not long' test
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report

# What takes minutes: kills at random moments and the like.
test-long: $(STAMP)
	$(BIN)/python -m pytest -q -m long test

# Every change of the safety gate's logic that no test notices.
mutants: $(STAMP)
	rm -rf mutants
	$(BIN)/python -m mutmut run
	$(BIN)/python -m mutmut results

build: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt colcon-common-extensions
	$(BIN)/python -m colcon build --packages-select raw2drive_ros

clean:
	rm -rf $(VENV) build install log runs mutants .coverage
