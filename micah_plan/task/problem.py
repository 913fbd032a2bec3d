"""Planning problems: the content of `problems/*.yaml` as a value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from micah_plan.automaton.contacts.values import Grip
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Vector3
from micah_plan.quantities import common_unit, percent, with_spread
from micah_plan.summaries import Summarised, aligned, listed
from micah_plan.task.body import Body
from micah_plan.task.by_name import Spread, with_goal, with_noise, with_start
from micah_plan.task.goal import Goal
from micah_plan.task.path import PathConstraint
from micah_plan.task.robot_description import Grasp, RobotDescription
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
class Release:
    """How a held object is released.

    Attributes:
        support: body of the scene on whose upper side it is put.
        support_std: of the height of that side [m].
        step: displacement of the hand down per control step while it feels for the support [m].
        force: at which the contact is felt [N].
        shift_std: how far the object moves along x and along y when the gripper opens [m].
        fingers: (joint of the robot, position when open [rad or m]); empty: a gripper without an arm.
        withdraw: displacement of the hand away from the object [m].
    """

    support: str
    support_std: float = 0.002
    step: float = 0.004
    force: float = 2.0
    shift_std: float = 0.002
    fingers: tuple[tuple[str, float], ...] = ()
    withdraw: float = 0.12


@dataclass(frozen=True, repr=False)
class Problem(Summarised):
    """The input of `solve`.

    Attributes:
        automaton: the model, with the noise of the problem if it states one.
        plant: physical parameters for execution in MuJoCo, passed to the plant as they are.
        source: path of the problem file as given, for messages; empty if made in Python.
        digests: SHA-256 of the problem, model and robot files, by role.
        scene: bodies around the object.
        robot: the arm that holds the object; None: none is planned for.
        grasp: the held part.
        hold: how a hand holds the object by one part; None: it stands, and its joints are moved.
        release: how a held object is released at the end, which the goal then describes; None: it stays in the hand.
        constraints: on the path, beyond the boundaries of the model.
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
    release: Release | None = None
    constraints: tuple[PathConstraint, ...] = ()

    def replace(
        self,
        *,
        start: Mapping[str, Spread] | None = None,
        start_mode: str | None = None,
        goal: Mapping[str, Spread] | None = None,
        modes: str | Sequence[str] | None = None,
        noise: Mapping[str, Mapping[str, float]] | None = None,
    ) -> Problem:
        """The problem with another start, goal or noise, by the names of coordinates and modes.

            problem.replace(start={"door": (0.4, 0.05)}, goal={"door": (1.2, 0.03)}, modes=["rigid"])

        Args:
            start: mean, or (mean, standard deviation), of some coordinates [rad or m].
            start_mode: that it is in; None: the first that allows the mean, where a start is given.
            goal: value, or (value, tolerance), of the coordinates that count [rad or m], instead of the whole target.
            modes: that count as reached; empty, or where only a goal is given: any, except for a collision.
            noise: standard deviations by `process_std` and `observation_std` and by coordinate [rad or m].

        Raises:
            InputError: for an unknown name, a value that is not a number, or a goal without a tolerance.
        """
        automaton = self.automaton
        if noise is not None:
            automaton = replace(automaton, noise=with_noise(automaton.noise, automaton, noise))
        return replace(
            self,
            automaton=automaton,
            start=with_start(self.start, automaton, start or {}, start_mode),
            goal=with_goal(self.goal, automaton, goal, modes),
        )

    def summary(self) -> str:
        """Start, goal, confidence and surroundings, in a few lines."""
        coordinates = self.automaton.coordinates
        start = [
            f"{c.name} {with_spread(mean, std, c.unit, degrees=False)}"
            for c, mean, std in zip(coordinates, self.start.mean, self.start.std, strict=True)
        ]
        goal = [
            f"{coordinates[i].name} {with_spread(value, room, coordinates[i].unit, degrees=False)}"
            for i, value, room in self.goal.target
        ]
        goal += [f"in mode {' or '.join(listed(self.goal.modes).split(', '))}"] if self.goal.modes else []
        return aligned(
            f"Problem {self.source}".strip(),
            {
                "start": listed(start),
                "goal": listed(goal),
                "confidence": percent(self.settings.confidence),
                "scene": listed([body.name for body in self.scene]),
                "held by": "a hand" if self.hold is not None else "",
                "robot": "" if self.robot is None else "an arm",
            },
        )

    @property
    def goal_unit(self) -> str:
        """The unit of distances from the goal: m, rad, or both where the goal constrains coordinates of both."""
        return common_unit(self.automaton.coordinates[index].unit for index in self.goal.indices)
