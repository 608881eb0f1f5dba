# Every target installs the packages that it needs into .venv. It needs Python 3.11 or newer, but no compiler.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Python compiles the modules that it imports. pip would compile all modules, five times as many.
INSTALL := python -m pip install --disable-pip-version-check --no-compile
WITH ?= test lint docs
PYTHON312 ?= python3.12
NEWER := build/vapoursynth
DEMO := build/demo
CURVE := build/curve
DOCS := build/docs
NOTEBOOKS := build/notebooks
WEB := build/web
RELEASE := build/release
KERNELS := $(CURDIR)/build/kernels
OCLGRIND ?= /usr/lib/oclgrind/liboclgrind-rt-icd.so
# Source files on which the targets demo, web and curve depend
CODE := $(shell find l3cli opencl -name '*.py' -o -name '*.cl')
JOBS ?= 2
INPUTS ?= 20000
PORT ?= 8000
L3 := $(BIN)/l3
TIMED := bash -c 'time "$$0" "$$@"'
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install demo demo-steps snakemake docs docs-build gallery peers notebooks web wheels test vapoursynth study soak video fuzz kernels curve lint format bench clean
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SECONDARY:

help: ## show this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 16

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# If the runtime or an extra that a target needs is missing or older than pyproject.toml, a single call of pip installs all of them.
install: $(BIN)/python ## make a .venv with l3, PoCL and the development tools (WITH="test lint docs" selects extras of pyproject.toml)
	@for each in runtime $(WITH); do [ $(VENV)/$$each -nt pyproject.toml ] || missing=1; done; [ -z "$$missing" ] || \
	{ set -x; $(BIN)/$(INSTALL) -e ".$(if $(WITH),[$(subst $() ,$(comma),$(strip $(WITH)))])" && \
	  touch $(addprefix $(VENV)/,runtime $(WITH)); }

comma := ,
needs = @$(MAKE) --no-print-directory install WITH="$(1)"

demo: ## run the pipeline for a five-band camera, from virtual lab to rendered picture; later calls repeat only what changed
	$(call needs,)
	$(MAKE) --no-print-directory demo-steps

demo-steps: $(DEMO)/rendered.png $(DEMO)/report.html
	$(TIMED) $(L3) evaluate $(DEMO)/table.h5 $(DEMO)/unseen.h5
	@ls "$$PWD"/$(DEMO)/report.html "$$PWD"/$(DEMO)/rendered.png "$$PWD"/$(DEMO)/unseen/*_ideal.png

$(DEMO)/lab/MEASUREMENTS.toml: configs/cameras/fiveband.toml $(CODE)
	mkdir -p $(DEMO)
	$(TIMED) $(L3) lab $< -o $(@D) --force --jobs $(JOBS)

$(DEMO)/camera.h5: $(DEMO)/lab/MEASUREMENTS.toml
	$(TIMED) $(L3) calibrate $< --truth configs/cameras/fiveband.toml -o $@ --force

$(DEMO)/training.h5: configs/scenes/default.toml $(DEMO)/camera.h5
	$(TIMED) $(L3) simulate $< --camera $(DEMO)/camera.h5 -o $@ --force --jobs $(JOBS)

$(DEMO)/table.h5: $(DEMO)/training.h5 configs/classes/default.toml
	$(TIMED) $(L3) train $< --classes configs/classes/default.toml -o $@ --force --jobs $(JOBS)

$(DEMO)/unseen.h5: configs/scenes/demo_unseen.toml configs/cameras/fiveband.toml $(CODE)
	mkdir -p $(DEMO)
	$(TIMED) $(L3) simulate $< --camera configs/cameras/fiveband.toml -o $@ --pictures $(DEMO)/unseen --force

$(DEMO)/rendered.png: $(DEMO)/table.h5 $(DEMO)/unseen.h5
	$(TIMED) $(L3) render $< $(DEMO)/unseen/*_raw.tif -o $@ --force

$(DEMO)/report.html: $(DEMO)/camera.h5 $(DEMO)/training.h5 $(DEMO)/table.h5 $(DEMO)/unseen.h5
	$(TIMED) $(L3) report $^ -o $@ --force

# The number of processes exceeds the number of cores by two, because many tests wait for processes that they start. The test files run in
# a fixed order with small files last, so that no long file starts late. Rewriting the assertions takes a third of the time in which
# each process collects the tests, so only the tests that fail run again with the values in their assertions explained.
test: ## run the test suite
	$(call needs,test)
	$(BIN)/python -m pytest -n $$(( $(JOBS) + 2 )) --dist loadfile --no-loadscope-reorder --assert=plain || \
	  { $(BIN)/python -m pytest --last-failed --last-failed-no-failures none; exit 1; }

snakemake: ## test the Snakefile that l3 init writes (one minute)
	$(call needs,test snakemake)
	$(BIN)/python -m pytest tests/commands/test_pipelines.py -k snakemake

docs: docs-build ## build the site from docs/ and serve it on http://127.0.0.1:8000 until Ctrl-C (PORT=… changes the port)
	$(BIN)/python -m http.server --directory "$(DOCS)/html" --bind 127.0.0.1 $(PORT)

docs-build: notebooks $(if $(shell command -v wasm-ld),web) ## build the site without serving it (DOCS=folder); fails if there is a warning or a broken link
	$(BIN)/python docs/site/build.py "$(DOCS)"

gallery: ## make docs/gallery.md and its pictures (eight minutes on two idle cores); ARRAYS="bayer xtrans" selects arrays
	$(call needs,)
	PYTHONPATH="$$PWD" $(BIN)/python docs/gallery/gallery.py $(ARRAYS) --jobs $(JOBS)

peers: ## make docs/peers.md, which compares l3 with other methods on the pictures in L3_DATA (an hour on two cores); PARTS="bayer noise" selects parts, "noise --seconds" measures only times, "noise --ours" repeats only l3
	$(call needs,peers)
	PYTHONPATH="$$PWD" $(BIN)/python docs/peers/peers.py $(PARTS) --jobs $(JOBS)

notebooks: ## run the notebooks in docs/notebooks, and write pages with their code and outputs (half a minute)
	$(call needs,test docs)
	rm -rf $(NOTEBOOKS)
	$(BIN)/python -m pytest tests/unit/test_notebooks.py
	$(BIN)/python docs/site/execute_notebooks.py $(NOTEBOOKS)

# The demo on the site consists of a page with the table of a Bayer camera, and a frame of this camera.
web: ## make build/web/demo.html, which renders raw files in the browser (a minute; needs clang and wasm-ld, Debian packages clang and lld)
	$(call needs,)
	$(MAKE) --no-print-directory $(WEB)/demo.html

$(WEB)/demo.html: configs/cameras/bayer.toml configs/scenes/default.toml configs/classes/fast.toml $(CODE) $(wildcard l3cli/export/c/*)
	mkdir -p $(WEB)
	$(L3) simulate default --camera bayer -o $(WEB)/training.h5 --force --jobs $(JOBS)
	$(L3) train $(WEB)/training.h5 --classes fast -o $(WEB)/table.h5 --force --jobs $(JOBS)
	$(L3) simulate demo_unseen --camera bayer -o $(WEB)/unseen.h5 --dng $(WEB)/dng --force
	cp $(WEB)/dng/00000*.dng $(WEB)/demo.dng
	$(L3) export $(WEB)/table.h5 -o $(WEB)/source --force
	$(MAKE) -C $(WEB)/source page
	cp $(WEB)/source/l3_page.html $@

wheels: ## build and check the source distribution and the wheel in dist/, and test the wheel in an empty environment
	$(PYTHON) -m venv --clear $(RELEASE)
	$(RELEASE)/bin/$(INSTALL) --quiet build twine
	rm -rf dist && $(RELEASE)/bin/python -m build --outdir dist .
	$(RELEASE)/bin/python -m twine check --strict dist/*
	$(PYTHON) -m venv --clear $(RELEASE)
	$(RELEASE)/bin/$(INSTALL) --quiet dist/*.whl
	cd $(RELEASE) && bin/python -I -m l3cli info --version && bin/python -I -m l3cli init bayer camera && \
	  ! bin/python -I -c "import tests" 2>/dev/null

# VapourSynth has wheels only for Python 3.12 and newer.
$(NEWER)/installed: pyproject.toml
	$(PYTHON312) -m venv $(NEWER)
	$(NEWER)/bin/$(INSTALL) --quiet -e ".[vapoursynth,video]" vapoursynth-bestsource pytest hypothesis
	touch $@

vapoursynth: $(NEWER)/installed ## test the VapourSynth filter with Python 3.12 or newer (PYTHON312=python3.12)
	$(NEWER)/bin/python -m pytest tests/commands/test_vapoursynth.py

study: ## measure calibrations with 21 seeds, quality, and time and memory of large inputs (ten minutes)
	$(call needs,test)
	$(BIN)/python -m pytest -m slow -s --ignore tests/studies/test_video_rate.py

soak: ## kill every stage forty times, fill disks, test endurance, and run all cases of tests of which `make test` runs only one case (half an hour)
	$(call needs,test)
	$(BIN)/python -m pytest -m soak -s

video: ## measure the frame rate and memory for a video of 1800 raw frames, compared with the encoder alone (six minutes)
	$(call needs,test)
	$(BIN)/python -m pytest -m slow -s tests/studies/test_video_rate.py

fuzz: ## test 20 000 corrupted inputs (ten minutes); failing inputs are kept in build/fuzz
	$(call needs,test snakemake)
	PYTHONPATH="$$PWD" nice $(BIN)/python -m tests.helpers.fuzz --inputs $(INPUTS) --jobs $(JOBS)

# Oclgrind 21.10 supports neither prefetching nor the intrinsics that inlining creates, so the kernels are compiled without prefetching
# and without inlining.
kernels: ## check the kernels for out-of-bounds accesses and data races in Oclgrind, and test them on Intel's OpenCL (a quarter of an hour)
	$(call needs,test)
	@test -e $(OCLGRIND) || { echo "Oclgrind is missing; install it with apt-get install oclgrind, or set OCLGRIND to the path of liboclgrind-rt-icd.so" >&2; exit 1; }
	rm -rf $(KERNELS) && mkdir -p $(KERNELS)/oclgrind $(KERNELS)/intel
	echo $(OCLGRIND) > $(KERNELS)/oclgrind/oclgrind.icd
	OCL_ICD_VENDORS=$(KERNELS)/oclgrind L3_DEVICE=Oclgrind OCLGRIND_DATA_RACES=1 OCLGRIND_LOG=$(KERNELS)/oclgrind.log \
	  OCLGRIND_BUILD_OPTIONS="-cl-opt-disable -Dalways_inline=unused -Drestrict= -D__builtin_prefetch(p)=(void)0" \
	  $(BIN)/python -m pytest -m slow tests/studies/test_kernels.py
	$(PYTHON) -m venv $(KERNELS)/packages
	$(KERNELS)/packages/bin/$(INSTALL) --quiet intel-opencl-rt intel-cmplr-lib-rt
	echo $(KERNELS)/packages/lib/libintelocl.so > $(KERNELS)/intel/intel.icd
	OCL_ICD_VENDORS=$(KERNELS)/intel $(BIN)/l3 info --version | grep "0: .*Intel(R) OpenCL"
	OCL_ICD_VENDORS=$(KERNELS)/intel L3_DEVICE=0 $(BIN)/python -m pytest tests/unit/test_render.py tests/unit/test_encoder.py \
	  tests/unit/test_smoothing.py tests/unit/test_temporal.py tests/science/test_corrections.py tests/science/test_trees.py

curve: ## compare a Bayer and an RGBW camera as a function of luminance (ten minutes)
	$(call needs,)
	$(MAKE) --no-print-directory $(CURVE)/curve.html

$(CURVE)/%.training.h5: configs/scenes/default.toml configs/cameras/%.toml $(CODE)
	mkdir -p $(@D) && $(L3) simulate $< --camera configs/cameras/$*.toml -o $@ --force --jobs $(JOBS)

$(CURVE)/%.unseen.h5: configs/scenes/curve.toml configs/cameras/%.toml $(CODE)
	mkdir -p $(@D) && $(L3) simulate $< --camera configs/cameras/$*.toml -o $@ --force --jobs $(JOBS)

$(CURVE)/%.table.h5: $(CURVE)/%.training.h5
	$(L3) train $< -o $@ --force --jobs $(JOBS)

$(CURVE)/%.json: $(CURVE)/%.table.h5 $(CURVE)/%.unseen.h5
	$(L3) evaluate $^ --json > $@

$(CURVE)/curve.html: $(CURVE)/bayer.json $(CURVE)/rgbw.json
	$(L3) compare $^ --figure mean_delta_e --figure scielab --figure psnr -o $@ --force

lint: ## run ruff format --check, ruff check and mypy
	$(call needs,test lint)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy docs/site
	$(BIN)/mypy docs/gallery
	$(BIN)/mypy docs/peers

format: ## format the sources, and fix the findings that ruff can fix
	$(call needs,lint)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: ## measure the time per frame of each stage, compared with multiply-adds alone and with Menon's method, and the time of simulations
	$(call needs,test)
	$(L3) bench
	$(BIN)/python -m pytest -m slow -s tests/studies/test_speed_study.py

clean: ## remove all files that other targets created
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +
