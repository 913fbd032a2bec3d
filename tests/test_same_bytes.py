"""The same files and seed give the same bytes, whatever the hash seed, threads, locale, time zone and folder are."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = {"PYTHONHASHSEED": "0", "TZ": "UTC", "LC_ALL": "C", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
THERE = {
    "PYTHONHASHSEED": "4242",
    "TZ": "Asia/Kolkata",
    "LC_ALL": "C.UTF-8",
    "LANG": "de_DE.UTF-8",
    "OMP_NUM_THREADS": "2",
    "OPENBLAS_NUM_THREADS": "2",
    "COLUMNS": "60",
}
COMMANDS = (
    "learn ROOT/examples/demonstrations/microwave.csv --parts ROOT/models/parts/microwave.yaml -o door.yaml "
    "--figure segments.png --html recording.html",
    "solve ROOT/problems/microwave_close.yaml --model door.yaml -o plan.json --html plan.html --figure plan.png",
    "execute plan.json --trials 3 -o runs.csv --html runs.html --figure runs.png",
    "predict door.yaml runs.csv --html predicted.html",
    "calibrate door.yaml runs.csv -o better.yaml --html report.html",
    "show door.yaml -o shown.html --scene scene.html",
    "convert plan.json trajectory.json",
    "convert door.yaml door.urdf",
    "convert door.yaml door.xml",
    "convert runs.csv runs.npz",
)


def made(folder: Path, root: Path, environment: dict[str, str]) -> dict[str, bytes]:
    """The content of every file that the commands write in a folder."""
    folder.mkdir(parents=True)
    for line in COMMANDS:
        command = [sys.executable, "-m", "micah_plan", *line.replace("ROOT", str(root)).split()]
        variables = os.environ | environment | {"PYTHONPATH": str(root)}
        done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{line}\n{done.stderr}"
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir()) if "timings" not in file.name}


@pytest.mark.slow
def test_nothing_around_the_files_changes_a_byte(tmp_path: Path, repository: Path) -> None:
    first = made(tmp_path / "a", repository, HERE)
    second = made(tmp_path / "a longer place" / "büro", repository, THERE)
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []
    assert len(first) >= 18
