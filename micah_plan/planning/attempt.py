"""The frame of every planning attempt: its inputs, and the plan or refusal that it ends with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

from micah_plan.planning.around_bodies import with_scene
from micah_plan.planning.findings import endpoint_findings
from micah_plan.planning.limits import Limits, limits_of
from micah_plan.planning.no_way import NoWayError
from micah_plan.summaries import Progress
from micah_plan.task.deadline import Clock, Deadline, TimeLimitError
from micah_plan.task.path import check_constraint
from micah_plan.task.plan import Candidate, Finding, Level, Outcome, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem
from micah_plan.task.start import start_mode


@dataclass(frozen=True, eq=False)
class Attempt:
    """Inputs of a planner.

    Attributes:
        problem: to solve; its start names its mode.
        seed: of all that is random.
        deadline: when to end.
        progress: called with one line of text and the fraction done whenever a stage begins.
        clock: of its stages.
    """

    problem: Problem
    seed: int
    deadline: Deadline
    progress: Progress = lambda _text, _fraction: None
    clock: Clock = field(default_factory=Clock)

    @property
    def mode(self) -> str:
        """The mode that the start is in."""
        return self.problem.start.mode or ""

    @cached_property
    def limits(self) -> Limits:
        """Limits of the problem."""
        return limits_of(self.problem)

    def planned_by(self, planner: Callable[[Attempt], Plan], level: Level) -> Plan:
        """The plan of a planner; no plan with the reason at a level if it fails or runs out of time."""
        try:
            return planner(self)
        except (NoWayError, TimeLimitError) as failed:
            return self.refused_for((Finding.of(level, failed.reason),))

    def solved(
        self,
        trajectory: Trajectory,
        cost: float,
        how: str,
        candidates: tuple[Candidate, ...] = (),
        findings: tuple[Finding, ...] = (),
    ) -> Plan:
        """A solved but unverified plan with its trajectory; `how` states in a few words how it was found."""
        answer = replace(self._plan("solved", "", findings, candidates), trajectory=trajectory, cost=cost)
        return replace(
            answer,
            reason=f"{' -> '.join(answer.mode_sequence)}{how}",
            goal_error=self.problem.goal.error(trajectory.means[-1]),
            goal_std=self.problem.goal.std(trajectory.factors[-1]),
        )

    def refused(self, reason: str, findings: tuple[Finding, ...], candidates: tuple[Candidate, ...] = ()) -> Plan:
        """No plan, with the reason and its remedy; findings on the start or goal replace the others, not the reason."""
        return self._plan("no_plan", reason, endpoint_findings(self.problem) or findings, candidates)

    def refused_for(
        self, findings: tuple[Finding, ...], before: str = "", candidates: tuple[Candidate, ...] = ()
    ) -> Plan:
        """No plan, for the first of the findings, with `before` prefixed to its sentence.

        Findings on the start or goal replace the others in the plan, not the reason.
        """
        first, *others = findings
        plan = self._plan("no_plan", "", tuple(others), candidates).refused_for(first, before, outcome="no_plan")
        return replace(plan, findings=endpoint_findings(self.problem) or plan.findings)

    def _plan(
        self, outcome: Outcome, reason: str, findings: tuple[Finding, ...], candidates: tuple[Candidate, ...]
    ) -> Plan:
        """A plan without a trajectory, with the seed and the timings so far."""
        timings = self.clock.timings()
        return Plan(outcome, reason, candidates=candidates, seed=self.seed, timings=timings, findings=findings)


def attempt_plan(
    planner: Callable[[Attempt], Plan],
    level: Level,
    problem: Problem,
    seed: int,
    progress: Progress | None,
    deadline: Deadline | None,
) -> Plan:
    """The plan of a planner from the mode that the start is in; no plan if it is in none.

    Args:
        planner: gives a plan, still to be verified, or raises `NoWayError`.
        level: at which it fails if it does.
        problem, seed, progress: see `Attempt`.
        deadline: None: the time limit of the settings from now on.

    Raises:
        InputError: if a constraint on the path does not fit the model.
    """
    for constraint in problem.constraints:
        check_constraint(constraint, problem.automaton)
    problem = with_scene(pre_release_problem(problem))
    attempt = Attempt(problem, seed, deadline or Deadline(problem.settings.solve_time_limit_s))
    mode, reason = start_mode(problem.automaton, problem.start)
    if mode is None:
        return attempt.refused(str(reason), ())
    attempt = replace(attempt, problem=replace(problem, start=replace(problem.start, mode=mode)))
    return (replace(attempt, progress=progress) if progress else attempt).planned_by(planner, level)
