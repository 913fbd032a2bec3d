"""From a problem to a verified plan, or to a failed plan with tested remedies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from micah_plan.automaton.certainty import low_probability_warnings
from micah_plan.automaton.input_memory import effects_left_out
from micah_plan.automaton.plausible import never_taken
from micah_plan.planning.around_bodies import unchecked_parts_warning
from micah_plan.planning.pomdp_hd import plan as pomdp_hd
from micah_plan.planning.remedies import with_tested_remedies
from micah_plan.planning.tightening import verified_plan
from micah_plan.summaries import Progress
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

if TYPE_CHECKING:
    pass
from micah_plan.planning.with_arm import planned_with_arm


def solve(
    problem: Problem,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    advise: bool = True,
    planner: Callable[..., Plan] | None = None,
) -> Plan:
    """Plan by POMDP-HD, and verify by roll-outs of the true hybrid system from sampled states.

    Where the roll-outs fail too often, it plans again with more room (`planning.tightening`).

    Args:
        planner: an alternative, whose plans are checked in the same way: called with the problem, and with `seed`,
            `progress` and `deadline` by name (see `planning.attempt`).
        advise: after a failure, test the proposed remedies so that they name numbers that help (`planning.remedies`):
            up to fourteen more solutions. False: remedies without numbers.

    Returns:
        A plan whose outcome states whether it solves the problem.
    """
    rounds = problem.settings.tightening_rounds * (planner is None)
    planned_by = partial(planner or pomdp_hd, seed=seed, progress=progress)
    if problem.robot is not None:
        import micah_plan.robot.along_plan  # noqa: F401
    # Only now: the time to load libraries does not depend on the problem.
    deadline = Deadline(problem.settings.solve_time_limit_s)

    def planned(asked: Problem) -> Plan:
        return verified_plan(asked, planned_by, seed, rounds, deadline)

    with_arm = planned_with_arm(problem, planned, seed, deadline)
    warnings = (
        *low_probability_warnings(problem.automaton.learned),
        *effects_left_out(problem.automaton, planner is not None),
    )
    warnings += (*never_taken(problem.automaton), *unchecked_parts_warning(problem))
    answer = replace(with_arm, warnings=warnings)
    if not advise or answer.outcome == "solved":
        return answer
    return with_tested_remedies(problem, answer, partial(solve, advise=False, planner=planner), seed, progress)
