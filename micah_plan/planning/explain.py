"""Why a plan is as it is: the level that failed, the place, the constraint, its amount and the nearest remedy."""

from __future__ import annotations

from dataclasses import dataclass

from micah_plan.planning.findings import endpoint_findings
from micah_plan.quantities import percent, plain
from micah_plan.task.plan import Finding, Level, Outcome, Plan
from micah_plan.task.problem import Problem

# In the order in which they are checked.
_LEVELS: tuple[Level, ...] = ("start", "goal", "search", "optimisation", "verification", "arm")


@dataclass(frozen=True)
class Explanation:
    """A plan in words.

    Attributes:
        outcome: of the plan.
        summary: one sentence on the whole.
        level: at which it failed; None if it is solved.
        findings: what stands in the way, first the first level that failed and the cheapest mode sequence.
        lines: all of it to be read, one sentence each.
    """

    outcome: Outcome
    summary: str
    level: Level | None
    findings: tuple[Finding, ...]
    lines: tuple[str, ...]


def explain(problem: Problem, plan: Plan) -> Explanation:
    """What stands in the way of a plan (of any outcome, also one read from a file).

    A plan file of an older version has no findings; then start and goal are checked again, and else its reason stands.
    """
    found = plan.findings
    if plan.outcome == "no_plan" and not found:
        found = endpoint_findings(problem)
    findings = tuple(sorted(found, key=lambda finding: _LEVELS.index(finding.level)))
    if plan.outcome == "not_verified":  # what the roll-outs ran into is the reason; the boundaries may be the cause
        findings = tuple(sorted(findings, key=lambda finding: finding.level not in ("verification", "arm")))
    level = None if plan.outcome == "solved" or not findings else findings[0].level
    lines = [_outcome_line(plan, level), *(line for finding in findings for line in finding_lines(finding))]
    if not findings and plan.outcome != "solved":
        lines.append("the file has no details, it was written by an older version: solve the problem again")
    for one in plan.candidates:
        cost = "no plan" if one.cost is None else f"cost {plain(one.cost)}"
        lines.append(f"tried {' -> '.join(one.modes)}: {cost}, {one.message}")
    return Explanation(plan.outcome, plan.reason, level, findings, tuple(lines))


def finding_lines(finding: Finding) -> list[str]:
    """Place and sentence of a finding, and its remedy."""
    place: str = finding.level
    place += f", {' -> '.join(finding.modes)}" if finding.modes else ""
    if finding.knot is not None:
        place += f", knot {finding.knot} in mode '{finding.mode}'"
    lines = [f"{place}: {finding.sentence}"]
    return [*lines, f"  remedy: {finding.remedy}"] if finding.remedy else lines


def _outcome_line(plan: Plan, level: Level | None) -> str:
    if plan.outcome == "solved":
        share = plan.success_probability
        verified = "" if share is None else f", {percent(share)} of the roll-outs succeed"
        return f"solved through {' -> '.join(plan.mode_sequence)}{verified}"
    failed = "there is no plan" if plan.outcome == "no_plan" else "a plan was found but not verified"
    return f"{failed}: {plan.reason if level is None else f'the {level} stands in the way'}"
