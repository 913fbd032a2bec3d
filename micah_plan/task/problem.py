"""A planning problem: what `problems/*.yaml` says, as a value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from micah_plan.automaton.contacts.values import Grip
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Vector3
from micah_plan.quantities import common_unit
from micah_plan.scene.body import Body
from micah_plan.scene.robot_description import Grasp, RobotDescription
from micah_plan.task.goal import Goal
from micah_plan.task.path import PathConstraint
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start


@dataclass(frozen=True)
class Hold:
    """How the object of a problem is held, and between which corners the hand may move (`automaton.contacts.values`).

    Attributes:
        grip: how a hand holds the object.
        contacts: (body of the scene, axis, sign) of every face that the moving part may touch.
        lower, upper: corners of where the hand may go [m].
    """

    grip: Grip
    contacts: tuple[tuple[str, int, int], ...]
    lower: Vector3
    upper: Vector3


@dataclass(frozen=True)
class Problem:
    """Everything `solve` needs.

    Attributes:
        automaton: the model, with the noise of the problem if it states one.
        plant: physical parameters for execution in MuJoCo, passed to the plant as they are.
        source: path of the problem file as given, for messages; empty if made in Python.
        digests: SHA-256 of the problem, model and robot files, by role.
        scene: bodies around the object.
        robot: the arm that holds the object; None: none is planned for.
        grasp: what it holds.
        hold: how a hand holds the object by one part; None: it stands, and its joints are moved.
        constraints: what is asked of the path, beyond the boundaries of the model.
    """

    automaton: HybridAutomaton
    start: Start
    goal: Goal
    settings: PlannerSettings = field(default_factory=PlannerSettings)
    plant: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    digests: Mapping[str, str] = field(default_factory=dict)
    scene: tuple[Body, ...] = ()
    robot: RobotDescription | None = None
    grasp: Grasp | None = None
    hold: Hold | None = None
    constraints: tuple[PathConstraint, ...] = ()

    @property
    def goal_unit(self) -> str:
        """The unit of distances from the goal: m, rad, or both where the goal constrains coordinates of both."""
        return common_unit(self.automaton.coordinates[index].unit for index in self.goal.indices)
