# `make pick` runs the main job, `make test` passes the checks. Every target makes .venv when it is missing.
# Python 3.11 where there is one: PyBullet has no wheels for newer ones
PYTHON ?= $(shell for p in python3.11 python3; do $$p -c "" 2>/dev/null && echo $$p && break; done || true)
# more options for pip, as an index of CPU builds of torch; CONTRIBUTING.md says when
PIP_ARGS ?=
STAMP := .venv/.stamp

.PHONY: setup pick lint test test-fast test-newest docs clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	.ci/setup .venv "$(or $(PYTHON),python3)" $(PIP_ARGS)
	touch $@

pick: $(STAMP)
	@out=out/pick-$$(date +%Y%m%d-%H%M%S) && \
	.venv/bin/pickproof run bracket --episodes 2 --workers 2 --out $$out && \
	.venv/bin/pickproof report $$out

# what changed files are held to, and docstrings of all public names
lint: $(STAMP)
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/lint-imports

# worksteal keeps the tests of a file together, which share what is costly to make
test: lint
	.venv/bin/python -m pytest -n 2 --dist worksteal

# for the author of a change, before a push: what neither settles heaps, trains, nor starts many processes
test-fast: $(STAMP)
	.venv/bin/python -m pytest -n 2 --dist worksteal -m "not slow"

# with the newest release of every dependency, as the weekly job runs it
test-newest:
	rm -rf .venv && $(or $(PYTHON),python3) -m venv .venv
	.venv/bin/python -m pip install --quiet $(PIP_ARGS) -e '.[dev]'
	touch $(STAMP)
	$(MAKE) test

# the site of docs/, in build/site; a broken link or a page out of date is an error
docs: $(STAMP)
	.venv/bin/python docs/fields.py --check
	.venv/bin/mkdocs build --strict --quiet

clean:
	rm -rf .venv out build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
