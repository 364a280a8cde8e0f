# Heliarch's tasks. `make help` lists them.
# Each one sets up what it needs: a virtual environment in .venv with the versions of
# constraints.txt. Nothing else on the machine is touched.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PEERS := .venv-peers
PEERS_READY := $(PEERS)/.ready

.DEFAULT_GOAL := help
.PHONY: help setup run test docs dist sbom results terms figures pictures golden check check-scripts format bench bench-before bench-peers bench-study campaign soak clean

help: ## list the tasks
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(READY) ## make the virtual environment

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed, $(PYTHON) is " + sys.version.split()[0])'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

run: $(READY) ## the main job: one simulated hour of broken clouds over 17 inverters, as 23 processes; open the page that it prints to watch it
	$(BIN)/heliarch launch oahu --page --report

test: $(READY) ## all tests; three workers, because many tests wait for processes
	$(BIN)/pytest -n 3 --dist worksteal

docs: $(READY) ## the documents as a site in build/site; read them with `python -m http.server -d build/site`
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

dist: $(READY) ## wheel and sdist in dist/, and a run with page and report from that wheel in an empty environment, build/empty
	rm -rf dist build/lib build/bdist.* build/empty *.egg-info
	$(BIN)/python -c 'from setuptools import build_meta; build_meta.build_sdist("dist"); build_meta.build_wheel("dist")' >/dev/null
	$(PYTHON) -m venv build/empty
	build/empty/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt "$$(ls dist/*.whl)[report]"
	cd build/empty && bin/heliarch init $(CURDIR)/examples/own_plant/positions.csv $(CURDIR)/examples/own_plant/ghi.csv --out own.toml
	cd build/empty && bin/heliarch launch oahu --duration 10 --report --page

sbom: $(READY) ## all dependencies with versions and licences: build/sbom.json and docs/licences.md
	PYTHONPATH=$(CURDIR) $(BIN)/python docs/dependencies.py

golden: $(READY) ## record the golden runs again with their own sky and clusters; one that was removed is simulated anew
	$(call golden,oahu-fraction,oahu --actuator fraction --duration 24s)
	$(call golden,oahu-limit,oahu --duration 20s)
	$(call golden,oahu-day-paper,oahu-day --scheme paper --from 12:13:08 --duration 16s)
	$(call golden,valley-periods,recordings/golden/valley-periods.toml --duration 8s)

define golden
	@rm -rf build/golden
	test -d recordings/golden/$(1) || $(BIN)/heliarch simulate $(2) --out build/golden
	@if test -d build/golden; then mkdir recordings/golden/$(1) && mv build/golden/run.mcap build/golden/profile.npz recordings/golden/$(1); fi
	$(BIN)/python tests/record_golden.py recordings/golden/$(1)
endef

check: $(READY) ## format, lint, types, directions of imports
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -q tests/test_house.py
	@if command -v npm >/dev/null; then $(MAKE) --no-print-directory check-scripts; \
	else echo "npm is absent: the types of the page's scripts were not checked"; fi

check-scripts: ## types of the page's scripts; npm fetches TypeScript
	npm exec --yes --package=typescript@5.9.3 -- tsc --project live_page/jsconfig.json

format: $(READY) ## bring the code into its format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(READY) ## cycle rate beside a bare Zenoh graph, start-up time, memory
	$(BIN)/python benchmarks/cycle_rate.py

bench-before: $(READY) ## large and small plants beside other checkouts: make bench-before BEFORE=/tmp/before
	$(BIN)/python benchmarks/before_after.py $(BEFORE)

bench-peers: $(PEERS_READY) ## cycle rate beside mosaik, in a virtual environment of its own
	$(PEERS)/bin/python benchmarks/peers.py

$(PEERS_READY): pyproject.toml constraints.txt benchmarks/requirements-peers.txt
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --requirement benchmarks/requirements-peers.txt --editable .
	@touch $@

results: $(READY) ## every measured table of the documents; DATA=FOLDER for those of measurements, PAGES=delays.md for one page
	PYTHONPATH=$(CURDIR) $(BIN)/python docs/measured.py $(abspath $(DATA)) $(PAGES)

terms: $(READY) ## what each term of the control law gains; DATA=FOLDER holds the measurements
	PYTHONPATH=$(CURDIR) $(BIN)/python docs/terms.py $(abspath $(DATA))

figures: $(READY) $(PEERS_READY) ## every figure of the documents that depends on the machine: half an hour on a quiet one
	PYTHONPATH=$(CURDIR) $(BIN)/python docs/machine.py

pictures: $(READY) ## the pictures of README that are drawn from runs
	PYTHONPATH=$(CURDIR) $(BIN)/python docs/pictures.py

bench-study: $(READY) ## a whole day through the agents and over arrays
	$(BIN)/python benchmarks/study_rate.py

campaign: $(READY) ## random faults on ten small plants, judged cycle by cycle: SEEDS=1..1000; two minutes of processor time for 100
	PYTHONPATH=$(CURDIR):$(CURDIR)/tests $(BIN)/python tests/campaign/campaign.py $(or $(SEEDS),1..100)

soak: $(READY) ## long runs: a random kill or cut every 5 s for SOAK_S (1800) s; two days (DAYS_CYCLES) of 10 s cycles in files of an hour; the recorder killed 20 times; planted bugs; other random examples
	$(BIN)/pytest -m soak
	$(BIN)/pytest --hypothesis-profile others tests/agents tests/bus_schemas tests/recordings tests/studies

clean: ## remove what the tasks made, recordings of runs excepted
	rm -rf $(VENV) $(PEERS) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
