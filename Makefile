# `make demo` and `make test` do all the set-up on a machine that has only Python and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# torch comes first and alone: with the version of constraints.txt there, nothing later replaces it.
TORCH := $(shell sed -n 's/^torch==/torch==/p' constraints.txt)

CPP := src/neural_renderer/raster/kernels/*.h src/neural_renderer/raster/kernels/cpu/*.h tests/native/*.h tests/native/*.cpp

.PHONY: demo test test-short test-all test-cuda test-cuda-emulated test-native fuzz lint format benchmark coverage package docs docs-quick clean

demo: $(VENV)/package
	$(BIN)/neural-renderer demo --output out

# In two processes, each of which uses all cores for what it draws. Tests start many programs, which begin sooner with
# the byte code of the first one. `make test-native` has the C++ tests, `make test-cuda-emulated` the CUDA compiler's.
COMPILATION := tests/raster/warp/test_cuda_compilation.py
test: $(VENV)/installed
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest --numprocesses 2 --dist worksteal --ignore tests/native --ignore $(COMPILATION)

# A minute of tests from every room, for a Python or a system that the others do not run on; `make package` runs them, too.
SHORT := tests/base tests/camera tests/io tests/rendering tests/test_imports.py
test-short: $(VENV)/installed
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal $(SHORT)

# With the tests that are marked as slow.
test-all: $(VENV)/installed
	$(BIN)/python -m pytest -m ""

# Not for emulators and sanitizers: statistics over hundreds of images, of which they see no more than of one and take long,
# and tests of torch's graphs and registrations, which run no other kernels.
UNWATCHED := --ignore tests/raster/visibility/test_gradient_quality.py \
	--ignore tests/raster/visibility/test_gradient_matrix.py \
	--deselect tests/raster/visibility/test_reinforce.py::test_through_the_renderer \
	--deselect tests/raster/visibility/test_intersections.py::test_mean_gradient_is_a_central_difference \
	--deselect tests/raster/visibility/test_layers_gradient.py::test_the_derivative_of_pictures \
	-k "not compile and not well_formed and not opcheck"

# On a machine with an NVIDIA GPU: the tests that take a device, with the slow ones; then the kernels of small scenes in
# the programs of the CUDA toolkit that watch memory, without torch's cache, so that they know where each tensor ends;
# then the times.
WATCHED := tests/raster/test_rasterize.py tests/raster/test_cube_colors.py tests/raster/ops tests/raster/colors \
	tests/raster/visibility
test-cuda: $(VENV)/installed
	$(BIN)/python -m pytest -m "" --device cuda --numprocesses 4 --dist worksteal
	for tool in memcheck initcheck; do \
		PYTORCH_NO_CUDA_MEMORY_CACHING=1 compute-sanitizer --tool $$tool --error-exitcode 1 --print-limit 20 \
			$(BIN)/python -m pytest --device cuda $(WATCHED) $(UNWATCHED) || exit 1; \
	done
	$(BIN)/python -m benchmarks --device cuda

# The kernels' CUDA code on a processor, with unordered memory accesses counted; needs a C compiler, no GPU. All
# processes share the translated kernels.
test-cuda-emulated: export EMULATED_MODULES := $(CURDIR)/build/emulated_cuda
test-cuda-emulated: $(VENV)/installed
	rm -rf $(EMULATED_MODULES) && mkdir -p $(EMULATED_MODULES)
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal --emulated-cuda races $(COMPILATION) \
		tests/raster/ops tests/raster/colors tests/raster/visibility tests/raster/test_rasterize.py \
		tests/raster/test_waiting.py tests/raster/test_sharing.py tests/apps/reconstruct/data/test_voxelize.py \
		tests/drop_in/test_dr_[airt]*.py $(UNWATCHED)
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal --emulated-cuda races --device cuda \
		tests/drop_in tests/meshes tests/rendering tests/shading tests/test_in_place.py

# The kernels' C++ headers as g++ builds them, with sanitizers: their own tests, then those of the operators. Reports of
# sanitizers end the process, so that they are shown at once.
test-native: $(VENV)/installed
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal tests/native
	for sanitizer in address thread; do \
		variables=$$($(BIN)/python -m tests.native.compiler $$sanitizer) && env $$variables \
		$(BIN)/python -m pytest --numprocesses 2 --dist worksteal --capture sys --sanitizer $$sanitizer \
			tests/raster/ops tests/raster/colors tests/raster/visibility tests/raster/test_rasterize.py \
			tests/drop_in/test_dr_*.py tests/apps/reconstruct/data/test_voxelize.py tests/fuzz/test_calls.py \
			$(UNWATCHED) || exit 1; \
	done

# Ten minutes of hostile inputs of all kinds; SEED=7 makes those of another run again. What fails lies in
# tests/fuzz/crashes then, where `make test` finds it until it is mended, and after.
SECONDS ?= 600
fuzz: $(VENV)/installed
	$(BIN)/python -m tests.fuzz --seconds $(SECONDS) $(if $(SEED),--seed $(SEED))

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror $(CPP)
	$(BIN)/mypy

format: $(VENV)/installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(CPP)

benchmark: $(VENV)/installed
	$(BIN)/python -m benchmarks

coverage: $(VENV)/installed
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal --cov --cov-report=term --cov-report=html

# A wheel and a source distribution in dist/; each is then installed and tested in an environment of its own. Where uv
# is installed, it runs the wheel, too, with torch's CPU build from PIP_FIND_LINKS or from torch's own index. The cache of
# kernels is new, so that the first demo says how long a user waits for a first picture.
UV_TORCH := $(if $(PIP_FIND_LINKS),--find-links $(PIP_FIND_LINKS),--torch-backend cpu)
package: export WARP_CACHE_PATH := $(CURDIR)/build/kernels
package: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt build twine
	rm -rf dist build
	$(BIN)/python -m build --quiet --outdir dist
	$(BIN)/twine check --strict dist/*
	for file in dist/*; do \
		$(PYTHON) -m venv --clear build/package \
		&& build/package/bin/python -m pip install --quiet "$(TORCH)" \
		&& build/package/bin/python -m pip install --quiet --constraint constraints.txt "$$file" \
		&& (cd build && package/bin/neural-renderer demo -o demo --frames 4 --steps 20 && test -s demo/knot.png \
			&& package/bin/neural-renderer info) || exit 1; \
	done
	if command -v uv; then \
		uv tool run --isolated --python $(PYTHON) $(UV_TORCH) --constraints constraints.txt --from dist/*.whl \
			neural-renderer demo -o build/uv_demo --frames 4 --steps 20 && test -s build/uv_demo/knot.png || exit 1; \
	fi
	mkdir build/sdist && tar -xzf dist/*.tar.gz --strip-components 1 -C build/sdist
	build/package/bin/python -m pip install --quiet --constraint constraints.txt "build/sdist[dev]"
	cd build/sdist && ../package/bin/python -m pytest $(SHORT) tests/raster

# The site, in out/docs/html. Notebooks run again only when their own cells change: `make clean` runs all of them.
SPHINX := $(BIN)/python -m sphinx --builder html --fail-on-warning --keep-going --quiet
docs: $(VENV)/docs
	$(SPHINX) docs out/docs/html
	@echo "Open out/docs/html/index.html"

# The site without the outputs of its cells, which `make test` runs but for the slow ones: links, names and the reference.
docs-quick: $(VENV)/docs
	$(SPHINX) --define nb_execution_mode=off --define suppress_warnings=myst-nb.lexer docs out/docs/quick

# The package alone, and what working on it needs besides.
$(VENV)/package: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet "$(TORCH)"
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	touch $@

$(VENV)/installed: $(VENV)/package
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[dev]"
	touch $@

$(VENV)/docs: $(VENV)/package
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[docs]"
	touch $@

clean:
	rm -rf $(VENV) out build dist
