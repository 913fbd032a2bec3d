"""Results in a few lines, the same at a prompt, in a notebook and on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from micah_plan.quantities import common_unit, count, duration, percent, percent_interval, plain, quantity, with_spread

if TYPE_CHECKING:
    from micah_plan.api.stages import Learned
    from micah_plan.automaton.graph import Segment
    from micah_plan.automaton.hybrid import HybridAutomaton
    from micah_plan.execution.trials import TrialStatistics
    from micah_plan.explore.run import Exploration
    from micah_plan.residual.calibrate import Calibration, FoundEffect
    from micah_plan.residual.judgement import Judgement
    from micah_plan.residual.prediction import PredictionError, RunPrediction
    from micah_plan.task.plan import Plan
    from micah_plan.task.problem import Problem

SUREST = 0.999
"""A recording is never surer than ">99 %", whatever is left of the odds in floating point."""
_MOST_SEGMENTS, _MOST_FAILURES = 8, 5


def learned_lines(learned: Learned) -> list[str]:
    """Segments of every part, and the modes made of them."""
    lines = [f"warning: {warning}" for warning in learned.warnings]
    for edge in learned.graph.edges:
        lines.append(learned.heading(edge))
        lines += [f"  {_segment(segment)}" for segment in edge.segments[:_MOST_SEGMENTS]]
        hidden = len(edge.segments) - _MOST_SEGMENTS
        lines += [f"  and {count(hidden, 'more segment')}"] if hidden > 0 else []
    if learned.automaton is None:
        return [*lines, f"no model: {learned.reason}"]
    names = " / ".join(learned.automaton.mode_names[:_MOST_SEGMENTS])
    modes = count(len(learned.automaton.modes), "mode")
    return [*lines, f"learned {modes} ({names}) in {duration(learned.seconds)}"]


def _segment(segment: Segment) -> str:
    from micah_plan.automaton.joint import radius

    rows = f"rows {segment.start}-{segment.end}"
    if segment.no_single_joint is not None:
        return f"no single joint   {rows}, the best misses by {quantity(segment.no_single_joint.position, 'm')}"
    kind, low, high = segment.joint.kind, *segment.configuration_range
    way = "" if kind == "rigid" else f", over {quantity(high - low, 'm' if kind == 'prismatic' else 'rad')}"
    arm = f", radius {quantity(radius(segment.joint), 'm')}" if kind in ("revolute", "screw") else ""
    sure = segment.certainty
    share = segment.probability if sure is None else dict(sure.kinds).get(kind, 0.0)
    return f"{kind:<10} {rows}{way}{arm}, {percent(min(share, SUREST), 0)} sure"


def explored_lines(exploration: Exploration) -> list[str]:
    """What holds the handle, how it was found, and what went wrong on the way."""
    said = {"opened": "opened", "held": "held", "gave_up": "gave up"}[exploration.outcome]
    joints = ", then ".join(exploration.kinds) or "none moved"
    went, force = quantity(exploration.travel, "m"), quantity(exploration.largest_force, "N")
    return [
        f"{said}: {exploration.reason}",
        f"  joints       {joints} ({percent(min(exploration.probability, SUREST), 0)} sure)",
        f"  {count(exploration.steps, 'step')}, {went} of way, at most {force}",
        *(f"  note: {note}" for note in exploration.notes),
    ]


def solved_lines(plan: Plan, problem: Problem) -> list[str]:
    """Outcome and figures of a plan; of one that failed, what stands in the way."""
    lines = [f"warning: {warning}" for warning in plan.warnings]
    lines.append(f"{plan.outcome}: {plan.reason}")
    lines += [f"  {finding.sentence}; {finding.remedy}" for finding in plan.findings if plan.outcome != "solved"]
    return lines + plan_lines(plan, problem)


def plan_lines(plan: Plan, problem: Problem) -> list[str]:
    """Modes, distance from the goal and probability of success of a plan that has a trajectory."""
    if plan.trajectory is None:
        return []
    unit = problem.goal_unit
    lines = [f"  modes        {' -> '.join(plan.mode_sequence)}"]
    if plan.goal_error is not None and plan.goal_std is not None:
        distance = f"{quantity(plan.goal_error, unit)} from the target, σ {quantity(plan.goal_std, unit)}"
        lines.append(f"  at the end   {distance}")
    if plan.success_probability is not None:
        share = f"{percent(plan.success_probability)} of {count(plan.verification_trials, 'roll-out')}"
        sure = "" if plan.success_interval is None else f" (95 % interval: {percent_interval(*plan.success_interval)})"
        lines.append(f"  success      {share}{sure}")
    return lines


def runs_lines(statistics: TrialStatistics, unit: str, most: int = _MOST_FAILURES) -> list[str]:
    """Successes and errors [unit] of trials, and why they failed."""
    error, said, whose = statistics.final_error, "reached the goal", ""
    if statistics.believed:
        said, whose = "are believed to have reached the goal (the plant does not know the truth)", " (believed)"
    spread = with_spread(error.mean, error.std, unit)
    lines = [
        f"{statistics.successes} of {statistics.trials} trials {said}",
        f"  final error  {spread}, at most {quantity(error.max, unit)}{whose}",
    ]
    if statistics.released is not None:
        lines.insert(1, f"  let go       {statistics.released} stand in the goal on their own, nothing knocked over")
    lines += [f"  trial {trial}: {reason}" for trial, reason in statistics.failures[:most]]
    hidden = len(statistics.failures) - most
    return lines + ([f"  and {count(hidden, 'more failure')}"] if hidden > 0 else [])


def predicted_lines(automaton: HybridAutomaton, runs: Sequence[RunPrediction], judged: Judgement) -> list[str]:
    """Errors of both predictions beside what noise alone would leave, and what they follow."""
    unit = common_unit(coordinate.unit for coordinate in automaton.coordinates)
    rows = (
        ("one step", [run.one_step for run in runs], judged.one_step),
        ("roll-out", [run.rollout for run in runs], judged.rollout),
    )
    lines = [f"{count(len(runs), 'run')} against the model: {judged.sentence}"]
    for name, errors, floor in rows:
        position, configuration = _sizes(errors)
        text = f"  {name}  {quantity(configuration, unit)}, {quantity(position, 'm')}"
        noise = "" if floor is None else f" (noise alone {quantity(floor.configuration, unit)})"
        lines.append(text + noise)
    return lines


def _sizes(errors: Sequence[PredictionError]) -> tuple[float, float]:
    from micah_plan.residual.prediction import rmse

    return rmse([error.position for error in errors]), rmse([error.configuration for error in errors])


def calibrated_lines(calibration: Calibration) -> list[str]:
    """Verdict, effects, errors before and after, and the next experiment."""
    from micah_plan.residual.verdict import SENTENCES

    lines = [
        f"{calibration.verdict}: {SENTENCES[calibration.verdict]}",
        *(f"  {effect_line(effect)}" for effect in calibration.effects),
    ]
    return [*lines, *error_lines(calibration), f"  next: {calibration.experiment}"]


def error_lines(calibration: Calibration) -> list[str]:
    """Errors before and after, and those of noise alone, in one unit each."""
    lines = []
    for coordinate_error in calibration.errors:
        lines += [f"  {coordinate_error.of}"] if coordinate_error.of else []
        for name in ("one_step", "rollout"):
            before, after = (
                quantity(getattr(size, name), coordinate_error.unit)
                for size in (coordinate_error.before, coordinate_error.after)
            )
            lines.append(f"  {'one step' if name == 'one_step' else 'roll-out':9} {before} before, {after} after")
        floors = (
            quantity(floor, coordinate_error.unit)
            for floor in (coordinate_error.noise_floor, coordinate_error.rollout_floor)
        )
        lines.append(f"  noise     {' (one step), '.join(floors)} (roll-out)")
    if calibration.automaton is calibration.nominal or not calibration.written:
        return lines
    for coordinate, size in zip(calibration.automaton.coordinates, calibration.written, strict=True):
        sizes = (quantity(error, coordinate.unit) for error in (size.one_step, size.rollout))
        sentence = (
            "new model on these runs: "
            if calibration.automaton.n == 1
            else f"new model on these runs, {coordinate.name}: "
        )
        lines.append(f"  {sentence}{' (one step), '.join(sizes)} (roll-out)")
    return lines


def effect_line(effect: FoundEffect) -> str:
    """An effect with its parameters, its evidence, since when it acts, and what would do as well."""
    from micah_plan.residual.calibrate import began

    pairs = zip(effect.effect.parameters, effect.units, strict=True)
    values = ", ".join(f"{name} {quantity(value, unit)}" for (name, value), unit in pairs)
    added = "" if effect.is_added else "; not added"
    added += f"; began {began(effect.effect.since)}" if effect.effect.since else ""
    others = f"; or instead {', '.join(effect.tied)}" if effect.tied else ""
    return (
        f"{effect.effect.name} of {effect.effect.coordinate}: {values} ({plain(effect.evidence)} nats{added}{others})"
    )
