"""The page on the recording format says what is so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from micah_plan.errors import InputError
from micah_plan.recording.checks import KNOWN
from micah_plan.recording.csv_file import read_csv


def test_the_example_on_the_page_is_a_recording(repository: Path, tmp_path: Path) -> None:
    page = (repository / "docs" / "concepts" / "recording.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```text\n(run,.*?)```", page, flags=re.DOTALL)
    path = tmp_path / "example.csv"
    path.write_text(example)
    recording = read_csv(path, minimum_rows=3)
    assert recording.extra == {"operator": ("Ada",) * 3}
    assert recording.has_actions
    table = {name for cell in re.findall(r"^\| `([a-z,]+)` \|", page, flags=re.MULTILINE) for name in cell.split(",")}
    assert table == set(KNOWN)


def test_the_error_on_the_page_is_the_reported_one(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (repository / "docs" / "concepts" / "recording.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^door\.csv, line .*$", page, flags=re.MULTILINE)
    times = [0.05 * row for row in range(38)] + [2.25, 2.1]
    monkeypatch.chdir(tmp_path)
    Path("door.csv").write_text("t,x,y,z\n" + "".join(f"{time},0,0,0\n" for time in times))
    with pytest.raises(InputError) as caught:
        read_csv("door.csv")
    assert str(caught.value) == shown
