"""Real processes and a real Dask cluster, killed on the way: nothing is lost, repeated or different."""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from extras import requires, skip_without
from sweep_examples import ROOT, Inline

from micah_plan.documents.sweep import load_sweep, sweep_of
from micah_plan.sweep.result import results_table
from micah_plan.sweep.run import run_sweep
from micah_plan.sweep.solve_case import solve_case

pytestmark = pytest.mark.slow
CASES, MOST_SECONDS = 30, 120.0
SWEEP = f"""
format: micah-plan/sweep/1
problems: [{ROOT}/problems/drawer_close.yaml]
grid:
  start.std.drawer: [0.004, 0.01]
  planner.verification_trials: [100]
seeds: {CASES // 2}
"""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    """The sweep's file, and its table when it is made in one process and one go."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "sweep.yaml").write_text(SWEEP)
    run_sweep(load_sweep(folder / "sweep.yaml"), folder / "r.csv", executor=Inline())
    return folder / "sweep.yaml", (folder / "r.csv").read_bytes()


def listen_to_interrupts() -> None:
    """Tests that run in the background of a shell ignore them, and so would the command that they start."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start(sweep: Path, output: Path, *options: str) -> subprocess.Popen[str]:
    """The command, leader of a process group of its own, as a terminal starts it."""
    command = [sys.executable, "-m", "micah_plan", "sweep", str(sweep), "-o", str(output), *options]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,
        cwd=output.parent,
        preexec_fn=listen_to_interrupts,
    )


def lines_of(output: Path) -> int:
    journal = output.with_name(f"{output.name}.journal")
    return journal.read_bytes().count(b"\n") if journal.exists() else 0


def wait_for(condition: object, what: str) -> None:
    begin = time.monotonic()
    while not condition():  # type: ignore[operator]
        assert time.monotonic() - begin < MOST_SECONDS, f"waited in vain for {what}"
        time.sleep(0.02)


def is_gone(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


def children(process: int) -> list[int]:
    """The spawned workers among the children of a process."""
    listed = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [int(child) for child in listed if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


def test_killed_then_interrupted_then_finished(undisturbed: tuple[Path, bytes], tmp_path: Path) -> None:
    sweep, expected = undisturbed
    output = tmp_path / "r.csv"
    first = start(sweep, output, "--workers", "2")
    wait_for(lambda: lines_of(output) >= 6, "five finished cases")
    first.kill()
    first.communicate()
    wait_for(lambda: is_gone(first.pid), "the workers of a killed sweep to end")
    kept = lines_of(output)
    assert 6 <= kept < CASES
    assert not output.exists()

    second = start(sweep, output, "--workers", "2")
    wait_for(lambda: lines_of(output) >= kept + 5, "five more")
    os.killpg(second.pid, signal.SIGINT)
    said, error = second.communicate(timeout=MOST_SECONDS)
    assert (second.returncode, said) == (130, "")
    assert re.fullmatch(
        rf"error: interrupted; \d+ of {CASES} cases are finished and kept in {output}.journal; "
        r"give the same command again to go on\n",
        error,
    ), error
    wait_for(lambda: is_gone(second.pid), "its processes to end")
    kept = lines_of(output)
    assert kept < CASES
    assert not output.exists()

    third = start(sweep, output, "--workers", "1")
    said, error = third.communicate(timeout=MOST_SECONDS)
    assert (third.returncode, error) == (0, "")
    assert f"finished {CASES} cases, {kept - 1} of them before in" in said
    assert output.read_bytes() == expected
    assert lines_of(output) == CASES + 1


def test_a_worker_that_is_killed_costs_nothing(undisturbed: tuple[Path, bytes], tmp_path: Path) -> None:
    sweep, expected = undisturbed
    output = tmp_path / "r.csv"
    running = start(sweep, output, "--workers", "2", "--json")
    wait_for(lambda: lines_of(output) >= 4, "three finished cases")
    os.kill(children(running.pid)[0], signal.SIGKILL)
    said, error = running.communicate(timeout=MOST_SECONDS)
    assert (running.returncode, error) == (0, "")
    assert f'"outcomes": {{"solved": {CASES}}}' in said
    assert output.read_bytes() == expected
    timed = csv.DictReader(io.StringIO((tmp_path / "r.timings.csv").read_text()))
    attempts = [int(row["attempts"]) for row in timed]
    assert max(attempts) == 2, "the cases that were in flight were tried once more"


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A Dask scheduler and three workers, each a process: its address, and the workers."""
    skip_without("cluster")
    folder = tmp_path_factory.mktemp("cluster")
    file = folder / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]

    def begin(*options: str) -> subprocess.Popen[bytes]:
        command = [*dask, *options, "--no-dashboard"]
        return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    begun = [begin("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))]
    try:
        wait_for(file.exists, "the scheduler")
        address = re.search(r'"(tcp://[\d.:]+)"', file.read_text())
        assert address is not None
        options = ["--nthreads", "1", "--no-nanny", "--host", "127.0.0.1"]
        begun += [begin("worker", address[1], *options) for _ in range(3)]
        yield address[1], begun[1:]
    finally:
        for process in begun:
            process.kill()
            process.wait()
        shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.evidence
def test_a_dask_cluster_that_loses_a_worker_gives_the_same_table(
    undisturbed: tuple[Path, bytes], cluster: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    from distributed import Client

    sweep, expected = undisturbed
    address, workers = cluster
    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(3, timeout=MOST_SECONDS)
    output = tmp_path / "r.csv"
    running = start(sweep, output, "--scheduler", address)
    wait_for(lambda: lines_of(output) >= 8, "seven finished cases")
    workers[0].kill()
    said, error = running.communicate(timeout=MOST_SECONDS)
    assert running.returncode == 0, error
    assert f"finished {CASES} cases in" in said
    assert output.read_bytes() == expected
    assert workers[0].wait() == -signal.SIGKILL
    assert [worker.poll() for worker in workers[1:]] == [None, None]


@pytest.mark.evidence
@requires("sim")
def test_other_planners_plants_and_orders_leave_no_trace_in_a_process(tmp_path: Path) -> None:
    names = [f"problems/{name}.yaml" for name in ("drawer_open", "microwave_close_by_arm", "drawer_behind_door")]
    grid = {"planner.candidates": [1, 2], "planner.verification_trials": [100]}
    execute = {"plant": "mujoco", "trials": 1}
    sweep = sweep_of({"format": "micah-plan/sweep/1", "problems": names, "grid": grid, "execute": execute}, ROOT)
    run_sweep(sweep, tmp_path / "r.csv", workers=2)
    cases = list(sweep.cases())
    backwards = {case.key: solve_case(case).result for case in reversed(cases)}
    assert (
        results_table(sweep, cases, [backwards[case.key] for case in cases], ".csv")
        == (tmp_path / "r.csv").read_bytes()
    )
    assert {result.outcome for result in backwards.values()} == {"solved"}


def test_a_script_whose_workers_cannot_start_is_reported_so(undisturbed: tuple[Path, bytes], tmp_path: Path) -> None:
    script = f"""
from micah_plan.documents.sweep import load_sweep
from micah_plan.sweep.run import run_sweep
run_sweep(load_sweep({str(undisturbed[0])!r}), "r.csv", workers=1)
"""
    (tmp_path / "script.py").write_text(script)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=MOST_SECONDS, check=False
    )
    assert done.returncode == 1
    assert "no worker process can start; a script that runs a sweep must do it below" in done.stderr
    assert lines_of(tmp_path / "r.csv") == 1, "no case was given up"


@pytest.mark.evidence
@requires("cluster")
def test_no_scheduler_is_one_line(undisturbed: tuple[Path, bytes], tmp_path: Path) -> None:
    running = start(undisturbed[0], tmp_path / "r.csv", "--scheduler", "tcp://127.0.0.1:9")
    said, error = running.communicate(timeout=MOST_SECONDS)
    assert (running.returncode, said) == (2, "")
    assert error.startswith("error: no Dask scheduler answers at tcp://127.0.0.1:9 (")
    assert len(error.splitlines()) == 1
