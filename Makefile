# `make demo` and `make test` create .venv on their first run.

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

.PHONY: help demo fleet test dashboard lint format bench constraints picture screens site release clean

help:
	@echo "make demo [PORT=8080]   serve simulated robots"
	@echo "make fleet [PORT=8080]  serve a hub, and three simulated robots with gateways of their own"
	@echo "make test [ARGS=...]    run the full test suite; ARGS is passed to pytest"
	@echo "make dashboard          build the dashboard's pages, if that failed before"
	@echo "make lint               ruff, pyright, import-linter"
	@echo "make format             format the code with ruff"
	@echo "make bench              run the benchmarks and print tables"
	@echo "make constraints        write constraints.txt from the installed versions"
	@echo "make picture            record docs/demo.svg from a running demo"
	@echo "make screens [ARGS=...]  photograph the dashboard for its page of the documentation; ARGS names some pictures"
	@echo "make site               build the documentation as a site into build/site, and check its links"
	@echo "make release            build all packages into dist/, install each and drive a robot with it; uploads nothing"
	@echo "make clean              remove .venv and all generated files"

demo: $(DEMO)
	@exec $(BIN)/rcpd demo --port $(PORT)

fleet: $(DEMO)
	@exec $(BIN)/python examples/fleet/run.py --port $(PORT)

test: $(TEST)
	@$(BIN)/python tests $(ARGS)

dashboard: $(MADE)
	$(BIN)/python -m pip install -v --no-deps -e .
	@test -f plugins/rcp_dashboard/static/index.html.gz

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

screens: $(TEST)
	$(BIN)/python .ci/screens.py $(ARGS)

site: $(TEST)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

release: $(TEST)
	$(BIN)/python packaging/build.py $(ARGS)
	$(BIN)/python packaging/verify.py $(ARGS)

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
		echo "Python 3.11 or newer is required; python3 here is" \
			"$$(python3 --version 2>/dev/null || echo 'not installed')." >&2; \
		echo "Install it and run: make PYTHON=/path/to/python3.11 <target>" >&2; \
		exit 1; \
	fi; \
	echo "Creating .venv with $$($$found --version)"; \
	$$found -m venv .venv || { \
		echo "Python's venv module does not work. On Debian: apt install python3-venv" >&2; \
		exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(BIN)/python -m ensurepip >/dev/null
	@touch $@

define report_missing_pages
test -f plugins/rcp_dashboard/static/index.html.gz || \
	echo "The dashboard's pages could not be built (npm cannot reach its registry);" \
		"everything else works. \`make dashboard\` retries with full output."
endef

# The tests' dependencies include those of the demo. Byte code of what the demo imports is made when it first runs,
# instead of everything's that is installed.
$(DEMO): $(NEEDS) | $(MADE)
	@echo "Installing the demo's dependencies"
	@$(PIP) --no-compile -c constraints.txt -e $(CLIENT) -e '.[a2a,can,conditions,console,dashboard,fast,fleet,jwt,mavlink,mcp,mujoco,tls]'
	@$(report_missing_pages)
	@touch $@

$(TEST): $(NEEDS) | $(MADE)
	@echo "Installing the test dependencies (several hundred MB, once)"
	@$(PIP) -c constraints.txt -e $(CLIENT) -e '.[test]'
	@$(report_missing_pages)
	@touch $(DEMO) $@
