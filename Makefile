# Both targets need nothing but Python 3.11 or later; they wrap plain pip and pytest lines.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test evidence clean

demo: $(BIN)/python  ## learn -> solve -> execute -> page, on a demonstration that the project ships
	$(BIN)/python -m pip install --quiet '.[sim]'
	$(BIN)/python examples/demo.py

test: $(BIN)/python  ## the quick test suite
	$(BIN)/python -m pip install --quiet '.[sim,test]'
	$(BIN)/pytest -n auto

evidence: $(BIN)/python  ## what takes long: tests over many seeds and new random examples, and the mutants that tests notice
	$(BIN)/python -m pip install --quiet -e '.[dev,robots]'
	$(BIN)/pytest -n auto -m evidence --hypothesis-profile=evidence -rA
	$(BIN)/python -m benchmarks mutants

$(BIN)/python:
	$(PYTHON) -m venv .venv

clean:
	rm -rf .venv build dist site
