"""`execute --plant`: names, classes in files, registered plants; every mistake is one line, and the log is kept."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import pytest

from micah_plan.cli.plants import ENTRY_POINTS, named_plant
from micah_plan.errors import InputError
from micah_plan.recording.read import read_recording
from micah_plan.task.plants import BUILT_IN

OWN = """
from __future__ import annotations
import os
import signal
import sys
from dataclasses import dataclass
from beside import MISTAKE_AT
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.plant import PlantError

@dataclass
class Own:
    problem: object
    step: int = 0
    def reset(self, rng):
        self.plant = NominalPlant.of(self.problem)
        return self.plant.reset(rng)
    def apply(self, command):
        self.step += 1
        if self.step == MISTAKE_AT:
            self.mistake()
        return self.plant.apply(command)
    def mistake(self):
        pass
    def close(self):
        print("closed", file=sys.stderr)

class Broken(Own):
    def mistake(self):
        raise ValueError("no such register")

class Slips(Own):
    def mistake(self):
        raise PlantError("the gripper lost the handle")

class Stopped(Own):
    def mistake(self):
        raise KeyboardInterrupt

class Terminated(Own):
    def mistake(self):
        os.kill(os.getpid(), signal.SIGTERM)

class HungUp(Own):
    def mistake(self):
        os.kill(os.getpid(), signal.SIGHUP)

class Rude(Own):
    def mistake(self):
        raise PlantError("\x1b]0;title\x07 [/red] the gripper")

class Dead(Own):
    def reset(self, rng):
        if self.step:
            raise PlantError("the protective stop is pressed")
        return super().reset(rng)

class Half:
    def __init__(self, problem):
        print("made", file=sys.stderr)

NUMBER = 3
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory, repository):
    """A folder with a plan and plants of somebody's own."""
    folder = tmp_path_factory.mktemp("plants")
    command = [sys.executable, "-m", "micah_plan", "solve", "problems/drawer_open.yaml", "-o", f"{folder}/plan.json"]
    subprocess.run(command, cwd=repository, check=True, capture_output=True)
    (folder / "own.py").write_text(OWN)
    (folder / "beside.py").write_text("MISTAKE_AT = 3\n")
    package = folder / "installed"
    (package / "robot_plants-1.0.dist-info").mkdir(parents=True)
    code = "from micah_plan.execution.nominal import NominalPlant\nof = NominalPlant.of\n"
    (package / "robot_plants.py").write_text(code)
    (package / "robot_plants-1.0.dist-info" / "METADATA").write_text("Name: robot_plants\nVersion: 1.0\n")
    points = f"[{ENTRY_POINTS}]\nrobot = robot_plants:of\nabsent = no_such_module:Plant\n"
    (package / "robot_plants-1.0.dist-info" / "entry_points.txt").write_text(points)
    return folder


@pytest.fixture
def run(place, tmp_path):
    """Runs `execute`, as in a terminal that hangs up, or under nohup."""

    def run(plant, *options, path="", hangs_up=True):
        command = [sys.executable, *([] if not path else ["-c", _WITH_PATH.format(path=path)])]
        command += [] if path else ["-m", "micah_plan"]
        command += ["execute", "plan.json", "--plant", plant, "-o", f"{tmp_path}/runs.csv", *options]
        # Children take over what is ignored here, and these tests may run under nohup themselves.
        before = signal.signal(signal.SIGHUP, signal.SIG_DFL if hangs_up else signal.SIG_IGN)
        try:
            return subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
        finally:
            signal.signal(signal.SIGHUP, before)

    return run


_WITH_PATH = "import sys; sys.path.append({path!r}); from micah_plan.cli import main; main()"


def told(done, code):
    """The one line of an error, after what the plant said when it was closed."""
    assert done.returncode == code, done.stderr
    *_, line = lines = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert lines[:-1] in ([], ["closed"])
    return line


@pytest.mark.slow
def test_a_class_of_ones_own_is_executed_on_and_success_is_what_is_believed(run, tmp_path):
    done = run("own.py:Own", "--trials", "2")
    assert done.returncode == 0, done.stderr
    assert "2 of 2 trials are believed to have reached the goal (the plant does not know the truth)" in done.stdout
    assert "(believed)" in done.stdout.splitlines()[1]
    assert done.stderr == "closed\n"
    found = json.loads(run("own.py:Own", "--trials", "2", "--json").stdout)
    assert found["believed"] is True
    assert {"trials", "successes", "final_error", "failures", "seconds"} < found.keys()
    extra = read_recording(tmp_path / "runs.csv").extra
    assert "true_drawer" not in extra
    assert {"mode", "belief_drawer", "belief_std_drawer", "estimate_x", "estimate_qw"} <= extra.keys()


@pytest.mark.slow
def test_a_simulation_is_scored_by_its_truth(run, tmp_path):
    found = json.loads(run("nominal", "--json").stdout)
    assert found["believed"] is False
    assert "true_drawer" in read_recording(tmp_path / "runs.csv").extra


@pytest.mark.slow
def test_a_plant_that_a_package_registered_is_known_by_its_name(run, place):
    installed = str(place / "installed")
    done = run("robot", "--json", path=installed)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["successes"] == 1
    assert "loading the plant 'absent' (no_such_module:Plant) raised ModuleNotFoundError" in told(
        run("absent", path=installed), 2
    )
    assert "there is no plant 'clay'; choose among nominal, mujoco, absent, robot, or" in told(
        run("clay", path=installed), 2
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "code", "said", "rows"),
    [
        ("own.py:Broken", 2, ["own.py, line ", "Broken.apply raised ValueError: no such register; what was"], 3),
        ("own.py:Dead", 1, ["error: the protective stop is pressed; what was logged until then is in "], 14),
        ("own.py:Stopped", 130, ["error: interrupted; what was logged until then is in "], 3),
        ("own.py:Terminated", 130, ["error: interrupted; what was logged until then is in "], 3),
        ("own.py:HungUp", 130, ["error: interrupted; what was logged until then is in "], 3),
    ],
)
def test_what_breaks_an_execution_off_is_one_line_and_the_log_is_kept(run, tmp_path, plant, code, said, rows):
    done = run(plant, "--trials", "3")
    line = told(done, code)
    assert done.stderr.startswith("closed\n")
    for words in said:
        assert words in line
    assert str(tmp_path / "runs.csv") in line
    assert abs(len(read_recording(tmp_path / "runs.csv")) - rows) <= 1


@pytest.mark.slow
def test_under_nohup_an_execution_goes_on(run):
    done = run("own.py:HungUp", "--trials", "1", hangs_up=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_what_ends_an_execution_is_json_too_on_request(run):
    done = run("own.py:Broken", "--json")
    assert done.returncode == 2
    assert "Broken.apply raised ValueError" in json.loads(done.stdout)["error"]


@pytest.mark.slow
def test_text_of_a_machine_is_escaped_and_not_sent_to_the_terminal(run):
    done = run("own.py:Rude", "--trials", "1")
    assert "\x1b" not in done.stdout + done.stderr
    assert r"\x1b]0;title\x07 [/red] the gripper" in done.stdout


@pytest.mark.slow
def test_a_machine_that_fails_is_a_failed_trial(run):
    done = run("own.py:Slips", "--trials", "2", "--json")
    assert done.returncode == 0
    found = json.loads(done.stdout)
    assert found["successes"] == 1
    reason = "the machine failed in step 3: the gripper lost the handle"
    assert found["failures"] == [{"trial": 0, "reason": reason, "code": "machine_failed", "missed": []}]


@pytest.mark.slow
def test_what_is_no_plant_is_refused_before_anything_is_made(run):
    assert "Half is no plant: it has no reset(), apply(), close()" in told(run("own.py:Half"), 2)


def test_names_of_the_package_stay_names():
    assert [named_plant(name) for name in BUILT_IN] == list(BUILT_IN)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("clay", "there is no plant 'clay'; choose among nominal, mujoco, or give FILE.py:CLASS"),
        ("own.py", "expected FILE.py:CLASS, found 'own.py'; name the class after a colon"),
        ("nowhere.py:Own", "nowhere.py: the file does not exist; give --plant as FILE.py:CLASS"),
        ("{folder}:Own", "the file does not exist"),
        ("plan.json:Own", "plan.json: expected a Python file"),
        ("own.py:Missing", "own.py: there is no class 'Missing'; check its name"),
        ("own.py:NUMBER", "own.py: NUMBER must be a class or function that is called with the problem. Got int"),
        ("cut.py:Own", "cut.py, line 2: loading it raised SyntaxError: "),
        ("raises.py:Own", "raises.py, line 2: loading it raised ZeroDivisionError: division by zero"),
        ("leaves.py:Own", "leaves.py, line 1: loading it raised SystemExit"),
    ],
)
def test_what_cannot_be_loaded_is_one_line(place, monkeypatch, text, said):
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (place / "cut.py").write_text("\nclass Own(:\n")
    (place / "raises.py").write_text("def f():\n    return 1 / 0\nf()\n")
    (place / "leaves.py").write_text("raise SystemExit\n")
    with pytest.raises(InputError) as caught:
        named_plant(text.format(folder=place))
    assert said in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
