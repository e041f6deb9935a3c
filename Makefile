# `make demo`, `make watch` and `make test` each install into .venv first, once. Of 14,000 modules a quarter is ever
# imported: Python compiles those when it meets them, and pip none.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
DEMO   ?= hrl-escape demo
WATCH  ?= hrl-escape watch --room clutter#3
JOBS   ?= 2
SHARD  ?= 1/1
MARKS  ?= nightly
PACKAGES ?= agents planning benchmark data text

VENV  := .venv
STAMP := $(VENV)/.installed
export PATH := $(CURDIR)/$(VENV)/bin:$(PATH)
unexport PYTHONDONTWRITEBYTECODE  # every process that tests start would compile the package anew

.DEFAULT_GOAL := help
.PHONY: help demo watch test test-nightly mutants docs contact-sheet lint dist clean

help: ## show this list
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 22

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[dev]'
	hrl-escape warm  # no first plan waits for the compiler
	touch $@

demo: $(STAMP) ## compare six agents in a room with four buttons; ends with a link to the report
	$(DEMO)

watch: $(STAMP) ## open the viewer in the browser: the planner escapes from a cluttered room; Ctrl-C ends
	$(WATCH)

test: $(STAMP) ## the fast tests, four minutes on two idle cores
	python -m pytest tests -n $(JOBS) --dist worksteal -m "not (nightly or gpu)"

test-nightly: $(STAMP) ## all others, planted bugs among them, about an hour; a tenth of them: make test-nightly SHARD=1/10
	python -m pytest tests -n $(JOBS) --dist worksteal -m "$(MARKS)" --shard $(SHARD)

mutants: $(STAMP) ## 20 small bugs in each of five packages, drawn by the date; some hours; one: PACKAGES=data
	python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[mutants]'
	python -m benchmarks.mutants --packages $(PACKAGES) --count 20

docs: $(STAMP) ## the site, into build/docs, read once more by its tests
	sphinx-build -j $(JOBS) -W --keep-going -q docs build/docs
	python -m pytest -q tests/docs/test_site.py --site build/docs
	@echo "Read it: $(CURDIR)/build/docs/index.html"

contact-sheet: docs ## pictures of every page of the site, on a laptop and on a phone
	python docs/contact_sheet.py build/docs

dist: $(STAMP) ## wheel and source into dist, built twice to the same bytes and checked for a package index
	python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[release]'
	rm -rf dist build/again
	python -m build --no-isolation --outdir dist .
	python -m build --no-isolation --outdir build/again .
	diff -r dist build/again
	twine check --strict dist/*

lint: $(STAMP) ## style, words, types and which way imports run
	ruff check .
	python docs/check_words.py
	pyright --pythonpath $(VENV)/bin/python
	lint-imports --no-cache

clean: ## remove .venv and every cache
	rm -rf $(VENV) build dist .benchmarks .hypothesis .import_linter_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
