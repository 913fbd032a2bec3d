"""A folder of work as a page: what is in it, what cannot be read, and the next command at each stage."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from shell import exit_code
from typer.testing import CliRunner

from micah_plan.api.files import load
from micah_plan.api.folder import page_of, read_folder
from micah_plan.cli.application import app
from micah_plan.errors import InputError, MissingDependencyError

ROOT = Path(__file__).resolve().parents[2]
RECORDING, MODEL = ROOT / "examples" / "demonstrations" / "drawer.csv", ROOT / "models" / "drawer.yaml"
PROBLEM = """\
format: micah-plan/problem/1
model: drawer.yaml
start: {mean: {drawer: 0.03}, std: {drawer: 0.01}}
goal: {target: {drawer: {value: 0.25, tolerance: 0.01}}}
planner: {verification_trials: 200}
"""


def run(*words: object) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_the_next_command_at_each_stage_of_the_work(tmp_path) -> None:
    def step() -> str:
        return read_folder(tmp_path).step[0]

    shutil.copy(RECORDING, tmp_path / "drawer.csv")
    assert step() == "micah-plan learn drawer.csv -o model.yaml --html model.html"
    shutil.copy(MODEL, tmp_path / "drawer.yaml")
    assert step() == "micah-plan new problem task --model drawer.yaml"
    (tmp_path / "task.yaml").write_text(PROBLEM)
    assert step() == "micah-plan solve task.yaml -o plan.json"
    run("solve", tmp_path / "task.yaml", "-o", tmp_path / "plan.json")
    assert step() == "micah-plan execute plan.json -o runs.csv"
    run("execute", tmp_path / "plan.json", "--trials", 2, "-o", tmp_path / "runs.csv")
    assert step() == "micah-plan calibrate drawer.yaml runs.csv -o better.yaml"
    found = read_folder(tmp_path)
    groups = {
        group: [each.file.name for each in found.of(group)] for group in ("recordings", "models", "plans", "runs")
    }
    assert groups == {
        "recordings": ["drawer.csv"],
        "models": ["drawer.yaml"],
        "plans": ["plan.json"],
        "runs": ["runs.csv"],
    }


def test_a_plan_that_failed_is_to_be_explained(tmp_path) -> None:
    shutil.copy(MODEL, tmp_path / "drawer.yaml")
    (tmp_path / "task.yaml").write_text(PROBLEM.replace("trials: 200", "trials: 200, max_knots: 4"))
    assert exit_code("solve", str(tmp_path / "task.yaml"), "-o", str(tmp_path / "plan.json")) == 1
    found = read_folder(tmp_path)
    assert found.step[0] == "micah-plan explain plan.json"
    assert '<p class="badge bad">no plan</p>' in page_of(found)


def test_pages_are_linked_from_their_files_and_names_are_escaped(tmp_path) -> None:
    shutil.copy(MODEL, tmp_path / 'my "<b>" drawer.yaml')
    (tmp_path / 'my "<b>" drawer.html').write_text("page")
    (tmp_path / "talk.html").write_text("page")
    found = read_folder(tmp_path)
    assert [page.name for page in found.files[0].pages] == ['my "<b>" drawer.html']
    assert [page.name for page in found.pages] == ["talk.html"]
    page = page_of(found)
    assert "<b>" not in page
    assert 'href="my%20%22%3Cb%3E%22%20drawer.html"' in page
    assert "<script" not in page


def test_what_cannot_be_read_gives_the_reason_and_does_not_end_it(tmp_path) -> None:
    shutil.copy(MODEL, tmp_path / "drawer.yaml")
    (tmp_path / "broken.yaml").write_text("format: micah-plan/model/1\nmodes: [\n")
    (tmp_path / "mine.csv").write_text("a,b\n1,2\n")
    (tmp_path / "notes.txt").write_text("not read")
    found = read_folder(tmp_path)
    assert [each.file.name for each in found.of("others")] == ["broken.yaml", "mine.csv"]
    assert all(each.value is None and str(each.file) in each.words for each in found.of("others"))
    assert found.step[0].endswith("--model drawer.yaml")


def test_a_missing_library_is_reported_for_its_file_alone(tmp_path, monkeypatch) -> None:
    shutil.copy(MODEL, tmp_path / "drawer.yaml")
    (tmp_path / "log.bag").write_bytes(b"#ROSBAG V2.0")

    def without_library(path: Path) -> object:
        if path.suffix == ".bag":
            raise MissingDependencyError("reading .bag needs the extra 'ros'")
        return load(path)

    monkeypatch.setattr("micah_plan.api.folder.load", without_library)
    found = read_folder(tmp_path)
    assert [each.words for each in found.of("others")] == ["reading .bag needs the extra 'ros'"]
    assert len(found.of("models")) == 1


def test_the_command_writes_the_page_and_names_the_next_command(tmp_path) -> None:
    shutil.copy(MODEL, tmp_path / "drawer.yaml")
    output = tmp_path / "index.html"
    for _ in range(2):  # its own page is no part of it
        assert "next: micah-plan new problem task --model drawer.yaml" in run("show", tmp_path, "-o", output)
    assert "index.html" not in output.read_text()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--picture", "{}/a.png"], "of a folder there is a page only"),
        (["-o", "{}/a.html", "--scene", "{}/b.html"], "of a folder there is a page only"),
        (["-o", "{}/a.html", "--live"], "of a folder there is a page only"),
        (["-o", "{}/a.html"], "the folder has no recording, model, problem or plan"),
    ],
)
def test_what_a_folder_is_not_shown_as(tmp_path, capsys, options, says) -> None:
    assert exit_code("show", str(tmp_path), *(option.format(tmp_path) for option in options)) == 2
    assert says in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_too_many_files_are_refused(tmp_path) -> None:
    for number in range(201):
        (tmp_path / f"{number}.csv").write_text("")
    with pytest.raises(InputError, match="at most 200 files, found 201"):
        read_folder(tmp_path)
