# Every target sets up what it needs through env/enter. Settings: case, ranks, e.g.
#   make run case=configs/dogbone.yaml ranks=4

case  = configs/bias-1x3.yaml
ranks = 2
jobs  = 2
before = main
enter = env/enter

.PHONY: help run paper pictures test test-all test-next test-wheels suite dist lint size docs constants bench accuracy hard survive fuzz random layers stale unchanged paraview-check clean clean-environment

help: ## print the targets (the default)
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile | expand -t 26

run: ## compute the bias-extension loop on 2 ranks into results/bias-1x3
	$(enter) mpirun -n $(ranks) wovenfab run $(case) --overwrite

paper: ## run the paper's figures, measure its claims, write docs/paper.md; goes on where it was
	$(enter) python3 -m paper configs/paper -o results/paper --docs docs

pictures: ## draw the pictures of README.md and docs/effects.md again, of the code as committed
	$(enter) mpirun -n 2 wovenfab run configs/bias-1x3.yaml --overwrite
	$(enter) wovenfab effects configs/bias-1x3.yaml --set program.amplitudes=40mm --set time.steps_per_cycle=40
	cp results/bias-1x3/loop.png results/bias-1x3/deformed.png docs/pictures
	cp results/bias-1x3-effects/effects.png docs/pictures

test: lint suite ## style, types, and the tests of physics, numerics, files and interface

test-all: lint dist docs ## all tests, the slow ones too, the site, the wheel, and plain kernels
	$(enter) pytest -n $(jobs) --dist loadfile -m "not mpi"
	$(enter) on-ranks 2 pytest -m mpi
	$(enter) on-ranks 4 pytest -m mpi4
	$(enter) pytest -n $(jobs) --dist loadfile --plain-kernels -m "not mpi and not slow" tests/forms tests/solver tests/stepping tests/verification

test-next: export WOVENFAB_SUITE = sid
test-next: suite ## the same tests with the next dolfinx (0.11), in a Debian sid

test-wheels: export WOVENFAB_SUITE = wheels
test-wheels: ## the same tests with FEniCSx from PyPI, in a bare Debian 13, but for those of env/enter
	$(enter) pytest -n $(jobs) --dist loadfile -m "not mpi and not slow" --ignore tests/environment
	$(enter) on-ranks 2 pytest -m "mpi and not mpi4 and not slow" --ignore tests/environment
	$(enter) on-ranks 4 pytest -m "mpi4 and not slow" --ignore tests/environment

suite:
	$(enter) pytest -n $(jobs) --dist loadfile -m "not mpi and not slow"
	$(enter) on-ranks 2 pytest -m "mpi and not mpi4 and not slow"
	$(enter) on-ranks 4 pytest -m "mpi4 and not slow"

lint: ## style, format and types
	$(enter) sh -c "ruff check . && ruff format --check . && python3 -m mypy"

size: ## lines of code, functions, numbers and public names by layer; it judges nothing
	$(enter) python3 -m benchmarks.size

constants: ## change each named number of the core and of the studies: which test fails (an hour)
	$(enter) python3 -m benchmarks.constants $(only)

docs: ## write docs/parameters.md anew and build the documentation site: build/site/index.html
	$(enter) wovenfab schema --effects > docs/parameters.md
	$(enter) python3 -m sphinx -W --keep-going -q -E -d build/doctrees docs build/site

bench: ## measure speed, as phases and ratios in one run
	$(enter) python3 -m benchmarks

hard: ## run the hard cases and write docs/hard-cases.md; rows="locking long" for some
	$(enter) python3 -m benchmarks.hard $(rows) $(quick)

random: ## 1 % on fabrics drawn at random: docs/random-fabrics.md (some hours; goes on)
	$(enter) python3 -m benchmarks.random_scenes $(count) $(seed)
	$(enter) python3 -m benchmarks.random_page

layers: ## stated errors of twenty sheets with thin boundary layers (goes on)
	$(enter) python3 -m benchmarks.layer_scenes $(count) $(seed)

stale: ## tell which pages of results are of older code: whoever changed it makes them anew
	@for page in accuracy hard-cases random-fabrics; do \
	  for of in $$(sed -n '/^Code of these figures/s/[^`]*`\([0-9a-f]*\)`[^`]*/\1 /gp' docs/$$page.md); do \
	    git diff --quiet $$of -- forms wovenfab configs && said="of this code" || said="of older code"; \
	    echo "docs/$$page.md: commit $$of, $$said"; \
	  done; \
	done

survive: ## kill runs again and again and let them go on; cycles in parts (12 minutes)
	$(enter) python3 -u -m benchmarks.survive $(kills)

fuzz: ## check mutated cases, geometries, measured and fit files, count=2000 of each, and results
	$(enter) python3 -m tests.fuzz $(count)
	$(enter) python3 -m tests.fuzz.geometries $(count)
	$(enter) python3 -m tests.fuzz.measured $(count)
	$(enter) python3 -m tests.fuzz.results $(damaged)

accuracy: ## write docs/accuracy.md: what accuracy costs (goes on where it was)
	$(enter) python3 -m benchmarks.accuracy_page

unchanged: ## compare the histories of all cases with those of another commit, before=REVISION
	code=$$(mktemp -d) && trap 'rm -rf "$$code"' EXIT && \
	git archive $(before) | tar -x -C "$$code" && \
	$(enter) python3 -m benchmarks.unchanged "$$code" "$$(git rev-parse $(before))"

paraview-check: ## open the fields of a run in ParaView's three XDMF readers (needs 2.3 GB more)
	tests/paraview/run.sh $(results)

dist: ## build wheel and sdist into dist/ and check them; nothing is uploaded
	$(enter) dist

clean: ## remove what tools left in this folder; results stay
	rm -rf build dist *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

clean-environment: ## remove the environments and caches that env/enter made
	$(enter) --remove
