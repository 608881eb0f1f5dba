# l3cli: every target installs what it needs, and no more, into .venv (Python ≥ 3.11; no compiler).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Python compiles what it imports, a fifth of what pip would.
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
# What demo and curve are made by; a change of it makes them again.
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

help: ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 16

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# One call of pip for the runtime and the extras that a target needs, if one of them is not there as pyproject.toml says.
install: $(BIN)/python ## a .venv with l3, PoCL and the development tools (WITH="test lint docs", extras of pyproject.toml)
	@for each in runtime $(WITH); do [ $(VENV)/$$each -nt pyproject.toml ] || missing=1; done; [ -z "$$missing" ] || \
	{ set -x; $(BIN)/$(INSTALL) -e ".$(if $(WITH),[$(subst $() ,$(comma),$(strip $(WITH)))])" && \
	  touch $(addprefix $(VENV)/,runtime $(WITH)); }

comma := ,
needs = @$(MAKE) --no-print-directory install WITH="$(1)"

demo: ## a five-band camera from virtual lab to rendered picture; again, only what a change of recipes or code reaches
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

# One process more than there are cores: many tests wait for processes that they start. Files go in their order, small ones
# last: none is begun late that takes long.
test: ## the test suite
	$(call needs,test)
	$(BIN)/python -m pytest -n $$(( $(JOBS) + 1 )) --dist loadfile --no-loadscope-reorder

snakemake: ## the tests of the Snakefile that l3 init lays beside recipes (one minute)
	$(call needs,test snakemake)
	$(BIN)/python -m pytest tests/commands/test_pipelines.py -k snakemake

docs: docs-build ## the pages of docs/ as a site, on http://127.0.0.1:8000 until Ctrl-C (PORT=…)
	$(BIN)/python -m http.server --directory "$(DOCS)/html" --bind 127.0.0.1 $(PORT)

docs-build: notebooks $(if $(shell command -v wasm-ld),web) ## the same without serving (DOCS=folder); fails on any warning and any link that leads nowhere
	$(BIN)/python docs/site/build.py "$(DOCS)"

gallery: ## docs/gallery.md and its pictures, two arrays at a time (eight minutes of two quiet cores); ARRAYS="bayer xtrans" for some
	$(call needs,)
	PYTHONPATH="$$PWD" $(BIN)/python docs/gallery/gallery.py $(ARRAYS) --jobs $(JOBS)

peers: ## docs/peers.md: ours beside other methods, from the pictures of L3_DATA (an hour on two cores); PARTS="bayer noise" for some, PARTS="noise --seconds" for times alone, PARTS="noise --ours" for ours beside rivals as they were
	$(call needs,peers)
	PYTHONPATH="$$PWD" $(BIN)/python docs/peers/peers.py $(PARTS) --jobs $(JOBS)

notebooks: ## the notebooks of docs/ are run, and written as pages of code and outputs (half a minute)
	$(call needs,test docs)
	rm -rf $(NOTEBOOKS)
	$(BIN)/python -m pytest tests/unit/test_notebooks.py
	$(BIN)/python docs/site/execute_notebooks.py $(NOTEBOOKS)

# The demo of the site: a table for a Bayer camera, as a page, and a frame of that camera.
web: ## build/web/demo.html renders raw files in the browser (a minute; needs clang and wasm-ld, Debian's clang and lld)
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

wheels: ## dist/: source distribution, the wheel built from it, both checked, and the wheel tried alone
	$(PYTHON) -m venv --clear $(RELEASE)
	$(RELEASE)/bin/$(INSTALL) --quiet build twine
	rm -rf dist && $(RELEASE)/bin/python -m build --outdir dist .
	$(RELEASE)/bin/python -m twine check --strict dist/*
	$(PYTHON) -m venv --clear $(RELEASE)
	$(RELEASE)/bin/$(INSTALL) --quiet dist/*.whl
	cd $(RELEASE) && bin/python -I -m l3cli info --version && bin/python -I -m l3cli init bayer camera && \
	  ! bin/python -I -c "import tests" 2>/dev/null

# VapourSynth has wheels for Python ≥ 3.12 alone.
$(NEWER)/installed: pyproject.toml
	$(PYTHON312) -m venv $(NEWER)
	$(NEWER)/bin/$(INSTALL) --quiet -e ".[vapoursynth,video]" vapoursynth-bestsource pytest hypothesis
	touch $@

vapoursynth: $(NEWER)/installed ## the tests of the VapourSynth filter, under PYTHON312=python3.12 or newer
	$(NEWER)/bin/python -m pytest tests/commands/test_vapoursynth.py

study: ## calibration over 21 seeds, quality, time and memory of large inputs (ten minutes)
	$(call needs,test)
	$(BIN)/python -m pytest -m slow -s --ignore tests/studies/test_video_rate.py

soak: ## every stage killed forty times, full disks, endurance, sweeps of which `make test` has one of each kind (half an hour)
	$(call needs,test)
	$(BIN)/python -m pytest -m soak -s

video: ## rate and memory of 1800 raw frames to video, beside the encoder alone (six minutes)
	$(call needs,test)
	$(BIN)/python -m pytest -m slow -s tests/studies/test_video_rate.py

fuzz: ## 20 000 corrupted inputs (ten minutes); failures are kept in build/fuzz
	$(call needs,test snakemake)
	PYTHONPATH="$$PWD" nice $(BIN)/python -m tests.helpers.fuzz --inputs $(INPUTS) --jobs $(JOBS)

# Oclgrind 21.10 knows no intrinsic of prefetching, and none that inlining leaves: kernels are compiled as they are written.
kernels: ## kernels under Oclgrind, for accesses out of bounds and races, and on Intel's OpenCL (a quarter of an hour)
	$(call needs,test)
	@test -e $(OCLGRIND) || { echo "Oclgrind is missing: apt-get install oclgrind, or name its liboclgrind-rt-icd.so by OCLGRIND=" >&2; exit 1; }
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

curve: ## Bayer and RGBW over luminance: which is better where (ten minutes)
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

lint: ## ruff format and check, mypy
	$(call needs,test lint)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy docs/site
	$(BIN)/mypy docs/gallery
	$(BIN)/mypy docs/peers

format: ## format the sources, fix what ruff can
	$(call needs,lint)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: ## frame times by stage; beside the bare multiply-adds, Menon; simulation
	$(call needs,test)
	$(L3) bench
	$(BIN)/python -m pytest -m slow -s tests/studies/test_speed_study.py

clean: ## remove what the other targets made
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +
