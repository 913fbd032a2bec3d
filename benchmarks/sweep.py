"""500 small problems: killed twice and resumed, against undisturbed runs; throughput on processes and a Dask cluster.

    python -m benchmarks sweep [--cases 500] [--json FILE]

Two drawer problems, five goals, five uncertainties of the start, and seeds. Every run is `micah-plan sweep` in its own
process. Of the disturbed runs, one is killed (SIGKILL) when a third and again when two thirds of its cases are in
the journal; the other is on a Dask cluster of three workers, of which one is killed after a third. All tables must be
the same bytes. CPU time is that of all processes of a run, the cluster's too; those that were killed are left out.
"""

from __future__ import annotations

import argparse
import csv
import re
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from saving import add_json, save_json

ROOT = Path(__file__).resolve().parent.parent
SWEEP = """
format: micah-plan/sweep/1
problems: [{root}/problems/drawer_open.yaml, {root}/problems/drawer_close.yaml]
grid:
  goal.target.drawer.value: [0.05, 0.1, 0.15, 0.2, 0.25]
  start.std.drawer: [0.002, 0.005, 0.01, 0.015, 0.02]
seeds: {seeds}
"""
COMBINATIONS = 50


@dataclass(frozen=True)
class Run:
    """One way through the sweep.

    Attributes:
        name: what it ran on, and what happened to it.
        seconds: wall-clock time from start to table [s].
        cpu_seconds: of all processes that ended by themselves or with the run [s].
        cases_per_second: over the wall-clock time.
        busy: share of that time that a worker spent on cases that were finished, on average over the workers.
        same: whether its table is that of the first run, byte for byte.
        repeated: cases that the journal has twice.
    """

    name: str
    seconds: float
    cpu_seconds: float
    cases_per_second: float
    busy: float
    same: bool
    repeated: int


@dataclass(frozen=True)
class Way:
    """How the sweep is run.

    Attributes:
        name: what it runs on, and what happens to it.
        options: of the command.
        kills: numbers of finished cases at which the command is killed.
        dask_workers: of a cluster; 0: none.
        worker_dies: number of finished cases at which one of them is killed.
    """

    name: str
    options: tuple[str, ...] = ()
    kills: tuple[int, ...] = ()
    dask_workers: int = 0
    worker_dies: int | None = None


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Throughput of sweeps, and what kills cost.")
    parser.add_argument("--cases", type=int, default=500, help=f"at least {COMBINATIONS}; rounded down to a multiple")
    add_json(parser)
    options = parser.parse_args(arguments)
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sweep.yaml").write_text(SWEEP.format(root=ROOT, seeds=max(1, options.cases // COMBINATIONS)))
        cases = COMBINATIONS * max(1, options.cases // COMBINATIONS)
        runs = [_run(folder, number, way, cases) for number, way in enumerate(_ways(cases))]
        outcomes = _outcomes(folder / "0.csv")
        print(f"{cases} cases: {dict(outcomes)}")
    save_json({"cases": cases, "outcomes": dict(outcomes), "runs": [asdict(run) for run in runs]}, options.json)


def _ways(cases: int) -> tuple[Way, ...]:
    third, two_thirds = cases // 3, 2 * cases // 3
    return (
        Way("1 process", ("--workers", "1")),
        Way("2 processes", ("--workers", "2")),
        Way("2 processes, killed twice", ("--workers", "2"), kills=(third, two_thirds)),
        Way("Dask, 2 workers", dask_workers=2),
        Way("Dask, 3 workers, one killed", dask_workers=3, worker_dies=third),
    )


def _run(folder: Path, number: int, way: Way, cases: int) -> Run:
    output = folder / f"{number}.csv"
    cpu = _cpu_seconds()
    with _cluster(folder, way.dask_workers) as (options, workers):
        begin = time.perf_counter()
        for kill in way.kills:
            process = _start(folder, output, way.options)
            _wait_for_lines(output, kill, process)
            process.kill()
            process.wait()
        process = _start(folder, output, (*way.options, *options))
        if way.worker_dies is not None:
            _wait_for_lines(output, way.worker_dies, process)
            workers[0].kill()
        if process.wait() != 0:
            sys.exit(f"{way.name}: the sweep ended with code {process.returncode}")
        seconds = time.perf_counter() - begin
    keys = re.findall(rb'^{"key": "(\w+)"', _journal(output), re.MULTILINE)
    if len(set(keys)) != cases:
        sys.exit(f"{way.name}: {len(set(keys))} of {cases} cases are in the journal")
    same = output.read_bytes() == (folder / "0.csv").read_bytes()
    busy = _solving_seconds(folder / f"{number}.timings.csv") / (seconds * (way.dask_workers or int(way.options[1])))
    run = Run(way.name, seconds, _cpu_seconds() - cpu, cases / seconds, busy, same, len(keys) - len(set(keys)))
    print(
        f"{run.name:<28} {run.seconds:7.1f} s {run.cpu_seconds:7.1f} s CPU {run.cases_per_second:6.2f} cases/s "
        f"{100 * run.busy:4.0f} % busy  "
        f"{'same bytes' if run.same else 'OTHER BYTES'}, {run.repeated} repeated",
        flush=True,
    )
    return run


def _start(folder: Path, output: Path, options: Sequence[str]) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "micah_plan", "sweep", "sweep.yaml", "-o", str(output), *options]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)  # noqa: S603 - our own command


@contextmanager
def _cluster(folder: Path, count: int) -> Iterator[tuple[tuple[str, ...], list[subprocess.Popen[bytes]]]]:
    """Options of the command that lead to a Dask cluster of so many workers, and these; nothing for none."""
    if count == 0:
        yield (), []
        return
    file = folder / f"scheduler_{count}.json"
    begun = [_dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))]
    try:
        while not file.exists():
            time.sleep(0.1)
        address = re.findall(r"tcp://[\d.:]+", file.read_text())[0]
        options = ("--nthreads", "1", "--no-nanny", "--host", "127.0.0.1")
        begun.extend([_dask("worker", address, *options) for _ in range(count)])
        from distributed import Client

        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(count)
        yield ("--scheduler", address), begun[1:]
    finally:
        for process in begun:
            process.terminate()
            process.wait()


def _dask(*options: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "dask", *options, "--no-dashboard"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # noqa: S603 - likewise


def _wait_for_lines(output: Path, finished: int, process: subprocess.Popen[bytes]) -> None:
    """Until so many cases are in the journal."""
    while _journal(output).count(b"\n") <= finished:
        if process.poll() is not None:
            sys.exit("the sweep ended before it could be disturbed")
        time.sleep(0.05)


def _journal(output: Path) -> bytes:
    path = output.with_name(f"{output.name}.journal")
    return path.read_bytes() if path.exists() else b""


def _cpu_seconds() -> float:
    """Of all processes that this one started and that have ended, and of theirs [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _solving_seconds(timings: Path) -> float:
    """Over all cases, from loading to the result [s]."""
    with timings.open(newline="") as file:
        return sum(float(row["total_s"]) for row in csv.DictReader(file))


def _outcomes(table: Path) -> Counter[str]:
    with table.open(newline="") as file:
        return Counter(row["outcome"] for row in csv.DictReader(file))


if __name__ == "__main__":
    main()
