"""Plans as goals of a robot's controller: the YAML for `ros2 action send_goal`, and the node that sends it."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from micah_plan.documents.plan import load_plan, write_plan
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.exchange.convert import convert
from micah_plan.exchange.joint_trajectory import trajectory_goal
from micah_plan.planning.solver import solve
from micah_plan.task.plan import Plan
from micah_plan.templates.write import write_template


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("robot")
    write_template("robot", folder / "robot")
    problem = load_problem(folder / "robot" / "problem.yaml")
    write_plan(solve(problem), problem, folder / "plan.json")
    return folder / "plan.json"


def test_the_goal_is_the_trajectory_of_the_plan(plan_file: Path, tmp_path: Path) -> None:
    assert convert(plan_file, tmp_path / "goal.yaml") == ("plan", ())
    text = (tmp_path / "goal.yaml").read_text()
    assert "ros2 action send_goal" in text
    goal = yaml.safe_load(text)
    assert goal.keys() == {"trajectory", "goal_time_tolerance"}
    arm = load_plan(plan_file).plan.arm
    assert arm is not None
    trajectory = goal["trajectory"]
    assert trajectory["joint_names"] == list(arm.joints)
    assert trajectory["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}  # it begins when it arrives
    points = trajectory["points"]
    np.testing.assert_array_equal(points[0]["positions"], arm.positions[0])
    np.testing.assert_array_equal(points[-1]["positions"], arm.positions[-1])
    times = [point["time_from_start"]["sec"] + 1e-9 * point["time_from_start"]["nanosec"] for point in points]
    assert np.all(np.diff(times) > 0)
    # Velocities are those of the positions: a controller that interpolates with cubic splines does not overshoot.
    between = np.diff([point["positions"] for point in points], axis=0) / np.diff(times)[:, None]
    np.testing.assert_allclose(points[1]["velocities"], (between[0] + between[1]) / 2, atol=1e-9)
    assert not np.any(points[-1]["velocities"])


def test_what_is_no_solution_is_not_sent(tmp_path: Path, repository: Path) -> None:
    problem = load_problem(repository / "problems" / "drawer_open.yaml")
    write_plan(Plan("no_plan", "there is a wall"), problem, tmp_path / "plan.json")
    with pytest.raises(InputError):
        convert(tmp_path / "plan.json", tmp_path / "goal.yaml")
    assert not (tmp_path / "goal.yaml").exists()


@dataclass
class Controller:
    """A robot's controller, its joints, and a clock that only waiting moves."""

    joints: dict[str, float]
    is_there: bool = True
    accepts: bool = True
    error: tuple[int, str] = (0, "")
    is_interrupted: bool = False
    now: float = 0.0
    goals: list[Any] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    heard: Callable[[Any], None] = print

    def modules(self) -> dict[str, dict[str, Any]]:
        result = SimpleNamespace(SUCCESSFUL=0)
        action = SimpleNamespace(Goal=SimpleNamespace, Result=result)
        return {
            "rclpy": {
                "init": lambda **options: self.said.append("init"),
                "shutdown": lambda: self.said.append("shutdown"),
                "create_node": lambda name: self,
                "spin_once": self.spin_once,
                "spin_until_future_complete": lambda node, future: None,
            },
            "rclpy.action": {"ActionClient": lambda node, kind, name: self.named(name)},
            "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO="none")},
            "control_msgs": {},
            "control_msgs.action": {"FollowJointTrajectory": action},
            "sensor_msgs": {},
            "sensor_msgs.msg": {"JointState": object},
            "rosidl_runtime_py": {},
            "rosidl_runtime_py.set_message": {
                "set_message_fields": lambda message, values: vars(message).update(values)
            },
        }

    def named(self, name: str) -> Controller:
        self.said.append(name)
        return self

    def wait_for_server(self, timeout_sec: float) -> bool:
        return self.is_there

    def create_subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], depth: int) -> None:
        assert topic == "joint_states"
        self.heard = callback

    def spin_once(self, node: Any, timeout_sec: float) -> None:
        self.now += timeout_sec
        self.heard(SimpleNamespace(name=list(self.joints), position=list(self.joints.values())))

    def send_goal_async(self, goal: Any) -> Any:
        self.goals.append(goal)
        return SimpleNamespace(result=lambda: SimpleNamespace(accepted=self.accepts, **self.handle()))

    def handle(self) -> dict[str, Any]:
        ended = SimpleNamespace(result=SimpleNamespace(error_code=self.error[0], error_string=self.error[1]))

        def result() -> Any:
            if self.is_interrupted:
                raise KeyboardInterrupt
            return ended

        def cancel() -> Any:
            self.said.append("cancel")
            return SimpleNamespace(result=lambda: None)

        return {"get_result_async": lambda: SimpleNamespace(result=result), "cancel_goal_async": cancel}

    def destroy_node(self) -> None:
        self.said.append("destroyed")


@pytest.fixture
def send(repository: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    def sent(controller: Controller, *arguments: Any) -> str:
        for name, members in controller.modules().items():
            module = ModuleType(name)
            vars(module).update(members)
            monkeypatch.setitem(sys.modules, name, module)
        namespace = runpy.run_path(str(repository / "examples" / "ros2" / "send_trajectory.py"))
        send_function = namespace["send"]
        send_function.__globals__["time"] = SimpleNamespace(monotonic=lambda: controller.now)
        text: str = send_function(*arguments)
        assert controller.said[-2:] == ["destroyed", "shutdown"]
        return text

    return sent


def begins(plan_file: Path) -> dict[str, float]:
    trajectory = trajectory_goal(load_plan(plan_file))["trajectory"]
    return dict(zip(trajectory["joint_names"], trajectory["points"][0]["positions"], strict=True)) | {"finger": 0.0}


def test_the_node_sends_the_goal_to_the_controller(plan_file: Path, send: Callable[..., str]) -> None:
    controller = Controller(begins(plan_file))
    assert send(controller, plan_file, "/arm/follow_joint_trajectory") == ""
    assert "/arm/follow_joint_trajectory" in controller.said
    (goal,) = controller.goals
    assert vars(goal) == trajectory_goal(load_plan(plan_file))


@pytest.mark.parametrize(
    ("change", "said", "is_sent"),
    [
        ({"is_there": False}, "nothing answers at /joint_trajectory_controller", False),
        ({"accepts": False}, "the controller refused the trajectory", True),
        ({"error": (-4, "elbow too far off")}, "error -4: elbow too far off", True),
        ({"is_interrupted": True}, "cancelled", True),
        ({"joints": {"elbow": 0.3}}, "elbow is +0.300 away from where the plan begins; move the robot there", False),
        ({"joints": {"elbow": None}}, "/joint_states has no elbow", False),
    ],
)
def test_what_goes_wrong_is_reported(
    plan_file: Path, send: Callable[..., str], change: dict[str, Any], said: str, is_sent: bool
) -> None:
    joints = begins(plan_file)
    for name, by in change.pop("joints", {}).items():
        if by is None:
            del joints[name]
        else:
            joints[name] += by
    controller = Controller(joints, **change)
    assert said in send(controller, plan_file)
    assert bool(controller.goals) == is_sent
    assert ("cancel" in controller.said) == controller.is_interrupted
