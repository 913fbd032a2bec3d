"""The notebooks run offline, and say what their prose says. They are stored without outputs; the docs run them too."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path
from typing import Any

import pytest
from extras import requires

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
NOTEBOOKS = sorted(file.stem for file in FOLDER.glob("*.ipynb"))

# What the outputs must tell, in this order, for the prose around them to be true.
TOLD = {
    "learn": r"revolute .*\srigid .*revolute -> rigid where door >= 1\.2.*10 mm more: revolute -> rigid.*plan/model/1",
    "plan": r"solved.*revolute -> rigid.*asked 99 %.*no_plan - the goal .* is in the range of none.*solved",
    "explore": (
        r"opened.*prismatic \(probability >99 %\).*dead_zone.*1 of 1 trials.*none.*not noise.*explained.*"
        r"dead_zone \(handle\) +width 11\.\d+ mm.*1 of 1 trials"
    ),
    "close_the_loop": r"[01] of 4 trials reach.*(explained|partly): .*[34] of 4 trials reach",
}
FIGURES = {"learn": 2, "plan": 2, "close_the_loop": 2, "explore": 2}

OFFLINE = """
import socket

_connect = socket.socket.connect

def connect(self, address):
    if self.family != socket.AF_UNIX and not str(address[0]).startswith("127."):
        raise OSError(f"a notebook wants the network: {address}")
    return _connect(self, address)

socket.socket.connect = connect
"""


def stored(name: str) -> dict[str, Any]:
    return dict(json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8")))


def test_there_are_the_notebooks_that_are_tested() -> None:
    assert sorted(TOLD) == NOTEBOOKS


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_short_and_stored_without_outputs(name: str) -> None:
    cells = stored(name)["cells"]
    assert 8 <= len(cells) <= 15
    assert cells[0]["source"][0].startswith("# ")
    assert not [cell for cell in cells if cell.get("outputs") or cell.get("execution_count")]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_links_of_a_notebook_lead_somewhere(name: str) -> None:
    prose = "".join(
        line for cell in stored(name)["cells"] if cell["cell_type"] == "markdown" for line in cell["source"]
    )
    for target in re.findall(r"\]\(([^)\s#]+)", prose):
        assert (FOLDER / target).is_file(), target


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_what_a_notebook_imports_exists(name: str) -> None:
    code = "".join(line for cell in stored(name)["cells"] if cell["cell_type"] == "code" for line in cell["source"])
    imports = re.findall(r"^from (micah_plan\S*) import (.+)$", code, re.MULTILINE)
    assert imports
    for module, names in imports:
        assert [each for each in names.split(", ") if not hasattr(importlib.import_module(module), each)] == []


@pytest.mark.evidence  # the docs of every landing run the notebooks; here their numbers are those of the prose
@requires("notebooks")
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_offline_and_prints_what_its_prose_states(name: str) -> None:
    import nbclient
    import nbformat

    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(OFFLINE))
    client = nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(FOLDER)}})
    client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    text = "".join(output["text"] for output in outputs if output.get("name") == "stdout")
    assert re.search(TOLD[name], text, re.DOTALL), text
    assert [output for output in outputs if output.get("name") == "stderr"] == []
    assert sum("image/png" in output.get("data", {}) for output in outputs) == FIGURES[name]
