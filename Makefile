# Two commands: `make pick` runs the main job, `make test` passes the checks. Both make .venv when it is missing.
# Python 3.11 where there is one: PyBullet has no wheels for newer ones
PYTHON ?= $(shell for p in python3.11 python3; do $$p -c "" 2>/dev/null && echo $$p && break; done || true)
# more options for pip, as an index of CPU builds of torch; CONTRIBUTING.md says when
PIP_ARGS ?=
STAMP := .venv/.stamp

.PHONY: setup pick test docs clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	.ci/setup .venv "$(or $(PYTHON),python3)" $(PIP_ARGS)
	touch $@

pick: $(STAMP)
	@out=out/pick-$$(date +%Y%m%d-%H%M%S) && \
	.venv/bin/pickproof run bracket --episodes 2 --workers 2 --out $$out && \
	.venv/bin/pickproof report $$out

test: $(STAMP)
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/lint-imports
	.venv/bin/python -m pytest -n 2

# the site of docs/, in build/site; a broken link or a page out of date is an error
docs: $(STAMP)
	.venv/bin/python docs/fields.py --check
	.venv/bin/mkdocs build --strict --quiet

clean:
	rm -rf .venv out build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
