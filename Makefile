# Two commands on a fresh machine with Python 3.11 or newer: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
USBLDR ?= $(BIN)/usbldr
SAMPLES ?= sample_logs

KERNEL := $(wildcard filters/kernel/*.c filters/kernel/*.h)

.PHONY: demo test test-all fuzz docs man lint check wheel sanitize sample_logs study logs peers clean

demo: $(VENV)/installed
	@mkdir -p demo
	$(BIN)/usbldr simulate paper -o demo/paper.mcap --force
	$(BIN)/usbldr replay demo/paper.mcap --filter cpf --output demo/paper-cpf --force
	@echo
	@echo "The figures are in demo/paper-cpf; look at track.png and errors.png first."

test: $(VENV)/installed-dev .pyright/usbldr
	$(BIN)/pytest -q -n auto --dist worksteal -m "not slow and not long"

test-all: $(VENV)/installed-dev .pyright/usbldr
	$(BIN)/pytest -q -n auto --dist worksteal -m "not slow"

# damaged files of every format by the thousand: the table in docs/broken_files.md
fuzz: $(VENV)/installed-dev
	$(BIN)/pytest -q -n auto --dist worksteal -m slow
	PYTHONPATH=tests/support:benchmarks $(BIN)/python tests/support/damage.py --write docs/broken_files.md

# the tests of the kernel with checks of every access and of every operation without a defined result
SANITIZERS := -fsanitize=address,undefined -fno-sanitize-recover=undefined -g -O1
sanitize: $(VENV)/installed-dev
	gcc -shared -fPIC $(SANITIZERS) -DPORTABLE_ALONE -ffp-contract=off -fno-math-errno -Wno-psabi filters/kernel/*.c \
		-I$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("include"))') -o filters/kernel/_kernel.abi3.so
	LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libubsan.so)" ASAN_OPTIONS=detect_leaks=0 \
		$(BIN)/pytest -q tests/filters/estimators/test_compiled.py tests/filters/identification/test_compiled_passes.py; \
	result=$$?; $(BIN)/pip install --quiet --disable-pip-version-check -e .; exit $$result

check: $(VENV)/installed
	$(USBLDR) check sample_logs/baseline.toml

# the wheel of this machine for every Python from 3.11 on (abi3), installed and imported in a fresh environment
wheel: $(VENV)/bin/python
	rm -rf build/lib* build/wheel
	$(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir build/wheel .
	$(PYTHON) -m venv build/wheel/env
	cd build/wheel && env/bin/pip install --quiet --disable-pip-version-check usbldr-*-cp311-abi3-*.whl
	cd build/wheel && env/bin/python -c 'from usbldr.filters.kernel import KERNEL; assert KERNEL.advance, KERNEL.reason'
	cd build/wheel && env/bin/usbldr --version -v

# the same bytes each time, as long as numpy and zstandard stay the same
sample_logs: $(VENV)/installed
	$(USBLDR) simulate paper --seed 0 --force -o $(SAMPLES)/paper.mcap
	$(USBLDR) simulate lawnmower --seed 0 --force -o $(SAMPLES)/lawnmower.mcap
	$(USBLDR) simulate lawnmower --seed 0 --force -o $(SAMPLES)/lawnmower.bag
	$(USBLDR) simulate lawnmower --seed 0 --force -o $(SAMPLES)/lawnmower_csv
	$(USBLDR) export $(SAMPLES)/lawnmower.mcap --start 60 --end 180 --force -o $(SAMPLES)/lawnmower_turn_db3

# every command of a page of docs/studies, such as `make study PAGE=docs/studies/field.md`; third-party logs in USBLDR_FIELD_LOGS
study: $(VENV)/installed
	@sed -n 's/^\$$ //p' $(PAGE) | PATH="$(CURDIR)/$(BIN):$$PATH" sh -ex

# what info, doctor and init say of each of the same logs
logs: $(VENV)/installed
	@scratch=$$(mktemp -d); \
	for log in $${USBLDR_FIELD_LOGS:-../shared/logs}/*/*.mcap; do \
		for command in info doctor "init --force --output $$scratch/usbldr.toml"; do \
			printf '\n$$ usbldr %s\n' "$$command $$log"; $(USBLDR) $$command $$log || true; \
		done; \
		cat $$scratch/usbldr.toml; \
	done; \
	rm -r $$scratch

# the documentation as a site in build/site; a dead link is an error
docs: $(VENV)/installed-dev
	$(BIN)/sphinx-build -q -n -W --keep-going -c docs . build/site
	@echo '<meta http-equiv="refresh" content="0; url=README.html">' > build/site/index.html
	@echo "The documentation is in build/site/index.html."

# the manual page build/man/usbldr.1; `man build/man/usbldr.1` shows it
man: $(VENV)/installed-dev
	$(BIN)/sphinx-build -q -b man -c docs . build/man

# our filters beside those of other libraries, on one thread: the table in docs/peers.md; wants an idle machine for 2 minutes
PEERS := .venv-peers
peers: $(PEERS)/installed
	OMP_NUM_THREADS=1 $(PEERS)/bin/python benchmarks/speed/peers.py --json benchmarks/speed/peers.json --write docs/peers.md

$(PEERS)/installed: benchmarks/speed/requirements.txt pyproject.toml $(KERNEL)
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check -e . -r benchmarks/speed/requirements.txt
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check --no-deps particles
	touch $@

lint: $(VENV)/installed-dev .pyright/usbldr
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/pyright --pythonpath $(BIN)/python
	PYTHONPATH=.pyright $(BIN)/lint-imports

# links for what follows folders; a source distribution cannot hold them
.pyright/usbldr:
	mkdir -p $@
	ln -s ../../filters ../../io $(addprefix ../../,$(wildcard public/*.*)) $@

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "usbldr needs Python 3.11 or newer: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml $(KERNEL)
	@echo "Installing usbldr with what it needs in $(VENV), and compiling its filters: about a minute."
	$(BIN)/pip install --quiet --disable-pip-version-check -e .
	touch $@

$(VENV)/installed-dev: $(VENV)/bin/python pyproject.toml $(KERNEL)
	@echo "Installing usbldr with what its tests need in $(VENV), and compiling its filters: about a minute."
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV) $(PEERS) demo
