"""Why a plan is as it is: the level that failed, the place, the constraint, its amount and the nearest remedy."""

from __future__ import annotations

from dataclasses import dataclass

from micah_plan.planning.obstacles import endpoint_obstacles
from micah_plan.planning.plan import Candidate, Level, Obstacle, Outcome, Plan
from micah_plan.planning.problem import Problem

# In the order in which they are checked.
_LEVELS: tuple[Level, ...] = ("start", "goal", "search", "optimisation", "verification", "arm")


@dataclass(frozen=True)
class Explanation:
    """A plan in words.

    Attributes:
        outcome: of the plan.
        summary: one sentence on the whole.
        level: at which it failed; None if it is solved.
        obstacles: what stands in the way, first the first level that failed and the cheapest mode sequence.
        lines: all of it to be read, one sentence each.
    """

    outcome: Outcome
    summary: str
    level: Level | None
    obstacles: tuple[Obstacle, ...]
    lines: tuple[str, ...]


def explain(problem: Problem, plan: Plan) -> Explanation:
    """What a plan (of any outcome, also one read from a file) ran into.

    A plan file of an older version does not tell obstacles; then start and goal are checked again, and for the rest its
    own sentence stands.
    """
    known = plan.obstacles
    if plan.outcome == "no_plan":
        known = endpoint_obstacles(problem) or known
    obstacles = tuple(sorted(known, key=lambda obstacle: _LEVELS.index(obstacle.level)))
    if plan.outcome == "not_verified":  # what the roll-outs ran into is the reason; the boundaries may be the cause
        obstacles = tuple(sorted(obstacles, key=lambda obstacle: obstacle.level not in ("verification", "arm")))
    level = None if plan.outcome == "solved" or not obstacles else obstacles[0].level
    lines = [_outcome_line(plan, level)]
    for obstacle in obstacles:
        lines += obstacle_lines(obstacle)
    if not obstacles and plan.outcome != "solved":
        lines.append("the file tells no details, it was written by an older version: solve the problem again")
    lines += [_candidate_line(candidate) for candidate in plan.candidates]
    return Explanation(plan.outcome, plan.reason, level, obstacles, tuple(lines))


def obstacle_lines(obstacle: Obstacle) -> list[str]:
    """Place and sentence of an obstacle, and its remedy."""
    place: str = obstacle.level
    place += f", {' -> '.join(obstacle.modes)}" if obstacle.modes else ""
    if obstacle.knot is not None:
        place += f", knot {obstacle.knot} in mode '{obstacle.mode}'"
    lines = [f"{place}: {obstacle.sentence}"]
    return [*lines, f"  remedy: {obstacle.remedy}"] if obstacle.remedy else lines


def _outcome_line(plan: Plan, level: Level | None) -> str:
    if plan.outcome == "solved":
        share = "" if plan.success_probability is None else f", {plan.success_probability:.1%} of the roll-outs succeed"
        return f"solved through {' -> '.join(plan.mode_sequence)}{share}"
    failed = "there is no plan" if plan.outcome == "no_plan" else "a plan was found but does not hold"
    return f"{failed}: {plan.reason if level is None else f'the {level} stands in the way'}"


def _candidate_line(candidate: Candidate) -> str:
    cost = "no plan" if candidate.cost is None else f"cost {candidate.cost:.4g}"
    return f"tried {' -> '.join(candidate.modes)}: {cost}, {candidate.message}"
