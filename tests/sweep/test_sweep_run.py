"""Sweeps from end to end in this process: tables, resuming, failures as rows, the same bytes on every executor."""

from __future__ import annotations

import csv
import io
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from extras import requires
from sweep_examples import ROOT, SMALL, Inline

from micah_plan.documents.problem import load_problem
from micah_plan.documents.sweep import sweep_of
from micah_plan.errors import InputError, MissingDependencyError
from micah_plan.execution.trials import run_trials
from micah_plan.planning.solver import solve
from micah_plan.sweep import solve_case as worker
from micah_plan.sweep.run import SweepStoppedError, run_sweep
from micah_plan.sweep.solve_case import WorkerFilesError, solve_case
from micah_plan.sweep.workers import ProcessWorkers
from micah_plan.task.sweep import Case, Sweep


def small(**changes: Any) -> Sweep:
    return sweep_of({**SMALL, **changes}, ROOT)


def rows(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(content.decode())))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Sweep, Path, bytes]:
    """A sweep with trials, where its table is, and the table's content."""
    sweep = small(execute={"trials": 1})
    output = tmp_path_factory.mktemp("undisturbed") / "r.csv"
    run_sweep(sweep, output, executor=Inline())
    return sweep, output, output.read_bytes()


def test_a_row_equals_solving_and_executing_by_hand(undisturbed: tuple[Sweep, Path, bytes]) -> None:
    row = rows(undisturbed[2])[3]
    overrides = {"start.std.drawer": 0.01, "planner.verification_trials": 40, "confidence": 0.8}
    problem = load_problem(ROOT / "problems" / "drawer_close.yaml", overrides)
    plan = solve(problem, seed=1)
    statistics = run_trials(problem, plan, trials=1, seed=1)
    assert list(row)[:6] == ["case", "problem", *overrides, "seed"]
    assert (row["case"], row["seed"], row["start.std.drawer"], row["outcome"]) == ("3", "1", "0.01", "solved")
    assert row["modes"] == " > ".join(plan.mode_sequence)
    assert float(row["cost"]) == plan.cost
    assert float(row["success_probability"]) == plan.success_probability
    assert int(row["successes"]) == statistics.successes
    assert float(row["final_error_max"]) == statistics.final_error.max


def test_any_executor_gives_the_same_bytes(undisturbed: tuple[Sweep, Path, bytes], tmp_path: Path) -> None:
    with ThreadPoolExecutor(3) as executor:
        run_sweep(undisturbed[0], tmp_path / "r.csv", executor=executor)
    assert (tmp_path / "r.csv").read_bytes() == undisturbed[2]


def test_times_are_apart(undisturbed: tuple[Sweep, Path, bytes]) -> None:
    timed = rows(undisturbed[1].with_name("r.timings.csv").read_bytes())
    assert [row["case"] for row in timed] == ["0", "1", "2", "3"]
    for row in timed:
        stages = [float(row[f"{stage}_s"]) for stage in ("load", "solve", "execute")]
        assert 0 < sum(stages) <= float(row["total_s"])
        assert row["attempts"] == "1"


def test_a_sweep_that_was_interrupted_goes_on_and_does_nothing_twice(
    undisturbed: tuple[Sweep, Path, bytes], tmp_path: Path
) -> None:
    sweep, content = undisturbed[0], undisturbed[2]
    output, journal = tmp_path / "r.csv", tmp_path / "r.csv.journal"

    def interrupt(text: str, _: float) -> None:
        if text.startswith("2 of 4"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep, output, executor=Inline(), progress=interrupt)
    assert not output.exists()
    with journal.open("ab") as file:
        file.write(b'{"key": "torn", "resu')
    executor, told = Inline(), list[str]()
    done = run_sweep(sweep, output, executor=executor, progress=lambda text, _: told.append(text))
    assert (executor.submitted, done.resumed) == (2, 2)
    assert told[0] == "2 of 4 cases (2 from before)"
    assert told[-1] == "4 of 4 cases (2 from before, 2 solved)"
    assert output.read_bytes() == content


def test_a_finished_sweep_is_not_done_again_and_more_seeds_are_added(
    undisturbed: tuple[Sweep, Path, bytes], tmp_path: Path
) -> None:
    (tmp_path / "r.csv.journal").write_bytes(undisturbed[1].with_name("r.csv.journal").read_bytes())
    executor = Inline()
    run_sweep(undisturbed[0], tmp_path / "r.csv", executor=executor)
    assert executor.submitted == 0
    assert (tmp_path / "r.csv").read_bytes() == undisturbed[2]
    more = run_sweep(small(execute={"trials": 1}, seeds=3), tmp_path / "r.csv", executor=executor)
    assert (executor.submitted, more.resumed, len(more.results)) == (2, 4, 6)


def test_failures_are_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:

    def failing(problem: Any, *, seed: int, advise: bool) -> Any:
        if problem.goal.target[0][1] == 0.1:
            raise ZeroDivisionError("of\nall things")
        return solve(problem, seed=seed, advise=advise)

    monkeypatch.setattr(worker, "solve", failing)
    limits = {"goal.target.drawer.value": [0.05, 9.0, 0.1], "planner.solve_time_limit_s": [1e-6], "confidence": [0.8]}
    run_sweep(small(grid=limits, seeds=1, execute={"trials": 1}), tmp_path / "r.csv", executor=Inline())
    limited, impossible, broken = rows((tmp_path / "r.csv").read_bytes())
    assert limited["outcome"] == "no_plan"
    assert "time limit of 1e-06 s" in limited["reason"]
    assert impossible["outcome"] == "bad_input"
    assert "the nearest possible value is" in impossible["reason"]
    assert str(ROOT) not in impossible["reason"]
    assert (broken["outcome"], broken["reason"]) == ("error", "ZeroDivisionError: of all things")
    assert {row["successes"] for row in (limited, impossible, broken)} == {""}


def test_workers_must_see_the_files_of_the_sweep(tmp_path: Path) -> None:
    case = next(small().cases())
    with pytest.raises(WorkerFilesError, match="a worker cannot read a problem"):
        solve_case(Case(case.problem, tmp_path / "no.yaml", case.digests, case.overrides, 0))
    with pytest.raises(WorkerFilesError, match="the model file is not the one"):
        solve_case(Case(case.problem, case.path, {**case.digests, "model": "0"}, case.overrides, 0))


def test_a_closed_executor_stops_the_sweep_with_one_line(tmp_path: Path) -> None:
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(SweepStoppedError, match=r"cannot run cases .*give the command again to go on"):
        run_sweep(small(), tmp_path / "r.csv", executor=executor)


@requires("parquet")
def test_parquet_holds_the_same_table(undisturbed: tuple[Sweep, Path, bytes], tmp_path: Path) -> None:
    from pyarrow import parquet

    (tmp_path / "r.parquet.journal").write_bytes(undisturbed[1].with_name("r.csv.journal").read_bytes())
    run_sweep(undisturbed[0], tmp_path / "r.parquet", executor=Inline())
    table = parquet.read_table(tmp_path / "r.parquet")
    expected = rows(undisturbed[2])
    assert table.column_names == list(expected[0])
    assert [str(kind) for kind in table.schema.types[:5]] == ["int64", "string", "double", "double", "double"]
    for row, shown in zip(table.to_pylist(), expected, strict=True):
        for name, value in row.items():
            assert (type(value)(shown[name]) if value is not None else None) == value, name


def test_parquet_without_its_library_is_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    executor = Inline()
    with pytest.raises(MissingDependencyError, match=r"pip install 'pyarrow"):
        run_sweep(small(), tmp_path / "r.parquet", executor=executor)
    assert executor.submitted == 0
    assert list(tmp_path.iterdir()) == []


def test_outputs_destroy_nothing(tmp_path: Path) -> None:
    executor = Inline()
    for name, said in (("r.txt", "must end in"), ("no/r.csv", "its directory does not exist")):
        with pytest.raises(InputError, match=said):
            run_sweep(small(), tmp_path / name, executor=executor)
    (tmp_path / "r.csv.journal").write_text("my notes\n")
    with pytest.raises(InputError, match="is no journal of a sweep"):
        run_sweep(small(), tmp_path / "r.csv", executor=executor)
    assert (tmp_path / "r.csv.journal").read_text() == "my notes\n"
    assert executor.submitted == 0


@pytest.mark.slow
def test_a_process_pool_does_not_outlive_its_owner() -> None:
    workers = ProcessWorkers(1)
    process = workers._first_begun.result()
    workers.close()
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
