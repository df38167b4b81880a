# Two commands: `make pick` runs the main job, `make test` passes the checks. Both make .venv when it is missing.
PYTHON ?= python3
# more options for pip, as an index of CPU builds of torch; CONTRIBUTING.md says when
PIP_ARGS ?=
STAMP := .venv/.stamp

.PHONY: setup pick test clean

setup: $(STAMP)

# torch goes first and alone, so that its build is settled before anything that asks for torch is resolved
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	.venv/bin/python -m pip install --quiet -c constraints.txt $(PIP_ARGS) torch
	.venv/bin/python -m pip install --quiet -c constraints.txt $(PIP_ARGS) -e '.[dev]'
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

clean:
	rm -rf .venv out build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
