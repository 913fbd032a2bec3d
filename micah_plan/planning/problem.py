"""A planning problem and its settings: what `problems/*.yaml` says, as values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from micah_plan.automaton.contacts.task import Grip
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Vector3
from micah_plan.scene.body import Body
from micah_plan.scene.robot_description import Grasp, RobotDescription

Method = Literal["pomdp-hd", "direct", "rrt"]


@dataclass(frozen=True)
class Start:
    """The initial belief.

    Attributes:
        mean, std: (n,) of the Gaussian over x [rad or m].
        mode: the mode the object is in; None: the first mode whose invariant holds the mean.
    """

    mean: tuple[float, ...]
    std: tuple[float, ...]
    mode: str | None = None


@dataclass(frozen=True)
class Goal:
    """The goal set: any subset of the coordinates within a tolerance, and optionally the modes to end in.

    Attributes:
        target: (index, value, tolerance) per constrained coordinate [rad or m].
        modes: names of the modes that count as reached; empty: any.
    """

    target: tuple[tuple[int, float, float], ...]
    modes: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlannerSettings:
    """Settings with defaults that serve ordinary problems.

    Attributes:
        method: ``"pomdp-hd"``, or a baseline: ``"direct"`` (one optimisation over the soft mixture of all modes) or
            ``"rrt"`` (kinodynamic RRT on the means). What each finds is verified alike.
        confidence: probability that guards and invariants are planned to hold with, and that roll-outs must confirm for
            the goal.
        samples_per_mode: roadmap states per mode of the high-level search.
        candidates: how many of the cheapest mode sequences are optimised.
        revisits: how many times a mode sequence may come back to a mode that it has been in.
        max_step: largest input per step and input coordinate [rad or m]; None: from the automaton's admissible inputs,
            else a twentieth of the coordinate's range.
        max_knots: upper limit of knots over the whole plan.
        weight_goal, weight_covariance, weight_effort: of the final squared goal error and the final variance (both over
            the squared tolerance) and of the squared inputs (over the squared max_step).
        time_limit_s: wall-clock limit of each optimisation [s].
        solve_time_limit_s: wall-clock limit of search, optimisations, verification and the arm together [s].
        verification_trials: roll-outs that check a plan.
        tightening_rounds: how often a plan that roll-outs fail too often is made anew with more room.
        replan_every: steps after which execution plans anew from its belief (receding horizon); 0: only where the
            belief leaves the plan.
    """

    method: Method = "pomdp-hd"
    confidence: float = 0.95
    samples_per_mode: int = 100
    candidates: int = 4
    revisits: int = 0
    max_step: tuple[float, ...] | None = None
    max_knots: int = 60
    weight_goal: float = 1.0
    weight_covariance: float = 1.0
    weight_effort: float = 0.05
    time_limit_s: float = 20.0
    solve_time_limit_s: float = 120.0
    verification_trials: int = 1000
    tightening_rounds: int = 3
    replan_every: int = 0


@dataclass(frozen=True)
class Hold:
    """How the object of a problem is held, and between which corners the hand may move; see `automaton.contacts.task`.

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
        scene: bodies that do not move.
        robot: the arm that holds the object; None: none is planned for.
        grasp: what it holds.
        hold: how a hand holds the object by one part; None: it stands, and its joints are moved.
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
