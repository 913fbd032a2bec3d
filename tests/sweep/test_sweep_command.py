"""`micah-plan sweep` as a command: what it counts, prints and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from sweep_examples import ROOT, Inline
from typer.testing import CliRunner, Result

from micah_plan.cli.application import app
from micah_plan.documents.sweep import load_sweep
from micah_plan.errors import InputError
from micah_plan.sweep.run import run_sweep

SWEEP = f"""
format: micah-plan/sweep/1
problems: [{ROOT}/problems/drawer_close.yaml]
grid: {{planner.verification_trials: [20, 40], confidence: [0.8, 3]}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "sweep.yaml").write_text(SWEEP.replace("0.8, 3", "0.8"))
    return tmp_path / "sweep.yaml"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["sweep", *map(str, arguments)])


def test_a_dry_run_counts_and_writes_nothing(file: Path) -> None:
    done = run(file, "--dry-run", "--json")
    assert json.loads(done.stdout) == {
        "problems": 1,
        "grid": {"planner.verification_trials": 2, "confidence": 1},
        "seeds": 1,
        "cases": 2,
        "finished": 0,
    }
    assert [path.name for path in file.parent.iterdir()] == ["sweep.yaml"]


@pytest.mark.slow
def test_a_finished_sweep_is_counted_and_printed(file: Path) -> None:
    output = file.with_name("r.csv")
    run_sweep(load_sweep(file), output, executor=Inline())
    assert run(file, "-o", output, "--dry-run").stdout.endswith("\n  finished  2\n")
    said = json.loads(run(file, "-o", output, "--json").stdout)
    assert (said["cases"], said["resumed"], said["outcomes"]) == (2, 2, {"solved": 2})
    assert said["files"] == [str(file.with_name(name)) for name in ("r.csv", "r.timings.csv", "r.csv.journal")]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "no file for the results; name one with -o, or only count with --dry-run"),
        (("-o", "r.csv", "--workers", "2", "--scheduler", "a"), "--workers and --scheduler exclude each other"),
        (("-o", "r.json"), "-o must end in .csv or .parquet"),
    ],
)
def test_wrong_options_are_one_line(file: Path, options: tuple[str, ...], said: str) -> None:
    done = run(file, *options)
    assert isinstance(done.exception, InputError)
    assert said in str(done.exception)


def test_a_fault_of_the_sweep_is_reported_before_anything_is_solved(file: Path) -> None:
    file.write_text(SWEEP)
    done = run(file, "-o", file.with_name("r.csv"))
    assert isinstance(done.exception, InputError)
    assert "key 'grid.confidence.1'" in str(done.exception)
    assert [path.name for path in file.parent.iterdir()] == ["sweep.yaml"]
