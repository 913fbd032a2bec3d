"""Experiments: what is written is commanded, whatever is measured, and the log is that of any execution."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from execution_objects import drawer

from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.open_loop import carry_out
from micah_plan.execution.plant import PlantError
from micah_plan.recording.read import read_recording
from micah_plan.task.experiment import Experiment, Motion
from micah_plan.task.start import Start

COMMANDS = ((0.03,), (0.03,), (0.0,), (-0.02,))


def experiment(repetitions: int = 2) -> Experiment:
    starts = Start((0.05,), (0.004,), "sliding"), Start((0.15,), (0.004,), "sliding")
    return Experiment(drawer(), tuple(Motion(start, COMMANDS) for start in starts), repetitions)


def test_commands_are_given_as_written() -> None:
    given = []

    class Noted(NominalPlant):
        def apply(self, command):
            given.append(float(command.input[0]))
            return super().apply(command)

    log, failures = carry_out(experiment(), plant=lambda problem: Noted.of(problem))
    assert given == [u for (u,) in COMMANDS] * 4
    assert failures == ()
    assert log.runs == (0, 1, 2, 3)
    starts = [float(log.select(run=run).position[0, 0]) for run in log.runs]
    assert np.ptp(starts[:2]) < 0.05 < starts[2] - starts[0]
    action = np.linalg.norm(log.select(run=0).action, axis=1)
    assert action[:-1] == pytest.approx([abs(u) for (u,) in COMMANDS])
    assert np.isnan(action[-1])
    assert {"estimate_x", "true_drawer"} <= set(log.extra)


def test_one_seed_gives_one_log() -> None:
    first, again, other = (carry_out(experiment(1), seed=seed)[0] for seed in (3, 3, 4))
    assert np.array_equal(first.position, again.position)
    assert not np.array_equal(first.position, other.position)


def test_a_machine_that_fails_ends_its_run_only() -> None:
    class Failing(NominalPlant):
        applied = 0

        def apply(self, command):
            self.applied += 1
            if self.applied == 2:
                raise PlantError("it slipped")
            return super().apply(command)

    log, failures = carry_out(experiment(), plant=lambda problem: Failing.of(problem))
    assert failures == (
        (0, "the machine failed in step 2: it slipped"),
        (2, "the machine failed in step 2: it slipped"),
    )
    assert [len(log.select(run=run).time) for run in log.runs] == [2, 5, 2, 5]


@pytest.mark.slow
def test_the_command_carries_out_an_experiment(repository, tmp_path) -> None:
    file = repository / "problems" / "experiments" / "drawer.yaml"
    output = tmp_path / "runs.csv"

    def execute(*options):
        command = [sys.executable, "-m", "micah_plan", "execute", str(file), "-o", str(output), *options]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    done = execute("--trials", "1", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["trials"] == 2
    assert read_recording(output).runs == (0, 1)
    refused = execute("--html", str(tmp_path / "page.html"))
    assert refused.returncode == 2
    assert "--html is for plans, this is an experiment" in refused.stderr
