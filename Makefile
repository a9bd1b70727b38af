# `make demo` and `make test` are all it takes: they make .venv by themselves, once.

PYTHON ?=
PORT ?= 8080
ARGS ?=

BIN := .venv/bin
MADE := .venv/.made
DEMO := .venv/.demo
TEST := .venv/.test
PIP := $(BIN)/python -m pip install -qq --disable-pip-version-check
WEB := plugins/rcp_dashboard/web
PAGES := $(shell find $(WEB) clients/typescript/src -name node_modules -prune -o -type f ! -name .made -print)
CLIENT := clients/python
NEEDS := Makefile pyproject.toml $(CLIENT)/pyproject.toml constraints.txt $(PAGES)

.PHONY: help demo test dashboard lint format bench constraints picture clean

help:
	@echo "make demo [PORT=8080]   serve simulated robots and say where to look"
	@echo "make test [ARGS=...]    run the tests; ARGS goes to pytest"
	@echo "make dashboard          build the dashboard's pages, where that failed before"
	@echo "make lint               ruff, pyright, import-linter"
	@echo "make format             have ruff lay the code out"
	@echo "make bench              measure; prints tables"
	@echo "make constraints        write constraints.txt from what is installed"
	@echo "make picture            draw docs/demo.svg from a demo that runs"
	@echo "make clean              remove .venv and what tools left behind"

demo: $(DEMO)
	@exec $(BIN)/rcpd demo --port $(PORT)

test: $(TEST)
	@$(BIN)/python tests $(ARGS)

dashboard: $(MADE)
	$(BIN)/python -m pip install -v --no-deps -e .
	@test -f plugins/rcp_dashboard/static/index.html

lint: $(TEST)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

format: $(TEST)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(TEST)
	@$(PIP) -c constraints.txt -e $(CLIENT) -e '.[test,bench]'
	$(BIN)/python benchmarks $(ARGS)

constraints: $(TEST)
	$(BIN)/python .ci/constraints.py

picture: $(TEST)
	$(BIN)/python .ci/picture.py

clean:
	rm -rf .venv .pytest_cache .ruff_cache .hypothesis .import_linter_cache build dist
	rm -rf plugins/rcp_dashboard/static $(WEB)/node_modules $(WEB)/.made

$(MADE):
	@found=; \
	for python in $(PYTHON) python3 python3.14 python3.13 python3.12 python3.11 python; do \
		if $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; \
		then found=$$python; break; fi; \
	done; \
	if [ -z "$$found" ]; then \
		echo "This needs Python 3.11 or newer; python3 here is" \
			"$$(python3 --version 2>/dev/null || echo 'not installed')." >&2; \
		echo "Install one and name it: make PYTHON=/path/to/python3.11 <target>" >&2; \
		exit 1; \
	fi; \
	echo "Making .venv with $$($$found --version)"; \
	$$found -m venv .venv || { \
		echo "Python's venv module does not work here; on Debian: apt install python3-venv" >&2; \
		exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(BIN)/python -m ensurepip >/dev/null
	@touch $@

define told
test -f plugins/rcp_dashboard/static/index.html || \
	echo "The dashboard's pages could not be built (npm has to reach its registry):" \
		"all else works. \`make dashboard\` tries again and says more."
endef

# What was installed for the tests serves the demo too.
$(DEMO): $(NEEDS) | $(MADE)
	@echo "Installing what the demo needs"
	@$(PIP) -c constraints.txt -e $(CLIENT) -e '.[a2a,can,dashboard,mavlink,mcp]'
	@$(told)
	@touch $@

$(TEST): $(NEEDS) | $(MADE)
	@echo "Installing what the tests need (some hundred MB, once)"
	@$(PIP) -c constraints.txt -e $(CLIENT) -e '.[test]'
	@$(told)
	@touch $(DEMO) $@
