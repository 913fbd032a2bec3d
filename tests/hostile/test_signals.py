"""Signals at any moment of a command: the machine is closed, what was measured is kept, no file is half-written.

Of evidence are twenty moments of each command; of the blocking ones are three.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from micah_plan.cli.interrupted import INTERRUPTED

# A machine that says when it is made and closed, and takes its time.
MACHINE = """
import time
from pathlib import Path

from micah_plan.execution.handle import NominalHandle
from micah_plan.execution.nominal import NominalPlant
from micah_plan.task.problem import Problem


class Slow:
    def __init__(self, asked):
        is_problem = isinstance(asked, Problem)
        self.plant = NominalPlant.of(asked) if is_problem else NominalHandle(asked.simulated)
        Path("made").write_text("")

    def reset(self, rng):
        return self.plant.reset(rng)

    def apply(self, command):
        time.sleep(0.05)
        return self.plant.apply(command)

    def close(self):
        Path("closed").write_text("")
"""
SWEEP = """
format: micah-plan/sweep/1
problems: [{repository}/problems/drawer_open.yaml]
seeds: 20
"""
COMMANDS = {
    "learn": "learn {repository}/examples/demonstrations/cabinet.csv -o out.yaml --html out.html",
    "solve": "solve {repository}/problems/cabinet_close.yaml -o out.json --html out.html",
    "execute": "execute plan.json --plant machine.py:Slow --trials 3 -o out.csv",
    "calibrate": "calibrate {repository}/models/drawer.yaml runs.csv -o out.yaml --html out.html",
    "explore": "explore {repository}/problems/explore_handle.yaml --plant machine.py:Slow -o out.yaml --html out.html",
    "sweep": "sweep sweep.yaml -o table.csv",
}
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def command(words: str, repository: Path) -> list[str]:
    return [sys.executable, "-m", "micah_plan", *words.format(repository=repository).split()]


@pytest.fixture(scope="module")
def prepared(tmp_path_factory, repository) -> Path:
    folder = tmp_path_factory.mktemp("signals")
    (folder / "machine.py").write_text(MACHINE)
    (folder / "sweep.yaml").write_text(SWEEP.format(repository=repository))
    for line in (
        "solve {repository}/problems/drawer_open.yaml -o plan.json",
        "execute plan.json --trials 8 -o runs.csv",
    ):
        subprocess.run(command(line, repository), cwd=folder, check=True, capture_output=True)
    return folder


def interrupted(words: str, prepared: Path, repository: Path, place: Path, after: float, number: int) -> None:
    """Start a command in a folder of its own, send it a signal after so many seconds, and look at what is left."""
    place.mkdir()
    for name in ("machine.py", "sweep.yaml", "plan.json", "runs.csv"):
        (place / name).symlink_to(prepared / name)
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # these tests may run under nohup
    try:
        process = subprocess.Popen(
            command(words, repository), cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
    finally:
        signal.signal(signal.SIGHUP, before)
    time.sleep(after)
    process.send_signal(number)
    _, errors = process.communicate(timeout=120)
    # Until the package is loaded that handles it, Ctrl-C ends Python as it ends any script.
    assert "Traceback" not in errors or "micah_plan/cli/" not in errors, errors
    # Before Python itself can be told, a signal ends it as the system has it. And what is interrupted within `exec` of
    # a string, as where a dataclass is made, ends by SIGINT (CPython's `unhandled_keyboard_interrupt`): 130 in a shell.
    assert process.returncode in (0, INTERRUPTED, -number, -signal.SIGINT), errors
    if (place / "made").exists():
        assert (place / "closed").exists(), errors
    left = sorted(path.name for path in place.iterdir() if not path.is_symlink())
    assert not [name for name in left if name.startswith((".", "tmp")) or name.endswith((".part", ".tmp"))], left
    whole = [place / name for name in left if name in ("out.yaml", "out.json", "out.csv")]
    for path in whole:
        checked = subprocess.run(command(f"check {path}", repository), capture_output=True, text=True, check=False)
        assert checked.returncode == 0, (path, checked.stderr)
    for page in place.glob("out.html"):
        assert page.read_text().rstrip().endswith("</html>")


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_signal_leaves_nothing_half_done(name, prepared, repository, tmp_path) -> None:
    for i, number in enumerate(SIGNALS):
        interrupted(COMMANDS[name], prepared, repository, tmp_path / str(i), 0.5 + 0.4 * i, number)


@pytest.mark.evidence
@pytest.mark.parametrize("name", COMMANDS)
def test_a_signal_at_twenty_moments_leaves_nothing_half_done(name, prepared, repository, tmp_path) -> None:
    rng = np.random.default_rng(len(name))
    for i in range(20):
        number = SIGNALS[i % len(SIGNALS)]
        interrupted(COMMANDS[name], prepared, repository, tmp_path / str(i), float(rng.uniform(0.05, 2.5)), number)


LOADED = """
import signal
import micah_plan.planning.search
signal.signal(signal.SIGALRM, signal.default_int_handler)
signal.setitimer(signal.ITIMER_REAL, {after})
try:
    import micah_plan.planning.search.ompl_library
except KeyboardInterrupt:
    print("interrupted")
signal.setitimer(signal.ITIMER_REAL, 0.0)
import micah_plan.planning.search.ompl_library
"""


def test_a_signal_while_ompl_is_loaded_is_handled_when_it_is() -> None:
    ends = [
        subprocess.run([sys.executable, "-c", LOADED.format(after=after)], capture_output=True, text=True, check=False)
        for after in np.linspace(0.005, 0.06, 8)
    ]
    assert [(end.returncode, end.stderr) for end in ends] == [(0, "")] * len(ends)
    assert any(end.stdout == "interrupted\n" for end in ends)


DROPPED = """
import signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background of a shell ignores it
from micah_plan.cli.interrupted import repeat_dropped_interruptions
repeat_dropped_interruptions()

class Interrupted:
    def __del__(self):
        raise {error}

Interrupted()
try:
    for _ in range(100):
        time.sleep(0.02)
    print("nothing")
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.parametrize(("error", "printed"), [("KeyboardInterrupt", "interrupted"), ("ValueError", "nothing")])
def test_an_interruption_that_python_drops_comes_again(error, printed) -> None:
    end = subprocess.run(
        [sys.executable, "-c", DROPPED.format(error=error)], capture_output=True, text=True, check=True
    )
    assert end.stdout == f"{printed}\n"
    assert ("Traceback" in end.stderr) == (error == "ValueError")
