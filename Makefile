# make demo    process the sample recording into out/
# make test    lint, types, tests
# make check   lint and types only
# make fuzz    hostile inputs for every decoder, MINUTES=15 of them (Linux)
# make samples record the sample recordings in bags/ anew
# make bench   what is measured against what
# Each installs what it needs into .venv the first time, and only then.

PYTHON ?= python3
BIN := .venv/bin
MINUTES ?= 15
INSTALLED := .venv/installed

.PHONY: demo test check fuzz samples bench
.DELETE_ON_ERROR:

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "lidcam needs Python 3.11 or newer, found " + sys.version.split()[0] + ": set PYTHON=python3.12 or the like")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[sim,torch,dev]'
	@touch $@

demo: $(INSTALLED)
	@mkdir -p out
	$(BIN)/lidcam-process bags/sandbox.bag out/sandbox.mcap --config config/sandbox.yaml --rerun out/sandbox.rrd
	$(BIN)/lidcam-process bags/crossing.mcap out/crossing.mcap --config config/crossing.yaml --rerun out/crossing.rrd
	@echo
	@echo 'Look at it:'
	@echo '  out/sandbox.rrd, out/crossing.rrd     $(BIN)/rerun out/sandbox.rrd'
	@echo '  out/sandbox.mcap, out/crossing.mcap   Foxglove or Lichtblick: "Open local file", layouts: out/*.foxglove.json'

check: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy lidcam pipeline readers writers bags tests benchmarks

test: check
	$(BIN)/pytest -n auto --dist loadfile --cov --cov-report=term:skip-covered

fuzz: $(INSTALLED)
	$(BIN)/python tests/fuzz/fuzz.py --minutes $(MINUTES)

samples: $(INSTALLED)
	$(BIN)/lidcam simulate sandbox bags/sandbox.bag --duration 2 --set 'lidars.*.firing_stride=4' --set 'cameras.*.jpeg_quality=40'
	$(BIN)/lidcam simulate crossing bags/crossing.mcap --duration 1.4 --set 'cameras.*.rate_hz=5' --set 'cameras.*.jpeg_quality=45'

bench: $(INSTALLED)
	$(BIN)/python benchmarks/end_to_end.py
	$(BIN)/python benchmarks/filters.py
	$(BIN)/python benchmarks/velodyne.py
	$(BIN)/python benchmarks/simulator.py

config/default.yaml: $(wildcard pipeline/core/settings/*.py) $(INSTALLED)
	@printf '# The defaults of every setting: a printed copy of pipeline/core/settings/, which explains each one.\n# Copy the part that you want to change into a file of your own and pass it with --config.\n\n' > $@
	@$(BIN)/python -c 'from pipeline.core.settings.config import Config; from pipeline.core.settings.load import dump_config; print(dump_config(Config()), end="")' >> $@
