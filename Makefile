# Everything runs in .venv, which the first command makes; PYTHON may name another interpreter (3.11 or newer).
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo robot test soak fuzz lint bench claims docs format clean

demo: .venv/installed
	$(BIN)/stltool run examples/factory/patrolling.stl --episodes 1000 --seed 0 --out out/patrolling
	@echo "open out/patrolling/report.html in a browser"

# the paper's task on a simulated robot: learned, promised, and what models predict of it (docs/robot.md)
robot: .venv/installed
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[robot]' \
		|| echo "MuJoCo cannot be installed here: the kinematic robot is taken instead"
	$(BIN)/python -m examples.robot --out out/robot

# bytecode is kept, whatever the environment says: tests start dozens of processes
test soak: export PYTHONDONTWRITEBYTECODE =
test: .venv/installed-dev
	$(BIN)/pytest -n 2 --dist worksteal

# random instances, statistics and mutations: MORE times the numbers in the tests, of which `make test` takes .1
MORE ?= 30
soak: .venv/installed-dev
	STLTOOL_MORE=$(MORE) $(BIN)/pytest -n 2 --dist worksteal -m "soak or hypothesis"

lint: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# every table of bench/results.md, hours; ONLY=kernels,graphs and SKIP=largest choose parts, QUICK=1 tries the smallest
# sizes and keeps nothing, LIST=1 shows the parts
bench: .venv/installed-dev
	$(BIN)/python bench/run.py $(if $(ONLY),--only $(ONLY)) $(if $(SKIP),--skip $(SKIP)) $(if $(QUICK),--quick) $(if $(LIST),--list)

# the figures of README and docs against their commands; CLASS=minutes|bench|all, ONLY=name,name, UPDATE=1, LIST=1 (docs/claims.py)
CLASS ?= quick
claims: .venv/installed-dev
	$(BIN)/python docs/claims.py --class $(CLASS) $(if $(ONLY),--only $(ONLY)) $(if $(UPDATE),--update) $(if $(LIST),--list)

# the documentation site: open out/docs/site/index.html in a browser
docs: .venv/installed-dev
	rm -rf out/docs
	$(BIN)/python docs/generated.py --site out/docs
	$(BIN)/zensical build --strict --config-file out/docs/zensical.yml

# ten minutes; WHAT=policies, models (in TOML), formats (of other tools), explicit (.tra) or results (logs, reports,
# certificates, checkpoints) for the readers of these, FUZZ=-max_total_time=60 for another time, and libFuzzer's options
FUZZ ?= -max_total_time=600
WHAT ?= formulas
fuzz: .venv/installed-fuzz
	mkdir -p out/fuzz/$(WHAT)
	cd out/fuzz/$(WHAT) && ../../../$(BIN)/python ../../../bench/fuzz_$(WHAT).py -max_len=400 $(FUZZ) .

format: .venv/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf .venv out dist

.venv/python:
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "stltool needs Python 3.11 or newer; call make PYTHON=...")'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --upgrade pip
	touch $@

.venv/installed: pyproject.toml .venv/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	touch $@

.venv/installed-fuzz: pyproject.toml .venv/installed-dev
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	touch $@

.venv/installed-dev: pyproject.toml .venv/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[peers]' \
		|| echo "Storm, RTAMT or SENTIL cannot be installed here: the tests that compare with them are skipped"
	touch $@
