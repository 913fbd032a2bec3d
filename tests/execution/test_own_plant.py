"""The example of a machine in another process: it works, and whatever fails ends safely, with a log and a sentence."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from execution_objects import drawer, pulling

from micah_plan.errors import InputError
from micah_plan.execution.conformance import check_plant
from micah_plan.execution.plant import Command, PlantError
from micah_plan.execution.trials import run_trials
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "own_plant.py"
PULL = Problem(drawer(), Start((0.02,), (0.01,), "sliding"), Goal(((0, 0.25, 0.008),)))
PLAN = Plan("solved", "", pulling())
STEPS = 8


def loaded(name: str = "own_plant"):
    place = importlib.util.spec_from_file_location(name, EXAMPLE)
    module = importlib.util.module_from_spec(place)
    sys.modules[name] = module
    place.loader.exec_module(module)
    return module


ProcessPlant = loaded().ProcessPlant


def is_running(pid: int) -> bool:
    """Whether there is such a process that has not ended; one that nobody has waited for yet has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


class Trials:
    """Trials on a plant with a fault, the plants that were made for them, and what was kept of their logs."""

    def __init__(self, fault: str = "", timeout_s: float = 20.0, trials: int = 1) -> None:
        self.plants, self.kept, self.statistics, self.error = [], [], None, None
        try:
            self.statistics = run_trials(
                PULL, PLAN, plant=lambda p: self.made(p, timeout_s, fault), trials=trials, keep=self.kept.append
            )
        except PlantError as error:
            self.error = error

    def made(self, problem: Problem, timeout_s: float, fault: str):
        self.plants.append(ProcessPlant(problem, timeout_s=timeout_s, fault=fault))
        return self.plants[-1]

    @property
    def has_ended(self) -> bool:
        """Whether the one process that was started has ended."""
        (plant,) = self.plants
        return not is_running(plant.pid)


@pytest.fixture(scope="module")
def untroubled() -> Trials:
    return Trials()


@pytest.mark.slow
def test_a_machine_in_another_process_executes_and_has_no_truth(untroubled) -> None:
    (result,) = untroubled.statistics.results
    assert result.success, result.reason
    assert untroubled.statistics.believed
    assert result.steps == STEPS
    assert result.final_error == PULL.goal.error(result.beliefs[-1].means[0])
    assert not [name for name in result.recording.extra if name.startswith("true_")]
    assert untroubled.has_ended


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        "drop:4",
        "late:1",
        *(pytest.param(one, marks=pytest.mark.evidence) for one in ("drop:1", f"drop:{STEPS + 1}", "late:4")),
    ],
)
def test_a_lost_or_late_reply_changes_nothing(untroubled, fault) -> None:
    """The request is sent again and carried out once: the log is the same to the last bit."""
    found = Trials(fault, timeout_s=1.0)
    assert found.statistics.recording.digest() == untroubled.statistics.recording.digest()
    assert found.has_ended


def test_a_killed_process_ends_the_trial_with_its_log(untroubled) -> None:
    found = Trials("die:4")
    (result,) = found.statistics.results
    assert not result.success
    assert result.reason == "the machine failed in step 3: the machine's process was killed by signal 9"
    assert result.steps == 2
    (log,) = found.kept
    first = untroubled.kept[0].rows(slice(0, 3))
    np.testing.assert_array_equal(log.position, first.position)
    np.testing.assert_array_equal(log.action, first.action)
    assert found.has_ended


def test_a_machine_that_is_gone_cannot_be_reset_and_ends_the_execution() -> None:
    found = Trials("die:4", trials=3)
    assert str(found.error) == "the machine's process was killed by signal 9"
    assert [log.runs for log in found.kept] == [(0,)]
    assert found.has_ended


@pytest.mark.slow
def test_a_machine_that_stays_silent_is_ended() -> None:
    found = Trials("mute:3", timeout_s=0.3)
    (result,) = found.statistics.results
    assert result.reason.endswith("the machine's process did not answer a request that was sent 3 times")
    assert len(found.kept[0]) == 2
    assert found.has_ended


def test_a_stop_of_the_machine_fails_one_trial_and_the_next_one_is_reset() -> None:
    found = Trials("stop:3", trials=2)
    stopped, other = found.statistics.results
    assert found.statistics.failures == ((0, "the machine failed in step 2: the protective stop was pressed"),)
    assert not stopped.success
    assert other.success
    assert found.statistics.recording.runs == (0, 1)
    assert found.has_ended


def test_a_process_that_does_not_start_is_one_sentence(monkeypatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(PlantError, match="the machine's process ended with exit code 1"):
        ProcessPlant(PULL)


def test_what_is_no_reply_is_one_sentence(monkeypatch) -> None:
    plant = ProcessPlant(PULL)
    monkeypatch.setattr(plant, "_line", lambda _: b'{"seq": "one"}')
    with pytest.raises(PlantError, match=r"sent .* which is no reply"):
        plant.apply(Command(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3))))
    assert not is_running(plant.pid)


@pytest.mark.slow
def test_the_process_ends_with_the_client_that_dies() -> None:
    script = f"""
import os, sys
sys.path[:0] = [{str(EXAMPLE.parent)!r}, {str(Path(__file__).parent)!r}]
from own_plant import ProcessPlant
from test_own_plant import PULL
print(ProcessPlant(PULL).pid, flush=True)
os.kill(os.getpid(), 9)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == -9, done.stderr
    for _ in range(600):  # as long as it takes, but not for ever
        if not is_running(int(done.stdout)):
            break
        time.sleep(0.1)
    assert not is_running(int(done.stdout))


@pytest.mark.slow
def test_it_keeps_to_what_a_plant_must_do() -> None:
    plant = ProcessPlant(PULL)
    check_plant(plant, PULL)
    elsewhere = replace(PULL, start=replace(PULL.start, mean=(0.2,)))
    with pytest.raises(InputError, match="drawer"):
        check_plant(plant, elsewhere)
    plant.close()


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory, repository):
    path = tmp_path_factory.mktemp("own") / "plan.json"
    command = [sys.executable, "-m", "micah_plan", "solve", "problems/drawer_open.yaml", "-o", str(path)]
    subprocess.run(command, cwd=repository, check=True, capture_output=True)
    return path


def execute(plan, plant, folder, *options):
    command = [sys.executable, "-m", "micah_plan", "execute", str(plan), "--plant", plant, *options]
    return subprocess.run([*command, "-o", str(folder / "runs.csv")], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_command_line_executes_on_it(plan_file, tmp_path) -> None:
    done = execute(plan_file, f"{EXAMPLE}:ProcessPlant", tmp_path, "--trials", "2", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["believed"] is True
    assert found["successes"] == found["trials"] == 2
    header = (tmp_path / "runs.csv").read_text().splitlines()[0].split(",")
    assert "true_drawer" not in header
    assert {"belief_drawer", "estimate_x", "estimate_qw"} <= set(header)


@pytest.mark.slow
def test_on_the_command_line_a_killed_process_is_one_line_and_the_log_is_kept(plan_file, tmp_path) -> None:
    (tmp_path / "doomed.py").write_text(f"""
import sys
sys.path.append({str(EXAMPLE.parent)!r})
from own_plant import ProcessPlant

def doomed(problem):
    return ProcessPlant(problem, fault="die:4")
""")
    done = execute(plan_file, f"{tmp_path}/doomed.py:doomed", tmp_path, "--trials", "2")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: the machine's process was killed by signal 9; what was logged until then is in ")
    assert len((tmp_path / "runs.csv").read_text().splitlines()) == 1 + 3
