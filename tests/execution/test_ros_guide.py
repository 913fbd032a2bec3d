"""The ROS 2 plant of the examples, run as it stands against a stand-in for rclpy: topics, time, failures."""

from __future__ import annotations

import sys
from copy import deepcopy
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from micah_plan.documents.problem import load_problem
from micah_plan.execution.conformance import check_plant
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.plant import Command, PlantError
from micah_plan.execution.trials import run_trials
from micah_plan.planning.solver import solve


class Robot:
    """A robot that holds a drawer, the topics that it speaks, and a clock that only waiting moves."""

    def __init__(self, problem) -> None:
        self.drawer = NominalPlant.of(problem)
        self.along = np.array(problem.automaton.modes[0].joints[0].axis)
        self.seen = self.drawer.reset(np.random.default_rng(5))
        self.hand, self.now, self.shut_down = np.zeros(3), 100.0, False
        self.subscriptions, self.silent = {}, set()

    def init(self, **options) -> None:
        assert options == {"signal_handler_options": "none"}

    def create_node(self, _):
        return self

    def create_subscription(self, _, topic, callback, __) -> None:
        self.subscriptions[topic] = callback

    def create_publisher(self, _, topic, __):
        assert topic == "target_frame"
        return self

    def publish(self, target) -> None:
        place = target.pose.position
        moved = np.array([place.x, place.y, place.z]) - self.hand
        self.hand = self.hand + moved
        nothing = np.zeros((1, 3))
        self.seen = self.drawer.apply(Command(np.array([moved @ self.along]), nothing, nothing))

    def spin_once(self, _, timeout_sec) -> None:
        self.now += timeout_sec
        x, y, z = self.hand.tolist()
        messages = {"current_pose": SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=z)))}
        (place,), (turn,) = self.seen.position, self.seen.quaternion
        position = SimpleNamespace(**dict(zip("xyz", place, strict=True)))
        orientation = SimpleNamespace(**dict(zip("xyzw", turn, strict=True)))
        messages["parts"] = SimpleNamespace(poses=[SimpleNamespace(position=position, orientation=orientation)])
        for topic, message in messages.items():
            if topic not in self.silent:
                self.subscriptions[topic](deepcopy(message))

    def again(self, _) -> str:
        self.hand, self.seen = np.zeros(3), self.drawer.reset(np.random.default_rng(5))
        return ""

    def destroy_node(self) -> None:
        assert not self.shut_down

    def shutdown(self) -> None:
        self.shut_down = True


@pytest.fixture
def problem(repository):
    return load_problem(repository / "problems" / "drawer_open.yaml")


@pytest.fixture
def robot(problem) -> Robot:
    return Robot(problem)


@pytest.fixture
def shown(repository, robot, monkeypatch):
    """The class of the example."""
    modules = {
        "rclpy": {name: getattr(robot, name) for name in ("init", "create_node", "spin_once", "shutdown")},
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO="none")},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseArray": object, "PoseStamped": object},
    }
    for name, members in modules.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    code = (repository / "examples" / "ros2" / "hand.py").read_text(encoding="utf-8")
    namespace = {"input": robot.again}
    exec(compile(code, "hand.py", "exec"), namespace)  # noqa: S102
    namespace["time"] = SimpleNamespace(monotonic=lambda: robot.now)
    return namespace["RosPlant"]


def test_it_is_about_as_short_as_promised(repository) -> None:
    code = (repository / "examples" / "ros2" / "hand.py").read_text(encoding="utf-8")
    code = code[code.index("\nclass ") :]
    assert len([line for line in code.splitlines() if line.strip()]) <= 45


def test_it_keeps_to_what_a_plant_must_do(shown, problem) -> None:
    assert check_plant(shown(problem), problem) == ()


def test_a_plan_is_executed_on_it(shown, problem, robot) -> None:
    found = run_trials(problem, solve(problem), plant=shown, trials=2)
    assert found.successes == 2
    assert found.believed
    assert robot.shut_down
    steps = np.diff(found.recording.select(run=0).time)
    assert (steps >= 1.0).all()  # it waits until a motion has ended


@pytest.mark.parametrize("topic", ["parts", "current_pose"])
def test_a_silent_topic_is_a_failure_of_the_machine(shown, problem, robot, topic) -> None:
    plant = shown(problem)
    plant.reset(np.random.default_rng(0))
    robot.silent.add(topic)
    with pytest.raises(PlantError, match=f"nothing came on '{topic}' for 2 s"):
        plant.apply(Command(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3))))
