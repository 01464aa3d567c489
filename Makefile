# make demo     process the sample recordings into out/
# make gate     measure the outputs of the demo, and compare them with golden results
# make quick    lint, types and the tests of what changed, without Ray, PyTorch and a simulated S3: for each commit
# make test     lint, types, all tests but the slow ones, which start programs of others or take many seconds
# make check    lint and types only
# make coverage all tests, slow ones too, and the share of the lines that they run: before a release, and every night
# make fuzz     hostile inputs for every decoder, MINUTES=15 of them (Linux)
# make campaign signals, kills, damaged and hostile inputs: MINUTES=30 of them (Linux)
# make sanitize what the native module does, under the sanitizers of GCC for addresses and undefined behaviour
# make golden   write the golden results anew, after a change that is meant
# make samples  record the sample recordings in bags/ anew
# make bench    docs/performance.md anew: speed beside other programs, and memory
# make numbers  docs/numbers.md and docs/research/numbers.md anew: how good the results are on simulated recordings
# make site     the documentation as a site, into out/site
# Each installs what it needs into .venv the first time, and only then: the demo lidcam alone, the others all extras and the tools of tests, too.
# make locks docs/licences.md    after a change of dependencies: constraints*.txt anew (UPGRADE=--upgrade takes newer versions), the page of licences

PYTHON ?= python3
BIN := .venv/bin
PACKAGES := .venv/packages
INSTALLED := .venv/installed
INSTALLED_QUICK := .venv/installed-quick
INSTALLED_ALL := .venv/installed-all
PIP = $(BIN)/python -m pip --disable-pip-version-check
UV = $(BIN)/uv
# Everything by its hash, and nothing that is not listed; with uv, which takes a quarter of pip's time.
LOCKED = $(UV) pip install --python $(BIN)/python --require-hashes --no-deps --requirement
WITHOUT_CLOUDS = --set output.images=false --set output.clouds=false --set output.layout=false --set 'output.copy_topics=[]' --set output.compression=zstd
UPGRADE ?=
COMPILE = UV_CUSTOM_COMPILE_COMMAND='make locks' $(UV) pip compile --quiet --universal --python-version 3.11 --no-build --generate-hashes --no-annotate $(UPGRADE)

# Where this is set, as in some containers, each of the hundreds of programs that the tests start compiles all sources anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo gate golden quick test check pytest coverage fuzz campaign sanitize samples bench numbers site locks
.DELETE_ON_ERROR:

$(PACKAGES): constraints-run.txt constraints-uv.txt
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "lidcam needs Python 3.11 or newer, found " + sys.version.split()[0] + ": set PYTHON=python3.12 or the like")'
	$(PYTHON) -m venv .venv
	@echo 'Installing lidcam into .venv: 390 MB to fetch, once'
	$(PIP) install --require-hashes --no-deps --requirement constraints-uv.txt
	$(LOCKED) constraints-run.txt
	@touch $@

# lidcam itself: a change of its C++ builds it anew. Without a C++ compiler on the machine, one comes as a wheel.
$(INSTALLED): $(PACKAGES) pyproject.toml hatch_build.py $(wildcard pipeline/native/*.cpp pipeline/native/*.h)
	@test -n "$$CXX" || command -v c++ g++ clang++ > /dev/null || $(LOCKED) constraints-compiler.txt
	$(PIP) install --no-build-isolation --no-deps --editable .
	@touch $@

# PyTorch comes last and without a hash: its version is pinned, but it has builds for CPUs on indexes of their own, and what an index may offer
# here is not known. The CUDA libraries of PyPI's build come with it.
$(INSTALLED_ALL): pyproject.toml constraints.txt | $(INSTALLED)
	@echo 'Installing the extras and the tools of the tests into .venv: 930 MB to fetch, once'
	$(LOCKED) constraints.txt
	$(PIP) install --no-compile 'lidcam[sim,train,foxglove,video,notebook,http,s3,ray,test,dev]'
	$(PIP) check
	@touch $@

$(INSTALLED_QUICK): constraints-quick.txt | $(INSTALLED)
	@test -f $(INSTALLED_ALL) || $(LOCKED) constraints-quick.txt
	@touch $@

demo: $(INSTALLED)
	$(BIN)/lidcam demo out
	$(BIN)/lidcam-process bags/crossing.mcap out/crossing.mcap --config config/crossing.yaml --rerun out/crossing.rrd
	@echo
	@echo 'The second recording: $(BIN)/rerun out/crossing.rrd, or out/crossing.mcap in Foxglove or Lichtblick'

gate: $(INSTALLED)
	@test -f out/sandbox.mcap -a -f out/crossing.mcap || $(MAKE) demo
	@for sample in sandbox crossing; do \
		$(BIN)/lidcam evaluate out/$$sample.mcap --require @tests/golden/$$sample.txt --json-file out/$$sample.figures.json && \
		$(BIN)/lidcam compare tests/golden/$$sample.mcap out/$$sample.mcap --max-different 2 || exit 1; \
	done

golden: $(INSTALLED)
	$(BIN)/lidcam process bags/sandbox.bag tests/golden/sandbox.mcap --config sandbox $(WITHOUT_CLOUDS)
	$(BIN)/lidcam process bags/crossing.mcap tests/golden/crossing.mcap --config crossing $(WITHOUT_CLOUDS)

check: $(INSTALLED_ALL)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy lidcam tests benchmarks

# Without the packages that are left out, what derives from them has no type.
LOOSE = --cache-dir .mypy_cache/quick --ignore-missing-imports --allow-subclassing-any --allow-untyped-decorators --no-warn-unused-ignores --no-warn-return-any
QUICK = $(filter-out tests/lidcam/training tests/lidcam/batches/test_ray.py tests/e2e/test_object_store.py,$(shell $(BIN)/python tests/support/changed_tests.py))
quick: $(INSTALLED_QUICK)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(LOOSE) lidcam tests benchmarks
	$(BIN)/pytest -q -n auto $(QUICK)

# Types are checked on one core beside the first tests.
test: $(INSTALLED_ALL)
	@$(MAKE) --no-print-directory --jobs=2 check pytest

# The files in their order, in which slow ones stand first: that of xdist puts a file of one test last, however long that takes.
PARALLEL = -n auto --dist loadfile --no-loadscope-reorder
pytest: $(INSTALLED_ALL)
	$(BIN)/pytest $(PARALLEL)

# Half as long again: what is traced takes almost twice the time.
coverage: $(INSTALLED_ALL)
	$(BIN)/pytest $(PARALLEL) -m "" --cov --cov-report=term:skip-covered

fuzz: $(INSTALLED_ALL)
	$(BIN)/python tests/fuzz/fuzz.py $(MINUTES:%=--minutes=%)

# Each gets an equal share of the minutes.
CAMPAIGNS = containers long_run signals
campaign: $(INSTALLED_ALL)
	@failed=0; for name in $(CAMPAIGNS); do \
		$(BIN)/python tests/campaign/$$name.py --minutes=$$(awk 'BEGIN {print $(or $(MINUTES),30) / $(words $(CAMPAIGNS))}') || failed=1; \
	done; exit $$failed

samples: $(INSTALLED_ALL)
	$(BIN)/lidcam simulate sandbox bags/sandbox.bag --overwrite --duration 2 --set 'lidars.*.firing_stride=4' --set 'cameras.*.jpeg_quality=40'
	$(BIN)/lidcam simulate crossing bags/crossing.mcap --duration 1.4 --set 'cameras.*.rate_hz=5' --set 'cameras.*.jpeg_quality=45'

bench: $(INSTALLED_ALL)
	$(BIN)/python benchmarks/measured/speed_page.py
	$(BIN)/python benchmarks/measured/memory_table.py

numbers: $(INSTALLED_ALL)
	$(BIN)/python benchmarks/measured/numbers_page.py

sanitize: $(INSTALLED_ALL)
	@rm $(INSTALLED)
	CFLAGS='-fsanitize=address,undefined -O1' LDFLAGS='-fsanitize=address,undefined' $(PIP) install --no-build-isolation --no-deps --editable .
	LD_PRELOAD="$$(g++ -print-file-name=libasan.so) $$(g++ -print-file-name=libubsan.so)" UBSAN_OPTIONS=halt_on_error=1 \
		ASAN_OPTIONS=detect_leaks=0:allocator_may_return_null=1 $(BIN)/pytest -q -s $(addprefix tests/pipeline/,core detectors filters fusion)
	$(MAKE) $(INSTALLED)

site: $(INSTALLED_ALL)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --site-dir out/site

config/default.yaml: $(wildcard pipeline/core/settings/*.py) $(INSTALLED_ALL)
	@printf '# The defaults of every setting: a printed copy of pipeline/core/settings/, which explains each one.\n# Copy the part that you want to change into a file of your own and pass it with --config.\n\n' > $@
	@$(BIN)/python -c 'from lidcam.pipeline.core.settings.config import Config; from lidcam.pipeline.core.settings.load import dump_config; print(dump_config(Config()), end="")' >> $@

locks: $(PACKAGES)
	$(COMPILE) --extra sim --extra foxglove --extra video --extra notebook --extra http --extra s3 --extra ray --extra test --extra dev --output-file constraints.txt pyproject.toml constraints.in
	$(COMPILE) --constraint constraints.txt --output-file constraints-run.txt pyproject.toml constraints-build.in
	echo ziglang | $(COMPILE) --output-file constraints-compiler.txt -
	echo uv | $(COMPILE) --output-file constraints-uv.txt -
	$(COMPILE) --constraint constraints.txt --extra test --output-file constraints-quick.txt pyproject.toml constraints-build.in

docs/licences.md: $(INSTALLED_ALL)
	$(BIN)/python tests/support/licences.py > $@
