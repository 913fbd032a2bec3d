"""The version is one everywhere, what a release needs is there, and the wheel says that it is typed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import micah_plan
from micah_plan.documents.yaml_lines import read_yaml

ROOT = Path(__file__).resolve().parents[1]


def test_one_version_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = read_yaml((ROOT / "CITATION.cff").read_bytes(), "CITATION.cff").data
    assert project["version"] == citation["version"] == micah_plan.__version__
    assert f"## {micah_plan.__version__}" in (ROOT / "CHANGELOG.md").read_text()
    assert project["license"] == citation["license"] == "BSD-3-Clause"


def test_the_citation_says_what_it_must() -> None:
    citation = read_yaml((ROOT / "CITATION.cff").read_bytes(), "CITATION.cff").data
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()  # required by the format 1.2.0
    (paper,) = citation["references"]
    assert {"type", "title", "authors", "year", "conference"} <= paper.keys()


def test_templates_and_the_marker_of_types_are_package_data() -> None:
    package = Path(micah_plan.__file__).parent
    assert (package / "py.typed").read_bytes() == b""
    assert {path.name for path in (package / "templates").glob("*.*")} >= {"model.yaml", "problem.yaml", "robot.urdf"}


def test_every_library_at_run_time_is_bounded_and_has_its_licence_in_the_docs() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = ("sim", "ros", "rerun", "evo", "robots", "cluster", "parquet", "vision")
    needed = {"": project["dependencies"], **{extra: project["optional-dependencies"][extra] for extra in extras}}
    table = (ROOT / "docs" / "reference" / "dependencies.md").read_text()
    rows = dict(re.findall(r"^\| ([\w.-]+) \| [^|]+ \| (?:`(\w+)`)? ?\| [^|]+ \|$", table, re.MULTILINE))
    rows.pop("library", None)
    names = {re.split(r"[>=<]", item)[0]: extra for extra, items in needed.items() for item in items}
    assert rows == names
    # Of calendar versions none says when something changes.
    assert [item for items in needed.values() for item in items if "<" not in item] == ["distributed>=2025.1"]


def test_the_oldest_versions_are_those_that_are_allowed() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = [line for line in (ROOT / ".ci" / "oldest.txt").read_text().splitlines() if not line.startswith("#")]
    oldest = dict(line.split("==") for line in lines)
    for item in [*project["dependencies"], *project["optional-dependencies"]["sim"]]:
        name, least = re.split(r">=|,", item)[:2]
        assert oldest[name] == least or oldest[name].startswith(f"{least}."), name
