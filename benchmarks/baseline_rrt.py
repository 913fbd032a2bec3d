"""A baseline: OMPL's kinodynamic RRT on the hybrid system, without any belief.

The states are (x, mode), a propagation is one step of the real transition without noise, so modes change where guards
fire and nowhere else. Source: LaValle and Kuffner, "Randomized kinodynamic planning", IJRR 2001.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from baseline_direct import plan_along
from ompl import base as ob
from ompl import control as oc
from ompl import util as ou

from micah_plan.arrays import Floats
from micah_plan.automaton.transition import step
from micah_plan.planning.attempt import Attempt, attempt_plan
from micah_plan.planning.limits import Limits, limited_input
from micah_plan.planning.no_way import NoWayError
from micah_plan.planning.search.polytope import nominal_start
from micah_plan.planning.search.roadmap import bounding_box
from micah_plan.planning.search.samples import goal_states
from micah_plan.summaries import Progress
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Reason

# Extensions of the tree, after which it is given up: with them the result depends on the seed alone.
_MOST_EXTENSIONS = 20_000
# The mean must end within this share of the tolerance: the rest is for the belief's spread.
_GOAL_SHARE = 0.5
# Distance between different modes, in widths of the range: neighbours in other modes are rarer, but exist.
_MODE_DISTANCE = 0.1
_LONGEST_CONTROL = 5
_TOLERANCE = 1e-9


def plan(problem: Problem, seed: int = 0, progress: Progress | None = None, deadline: Deadline | None = None) -> Plan:
    """Inputs that bring the mean of the start into the goal, or the reason why none were found."""
    return attempt_plan(partial(plan_along, _grow), "search", problem, seed, progress, deadline)


def _grow(attempt: Attempt) -> tuple[Floats, str]:
    """(T, m) inputs of a path to the goal, and how they were found."""
    attempt.progress("growing a tree", 0.0)
    # OMPL complains that generators exist already; those made from here on follow the seed, and no other is used.
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(attempt.seed + 1)
    asked = 0

    def is_over() -> bool:
        nonlocal asked
        asked += 1
        return asked > _MOST_EXTENSIONS or attempt.deadline.is_over()

    with attempt.clock.stage("search"):
        system = _System(attempt.problem, attempt.limits)
        information = system.information()
        definition = ob.ProblemDefinition(information)
        start = information.allocState()
        system.write(start, nominal_start(attempt.problem, attempt.limits, attempt.mode), attempt.mode)
        definition.addStartState(start)
        goal = _Goal(information, system, np.random.default_rng(attempt.seed))
        definition.setGoal(goal)
        planner = oc.RRT(information)
        planner.setProblemDefinition(definition)
        planner.setup()
        planner.solve(ob.PlannerTerminationCondition(is_over))
    if not definition.hasExactSolution():
        limit = f"{_MOST_EXTENSIONS} extensions" if asked > _MOST_EXTENSIONS else "the time limit (solve_time_limit_s)"
        sentence = f"RRT found no path to the goal within {limit}, which does not prove that there is none"
        raise NoWayError(Reason("not_connected", sentence, ("use the method pomdp-hd",)))
    path, m = definition.getSolutionPath(), attempt.problem.automaton.m
    controls = [[path.getControl(i)[j] for j in range(m)] for i in range(path.getControlCount())]
    durations = [round(path.getControlDuration(i)) for i in range(len(controls))]
    inputs = np.repeat(np.array(controls, dtype=float).reshape(-1, m), durations, axis=0)
    return inputs, f"found by RRT in {len(inputs)} steps"


class _System:
    """The hybrid system as OMPL sees it: states (x over the ranges' widths, number of the mode)."""

    def __init__(self, problem: Problem, limits: Limits) -> None:
        self.automaton, self.goal, self.limits = problem.automaton, problem.goal, limits
        width = limits.upper - limits.lower
        self.width = np.where(width > 0, width, 1.0)
        self.rest = np.zeros(problem.automaton.m)
        sets = [(mode, goal_states(problem, limits, mode)) for mode in problem.automaton.mode_names]
        self.goals = [(mode, states) for mode, states in sets if not states.is_empty]
        if not self.goals:
            ways = ("move the goal into a range",)
            raise NoWayError(
                Reason("goal_in_no_mode", "the goal lies in the range of no mode that it may end in", ways)
            )

    def information(self) -> Any:
        lowest = self.limits.lower / self.width
        continuous = ob.RealVectorStateSpace(self.automaton.n)
        continuous.setBounds(bounding_box(lowest, lowest + 1.0))
        space = ob.CompoundStateSpace()
        space.addSubspace(continuous, 1.0)
        # OMPL asks for two values at least; the second of one mode is never reached.
        space.addSubspace(ob.DiscreteStateSpace(0, max(1, len(self.automaton.modes) - 1)), _MODE_DISTANCE)
        controls = oc.RealVectorControlSpace(space, self.automaton.m)
        controls.setBounds(bounding_box(-self.limits.max_step, self.limits.max_step))
        information = oc.SpaceInformation(space, controls)
        information.setStatePropagator(self.propagate)
        information.setStateValidityChecker(self.is_valid)
        information.setPropagationStepSize(1.0)
        information.setMinMaxControlDuration(1, _LONGEST_CONTROL)
        return information

    def read(self, state: Any) -> tuple[Floats, str]:
        x = np.array([state[0][i] for i in range(self.automaton.n)]) * self.width
        return x, self.automaton.mode_names[state[1].value]

    def write(self, state: Any, x: Floats, mode: str) -> None:
        for i, value in enumerate(x / self.width):
            state[0][i] = float(value)
        state[1].value = self.automaton.mode_index(mode)

    def propagate(self, state: Any, control: Any, _duration: float, after: Any) -> None:
        x, name = self.read(state)
        u = np.array([control[j] for j in range(self.automaton.m)])
        cut = limited_input(self.automaton.mode(name), x, u, self.limits.max_step)
        moved = step(self.automaton, name, x, cut)
        self.write(after, moved.x, moved.mode)

    def is_valid(self, state: Any) -> bool:
        x, name = self.read(state)
        return bool(self.automaton.mode(name).invariant.contains(x, self.rest, _TOLERANCE))

    def distance(self, state: Any) -> float:
        """Largest goal error over its tolerance; infinite in a mode that does not count."""
        x, name = self.read(state)
        if not self.goal.admits(name):
            return float("inf")
        return max((abs(float(x[i]) - value) / tolerance for i, value, tolerance in self.goal.target), default=0.0)


class _Goal(ob.GoalSampleableRegion):  # type: ignore[misc]  # OMPL's wheel has no type information
    """The goal set, from which the tree's growth takes a state now and then."""

    def __init__(self, information: Any, system: _System, rng: np.random.Generator) -> None:
        super().__init__(information)
        self.setThreshold(_GOAL_SHARE)
        self.system, self.rng = system, rng

    def distanceGoal(self, state: Any) -> float:  # noqa: N802  # OMPL's name
        return self.system.distance(state)

    def sampleGoal(self, state: Any) -> None:  # noqa: N802  # OMPL's name
        name, states = self.system.goals[int(self.rng.integers(len(self.system.goals)))]
        self.system.write(state, states.sample(self.rng, 1)[0], name)

    def maxSampleCount(self) -> int:  # noqa: N802  # OMPL's name
        return _MOST_EXTENSIONS
