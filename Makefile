# From a fresh clone, Python 3.11+, make and git are all that these need; CONTRIBUTING.md says which to use when.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORES := -n 2 --dist worksteal
FAST := $(CORES) -m 'not slow and not gpu'

.PHONY: train quick test coverage oldest fuzz docs lint format release-check clean

train: $(VENV)/.ready
	$(BIN)/python -m train via_point --shape N --runs 20 --updates 100

quick: lint
	$(BIN)/python -m pytest $(FAST)

test: lint
	$(BIN)/python -m pytest $(CORES)

# The same tests, and how much of torchds they reach; pyproject.toml has the floor.
coverage: lint
	$(BIN)/python -m pytest $(CORES) --cov --cov-report=term:skip-covered

# The property tests of tests/faults with many cases and fresh seeds; prints a table of cases and failures.
CASES ?= 7500
fuzz: $(VENV)/.ready
	TORCHDS_FUZZ=$(CASES) $(BIN)/python -m pytest $(CORES) tests/faults

# The site in docs/_build/html: its tutorials are run, a warning is an error, and no link leads nowhere.
docs: $(VENV)/.docs
	$(BIN)/sphinx-build -q -W --keep-going -b html -d docs/_build/doctrees docs docs/_build/html
	$(BIN)/python -m tests.project.site docs/_build/html

$(VENV)/.docs: $(VENV)/.ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	touch $@

# All that a release needs, of the commit that stands here: dist/ holds what to upload when it says so.
release-check: $(VENV)/.ready
	@test -z "$$(git status --porcelain)" || { git status --short; echo "not ready: the tree is not clean"; exit 1; }
	$(MAKE) test
	$(MAKE) docs
	rm -rf dist
	$(BIN)/python -m build --no-isolation
	$(BIN)/python -m tests.release dist

lint: $(VENV)/.ready
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(VENV)/.ready
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# The environment is made anew when what goes into it changes.
$(VENV)/.ready: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

# The oldest numpy, scipy and scikit-learn that pyproject.toml allows, in front of the packages of the main environment;
# what tests/project says of files and imports does not depend on them, the examples in docstrings do; tests/faults calls the
# same with other numbers.
oldest: $(VENV)-oldest/.ready
	$(VENV)-oldest/bin/python -m pytest $(FAST) tests/torchds tests/tasks tests/train tests/project/test_names.py

$(VENV)-oldest/.ready: $(VENV)/.ready
	rm -rf $(VENV)-oldest
	$(BIN)/python -m venv $(VENV)-oldest
	$(VENV)-oldest/bin/python -m pip install --quiet --disable-pip-version-check \
		$$(sed -n '/^dependencies/s/>=/==/gp' pyproject.toml | grep -oE '(numpy|scipy|scikit-learn)==[0-9.]+')
	$(BIN)/python -c 'import site; print(f"import site; site.addsitedir({site.getsitepackages()[0]!r})")' \
		> $(VENV)-oldest/main.pth
	mv $(VENV)-oldest/main.pth $(VENV)-oldest/lib/python3*/site-packages/
	touch $@

# The fast tests under another Python, in an environment of its own: make python3.12
python3.%: .venv-3.%/.ready
	.venv-3.$*/bin/python -m pytest $(FAST)

.venv-3.%/.ready: pyproject.toml constraints.txt
	test -x $(@D)/bin/python || python3.$* -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

.PRECIOUS: .venv-3.%/.ready

clean:
	rm -rf $(VENV) $(VENV)-* build dist docs/_build .mypy_cache .pytest_cache .ruff_cache
